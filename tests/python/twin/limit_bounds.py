"""What uncertain data do to the best control over limits: bounds on state, input and value.

The true problem is (G, b), the estimated one (G^, b^), with the same limits U, Q and R; u is the
best of the true one, u~ a feasible point, usually the best of the estimated one or close to it.
Bounds are in the norms of the problem: `state` on ||G (u~ - u)||_Q, `input` on ||u~ - u||_R,
`distance` on D = ||u~ - u||_H, D^2 = state^2 + input^2, `value` on J(u~) - J(u).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .limited_problems import Problem, root

Array = NDArray[np.float64]


class Bounds(NamedTuple):
    """See the head of this file; infinite where there is no bound."""

    state: float
    input: float
    distance: float = np.inf
    value: float = np.inf


# -- the map is exact, only b moves ----------------------------------------------------------------


def projected(p: Problem, db: ArrayLike) -> float:
    """||P_Q db||_Q: the part of db in the range of G, all that <G du, db>_Q sees."""
    half = root(p.Q)
    U, s, _ = np.linalg.svd(half @ p.G, full_matrices=False)
    keep = s > max(p.G.shape) * np.finfo(float).eps * np.max(s, initial=0.0)
    return float(np.linalg.norm(U[:, keep].T @ (half @ np.asarray(db, dtype=np.float64))))


# -- the map is uncertain --------------------------------------------------------------------------


def uncertain_map(alpha: float, gamma: float, gap: float = 0.0) -> Bounds:
    """gamma >= ||c||_{R^-1}, gap: Frank-Wolfe gap of u~ in the estimated problem.

    With p = ||G (u~ - u)||_Q and q = ||u~ - u||_R, 2 (p^2 + q^2) <= <J'(u~), u~ - u>
    <= 2 <G' Q a + c, u~ - u> + gap gives p^2 + q^2 <= alpha p + gamma q + gap / 2, a disc; and
    J(u~) - J(u) = <J'(u~), u~ - u> - p^2 - q^2 is largest at (alpha, gamma).
    """
    h2 = alpha**2 + gamma**2
    rho = np.sqrt(h2 + 2.0 * gap)
    sides = ((alpha + rho) / 2.0, (gamma + rho) / 2.0, (np.sqrt(h2) + rho) / 2.0)
    return Bounds(float(sides[0]), float(sides[1]), float(sides[2]), float(h2 + gap))


def uncertain_map_small_weight(
    estimated: Problem, alpha: float, c: float, map_radius: float, gap: float = 0.0
) -> float:
    """D where R is 0 or tiny, c >= ||c||_2, map_radius >= ||Q^(1/2) (G - G^)||.

    H >= l I with l = (sigma_min(Q^(1/2) G^) - map_radius)_+^2 + lam_min(R), so with
    e = alpha + c / sqrt(l): D <= (e + sqrt(e^2 + 2 gap)) / 2.
    """
    X = root(estimated.Q) @ estimated.G
    s = np.linalg.svd(X, compute_uv=False)
    smallest = float(s[-1]) if len(s) == X.shape[1] else 0.0  # a wide G has a kernel
    lowest = max(float(np.linalg.eigvalsh(estimated.R)[0]), 0.0)
    least = max(smallest - map_radius, 0.0) ** 2 + lowest
    e = alpha + (0.0 if c == 0.0 else c / np.sqrt(least) if least > 0.0 else np.inf)
    return float((e + np.sqrt(e * e + 2.0 * gap)) / 2.0)


# -- limits of the state ---------------------------------------------------------------------------


def tightened(C: ArrayLike, h: ArrayLike, radii: ArrayLike) -> Array:
    """h - r_k ||C_i||, (K, rows): if C x^(k) is below, C x <= h for all ||x - x^(k)|| <= r_k.

    Radii that depend on the inputs must be those of the inputs that are found: ask again there.
    """
    sizes = np.linalg.norm(np.asarray(C, dtype=np.float64), axis=1)
    return np.asarray(h) - np.outer(np.asarray(radii, dtype=np.float64), sizes)
