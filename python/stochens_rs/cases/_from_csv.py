"""A control problem from a table [A B x0 xf] with names, as CSV."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._base.csv_file import name_and_unit, read_cells
from .._base.reading import number, printable
from ..exceptions import InputError

# A comment about the step, and one that can be read: dt = 0.1, dt = 100 ms, dt [ms] = 100.
_ABOUT_STEP = re.compile(r"\bdt\s*([=:]|[\[(].*[=:])|^dt\b.*\d|^dt$", re.IGNORECASE)
_STEP = re.compile(
    r"dt\s*(?:[\[(]\s*(?P<before>\w+)\s*[\])])?\s*[=:]\s*(?P<step>[-+.\d]+(?:e[-+]?\d+)?)"
    r"\s*[\[(]?(?P<after>\w+)?[\])]?",
    re.IGNORECASE,
)
# (times, parts): dt * times / parts is rounded once; two letters for micro in Unicode
_SECONDS = {
    "s": (1, 1), "ms": (1, 1000), "us": (1, 10**6), "\u00b5s": (1, 10**6), "\u03bcs": (1, 10**6),
    "min": (60, 1), "h": (3600, 1),
}  # fmt: skip
_ENDS = ("x0", "xf")  # columns behind those of A and B


def read_csv(path: Path) -> dict[str, Any]:
    """The entries A, B, states, inputs, units, and x0, xf and dt if the file has them."""
    head, rows, comments = read_cells(path, comments=True)
    columns = dict(zip(head, map(list, zip(*rows, strict=True)), strict=True))
    of_rows = columns.pop(head[0]) if head[0] in ("", "state") else None
    found: dict[str, Any] = {name: columns.pop(name) for name in _ENDS if name in columns}
    titles = list(columns)
    if head[len(head) - len(found) :] != [name for name in _ENDS if name in found]:
        raise InputError(f"{path} must have the columns x0 and xf last, in this order")
    bare = next((title for title in titles if not title or _is_number(title)), None)
    if bare is not None:
        raise InputError(f"{path} must name its columns in the first row, got {bare[:30]!r}")
    n = len(rows)
    if len(titles) <= n:
        raise InputError(
            f"{path} must have a row for each state, and a column for each state and then for each "
            f"input, got {n} rows and {len(titles)} such columns (measured runs become a model "
            "with identify)"
        )
    names, units = zip(*(name_and_unit(title) for title in titles), strict=True)
    order = list(range(n)) if of_rows is None else _order(path, of_rows, names[:n])
    numbers = {
        title: [_number(path, title, cells[k]) for k in order]
        for title, cells in (columns | found).items()
    }
    A_B = np.array([numbers[title] for title in titles]).T
    return {
        "A": A_B[:, :n],
        "B": A_B[:, n:],
        "states": names[:n],
        "inputs": names[n:],
        "units": list(units),
        **{name: numbers[name] for name in found},
        **_step(path, comments),
    }


def _order(path: Path, of_rows: Sequence[str], states: Sequence[str]) -> list[int]:
    """The row of each state."""
    named = [name_and_unit(cell)[0] for cell in of_rows]
    wrong = next((name for name in states if named.count(name) != 1), None)
    if wrong is not None:
        raise InputError(
            f"{path} must have the names of its columns {', '.join(states[:3])[:60]}, ... as names "
            f"of its rows, each once, got {wrong[:30]!r} {named.count(wrong)} times"
        )
    return [named.index(name) for name in states]


def _number(path: Path, title: str, cell: str) -> float:
    try:
        return number(cell)
    except ValueError:
        raise InputError(
            f"{path} must have numbers in column {title[:30]!r}, got {cell[:30]!r}"
        ) from None


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
    if found is None or unit not in _SECONDS or (found["before"] and found["after"]):
        raise InputError(
            f"{path} must have the step as '# dt = 0.1', in s or with one of the units ms, us, "
            f"min and h, got '# {printable(steps[0][:40])}'"
        )
    times, parts = _SECONDS[unit]
    return {"dt": _number(path, "dt", found["step"]) * times / parts}
