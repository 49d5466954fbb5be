"""Systematic samples: one random offset per line instead of independent draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..._base import memory, validation
from ..._base.types import AXES, Axis, Floats
from ..formulas import (
    Size,
    checked_finite,
    count,
    fractional_parts,
    lines_of,
    systematic_vector_covariance,
    whole_numbers,
)


def systematic_mse(target: ArrayLike, size: Size = 1, *, axis: Axis = "columns") -> float:
    """Mean squared error of the average of ``size`` systematic samples.

    Parameters
    ----------
    target : (n,) or (n, m) array_like
        The vector, or the matrix whose lines are sampled with one offset each.
    size : int or None, default 1
        Number of samples; None or inf: known exactly.
    axis : {"columns", "rows"}, default "columns"
        Which lines of a matrix are sampled; no effect for a vector.

    Returns
    -------
    float
        ``sum_j (g_j / size)^2 sum_i f_ij (1 - f_ij)`` with ``f_ij = frac(size |a_ij| / g_j)``, the
        square of the 2-norm (vector) or Frobenius norm (matrix). At most ``n g^2 / (4 size^2)``
        per line, and 0 where every ``size |a_ij| / g_j`` is an integer.

    Raises
    ------
    InputError, InputTypeError
        `target` is not a finite vector or matrix, `size` is not a count, `axis` is unknown, or the
        error overflows.

    Notes
    -----
    With one ``U`` per line, uniform on [0, 1), and ``c_i = size (p_1 + ... + p_i)``, entry i is hit
    ``N_i = ceil(c_i - U) - ceil(c_{i-1} - U)`` times: ``floor`` or ``ceil`` of ``size p_i``, the
    latter with probability ``f_i``. The error falls like ``1 / size^2``, that of independent draws
    (:func:`vector_mse`) like ``1 / size``. The fractional parts are computed in integers, hence 0
    exactly where they are 0.

    References
    ----------
    W. G. Madow and L. H. Madow, "On the theory of systematic sampling", Ann. Math. Stat. 15, 1944.

    Examples
    --------
    >>> systematic_mse([3.0, -1.0], size=6), systematic_mse([3.0, -1.0], size=8)
    (0.2222222222222222, 0.0)
    """
    _, lines = _checked(target, axis)
    N = count("size", size)
    if N == 0.0:
        return 0.0
    lines = lines.T[lines.any(axis=0)]
    # as integers, each of 36 bytes or more and a pointer: W, N W, remainders, 1 - f, and quotients
    memory.need("the fractional parts", 5 * 44 * lines.size)
    with np.errstate(over="ignore", invalid="ignore"):
        W = whole_numbers(lines)
        f, f_rest = fractional_parts(N, W, W.sum(axis=1, keepdims=True))
        mse = ((np.abs(lines).sum(axis=1) / N) ** 2 * (f * f_rest).sum(axis=1)).sum()
    return float(checked_finite(mse, "mean squared error"))


def systematic_covariance(target: ArrayLike, size: Size = 1, *, axis: Axis = "columns") -> Floats:
    """Covariance of the average of ``size`` systematic samples.

    Parameters
    ----------
    target, size, axis
        As in :func:`systematic_mse`.

    Returns
    -------
    (n, n), (m, n, n) or (n, m, m) array
        For a vector, ``(g / size)^2 sign(w_i) sign(w_k) Cov(N_i, N_k)``. For a matrix one such
        covariance per line; different lines are independent.

    Raises
    ------
    InputError, InputTypeError
        As :func:`systematic_mse`.
    ResourceError
        The covariances do not fit into memory.

    Notes
    -----
    With ``c_i = size (p_1 + ... + p_i)`` and ``f_i = frac(c_i)``, the counts are
    ``N_i = floor(c_i) - floor(c_{i-1}) + b_i - b_{i-1}`` with ``b_i = 1`` where the offset is
    below ``f_i``; hence ``Cov(b_i, b_k) = min(f_i, f_k) - f_i f_k``. The traces add up to
    :func:`systematic_mse`. ``size=1`` is a single independent draw.

    Examples
    --------
    >>> systematic_covariance([3.0, -1.0], size=2)
    array([[1., 1.],
           [1., 1.]])
    """
    vector, lines = _checked(target, axis)
    N = count("size", size)
    # the result, and the arrays for one line
    memory.need("the covariances", 8 * lines.shape[0] ** 2 * (lines.shape[1] + 5))
    with np.errstate(over="ignore", invalid="ignore"):
        covariances = np.array([systematic_vector_covariance(line, N) for line in lines.T])
    checked_finite(covariances)
    return np.asarray(covariances[0] if vector else covariances, dtype=np.float64)


def _checked(target: object, axis: str) -> tuple[bool, Floats]:
    """Check a vector or matrix; return whether it is a vector, and its lines as columns."""
    values = validation.array("target", target, ndim=(1, 2))
    validation.choice("axis", axis, AXES)
    vector = values.ndim == 1
    return vector, values[:, None] if vector else lines_of(values, axis)
