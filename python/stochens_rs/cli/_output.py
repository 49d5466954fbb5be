"""Where results go: standard output, and a directory that is checked before the computation."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from hashlib import sha256
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from .._base.columns import columns
from .._base.files import write_listed
from .._base.validation import nearest
from ..exceptions import InputError
from ..plots import save_figures
from ..plots.style import require_matplotlib

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Options that say where the results go, and are no part of what is computed.
WRITTEN = ("out", "force", "as_json", "checkpoint")
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
    lines = "\n".join(map(_broken, text.split("\n")))
    show(json.dumps(facts, allow_nan=False, indent=2) if as_json else lines)


def _broken(line: str) -> str:
    """The line as wide as the terminal; it goes on below the text of ``certified  the ...``."""
    how: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
    return "\n".join(wrap(line, _room(), subsequent_indent=" " * 11, **how))


def prepared(
    out: str, index: str, names: re.Pattern[str], options: dict[str, Any], force: bool
) -> tuple[Path, list[Path]]:
    """Make the directory and check that it can be written, before anything is computed.

    Returns it and the files of an earlier run that this one replaces; raises if other files would
    be replaced. `index` is the file that lists the others with their SHA-256, and the options of
    the run (`write_listed`); `names` matches all names the command may write.
    """
    if not out.strip():
        raise click.BadParameter("the directory has no name", param_hint="--out")
    directory = Path(out)
    new = [path for path in (directory, *directory.parents) if not path.exists()]
    directory.mkdir(parents=True, exist_ok=True)
    if context := click.get_current_context(silent=True):
        context.call_on_close(partial(_remove_empty, new))
    with tempfile.TemporaryFile(dir=directory):
        pass
    return directory, _replaceable(directory, index, names, options, force)


class Out:
    """What ``--out`` names: a directory, checked when this is made; a `file` with an ending."""

    def __init__(self, context: click.Context, endings: Sequence[str] = ()) -> None:
        given = context.params["out"] or ()
        files: list[str] = []
        directories: list[str] = []
        for path in (given,) if isinstance(given, str) else given:
            ending = Path(path).suffix
            if hint := ending not in endings and nearest(ending, endings):
                raise click.BadParameter(f"{path!r} ends in {ending!r}{hint}", param_hint="--out")
            (files if ending in endings else directories).append(path)
        if max(len(files), len(directories)) > 1:
            raise click.UsageError("--out must be one directory, one file, or one of each")
        self.file = files[0] if files else None
        self._at: Path | None = None
        if directories:
            require_matplotlib()
            name = self._name = str(context.command.name)
            self._options = {
                key: list(value) if isinstance(value, tuple) else value  # as JSON has them
                for key, value in context.params.items()
                if key not in WRITTEN
            }
            names, force = re.compile(rf"{name}\.(json|png|svg)"), context.params["force"]
            self._at, self._earlier = prepared(
                directories[0], f"{name}.json", names, self._options, force
            )

    def write(self, facts: dict[str, Any], draw: Callable[[], Figure]) -> None:
        """Write facts with the options, and the figure, to the directory if there is one.

        Names the files on standard error.
        """
        if self._at is None:
            return
        for path in self._earlier:
            path.unlink(missing_ok=True)
        with tempfile.TemporaryDirectory(dir=self._at) as made:
            figures = save_figures({self._name: draw()}, made)
            facts = {**facts, "options": self._options}
            for path in write_listed(self._at, f"{self._name}.json", facts, figures):
                note(f"written: {path}")


def finite(values: Any) -> Any:
    """Numbers for JSON, as lists: None where one is infinite or nan."""
    given = np.asarray(values, dtype=np.float64)
    return np.where(np.isfinite(given), given.astype(object), np.array(None)).tolist()


def grid(rows: list[list[str]], keys: int = 1) -> list[str]:
    """Lines of cells in columns, as wide as the terminal: see `columns`."""
    return columns(rows, _room(), keys)


def _room() -> int:
    """Characters of a line of the terminal."""
    return shutil.get_terminal_size((_UNBROKEN, 0)).columns


def _remove_empty(made: list[Path]) -> None:
    """Remove directories, the innermost first, if nothing was written to them."""
    with contextlib.suppress(OSError):
        for path in made:
            path.rmdir()


def _replaceable(
    directory: Path, index: str, names: re.Pattern[str], options: dict[str, Any], force: bool
) -> list[Path]:
    there = {path.name for path in directory.glob("*") if names.fullmatch(path.name)}
    if not there:
        return []
    try:
        found = json.loads((directory / index).read_bytes())
        listed, before = dict(found["files"]), dict(found["options"])
    except (OSError, ValueError, TypeError, KeyError):  # no index, or not of this command
        listed, before = {}, {}
    for name in sorted(there):
        path = directory / name
        if name not in listed:
            what = "was not written by this command"
        elif name != index and sha256(path.read_bytes()).hexdigest() != listed[name]:
            what = "was changed since this command wrote it"
        else:
            continue
        raise InputError(f"{path} {what}: move it away, or give another --out")
    if before != options:
        other = ", ".join(f"{k}={v}" for k, v in before.items() if v != options.get(k))
        if not force:
            raise InputError(
                f"{directory} has the results of a run with {other}: give another --out, or "
                "--force to replace them"
            )
    else:
        other = "the same options"
    note(f"replacing the results of a run with {other} in {directory}")
    # without the index, which is overwritten at the end: it lists the files of this command
    return [directory / name for name in there - {index}]
