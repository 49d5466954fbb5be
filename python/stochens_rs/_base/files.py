"""Paths, files that are replaced in one piece, and the versions that are written into them."""

from __future__ import annotations

import os
import platform
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from typing import TypeAlias

import numpy as np

from ..exceptions import InputError, InputTypeError
from .validation import show

PathLike: TypeAlias = "str | os.PathLike[str]"
_KINDS = {
    stat.S_IFDIR: "directory",
    stat.S_IFIFO: "pipe",
    stat.S_IFCHR: "device",
    stat.S_IFBLK: "device",
    stat.S_IFSOCK: "socket",
}


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


def regular_file(path: PathLike) -> os.stat_result:
    """Refuse what is no regular file: a device or a pipe may block or never end."""
    about = os.stat(path)
    if not stat.S_ISREG(about.st_mode):
        kind = _KINDS.get(stat.S_IFMT(about.st_mode), "special file")
        cure = ": save it to a file first" if kind == "pipe" else ""
        raise InputError(f"{path} must be a regular file, got a {kind}{cure}")
    return about


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


@contextmanager
def replaced(path: PathLike) -> Iterator[str]:
    """Give the name of a new, empty file beside `path` that takes its place in one piece.

    Its name is drawn, and whatever already has that name is never opened. It is on the disk when
    this ends; after an exception nothing is left of it.
    """
    whole = os.path.abspath(path)
    part = f"{whole}.{secrets.token_hex(8)}.tmp"
    how = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    os.close(os.open(part, how, 0o666))
    try:
        with suppress(FileNotFoundError):
            os.chmod(part, os.stat(whole).st_mode & 0o777)
        yield part
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(part, whole)
    except BaseException:
        with suppress(OSError):
            os.remove(part)
        raise
    if os.name == "posix":  # where folders can be synced, the new name survives a power failure
        folder = os.open(os.path.dirname(whole), os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def write_text(path: PathLike, text: str) -> None:
    """Write a file so that a reader sees either the old or the whole new one."""
    with replaced(path) as part, open(part, "w", encoding="utf-8") as file:
        file.write(text)
