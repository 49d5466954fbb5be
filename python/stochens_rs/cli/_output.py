"""Where results go: stdout, and a directory that is tried before anything is computed."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from pathlib import Path

import click


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
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def writable(out: str) -> Path:
    """Make the directory and try it before anything is computed."""
    if not out.strip():
        raise click.BadParameter("the directory has no name", param_hint="--out")
    directory = Path(out)
    directory.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=directory):
        return directory
