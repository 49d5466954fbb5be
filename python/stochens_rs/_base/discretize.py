"""From ``x' = A x + B u`` to ``x(k+1) = A_d x(k) + B_d u(k)``."""

from __future__ import annotations

import math

import numpy as np

from ..exceptions import InputError
from . import validation
from .types import Floats

# Coefficients of the (13, 13) Pade approximant of exp, b_k = (26-k)! 13! / (26! k! (13-k)!),
# scaled to integers; theta_13 is the largest 1-norm for which its backward error is below 2^-53.
_PADE = tuple(
    math.factorial(26 - k) // (math.factorial(k) * math.factorial(13 - k)) for k in range(14)
)
_PADE_13 = tuple(float(c // _PADE[13]) for c in _PADE)
_THETA_13 = 5.371920351148152

# Each squaring doubles the relative error of an eigenvalue: above this norm, fewer than about six
# digits would be correct.
_NORM_LIMIT = 2.0**30


def expm(X: Floats) -> Floats:
    """Matrix exponential by scaling and squaring with the (13, 13) Pade approximant.

    Parameters
    ----------
    X : (n, n) array

    Returns
    -------
    (n, n) array
        ``exp(X) = r_13(X / 2^s)^(2^s)`` with the smallest ``s`` such that
        ``||X||_1 / 2^s <= theta_13``. Entries that overflow are inf or nan.

    References
    ----------
    N. J. Higham, "The scaling and squaring method for the matrix exponential revisited",
    SIAM J. Matrix Anal. Appl. 26(4), 2005.
    """
    norm = float(np.abs(X).sum(axis=0).max())
    squarings = max(0, math.ceil(math.log2(norm / _THETA_13))) if norm > 0.0 else 0
    X = np.ldexp(X, -squarings)
    b = _PADE_13
    identity = np.eye(X.shape[0])
    X2 = X @ X
    X4 = X2 @ X2
    X6 = X4 @ X2
    # Odd part U and even part V of the numerator; the denominator is V - U.
    U = X @ (
        X6 @ (b[13] * X6 + b[11] * X4 + b[9] * X2)
        + b[7] * X6 + b[5] * X4 + b[3] * X2 + b[1] * identity
    )  # fmt: skip
    V = (
        X6 @ (b[12] * X6 + b[10] * X4 + b[8] * X2)
        + b[6] * X6 + b[4] * X4 + b[2] * X2 + b[0] * identity
    )  # fmt: skip
    # (V - U)^-1 (V + U), in the form that is exact at X = 0 and accurate near it.
    result = identity + 2.0 * np.linalg.solve(V - U, U)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(squarings):
            result = result @ result
    return np.asarray(result, dtype=np.float64)


def discretize(A: Floats, B: Floats, dt: float, method: str) -> tuple[Floats, Floats]:
    """Discrete-time matrices for a step of ``dt`` seconds.

    Parameters
    ----------
    A : (n, n) array
    B : (n, m) array
    dt : float
        Step in seconds.
    method : {"zoh", "euler"}
        ``"zoh"``: exact for inputs held constant over a step,
        ``[[A_d, B_d], [0, I]] = exp(dt [[A, B], [0, 0]])``; A_d depends on A only, and the units of
        an input on its column of B_d only. ``"euler"``: ``A_d = I + dt A``, ``B_d = dt B``, which
        keeps the zeros of ``A`` (``"zoh"`` fills them).

    Returns
    -------
    A_d : (n, n) array
    B_d : (n, m) array

    Raises
    ------
    InputError
        ``dt`` is not a positive number, or is so large that the result overflows or (``"zoh"``)
        has no correct digits; ``method`` is unknown.
    """
    dt = validation.positive("dt", dt)
    n, m = B.shape
    with np.errstate(over="ignore"):
        if validation.choice("method", method, ("zoh", "euler")) == "euler":
            A_d, B_d = np.eye(n) + dt * A, dt * B
        else:
            augmented = np.zeros((n + m, n + m))
            augmented[:n, :n] = dt * A
            if not float(np.abs(augmented).sum(axis=0).max()) <= _NORM_LIMIT:
                raise InputError(
                    f"`dt` is too large ({dt:g} s) for the time scales of the system: the result "
                    "would be rounding only"
                )
            # B_d is linear in dt B: its columns are brought to a 1-norm below 1 by powers of two,
            # hence exactly, and then have no part in the norm that chooses the scaling
            short, exponent = np.frexp(dt)
            largest = np.frexp(np.abs(B).max(axis=0))[1]
            scaled = np.ldexp(B, -largest)
            more = np.frexp(np.abs(scaled).sum(axis=0))[1]
            augmented[:n, n:] = short * np.ldexp(scaled, -more)
            whole = expm(augmented)
            A_d = whole[:n, :n]
            B_d = np.ldexp(whole[:n, n:], exponent + largest + more)
    for name, found in (("A", A_d), ("B", B_d)):
        if not np.isfinite(found).all():
            raise InputError(
                f"`dt` is too large ({dt:g} s): {name} of the discretized system is not finite"
            )
    return np.ascontiguousarray(A_d), np.ascontiguousarray(B_d)
