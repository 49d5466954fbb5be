"""Runs from tables and CSV files with one row per run and time, their columns named by the user."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._base import validation
from .._base.csv_file import csv_files, name_and_unit, read_cells, titled
from .._base.reading import number, printable
from ..exceptions import InputError, InputTypeError, ShapeError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from .._base.types import Floats


class Chosen(NamedTuple):
    """The columns that the user names."""

    states: list[Any]
    inputs: list[Any]
    by: Any
    time: Any
    kind: str = "states"


@dataclass(frozen=True, eq=False)
class Run:
    """The rows of a run: states, inputs, nan where one is missing; times [s]; and words for it."""

    x: Floats
    u: Floats
    times: Floats | None
    rows: NDArray[np.intp]
    table: Table
    label: str | None

    @property
    def name(self) -> str:
        """``run a``, ``logs/3.csv``, ``run a of logs/3.csv``."""
        of = self.table.path if self.label is None else f"run {self.label}"
        return f"{of} of {self.table.path}" if self.label and self.table.path else of or "the table"

    def where(self, row: int) -> str:
        """``in run a at time 0.2``."""
        inside = self.label is not None or self.table.path is not None
        at = f"row {self.rows[row] + self.table.first}"
        at = f"in {at}" if self.times is None else f"at time {self.times[row]:.6g}"
        return f"in {self.name} {at}" if inside else at


class Table:
    """The columns of a table, or of a CSV file, by the names that the user knows."""

    def __init__(self, columns: Any, path: str | None = None) -> None:
        if not isinstance(columns, Mapping) and not hasattr(columns, "columns"):
            raise InputTypeError(
                f"`table` must be a table or a mapping of columns, got {validation.show(columns)}"
            )
        self.columns, self.path = columns, path
        self.first = 0 if path is None else 2  # the number of its first row: a file has a head

    @classmethod
    def of_file(cls, path: str) -> Table:
        """Read a CSV file; its cells stay text."""
        names, rows, _ = read_cells(path)
        columns = zip(*rows, strict=True)
        return cls({name: np.array(one) for name, one in zip(names, columns, strict=True)}, path)

    @property
    def names(self) -> list[Any]:
        """The names of the columns."""
        return list(self.columns.keys() if self.path is not None else _names(self.columns))

    def title(self, name: Any) -> Any:
        """The column of this name, with the unit that a file may say behind it."""
        if not isinstance(name, str) or self.path is None:
            return name
        return titled(name, self.columns)

    def said(self, name: Any) -> str:
        """A column in words."""
        if self.path is not None:
            return f"column '{name:.30}' of {self.path}"
        return f"`table[{name!r:.30}]`"

    def column(self, argument: str, name: Any) -> NDArray[Any]:
        """A column as it is."""
        try:
            found = self.columns[name]
        except MemoryError:
            raise
        except Exception:  # whatever a table raises for what is no column
            known = ", ".join(printable(f"{one!s:.20}") for one in self.names[:8])
            texts = [one for one in self.names if isinstance(one, str)]
            near = validation.nearest(name, texts) if isinstance(name, str) else ""
            of = "`table`" if self.path is None else self.path
            raise InputError(
                f"`{argument}` names {validation.show(name)}, but the columns of {of} are "
                f"{known}{', ...' if len(self.names) > 8 else ''}{near}"
            ) from None
        if isinstance(self.columns, Mapping):
            column = validation.read(f"table[{name!r:.30}]", found)
        else:  # all columns of a frame have the order of its rows
            column = np.asarray(found)
        if column.ndim != 1:
            raise ShapeError(f"{self.said(name)} must be one column, got {column.ndim} dimensions")
        return column

    def numbers(self, argument: str, name: Any) -> Floats:
        """A column of numbers; nan where one is missing."""
        column = self.column(argument, name)
        if self.path is not None:
            return self._parsed(name, column)
        if column.dtype.kind == "O":  # numbers and None, as tables keep them
            with contextlib.suppress(TypeError, ValueError):
                column = column.astype(np.float64)
        if column.dtype.kind not in "iuf":
            raise InputTypeError(
                f"{self.said(name)} must contain real numbers, got dtype {str(column.dtype)[:40]}"
            )
        return column.astype(np.float64)

    def times(self, name: Any, rows: int) -> Floats:
        """A column of seconds, or of dates and times in seconds since its first row."""
        column = self.column("time", name)
        if self.path is not None:
            if name_and_unit(name)[1] not in ("", "s"):
                raise InputError(f"{self.said(name)} must be in seconds, or dates and times")
            try:
                column = self._parsed(name, column)
            except InputError as error:
                try:
                    column = column.astype("datetime64[ns]")
                except ValueError:
                    raise InputError(
                        f"{error}: seconds, or dates and times as in ISO 8601"
                    ) from None
        if column.dtype.kind in "mM" and len(column):
            column = (column - column[0]) / np.timedelta64(1, "s")
        if column.dtype.kind not in "iuf" or len(column) != rows:
            raise InputTypeError(
                f"`time` must be a column of {rows} numbers or dates, got {len(column)} of dtype "
                f"{str(column.dtype)[:40]}"
            )
        times = column.astype(np.float64)
        if not np.isfinite(times).all():
            row = int(np.argmin(np.isfinite(times))) + self.first
            of = "" if self.path is None else f" of {self.path}"
            raise InputError(f"`time` is missing in row {row}{of}")
        return times

    def labels(self, by: Any) -> list[Any]:
        """The labels as they are: NumPy makes 1 of True, and text of both beside text."""
        column = self.column("by", by)
        if self.path is not None:
            return [label or None for label in column.tolist()]
        if column.dtype.kind in "mM":
            return [None if np.isnat(time) else time.item() for time in column]
        given = self.columns[by]
        return list(given) if isinstance(given, (list, tuple)) else column.tolist()

    def _parsed(self, name: Any, cells: NDArray[Any]) -> Floats:
        """Text as numbers, nan where a cell is empty."""
        found = np.full(len(cells), np.nan)
        for k, cell in enumerate(cells.tolist()):
            try:
                found[k] = number(cell) if cell else np.nan
            except ValueError:
                raise InputError(
                    f"{self.path} must have numbers in column '{name:.30}', got {cell[:30]!r} in "
                    f"row {k + self.first}"
                ) from None
        return found


def chosen_columns(states: Any, outputs: Any, inputs: Any, by: Any, time: Any) -> Chosen:
    """Check the arguments that name columns."""
    if (states is None) == (outputs is None):
        raise InputError("exactly one of `states` and `outputs` must be given")
    kind, names = ("outputs", outputs) if states is None else ("states", states)
    chosen = Chosen(
        validation.items(kind, names), validation.items("inputs", inputs), by, time, kind
    )
    for argument, names in ((kind, chosen.states), ("inputs", chosen.inputs)):
        if not names:
            raise InputError(f"`{argument}` must name at least one column, got none")
    return chosen


def read_files(source: Any, chosen: Chosen) -> tuple[list[Run], Chosen]:
    """The runs of CSV files, and the columns with the units that the files say."""
    runs: list[Run] = []
    titles = None
    for path in csv_files(source):
        table = Table.of_file(path)
        states, inputs = ([table.title(name) for name in some] for some in chosen[:2])
        by, time = (table.title(name) for name in chosen[2:4])
        own = Chosen(states, inputs, by, time, chosen.kind)
        runs += read_table(table, own)
        titles = titles or own
        if own != titles:
            here, before = next((a, b) for a, b in zip(own, titles, strict=True) if a != b)
            raise InputError(
                f"{path} has {printable(f'{here!s:.80}')}, the files before it "
                f"{printable(f'{before!s:.80}')}: bring them to the same units"
            )
    if titles is None:
        raise InputError("`source` must have at least one file, got none")
    return runs, titles


def read_table(table: Table, chosen: Chosen) -> list[Run]:
    """The runs of a table, in the order of their first rows."""
    x = np.column_stack([table.numbers(chosen.kind, name) for name in chosen.states])
    u = np.column_stack([table.numbers("inputs", name) for name in chosen.inputs])
    if len(x) != len(u):
        raise ShapeError(f"`table` must have columns of one length, got {len(x)} and {len(u)} rows")
    times = None if chosen.time is None else table.times(chosen.time, len(x))
    runs = []
    for label, rows in _runs(table, chosen.by, len(x)):
        text = None if chosen.by is None else printable(f"{label!s:.30}")
        own = None if times is None else times[rows]
        run = Run(x[rows], u[rows], own, rows, table, text)
        for values, names in ((run.x, chosen.states), (run.u, chosen.inputs)):
            if np.isinf(values).any():
                row, column = np.unravel_index(int(np.argmax(np.isinf(values))), values.shape)
                raise InputError(
                    f"{table.said(names[column])} is {values[row, column]} {run.where(int(row))}: "
                    "a run that diverged ends with its last finite state"
                )
        runs.append(run)
    return runs


def _names(columns: Any) -> Any:
    return columns.keys() if isinstance(columns, Mapping) else columns.columns


def _runs(table: Table, by: Any, rows: int) -> Iterator[tuple[Any, NDArray[np.intp]]]:
    """The label and the rows of each run, in the order of their first rows."""
    if by is None:
        yield None, np.arange(rows)
        return
    labels = table.labels(by)
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
            of = "" if table.path is None else f" of {table.path}, column '{by:.30}'"
            raise InputError(
                f"`by` is missing in row {row + table.first}{of}, or no label: "
                f"{validation.show(label)}"
            )
    for (_, label), places in found.items():
        yield label, np.array(places)
