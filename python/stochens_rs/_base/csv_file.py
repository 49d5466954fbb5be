"""CSV files as columns of cells, and folders of them; messages name the file and its line."""

from __future__ import annotations

import codecs
import csv
import glob
import io
import os
import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..exceptions import InputError
from . import memory, validation
from .files import PathLike, checked_path, regular_file
from .reading import number, printable

if TYPE_CHECKING:
    from .types import Floats

# Bytes of memory for one of the file: a cell of few characters becomes an object of about 60.
_PARSED = 30
_TITLE = re.compile(r"(.*\S)\s*[\[(]\s*(?![-+]?\d)[^\[\]()]+[\])]")
_SEPARATORS = "\t;|, "
_SEP_LINE = re.compile(r'"?sep=([^\r\n])"?\s*', re.IGNORECASE)
_MISSING = ("", "na", "n/a", "null", "none")  # nan is a number
# A number in either notation, what stands for a missing one, or the start of a date or time.
_VALUE = re.compile(
    r"[-+]?((\d+[.,]?\d*|[.,]\d+)(e[-+]?\d+)?|inf|nan)|n/?a|null|none|\d+[-/.:]\d+[-/.:]\d.*",
    re.IGNORECASE,
)
_DECIMAL_COMMA = re.compile(r'(?:^|;)\s*"?[-+]?\d*,\d+(?:e[-+]?\d+)?"?\s*(?:;|$)', re.IGNORECASE)


class Text(NamedTuple):
    """How a CSV file is written; None is what the file shows."""

    sep: str | None = None
    decimal: str | None = None
    skip: int = 0

    @classmethod
    def checked(cls, sep: Any, decimal: Any, skip: Any) -> Text:
        """Check the arguments of a user."""
        if sep is not None and (not isinstance(sep, str) or len(sep) != 1 or sep in '"\r\n'):
            raise InputError(f"`sep` must be one character, as ';', got {validation.show(sep)}")
        if decimal is not None:
            validation.choice("decimal", decimal, (".", ","))
        if sep is not None and sep == decimal:
            raise InputError(f"`sep` and `decimal` must differ, got {sep!r} for both")
        return cls(sep, decimal, validation.size("skip", skip, minimum=0))


@dataclass(frozen=True, eq=False)
class Cells:
    """The columns below their names, and the line of each row."""

    path: PathLike
    names: list[str]
    columns: dict[str, tuple[str, ...]]
    lines: Sequence[int]
    decimal: str

    def numbers(self, name: str, *, whole: bool = False) -> Floats:
        """A column of numbers; nan where one is missing, unless the column must be `whole`."""
        cells = self.columns[name]
        every = "".join(cells)
        if "_" not in every and not (self.decimal == "," and "." in every) and not whole:
            try:
                if self.decimal == ",":
                    return np.array([float(cell.replace(",", ".") or "nan") for cell in cells])
                return np.array([float(cell or "nan") for cell in cells])
            except ValueError:
                pass
        found = np.full(len(cells), np.nan)
        for k, cell in enumerate(map(str.strip, cells)):
            try:
                missing = cell.lower() in _MISSING and not whole
                found[k] = np.nan if missing else self._number(cell)
            except ValueError:
                raise InputError(
                    f"{self.path} must have numbers in column '{name:.30}', got {cell[:30]!r} in "
                    f"line {self.lines[k]}{self.cure(name, cell)}"
                ) from None
        return found

    def _number(self, cell: str) -> float:
        if self.decimal == "," and "." in cell:
            raise ValueError(cell)
        return number(cell.replace(",", ".") if self.decimal == "," else cell)

    def cure(self, name: str, cell: str) -> str:
        """What to do about a cell that is no number."""
        if cell in (name, titled_as(name)):
            return (
                ", the names of the columns again: split the file there, or fill a column that "
                "tells runs apart for `by`"
            )
        if self.decimal == "," and "." in cell:
            return ", where others have a decimal comma: pass `decimal`, '.' or ','"
        if self.decimal == "." and _DECIMAL_COMMA.fullmatch(cell):
            return ": if that is a decimal comma, pass `decimal` as ','"
        return ""


def read_cells(path: PathLike, how: Text | None = None) -> Cells:
    """Read a CSV file whose first row names the columns, all with different names.

    Above it may stand a line ``sep=;``, empty lines, and comments that begin with # or %; below it
    a row of units, which become part of the names. Columns and rows without a cell at the end are
    left out.
    """
    how = Text() if how is None else how
    about = regular_file(path)
    memory.need(f"to read {path}", about.st_size * _PARSED)
    lines = io.StringIO(_decoded(path), newline="").readlines()
    sep, at, comments = _above(lines, how)
    try:
        if sep is None and at < len(lines):
            sep = _separator(lines[at], next((one for one in lines[at + 1 :] if one.strip()), ""))
        if sep == " ":  # any number of blanks is one
            lines, sep = ["\t".join(line.split()) for line in lines], "\t"
        sep = sep or ","
        names, at = _names(path, lines, at, sep, comments)
        _refuse_names(path, names)
        rows, places = _rows(path, lines, at, sep, names)
    except csv.Error as error:
        raise InputError(f"{path} must be a CSV file: {error}") from None
    if _are_units(rows):
        names = [_with_unit(*pair) for pair in zip(names, rows[0], strict=True)]
        rows, places = rows[1:], places[1:]
    _refuse_names(path, names)
    if not rows:
        raise InputError(f"{path} has no rows below the names of its columns")
    comma = sep == ";" and any("," in one and _DECIMAL_COMMA.search(one) for one in lines[at:])
    columns = dict(zip(names, zip(*rows, strict=True), strict=True))
    return Cells(path, names, columns, places, how.decimal or ("," if comma else "."))


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


def _above(lines: Sequence[str], how: Text) -> tuple[str | None, int, list[str]]:
    """What ``sep=`` says, the place of the first row, and the comments above it."""
    sep, at, comments = how.sep, how.skip, []
    found = _SEP_LINE.fullmatch(lines[0]) if lines and at == 0 else None
    if found is not None:
        sep, at = sep or found[1], 1
    while at < len(lines):
        line = lines[at].strip(' \t\r\n"')
        if line and line[0] not in "#%":
            break
        if line:
            comments.append(line.strip(" \t,;#%"))  # a spreadsheet adds commas
        at += 1
    return sep, at, comments


def _separator(names: str, below: str) -> str:
    """What divides the names and the row below into as many cells, most of them with values."""
    counts = {sep: len(_cells(names, sep)) for sep in _SEPARATORS}
    rows = {sep: _cells(below, sep) for sep in _SEPARATORS}
    fits = [sep for sep, count in counts.items() if count == len(rows[sep]) > 1]

    def values(sep: str) -> tuple[float, int]:
        share = sum(_VALUE.fullmatch(cell) is not None for cell in rows[sep]) / len(rows[sep])
        return share, counts[sep]

    return max(fits, key=values) if fits else max(",;\t|", key=counts.__getitem__)


def _cells(line: str, sep: str) -> list[str]:
    """The cells of a line, without empty ones at its end."""
    row = line.split() if sep == " " else [line]
    if sep in line and sep != " ":
        row = next(csv.reader([line], delimiter=sep), [])
    cells = [cell.strip() for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _names(
    path: PathLike, lines: Sequence[str], at: int, sep: str, comments: Sequence[str]
) -> tuple[list[str], int]:
    """The names of the columns, and the place of the row below them."""
    rows = csv.reader(lines[at:], delimiter=sep, skipinitialspace=True)
    names = [name.strip() for name in next(rows, [])]
    at += rows.line_num
    while names and not names[-1]:
        names.pop()
    values = [name for name in names if name]
    if not names:
        raise InputError(f"{path} is empty: its first row must name the columns")
    counted = values == [str(k) for k in range(len(values))]  # as pandas names columns
    if all(map(_VALUE.fullmatch, values)) and not counted:
        above = _cells(comments[-1], sep) if comments else []
        if len(above) != len(names) or any(_VALUE.fullmatch(a) or "=" in a for a in above):
            raise InputError(
                f"{path} must name its columns in the first row, got {values[0][:30]!r}: write "
                "names above it, or pass pandas.read_csv(path, header=None) to from_table, whose "
                "columns are 0, 1, ..."
            )
        names, at = above, at - rows.line_num
    return names, at


def _refuse_names(path: PathLike, names: Sequence[str]) -> None:
    """Refuse names that are no line of text, and those that are there twice."""
    odd = next((name for name in names if printable(name) != name), None)
    if odd is not None:
        raise InputError(
            f"{path} must name its columns in one line of text without control characters, "
            f"got {odd[:40]!r}"
        )
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise InputError(f"{path} has the column {twice[:40]!r} twice")


def _rows(
    path: PathLike, lines: Sequence[str], at: int, sep: str, names: Sequence[str]
) -> tuple[list[list[str]], Sequence[int]]:
    """The rows below the names, all as long as these, and the line of each."""
    rows = csv.reader(lines[at:], delimiter=sep, skipinitialspace=True)
    found, width = list(rows), len(names)
    places: Sequence[int] = range(at + 1, at + 1 + len(found))
    if rows.line_num != len(found) or any(len(row) != width for row in found):
        found, places = _uneven(path, lines, at, sep, width)
    while found and not any(map(str.strip, found[-1])):  # as a spreadsheet leaves them
        found.pop()
    marked = [k for k, row in enumerate(found) if row[0].startswith(("#", "%"))]
    if 0 < len(marked) < len(found):  # else labels that begin so
        raise _comment(path, places[marked[0]])
    return found, places[: len(found)]


def _uneven(
    path: PathLike, lines: Sequence[str], at: int, sep: str, width: int
) -> tuple[list[list[str]], list[int]]:
    """Leave out empty lines, and empty cells behind the last name."""
    found: list[list[str]] = []
    places: list[int] = []
    rows = csv.reader(lines[at:], delimiter=sep, skipinitialspace=True)
    for row in rows:
        line = at + rows.line_num
        if len(row) != width:
            if not any(map(str.strip, row)) and len(row) < width:
                continue
            if len(row) < width or any(map(str.strip, row[width:])):
                if row[0].startswith(("#", "%")):
                    raise _comment(path, line)
                raise InputError(
                    f"{path} has {len(row)} cells, not {width}, in line {line}"
                    f"{_ragged(row, width, sep, len(found) < 5)}"
                )
        found.append(row[:width])
        places.append(line)
    return found, places


def _comment(path: PathLike, line: int) -> InputError:
    return InputError(
        f"{path} has a comment among its rows, in line {line}: delete it; of a row that was lost "
        "leave the stamp, and empty cells"
    )


def _ragged(row: Sequence[str], width: int, sep: str, first: bool) -> str:
    """What to do about a row with more or fewer cells than there are names."""
    if sep == "," and len(row) == 2 * width and all(map(_VALUE.fullmatch, map(str.strip, row))):
        return ": decimal commas between commas cannot be read: save it with ; between the cells"
    if first:
        return ": if the names of its columns stand further down, pass `skip`, the lines above them"
    return ": complete the row with empty cells, or delete it if it is none"


def _are_units(rows: Sequence[Sequence[str]]) -> bool:
    """Whether the first row has text above numbers, and no number."""
    if len(rows) < 2 or any(_VALUE.fullmatch(cell.strip()) for cell in rows[0]):
        return False
    pairs = zip(rows[0], rows[1], strict=True)
    return any(unit.strip() and _VALUE.fullmatch(cell.strip()) for unit, cell in pairs)


def _with_unit(name: str, cell: str) -> str:
    unit = cell.strip(" []()")
    return f"{name} [{unit}]" if unit and titled_as(name) == name else name


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


def titled_as(title: str) -> str:
    """The name in ``angle [rad]``, ``angle[rad]`` or ``angle (rad)``; but x[0] is a name."""
    split = _TITLE.fullmatch(title)
    return title if split is None else split[1]


def titled(name: str, titles: Collection[Any]) -> str:
    """The one of `titles` that is this name with a unit behind it; else the name."""
    fits = [title for title in titles if isinstance(title, str) and titled_as(title) == name]
    return fits[0] if len(fits) == 1 and name not in titles else name


def natural(path: str) -> tuple[list[Any], str]:
    """What to sort names by so that numbers in them are compared as numbers."""
    parts = re.split("([0-9]+)", path)
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], path
