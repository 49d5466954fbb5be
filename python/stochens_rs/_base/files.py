"""Paths, files that are replaced in one piece, and the versions that are written into them."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ..exceptions import InputError, InputTypeError
from .validation import show

PathLike: TypeAlias = "str | os.PathLike[str]"


def checked_path(name: str, value: object) -> str:
    """Return a path as text that the system can take."""
    if not isinstance(value, (str, os.PathLike)):
        raise InputTypeError(f"`{name}` must be a path, got {show(value)}")
    try:
        text = os.fspath(value)
    except Exception as error:  # whatever a foreign path raises
        raise InputTypeError(f"`{name}` must be a path, got {show(value)}") from error
    if not isinstance(text, str):
        raise InputTypeError(f"`{name}` must be a path of type str, got {show(text)}")
    try:
        usable = os.path.basename(text) != "" and b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        usable = False
    if not usable:
        raise InputError(f"`{name}` must be the name of a file, got {show(text)}")
    return text


def versions() -> dict[str, str]:
    """Versions of the package, Python, NumPy and the platform, as strings."""
    try:
        package = metadata.version("stochens_rs")
    except metadata.PackageNotFoundError:  # run from a source tree that was never installed
        package = "not installed"
    return {
        "stochens_rs": package,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": f"{platform.system()} {platform.machine()}",
    }


def write_text(path: Path, text: str) -> None:
    """Write a file so that a reader sees either the old or the whole new one."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def write_listed(
    directory: Path, index: str, facts: dict[str, Any], made: list[Path]
) -> list[Path]:
    """Write an index with the SHA-256 of each file made elsewhere, then move these beside it."""
    digests = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in made}
    listed = {**facts, "files": {index: None, **digests}}
    write_text(directory / index, json.dumps(listed, allow_nan=False) + "\n")
    return [directory / index, *(path.replace(directory / path.name) for path in made)]
