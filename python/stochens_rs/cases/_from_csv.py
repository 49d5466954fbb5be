"""A control problem from a table [A B x0 xf] with names, as CSV."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._base.reading import printable
from ..data.table import Table
from ..data.units import SECONDS, name_and_unit
from ..exceptions import InputError

# A comment about the step, and one that can be read: dt = 0.1, dt = 100 ms, dt [ms] = 100.
_ABOUT_STEP = re.compile(r"\bdt\s*([=:]|[\[(].*[=:])|^dt\b.*\d|^dt$", re.IGNORECASE)
_STEP = re.compile(
    r"dt\s*(?:[\[(]\s*(?P<before>\w+)\s*[\])])?\s*[=:]\s*(?P<step>[-+.\d]+(?:e[-+]?\d+)?)"
    r"\s*[\[(]?(?P<after>\w+)?[\])]?",
    re.IGNORECASE,
)
_ENDS = ("x0", "xf")  # columns behind those of A and B


def read_csv(path: Path) -> dict[str, Any]:
    """The entries A, B, states, inputs, units, and x0, xf and dt if the file has them."""
    table = Table.of_file(path)
    head = table.names
    of_rows = table.labels(head[0]) if head[0] in ("", "state") else None
    found = [name for name in _ENDS if name in head]
    titles = [name for name in head[of_rows is not None :] if name not in found]
    if head[len(head) - len(found) :] != found:
        raise InputError(f"{path} must have the columns x0 and xf last, in this order")
    bare = next((title for title in titles if not title or _is_number(title)), None)
    if bare is not None:
        raise InputError(f"{path} must name its columns in the first row, got {bare[:30]!r}")
    assert table.file is not None
    n = table.file.rows
    if len(titles) <= n:
        raise InputError(
            f"{path} must have a row for each state, and a column for each state and then for each "
            f"input, got {n} rows and {len(titles)} such columns (measured runs become a model "
            "with identify)"
        )
    names, units = zip(*(name_and_unit(title) for title in titles), strict=True)
    order = list(range(n)) if of_rows is None else _order(path, of_rows, names[:n])
    numbers = {
        title: table.numbers("path", title, whole=True)[order] for title in (*titles, *found)
    }
    A_B = np.array([numbers[title] for title in titles]).T
    return {
        "A": A_B[:, :n],
        "B": A_B[:, n:],
        "states": names[:n],
        "inputs": names[n:],
        "units": list(units),
        **{name: numbers[name] for name in found},
        **_step(path, table.file.comments),
    }


def _order(path: Path, of_rows: Sequence[str], states: Sequence[str]) -> list[int]:
    """The row of each state."""
    named = [name_and_unit(cell.strip())[0] for cell in of_rows]
    wrong = next((name for name in states if named.count(name) != 1), None)
    if wrong is not None:
        raise InputError(
            f"{path} must have the names of its columns {', '.join(states[:3])[:60]}, ... as names "
            f"of its rows, each once, got {wrong[:30]!r} {named.count(wrong)} times"
        )
    return [named.index(name) for name in states]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _step(path: Path, comments: Sequence[str]) -> dict[str, float]:
    """``# dt = 0.1`` or ``# dt = 100 ms`` above the names of the columns, in seconds."""
    steps = [line for line in comments if _ABOUT_STEP.search(line)]
    if len(steps) > 1:
        raise InputError(f"{path} must have one line '# dt = ...', got {len(steps)}")
    if not steps:
        return {}
    found = _STEP.fullmatch(steps[0])
    unit = "" if found is None else (found["before"] or found["after"] or "s").lower()
    wrong = unit not in SECONDS or not _is_number("" if found is None else found["step"])
    if found is None or wrong or (found["before"] and found["after"]):
        raise InputError(
            f"{path} must have the step as '# dt = 0.1', in s or with one of the units ms, us, "
            f"min and h, got '# {printable(steps[0][:40])}'"
        )
    times, parts = SECONDS[unit]
    return {"dt": float(found["step"]) * times / parts}
