"""CSV files as rows of cells, and folders of them; messages name the file."""

from __future__ import annotations

import csv
import glob
import os
import re
from collections import Counter
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

from ..exceptions import InputError
from . import memory, validation
from .files import PathLike, checked_path
from .reading import printable

# Bytes of memory for one of the file: a cell of few characters becomes an object of about 60.
_PARSED = 30
_WITH_UNIT = re.compile(r"(.*\S)\s+\[([^\[\]]*)\]")


class Cells(NamedTuple):
    """The names of the columns, the rows below them, and the comments above, all stripped."""

    names: list[str]
    rows: list[list[str]]
    comments: list[str]


def read_cells(path: PathLike, *, comments: bool = False) -> Cells:
    """Read a CSV file whose first row names the columns, all with different names.

    With `comments`, lines above that row may begin with #.
    """
    memory.need(f"to read {path}", Path(path).stat().st_size * _PARSED)
    said: list[str] = []
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            rows = csv.reader(file)
            head = next(rows, [])
            while comments and head and head[0].lstrip().startswith("#"):
                said.append(",".join(head).strip(" \t,#"))  # a spreadsheet adds commas
                head = next(rows, [])
            names = [name.strip() for name in head]
            twice = next((name for name, count in Counter(names).items() if count > 1), None)
            odd = next((name for name in names if printable(name) != name), None)
            other = next((c for c in ";\t|" if len(names) == 1 and c in names[0]), None)
            if other is not None:
                raise InputError(
                    f"{path} must have commas between its cells, got {other!r} in its first row: "
                    "save it with commas, and with points in the numbers"
                )
            if not names:
                raise InputError(f"{path} is empty: its first row must name the columns")
            if odd is not None:
                raise InputError(
                    f"{path} must name its columns in one line of text without control characters, "
                    f"got {odd[:40]!r}"
                )
            if twice is not None:
                raise InputError(f"{path} has the column {twice[:40]!r} twice")
            found: list[list[str]] = []
            for row in rows:
                if not row:
                    continue
                if len(row) != len(names):
                    raise InputError(
                        f"{path} has {len(row)} cells, not {len(names)}, in line {rows.line_num}"
                    )
                found.append([cell.strip() for cell in row])
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} must be a CSV file in UTF-8: {error}") from None
    if not found:
        raise InputError(f"{path} has no rows below the names of its columns")
    return Cells(names, found, said)


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
        found = [one.path for one in os.scandir(text) if one.name.lower().endswith(".csv")]
        wanted = f"no .csv file in the folder {text}"
    elif glob.has_magic(text) and not os.path.exists(text):
        found, wanted = glob.glob(text), f"no file fits {text}"
    else:
        return [text]
    if not found:
        raise FileNotFoundError(wanted)
    return sorted(found, key=natural)


def name_and_unit(title: str) -> tuple[str, str]:
    """``delta_1 [rad]``: the name, and the unit or ""."""
    split = _WITH_UNIT.fullmatch(title)
    return (title, "") if split is None else (split[1], split[2])


def titled(name: str, titles: Collection[str]) -> str:
    """The one of `titles` that is this name with a unit behind it; else the name."""
    fits = [title for title in titles if name_and_unit(title)[0] == name]
    return fits[0] if len(fits) == 1 and name not in titles else name


def natural(path: str) -> tuple[list[Any], str]:
    """What to sort names by so that numbers in them are compared as numbers."""
    parts = re.split("([0-9]+)", path)
    return [int(part) if k % 2 else part for k, part in enumerate(parts)], path
