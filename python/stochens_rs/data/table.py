"""Tables of measured runs with one row per run and time: in memory, or in CSV files."""

from __future__ import annotations

import codecs
import contextlib
import glob
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.files import PathLike, checked_path, regular_file
from .._base.reading import printable
from ..exceptions import InputError, InputTypeError, ShapeError
from .units import in_seconds, instants, titled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats

_PARSED = 30  # bytes of memory for one of a file: an empty cell is one, and has its place
_DATES = "seconds, or dates and times as 2024-03-05 10:00:00.5, all with a time zone or none"


class Text(NamedTuple):
    """How a CSV file is written; None is what the file shows."""

    sep: str | None = None
    decimal: str | None = None
    skip: int = 0

    @classmethod
    def checked(cls, sep: Any, decimal: Any, skip: Any) -> Text:
        """Check the arguments of a user."""
        if sep is not None and (
            not isinstance(sep, str) or len(sep) != 1 or sep in '"\r\n' or not sep.isascii()
        ):
            raise InputError(
                f"`sep` must be one character of ASCII, as ';', got {validation.show(sep)}"
            )
        if decimal is not None:
            validation.choice("decimal", decimal, (".", ","))
        if sep is not None and sep == decimal:
            raise InputError(f"`sep` and `decimal` must differ, got {sep!r} for both")
        return cls(sep, decimal, validation.size("skip", skip, minimum=0))


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

    def rows_of(self, *rows: int) -> str:
        """``lines 60 and 61 of run a of logs/3.csv``."""
        words = [self.table.row(int(self.rows[row])) for row in rows]
        kind = words[0].split()[0] + ("s" if len(rows) > 1 else "")
        return f"{kind} {' and '.join(word.split()[1] for word in words)} of {self.name}"

    def where(self, row: int) -> str:
        """``in run a at time 0.2``."""
        inside = self.label is not None or self.table.path is not None
        at = self.table.row(int(self.rows[row]))
        at = f"in {at}" if self.times is None else f"at time {self.times[row]:.6g}"
        return f"in {self.name} {at}" if inside else at


class Table:
    """The columns of a table, or of a CSV file, by the names that the user knows."""

    def __init__(self, columns: Any, file: _core.Table | None = None, path: str = "") -> None:
        if not isinstance(columns, Mapping) and not hasattr(columns, "columns"):
            raise InputTypeError(
                f"`table` must be a table or a mapping of columns, got {validation.show(columns)}"
            )
        self.columns, self.file, self.path = columns, file, path or None
        self.names = list(columns.keys() if isinstance(columns, Mapping) else columns.columns)

    @classmethod
    def of_file(cls, path: PathLike, how: Text | None = None) -> Table:
        """Read a CSV file whose first row names the columns, all with different names.

        Above it may stand a line ``sep=;``, empty lines, and comments that begin with # or %; below
        it a row of units, which become part of the names. Columns and rows without a cell at the
        end are left out.
        """
        how, about = how or Text(), regular_file(path)
        running.need(f"to read {path}", about.st_size * _PARSED)
        comma = None if how.decimal is None else how.decimal == ","
        file = _core.Table(str(path), _decoded(path), how.sep, comma, how.skip)
        odd = next((name for name in file.names if printable(name) != name), None)
        if odd is not None:
            raise InputError(
                f"{path} must name its columns in one line of text without control characters, "
                f"got {odd[:40]!r}"
            )
        return cls({name: k for k, name in enumerate(file.names)}, file, str(path))

    def title(self, name: Any) -> Any:
        """The column of this name, with the unit that stands behind it."""
        return titled(name, self.names) if isinstance(name, str) else name

    def row(self, row: int) -> str:
        """A row in words: of a file its line."""
        return f"row {row}" if self.file is None else f"line {self.file.line(row)}"

    def in_words(self, name: Any) -> str:
        """A column in words."""
        of = self.path
        return f"`table[{name!r:.30}]`" if of is None else f"column '{name:.30}' of {of}"

    def column(self, argument: str, name: Any) -> Any:
        """A column as it is: an array, or the place of a column of a file."""
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
        if self.file is not None:
            return found
        if isinstance(self.columns, Mapping):
            column = validation.read(f"table[{name!r:.30}]", found)
        else:  # all columns of a frame have the order of its rows
            column = np.asarray(found)
        if column.ndim != 1:
            raise ShapeError(
                f"{self.in_words(name)} must be one column, got {column.ndim} dimensions"
            )
        return column

    def numbers(self, argument: str, name: Any, *, whole: bool = False) -> Floats:
        """A column of numbers; nan where one is missing, unless one of a file must be `whole`."""
        column = self.column(argument, name)
        if self.file is not None:
            return self.file.numbers(column, whole)
        if column.dtype.kind == "O":  # numbers and None, as tables keep them
            with contextlib.suppress(TypeError, ValueError):
                column = column.astype(np.float64)
        if column.dtype.kind not in "iuf":
            raise InputTypeError(
                f"{self.in_words(name)} must contain real numbers, got dtype "
                f"{str(column.dtype)[:40]}"
            )
        numbers: Floats = column.astype(np.float64)
        return numbers

    def times(self, name: Any) -> Floats:
        """A column of times in seconds, or of dates and times in seconds since its first row."""
        column = self.column("time", name)
        times: Floats
        if self.file is None and column.dtype.kind in "mM":
            times = (column - column[:1]) / np.timedelta64(1, "s")
        else:
            try:
                numbers = self.numbers("time", name)
            except (InputError, InputTypeError) as error:
                times = self._dates(name, column, error)
            else:
                times = in_seconds(self.in_words(name), name, numbers)
        if not np.isfinite(times).all():
            row = self.row(int(np.argmin(np.isfinite(times))))
            raise InputError(
                f"`time` is missing in {row}{'' if self.path is None else f' of {self.path}'}"
            )
        return times

    def _dates(self, name: Any, column: Any, error: Exception) -> Floats:
        cells = list(column) if self.file is None else self.file.cells(column)
        try:
            return instants(cells)
        except ValueError as found:
            k = found.args[0]
        if k == 0:  # it has no dates
            raise type(error)(f"{error}: {_DATES}; pandas.to_datetime reads other forms") from None
        again = "" if self.file is None else self.file.cure(column, cells[k])
        raise InputError(
            f"`time` must have {_DATES}, got {validation.show(cells[k])} in {self.row(k)} of "
            f"{self.in_words(name)}{again}"
        ) from None

    def labels(self, by: Any) -> list[Any]:
        """The labels as they are: NumPy makes 1 of True, and text of both beside text."""
        column = self.column("by", by)
        if self.file is not None:
            return [label or None for label in self.file.cells(column)]
        if column.dtype.kind in "mM":
            return [None if np.isnat(time) else time.item() for time in column]
        given = self.columns[by]
        return list(given) if isinstance(given, (list, tuple)) else column.tolist()


def _decoded(path: PathLike) -> str:
    """The text of a file in UTF-8, UTF-16, or Windows-1252, of which Latin-1 is the larger part."""
    content = Path(path).read_bytes()
    encodings = ["utf-8-sig", "cp1252"]
    if content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        encodings = ["utf-16"]
    elif b"\0" in content[:2]:
        encodings = ["utf-16-be" if content[:1] == b"\0" else "utf-16-le"]
    for encoding in encodings:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise InputError(f"{path} must be a CSV file, text in UTF-8, UTF-16 or Windows-1252")


def csv_files(source: Any) -> list[str]:
    """The files of a folder, of a pattern, or of a list in its order; or one file.

    Those of a folder or pattern are in the order of their names, with numbers compared as numbers:
    run_2 before run_10.
    """
    single = isinstance(source, (str, os.PathLike))
    given = [source] if single else validation.items("source", source)
    found = [path for one in given for path in _files(one)]
    twice = next((p for p, n in Counter(map(os.path.realpath, found)).items() if n > 1), None)
    if twice is not None:
        raise InputError(f"`source` must name each file once, got {twice} twice")
    return found


def _files(source: Any) -> list[str]:
    folder = source.rstrip("/") if isinstance(source, str) else source  # the shell adds a slash
    text = checked_path("source", folder)
    if os.path.isdir(text):
        entries = (one for one in os.scandir(text) if not one.is_dir())
        found = [one.path for one in entries if one.name.lower().endswith(".csv")]
        wanted = f"no .csv file in the folder {text}"
    elif glob.has_magic(text) and not os.path.exists(text):
        found, wanted = glob.glob(text), f"no file fits {text}"
    else:
        return [text]
    if not found:
        raise FileNotFoundError(wanted)
    return sorted(found, key=natural)


def natural(path: str) -> tuple[list[Any], str]:
    """What to sort names by so that numbers in them are compared as numbers."""
    parts = re.split("([0-9]+)", path)
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], path


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


def read_files(source: Any, chosen: Chosen, how: Text | None = None) -> tuple[list[Run], Chosen]:
    """The runs of CSV files, and the columns with the units that the files say."""
    runs: list[Run] = []
    titles = None
    for path in csv_files(source):
        own, more = read_table(Table.of_file(path, how), chosen)
        runs += more
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


def read_table(table: Table, named: Chosen) -> tuple[Chosen, list[Run]]:
    """The columns as the table calls them; and its runs, in the order of their first rows."""
    states, inputs = ([table.title(name) for name in some] for some in named[:2])
    by, time = map(table.title, named[2:4])
    chosen = Chosen(states, inputs, by, time, named.kind)
    read = [(chosen.kind, name) for name in states] + [("inputs", name) for name in inputs]
    columns = [table.numbers(*one) for one in read]
    times = None if chosen.time is None else table.times(chosen.time)
    lengths = [len(column) for column in columns] + ([] if times is None else [len(times)])
    if len(set(lengths)) > 1:
        other = next(k for k, length in enumerate(lengths) if length != lengths[0])
        names = [name for _, name in read] + [chosen.time]
        raise ShapeError(
            f"`table` must have columns of one length, got {lengths[0]} rows of "
            f"{validation.show(names[0])} and {lengths[other]} of "
            f"{validation.show(names[other])}: the last row of an input is not used, so that nan "
            "may stand there"
        )
    x, u = np.column_stack(columns[: len(states)]), np.column_stack(columns[len(states) :])
    runs = []
    for label, rows in _runs(table, chosen.by, len(x)):
        text = None if chosen.by is None else printable(f"{label!s:.30}")
        own = None if times is None else times[rows]
        run = Run(x[rows], u[rows], own, rows, table, text)
        for values, names in ((run.x, chosen.states), (run.u, chosen.inputs)):
            if np.isinf(values).any():
                row, column = np.unravel_index(int(np.argmax(np.isinf(values))), values.shape)
                raise InputError(
                    f"{table.in_words(names[column])} is {values[row, column]} "
                    f"{run.where(int(row))}: "
                    "a run that diverged ends with its last finite state"
                )
        runs.append(run)
    return chosen, runs


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
                f"`by` is missing in {table.row(row)}{of}, or no label: {validation.show(label)}"
            )
    for (_, label), places in found.items():
        yield label, np.array(places)
