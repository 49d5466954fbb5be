"""Where results go: stdout, and a directory that is tried before anything is computed."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import click


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
