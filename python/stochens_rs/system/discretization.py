"""From ``x' = A x + B u`` to ``x(k+1) = A_d x(k) + B_d u(k)``."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .._base import validation
from .._base.types import Floats
from ..exceptions import InputError

# Coefficients of the (13, 13) Pade approximant of exp, b_k = (26-k)! 13! / (26! k! (13-k)!),
# scaled to integers; theta_13 is the largest 1-norm for which its backward error is below 2^-53.
_PADE = tuple(
    math.factorial(26 - k) // (math.factorial(k) * math.factorial(13 - k)) for k in range(14)
)
_PADE_13 = tuple(float(c // _PADE[13]) for c in _PADE)
_THETA_13 = 5.371920351148152

# Each squaring while a part of the state lasts doubles the relative error of that part: after more
# of them, fewer than about six digits of it would be correct.
_SQUARINGS = 28
_SWEEPS = 100  # each halves the logarithms of what is out of balance


def expm(X: Floats, n: int) -> tuple[Floats, int]:
    """Matrix exponential by scaling and squaring with the (13, 13) Pade approximant.

    Parameters
    ----------
    X : (k, k) array
    n : int
        The size of the block in the upper left corner that is watched.

    Returns
    -------
    (k, k) array
        ``exp(X) = r_13(X / 2^s)^(2^s)`` with the smallest ``s`` such that
        ``||X||_1 / 2^s <= theta_13``. Entries that overflow are inf or nan.
    int
        How many of the s squarings found the exponential of the block with a norm above 1/2.

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
    lasting = 0
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(squarings):
            lasting += not np.abs(result[:n, :n]).sum(axis=0).max() <= 0.5
            result = result @ result
    return np.asarray(result, dtype=np.float64), lasting


def balance(A: Floats) -> NDArray[np.int64]:
    """Exponents e of the states ``x_i = 2^e_i z_i`` in which rows and columns of A are alike.

    Osborne's iteration: with r and c the sums of row and column i beside the diagonal, unit i
    becomes ``(r / c)^(1/2)`` times as large. A state that acts on no other, or that no other acts
    on, is scaled until its sum is below 1, where nothing is left to gain.

    References
    ----------
    E. E. Osborne, "On pre-conditioning of matrices", J. ACM 7(4), 1960.
    """
    beside = np.abs(A)
    np.fill_diagonal(beside, 0.0)
    e = np.zeros(len(A), dtype=np.int64)
    for _ in range(_SWEEPS):
        moved = False
        for i in range(len(A)):
            row, column = float(beside[i].sum()), float(beside[:, i].sum())
            if not row + column > 0.0 or not math.isfinite(row + column):
                continue
            ratio = (row or min(column, 1.0)) / (column or min(row, 1.0))
            k = round(math.log2(ratio) / 2.0)
            if k and math.ldexp(column, k) + math.ldexp(row, -k) < 0.95 * (row + column):
                beside[i], beside[:, i] = np.ldexp(beside[i], -k), np.ldexp(beside[:, i], k)
                e[i] += k
                moved = True
        if not moved:
            break
    return e


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
            # exp(D^-1 A D) = D^-1 exp(A) D: in units of the states that suit A the entries of
            # the exponential have their digits, and only time scales are left in its norm
            e = balance(dt * A)
            augmented[:n, :n] = np.ldexp(dt * A, e - e[:, None])
            # B_d is linear in dt B: its columns are brought to a 1-norm below 1 by powers of two,
            # hence exactly, and then have no part in the norm that chooses the scaling
            short, exponent = np.frexp(dt)
            largest = np.frexp(np.abs(B).max(axis=0))[1]
            scaled = np.ldexp(np.ldexp(B, -largest), -e[:, None])
            more = np.frexp(np.abs(scaled).sum(axis=0))[1]
            augmented[:n, n:] = short * np.ldexp(scaled, -more)
            norm = float(np.abs(augmented[:, :n]).sum(axis=0).max())
            whole, lasting = expm(augmented, n) if norm < np.inf else (augmented, _SQUARINGS + 1)
            if lasting > _SQUARINGS:
                raise InputError(
                    f"`dt` is too large ({dt:g} s) for the time scales of the system: dt A has the "
                    f"norm {norm:.1g} in balanced units, and a part of the state lasts for so long "
                    "that fewer than six digits of it would be right; take a shorter step"
                )
            A_d = np.ldexp(whole[:n, :n], e[:, None] - e)
            B_d = np.ldexp(whole[:n, n:], exponent + largest + more + e[:, None])
    for name, found in (("A", A_d), ("B", B_d)):
        if not np.isfinite(found).all():
            raise InputError(
                f"`dt` is too large ({dt:g} s): {name} of the discretized system is not finite"
            )
    return np.ascontiguousarray(A_d), np.ascontiguousarray(B_d)
