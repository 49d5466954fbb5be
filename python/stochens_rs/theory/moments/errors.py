"""Covariances of controls and estimates, over one step and several."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..._base import running, validation
from ..._base.types import AXES, Axis, Floats, Fusion, Scheme
from ...exceptions import InputError
from ...system.system import System
from ..exact import best_control, checked_ends, checked_steps, matrix_powers, states
from ..formulas import (
    Size,
    Sizes,
    checked_finite,
    column_excess,
    compact_svd,
    count,
    fractional_parts,
    fused_covariance,
    fused_product_covariance,
    inverse_size,
    lines_of,
    matrix_excess,
    one_each,
    realization_covariance,
    root_trace,
    sum_of_others,
    symmetric_product,
    systematic_vector_covariance,
    whole_numbers,
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
    running.need("the covariance", 3 * 8 * w.size**2)  # with two products on the way
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
    running.need("the covariances", 2 * 8 * lines.size * lines.shape[1])  # before and after 1/N
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


def realization_control_covariance(
    system: System | Any, x0: ArrayLike, xf: ArrayLike, *, axis: Axis = "columns"
) -> Floats:
    """Covariance of the control ``u^s = B+ (xf^s - A^s x0^s)`` of one realization.

    Parameters
    ----------
    system, x0, xf, axis
        As in :func:`control_covariance`.

    Returns
    -------
    (m, m) array
        ``B+ (Cv(xf) + C_z) B+^T`` with ``C_z`` of :func:`product_covariance`. The mean of ``u^s``
        is ``v* = B+ (xf - A x0)``.

    Raises
    ------
    InputError, InputTypeError
        As :func:`control_covariance`.

    Notes
    -----
    Lemma 4.2, exact. If an entity is known exactly:
    ``control_covariance(..., size=(1, None, 1), fusion="diagonal")``.

    Examples
    --------
    >>> system = [[1.0, 0.0], [2.0, 5.0]], [[1.0], [0.0]]
    >>> realization_control_covariance(system, [1.0, 1.0], [2.0, 2.0])
    array([[9.]])
    """
    return control_covariance(system, x0, xf, 1, fusion="diagonal", axis=axis)


def control_covariance(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: Sizes = 1,
    *,
    fusion: Fusion = "product",
    axis: Axis = "columns",
    scheme: Scheme = "iid",
) -> Floats:
    """Covariance of the fused control under uniform weights.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``. ``B`` is known exactly
        and may have any rank.
    x0, xf : (n,) array_like
        Initial state and target state.
    size : int, None or (N0, Nf, NA), default 1
        Number of independent realizations of ``x0``, ``xf`` and ``A``; one number for all three
        or one each. None or inf: that entity is known exactly.
    fusion : {"product", "diagonal"}, default "product"
        ``"product"``: each entity is averaged first, ``u = B+ (xf_hat - A_hat x0_hat)``.
        ``"diagonal"``: the realizations are paired, ``u = 1/N sum_s B+ (xf^s - A^s x0^s)``; the
        sizes of the entities that are not exact must be equal.
    axis : {"columns", "rows"}, default "columns"
        Which lines of ``A`` are sampled.
    scheme : {"iid", "systematic"}, default "iid"
        Whether the realizations of an entity are independent or systematic samples; "systematic"
        goes with product fusion only.

    Returns
    -------
    (m, m) array
        ``B+ C B+^T``, about the mean ``v* = B+ (xf - A x0)`` (both fusions are unbiased). Columns:

        - product: ``C = Cv(xf)/Nf + A Cv(x0) A^T/N0 + T_A(x0 * x0)/NA
          + T_A(g0 |x0| - x0 * x0)/(N0 NA)``;
        - diagonal: ``C = (Cv(xf) + C_z) / N``, in which exact entities have no covariance.

        Rows: ``T_A(diag M)`` is replaced by the diagonal matrix of :func:`second_moment`, with
        ``M = x0 x0^T`` in the third and ``M = Cv(x0)`` in the last term. Systematic samples, with
        ``V`` of :func:`systematic_covariance`: ``C = V(xf) + A V(x0) A^T + sum_j (x0_j^2 +
        V(x0)_jj) V(a_j)``; rows: the last sum is the diagonal of ``<V(row i), x0 x0^T + V(x0)>``.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, a choice is unknown, the covariance
        overflows, or ``fusion="diagonal"`` goes with different sizes or systematic samples.

    Notes
    -----
    Lemma 4.2, exact. ``Cov_diagonal - Cov_product = (1 - 1/N) / N B+ T_A(g0 |x0| - x0 * x0) B+^T``
    is positive semidefinite: product fusion is never worse (and by Rao-Blackwell, for every convex
    loss). Singular values of ``B`` below ``max(n, m) eps`` of the largest count as 0.

    Examples
    --------
    >>> system, x0, xf = ([[1.0, 0.0], [2.0, 5.0]], [[1.0], [0.0]]), [1.0, 1.0], [2.0, 2.0]
    >>> control_covariance(system, x0, xf, 10)
    array([[0.72]])
    >>> control_covariance(system, x0, xf, (None, 10, None))
    array([[0.4]])
    """
    with np.errstate(over="ignore", invalid="ignore"):
        B, C = fused_covariance(system, x0, xf, size, fusion, axis, scheme)
        U, s, V = compact_svd(B)
        return symmetric_product(V / s, U.T @ C @ U)


def state_covariance(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: Sizes = 1,
    *,
    fusion: Fusion = "product",
    axis: Axis = "columns",
    scheme: Scheme = "iid",
) -> Floats:
    """Covariance of the state ``x(1) = A x0 + B u`` that the fused control leads to.

    Parameters
    ----------
    system, x0, xf, size, fusion, axis, scheme
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
    ``E||x(1) - xf||^2 = trace + ||(I - P)(xf - A x0)||^2``. The second term, the part of the target
    that no control reaches, does not depend on ``size``.

    Examples
    --------
    >>> system, x0, xf = ([[1.0, 0.0], [2.0, 5.0]], [[1.0], [0.0]]), [1.0, 1.0], [2.0, 2.0]
    >>> state_covariance(system, x0, xf, 10)
    array([[0.72, 0.  ],
           [0.  , 0.  ]])
    """
    with np.errstate(over="ignore", invalid="ignore"):
        B, C = fused_covariance(system, x0, xf, size, fusion, axis, scheme)
        U, _, _ = compact_svd(B)
        return symmetric_product(U, U.T @ C @ U)


def control_rms(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: Sizes = 1,
    *,
    fusion: Fusion = "product",
    axis: Axis = "columns",
    scheme: Scheme = "iid",
) -> float:
    """Root mean square error ``sqrt(E||u - v*||_2^2)`` of the fused control.

    Parameters
    ----------
    system, x0, xf, size, fusion, axis, scheme
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
    >>> system, x0, xf = ([[1.0, 0.0], [2.0, 5.0]], [[1.0], [0.0]]), [1.0, 1.0], [2.0, 2.0]
    >>> round(control_rms(system, x0, xf, 10), 6)
    0.848528
    """
    return root_trace(
        control_covariance(system, x0, xf, size, fusion=fusion, axis=axis, scheme=scheme)
    )


def state_rms(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: Sizes = 1,
    *,
    fusion: Fusion = "product",
    axis: Axis = "columns",
    scheme: Scheme = "iid",
) -> float:
    """Root mean square error ``sqrt(E||B (u - v*)||_2^2)`` of the state after one step.

    Parameters
    ----------
    system, x0, xf, size, fusion, axis, scheme
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
    >>> system, x0, xf = ([[1.0, 0.0], [2.0, 5.0]], [[2.0], [0.0]]), [1.0, 1.0], [2.0, 2.0]
    >>> round(state_rms(system, x0, xf, 10), 6)
    0.848528
    """
    return root_trace(
        state_covariance(system, x0, xf, size, fusion=fusion, axis=axis, scheme=scheme)
    )


def final_state_covariance(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    steps: int,
    size: Sizes = 1,
    *,
    axis: Axis = "columns",
) -> Floats:
    """Covariance of the state after K steps of the estimated minimum-norm control, for large N.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``; ``B`` is known exactly.
    x0, xf : (n,) array_like
        Initial state and target state.
    steps : int
        Number of steps K, at least 1.
    size : int, None or (N0, Nf, NA), default 1
        Number of independent realizations of ``x0``, ``xf`` and ``A`` behind the uniform
        averages; one number for all three or one each. None or inf: that entity is exact.
    axis : {"columns", "rows"}, default "columns"
        Which lines of ``A`` are sampled.

    Returns
    -------
    (n, n) array
        The leading term of ``E[(x(K) - xf)(x(K) - xf)^T]``; its trace, times N, is the limit of
        ``N E||x(K) - xf||^2``. With the states ``x(k)`` of the exact minimum-norm control and
        ``G_j = sum_k x_j(k) A^{K-1-k}``:
        ``Cv(xf) / Nf + A^K Cv(x0) A^KT / N0 + sum_j G_j Cv(a_j) G_j^T / NA``.
        Rows: ``sum_i H_i Cv(row i) H_i^T / NA``, ``H_i = sum_k A^{K-1-k} e_i x(k)^T``.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, powers of ``A`` overflow, or the rank of
        ``C_K = [B, A B, ..., A^{K-1} B]`` is below n, where the expansion does not hold.
    ResourceError
        ``C_K``, the powers of ``A`` or ``n^3`` numbers do not fit into memory.

    Notes
    -----
    The control ``u = C_K(A_hat, B)^+ (xf_hat - A_hat^K x0_hat)`` drives the *model* along
    ``xh(k+1) = A_hat xh(k) + B u(k)`` from ``x0_hat`` to ``xf_hat``, and the system to x(K) with
    ``x(K) - xf = (xf_hat - xf) + A^K (x0 - x0_hat) + sum_{k<K} A^{K-1-k} (A - A_hat) xh(k)``,
    exactly, if the model reaches its target. As ``xh`` depends on the errors, too, the covariance
    holds to leading order in 1 / N only (delta method), unlike the other moments. For ``m K = n``
    the inverse of the estimated ``C_K`` has heavy tails, and N has to be very large.

    Examples
    --------
    >>> system = [[1.0, 1.0], [0.5, 1.0]], [[0.0], [1.0]]
    >>> C = final_state_covariance(system, [1.0, 0.0], [0.0, 1.0], steps=3, size=1000)
    >>> C.round(5)
    array([[ 0.00015, -0.00018],
           [-0.00018,  0.00143]])
    """
    checked, x0, xf = checked_ends(system, x0, xf)
    A, B, n = checked.A, checked.B, checked.n
    K = checked_steps(steps, n, checked.m)
    validation.choice("axis", axis, AXES)
    r0, rf, rA = (inverse_size(f"size[{i}]", N) for i, N in enumerate(one_each(size)))
    best = best_control(A, B, x0, xf, K)
    rank = len(best.factors.s)
    if rank < n:
        raise InputError(
            f"`steps` must be large enough for C_K to have rank n={n}, got rank {rank} with "
            f"steps={K}: the expansion does not hold there"
        )
    # the powers, and their order that `tensordot` takes; the n matrices G_j, twice
    running.need("the covariance", (2 * n**3 + 2 * (K + 1) * n * n) * 8)
    powers = matrix_powers(A, K)
    with np.errstate(over="ignore", invalid="ignore"):
        x = states(A, B, x0, best.u.reshape(K, -1))[:K]
        C = (
            rf * realization_covariance(xf)
            + r0 * powers[K] @ realization_covariance(x0) @ powers[K].T
        )
        carry = powers[K - 1 :: -1]  # carry[k] = A^{K-1-k}
        if axis == "columns":
            G = np.tensordot(x.T, carry, axes=1)
        else:
            G = np.tensordot(carry, x, axes=(0, 0)).transpose(1, 0, 2)
        for line, G_j in zip(A.T if axis == "columns" else A, G, strict=True):
            C += rA * (G_j @ realization_covariance(line) @ G_j.T)
    return checked_finite(np.asarray((C + C.T) / 2.0, dtype=np.float64))


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
    running.need("the fractional parts", 5 * 44 * lines.size)
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
    running.need("the covariances", 8 * lines.shape[0] ** 2 * (lines.shape[1] + 5))
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
