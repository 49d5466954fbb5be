r"""Exact second moments of realizations, of their averages and of the controls they give.

Notation. ``w`` (n,) is a vector, ``g = ||w||_1``. One realization is ``w^s = g sign(w_I) e_I``
with ``P(I = i) = |w_i| / g``; it has mean ``w``. A matrix ``A`` (n, m) is sampled line by line,
independently: ``axis="columns"`` (the default) draws one entry of every column ``a_j``, with
``g_j = ||a_j||_1``; ``axis="rows"`` one entry of every row, with ``rho_i = ||row i||_1``. An
estimate is the average of ``size`` independent realizations; ``size`` None (or inf) stands for
an entity that is known exactly. A line of zeros is always exact: its realizations are 0.

Everything follows from two facts, the covariance of one realization of a vector and that of
one column:

``Cv(w) = g diag|w| - w w^T``,
``E[A^s M A^sT] = A M A^T + T_A(diag M)`` with ``T_A(d) = sum_j d_j Cv(a_j)``.

All results are exact for every ``size`` and need no limit. Variances are computed from sums of
nonnegative terms, ``g - |w_i| = sum_{k != i} |w_k|``, hence without cancellation.

The formulas are those behind the lemmas "variance" (4.2) and "final_state_variance" (4.3), with
their exact values in place of bounds.
"""

from __future__ import annotations

import math
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _gate
from ..exceptions import InputError, ShapeError

__all__ = [
    "control_covariance",
    "control_rms",
    "matrix_mse",
    "product_covariance",
    "realization_control_covariance",
    "second_moment",
    "state_covariance",
    "state_rms",
    "systematic_mse",
    "transition",
    "vector_covariance",
    "vector_mse",
]

Array: TypeAlias = NDArray[np.float64]
Axis: TypeAlias = Literal["columns", "rows"]
Fusion: TypeAlias = Literal["product", "diagonal"]
Size: TypeAlias = "int | float | None"
Sizes: TypeAlias = "Size | tuple[Size, Size, Size]"

_AXES = ("columns", "rows")


# -- one entity ----------------------------------------------------------------------------------


def vector_covariance(w: ArrayLike, size: Size = 1) -> Array:
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
        `w` is not a finite vector, `size` is not a count.
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
    w = _gate.vector("w", w)
    reciprocal = _reciprocal("size", size)
    _gate.memory("the covariance", 3 * 8 * w.size**2)
    return _vector_covariance(w) * reciprocal


def vector_mse(w: ArrayLike, size: Size = 1) -> float:
    """Mean squared 2-norm error of the average of ``size`` realizations of a vector.

    Parameters
    ----------
    w : (n,) array_like
        The vector.
    size : int or None, default 1
        Number of independent realizations; None or inf: known exactly.

    Returns
    -------
    float
        ``(||w||_1^2 - ||w||_2^2) / size``, the trace of :func:`vector_covariance`.

    Raises
    ------
    InputError, InputTypeError
        `w` is not a finite vector, `size` is not a count.

    Notes
    -----
    Lemma 4.1. Weights ``y`` with sum 1: the value for ``size=1`` times ``sum(y**2)``.

    Examples
    --------
    >>> vector_mse([3.0, -1.0], size=2)
    3.0
    """
    return matrix_mse(_gate.vector("w", w)[:, None], size)


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
        `A` is not a finite matrix, `size` is not a count, `axis` is unknown.

    Notes
    -----
    Lemma 4.1, one vector per line. ``g^2 - ||a||_2^2 = sum_i |a_i| (g - |a_i|)``.

    Examples
    --------
    >>> matrix_mse([[1.0, 0.0], [2.0, 5.0]])
    4.0
    """
    lines = _lines(_gate.matrix("A", A), axis)
    return float((np.abs(lines) * _others(lines)).sum()) * _reciprocal("size", size)


def systematic_mse(target: ArrayLike, size: Size = 1, *, axis: Axis = "columns") -> float:
    """Mean squared error of the average of ``size`` systematic samples.

    Parameters
    ----------
    target : (n,) or (n, m) array_like
        The vector, or the matrix whose lines are sampled with one offset each.
    size : int or None, default 1
        Number of samples; None or inf: known exactly.
    axis : {"columns", "rows"}, default "columns"
        Which lines of a matrix are sampled; without effect for a vector.

    Returns
    -------
    float
        ``sum_j (g_j / size)^2 sum_i f_ij (1 - f_ij)`` with ``f_ij = frac(size |a_ij| / g_j)``, the
        square of the 2-norm (vector) or Frobenius norm (matrix). At most ``n g^2 / (4 size^2)``
        per line, and 0 where every ``size |a_ij| / g_j`` is an integer.

    Raises
    ------
    InputError, InputTypeError
        `target` is not a finite vector or matrix, `size` is not a count, `axis` is unknown.

    Notes
    -----
    One ``U`` uniform on [0, 1) per line and ``c_i = size (p_1 + ... + p_i)`` give the counts
    ``N_i = ceil(c_i - U) - ceil(c_{i-1} - U)``: each is ``floor`` or ``ceil`` of ``size p_i``, the
    latter with probability ``f_i``. Compare ``1 / size`` in :func:`vector_mse`. The fractional
    parts are meaningful while ``size`` is far below 2**53.

    References
    ----------
    W. G. Madow and L. H. Madow, "On the theory of systematic sampling", Ann. Math. Stat. 15, 1944.

    Examples
    --------
    >>> systematic_mse([3.0, -1.0], size=6), systematic_mse([3.0, -1.0], size=8)
    (0.2222222222222222, 0.0)
    """
    lines = _gate.array("target", target, ndim=(1, 2))
    _gate.choice("axis", axis, _AXES)
    lines = lines[:, None] if lines.ndim == 1 else _lines(lines, axis)
    if _reciprocal("size", size) == 0.0:
        return 0.0
    N = float(_gate.size("size", size))
    g = np.abs(lines).sum(axis=0)
    lines, g = lines[:, g > 0.0], g[g > 0.0]
    # A remainder is computed without rounding: where N |a| / g is an integer, f is exactly 0.
    f = np.fmod(N * np.abs(lines), g) / g
    return float(((g / N) ** 2 * (f * (1.0 - f)).sum(axis=0)).sum())


def transition(A: ArrayLike, d: ArrayLike) -> Array:
    """``T_A(d)``: what the sampling of the columns of ``A`` adds to a second moment.

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
        A shape does not fit, or an entry is not finite.

    Notes
    -----
    Its diagonal is ``Phi d`` with ``Phi_ij = |A_ij| (g_j - |A_ij|)``, and is computed so. For a
    vector ``x`` that is known, ``T_A(x * x)`` is the covariance of ``A^s x``.

    Examples
    --------
    >>> transition([[1.0, 0.0], [2.0, 5.0]], [1.0, 1.0])
    array([[ 2., -2.],
           [-2.,  2.]])
    """
    A = _gate.matrix("A", A)
    return _transition(A, _gate.vector("d", d, length=A.shape[1]))


def second_moment(A: ArrayLike, M: ArrayLike, *, axis: Axis = "columns") -> Array:
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
        A shape does not fit, an entry is not finite, `axis` is unknown.

    Notes
    -----
    For an average of ``N`` realizations, the part beside ``A M A^T`` is divided by ``N``.

    Examples
    --------
    >>> second_moment([[1.0, 0.0], [2.0, 5.0]], [[1.0, 0.0], [0.0, 1.0]])
    array([[ 3.,  0.],
           [ 0., 31.]])
    """
    A = _gate.matrix("A", A)
    M = _gate.matrix("M", M, rows=A.shape[1], cols=A.shape[1])
    _gate.choice("axis", axis, _AXES)
    moment: Array = A @ M @ A.T + _excess(A, M, axis)
    return moment


def product_covariance(x0: ArrayLike, A: ArrayLike, *, axis: Axis = "columns") -> Array:
    """``C_z``: covariance of ``z^s = A^s x0^s``, one realization of each.

    Parameters
    ----------
    x0 : (m,) array_like
        The vector.
    A : (n, m) array_like
        The matrix.
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
        A shape does not fit, an entry is not finite, `axis` is unknown.

    Notes
    -----
    Behind Lemma 4.2. Evaluated as ``A Cv(x0) A^T`` (from ``x0``) plus the two parts from ``A``.

    Examples
    --------
    >>> product_covariance([1.0, 1.0], [[1.0, 0.0], [2.0, 5.0]])
    array([[ 5., -7.],
           [-7., 13.]])
    """
    A = _gate.matrix("A", A)
    x0 = _gate.vector("x0", x0, length=A.shape[1])
    _gate.choice("axis", axis, _AXES)
    return _product_covariance(x0, A, 1.0, 1.0, axis)


# -- controls ------------------------------------------------------------------------------------


def realization_control_covariance(
    B: ArrayLike, x0: ArrayLike, xf: ArrayLike, A: ArrayLike, *, axis: Axis = "columns"
) -> Array:
    """Covariance of the control ``u^s = B+ (xf^s - A^s x0^s)`` of one realization.

    Parameters
    ----------
    B : (n, m) array_like
        Input matrix, known exactly; any rank.
    x0, xf : (n,) array_like
        Initial state and target state.
    A : (n, n) array_like
        State matrix.
    axis : {"columns", "rows"}, default "columns"
        Which lines of ``A`` are sampled.

    Returns
    -------
    (m, m) array
        ``B+ (Cv(xf) + C_z) B+^T`` with ``C_z`` of :func:`product_covariance`. The mean of ``u^s``
        is ``v* = B+ (xf - A x0)``.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, `axis` is unknown.

    Notes
    -----
    Lemma 4.2, exact. With an entity known exactly:
    ``control_covariance(..., size=(1, None, 1), fusion="diagonal")``.

    Examples
    --------
    >>> realization_control_covariance([[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0],
    ...                                [[1.0, 0.0], [2.0, 5.0]])
    array([[9.]])
    """
    return control_covariance(B, x0, xf, A, 1, fusion="diagonal", axis=axis)


def control_covariance(
    B: ArrayLike,
    x0: ArrayLike,
    xf: ArrayLike,
    A: ArrayLike,
    size: Sizes = 1,
    *,
    fusion: Fusion = "product",
    axis: Axis = "columns",
) -> Array:
    """Covariance of the fused control under uniform weights.

    Parameters
    ----------
    B : (n, m) array_like
        Input matrix, known exactly; any rank.
    x0, xf : (n,) array_like
        Initial state and target state.
    A : (n, n) array_like
        State matrix.
    size : int, None or (N0, Nf, NA), default 1
        Number of independent realizations of ``x0``, ``xf`` and ``A``; one number for all three
        or one each. None or inf: that entity is known exactly.
    fusion : {"product", "diagonal"}, default "product"
        ``"product"``: each entity is averaged first, ``u = B+ (xf_hat - A_hat x0_hat)``.
        ``"diagonal"``: the realizations are paired, ``u = 1/N sum_s B+ (xf^s - A^s x0^s)``, so that
        the sizes of the entities that are not exact must be equal.
    axis : {"columns", "rows"}, default "columns"
        Which lines of ``A`` are sampled.

    Returns
    -------
    (m, m) array
        ``B+ C B+^T``, about the mean ``v* = B+ (xf - A x0)`` (both fusions are unbiased). Columns:

        - product: ``C = Cv(xf)/Nf + A Cv(x0) A^T/N0 + T_A(x0 * x0)/NA
          + T_A(g0 |x0| - x0 * x0)/(N0 NA)``;
        - diagonal: ``C = (Cv(xf) + C_z) / N``, without the covariance of what is exact.

        Rows: ``T_A(diag M)`` is replaced by the diagonal matrix of :func:`second_moment`, with
        ``M = x0 x0^T`` in the third and ``M = Cv(x0)`` in the last term.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, a choice is unknown, or the sizes differ
        under ``fusion="diagonal"``.

    Notes
    -----
    Lemma 4.2, exact. ``Cov_diagonal - Cov_product = (1 - 1/N) / N B+ T_A(g0 |x0| - x0 * x0) B+^T``
    is positive semidefinite: product fusion is never worse (and by Rao-Blackwell, for every convex
    loss). Singular values of ``B`` below ``max(n, m) eps`` of the largest count as 0.

    Examples
    --------
    >>> B, x0, xf, A = [[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> control_covariance(B, x0, xf, A, 10), control_covariance(B, x0, xf, A, (None, 10, None))
    (array([[0.72]]), array([[0.4]]))
    """
    B, C = _fused(B, x0, xf, A, size, fusion, axis)
    U, s, V = _compact_svd(B)
    return _symmetric_product(V / s, U.T @ C @ U)


def state_covariance(
    B: ArrayLike,
    x0: ArrayLike,
    xf: ArrayLike,
    A: ArrayLike,
    size: Sizes = 1,
    *,
    fusion: Fusion = "product",
    axis: Axis = "columns",
) -> Array:
    """Covariance of the state ``x(1) = A x0 + B u`` that the fused control leads to.

    Parameters
    ----------
    B, x0, xf, A, size, fusion, axis
        As in :func:`control_covariance`; the control acts on the exact system.

    Returns
    -------
    (n, n) array
        ``B Cov(u) B^T = P C P`` with ``P = B B+``, about the mean
        ``A x0 + B v* = xf - (I - P)(xf - A x0)``.

    Raises
    ------
    InputError, InputTypeError
        As :func:`control_covariance`.

    Notes
    -----
    Lemma 4.3 for one step, exact and corrected:
    ``E||x(1) - xf||^2 = trace + ||(I - P)(xf - A x0)||^2``, whose second term, the part of the
    target that cannot be reached, does not shrink with ``size``.

    Examples
    --------
    >>> B, x0, xf, A = [[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> state_covariance(B, x0, xf, A, 10)
    array([[0.72, 0.  ],
           [0.  , 0.  ]])
    """
    B, C = _fused(B, x0, xf, A, size, fusion, axis)
    U, _, _ = _compact_svd(B)
    return _symmetric_product(U, U.T @ C @ U)


def control_rms(
    B: ArrayLike,
    x0: ArrayLike,
    xf: ArrayLike,
    A: ArrayLike,
    size: Sizes = 1,
    *,
    fusion: Fusion = "product",
    axis: Axis = "columns",
) -> float:
    """Root mean square error ``sqrt(E||u - v*||_2^2)`` of the fused control.

    Parameters
    ----------
    B, x0, xf, A, size, fusion, axis
        As in :func:`control_covariance`.

    Returns
    -------
    float
        Square root of the trace of :func:`control_covariance`.

    Raises
    ------
    InputError, InputTypeError
        As :func:`control_covariance`.

    Examples
    --------
    >>> B, x0, xf, A = [[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> round(control_rms(B, x0, xf, A, 10), 6)
    0.848528
    """
    return _root_trace(control_covariance(B, x0, xf, A, size, fusion=fusion, axis=axis))


def state_rms(
    B: ArrayLike,
    x0: ArrayLike,
    xf: ArrayLike,
    A: ArrayLike,
    size: Sizes = 1,
    *,
    fusion: Fusion = "product",
    axis: Axis = "columns",
) -> float:
    """Root mean square error ``sqrt(E||B (u - v*)||_2^2)`` of the state after one step.

    Parameters
    ----------
    B, x0, xf, A, size, fusion, axis
        As in :func:`control_covariance`.

    Returns
    -------
    float
        Square root of the trace of :func:`state_covariance`: the distance to the state that the
        exact control reaches, not to ``xf``.

    Raises
    ------
    InputError, InputTypeError
        As :func:`control_covariance`.

    Examples
    --------
    >>> B, x0, xf, A = [[2.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> round(state_rms(B, x0, xf, A, 10), 6)
    0.848528
    """
    return _root_trace(state_covariance(B, x0, xf, A, size, fusion=fusion, axis=axis))


# -- the formulas --------------------------------------------------------------------------------


def _others(lines: Array) -> Array:
    """``sum_{k != i} |W_kj|``, which is ``g_j - |W_ij|`` without the subtraction."""
    absolute = np.abs(lines)
    before = np.zeros_like(absolute)
    after = np.zeros_like(absolute)
    np.cumsum(absolute[:-1], axis=0, out=before[1:])
    after[:-1] = np.cumsum(absolute[:0:-1], axis=0)[::-1]
    return before + after


def _vector_covariance(w: Array) -> Array:
    """``Cv(w)`` for one realization."""
    return _transition(w[:, None], np.ones(1))


def _transition(A: Array, d: Array) -> Array:
    """``T_A(d)``: off the diagonal ``-A diag(d) A^T``, on it ``Phi d``."""
    T: Array = 0.0 - (A * d) @ A.T  # "0.0 -" rather than "-": zeros stay +0.0
    np.fill_diagonal(T, (np.abs(A) * _others(A)) @ d)
    return T


def _excess(A: Array, M: Array, axis: str) -> Array:
    """``E[A^s M A^sT] - A M A^T``."""
    diagonal = np.diagonal(M)
    if axis == "columns":
        return _transition(A, diagonal)
    # Rows are independent of each other: only E[(A^s M A^sT)_ii] differs.
    rho = np.abs(A).sum(axis=1)
    return np.diag(rho * (np.abs(A) @ diagonal) - ((A @ M) * A).sum(axis=1))


def _product_covariance(x0: Array, A: Array, r0: float, rA: float, axis: str) -> Array:
    """``Cov(A_hat x0_hat)`` for ``1/r0`` realizations of ``x0`` and ``1/rA`` of ``A``."""
    Cv = _vector_covariance(x0)
    from_both = r0 * rA * _excess(A, Cv, axis)
    from_A = rA * _excess(A, np.outer(x0, x0), axis)
    covariance: Array = r0 * (A @ Cv @ A.T) + from_A + from_both
    return covariance


def _fused(
    B: ArrayLike, x0: ArrayLike, xf: ArrayLike, A: ArrayLike, size: Sizes, fusion: str, axis: str
) -> tuple[Array, Array]:
    """The checked ``B`` and ``C``, the covariance of ``xf_hat - A_hat x0_hat`` (or its pairing)."""
    B = _gate.matrix("B", B)
    n = B.shape[0]
    x0 = _gate.vector("x0", x0, length=n)
    xf = _gate.vector("xf", xf, length=n)
    A = _gate.matrix("A", A, rows=n, cols=n)
    _gate.choice("axis", axis, _AXES)
    sizes = _one_each(size)
    r0, rf, rA = (_reciprocal(f"size[{k}]", N) for k, N in enumerate(sizes))
    if _gate.choice("fusion", fusion, ("product", "diagonal")) == "product":
        return B, rf * _vector_covariance(xf) + _product_covariance(x0, A, r0, rA, axis)
    # N independent pairs: the covariance of one pair over N; exact entities stay exact.
    sampled = {r for r in (r0, rf, rA) if r > 0.0}
    if len(sampled) > 1:
        raise InputError(
            "`size` must be one number with fusion='diagonal', which pairs the realizations, "
            f"got N0, Nf, NA = {', '.join(_gate.show(N) for N in sizes)}"
        )
    one0, onef, oneA = (float(r > 0.0) for r in (r0, rf, rA))
    one_pair = onef * _vector_covariance(xf) + _product_covariance(x0, A, one0, oneA, axis)
    return B, max(sampled, default=0.0) * one_pair


# -- helpers -------------------------------------------------------------------------------------


def _lines(A: Array, axis: str) -> Array:
    """``A`` with the sampled lines as columns."""
    return A if _gate.choice("axis", axis, _AXES) == "columns" else A.T


def _reciprocal(name: str, size: object) -> float:
    """``1 / size``; 0 for an entity that is known exactly (None or inf)."""
    if size is None or (isinstance(size, (float, np.floating)) and size == math.inf):
        return 0.0
    return 1.0 / _gate.size(name, size)


def _one_each(size: object) -> tuple[object, object, object]:
    """``(N0, Nf, NA)``."""
    if not isinstance(size, (tuple, list)):
        _reciprocal("size", size)  # so that an error names `size`, not `size[0]`
        return size, size, size
    if len(size) != 3:
        raise ShapeError(f"`size` must be one number or (N0, Nf, NA), got {len(size)} numbers")
    N0, Nf, NA = size
    return N0, Nf, NA


def _compact_svd(B: Array) -> tuple[Array, Array, Array]:
    """``B = U diag(s) V^T`` with the numerical rank as inner size, so ``B+ = V diag(1/s) U^T``."""
    U, s, Vt = np.linalg.svd(B, full_matrices=False)
    rank = int((s > s[0] * max(B.shape) * np.finfo(np.float64).eps).sum())
    return U[:, :rank], s[:rank], Vt[:rank].T


def _symmetric_product(F: Array, C: Array) -> Array:
    """``F C F^T``, exactly symmetric."""
    product = F @ C @ F.T
    return np.asarray((product + product.T) / 2.0, dtype=np.float64)


def _root_trace(C: Array) -> float:
    """``sqrt(tr C)``; rounding may leave a trace that should be 0 slightly below it."""
    return math.sqrt(max(0.0, float(np.trace(C))))
