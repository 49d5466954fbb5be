"""Covariance of the state that a control over several steps leads to, for large N."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..._base import memory, validation
from ..._base.types import AXES, Axis, Floats
from ...exceptions import InputError
from ...system import System
from ..dynamics import checked_ends, checked_steps, matrix_powers, states
from ..exact import best_control
from ..formulas import Sizes, checked_finite, inverse_size, one_each, realization_covariance


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
    memory.need("the covariance", (2 * n**3 + 2 * (K + 1) * n * n) * 8)
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
