"""Where results go: stdout, and a directory that is tried before anything is computed."""

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


def occupy_standard_descriptors() -> None:
    """Open what was closed (``2>&-``), or the next file would be the standard error output."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, this one


def note(text: str) -> None:
    """To stderr; that nobody can read it is no failure of the command."""
    with contextlib.suppress(OSError):
        click.echo(text, err=True)


def show(text: str) -> None:
    """To stdout, at once, so that a reader who has gone is noticed here."""
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except BrokenPipeError:  # who read it has gone: click ends the command
        raise
    except OSError as error:
        raise OSError(f"cannot write to standard output: {error.strerror}") from None


def prepared(
    out: str, index: str, names: re.Pattern[str], options: dict[str, Any], force: bool
) -> tuple[Path, list[Path]]:
    """Make the directory and try it before anything is computed.

    Also returns the files of an earlier run that this one replaces; refuses to replace any others.
    The index lists each file with its SHA-256, and the options of the run (`write_listed`).
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
    except (OSError, ValueError, TypeError, KeyError):  # none, or not ours
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
    # the index goes last, by being written anew: it says whose the others are
    return [directory / name for name in there - {index}]
