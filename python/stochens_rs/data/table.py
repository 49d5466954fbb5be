"""Tables of measured runs: columns with their units, one row per run and time, from CSV files."""

from __future__ import annotations

import codecs
import contextlib
import glob
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from datetime import date
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.files import PathLike, checked_path, regular_file
from .._base.reading import printable, titled
from .._base.types import Floats, NDArray
from ..exceptions import InputError, InputTypeError, ShapeError

_PARSED = 30  # bytes of memory for one of a file: an empty cell is one, and has its place
_DATES = "seconds, or dates and times as 2024-03-05 10:00:00.5, all with a time zone or none"


class Columns(NamedTuple):
    """The columns that the user names; `kind`: whether "states" or "outputs" are read."""

    kind: str
    read: list[Any]
    inputs: list[Any]
    by: Any
    time: Any

    @classmethod
    def checked(cls, states: Any, outputs: Any, inputs: Any, by: Any, time: Any) -> Columns:
        """Check the arguments of a user."""
        if (states is None) == (outputs is None):
            raise InputError("exactly one of `states` and `outputs` must be given")
        kind, names = ("outputs", outputs) if states is None else ("states", states)
        read, acting = validation.items(kind, names), validation.items("inputs", inputs)
        for argument, some in ((kind, read), ("inputs", acting)):
            if not some:
                raise InputError(f"`{argument}` must name at least one column, got none")
        return cls(kind, read, acting, by, time)


class Run(NamedTuple):
    """The rows of a run, and words for them."""

    z: Floats  # n states, then inputs; nan where one is missing
    n: int
    times: Floats  # [s]; none where the log has no times
    rows: NDArray[np.intp]
    table: Table
    label: str | None

    @property
    def name(self) -> str:
        """``run a``, ``logs/3.csv``, ``run a of logs/3.csv``."""
        words = [f"run {self.label}" if self.label is not None else "", self.table.path or ""]
        return " of ".join(filter(None, words)) or "the table"

    def rows_of(self, *rows: int) -> str:
        """``lines 60 and 61 of run a of logs/3.csv``."""
        words = [self.table.row(int(self.rows[row])).split() for row in rows]
        numbers = " and ".join(number for _, number in words)
        return f"{words[0][0]}{'s' if len(rows) > 1 else ''} {numbers} of {self.name}"

    def where(self, row: int) -> str:
        """``in run a at time 0.2``."""
        at = f"in {self.table.row(int(self.rows[row]))}"
        at = f"at time {self.times[row]:.6g}" if len(self.times) else at
        return at if self.name == "the table" else f"in {self.name} {at}"


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
    def of_file(cls, path: PathLike, skip: object = 0) -> Table:
        """Read a CSV file whose first row names the columns, all with different names.

        Above it may stand a line ``sep=;``, empty lines, and comments that begin with # or %; below
        it a row of units, which become part of the names. Columns and rows without a cell at the
        end are left out.
        """
        above = validation.size("skip", skip, minimum=0)
        running.need(f"to read {path}", regular_file(path).st_size * _PARSED)
        file = _core.Table(str(path), _decoded(path), above)
        odd = next((name for name in file.names if printable(name) != name), None)
        if odd is not None:
            raise InputError(
                f"{path} must name its columns in one line of text without control characters, "
                f"got {odd[:40]!r}"
            )
        return cls({name: k for k, name in enumerate(file.names)}, file, str(path))

    def title(self, name: Any) -> Any:
        """The column of this name, with the unit that stands behind it."""
        return titled(name, self.names)

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
                f"{self.in_words(name)} must contain real numbers, got "
                f"{_odd_cell(column) or str(column.dtype)[:40]}"
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
                times = self.numbers("time", name)
            except (InputError, InputTypeError) as error:
                times = self._dates(name, column, error)
            else:
                times = in_seconds(self.in_words(name), name, times)
        if not np.isfinite(times).all():
            row = self.row(int(np.argmin(np.isfinite(times))))
            raise InputError(
                f"`time` is missing in {row}{'' if self.path is None else f' of {self.path}'}"
            )
        return times

    def _dates(self, name: Any, column: Any, error: Exception) -> Floats:
        """Texts as in ISO 8601, or objects of `datetime`, all with a time zone or all without."""
        cells = list(column) if self.file is None else self.file.cells(column)
        seconds, k = _core.instants(list(map(as_text, cells)))
        if k is None:
            return seconds
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


def _odd_cell(column: NDArray[Any]) -> str:
    """The first cell of a column of objects or texts that is no number, with its row and a cure."""
    if column.dtype.kind not in "OUT":
        return ""
    for row, cell in enumerate(column.tolist()):
        if cell is None or validation.is_real(cell):
            continue
        cure = "pass nan where nothing was measured"
        if isinstance(cell, str) and re.fullmatch(r"\s*[-+]?\d+([.,]\d+)?([eE][-+]?\d+)?\s*", cell):
            comma = ", after .str.replace(',', '.')" if "," in cell else ""
            cure = f"a number as text: column.astype(float){comma} makes it one"
        return f"{validation.show(cell)} in row {row}: {cure}"
    return ""


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


def read_runs(tables: Iterable[Table], columns: Columns) -> tuple[Columns, list[Run]]:
    """The columns as the tables call them; and their runs, in the order of their first rows."""
    runs: list[Run] = []
    titles = None
    for table in tables:
        own = Columns(
            columns.kind,
            [table.title(name) for name in columns.read],
            [table.title(name) for name in columns.inputs],
            *map(table.title, columns[3:]),
        )
        runs += _runs(table, own)
        titles = titles or own
        if own != titles:
            here, before = next((a, b) for a, b in zip(own, titles, strict=True) if a != b)
            raise InputError(
                f"{table.path} has {printable(f'{here!s:.80}')}, the files before it "
                f"{printable(f'{before!s:.80}')}: bring them to the same units"
            )
    if titles is None:
        raise InputError("`source` must have at least one file, got none")
    return titles, runs


def _runs(table: Table, columns: Columns) -> Iterator[Run]:
    """The runs of a table, in the order of their first rows."""
    kind, states, inputs, by, time = columns
    named = [(kind, name) for name in states] + [("inputs", name) for name in inputs]
    read = [table.numbers(*one) for one in named]
    times = np.zeros(0) if time is None else table.times(time)
    lengths = [len(column) for column in read] + ([] if time is None else [len(times)])
    other = next((k for k, length in enumerate(lengths) if length != lengths[0]), None)
    if other is not None:
        names = [name for _, name in named] + [time]
        raise ShapeError(
            f"`table` must have columns of one length, got {lengths[0]} rows of "
            f"{validation.show(names[0])} and {lengths[other]} of "
            f"{validation.show(names[other])}: the last row of an input is not used, so that nan "
            "may stand there"
        )
    z = np.column_stack(read)
    for label, rows in _rows(table, by, len(z)).items():
        text = None if by is None else printable(f"{label[1]!s:.30}")
        run = Run(z[rows], len(states), times[rows] if len(times) else times, rows, table, text)
        wrong = np.argwhere(np.isinf(run.z))
        if len(wrong):
            row, column = map(int, wrong[0])
            raise InputError(
                f"{table.in_words(named[column][1])} is {run.z[row, column]} {run.where(row)}: "
                "a run that diverged ends with its last finite state"
            )
        yield run


def _rows(table: Table, by: Any, rows: int) -> dict[tuple[bool, Any], NDArray[np.intp]]:
    """The rows of each label, in the order of their first rows; True is apart from 1."""
    if by is None:
        return {(False, None): np.arange(rows)}
    labels = table.labels(by)
    if len(labels) != rows:
        raise ShapeError(f"`by` must be a column of {rows} rows, got {len(labels)}")
    found: dict[tuple[bool, Any], list[int]] = {}
    for row, label in enumerate(labels):
        try:
            missing = label is None or bool(label != label)  # nan
            found.setdefault((isinstance(label, (bool, np.bool_)), label), []).append(row)
        except (TypeError, ValueError):  # missing as pandas says it, or a list
            missing = True
        if missing:
            of = "" if table.path is None else f" of {table.path}, column '{by:.30}'"
            raise InputError(
                f"`by` is missing in {table.row(row)}{of}, or no label: {validation.show(label)}"
            )
    return {label: np.array(places) for label, places in found.items()}


_WORDS = {  # (times, parts): a time times / parts is in seconds, rounded once
    (1, 1): "s sec secs second seconds",
    (1, 10**3): "ms msec msecs millis millisec millisecs millisecond milliseconds",
    # two letters for micro in Unicode
    (1, 10**6): "us \u00b5s \u03bcs usec usecs micros microsec microsecs microsecond microseconds",
    (1, 10**9): "ns nsec nsecs nanos nanosec nanosecs nanosecond nanoseconds",
    (60, 1): "min mins minute minutes",
    (3600, 1): "h hr hrs hour hours",
    (86400, 1): "d day days",
}
SECONDS = {word: ratio for ratio, words in _WORDS.items() for word in words.split()}
_ANY = "|".join(sorted(SECONDS, key=len, reverse=True))
_LONG = "|".join(sorted((word for word in SECONDS if len(word) > 1), key=len, reverse=True))
_BRACKETS = re.compile(r".*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*")
_ENDINGS = (  # t_ms, time.us, t ms; ms, tms, timeus; TimeUS, stampMs
    re.compile(rf".*[\s_.\-/]({_ANY})", re.IGNORECASE),
    re.compile(rf"(?:t|time|stamp|timestamp)?({_LONG})|(h)", re.IGNORECASE),
    re.compile(rf".*[a-z0-9]((?=[A-Z])(?i:{_LONG}))"),
)
_EPOCH = (9.4e8, 4.2e9)  # seconds from 1970 to 1999 and to 2103
LATEST = 1e11  # seconds, the year 5138


def unit_of(title: object) -> str:
    """The unit that the name of a column of times says, or ""; it need not be one of `SECONDS`."""
    if not isinstance(title, str):
        return ""
    found = _BRACKETS.fullmatch(title)
    if found is not None:
        return found[1].lower()
    fits = (one.fullmatch(title.strip()) for one in _ENDINGS)
    return next((str(one[one.lastindex or 0]).lower() for one in fits if one is not None), "")


def in_seconds(what: str, title: object, values: Floats) -> Floats:
    """Numbers of a column of times in seconds; refused where its unit is unknown.

    Numbers without a unit, beyond `LATEST`, that are ms, us or ns since 1970 in this century are
    taken as such.
    """
    unit = unit_of(title)
    if unit and unit not in SECONDS:
        raise InputError(
            f"`time` must be in seconds or a unit of time, but {what} is in {unit[:20]!r}: name "
            "s, ms, us, ns, min, h or d"
        )
    times, parts = SECONDS[unit or "s"]
    known = values[np.isfinite(values)]
    if not unit and len(known) and known.min() > LATEST:
        (low, high), ends = _EPOCH, np.array([known.min(), known.max()])
        fits = (k for k in (10**3, 10**6, 10**9) if low < ends[0] / k and ends[1] / k < high)
        parts = next(fits, 1)
    with np.errstate(over="ignore"):
        return values if times == parts else values * times / parts


def as_text(cell: Any) -> str:
    """A date or time in ISO 8601, "" where it is missing, ? where it is something else."""
    try:
        if cell is None or cell != cell:
            return ""
    except Exception:  # whatever a foreign object raises
        return "?"
    return str(cell).replace("\n", " ") if isinstance(cell, (str, date, np.datetime64)) else "?"
