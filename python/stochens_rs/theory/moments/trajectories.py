"""Means and covariances of simulated ensembles over K steps, and how fast they grow."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..._base import running, validation
from ..._base.types import AVERAGINGS, AXES, Averaging, Axis, Floats
from ...exceptions import NonFiniteError
from ...system.system import System
from ..exact import checked_motion, states
from ..formulas import Size, inverse_size, matrix_excess, realization_covariance, vector_excess


def trajectory_mean(system: System | Any, x0: ArrayLike, u: ArrayLike) -> Floats:
    """Mean of every realization, and of every average, of the state over K steps.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``.
    x0 : (n,) array_like
        Initial state.
    u : (K, m) array_like
        The control; ``u[k]`` acts in the step from k to k + 1. K = 0 is allowed.

    Returns
    -------
    (K + 1, n) array
        ``mu_{k+1} = A mu_k + B u_k`` from ``mu_0 = x0``: the trajectory of the exact system.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or the trajectory overflows.

    Notes
    -----
    Used in Lemma 3.1. The realizations of ``A``, ``B`` and ``x0`` must be independent of each
    other and drawn anew in every step. One ``A^s`` for two steps has
    ``E[(A^s)^2] = A^2 + diag(g_j |a_jj|) - A diag(a_jj)``, not ``A^2``.

    Examples
    --------
    >>> trajectory_mean(([[0.5]], [[1.0]]), [2.0], [[1.0], [0.0]])
    array([[2.],
           [2.],
           [1.]])
    """
    checked, x0, u = checked_motion(system, x0, u)
    return states(checked.A, checked.B, x0, u)


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
        ``[k]`` is the covariance of the average at step k, about :func:`trajectory_mean`. With
        ``M_k = S_k + mu_k mu_k^T`` and the excess ``X_A(M) = E[A^s M A^sT] - A M A^T`` of
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
    per_step = validation.choice("averaging", averaging, AVERAGINGS) == "mean-field"
    validation.choice("axis", axis, AXES)
    reciprocal = inverse_size("size", size)
    step = reciprocal if per_step else 1.0
    drawn = validation.subset("sampled", sampled, ("A", "B", "x0"))
    rA, rB, r0 = (step * (name in drawn) for name in ("A", "B", "x0"))
    mu = states(A, B, x0, u)
    running.need("the covariances", (len(u) + 5) * n * n * 8)  # and four products of a step
    S = np.empty((len(u) + 1, n, n))
    with np.errstate(over="ignore", invalid="ignore"):
        S[0] = r0 * realization_covariance(x0)
        for k, u_k in enumerate(u):
            # X_A(M_k) = X_A(S_k) + X_A(mu_k mu_k^T)
            from_A = matrix_excess(A, S[k], axis) + vector_excess(A, mu[k], axis)
            S[k + 1] = A @ S[k] @ A.T + rA * from_A + rB * vector_excess(B, u_k, axis)
    _finite("covariance", S)
    return S if per_step else reciprocal * S


def trajectory_rms(
    system: System | Any,
    x0: ArrayLike,
    u: ArrayLike,
    size: Size = 1,
    *,
    sampled: str | Iterable[str] = ("A", "B", "x0"),
    averaging: Averaging = "runs",
    axis: Axis = "columns",
) -> Floats:
    """Root mean square error of the averaged state of an ensemble, for every step.

    Parameters
    ----------
    system, x0, u, size, sampled, averaging, axis
        As in :func:`trajectory_covariance`.

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
    S = trajectory_covariance(system, x0, u, size, sampled=sampled, averaging=averaging, axis=axis)
    with np.errstate(over="ignore"):
        squares = _finite("mean squared error", np.trace(S, axis1=1, axis2=2))
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)), dtype=np.float64)


def _finite(what: str, values: Floats) -> Floats:
    finite = np.isfinite(values)
    if not finite.all():
        step = f" at step {int(np.argwhere(~finite)[0, 0])}" if values.ndim else ""
        raise NonFiniteError(
            f"the {what} overflows{step}: scale the problem down or take K smaller"
        )
    return values
