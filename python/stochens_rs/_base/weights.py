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
    name: str,
    value: Any,
    n: int,
    *,
    auto: bool = False,
    positive: bool = False,
    matrix: bool = False,
    labels: Sequence[str] | None = None,
) -> Floats:
    """A weight as a matrix: from a number, a diagonal (n,) or a matrix (n, n).

    A table whose labels are `labels`, the names of its entries, is brought into their order;
    `positive` asks for a positive definite one, `matrix` for one that is given as such.
    """
    if isinstance(value, str):
        other, found = '"auto", ' if auto else "", validation.show(value)
        raise InputTypeError(f"`{name}` must be {other}a number, ({n},) or ({n}, {n}), got {found}")
    value = value if labels is None else aligned_weight(name, value, labels)
    given = validation.read(name, value)
    kind = "definite" if positive else "semidefinite"
    if given.ndim == 0 and not matrix:
        if positive and validation.is_real(value) and value <= 0.0:
            raise InputError(f"`{name}` must be positive definite, got {validation.show(value)}")
        return validation.nonnegative(name, value) * np.eye(n)
    if given.ndim == 1 and not matrix:
        entries = validation.vector(name, value, length=n)
        least = float(entries.min(initial=1.0))
        if least < 0.0 or (positive and least == 0.0):
            rule = "be positive definite" if positive else "have entries >= 0"
            raise InputError(f"`{name}` must {rule}, got the entry {least:.3g}")
        return np.diag(entries)
    full = validation.matrix(name, value, rows=n, cols=n)
    # in units in which the diagonal is 1: what rounding is does not depend on those of the entries
    diagonal = np.abs(np.diag(full))
    size = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    unit = full / size[:, None] / size
    apart = np.abs(unit - unit.T)
    i, j = np.unravel_index(apart.argmax(), apart.shape) if n else (0, 0)
    if n and apart[i, j] > 5e-10:
        found = f"[{i}, {j}] = {full[i, j]:.6g} and [{j}, {i}] = {full[j, i]:.6g}"
        raise InputError(f"`{name}` must be symmetric, got {found}")
    half = full / 2.0 + full.T / 2.0
    least = float(np.linalg.eigvalsh(unit / 2.0 + unit.T / 2.0)[0])
    room = n * float(np.finfo(np.float64).eps) * float(np.abs(unit).max())
    if least <= room if positive else least < -room:
        least = min(least, float(np.linalg.eigvalsh(half)[0]))
        raise InputError(f"`{name}` must be positive {kind}, its least eigenvalue is {least:.3g}")
    return half
