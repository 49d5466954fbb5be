r"""Exact second moments of realizations, of their averages and of the controls they give.

Notation. ``w`` (n,) is a vector, ``g = ||w||_1``. One realization is ``w^s = g sign(w_I) e_I``
with ``P(I = i) = |w_i| / g``; it has mean ``w``. A matrix ``A`` (n, m) is sampled line by line,
independently: ``axis="columns"`` (the default) draws one entry of every column ``a_j``, with
``g_j = ||a_j||_1``; ``axis="rows"`` one entry of every row, with ``rho_i = ||row i||_1``. An
estimate is the average of ``size`` independent realizations (or of systematic samples, where a
function says so); ``size`` None (or inf) stands for an entity that is known exactly. A line of
zeros is always exact: its realizations are 0.

Everything follows from two facts, the covariance of one realization of a vector and that of
one column:

``Cv(w) = g diag|w| - w w^T``,
``E[A^s M A^sT] = A M A^T + T_A(diag M)`` with ``T_A(d) = sum_j d_j Cv(a_j)``.

All results are exact for every ``size``, except :func:`final_state_covariance`, the limit for large
N over several steps. Variances are computed from sums of nonnegative terms, hence without
cancellation: ``g - |w_i| = sum_{k != i} |w_k|``, and for the product of a line and a vector x
``sum_{j<k} |a_j| |a_k| (s_j x_j - s_k x_k)^2``, s the signs of a.

These are the exact values of the variances that Lemmas 4.2 and 4.3 of the paper bound.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, TypeAlias, TypedDict

import numpy as np

from .. import _core
from .._base import running, types, validation
from .._base.types import ArrayLike, Averaging, Axis, Floats, Fusion, NDArray, Scheme
from ..exceptions import InputError, ShapeError
from ..system.system import System
from . import exact
from .exact import checked_ends, checked_finite, checked_motion, checked_steps

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = [
    "control_covariance",
    "control_rms",
    "covariance",
    "final_state_covariance",
    "mse",
    "product_covariance",
    "second_moment",
    "state_covariance",
    "state_rms",
    "trajectory_covariance",
    "trajectory_rms",
]

Size: TypeAlias = "int | float | None"
Sizes: TypeAlias = "Size | tuple[Size, Size, Size]"


class Law(TypedDict, total=False):
    """How the realizations of a control are fused and drawn."""

    fusion: Fusion
    axis: Axis
    scheme: Scheme


class RunsLaw(TypedDict, total=False):
    """How the realizations of an ensemble of runs are drawn and averaged."""

    sampled: str | Iterable[str]
    averaging: Averaging
    axis: Axis


def mse(
    target: ArrayLike, size: Size = 1, *, axis: Axis = "columns", scheme: Scheme = "iid"
) -> float:
    """Mean squared error of the average of ``size`` realizations of a vector or a matrix.

    Parameters
    ----------
    target : (n,) or (n, m) array_like
        The vector or the matrix.
    size : int or None, default 1
        Number of realizations; None or inf: known exactly.
    axis : {"columns", "rows"}, default "columns"
        Which lines of a matrix are sampled; no effect for a vector.
    scheme : {"iid", "systematic"}, default "iid"
        How the realizations are drawn.

    Returns
    -------
    float
        The mean square of the 2-norm (vector) or Frobenius norm (matrix). Independent:
        ``sum_j (g_j^2 - ||a_j||_2^2) / size`` over the sampled lines ``a_j``. Systematic:
        ``sum_j (g_j / size)^2 sum_i f_ij (1 - f_ij)`` with ``f_ij = frac(size |a_ij| / g_j)``; at
        most ``n g^2 / (4 size^2)`` per line, and 0 where every ``size |a_ij| / g_j`` is an integer.

    Raises
    ------
    InputError, InputTypeError
        `target` is not a finite vector or matrix, `size` is not a count, a choice is unknown, or
        the error overflows.

    Notes
    -----
    *Independent* (Lemma 4.1): ``g^2 - ||a||_2^2 = sum_i |a_i| (g - |a_i|)``. Weights ``y`` with sum
    1: the value for ``size=1`` times ``sum(y**2)``.

    *Systematic.* With one ``U`` per line, uniform on [0, 1), and ``c_i = size (p_1 + ... + p_i)``,
    entry i is hit ``N_i = ceil(c_i - U) - ceil(c_{i-1} - U)`` times: ``floor`` or ``ceil`` of
    ``size p_i``, the latter with probability ``f_i``. The error falls like ``1 / size^2``, that of
    independent draws like ``1 / size``. The fractional parts are computed in integers, hence 0
    exactly where they are 0.

    References
    ----------
    W. G. Madow and L. H. Madow, "On the theory of systematic sampling", Ann. Math. Stat. 15, 1944.

    Examples
    --------
    >>> mse([[1.0, 0.0], [2.0, 5.0]])
    4.0
    >>> mse([3.0, -1.0], 6, scheme="systematic"), mse([3.0, -1.0], 8, scheme="systematic")
    (0.2222222222222222, 0.0)
    """
    _, lines, N, systematic = _checked(target, size, axis, scheme)
    with np.errstate(over="ignore", invalid="ignore"):
        if not systematic:
            found = (np.abs(lines) * _sum_of_others(lines)).sum() * _rate(N)
        elif N == 0.0:
            found = 0.0
        else:
            lines = lines.T[lines.any(axis=0)]
            # as integers, each of 36 bytes or more and a pointer: W, N W, remainders, 1 - f, and
            # quotients
            running.need("the fractional parts", 5 * 44 * lines.size)
            W = _whole_numbers(lines)
            f, f_rest = _fractional_parts(N, W, W.sum(axis=1, keepdims=True))
            found = ((np.abs(lines).sum(axis=1) / N) ** 2 * (f * f_rest).sum(axis=1)).sum()
    return float(checked_finite(found, "mean squared error"))


def covariance(
    target: ArrayLike, size: Size = 1, *, axis: Axis = "columns", scheme: Scheme = "iid"
) -> Floats:
    """Covariance of the average of ``size`` realizations of a vector or of each line of a matrix.

    Parameters
    ----------
    target, size, axis, scheme
        As in :func:`mse`.

    Returns
    -------
    (n, n), (m, n, n) or (n, m, m) array
        For a vector ``Cv(w) / size``, ``Cv(w) = ||w||_1 diag|w| - w w^T``; of systematic samples
        ``(g / size)^2 sign(w_i) sign(w_k) Cov(N_i, N_k)``. For a matrix one such covariance per
        sampled line; different lines are independent.

    Raises
    ------
    InputError, InputTypeError
        As :func:`mse`.
    ResourceError
        The covariances do not fit into memory.

    Notes
    -----
    *Independent* (Lemma 4.1): a scaled multinomial covariance. For fixed weights ``y`` with sum 1
    instead of the average, multiply the value for ``size=1`` by ``sum(y**2)``.

    *Systematic.* With ``c_i = size (p_1 + ... + p_i)`` and ``f_i = frac(c_i)``, the counts are
    ``N_i = floor(c_i) - floor(c_{i-1}) + b_i - b_{i-1}`` with ``b_i = 1`` where the offset is
    below ``f_i``; hence ``Cov(b_i, b_k) = min(f_i, f_k) - f_i f_k``. ``size=1`` is a single
    independent draw. The traces add up to :func:`mse`.

    Examples
    --------
    >>> covariance([3.0, -1.0], size=2)
    array([[1.5, 1.5],
           [1.5, 1.5]])
    >>> covariance([3.0, -1.0], size=2, scheme="systematic")
    array([[1., 1.],
           [1., 1.]])
    """
    vector, lines, N, systematic = _checked(target, size, axis, scheme)
    # the result, and the arrays for one line, or the result before and after 1/N
    running.need("the covariances", 8 * lines.shape[0] ** 2 * (2 * lines.shape[1] + 5))
    with np.errstate(over="ignore", invalid="ignore"):
        if systematic:
            found = np.array([_systematic_covariance(line, N) for line in lines.T])
        else:
            found = np.array([_realization_covariance(line) for line in lines.T]) * _rate(N)
    checked_finite(found)
    return np.asarray(found[0] if vector else found, dtype=np.float64)


def _checked(
    target: object, size: object, axis: str, scheme: str
) -> tuple[bool, Floats, float, bool]:
    """Whether it is a vector, its lines as columns, their number, and whether it is systematic."""
    values = validation.array("target", target, ndim=(1, 2))
    validation.choice("axis", axis, types.AXES)
    systematic = validation.choice("scheme", scheme, types.SCHEMES) == "systematic"
    vector = values.ndim == 1
    lines = values[:, None] if vector else lines_of(values, axis)
    return vector, lines, count("size", size), systematic


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
    validation.choice("axis", axis, types.AXES)
    with np.errstate(over="ignore", invalid="ignore"):
        return checked_finite(A @ M @ A.T + _matrix_excess(A, M, axis), "second moment")


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
    validation.choice("axis", axis, types.AXES)
    with np.errstate(over="ignore", invalid="ignore"):
        return checked_finite(_product_covariance(A, x0, 1.0, 1.0, axis))


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
        ``V`` of systematic :func:`covariance`: ``C = V(xf) + A V(x0) A^T + sum_j (x0_j^2 +
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
        B, C = _fused_covariance(system, x0, xf, size, fusion, axis, scheme)
        return _symmetric_product(B.V / B.s, B.U.T @ C @ B.U)


def state_covariance(
    system: System | Any, x0: ArrayLike, xf: ArrayLike, size: Sizes = 1, **law: Unpack[Law]
) -> Floats:
    """Covariance of the state ``x(1) = A x0 + B u`` that the fused control leads to.

    Parameters
    ----------
    system, x0, xf, size
        As in :func:`control_covariance`.
    **law : str
        `fusion`, `axis` and `scheme`, as in :func:`control_covariance`; the control acts on the
        exact system.

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
        B, C = _fused_covariance(system, x0, xf, size, **law)
        return _symmetric_product(B.U, B.U.T @ C @ B.U)


def control_rms(
    system: System | Any, x0: ArrayLike, xf: ArrayLike, size: Sizes = 1, **law: Unpack[Law]
) -> float:
    """Root mean square error ``sqrt(E||u - v*||_2^2)`` of the fused control.

    Parameters
    ----------
    system, x0, xf, size
        As in :func:`control_covariance`.
    **law : str
        `fusion`, `axis` and `scheme`, as in :func:`control_covariance`.

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
    return float(_root_trace(control_covariance(system, x0, xf, size, **law)))


def state_rms(
    system: System | Any, x0: ArrayLike, xf: ArrayLike, size: Sizes = 1, **law: Unpack[Law]
) -> float:
    """Root mean square error ``sqrt(E||B (u - v*)||_2^2)`` of the state after one step.

    Parameters
    ----------
    system, x0, xf, size
        As in :func:`control_covariance`.
    **law : str
        `fusion`, `axis` and `scheme`, as in :func:`control_covariance`.

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
    return float(_root_trace(state_covariance(system, x0, xf, size, **law)))


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
    validation.choice("axis", axis, types.AXES)
    r0, rf, rA = (_rate(N) for N in counts(size))
    best = exact.best_control(A, B, x0, xf, K)
    rank = best.factors.rank
    if rank < n:
        raise InputError(
            f"`steps` must be large enough for C_K to have rank n={n}, got rank {rank} with "
            f"steps={K}: the expansion does not hold there"
        )
    # the powers, and their order that `tensordot` takes; the n matrices G_j, twice
    running.need("the covariance", (2 * n**3 + 2 * (K + 1) * n * n) * 8)
    powers = exact.matrix_powers(A, K)
    with np.errstate(over="ignore", invalid="ignore"):
        x = exact.states(A, B, x0, best.u.reshape(K, -1))[:K]
        C = (
            rf * _realization_covariance(xf)
            + r0 * powers[K] @ _realization_covariance(x0) @ powers[K].T
        )
        carry = powers[K - 1 :: -1]  # carry[k] = A^{K-1-k}
        if axis == "columns":
            G = np.tensordot(x.T, carry, axes=1)
        else:
            G = np.tensordot(carry, x, axes=(0, 0)).transpose(1, 0, 2)
        for line, G_j in zip(A.T if axis == "columns" else A, G, strict=True):
            C += rA * (G_j @ _realization_covariance(line) @ G_j.T)
    return checked_finite(np.asarray((C + C.T) / 2.0, dtype=np.float64))


def trajectory_covariance(
    system: System | Any,
    x0: ArrayLike,
    u: ArrayLike,
    size: Size = 1,
    *,
    sampled: str | Iterable[str] = ("A", "B", "x0"),
    averaging: Averaging = "runs",
    axis: Axis = "columns",
) -> Floats:
    """Covariance of the averaged state of an ensemble, for every step.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``.
    x0 : (n,) array_like
        Initial state.
    u : (K, m) array_like
        The control, the same for all runs; ``u[k]`` acts in the step from k to k + 1.
    size : int or None, default 1
        Number of runs, or of new realizations per step with ``averaging="mean-field"``. 1: the
        covariance of one run. None or inf: no sampling error.
    sampled : str or sequence of str, default ("A", "B", "x0")
        What is sampled, such as "A x0"; the rest is known exactly.
    averaging : {"runs", "mean-field"}, default "runs"
        ``"runs"``: N runs ``x^s(k+1) = A^s_k x^s(k) + B^s_k u(k)`` are averaged at the end.
        ``"mean-field"``: the realizations are averaged in every step,
        ``F_{k+1} = A_hat_k F_k + B_hat_k u(k)``.
    axis : {"columns", "rows"}, default "columns"
        Which lines of ``A`` and ``B`` are sampled.

    Returns
    -------
    (K + 1, n, n) array
        ``[k]`` is the covariance of the average at step k, about the state mu_k of the exact
        system. With ``M_k = S_k + mu_k mu_k^T`` and the excess
        ``X_A(M) = E[A^s M A^sT] - A M A^T`` of
        :func:`second_moment` (``T_A(diag M)`` for columns):

        - one run: ``S_0 = Cv(x0)``, ``S_{k+1} = A S_k A^T + X_A(M_k) + X_B(u_k u_k^T)``; the
          average of N runs has ``S_k / N``;
        - mean-field: ``S_0``, ``X_A`` and ``X_B`` are divided by N in the recursion.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, a choice is unknown, or a covariance
        overflows.
    ResourceError
        The covariances do not fit into memory.

    Notes
    -----
    Exact for new, independent realizations in every run and step; the bound of Lemma 4.3 does not
    depend on K. In the long run the trace grows by a constant factor per step, whether or not the
    state does. With averaging="mean-field" that factor is much smaller: prefer it for K > 1.

    Examples
    --------
    >>> system = [[1.0, 0.0], [2.0, 5.0]], [[1.0], [1.0]]
    >>> S = trajectory_covariance(system, [1.0, 0.0], [[1.0]], 10)
    >>> S.shape, S[1]
    ((2, 2, 2), array([[ 0.3, -0.3],
           [-0.3,  0.3]]))
    """
    checked, x0, u = checked_motion(system, x0, u)
    A, B, n = checked.A, checked.B, checked.n
    per_step = validation.choice("averaging", averaging, types.AVERAGINGS) == "mean-field"
    validation.choice("axis", axis, types.AXES)
    reciprocal = _rate(count("size", size))
    step = reciprocal if per_step else 1.0
    drawn = validation.subset("sampled", sampled, ("A", "B", "x0"))
    rA, rB, r0 = (step * (name in drawn) for name in ("A", "B", "x0"))
    mu = exact.states(A, B, x0, u)
    running.need("the covariances", (len(u) + 5) * n * n * 8)  # and four products of a step
    S = np.empty((len(u) + 1, n, n))
    with np.errstate(over="ignore", invalid="ignore"):
        S[0] = r0 * _realization_covariance(x0)
        for k, u_k in enumerate(u):
            # X_A(M_k) = X_A(S_k) + X_A(mu_k mu_k^T)
            from_A = _matrix_excess(A, S[k], axis) + _vector_excess(A, mu[k], axis)
            S[k + 1] = A @ S[k] @ A.T + rA * from_A + rB * _vector_excess(B, u_k, axis)
    checked_finite(S)
    return S if per_step else reciprocal * S


def trajectory_rms(
    system: System | Any, x0: ArrayLike, u: ArrayLike, size: Size = 1, **law: Unpack[RunsLaw]
) -> Floats:
    """Root mean square error of the averaged state of an ensemble, for every step.

    Parameters
    ----------
    system, x0, u, size
        As in :func:`trajectory_covariance`.
    **law : str
        `sampled`, `averaging` and `axis`, as in :func:`trajectory_covariance`.

    Returns
    -------
    (K + 1,) array
        ``sqrt(E||x_bar(k) - x(k)||_2^2)``, the root of the trace of the covariance at step k.

    Raises
    ------
    InputError, InputTypeError, ResourceError
        As :func:`trajectory_covariance`.

    Examples
    --------
    A rotation: the state keeps its norm, the mean square error of one run is ``2^(k+1) - 1``.

    >>> import numpy as np
    >>> H = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2)
    >>> rms = trajectory_rms((H, np.zeros((2, 1))), [0.5**0.5, 0.5**0.5], np.zeros((3, 1)))
    >>> (rms**2).round(6)
    array([ 1.,  3.,  7., 15.])
    """
    return _root_trace(trajectory_covariance(system, x0, u, size, **law))


# -- sizes and results ----------------------------------------------------------------------------


def count(name: str, size: object) -> float:
    """Check a size; 0 for an entity that is known exactly (None or inf)."""
    if size is None or (isinstance(size, (float, np.floating)) and size == math.inf):
        return 0.0
    return float(validation.size(name, size))


def counts(size: object) -> tuple[float, float, float]:
    """The sizes ``(N0, Nf, NA)`` of one number or three, 0 for what is known exactly."""
    if not isinstance(size, (tuple, list)):
        return (count("size", size),) * 3
    if len(size) != 3:
        raise ShapeError(f"`size` must be one number or (N0, Nf, NA), got {len(size)} numbers")
    N0, Nf, NA = (count(f"size[{k}]", N) for k, N in enumerate(size))
    return N0, Nf, NA


def lines_of(A: Floats, axis: str) -> Floats:
    """``A`` with the sampled lines as columns."""
    return A if validation.choice("axis", axis, types.AXES) == "columns" else A.T


def _rate(N: float) -> float:
    """``1 / N``; 0 for what is known exactly."""
    return 1.0 / N if N else 0.0


def _symmetric_product(F: Floats, C: Floats) -> Floats:
    """``F C F^T``, exactly symmetric."""
    product = F @ C @ F.T
    return checked_finite(np.asarray((product + product.T) / 2.0, dtype=np.float64))


def _root_trace(C: Floats) -> Floats:
    """``sqrt(tr C)`` of one covariance or of each; a trace that rounding makes negative is 0."""
    with np.errstate(over="ignore"):
        trace = checked_finite(np.trace(C, axis1=-2, axis2=-1), "mean squared error")
    return np.asarray(np.sqrt(np.maximum(trace, 0.0)), dtype=np.float64)


# -- formulas, on checked arrays ------------------------------------------------------------------


def _sum_of_others(lines: Floats) -> Floats:
    """``sum_{k != i} |W_kj|``, which is ``g_j - |W_ij|`` without the subtraction."""
    absolute = np.abs(lines)
    before, after = np.zeros_like(absolute), np.zeros_like(absolute)
    np.cumsum(absolute[:-1], axis=0, out=before[1:])
    after[:-1] = np.cumsum(absolute[:0:-1], axis=0)[::-1]
    return before + after


def _realization_covariance(w: Floats) -> Floats:
    """``Cv(w)`` for one realization."""
    return _column_excess(w[:, None], np.ones(1))


def _column_excess(A: Floats, d: Floats) -> Floats:
    """``T_A(d)``: off the diagonal ``-A diag(d) A^T``, on it ``Phi d``."""
    T: Floats = 0.0 - (A * d) @ A.T  # "0.0 -" rather than "-": zeros stay +0.0
    np.fill_diagonal(T, (np.abs(A) * _sum_of_others(A)) @ d)
    return T


def _centred(values: Floats, weights: Floats) -> Floats:
    """Subtract from every row of values its weighted mean.

    The value with the largest weight is subtracted first, and is then exactly 0, so that the
    squares ``g sum_j w_j (v_j - mean)^2 = sum_{j<k} w_j w_k (v_j - v_k)^2`` keep their relative
    accuracy.
    """
    heaviest = weights.argmax(axis=1, keepdims=True)
    y = values - np.take_along_axis(values, heaviest, axis=1)
    total = weights.sum(axis=1, keepdims=True)
    mean = (weights * y).sum(axis=1, keepdims=True) / np.where(total > 0.0, total, 1.0)
    return np.asarray(y - mean, dtype=np.float64)


def _matrix_excess(A: Floats, M: Floats, axis: str) -> Floats:
    """``E[A^s M A^sT] - A M A^T``."""
    diagonal = np.diagonal(M)
    if axis == "columns":
        return _column_excess(A, diagonal)
    # Rows are independent of each other: only the diagonal entries differ. They are
    # sum_j |a_ij| (rho_i - |a_ij|) M_jj - sum_{j != k} a_ij a_ik M_jk.
    apart = M - np.diag(diagonal)
    return np.diag((np.abs(A) * _sum_of_others(A.T).T) @ diagonal - ((A @ apart) * A).sum(axis=1))


def _vector_excess(A: Floats, x: Floats, axis: str) -> Floats:
    """``Cov(A^s x)``, which is `_matrix_excess` for ``M = x x^T``."""
    if axis == "columns":
        return _column_excess(A, x * x)
    # sum_{j<k} |a_ij| |a_ik| (s_ij x_j - s_ik x_k)^2
    weights = np.abs(A)
    squares = (weights * _centred(np.sign(A) * x, weights) ** 2).sum(axis=1)
    return np.diag(weights.sum(axis=1) * squares)


def _whole_numbers(values: Floats) -> NDArray[Any]:
    """Integers W of any size with ``|values| = W 2^e`` exactly, e constant along the last axis."""
    mantissas, exponents = np.frexp(np.abs(values))
    least = exponents.min(axis=-1, keepdims=True, where=values != 0.0, initial=2000)
    shifts = np.where(values == 0.0, 0, exponents - least)
    return np.asarray(np.ldexp(mantissas, 53).astype(np.int64).astype(object) << shifts)


def _fractional_parts(N: float, parts: NDArray[Any], whole: NDArray[Any]) -> tuple[Floats, Floats]:
    """``f = frac(N parts / whole)`` and ``1 - f`` of integers, each correct to its last digit."""
    remainders = int(N) * parts % whole
    f, rest = remainders / whole, (whole - remainders) / whole
    return f.astype(np.float64), rest.astype(np.float64)


def _systematic_covariance(w: Floats, N: float) -> Floats:
    """Covariance of the average of N systematic samples of a vector; N = 0: known exactly."""
    if N == 0.0 or not w.any():
        return np.zeros((w.size, w.size))
    W = _whole_numbers(w)
    # f_i = frac(N |w_i| / g), phi_i = frac(N (p_1 + ... + p_i)), psi = 1 - phi
    f, f_rest = _fractional_parts(N, W, W.sum())
    phi, psi = _fractional_parts(N, np.cumsum(W), W.sum())
    both = np.minimum.outer(phi, phi) * np.minimum.outer(psi, psi)  # Cov(b_i, b_k)
    covariance = np.diff(np.diff(both, axis=0, prepend=0.0), axis=1, prepend=0.0)
    # |Cov(N_i, N_k)| <= sd(N_i) sd(N_k), also where the differences are rounding: 0 where N p_i is
    # an integer
    sd = np.sqrt(f * f_rest)
    most = np.outer(sd, sd)
    covariance = np.clip(covariance, -most, most)
    np.fill_diagonal(covariance, f * f_rest)
    # scaled by a power of two, hence exactly, so that g^2 does not overflow
    exponent = np.frexp(np.abs(w).max())[1]
    scale = float(np.ldexp(np.abs(w), -exponent).sum()) / N
    covariance = scale * scale * covariance * np.outer(np.sign(w), np.sign(w))
    return np.asarray(np.ldexp(covariance, 2 * exponent), dtype=np.float64)


def _systematic_excess(A: Floats, C0: Floats, x: Floats, N: float, axis: str) -> Floats:
    """``E[A_hat M A_hat^T] - A M A^T``, ``M = C0 + x x^T``, for N systematic samples."""
    if axis == "columns":  # sum_j M_jj Cov(a_hat_j)
        weights = C0.diagonal() + x * x
        covariances = (_systematic_covariance(line, N) for line in A.T)
        return np.asarray(sum(m * C for m, C in zip(weights, covariances, strict=True)))
    signs = np.sign(A)
    moved = signs * _centred(signs * x, np.abs(A))  # the covariance of a line times its signs is 0
    V = [_systematic_covariance(line, N) for line in A]
    return np.diag([(C * C0).sum() + y @ C @ y for C, y in zip(V, moved, strict=True)])


def _product_covariance(A: Floats, x0: Floats, r0: float, rA: float, axis: str) -> Floats:
    """``Cov(A_hat x0_hat)`` for ``1/r0`` realizations of ``x0`` and ``1/rA`` of ``A``."""
    # A Cv(x0) A^T = g sum_i |x_i| y_i y_i^T, y_i = sign(x_i) A e_i minus its mean
    absolute = np.abs(x0)
    Y = _centred(A * np.sign(x0), np.broadcast_to(absolute, A.shape))
    from_x0 = r0 * (absolute.sum() * ((Y * absolute) @ Y.T))
    from_both = r0 * rA * _matrix_excess(A, _realization_covariance(x0), axis)
    return np.asarray(from_x0 + rA * _vector_excess(A, x0, axis) + from_both, dtype=np.float64)


def _fused_covariance(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: Sizes,
    fusion: str = "product",
    axis: str = "columns",
    scheme: str = "iid",
) -> tuple[_core.Factors, Floats]:
    """``B`` and the covariance of ``xf_hat - A_hat x0_hat`` (diagonal: of the average pair)."""
    checked, x0, xf = checked_ends(system, x0, xf)
    A, B = checked.A, exact.factors(checked.B)
    validation.choice("axis", axis, types.AXES)
    N0, Nf, NA = sizes = counts(size)
    paired = validation.choice("fusion", fusion, types.FUSIONS) == "diagonal"
    if validation.choice("scheme", scheme, types.SCHEMES) == "systematic":
        if paired:
            raise InputError("`fusion` must be 'product' with scheme='systematic', got 'diagonal'")
        C, C0 = _systematic_covariance(xf, Nf), _systematic_covariance(x0, N0)
        # Given x0_hat, A_hat x0_hat has the covariance of A_hat at x0_hat; E[x0_hat x0_hat^T] = M.
        if NA:
            C = C + _systematic_excess(A, C0, x0, NA, axis)
        return B, np.asarray(C + A @ C0 @ A.T, dtype=np.float64)
    total = 1.0
    if paired:  # N independent pairs: the covariance of one pair over N; exact entities stay exact
        sampled = set(sizes) - {0.0}
        if len(sampled) > 1:
            raise InputError(
                "`size` must be one number with fusion='diagonal', which pairs the realizations, "
                f"got N0, Nf, NA = {', '.join(f'{N:.0f}' if N else 'None' for N in sizes)}"
            )
        total = _rate(max(sampled, default=0.0))
        N0, Nf, NA = (float(N > 0.0) for N in sizes)
    of_xf = _rate(Nf) * _realization_covariance(xf)
    C = of_xf + _product_covariance(A, x0, _rate(N0), _rate(NA), axis)
    return B, np.asarray(total * C, dtype=np.float64)
