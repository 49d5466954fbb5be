"""Singleton realizations written out as dense arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import memory
from .._base.types import Axis, Floats
from .lines import stack_from_lines

if TYPE_CHECKING:
    from collections.abc import Iterator


_BLOCK = 2**20  # entries written at a time, 8 MiB; between two blocks Ctrl-C is handled


def dense_blocks(
    draws: _core.Draws, shape: tuple[int, ...], axis: Axis, rows: int
) -> Iterator[Floats]:
    """Yield `rows` realizations at a time, each block of shape (rows, *shape)."""
    for first in range(0, draws.size, rows):
        index = draws.indices()[first : first + rows].astype(np.intp)
        atoms = draws.atoms()
        out = np.zeros((len(index), *atoms.shape))
        s, j = np.arange(len(index))[:, None], np.arange(len(atoms))[None, :]
        out[s, j, index] = atoms[j, index]
        yield stack_from_lines(out.reshape(len(index), -1), shape, axis)


def dense(draws: _core.Draws, shape: tuple[int, ...], axis: Axis) -> Floats:
    """Return all realizations, shape (N, *shape)."""
    entries = int(np.prod(shape))
    rows = max(1, _BLOCK // entries)
    # the result, and four arrays of the size of a block
    largest = min(rows, draws.size) * entries
    memory.need("the dense realizations", (draws.size * entries + 4 * largest) * 8)
    out = np.empty((draws.size, *shape))
    first = 0
    for block in dense_blocks(draws, shape, axis, rows):
        out[first : first + len(block)] = block
        first += len(block)
    return out
