"""Sign-perturbed sums: regions for symmetric noise of any law, and limits for bounded noise.

If the w_t are independent, symmetric and independent of all z_t, the true Theta makes
S_a = sum a_t e_t(Theta) z_t' V^(-1/2), e_t(Theta) = y_t - Theta z_t, equal in law for all sign
vectors a: the rank of ||S_1|| for a = (1, .., 1) among m of them is uniform, so that Theta is in
the set {S_1 not among the q largest} with probability exactly 1 - q / m (Csaji, Campi and Weyer
2015). Not valid with feedback: there z_t itself changes with the signs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .laws import scipy as _scipy
from .regions import Region
from .triangle import Fitted, fit, residuals, triangle

Array = NDArray[np.float64]


def sign_vectors(m: int, N: int, gen: np.random.Generator) -> Array:
    """m - 1 random sign vectors, (m - 1, N); never to be filtered or drawn again."""
    return np.asarray(gen.integers(0, 2, (m - 1, N)) * 2.0 - 1.0)


def statistics(errors: ArrayLike, basis: ArrayLike, signs: ArrayLike) -> Array:
    """||sum_t a_t e_t b_t'||_F for each row a of `signs`, (m - 1,); b_t rows of `basis`."""
    e, b = np.asarray(errors, dtype=np.float64), np.asarray(basis, dtype=np.float64)
    sums = [e.T @ (a[:, None] * b) for a in np.asarray(signs, dtype=np.float64)]
    return np.array([float(np.linalg.norm(S)) for S in sums])


def contains(
    errors: ArrayLike, basis: ArrayLike, signs: ArrayLike, q: int, gen: np.random.Generator
) -> bool:
    """Whether the exact set contains the Theta of these `errors` y_t - Theta z_t.

    `basis`: orthonormal columns spanning those of z. Ties are broken at random.
    """
    e, b = np.asarray(errors, dtype=np.float64), np.asarray(basis, dtype=np.float64)
    own = np.linalg.norm(e.T @ b)
    others = statistics(e, b, signs)
    ties = int(gen.integers(0, np.sum(others == own) + 1))
    return bool(np.sum(others > own) + ties >= q)


def chance_of_infinity(N: int, d: int) -> float:
    """P(one sign vector bounds nothing) for z in general position: 2 P(Bin(N, 1/2) < d)."""
    return float(min(1.0, 2.0 * _scipy().stats.binom.cdf(d - 1, N, 0.5)))


def sign_radius(s: ArrayLike, K: ArrayLike) -> float:
    """max ||X||_F over ||X|| <= ||s - X K||: how far Theta can be while S_1 <= S_a.

    By the S-lemma sqrt(min phi), phi(x) = x ||s||^2 + sum_j x^2 k_j^2 ||s_j||^2 /
    (x (1 - k_j^2) - 1) over x > 1 / min(1 - k_j^2), (k_j, u_j) eigenpairs of K, s_j = s u_j.
    Convex; any x gives a valid radius. For one dimension |s| / (1 - |k|).
    """
    s = np.atleast_2d(np.asarray(s, dtype=np.float64))
    k, U = np.linalg.eigh(np.atleast_2d(np.asarray(K, dtype=np.float64)))
    free = 1.0 - k * k
    if free.min() <= 0.0:
        return np.inf
    sizes = np.sum((s @ U) ** 2, axis=0)
    if not np.any(sizes):
        return 0.0
    lowest = 1.0 / free.min()

    def phi(log_excess: float) -> float:
        x = lowest + np.exp(log_excess)
        # x (1 - k^2) - 1 = (x - lowest)(1 - k^2) + (lowest (1 - k^2) - 1), without cancellation
        below = np.exp(log_excess) * free + np.maximum(lowest * free - 1.0, 0.0)
        return float(x * sizes.sum() + np.sum(x * x * k * k * sizes / below))

    logs = np.linspace(-36.0, 36.0, 145) + np.log(lowest)
    best = int(np.argmin([phi(v) for v in logs]))
    low, high = logs[max(best - 1, 0)], logs[min(best + 1, len(logs) - 1)]
    found = _scipy().optimize.minimize_scalar(
        phi, bounds=(low, high), method="bounded", options={"xatol": 1e-10}
    )
    return float(np.sqrt(found.fun))


def radii(Z: ArrayLike, Y: ArrayLike, signs: ArrayLike) -> Array:
    """The radius r_a of each sign vector in the Frobenius norm of (Theta - H) V^(1/2).

    Infinite iff the z with one of the two signs do not span what all z span: a test of rank.
    """
    Z, Y = np.asarray(Z, dtype=np.float64), np.asarray(Y, dtype=np.float64)
    m = fit(triangle(Z, Y))
    E, b = residuals(Z, Y), Z @ m.white.T
    found = []
    for a in np.asarray(signs, dtype=np.float64):
        short = any(_rank(b[a == sign]) < m.rank for sign in (-1.0, 1.0))
        found.append(
            np.inf if short else sign_radius((a[:, None] * E).T @ b, b.T @ (a[:, None] * b))
        )
    return np.array(found)


def _rank(rows: Array) -> int:
    return int(np.linalg.matrix_rank(rows, tol=1e-10)) if len(rows) else 0


def ellipsoid(Z: ArrayLike, Y: ArrayLike, signs: ArrayLike, q: int) -> Region:
    """A ball around least squares with the exact set in it, level q / m: the q-th largest r_a."""
    m: Fitted = fit(triangle(Z, Y))
    r = np.sort(radii(Z, Y, signs))[::-1][q - 1]
    n, size = len(m.H), len(np.asarray(signs)) + 1
    return Region(
        m, float(r**2), np.eye(n), q / size, "symmetric independent noise, independent of all z"
    )


# -- bounded noise ---------------------------------------------------------------------------------


def bounded_range(Z: ArrayLike, y: ArrayLike, limit: float, z: ArrayLike) -> tuple[float, float]:
    """Smallest and largest theta' z over {theta: |y_t - theta' z_t| <= limit for all t}.

    Certain for noise |w_t| <= `limit`, any design (set membership): two linear programs per row of
    Theta. ValueError if the set is empty: then `limit` is refuted.
    """
    Z, y = np.asarray(Z, dtype=np.float64), np.asarray(y, dtype=np.float64)
    z = np.asarray(z, dtype=np.float64)
    A, b = np.vstack([Z, -Z]), np.concatenate([limit + y, limit - y])
    ends = []
    for sign in (1.0, -1.0):
        found = _scipy().optimize.linprog(sign * z, A, b, bounds=(None, None), method="highs")
        if found.status == 2:
            raise ValueError(f"no theta explains the data with noise up to {limit:g}")
        ends.append(sign * found.fun if found.status == 0 else -sign * np.inf)
    return float(ends[0]), float(ends[1])
