"""Runs from a table with one row per run and time, its columns named by the user."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import validation
from .._base.reading import printable
from ..exceptions import InputError, InputTypeError, ShapeError
from ..theory.exact import EPS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats


# A step may differ from the others by this part of it: times are often written with few digits.
EQUAL = 1e-3


def read_table(
    table: Any, states: Sequence[Any], inputs: Sequence[Any], by: Any, time: Any
) -> tuple[Floats, NDArray[np.int64], float | None]:
    """The rows (x, u, x_next) of all runs, the steps of each run, and the time between steps."""
    chosen = {
        "states": validation.items("states", states),
        "inputs": validation.items("inputs", inputs),
    }
    for argument, names in chosen.items():
        if not names:
            raise InputError(f"`{argument}` must name at least one column, got none")
    x, u = (
        np.column_stack([_numbers(table, argument, name) for name in names])
        for argument, names in chosen.items()
    )
    if len(x) != len(u):
        raise ShapeError(f"`table` must have columns of one length, got {len(x)} and {len(u)} rows")
    times = None if time is None else _seconds(_column(table, "time", time), len(x))
    rows, lengths, dt = [], [], None
    for label, places in _runs(table, by, len(x)):
        where = _Place(label if by is not None else None, places, times)
        if len(places) < 2:
            raise InputError(f"`table` has one row only {where(0)}: a run needs two")
        if times is not None:
            dt = _checked_step(times[places], where, dt)
        names = chosen["states"]
        _refuse_missing(x[places], names, where)
        _refuse_missing(u[places[:-1]], chosen["inputs"], where)
        rows.append(np.hstack([x[places[:-1]], u[places[:-1]], x[places[1:]]]))
        lengths.append(len(places) - 1)
    return np.vstack(rows), np.array(lengths, dtype=np.int64), dt


class _Place:
    """Words for a row of a run: ``in run 'a' at time 0.2``."""

    def __init__(self, label: object, places: NDArray[np.intp], times: Floats | None) -> None:
        text = printable(f"{label!s:.30}")
        self.label, self.places, self.times = None if label is None else text, places, times

    def __call__(self, row: int) -> str:
        run = "" if self.label is None else f"in run {self.label} "
        at = f"in row {self.places[row]}"
        return run + (at if self.times is None else f"at time {self.times[self.places[row]]:.6g}")


def _column(table: Any, argument: str, name: Any) -> NDArray[Any]:
    if not isinstance(table, Mapping) and not hasattr(table, "columns"):
        raise InputTypeError(
            f"`table` must be a table or a mapping of columns, got {validation.show(table)}"
        )
    try:
        found = table[name]
    except MemoryError:
        raise
    except Exception:  # whatever a table raises for what is no column
        known = ", ".join(printable(f"{one!s:.20}") for one in list(_column_names(table))[:6])
        raise InputError(
            f"`{argument}` names {validation.show(name)}, but the columns of `table` are {known}"
        ) from None
    if isinstance(table, Mapping):
        column = validation.read(f"table[{name!r:.30}]", found)
    else:  # all columns of a frame have the order of its rows
        column = np.asarray(found)
    if column.ndim != 1:
        raise ShapeError(f"`table[{name!r:.30}]` must be one column, got {column.ndim} dimensions")
    return column


def _column_names(table: Any) -> Any:
    return table.keys() if isinstance(table, Mapping) else table.columns


def _numbers(table: Any, argument: str, name: Any) -> Floats:
    column = _column(table, argument, name)
    if column.dtype.kind == "O":  # numbers and None, as tables keep them
        with contextlib.suppress(TypeError, ValueError):
            column = column.astype(np.float64)
    if column.dtype.kind not in "iuf":
        raise InputTypeError(
            f"`table[{name!r:.30}]` must contain real numbers, got dtype {str(column.dtype)[:40]}"
        )
    return column.astype(np.float64)


def _seconds(column: NDArray[Any], rows: int) -> Floats:
    if column.dtype.kind in "mM":  # dates or durations
        column = (column - column[0]) / np.timedelta64(1, "s")
    if column.dtype.kind not in "iuf" or len(column) != rows:
        raise InputTypeError(
            f"`time` must be a column of {rows} numbers or dates, got {len(column)} of dtype "
            f"{str(column.dtype)[:40]}"
        )
    times = column.astype(np.float64)
    if not np.isfinite(times).all():
        raise InputError(f"`time` is missing in row {int(np.argmin(np.isfinite(times)))}")
    return times


def _runs(table: Any, by: Any, rows: int) -> list[tuple[Any, NDArray[np.intp]]]:
    """The label and the rows of each run, in the order of their first rows."""
    if by is None:
        return [(None, np.arange(rows))]
    labels = _labels(table, by)
    if len(labels) != rows:
        raise ShapeError(f"`by` must be a column of {rows} rows, got {len(labels)}")
    found: dict[tuple[bool, Any], list[int]] = {}
    for row, label in enumerate(labels):
        try:
            missing = label is None or bool(label != label)  # nan
            # True is apart from 1, which it equals
            found.setdefault((isinstance(label, (bool, np.bool_)), label), []).append(row)
        except (TypeError, ValueError):  # missing as pandas says it, or a list
            missing = True
        if missing:
            raise InputError(f"`by` is missing in row {row}, or no label: {validation.show(label)}")
    return [(label, np.array(places)) for (_, label), places in found.items()]


def _labels(table: Any, by: Any) -> list[Any]:
    """The labels of the rows as they are: NumPy makes 1 of True, and text of both beside text."""
    column = _column(table, "by", by)
    if column.dtype.kind in "mM":
        return [None if np.isnat(time) else time.item() for time in column]
    given = table[by]
    return list(given) if isinstance(given, (list, tuple)) else column.tolist()


def _checked_step(times: Floats, where: _Place, dt: float | None) -> float:
    """The time between two rows; that of the runs before, if there are any."""
    steps = np.diff(times)
    if (steps <= 0.0).any():
        row = int(np.argmax(steps <= 0.0)) + 1
        raise InputError(
            f"`time` must increase within a run, but does not {where(row)}: sort it"
            + (", or, if there are several runs, give `by`" if where.label is None else "")
        )
    usual = float(np.median(steps)) if dt is None else dt
    # rounding of the times themselves, and of what is written with few digits
    slack = EQUAL * usual + 8.0 * EPS * float(np.abs(times).max())
    wrong = np.abs(steps - usual) > slack
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"`time` must have equal steps of {usual:.6g}, but the next row {where(row)} is "
            f"{steps[row]:.6g} later: divide the run at the gap"
        )
    return float(f"{usual:.12g}")  # 0.1, where the times are 0, 0.1, 0.2, 0.30000000000000004


def _refuse_missing(values: Floats, names: list[Any], where: _Place) -> None:
    finite = np.isfinite(values)
    if not finite.all():
        row, column = np.unravel_index(int(np.argmin(finite)), values.shape)
        raise InputError(
            f"`table[{names[column]!r:.30}]` is {values[row, column]} {where(int(row))}: "
            "end the run before it, and start a new one after it"
            + ("; without `by`, all rows are one run" if where.label is None else "")
        )
