"""State files: what the package keeps between two runs, as named arrays of numbers.

A thin page over the core's `storage`, which knows the format (`docs/state-format.md`) and how to
save so that one complete generation can always be loaded. What the arrays mean is checked by
whoever loads them.
"""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .. import _core
from .._base import memory
from .._base.files import PathLike, checked_path
from .._base.gate import show
from ..exceptions import InputTypeError, StateRecoveredWarning

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Section: TypeAlias = NDArray[np.uint8] | NDArray[np.uint64] | NDArray[np.float64]


_ELEMENTS = (np.dtype(np.uint8), np.dtype(np.uint64), np.dtype(np.float64))


def save(
    path: PathLike,
    kind: str,
    sections: Mapping[str, NDArray[Any]],
    held: _core.StateLock | None = None,
) -> int:
    """Save one-dimensional uint8, uint64 or float64 arrays as the next generation at `path`.

    When this returns, they are on the disk; after any exception the generation before can be
    loaded. The arrays must not be changed by another thread meanwhile. `held` is the lock on
    `path`, if the caller has it. Returns the generation: 1 for the first, then one more each
    time. Raises `StateError` if something else than a state of this `kind` is at `path`,
    `StateLockedError` if another writer is at work, `StateIOError` for what the system refuses.
    """
    checked = checked_path("path", path)
    arrays = [(name, _section(name, array)) for name, array in sections.items()]
    memory.need("a state to be saved", sum(array.nbytes for _, array in arrays))
    return _core.storage_save(checked, kind, arrays, held)


def load(path: PathLike, kind: str) -> tuple[int, dict[str, Section]]:
    """Return the generation and the arrays of the state of this `kind` at `path`.

    Nothing is written. If the file is missing or damaged, the generation before is returned with
    a `StateRecoveredWarning`. Raises `StateError` if neither can be used, `StateNotFoundError` if
    neither exists, `StateIOError` for what the system refuses.
    """
    checked = checked_path("path", path)
    with contextlib.suppress(OSError):  # the core says what is wrong with the path
        memory.need("a state to be loaded", 2 * os.stat(checked).st_size)  # the bytes, the arrays
    generation, sections, recovered = _core.storage_load(checked, kind)
    if recovered is not None:
        warnings.warn(
            f"{recovered}: generation {generation} was loaded from the file beside it",
            StateRecoveredWarning,
            stacklevel=3,
        )
    return generation, sections


def _section(name: str, array: NDArray[Any]) -> NDArray[Any]:
    if not isinstance(array, np.ndarray) or array.dtype not in _ELEMENTS or array.ndim != 1:
        raise InputTypeError(
            f"`sections[{name!r:.20}]` must be a one-dimensional array of uint8, uint64 or "
            f"float64, got {show(array)}"
        )
    return np.ascontiguousarray(array)
