"""Realizations as indices, one per line of the target, and sums over them.

A *line* is a vector, or a column (``axis="columns"``) or row (``axis="rows"``) of a matrix. Line j
has the 1-norm g_j; a realization picks the index R_j with probability abs(A[R_j, j]) / g_j and has
there the value g_j * sign(A[R_j, j]), elsewhere 0. A line of zeros gets index 0, and its atoms are
0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .streams import (
    SYSTEMATIC_OFFSET,
    SYSTEMATIC_PERMUTATION,
    alias_table,
    chacha8_words,
    draw,
    iid_words,
    shuffle,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def to_lines(target: ArrayLike, axis: str = "columns") -> Array:
    """The target as (length, lines): a vector is one column, rows are transposed."""
    A = np.asarray(target, dtype=np.float64)
    if A.ndim == 1:
        return A[:, None]
    return A if axis == "columns" else A.T


def from_lines(values: NDArray[Any], ndim: int, axis: str = "columns") -> NDArray[Any]:
    """The inverse of `to_lines` for a target with `ndim` dimensions."""
    if ndim == 1:
        return values[:, 0]
    return values if axis == "columns" else values.T


def atoms(target: ArrayLike, axis: str = "columns") -> Array:
    """g_j * sign(A[i, j]) in the target's shape: the value of a realization at a chosen index."""
    lines = to_lines(target, axis)
    g = np.abs(lines).sum(axis=0)
    return from_lines(g * np.sign(lines), np.ndim(target), axis)


def systematic_counts(weights: ArrayLike, size: int, offset: float) -> Indices:
    """How often each index occurs among `size` systematic draws with one offset U in [0, 1).

    With c_i = N * (C_i / C_last), C_i the running sum of abs(w):
    N_i = ceil(c_i - U) - ceil(c_{i-1} - U), where the first subtrahend is 0 and ceil(N - U) = N.
    """
    cum = np.cumsum(np.abs(np.asarray(weights, dtype=np.float64)))
    if cum[-1] == 0.0:
        return np.zeros(len(cum), dtype=np.int64)
    upper = np.ceil(size * (cum / cum[-1]) - offset)
    upper[cum == cum[-1]] = size  # exactly, without the rounding of size - offset
    N_i: Indices = np.diff(upper, prepend=0.0).astype(np.int64)
    return N_i


def _line_indices(weights: Array, size: int, key: bytes, line: int, scheme: str) -> Indices:
    """The indices of one line, (size,)."""
    if not np.any(weights):
        return np.zeros(size, dtype=np.int64)
    if scheme == "iid":
        return draw(alias_table(weights), iid_words(key, line, size))
    word = int(chacha8_words(key, SYSTEMATIC_OFFSET, line, 0, 1)[0])
    offset = (word >> 11) * 2.0**-53
    ordered = np.repeat(np.arange(len(weights)), systematic_counts(weights, size, offset))
    return shuffle(ordered, chacha8_words(key, SYSTEMATIC_PERMUTATION, line, 0, size - 1))


def sample_indices(
    target: ArrayLike, size: int, *, key: bytes, scheme: str = "iid", axis: str = "columns"
) -> Indices:
    """`size` realizations of the target: (size, lines) indices; deterministic."""
    lines = to_lines(target, axis)
    columns = [_line_indices(w, size, key, j, scheme) for j, w in enumerate(lines.T)]
    return np.stack(columns, axis=1)


def _as_table(indices: ArrayLike) -> Indices:
    """Indices as (N, lines); a flat list of indices is one line."""
    R = np.asarray(indices, dtype=np.int64)
    return R[:, None] if R.ndim == 1 else R


def dense(indices: ArrayLike, atoms: ArrayLike, axis: str = "columns") -> Array:
    """The realizations, (N, n) or (N, n, m): sample s has the atoms at R[s] and is 0 elsewhere."""
    R, values = _as_table(indices), np.asarray(atoms, dtype=np.float64)
    lines = to_lines(values, axis)
    out = np.zeros((len(R), *lines.shape))
    s, j = np.arange(len(R))[:, None], np.arange(lines.shape[1])[None, :]
    out[s, R, j] = lines[R, j]
    if values.ndim == 1:
        return out[:, :, 0]
    return out if axis == "columns" else out.transpose(0, 2, 1)


def counts(indices: ArrayLike, target: ArrayLike, axis: str = "columns") -> Indices:
    """How often each entry is hit, in the target's shape: N in total per line, 0 in a zero line."""
    R, lines = _as_table(indices), to_lines(target, axis)
    table = np.stack([np.bincount(r, minlength=len(lines)) for r in R.T], axis=1)
    return from_lines(table * np.any(lines != 0, axis=0), np.ndim(target), axis)


def combine(
    indices: ArrayLike, atoms: ArrayLike, weights: ArrayLike, axis: str = "columns"
) -> Array:
    """sum_s y_s E_s without forming any E_s: entry = atom * (sum of y_s over {s: R[s, j] = i})."""
    R, y = _as_table(indices), np.asarray(weights, dtype=np.float64)
    lines = to_lines(atoms, axis)
    Y = np.stack([np.bincount(r, weights=y, minlength=len(lines)) for r in R.T], axis=1)
    return from_lines(lines * Y, np.ndim(atoms), axis)
