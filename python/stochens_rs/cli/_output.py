"""Where results go: standard output, and the files of ``--out``."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any

import click
import numpy as np

from .._base import files
from .._base.tables import columns
from .._base.types import Figure
from .._base.validation import nearest
from ..exceptions import InputError
from ..plots import save_figures
from ..plots.style import require_matplotlib

_UNBROKEN = 10_000  # columns of an output that is no terminal


def occupy_standard_descriptors() -> None:
    """Open closed standard streams (``2>&-``), so that no later file gets their numbers."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, this one


def note(text: str) -> None:
    """Write to standard error; the command goes on if that fails."""
    with contextlib.suppress(OSError):
        click.echo(text, err=True)


def drop_unwritten() -> None:
    """Drop what cannot be written: at its end Python would try again, and exit with 120."""
    for stream in filter(None, (sys.stdout, sys.stderr)):  # None: closed from the start
        try:
            stream.flush()
        except (OSError, ValueError):
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def show(text: str) -> None:
    """Write to standard output and flush, so that a closed pipe is noticed here."""
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except BrokenPipeError:  # the reader has closed it: click ends the command
        raise
    except OSError as error:
        raise OSError(f"cannot write to standard output: {error.strerror}") from None


def show_result(facts: dict[str, Any], text: str, as_json: bool) -> None:
    """Print the result as JSON or as text, whose long lines go on below what they say."""
    if not as_json:  # as wide as the terminal; a line goes on below the text of ``certified  the``
        how: Any = {"break_long_words": False, "break_on_hyphens": False}
        how |= {"width": _room(), "subsequent_indent": " " * 11}
        show("\n".join("\n".join(wrap(line, **how)) for line in text.split("\n")))
    else:
        show(json.dumps(facts, allow_nan=False, indent=2))


class Out:
    """What ``--out`` names: a directory, checked when this is made; a `file` with an ending."""

    def __init__(
        self, given: Sequence[str], name: str, force: bool, endings: Sequence[str] = ()
    ) -> None:
        for path in given:
            ending = Path(path).suffix
            if not path.strip():
                raise click.BadParameter("the directory has no name", param_hint="--out")
            if hint := ending not in endings and nearest(ending, endings):
                raise click.BadParameter(f"{path!r} ends in {ending!r}{hint}", param_hint="--out")
        found = [path for path in given if Path(path).suffix in endings]
        folders = [path for path in given if path not in found]
        if max(len(found), len(folders)) > 1:
            raise click.UsageError("--out must be one directory, one file, or one of each")
        self.file, self._name = (found[0] if found else None), name
        self._folder = Path(folders[0]) if folders else None
        if self._folder is not None:
            require_matplotlib()
            there = next(p for p in (self._folder, *self._folder.parents) if os.path.lexists(p))
            if not there.is_dir() or not os.access(there, os.W_OK):
                raise NotADirectoryError(20, "no directory that can be written", str(there))
            taken = [
                p for k in ("json", "png", "svg") if (p := self._folder / f"{name}.{k}").exists()
            ]
            if taken and not force:
                raise InputError(
                    f"{taken[0]} exists: give another --out, or --force to replace the files"
                )

    def write(self, facts: dict[str, Any], draw: Callable[[], Figure]) -> None:
        """Write facts and the figure to the directory if there is one; name the files."""
        if self._folder is None:
            return
        self._folder.mkdir(parents=True, exist_ok=True)
        listing = self._folder / f"{self._name}.json"
        files.write_text(listing, json.dumps(facts, allow_nan=False) + "\n")
        for path in (listing, *save_figures({self._name: draw()}, self._folder)):
            note(f"written: {path}")


def finite(values: Any) -> Any:
    """Numbers for JSON, as lists: None where one is infinite or nan."""
    given = np.asarray(values, dtype=np.float64)
    return np.where(np.isfinite(given), given.astype(object), np.array(None)).tolist()


def grid(rows: list[list[str]]) -> list[str]:
    """Lines of cells in columns, as wide as the terminal: see `columns`."""
    return columns(rows, _room())


def _room() -> int:
    """Characters of a line of the terminal."""
    return shutil.get_terminal_size((_UNBROKEN, 0)).columns
