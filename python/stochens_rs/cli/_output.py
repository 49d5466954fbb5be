"""Where results go: standard output, and a directory that is checked before the computation."""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from .._base.files import write_listed
from ..exceptions import InputError
from ..plots import save_figures
from ..plots.style import require_matplotlib

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Options that say where the results go, and are no part of what is computed.
WRITTEN = ("out", "force", "as_json", "save")


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
    """Print the result as JSON or as text."""
    show(json.dumps(facts, allow_nan=False, indent=2) if as_json else text)


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


class Folder:
    """The directory of ``--out``: checked when it is made, written to when there are results."""

    def __init__(self, out: str, name: str, options: dict[str, Any], force: bool) -> None:
        require_matplotlib()
        self._name, self._options = name, options
        names = re.compile(rf"{name}\.(json|png|svg)")
        self._at, self._earlier = prepared(out, f"{name}.json", names, options, force)

    def write(self, facts: dict[str, Any], draw: Callable[[], Figure]) -> None:
        """Write the facts with the options, and the figure; name the files on standard error."""
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


def grid(rows: list[list[str]]) -> list[str]:
    """Lines of cells in columns: the first left-aligned, the others right-aligned."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            [row[0].ljust(widths[0])]
            + [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        ).rstrip()
        for row in rows
    ]


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
