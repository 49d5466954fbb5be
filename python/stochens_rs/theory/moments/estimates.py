"""Covariances and mean square errors of estimated vectors and matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..._base import memory, validation
from ..._base.types import AXES, Axis, Floats
from ..formulas import (
    Size,
    checked_finite,
    column_excess,
    fused_product_covariance,
    inverse_size,
    lines_of,
    matrix_excess,
    realization_covariance,
    sum_of_others,
)


def vector_covariance(w: ArrayLike, size: Size = 1) -> Floats:
    """Covariance of the average of ``size`` realizations of a vector.

    Parameters
    ----------
    w : (n,) array_like
        The vector.
    size : int or None, default 1
        Number of independent realizations; None or inf: known exactly.

    Returns
    -------
    (n, n) array
        ``Cv(w) / size``, ``Cv(w) = ||w||_1 diag|w| - w w^T``.

    Raises
    ------
    InputError, InputTypeError
        `w` is not a finite vector, `size` is not a count, the covariance overflows.
    ResourceError
        The covariance does not fit into memory.

    Notes
    -----
    Lemma 4.1 (the sampling scheme): a scaled multinomial covariance. For fixed weights ``y`` with
    sum 1 instead of the average, multiply the value for ``size=1`` by ``sum(y**2)``.

    Examples
    --------
    >>> vector_covariance([3.0, -1.0], size=2)
    array([[1.5, 1.5],
           [1.5, 1.5]])
    """
    w = validation.vector("w", w)
    reciprocal = inverse_size("size", size)
    memory.need("the covariance", 3 * 8 * w.size**2)  # with two products on the way
    with np.errstate(over="ignore", invalid="ignore"):
        return checked_finite(realization_covariance(w) * reciprocal)


def vector_mse(w: ArrayLike, size: Size = 1) -> float:
    """Mean squared 2-norm error of the average of ``size`` realizations of a vector.

    Parameters
    ----------
    w, size
        As in :func:`vector_covariance`.

    Returns
    -------
    float
        ``(||w||_1^2 - ||w||_2^2) / size``, the trace of :func:`vector_covariance`.

    Raises
    ------
    InputError, InputTypeError
        As :func:`vector_covariance`.

    Notes
    -----
    Lemma 4.1. Weights ``y`` with sum 1: the value for ``size=1`` times ``sum(y**2)``.

    Examples
    --------
    >>> vector_mse([3.0, -1.0], size=2)
    3.0
    """
    return matrix_mse(validation.vector("w", w)[:, None], size)


def matrix_mse(A: ArrayLike, size: Size = 1, *, axis: Axis = "columns") -> float:
    """Mean squared Frobenius error of the average of ``size`` realizations of a matrix.

    Parameters
    ----------
    A : (n, m) array_like
        The matrix.
    size : int or None, default 1
        Number of independent realizations; None or inf: known exactly.
    axis : {"columns", "rows"}, default "columns"
        Which lines are sampled.

    Returns
    -------
    float
        ``sum_j (g_j^2 - ||a_j||_2^2) / size`` over the sampled lines ``a_j``.

    Raises
    ------
    InputError, InputTypeError
        `A` is not a finite matrix, `size` is not a count, `axis` is unknown, or the error
        overflows.

    Notes
    -----
    Lemma 4.1, one vector per line. ``g^2 - ||a||_2^2 = sum_i |a_i| (g - |a_i|)``.

    Examples
    --------
    >>> matrix_mse([[1.0, 0.0], [2.0, 5.0]])
    4.0
    """
    lines = lines_of(validation.matrix("A", A), axis)
    with np.errstate(over="ignore", invalid="ignore"):
        mse = (np.abs(lines) * sum_of_others(lines)).sum() * inverse_size("size", size)
    return float(checked_finite(mse, "mean squared error"))


def matrix_covariance(A: ArrayLike, size: Size = 1, *, axis: Axis = "columns") -> Floats:
    """Covariance of the average of ``size`` realizations of a matrix, line by line.

    Parameters
    ----------
    A, size, axis
        As in :func:`matrix_mse`.

    Returns
    -------
    (m, n, n) or (n, m, m) array
        ``[j] = Cv(a_j) / size`` for the sampled line ``a_j``. Different lines are independent.

    Raises
    ------
    InputError, InputTypeError
        As :func:`matrix_mse`.
    ResourceError
        The covariances do not fit into memory.

    Notes
    -----
    Lemma 4.1, one vector per line; the traces add up to :func:`matrix_mse`.

    Examples
    --------
    >>> matrix_covariance([[3.0, 0.0], [-1.0, 5.0]], size=3)[0]
    array([[1., 1.],
           [1., 1.]])
    """
    lines = lines_of(validation.matrix("A", A), axis).T
    reciprocal = inverse_size("size", size)
    memory.need("the covariances", 2 * 8 * lines.size * lines.shape[1])  # before and after 1/N
    with np.errstate(over="ignore", invalid="ignore"):
        covariances = np.array([realization_covariance(line) for line in lines])
        return checked_finite(covariances * reciprocal)


def transition(A: ArrayLike, d: ArrayLike) -> Floats:
    """``T_A(d)``, which sampling the columns of ``A`` adds to a second moment.

    Parameters
    ----------
    A : (n, m) array_like
        The matrix, sampled by columns.
    d : (m,) array_like
        One factor per column; for a random or fixed ``x`` the values ``E[x_j^2]``.

    Returns
    -------
    (n, n) array
        ``T_A(d) = sum_j d_j Cv(a_j) = diag(|A| (g * d)) - A diag(d) A^T``; positive semidefinite
        for ``d >= 0``, with trace ``sum_j d_j (g_j^2 - ||a_j||_2^2)``.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or the result overflows.

    Notes
    -----
    Its diagonal is computed as ``Phi d`` with ``Phi_ij = |A_ij| (g_j - |A_ij|)``. For a fixed
    vector ``x``, ``T_A(x * x)`` is the covariance of ``A^s x``.

    Examples
    --------
    >>> transition([[1.0, 0.0], [2.0, 5.0]], [1.0, 1.0])
    array([[ 2., -2.],
           [-2.,  2.]])
    """
    A = validation.matrix("A", A)
    d = validation.vector("d", d, length=A.shape[1])
    with np.errstate(over="ignore", invalid="ignore"):
        return checked_finite(column_excess(A, d))


def second_moment(A: ArrayLike, M: ArrayLike, *, axis: Axis = "columns") -> Floats:
    """``E[A^s M A^sT]`` for one realization of a matrix.

    Parameters
    ----------
    A : (n, m) array_like
        The matrix.
    M : (m, m) array_like
        Any fixed matrix, or ``E[x x^T]`` of an ``x`` that is independent of ``A^s``.
    axis : {"columns", "rows"}, default "columns"
        Which lines are sampled.

    Returns
    -------
    (n, n) array
        Columns: ``A M A^T + T_A(diag M)``.
        Rows: ``A M A^T + diag(rho * (|A| diag M) - diag(A M A^T))``.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, `axis` is unknown, or the result overflows.

    Notes
    -----
    For an average of ``N`` realizations, the part beside ``A M A^T`` is divided by ``N``.

    Examples
    --------
    >>> second_moment([[1.0, 0.0], [2.0, 5.0]], [[1.0, 0.0], [0.0, 1.0]])
    array([[ 3.,  0.],
           [ 0., 31.]])
    """
    A = validation.matrix("A", A)
    M = validation.matrix("M", M, rows=A.shape[1], cols=A.shape[1])
    validation.choice("axis", axis, AXES)
    with np.errstate(over="ignore", invalid="ignore"):
        return checked_finite(A @ M @ A.T + matrix_excess(A, M, axis), "second moment")


def product_covariance(A: ArrayLike, x0: ArrayLike, *, axis: Axis = "columns") -> Floats:
    """``C_z``: covariance of ``z^s = A^s x0^s``, one realization of each.

    Parameters
    ----------
    A : (n, m) array_like
        The matrix.
    x0 : (m,) array_like
        The vector.
    axis : {"columns", "rows"}, default "columns"
        Which lines of ``A`` are sampled.

    Returns
    -------
    (n, n) array
        Columns: ``C_z = g0 diag(|A| (g * |x0|)) - (A x0)(A x0)^T``, ``g0 = ||x0||_1``.
        Rows: ``A Cv(x0) A^T`` off the diagonal and ``g0 rho_i (|A| |x0|)_i - (A x0)_i^2`` on it.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, `axis` is unknown, or the result overflows.

    Notes
    -----
    Used in Lemma 4.2. Computed as ``A Cv(x0) A^T``, from ``x0``, and two parts from ``A``.

    Examples
    --------
    >>> product_covariance([[1.0, 0.0], [2.0, 5.0]], [1.0, 1.0])
    array([[ 5., -7.],
           [-7., 13.]])
    """
    A = validation.matrix("A", A)
    x0 = validation.vector("x0", x0, length=A.shape[1])
    validation.choice("axis", axis, AXES)
    with np.errstate(over="ignore", invalid="ignore"):
        return checked_finite(fused_product_covariance(A, x0, 1.0, 1.0, axis))
