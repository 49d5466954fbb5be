"""Paths, files that are replaced in one piece, versions, and state files.

The format of state files is that of `docs/systems.md`.
"""

from __future__ import annotations

import os
import platform
import secrets
import stat
import warnings
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np

from .. import _core
from ..exceptions import InputError, InputTypeError, StateError, StateRecoveredWarning
from . import running
from .types import Floats, NDArray, Self
from .validation import show

PathLike: TypeAlias = "str | os.PathLike[str]"
_KINDS = {"d": "directory", "p": "pipe", "c": "device", "b": "device", "s": "socket"}


def checked_path(name: str, value: object) -> str:
    """Return a path as text that the system can take."""
    try:
        text = os.fspath(value)  # type: ignore[call-overload]
    except Exception as error:  # whatever a foreign path raises
        raise InputTypeError(f"`{name}` must be a path, got {show(value)}") from error
    if not isinstance(text, str):
        raise InputTypeError(f"`{name}` must be a path of type str, got {show(text)}")
    with suppress(UnicodeEncodeError):
        if os.path.basename(text) != "" and b"\0" not in os.fsencode(text):
            return text
    raise InputError(f"`{name}` must be the name of a file, got {show(text)}")


def regular_file(path: PathLike) -> os.stat_result:
    """Refuse what is no regular file: a device or a pipe may block or never end."""
    about = os.stat(path)
    if not stat.S_ISREG(about.st_mode):
        kind = _KINDS.get(stat.filemode(about.st_mode)[0], "special file")
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


Section: TypeAlias = NDArray[np.uint8] | NDArray[np.uint64] | Floats
# Endings of tables, text and figures, which a state file is not.
_FOREIGN = (".csv", ".json", ".nc", ".parquet", ".pdf", ".png", ".tex", ".txt", ".xlsx")


def is_state(path: PathLike) -> bool:
    """Whether a file begins as one that `save` wrote: the length of a JSON header, and its "{"."""
    found = Path(checked_path("path", path))
    if not found.is_file():  # a pipe may block
        return False
    with found.open("rb") as file:
        begin = file.read(9)
    length = int.from_bytes(begin[:8], "little")
    return begin[8:] == b"{" and length + 8 <= found.stat().st_size


def save(
    path: PathLike,
    kind: str,
    sections: Mapping[str, NDArray[Any]],
    held: _core.StateLock | None = None,
) -> int:
    """Save one-dimensional uint8, uint64 or float64 arrays as the next generation at `path`.

    They are on the disk when this returns; after an exception, the previous generation can be
    loaded. No other thread may change the arrays meanwhile. `held` is the lock on `path`, if the
    caller has it. Returns the generation, from 1. Raises `StateError` if the file at `path` is not
    a state of this `kind`, `StateLockedError` if it is being written, `StateIOError` if writing
    fails.
    """
    checked = checked_path("path", path)
    if checked.lower().endswith(_FOREIGN):
        raise InputError(
            f"`path` must not end in {Path(checked).suffix}: `save` writes a file for `load`; "
            "`to_pandas`, `to_xarray` and `to_dict` give tables and plain data"
        )
    return _core.storage_save(checked, kind, _arrays(sections), held)


def load(path: PathLike, kind: str) -> tuple[int, dict[str, Section]]:
    """Return the generation and the arrays of the state of this `kind` at `path`.

    Nothing is written. If the file is missing or damaged, the previous generation is returned with
    a `StateRecoveredWarning`. Raises `StateError` if neither can be used, `StateNotFoundError` if
    neither exists, `StateIOError` if reading fails.
    """
    checked = checked_path("path", path)
    with suppress(OSError):  # the core reports a bad path
        running.need("a state to be loaded", 2 * os.stat(checked).st_size)  # file and arrays
    generation, sections, recovered = _core.storage_load(checked, kind)
    if recovered is not None:
        warnings.warn(
            f"{recovered}: generation {generation} was loaded instead",
            StateRecoveredWarning,
            stacklevel=3,
        )
    return generation, sections


def encode(kind: str, generation: int, sections: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the bytes of a state file with these arrays (see `save`)."""
    return _core.storage_encode(kind, generation, _arrays(sections))


def decode(source: str, content: bytes, kind: str) -> tuple[int, dict[str, Section]]:
    """Return the generation and the arrays in the bytes of a state file (see `load`)."""
    return _core.storage_decode(source, content, kind)


_held: weakref.WeakSet[_core.StateLock] = weakref.WeakSet()


def lock(path: str) -> _core.StateLock:
    """Lock a path for writing, until `release`; raises `StateLockedError` if it is locked."""
    made = _core.StateLock(path)
    _held.add(made)
    return made


def _let_go() -> None:
    """Release the locks in a forked child: its copies would outlive those of the parent."""
    for one in list(_held):
        one.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)


def _arrays(sections: Mapping[str, NDArray[Any]]) -> list[tuple[str, NDArray[Any]]]:
    """The arrays as the core takes them."""
    running.need("a state to be saved", sum(array.nbytes for array in sections.values()))
    return [(name, np.ascontiguousarray(array)) for name, array in sections.items()]


class Durable:
    """Base of the classes that can be saved as named arrays and loaded again."""

    __slots__ = ()

    _kind: ClassVar[str]

    def _to_sections(self) -> dict[str, Any]:
        raise NotImplementedError

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Self:
        raise NotImplementedError

    def save(self, path: PathLike) -> int:
        """Save to a file.

        Parameters
        ----------
        path : path
            The file; the previous state is kept as ``<path>.prev``.

        Returns
        -------
        int
            The generation: 1 for the first state at this path, then one more each time. The state
            is on the disk when this returns.

        Raises
        ------
        StateError
            If the file at `path` is something else than an earlier state of this kind.
        StateLockedError
            If another thread or process is saving there, or a run has it as its checkpoint.
        StateIOError
            If writing fails, for example for lack of space or permission. The previous states are
            not changed.
        InputError, InputTypeError
            If `path` is not a path.

        Notes
        -----
        The format is safetensors, with a version and a SHA-256 digest; loading executes nothing
        (``docs/systems.md``). The file is written under another name, synced and renamed, and
        the directory is synced: a complete state is on the disk at any time.

        Examples
        --------
        >>> import tempfile, pathlib, stochens_rs as se
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "a.state"
        >>> stream = se.Stream(([[2.0]], [[1.0]]), [1.0], [0.0], rng=1)
        >>> stream.step(1000)
        >>> stream.save(path)
        1
        >>> se.Stream.load(path).steps
        1000
        """
        return save(path, self._kind, self._to_sections())

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Load what was saved.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        Self
            With the same bits in every field; a stream continues exactly as it.

        Raises
        ------
        StateError
            If neither the file nor the previous generation can be used: damaged, of another kind,
            of a newer version, or with contents that cannot be.
        StateNotFoundError
            If neither exists.
        StateIOError
            If reading fails.
        InputError, InputTypeError
            If `path` is not a path.

        Warns
        -----
        StateRecoveredWarning
            If the file is missing or damaged and the previous generation was loaded.

        Notes
        -----
        Nothing is written. Checked are the sizes (before memory is allocated), the digest, and the
        numbers: finite; of a stream, estimates in the hull of the realizations; of a model, the
        triangle that of the data, and all that `identify` checks; of other results, the types of
        their fields and all that their constructors check.

        Examples
        --------
        See `save`.
        """
        _, sections = load(path, cls._kind)
        try:
            return cls._from_sections(sections)
        except KeyError as error:
            raise StateError(f"{os.fspath(path)} must have an array {error}, got none") from error
        except (InputError, InputTypeError) as error:
            raise StateError(f"{os.fspath(path)}: {error}") from error
