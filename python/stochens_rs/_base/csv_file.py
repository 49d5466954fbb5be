"""CSV files as rows of cells; messages name the file."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from ..exceptions import InputError
from . import memory
from .files import PathLike
from .reading import printable

# Bytes of memory for one of the file: a cell of few characters becomes an object of about 60.
_PARSED = 30


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
