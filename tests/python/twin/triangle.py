"""Measured pairs (z_t, y_t) of y = Theta z + w, kept as one triangle, and least squares from it.

The rows of `Z` (N, d) are z_t = (x, u), or (x, u, 1) with an offset; those of `Y` (N, n) are y_t.
With the triangle R of [Z Y] = Q R, R = [[R11, R12], [0, R22]], everything below is a function of
R and N alone: V = sum z z' = R11' R11 is never formed, since that squares its condition number.

    H = Y' Z (Z' Z)^+,  S = sum (y - H z)(y - H z)',  nu = N - rank Z.

Rank is decided on columns of unit length: the statements do not depend on the units of z.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Triangle(NamedTuple):
    """What is kept of N pairs: R (d + n, d + n), upper triangular, R' R = [Z Y]' [Z Y]."""

    R: Array
    d: int
    N: int


class Fitted(NamedTuple):
    """Least squares and what its error is measured with.

    `white` (rank, d) has white' white = V^+, so that ||z||_{V^+} = ||white z||; `root` (rank, d)
    has root' root = V and root white' = I. `missing` (d, d - rank) spans what the data do not
    show: Theta z is known only if missing' z = 0.
    """

    H: Array
    S: Array
    nu: int
    rank: int
    white: Array
    root: Array
    missing: Array
    ratio: float  # smallest over largest singular value of the scaled columns


def triangle(Z: ArrayLike, Y: ArrayLike) -> Triangle:
    """The triangle of the pairs that are the rows of `Z` and `Y`."""
    Z, Y = np.asarray(Z, dtype=np.float64), np.asarray(Y, dtype=np.float64)
    return Triangle(r_factor(np.hstack([Z, Y])), Z.shape[1], len(Z))


def r_factor(rows: Array) -> Array:
    """R of rows = Q R, square, with a diagonal >= 0; rows of 0 where there are too few."""
    R = np.linalg.qr(rows)[1]
    R = np.vstack([R, np.zeros((rows.shape[1] - len(R), rows.shape[1]))])
    return np.asarray(R * np.where(np.diag(R) < 0.0, -1.0, 1.0)[:, None])


def fit(data: Triangle) -> Fitted:
    """Least squares from the triangle, of any rank.

    R11 = U diag(s) Q' D with the column lengths D: H' = D^-1 Q_r s_r^-1 U_r' R12 and
    S = R22' R22 + R12' (I - U_r U_r') R12; the second term is what a lower rank leaves over.
    """
    d = data.d
    R11, R12, R22 = data.R[:d, :d], data.R[:d, d:], data.R[d:, d:]
    D = np.linalg.norm(R11, axis=0)
    D = np.where(D == 0.0, 1.0, D)
    U, s, Qt = np.linalg.svd(R11 / D)
    rank, missing = null_space(Qt, s, max(data.N, d) * np.finfo(float).eps)
    U, s_r, Q_r = U[:, :rank], s[:rank], Qt[:rank]
    white = (Q_r / s_r[:, None]) / D
    left = R12 - U @ (U.T @ R12)
    S = R22.T @ R22 + left.T @ left
    return Fitted(
        H=(white.T @ (U.T @ R12)).T,
        S=S,
        nu=data.N - rank,
        rank=rank,
        white=white,
        root=(s_r[:, None] * Q_r) * D,
        missing=missing / D[:, None],
        ratio=float(s_r[-1] / s_r[0]) if rank else 0.0,
    )


def null_space(Qt: Array, s: Array, share: float) -> tuple[int, Array]:
    """The rank of M = U diag(s) Qt and an orthonormal basis of its null space (columns).

    Singular values up to share s_1 are taken for rounding. So is a row w of the basis, its number
    i, if M + E with ||E|| <= share s_1 has a null space without it. With a in the range of M' and
    a_i = 1, row i of basis - a w is 0 and E = M a w (basis - a w)^+ makes that the null space,
    ||E|| <= ||M a|| ||w||. The smallest ||M a|| is 1 / ||Qt_r[:, i] / s_r||.
    """
    largest = np.max(s, initial=0.0)
    rank = int(np.sum(s > share * largest))
    basis = Qt[rank:].T.copy()
    for i, w in enumerate(basis):
        if np.linalg.norm(w) <= share * largest * np.linalg.norm(Qt[:rank, i] / s[:rank]):
            basis[i] = 0.0
    return rank, basis


def seen(fitted: Fitted, z: ArrayLike) -> bool:
    """Whether the data determine Theta z: z is in the range of sum z_t z_t'."""
    z = np.asarray(z, dtype=np.float64)
    # each direction against the size of what is added up in it; rounding turns it by eps / ratio
    # (Wedin 1972), of which no more is allowed for than at a ratio of sqrt(eps)
    tolerance = 100.0 * len(z) * np.finfo(float).eps / max(fitted.ratio, 1e-8)
    sizes = np.abs(fitted.missing.T) @ np.abs(z)
    return bool(np.all(np.abs(fitted.missing.T @ z) <= tolerance * sizes))


def leverages(Z: ArrayLike) -> Array:
    """h_t = z_t' V^+ z_t, (N,): the diagonal of the projector on the columns of `Z`."""
    Q = _range(np.asarray(Z, dtype=np.float64))
    return np.asarray(np.sum(Q * Q, axis=1))


def residuals(Z: ArrayLike, Y: ArrayLike) -> Array:
    """y_t - H z_t, (N, n): what the projector on the columns of `Z` leaves of `Y`."""
    Y = np.asarray(Y, dtype=np.float64)
    Q = _range(np.asarray(Z, dtype=np.float64))
    return np.asarray(Y - Q @ (Q.T @ Y))


def _range(Z: Array) -> Array:
    D = np.linalg.norm(Z, axis=0)
    U, s, _ = np.linalg.svd(Z / np.where(D == 0.0, 1.0, D), full_matrices=False)
    return np.asarray(U[:, s > max(Z.shape) * np.finfo(float).eps * s[0]])


# -- pairs from runs -------------------------------------------------------------------------------

Run = tuple[ArrayLike, ArrayLike]  # states (T + 1, n), inputs (T, m)


def pairs(runs: Sequence[Run], *, offset: bool = False) -> tuple[Array, Array]:
    """All pairs ((x(k), u(k)), x(k + 1)) of all runs, one after another."""
    Z, Y = [], []
    for states, inputs in runs:
        x, u = np.asarray(states, dtype=np.float64), np.asarray(inputs, dtype=np.float64)
        one = np.ones((len(u), 1 if offset else 0))
        Z.append(np.hstack([x[:-1], u, one]))
        Y.append(x[1:])
    return np.vstack(Z), np.vstack(Y)


def last_pairs(runs: Sequence[Run]) -> tuple[Array, Array]:
    """The last pair of each run: independent of all noise in Y, also with feedback in the run.

    The runs must be independent, and their lengths chosen without a look at the last state.
    """
    ends = [(np.asarray(x)[-2:], np.asarray(u)[-1:]) for x, u in runs]
    return pairs(ends)
