"""What uncertain data do to the best control over limits: bounds on state, input and value.

The true problem is (G, b), the estimated one (G^, b^), with the same limits U, Q and R; u is the
best of the true one, u~ a feasible point, usually the best of the estimated one or close to it.
Bounds are in the norms of the problem: `state` on ||G (u~ - u)||_Q, `input` on ||u~ - u||_R,
`distance` on D = ||u~ - u||_H, D^2 = state^2 + input^2, `value` on J(u~) - J(u). They turn into
2-norms only by 1 / sqrt(lam_min) of the weight, so only where it is definite (`in_two_norm`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .certified_control import _product, state_and_input
from .limited_problems import Problem, matrix, norm, root
from .regions import Region, _times
from .triangle import Fitted, seen

Array = NDArray[np.float64]


class Bounds(NamedTuple):
    """See the head of this file; infinite where there is no bound."""

    state: float
    input: float
    distance: float = np.inf
    value: float = np.inf


def in_two_norm(bound: float, weight: ArrayLike) -> float:
    """||v||_2 <= bound / sqrt(lam_min) for ||v||_W <= bound; infinite for a singular weight."""
    values = np.linalg.eigvalsh(np.asarray(weight, dtype=np.float64))
    definite = values[0] > len(values) * np.finfo(float).eps * values[-1]
    return bound / float(np.sqrt(values[0])) if definite else np.inf


# -- the map is exact, only b moves ----------------------------------------------------------------


def projected(p: Problem, db: ArrayLike) -> float:
    """||P_Q db||_Q: the part of db in the range of G, all that <G du, db>_Q sees."""
    half = root(p.Q)
    U, s, _ = np.linalg.svd(half @ p.G, full_matrices=False)
    keep = s > max(p.G.shape) * np.finfo(float).eps * np.max(s, initial=0.0)
    return float(np.linalg.norm(U[:, keep].T @ (half @ np.asarray(db, dtype=np.float64))))


# -- the map is uncertain --------------------------------------------------------------------------


def map_error(true: Problem, estimated: Problem, u: Array) -> tuple[float, Array]:
    """alpha = ||(G - G^) u - (b - b^)||_Q and c = (G - G^)' Q (G^ u - b^)."""
    dG = true.G - estimated.G
    alpha = norm(dG @ u - (true.b - estimated.b), true.Q)
    return alpha, np.asarray(dG.T @ (true.Q @ (estimated.G @ u - estimated.b)))


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


def in_inverse(c: ArrayLike, R: ArrayLike) -> float:
    """||c||_{R^-1}, R > 0."""
    return float(np.sqrt(np.asarray(c) @ np.linalg.solve(np.asarray(R), np.asarray(c))))


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


# -- a map known by a region -----------------------------------------------------------------------


def _input_size(fitted: Fitted, m: int, R: Array) -> float:
    """sqrt(lam_max(R^(-1/2) (V^-1)_uu R^(-1/2)))."""
    n, d = len(fitted.H), fitted.H.shape[1]
    if not all(seen(fitted, e) for e in np.eye(d)[n : n + m]):
        return np.inf
    half = np.linalg.cholesky(R)
    return float(np.linalg.norm(np.linalg.solve(half, fitted.white[:, n : n + m].T), 2))


def region_step(
    region: Region,
    x0: ArrayLike,
    u: ArrayLike,
    xf: ArrayLike,
    *,
    Q: ArrayLike | None = None,
    R: ArrayLike | None = None,
    rho0: float = 0.0,
    rhof: float = 0.0,
) -> tuple[float, float]:
    """alpha and gamma of one step for all Theta in (Theta - C) V (Theta - C)' <= f S, R > 0.

    alpha = sqrt(f lam_max(Q^(1/2) S Q^(1/2))) ||(x0, u)||_{V^-1}, gamma = sqrt(f r' Q S Q r)
    sqrt(lam_max(R^(-1/2) (V^-1)_uu R^(-1/2))), r = C z - xf. x0 and xf known up to rho0 and rhof
    add ||Q^(1/2)|| (rhof + ||A|| rho0) with ||A|| <= ||A^|| + its radius.
    """
    m, S = region.fitted, region.factor * region.S
    n, inputs = len(m.H), len(np.atleast_1d(u))
    half = root(matrix(Q, n, 1.0))
    z = state_and_input(m, x0, u)
    r = half @ half @ (m.H @ z - np.asarray(xf))
    alpha = _times(float(np.sqrt(np.linalg.norm(half @ S @ half, 2))), m, z)
    gamma = _product(float(np.sqrt(max(r @ S @ r, 0.0))), _input_size(m, inputs, matrix(R, inputs)))
    if rho0 > 0.0:
        size = np.linalg.norm(m.H[:, :n], 2) + _product(
            np.sqrt(np.linalg.norm(S, 2)), _state_size(m)
        )
        alpha += float(np.linalg.norm(half, 2) * size) * rho0
    return alpha + float(np.linalg.norm(half, 2)) * rhof, gamma


def _state_size(fitted: Fitted) -> float:
    """sqrt(||(V^-1)_xx||)."""
    n, d = len(fitted.H), fitted.H.shape[1]
    if not all(seen(fitted, e) for e in np.eye(d)[:n]):
        return np.inf
    return float(np.linalg.norm(fitted.white[:, :n], 2))


def region_steps(
    region: Region, radii: ArrayLike, residuals: ArrayLike, weights: list[Array], R: ArrayLike
) -> tuple[float, float]:
    """alpha and gamma of K steps, R (m, m) the weight of each input.

    `radii` r_1 .. r_K bound the model's states under u~ (`certified_control.several_steps`), and
    `residuals` (K, n) are its states minus the reference. alpha = (sum_k ||Q_k|| r_k^2)^(1/2).
    Block k of c is B' p_(k+1) - B^' p^_(k+1) with p^_K = Q_K r~_K, p^_k = A^' p^_(k+1) + Q_k r~_k;
    delta_k >= ||p_k - p^_k||: delta_K = 0, delta_k = (||A^|| + a) delta_(k+1) + eta_A(p^_(k+1)),
    ||c_k|| <= (||B^|| + b) delta_(k+1) + eta_B(p^_(k+1)), eta(p) = sqrt(f p' S p) ||(V^-1)^(1/2)||.
    """
    m, S = region.fitted, region.factor * region.S
    R = np.asarray(R, dtype=np.float64)
    n, inputs, K = len(m.H), len(R), len(weights)
    A, B = m.H[:, :n], m.H[:, n : n + inputs]
    r = np.asarray(residuals, dtype=np.float64)
    sizes = [np.linalg.norm(Q, 2) for Q in weights]
    alpha = float(np.sqrt(sizes @ np.asarray(radii, dtype=np.float64) ** 2))
    top = float(np.sqrt(np.linalg.norm(S, 2)))
    x, u = _state_size(m), _input_size(m, inputs, np.eye(inputs))
    p, delta, squares = weights[-1] @ r[-1], 0.0, 0.0
    for k in range(K - 1, -1, -1):
        eta = float(np.sqrt(max(p @ S @ p, 0.0)))
        size = float(np.linalg.norm(B, 2)) + _product(top, u)
        squares += (_product(size, delta) + _product(eta, u)) ** 2
        if k > 0:
            size = float(np.linalg.norm(A, 2)) + _product(top, x)
            delta = _product(size, delta) + _product(eta, x)
            p = A.T @ p + weights[k - 1] @ r[k - 1]
    return alpha, float(np.sqrt(squares / np.linalg.eigvalsh(R)[0]))


# -- limits of the state ---------------------------------------------------------------------------


def soft_price(Q: ArrayLike, C: ArrayLike, rho: float) -> float:
    """kappa = sqrt(1 + rho ||C Q^(-1/2)||^2): ||.||_W <= kappa ||.||_Q, Q > 0."""
    X = np.asarray(C) @ np.linalg.inv(root(Q))
    return float(np.sqrt(1.0 + rho * np.linalg.norm(X, 2) ** 2))


def tightened(C: ArrayLike, h: ArrayLike, radii: ArrayLike) -> Array:
    """h - r_k ||C_i||, (K, rows): if C x^(k) is below, C x <= h for all ||x - x^(k)|| <= r_k.

    Radii that depend on the inputs must be those of the inputs that are found: ask again there.
    """
    sizes = np.linalg.norm(np.asarray(C, dtype=np.float64), axis=1)
    return np.asarray(h) - np.outer(np.asarray(radii, dtype=np.float64), sizes)
