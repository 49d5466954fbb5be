"""Covariances of controls and of the states they lead to."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..._base.types import Axis, Floats, Fusion, Scheme
from ...system import System
from ..formulas import Sizes, compact_svd, fused_covariance, root_trace, symmetric_product


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
