"""Confidence regions for Theta from pairs whose regressors are independent of Gaussian noise.

A region has the form (Theta - C) V (Theta - C)' <= f S in the order of symmetric matrices. Then,
by Cauchy and Schwarz, for all z and l at once, also for z chosen after the data,

    |l' (Theta - C) z| <= sqrt(f l' S l) ||z||_{V^-1},
    ||(Theta - C) z||  <= sqrt(f ||S||_2) ||z||_{V^-1},

and no bound for z off the range of V. With Theta-hat = Theta + D, the law of everything here
follows from D V^(1/2) = Sigma^(1/2) G, S = Sigma^(1/2) E_nu Sigma^(1/2), G standard normal and
independent of E_nu ~ W_n(I, nu) (Anderson 2003, ch. 8).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stochens_rs import _core

from .laws import f_upper
from .triangle import Fitted, Triangle, fit, null_space, seen, triangle

Array = NDArray[np.float64]


class Region(NamedTuple):
    """(Theta - centre) V (Theta - centre)' <= factor S; V as in `fitted`, or its own pair."""

    fitted: Fitted  # centre H, white and root of V, missing directions
    factor: float
    S: Array
    delta: float
    assumption: str


def radius(region: Region) -> float:
    """sqrt(factor ||S||_2): the bound for a z with ||z||_{V^-1} = 1."""
    if not np.isfinite(region.factor):
        return np.inf
    return float(np.sqrt(region.factor * np.linalg.norm(region.S, 2)))


def bound(region: Region, z: ArrayLike) -> float:
    """||(Theta - centre) z|| is at most this, for all z at once."""
    return _times(radius(region), region.fitted, z)


def component_bounds(region: Region, z: ArrayLike) -> Array:
    """|((Theta - centre) z)_i| is at most this, for all i and z at once."""
    if not np.isfinite(region.factor):
        return np.full(len(region.S), _times(np.inf, region.fitted, z))
    deviations = np.sqrt(region.factor * np.diag(region.S))
    return np.array([_times(s, region.fitted, z) for s in deviations])


def _times(factor: float, fitted: Fitted, z: ArrayLike) -> float:
    """factor ||z||, infinite where the data do not determine Theta z, and 0 at z = 0."""
    if not np.any(np.asarray(z)):
        return 0.0
    if not seen(fitted, z):
        return np.inf
    return factor * float(np.linalg.norm(fitted.white @ np.asarray(z, dtype=np.float64)))


def pivot(region: Region, Theta: ArrayLike) -> Array:
    """Eigenvalues of S^-1 (Theta - C) V (Theta - C)', rising."""
    X = (np.asarray(Theta, dtype=np.float64) - region.fitted.H) @ region.fitted.root.T
    X = np.linalg.solve(np.linalg.cholesky(region.S), X)
    return np.asarray(np.linalg.eigvalsh(X @ X.T))


def pivot_in(region: Region, Theta: ArrayLike, Q: ArrayLike) -> Array:
    """Eigenvalues of S^-1 D Q (Q' V^-1 Q)^-1 Q' D', rising: the same for z in the span of `Q`."""
    basis = np.linalg.qr(region.fitted.white @ np.asarray(Q, dtype=np.float64))[0]
    X = (np.asarray(Theta, dtype=np.float64) - region.fitted.H) @ region.fitted.root.T @ basis
    X = np.linalg.solve(np.linalg.cholesky(region.S), X)
    return np.asarray(np.linalg.eigvalsh(X @ X.T))


def contains(region: Region, Theta: ArrayLike) -> bool:
    """Whether the region contains `Theta`."""
    return bool(np.isinf(region.factor) or pivot(region, Theta)[-1] <= region.factor)


# -- the regions -----------------------------------------------------------------------------------


def full(data: Triangle, delta: float, *, future: int = 0) -> Region:
    """Any covariance: lam_max(S^-1 D V D') is Roy's root of (n, rank, nu).

    `future` columns of independent noise w_k may join: lam_max(S^-1 (D V D' + sum w_k w_k')) has
    the law of (n, rank + future, nu), as [D V^(1/2), w] = Sigma^(1/2) G with more columns.
    """
    m = fit(data)
    q = _core.roy_quantile(len(m.H), m.rank + future, m.nu, delta, 1)
    return Region(m, q, m.S, delta, "Gaussian noise of any covariance, independent of all z")


def directions(data: Triangle, Q: ArrayLike, delta: float) -> Region:
    """The region for z in the span of the columns of `Q` (d, r) alone: Roy's root of (n, r, nu).

    V^(-1/2) Q (Q' V^-1 Q)^(-1/2) has orthonormal columns, so G times it is (n, r) standard normal.
    `Q` must be fixed without a look at Y. Off that span nothing is known: `bound` is infinite.
    """
    m = fit(data)
    sizes = np.linalg.norm(data.R[:, : data.d], axis=0)
    sizes = np.where(sizes == 0.0, 1.0, sizes)
    Q = np.asarray(Q, dtype=np.float64) / sizes[:, None]  # ranks in the units of the data
    Q = Q / np.where(Q.any(axis=0), np.linalg.norm(Q, axis=0), 1.0)
    white = m.white * sizes
    r = int(np.linalg.matrix_rank(white / np.linalg.norm(white, axis=1)[:, None] @ Q))
    U, s, _ = np.linalg.svd(Q)
    _, off = null_space(U.T, s, max(Q.shape) * np.finfo(float).eps)
    off = off / sizes[:, None]
    q = _core.roy_quantile(len(m.H), r, m.nu, delta, 1)
    m = m._replace(missing=np.hstack([off, m.missing]))
    return Region(m, q, m.S, delta, "as `full`, z in a span that was fixed without the outcomes")


def diagonal(data: Triangle, delta: float) -> Region:
    """Independent components of noise: lam_max(s^-1/2 D V D' s^-1/2), s = diag(S)."""
    m = fit(data)
    q = _core.diagonal_quantile(len(m.H), m.rank, m.nu, delta, 1)
    S = np.diag(np.diag(m.S))
    return Region(m, q, S, delta, "Gaussian noise of independent components, independent of all z")


def row_bounds(data: Triangle, z: ArrayLike, delta: float) -> Array:
    """Components under independent components of noise: sharper than `diagonal`, (n,).

    |e_i' D z| <= sqrt(q S_ii) ||z||, q = (d / nu) F^-1_{d, nu}((1 - delta)^(1/n)), all i and z.
    """
    m = fit(data)
    q = _core.row_quantile(len(m.H), m.rank, m.nu, delta)
    return np.sqrt(np.diag(m.S)) * _times(float(np.sqrt(q)), m, z)


def scalar(data: Triangle, delta: float) -> Region:
    """Noise of covariance sigma^2 I, sigma unknown: ||D V^(1/2)||^2 / tr S."""
    m = fit(data)
    n = len(m.H)
    q = _core.scalar_quantile(n, m.rank, m.nu, delta, 1)
    S = np.trace(m.S) * np.eye(n)
    return Region(m, q, S, delta, "Gaussian noise of covariance sigma^2 I, independent of all z")


def known(data: Triangle, sigma: float, delta: float) -> Region:
    """Noise of covariance sigma^2 I, sigma known: ||D V^(1/2)||^2 / sigma^2."""
    m = fit(data)
    n = len(m.H)
    q = _core.wishart_quantile(n, m.rank, delta, 1)
    S = sigma**2 * np.eye(n)
    return Region(m, q, S, delta, "Gaussian noise of known sigma, independent of all z")


class JointRegion(NamedTuple):
    """`full` with Frobenius: D = S^(1/2) Gamma V^(-1/2), both norms of Gamma in one event."""

    fitted: Fitted
    spectral: float
    frobenius: float
    delta: float


def joint(data: Triangle, delta: float) -> JointRegion:
    """||Gamma||_2 <= spectral and ||Gamma||_F <= frobenius."""
    m = fit(data)
    radii = _core.joint_radii(len(m.H), m.rank, m.nu, delta, 1)
    return JointRegion(m, *radii, delta)


# -- what is known of Theta beforehand -------------------------------------------------------------


def restricted(Z: ArrayLike, Y: ArrayLike, T: ArrayLike, Theta0: ArrayLike) -> Triangle:
    """Pairs for F when Theta = F T + Theta0: y - Theta0 z against T z. B known: T = [I 0]."""
    Z, Y = np.asarray(Z, dtype=np.float64), np.asarray(Y, dtype=np.float64)
    return triangle(Z @ np.asarray(T).T, Y - Z @ np.asarray(Theta0).T)


class Rows(NamedTuple):
    """Least squares row by row on the entries that may differ from 0."""

    H: Array
    fits: list[Fitted]
    quantiles: Array  # of s_i^-2 ||.||^2, all rows at once
    free: NDArray[np.bool_]


def pattern(Z: ArrayLike, Y: ArrayLike, free: ArrayLike, delta: float) -> Rows:
    """Entries that are not `free` (n, d) are 0; fixed before the data.

    Row i has the regressors P_i: |e_i' D z| <= s_i sqrt(d_i F_{d_i, N - d_i; delta/n})
    ||z_{P_i}||, s_i^2 = RSS_i / (N - d_i). Each row is exact for itself, so the union over rows
    asks nothing of the covariance.
    """
    Z, Y = np.asarray(Z, dtype=np.float64), np.asarray(Y, dtype=np.float64)
    free = np.asarray(free, dtype=bool)
    n = len(free)
    H = np.zeros(free.shape)
    fits, q = [], np.zeros(n)
    for i, own in enumerate(free):
        m = fit(triangle(Z[:, own], Y[:, [i]]))
        q[i] = m.rank * f_upper(delta / n, m.rank, m.nu) / m.nu if m.rank and m.nu else 0.0
        q[i] = np.inf if m.rank and not m.nu else q[i]
        fits.append(m)
    for i, (own, m) in enumerate(zip(free, fits, strict=True)):
        H[i, own] = m.H[0]
    return Rows(H, fits, q, free)


def pattern_bounds(rows: Rows, z: ArrayLike) -> Array:
    """|((Theta - H) z)_i| is at most this, for all i and z at once, (n,)."""
    z = np.asarray(z, dtype=np.float64)
    each = zip(rows.free, rows.fits, rows.quantiles, strict=True)
    return np.array([_times(np.sqrt(q * m.S[0, 0]), m, z[own]) for own, m, q in each])


def root_of(S: ArrayLike) -> Array:
    """A root of S, `root root' = S`; the rounding of each row is relative to its own size."""
    S = np.asarray(S)
    sizes = np.sqrt(np.maximum(np.diag(S), 0.0))[:, None]
    units = np.where(sizes == 0.0, 1.0, sizes)
    values, vectors = np.linalg.eigh(S / units / units.T)
    return np.ascontiguousarray(sizes * vectors * np.sqrt(np.maximum(values, 0.0)))
