"""State files: named arrays, in the format of `docs/state-format.md`.

The core writes and reads them. The classes that load the arrays check what they mean.
"""

from __future__ import annotations

import contextlib
import os
import warnings
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .. import _core
from ..exceptions import InputError, InputTypeError, StateRecoveredWarning
from . import memory
from .files import PathLike, checked_path
from .types import Floats
from .validation import show

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Section: TypeAlias = NDArray[np.uint8] | NDArray[np.uint64] | Floats


# Endings of tables, text and figures, which a state file is not.
_FOREIGN = (".csv", ".json", ".nc", ".parquet", ".pdf", ".png", ".tex", ".txt", ".xlsx")
_ELEMENTS = (np.dtype(np.uint8), np.dtype(np.uint64), np.dtype(np.float64))


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
    arrays = [(name, _section(name, array)) for name, array in sections.items()]
    memory.need("a state to be saved", sum(array.nbytes for _, array in arrays))
    return _core.storage_save(checked, kind, arrays, held)


def load(path: PathLike, kind: str) -> tuple[int, dict[str, Section]]:
    """Return the generation and the arrays of the state of this `kind` at `path`.

    Nothing is written. If the file is missing or damaged, the previous generation is returned with
    a `StateRecoveredWarning`. Raises `StateError` if neither can be used, `StateNotFoundError` if
    neither exists, `StateIOError` if reading fails.
    """
    checked = checked_path("path", path)
    with contextlib.suppress(OSError):  # the core reports a bad path
        memory.need("a state to be loaded", 2 * os.stat(checked).st_size)  # file and arrays
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
    arrays = [(name, _section(name, array)) for name, array in sections.items()]
    memory.need("a state to be saved", sum(array.nbytes for _, array in arrays))
    return _core.storage_encode(kind, generation, arrays)


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


def _section(name: str, array: NDArray[Any]) -> NDArray[Any]:
    if not isinstance(array, np.ndarray) or array.dtype not in _ELEMENTS or array.ndim != 1:
        raise InputTypeError(
            f"`sections[{name!r:.20}]` must be a one-dimensional array of uint8, uint64 or "
            f"float64, got {show(array)}"
        )
    return np.ascontiguousarray(array)
