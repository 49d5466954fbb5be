"""A controller as one C99 header: tables of numbers and the parts of `parts/` that use them."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np

from .. import _core
from .._base import files, validation
from .._base.names import Labels
from .._base.types import Floats
from ..exceptions import InputError

BEYOND = 1e6  # times the largest in the data from which a number is that of a broken sensor
LARGEST = 1e150  # of a number without a limit of its own: its square is finite


def write(path: Any, name: str, parts: list[str], *of: dict[str, Any], watch: Any = None) -> None:
    """Write the header of the controller `name`, with the alarm `watch` if there is one.

    `of`: sizes, tables and lines of its head, by their names.
    """
    sizes, tables, about = of
    file = files.checked_path("path", path)
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,30}", validation.text("name", name)):
        raise InputError(
            f"`name` must be a C name of lower-case letters, digits and _, got {name!r:.40}"
        )
    if watch is not None:
        (counts, numbers), parts = watch.tables(), [*parts, "alarm"]
        sizes = sizes | {f"ALARM_{one}": count for one, count in counts}
        tables = tables | {f"alarm_{one}": values for one, values in numbers}
        how = f"{name}_look(&alarm, y, the inputs that acted since the last call)"
        about = about | {"alarm": f"{watch.statement}; {how}"}
    lines = [f"/* {name}: a controller by stochens_rs {_core.version()}", " *"]
    for title, text in about.items():
        plain = re.sub(r"\*/|/\*|\?\?|[\x00-\x1f\\]", " ", f"{title}: {text}")
        lines += [f" * {line}" for line in wrap(plain, 108, subsequent_indent="  ")]
    head, lines = "\n".join([*lines, " */", ""]), [_part("common")]
    sizes = {"WIDE": 0} | sizes
    lines += [*(f"#define $_{size} {number}" for size, number in sizes.items()), _part("types")]
    for table, values in tables.items():
        array = np.asarray(values)
        real, kind = "@_real", "$_R"
        if table.startswith("alarm_"):
            real, kind = "double", ""
        elif table in ("inverse", "map", "offset", "aims"):
            real, kind = "@_wide", "$_W"
        elif array.dtype.kind == "i":
            real, kind = "int", ""
        numbers = ", ".join(_number(value, kind) for value in array.ravel().tolist())
        body = "\n    ".join(wrap(numbers or "0", 108))
        lines.append(f"static const {real} @_{table}[{max(array.size, 1)}] = {{\n    {body}}};")
    lines += [*map(_part, parts), "#endif", ""]
    files.write_text(file, head + "\n".join(lines).replace("$", name.upper()).replace("@", name))


def _part(name: str) -> str:
    return Path(__file__).with_name("parts").joinpath(f"{name}.h").read_text("utf-8")


def _number(value: float, kind: str) -> str:
    """A constant; infinite ones are the largest, those that no float holds the largest of use."""
    if kind and np.isinf(value):
        return "$_HUGE" if value > 0 else "-$_HUGE"
    return "$_LARGEST" if kind and value >= LARGEST else f"{kind}({value!r})"


def evidence(labels: Labels, dt: float | None, model: Any, read: Sequence[str]) -> dict[str, str]:
    """What the head says of the signals and the data."""
    y, u = ", ".join(map(labels.axis, read)), ", ".join(labels.input_axes)
    when = "step" if dt is None else f"{dt!r} s"
    about = {"reads": f"y = {y}", "returns": f"u = {u}", "one call each": when}
    data = getattr(model, "data", None)
    if data is not None:  # x, u, x one step later, row by row, as little-endian doubles
        rows = np.ascontiguousarray(np.hstack(data.pairs()[:3]).astype("<f8"))
        about["data"] = f"{len(rows)} pairs, sha256 {hashlib.sha256(rows.tobytes()).hexdigest()}"
    return about


def believed(seen: Floats) -> Floats:
    """Up to where a number may be true: far beyond the largest in the data, where one is."""
    return np.where(seen > 0.0, np.minimum(BEYOND * seen, LARGEST), LARGEST)
