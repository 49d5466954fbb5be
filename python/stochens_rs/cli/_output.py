"""Where results go: standard output, and a directory that is checked before the computation."""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import tempfile
from hashlib import sha256
from pathlib import Path
from typing import Any

import click

from ..exceptions import InputError

INTERRUPTED = 130  # exit code after Ctrl-C: 128 + SIGINT


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
    directory.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=directory):
        pass
    return directory, _replaceable(directory, index, names, options, force)


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
