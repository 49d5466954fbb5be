"""Weights of states and inputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..exceptions import InputError, InputTypeError
from . import validation
from .align_labels import aligned_weight
from .types import Floats


def weight(
    name: str, value: Any, n: int, *, auto: bool = False, labels: Sequence[str] | None = None
) -> Floats:
    """A weight as a matrix: from a number, a diagonal (n,) or a matrix (n, n).

    A table whose labels are `labels`, the names of its entries, is brought into their order.
    """
    if isinstance(value, str):
        other, found = '"auto", ' if auto else "", validation.show(value)
        raise InputTypeError(f"`{name}` must be {other}a number, ({n},) or ({n}, {n}), got {found}")
    value = value if labels is None else aligned_weight(name, value, labels)
    given = validation.read(name, value)
    if given.ndim == 0:
        return validation.nonnegative(name, value) * np.eye(n)
    if given.ndim == 1:
        entries = validation.vector(name, value, length=n)
        if (entries < 0.0).any():
            raise InputError(f"`{name}` must have entries >= 0, got {entries.min():.3g}")
        return np.diag(entries)
    full = validation.matrix(name, value, rows=n, cols=n)
    largest = float(np.abs(full).max())
    if np.abs(full / 2.0 - full.T / 2.0).max() > 5e-10 * largest:
        raise InputError(f"`{name}` must be symmetric")
    half = full / 2.0 + full.T / 2.0
    least = float(np.linalg.eigvalsh(half)[0])
    if least < -n * float(np.finfo(np.float64).eps) * largest:
        raise InputError(
            f"`{name}` must be positive semidefinite, its least eigenvalue is {least:.3g}"
        )
    return half
