r"""Exact errors of tracking a reference with a new estimate of ``A`` in every step.

With ``P = B B^+``, the reference ``r(k)``, ``e = x - r`` and ``D_k = A_hat_k - A``, where
``A_hat_k`` averages N realizations drawn for step k alone:

- feedback, ``u(k) = B^+ (r(k+1) - A_hat_k x(k))``:
  ``e(k+1) = (I - P) A e(k) + d(k) - P D_k x(k)``;
- no feedback, ``u(k) = B^+ (r(k+1) - A_hat_k r(k))``, section 5.2 of the paper:
  ``e(k+1) = A e(k) + d(k) - P D_k r(k)``.

``d(k) = (I - P)(A r(k) - r(k+1))`` is out of reach of any control; it is 0 for a *feasible*
reference. With feedback each step removes the part of the error that the controls reach; without,
errors accumulate by ``A``. Means and second moments of both follow exact recursions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._base import memory, validation
from .._base.types import Floats
from ..exceptions import InputError, NonFiniteError
from ..system import System
from .formulas import (
    Size,
    column_excess,
    compact_svd,
    fused_product_covariance,
    inverse_size,
    realization_covariance,
)

__all__ = ["reference_residuals", "tracking_moments", "tracking_rms"]


def reference_residuals(system: System | Any, reference: ArrayLike) -> Floats:
    """Distance of each step of a reference from the nearest state that a control reaches.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``; ``B`` may have any
        rank.
    reference : (K + 1, n) array_like
        The states to track; K >= 1.

    Returns
    -------
    (K,) array
        ``||(I - P)(r(k+1) - A r(k))||_2``. A reference is feasible if all are 0, to rounding: at
        most 1.5e-8 of ``||r(k+1)|| + ||A r(k)||``.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, or an entry is not finite.

    Notes
    -----
    Every reference is feasible where ``B`` has rank n.

    Examples
    --------
    >>> system = [[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]]
    >>> reference_residuals(system, [[0.0, 1.0], [1.0, 1.0], [5.0, 1.0]])
    array([0., 3.])
    """
    A, B, r = _checked(system, reference)
    with np.errstate(over="ignore", invalid="ignore"):
        d = _unreachable(A, compact_svd(B)[0], r)
    largest = np.abs(d).max(axis=1)
    if not np.isfinite(largest).all():
        raise NonFiniteError("`A` times `reference` overflows: scale the problem down")
    unit = np.where(largest > 0.0, largest, 1.0)
    return np.asarray(unit * np.linalg.norm(d / unit[:, None], axis=1), dtype=np.float64)


def tracking_moments(
    system: System | Any,
    reference: ArrayLike,
    size: Size = 1,
    *,
    feedback: bool = True,
    sample_states: bool = False,
    x0: ArrayLike | None = None,
) -> tuple[Floats, Floats]:
    """Mean and second moment of the tracking error, for every step.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``. ``B`` is known exactly
        and may have any rank.
    reference : (K + 1, n) array_like
        The states to track; K >= 1, feasible or not.
    size : int or None, default 1
        Number of realizations in every step; None or inf: the exact system.
    feedback : bool, default True
        Whether the control uses the measured state; else it uses the reference in its place.
    sample_states : bool, default False
        Whether ``r(k)`` and ``r(k+1)`` are sampled too, with N realizations each and product
        fusion, as in section 5.2 of the paper; with ``feedback=False`` only.
    x0 : (n,) array_like, optional
        The initial state; the first state of the reference by default.

    Returns
    -------
    mean : (K + 1, n) array
        ``E e(k)``; 0 for a feasible reference that starts at `x0`.
    second : (K + 1, n, n) array
        ``S_k = E[e(k) e(k)^T]``.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or the moments overflow; sampled states
        with feedback.

    Notes
    -----
    Feedback and a feasible reference from ``x0 = r(0)``:
    ``S_{k+1} = (I-P) A S_k A^T (I-P) + (1/N) P T_A(diag S_k + r_k * r_k) P``. In general, with
    ``F = (I - P) A`` (no feedback: ``F = A``), ``m = E e`` and the noise covariance ``C_k``:
    ``m_{k+1} = F m_k + d_k``,
    ``S_{k+1} = F S_k F^T + F m_k d_k^T + d_k m_k^T F^T + d_k d_k^T + P C_k P``,
    ``C_k = T_A(E[x_k * x_k]) / N`` with feedback and ``T_A(r_k * r_k) / N`` without; sampled states
    add ``(Cv(r_{k+1}) + A Cv(r_k) A^T) / N + T_A(g |r_k| - r_k * r_k) / N^2``. With sampled states
    and feedback there is no such recursion (it needs ``E|x_i x_j|``): see :func:`tracking_bound`.

    Examples
    --------
    >>> system = [[1.0, 0.0], [2.0, 5.0]], [[1.0, 0.0], [0.0, 1.0]]
    >>> mean, second = tracking_moments(system, [[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]], 10)
    >>> second[1]
    array([[ 0.2, -0.2],
           [-0.2,  0.2]])
    """
    A, B, r = _checked(system, reference)
    start = r[0] if x0 is None else validation.vector("x0", x0, length=r.shape[1])
    reciprocal = inverse_size("size", size)
    fed = validation.flag("feedback", feedback)
    sampled = validation.flag("sample_states", sample_states)
    if fed and sampled:
        raise InputError(
            "`sample_states` must be False with feedback=True: no recursion is known for the "
            "second moments of sampled, measured states; see tracking_bound"
        )
    U = compact_svd(B)[0]
    K, n = len(r) - 1, r.shape[1]
    memory.need("the second moments", (K + 6) * n * n * 8)
    mean, S = np.empty((K + 1, n)), np.empty((K + 1, n, n))
    with np.errstate(over="ignore", invalid="ignore"):
        F = A - U @ (U.T @ A) if fed else A
        d = _unreachable(A, U, r)
        mean[0] = start - r[0]
        S[0] = np.outer(mean[0], mean[0])
        for k in range(K):
            if sampled:
                C = fused_product_covariance(A, r[k], reciprocal, reciprocal, "columns")
                C += reciprocal * realization_covariance(r[k + 1])
            else:
                squares = r[k] * r[k]
                if fed:  # E[x_i^2]; rounding must not make it negative
                    squares = np.maximum(S[k].diagonal() + 2.0 * mean[k] * r[k] + squares, 0.0)
                C = reciprocal * column_excess(A, squares)
            carried = F @ mean[k]
            cross = np.outer(carried, d[k])
            mean[k + 1] = carried + d[k]
            S[k + 1] = F @ S[k] @ F.T + cross + cross.T + np.outer(d[k], d[k])
            S[k + 1] += U @ (U.T @ C @ U) @ U.T
    if not (np.isfinite(S).all() and np.isfinite(mean).all()):
        k = int(np.argwhere(~np.isfinite(S))[0, 0]) if not np.isfinite(S).all() else 0
        raise NonFiniteError(f"the second moment of the tracking error overflows at step {k}")
    return mean, S


def tracking_rms(
    system: System | Any,
    reference: ArrayLike,
    size: Size = 1,
    *,
    feedback: bool = True,
    sample_states: bool = False,
    x0: ArrayLike | None = None,
) -> Floats:
    """Root mean square tracking error, for every step.

    Parameters
    ----------
    system, reference, size, feedback, sample_states, x0
        As in :func:`tracking_moments`.

    Returns
    -------
    (K + 1,) array
        ``sqrt(E||x(k) - r(k)||_2^2)``.

    Raises
    ------
    InputError, InputTypeError
        As :func:`tracking_moments`.

    Examples
    --------
    >>> system = [[1.0, 0.0], [2.0, 5.0]], [[1.0, 0.0], [0.0, 1.0]]
    >>> (tracking_rms(system, [[1.0, 0.0]] * 3, 400) ** 2).round(6)
    array([0.     , 0.01   , 0.01005])
    """
    _, S = tracking_moments(
        system, reference, size, feedback=feedback, sample_states=sample_states, x0=x0
    )
    return np.asarray(np.sqrt(np.maximum(np.trace(S, axis1=1, axis2=2), 0.0)), dtype=np.float64)


def checked_reference(reference: object, names: Sequence[str]) -> Floats:
    """Check a reference of at least one step for the states with these names."""
    n = len(names)
    r = validation.inputs("reference", reference, cols=n, rows="K + 1", empty=False, labels=names)
    if len(r) < 2:
        raise InputError(f"`reference` must have shape (K + 1, {n}) with K >= 1, got {r.shape}")
    return r


def _checked(system: object, reference: object) -> tuple[Floats, Floats, Floats]:
    checked = System.from_any(system)
    return checked.A, checked.B, checked_reference(reference, checked.state_names)


def _unreachable(A: Floats, U: Floats, r: Floats) -> Floats:
    """``d(k) = (I - P)(A r(k) - r(k+1))``, (K, n)."""
    d = r[:-1] @ A.T - r[1:]
    return np.asarray(d - (d @ U) @ U.T, dtype=np.float64)
