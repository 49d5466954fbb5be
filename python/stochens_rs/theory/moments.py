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
from .._base.types import ArrayLike, Averaging, Axis, Floats, Fusion, Scheme
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
    return _core.mean_square(lines, N, systematic)


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
    running.need("the covariances", 8 * lines.shape[1] * (lines.size + 3 * lines.shape[1]))
    found = _core.line_covariances(lines, N, systematic)
    return found[0] if vector else found


def _checked(
    target: object, size: object, axis: str, scheme: str
) -> tuple[bool, Floats, int, bool]:
    """Whether it is a vector, its lines as rows, their number, and whether it is systematic."""
    values = validation.array("target", target, ndim=(1, 2))
    validation.choice("axis", axis, types.AXES)
    systematic = validation.choice("scheme", scheme, types.SCHEMES) == "systematic"
    vector = values.ndim == 1
    lines = values[None] if vector else lines_of(values, axis)
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
    return _core.second_moment(A, M, validation.choice("axis", axis, types.AXES) == "rows")


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
    law = validation.choice("axis", axis, types.AXES) == "rows", False, False
    return _core.fused_covariance(A, (x0, np.zeros(len(A))), (1, 0, 1), law, None)


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
    return _fused(system, x0, xf, size, True, fusion, axis, scheme)


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
    return _fused(system, x0, xf, size, False, **law)


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
    by_rows = validation.choice("axis", axis, types.AXES) == "rows"
    sizes = counts(size)
    best = exact.best_control(A, B, x0, xf, K)
    rank = best.factors.rank
    if rank < n:
        raise InputError(
            f"`steps` must be large enough for C_K to have rank n={n}, got rank {rank} with "
            f"steps={K}: the expansion does not hold there"
        )
    running.need("the covariance", (n**3 + (K + 8) * n * n) * 8)  # the matrices G_j, the powers
    x = exact.states(A, B, x0, best.u.reshape(K, -1))
    return _core.final_covariance(A, x, xf, sizes, by_rows)


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
    by_rows = validation.choice("axis", axis, types.AXES) == "rows"
    N = count("size", size)
    drawn = validation.subset("sampled", sampled, ("A", "B", "x0"))
    each = N if per_step else 1
    nA, nB, n0 = (each * (name in drawn) for name in ("A", "B", "x0"))
    mu = exact.states(A, B, x0, u)
    running.need("the covariances", (len(u) + 7) * n * n * 8)  # and products of a step
    S = _core.trajectory_covariances(A, B, mu, u, (nA, nB, n0), by_rows)
    return S if per_step else S * (1.0 / N if N else 0.0)


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


def count(name: str, size: object) -> int:
    """Check a size; 0 for an entity that is known exactly (None or inf)."""
    exact = size is None or (isinstance(size, (float, np.floating)) and size == math.inf)
    return 0 if exact else validation.size(name, size)


def counts(size: object) -> tuple[int, int, int]:
    """The sizes ``(N0, Nf, NA)`` of one number or three, 0 for what is known exactly."""
    if not isinstance(size, (tuple, list)):
        return (count("size", size),) * 3
    if len(size) != 3:
        raise ShapeError(f"`size` must be one number or (N0, Nf, NA), got {len(size)} numbers")
    N0, Nf, NA = (count(f"size[{k}]", N) for k, N in enumerate(size))
    return N0, Nf, NA


def lines_of(A: Floats, axis: str) -> Floats:
    """``A`` with the sampled lines as rows."""
    by_rows = validation.choice("axis", axis, types.AXES) == "rows"
    return A if by_rows else np.ascontiguousarray(A.T)


def _root_trace(C: Floats) -> Floats:
    """``sqrt(tr C)`` of one covariance or of each; a trace that rounding makes negative is 0."""
    with np.errstate(over="ignore"):
        trace = checked_finite(np.trace(C, axis1=-2, axis2=-1), "mean squared error")
    return np.asarray(np.sqrt(np.maximum(trace, 0.0)), dtype=np.float64)


def _fused(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    size: Sizes,
    control: bool,
    fusion: Fusion = "product",
    axis: Axis = "columns",
    scheme: Scheme = "iid",
) -> Floats:
    """The covariance of the fused control, or of the state that it leads to."""
    checked, x0, xf = checked_ends(system, x0, xf)
    B = exact.factors(checked.B)
    rows = validation.choice("axis", axis, types.AXES) == "rows"
    sizes = counts(size)
    paired = validation.choice("fusion", fusion, types.FUSIONS) == "diagonal"
    systematic = validation.choice("scheme", scheme, types.SCHEMES) == "systematic"
    if paired and systematic:
        raise InputError("`fusion` must be 'product' with scheme='systematic', got 'diagonal'")
    if paired and len(set(sizes) - {0}) > 1:
        raise InputError(
            "`size` must be one number with fusion='diagonal', which pairs the realizations, "
            f"got N0, Nf, NA = {', '.join(str(N or None) for N in sizes)}"
        )
    law = rows, systematic, paired
    return _core.fused_covariance(checked.A, (x0, xf), sizes, law, (B, control))
