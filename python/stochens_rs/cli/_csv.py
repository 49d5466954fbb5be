"""Columns of a CSV file, as numbers, times or text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .._base.csv_file import read_cells
from .._base.reading import number
from .._base.validation import nearest
from ..exceptions import InputError
from ..identification import Trajectories


def read_runs(
    path: str, states: Sequence[str], inputs: Sequence[str], by: str | None, time: str | None
) -> tuple[Trajectories, list[str]]:
    """Read runs from a CSV file whose first row names the columns; messages name the file.

    Returns them and the columns that are not used.
    """
    columns = _columns(path)
    wanted = (("--states", states), ("--inputs", inputs), ("--by", [by]), ("--time", [time]))
    for option, names in wanted:
        for name in names:
            if name is not None and name not in columns:
                known = f"{', '.join(list(columns)[:8])}{nearest(name, columns)}"
                raise InputError(f"{path} has no column '{name}' for {option}: it has {known}")
    table: dict[str, Any] = {name: _numbers(path, name, columns[name]) for name in states}
    table |= {name: _numbers(path, name, columns[name]) for name in inputs}
    if time is not None:
        table[time] = _times(path, time, columns[time])
    if by is not None:
        table[by] = np.array(columns[by])
        empty = next((k for k, label in enumerate(columns[by]) if not label), None)
        if empty is not None:
            raise InputError(f"{path} has no run in column '{by}', row {empty + 2}")
    unused = [name for name in columns if name not in table]
    try:
        runs = Trajectories.from_table(table, states=states, inputs=inputs, by=by, time=time)
    except InputError as error:
        left = f" (columns not used: {listed(unused)})" if unused and by is None else ""
        raise type(error)(f"{path}: {error}{left}") from None
    return runs, unused


def listed(names: Sequence[str]) -> str:
    """Names with commas, the first of many."""
    return ", ".join([*(name[:30] for name in names[:8]), *(["..."] if len(names) > 8 else [])])


def _columns(path: str) -> dict[str, list[str]]:
    names, rows, _ = read_cells(path)
    return dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))


def _numbers(path: str, name: str, cells: list[str]) -> Any:
    """Numbers, nan where a cell is empty."""
    found = np.empty(len(cells))
    for k, cell in enumerate(cells):
        try:
            found[k] = number(cell) if cell else np.nan
        except ValueError:
            raise InputError(
                f"{path} must have numbers in column '{name}', got {cell[:30]!r} in row {k + 2}"
            ) from None
    return found


def _times(path: str, name: str, cells: list[str]) -> Any:
    """Seconds, or dates and times as ISO 8601 writes them."""
    try:
        return _numbers(path, name, cells)
    except InputError as error:
        try:
            return np.array(cells, dtype="datetime64[ns]")
        except ValueError:
            raise InputError(f"{error}: seconds, or dates and times as in ISO 8601") from None
