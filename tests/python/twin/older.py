"""Runs of an older plant with a declared difference, in NumPy, from the statements alone.

Rows are pairs: zeta and Z (N, d), Y (N, n); two of each, of the newer and the older plant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .pilot import powers, wcs

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pooled:
    """``H - Theta = Sigma^(1/2) Gamma T + (Theta_old - Theta) B``."""

    H: Array
    T: Array
    B: Array
    white: Array  # R N_0^-1: g = white z0


def pooled(zeta: list[Array], Z: list[Array], Y: list[Array], q: float) -> Pooled:
    """The model with weight q of the older pairs."""
    weights = 1.0, q
    each = list(zip(weights, zeta, Z, Y, strict=True))
    N = sum(w * z.T @ s for w, s, z, _ in each)
    N0 = sum(w * s.T @ s for w, s, _, _ in each)
    R = np.linalg.cholesky(sum(w**2 * s.T @ s for w, s, _, _ in each)).T
    H = sum(w * y.T @ s for w, s, _, y in each) @ np.linalg.inv(N)
    B = q * Z[1].T @ zeta[1] @ np.linalg.inv(N)
    return Pooled(H, R @ np.linalg.inv(N), B, R @ np.linalg.inv(N0))


def moved(A: Array, first: list[Array]) -> Array:
    """``sum_j A^(K-1-j) v_j`` of vectors, or of matrices with columns of their own."""
    return sum(P @ v for P, v in zip(powers(A, len(first))[::-1], first, strict=True))


def ball(A: Array, left: Array, seen: Array, eta: float) -> tuple[float, float]:
    """Bounds over ``||D||_2 <= eta`` of ``||sum_j A^(K-1-j) diag(left) D b_j||``: two formulas."""
    n, d, K = len(A), seen.shape[1], len(seen)
    Ps = [P * left for P in powers(A, K)[::-1]]
    terms = [np.kron(b[None, :], P) for b, P in zip(seen, Ps, strict=True)]
    size = float(np.linalg.norm(sum(terms), 2))
    lengths = [float(np.linalg.norm(b)) for b in seen]
    return eta * np.sqrt(min(n, d)) * size, eta * wcs(Ps, lengths)


def worst(A: Array, left: Array, seen: Array, gen: np.random.Generator) -> tuple[float, Array]:
    """The largest ``||sum_j A^(K-1-j) diag(left) D b_j||`` over ``||D||_2 <= 1``, and its D."""
    best, found = -1.0, np.zeros((len(A), seen.shape[1]))
    Ps = [P * left for P in powers(A, len(seen))[::-1]]
    for _ in range(5):
        side = gen.standard_normal(len(A))
        for _ in range(60):
            side = side / np.linalg.norm(side)
            U, _, Vt = np.linalg.svd(
                sum(np.outer(P.T @ side, b) for P, b in zip(Ps, seen, strict=True)),
                full_matrices=False,
            )
            D = U @ Vt
            side = moved(A, [left * (D @ b) for b in seen])
        if (size := float(np.linalg.norm(side))) > best:
            best, found = size, D
    return best, found
