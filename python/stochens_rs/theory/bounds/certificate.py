"""A bound on the error of a control from the errors of its estimates, without probabilities."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..._base import validation
from ...system import System
from ..formulas import checked_finite, compact_svd


def from_errors(
    system: System | tuple[ArrayLike, ArrayLike],
    x0_hat: ArrayLike,
    *,
    x0_error: float = 0.0,
    xf_error: float = 0.0,
    A_error: float = 0.0,
) -> tuple[float, float]:
    """Bound the error of ``u = B+ (xf_hat - A_hat x0_hat)`` by the errors of its estimates.

    Parameters
    ----------
    system : System or (A_hat, B)
        The estimate (n, n) of the state matrix, and the exact input matrix (n, m), of any rank;
        or whatever `System.from_any` takes.
    x0_hat : (n,) array_like
        The estimate of the initial state.
    x0_error, xf_error : float, default 0.0
        e0 and ef: upper bounds on ``||x0_hat - x0||_2`` and ``||xf_hat - xf||_2``.
    A_error : float, default 0.0
        eA: upper bound on ``||A_hat - A||_2``, such as one on the Frobenius norm.

    Returns
    -------
    state, control : float
        ``||B (u - v*)|| <= ef + ||P A_hat|| e0 + eA (||x0_hat|| + e0)``, ``P = B B+``, and
        ``||u - v*|| <= ||B+|| ef + ||B+ A_hat|| e0 + ||B+|| eA (||x0_hat|| + e0)``, for
        ``v* = B+ (xf - A x0)``.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, an error is negative, or the result
        overflows.

    Notes
    -----
    From the identity ``B (v* - u) = P [(xf - xf_hat) - A_hat (x0 - x0_hat) - (A - A_hat) x0]``:
    the corrected form of the triangle inequality in the proof of Lemma 3.2. It holds for all
    weights, also for those of ALSE and SLSE, whose errors are known.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> bounds.from_errors(([[0.5]], [[2.0]]), [3.0], x0_error=0.1, A_error=0.01)
    (0.081, 0.0405)
    """
    checked = System.from_any(system)
    x0_hat, A_hat = validation.vector("x0_hat", x0_hat, length=checked.n), checked.A
    e0, ef, eA = (
        validation.nonnegative(name, value)
        for name, value in (("x0_error", x0_error), ("xf_error", xf_error), ("A_error", A_error))
    )
    U, s, _ = compact_svd(checked.B)
    if s.size == 0:
        return 0.0, 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        reached = U.T @ A_hat
        free = ef + eA * (float(np.linalg.norm(x0_hat)) + e0)
        state = free + float(np.linalg.norm(reached, 2)) * e0
        control = free / float(s[-1]) + float(np.linalg.norm(reached / s[:, None], 2)) * e0
    return checked_finite(state, "bound"), checked_finite(control, "bound")
