"""Regions for any adapted design: trajectories, closed loop, stopping, for all N at once.

y_t = Theta z_t + w_t, z_t a function of the past, E[exp(l' w_t) | past] <= exp(sigma^2 |l|^2 / 2):
Gaussian noise of covariance <= sigma^2 I, or noise of mean 0 with ||w_t|| <= sigma. With M =
sum w_t z_t', V = sum z_t z_t', V_lam = lam I + V and ld = log det(I + V / lam):

For a fixed matrix L, exp(<L, M> - sigma^2/2 tr(L V L')) is a supermartingale from 1. For L = l g',
l uniform on the sphere and g ~ N(0, I / (sigma^2 lam)), the integral over g is exp(-ld/2 + l' C l)
with C = M V_lam^-1 M' / (2 sigma^2), and the mean over l at least that of exp(c l_1^2), c the
largest eigenvalue of C: 1F1(1/2; n/2; c). By Ville's (1939) inequality, with probability
1 - delta, for all N, ||M V_lam^(-1/2)||^2 <= 2 sigma^2 c*, 1F1(1/2; n/2; c*) = exp(ld/2) / delta.
For n = 1 this is the bound of Abbasi-Yadkori, Pal and Szepesvari (2011); mixtures over g are due to
de la Pena, Klass and Lai (2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stochens_rs._core import smallest_quantile

from .laws import chi2_quantile, log_hyp1f1, root
from .laws import scipy as _scipy
from .regions import Region, bound
from .triangle import Triangle, fit, r_factor

Array = NDArray[np.float64]

GRID = tuple(2.0**j for j in range(-4, 12))  # times the size of z^2 that is expected beforehand


def sphere_level(n: int, ld: float, delta: float) -> float:
    """c* with 1F1(1/2; n/2; c*) = exp(ld / 2) / delta."""
    t = ld / 2.0 - np.log(delta)
    high = t + n / 2.0 * np.log(t + n + 3.0) + 10.0
    return root(lambda c: log_hyp1f1(0.5, n / 2.0, c) - t, 0.0, high)


def one_noise(n: int, delta: float) -> float:
    """r with P(||w|| > r sigma) <= delta for one sub-Gaussian w in n dimensions.

    The mean of exp(s l' w) over the sphere is 0F1(n/2; s^2 ||w||^2 / 4), its expectation at most
    exp(s^2/2): Markov's inequality, with the best s. For n = 1 this is sqrt(2 log(2/delta)) but
    for the second exponential of cosh.
    """
    scipy = _scipy()
    v = n / 2.0 - 1.0

    def log_0f1(y: float) -> float:  # of 0F1(n/2; y^2/4) = Gamma(n/2) (y/2)^-v I_v(y)
        ive = np.log(scipy.special.ive(v, y)) + y
        return float(scipy.special.gammaln(n / 2.0) - v * np.log(y / 2.0) + ive)

    def radius(s: float) -> float:
        level = s * s / 2.0 - np.log(delta)
        return root(lambda r: log_0f1(s * r) - level, 1e-9, (level + 50.0 + 10.0 * n) / s)

    return float(scipy.optimize.minimize_scalar(radius, bounds=(0.1, 50.0), method="bounded").fun)


class Information(NamedTuple):
    """ld and the smallest eigenvalue of V that is not 0, from singular values of R11."""

    ld: float
    smallest: float


def information(data: Triangle, lam: float) -> Information:
    """log det(I + V / lam) and the smallest non-zero eigenvalue of V."""
    s = np.linalg.svd(data.R[: data.d, : data.d], compute_uv=False)
    rank = fit(data).rank
    smallest = float(s[rank - 1] ** 2) if rank else 0.0
    return Information(float(np.sum(np.log1p(s * s / lam))), smallest)


def least_squares_level(
    data: Triangle, delta: float, lams: Sequence[float] = (1.0,), *, frobenius: bool = False
) -> float:
    """rho^2 with ||D V^(1/2)||^2 <= rho^2 sigma^2, D of least squares; J `lams` fixed beforehand.

    M V_lam^-1 M' >= M V^+ M' / (1 + lam / lmin), lmin the smallest eigenvalue of V that is not 0,
    so that no bound on Theta is needed: 2 c* (1 + lam / lmin) for one lam. The mean of J
    supermartingales is one as well, and at least each of them over J: rho^2 = 2 c with

        sum_j exp(-ld_j / 2) 1F1(1/2; n/2; c / (1 + lam_j / lmin)) = J / delta,

    smaller than the best single lam at delta / J. `frobenius`: n ld + 2 log(J / delta) for the
    Frobenius norm instead (entries of L independent), at the best lam.
    """
    n, share = len(data.R) - data.d, delta / len(lams)
    seen = [information(data, lam) for lam in lams]
    if seen[0].smallest == 0.0:
        return np.inf
    ld = np.array([info.ld for info in seen])
    wider = np.array([1.0 + lam / info.smallest for lam, info in zip(lams, seen, strict=True)])
    if frobenius:
        return float(np.min((n * ld - 2.0 * np.log(share)) * wider))

    def left(c: float) -> float:
        terms = [log_hyp1f1(0.5, n / 2.0, c / wide) for wide in wider]
        return float(np.logaddexp.reduce(np.array(terms) - ld / 2.0) + np.log(share))

    t = ld / 2.0 - np.log(share)
    high = np.min((t + n / 2.0 * np.log(t + n + 3.0) + 10.0) * wider)
    return 2.0 * root(left, 0.0, float(high))


def known_noise(
    data: Triangle, sigma: float, delta: float, lams: Sequence[float] = (1.0,)
) -> Region:
    """Theorem A: least squares under a known sub-Gaussian sigma, valid at all N at once."""
    level = least_squares_level(data, delta, lams)
    n = len(data.R) - data.d
    return Region(
        fit(data),
        level,
        sigma**2 * np.eye(n),
        delta,
        "sub-Gaussian noise of known sigma, any design, valid at all N at once",
    )


def gaussian_noise(
    data: Triangle, delta: float, lams: Sequence[float] = (1.0,), *, anytime: bool = False
) -> Region:
    """Theorem B: Gaussian noise of one unknown covariance Sigma, any design, N fixed beforehand.

    Xi = Sigma^(-1/2) W is standard normal and X = Xi Z' V^(-1/2) has ||X||^2 <= rho^2 (delta/2);
    Sigma^(-1/2) S Sigma^(-1/2) = Xi Xi' - X X' >= (a - rho^2) I, a the delta/2 quantile of the
    smallest eigenvalue of W_n(I, N). So D V D' <= rho^2 / (a - rho^2) S; infinite for a <= rho^2.
    `anytime`: the second half is shared as 1 / (N (N + 1)).
    """
    m = fit(data)
    share = delta / 2.0 / (data.N * (data.N + 1) if anytime else 1)
    rho2 = least_squares_level(data, delta / 2.0, lams)
    a = smallest_quantile(len(m.H), data.N, share, 1)
    factor = rho2 / (a - rho2) if a > rho2 else np.inf
    return Region(m, factor, m.S, delta, "Gaussian noise of one covariance, any design")


def scalar_noise(data: Triangle, delta: float, lams: Sequence[float] = (1.0,)) -> Region:
    """Theorem B for Sigma = sigma^2 I, sigma unknown, N fixed beforehand.

    tr S = sigma^2 (||Xi||_F^2 - ||X||_F^2) and ||X||_F^2 <= min(n, rank) rho^2, so sigma^2 <=
    tr S / (chi2_{nN; delta/2} - min(n, rank) rho^2).
    """
    m = fit(data)
    n = len(m.H)
    rho2 = least_squares_level(data, delta / 2.0, lams)
    left = chi2_quantile(delta / 2.0, n * data.N) - min(n, m.rank) * rho2
    factor = rho2 / left if left > 0.0 else np.inf
    S = np.trace(m.S) * np.eye(n)
    return Region(m, factor, S, delta, "Gaussian noise of covariance sigma^2 I, any design")


def universal(data: Triangle, delta: float, *, l0: float, psi: float, nu0: float) -> Region:
    """Gaussian noise of one unknown covariance, any design, all N at once; wide, but early finite.

    The marginal likelihood m under Theta ~ N(0, Sigma x I / l0), Sigma ~ IW(psi I, nu0), over the
    likelihood at the true (Theta, Sigma) is a martingale from 1, and the latter at most the
    supremum over Sigma (Wasserman, Ramdas and Balakrishnan 2020). So det(I + S^-1 D V D') <= rho,
    hence the trace and the largest root are at most rho - 1. The prior is fixed beforehand; the
    region is valid for any.
    """
    f = fit(data)
    d, n, N = data.d, len(data.R) - data.d, data.N
    if f.nu < n:
        return Region(f, np.inf, f.S, delta, "universal")
    lg = _scipy().special.multigammaln
    R11, R12, R22 = data.R[:d, :d], data.R[:d, d:], data.R[d:, d:]
    ld = float(np.sum(np.log1p(np.linalg.svd(R11, compute_uv=False) ** 2 / l0)))
    # Psi = psi I + Y Y' - Y Z' (V + l0 I)^-1 Z Y' = psi I + R22' R22 + what ridge leaves of R12
    prior = np.hstack([np.sqrt(l0) * np.eye(d), np.zeros((d, n))])
    below = r_factor(np.vstack([np.hstack([R11, R12]), prior]))[d:, d:]
    Psi = psi * np.eye(n) + R22.T @ R22 + below.T @ below
    log_m = (
        -n * N / 2.0 * np.log(np.pi)
        - n / 2.0 * ld
        + nu0 * n / 2.0 * np.log(psi)
        - (nu0 + N) / 2.0 * np.linalg.slogdet(Psi)[1]
        + lg((nu0 + N) / 2.0, n)
        - lg(nu0 / 2.0, n)
    )
    log_rho = -2.0 / N * (log_m + np.log(delta) + n * N / 2.0 * (1.0 + np.log(2.0 * np.pi)))
    log_rho += n * np.log(N) - np.linalg.slogdet(f.S)[1]
    return Region(
        f, float(np.expm1(log_rho)), f.S, delta, "Gaussian noise of one covariance, any design"
    )


# -- while data arrive -----------------------------------------------------------------------------


class Look(NamedTuple):
    """`certificate` = ||H z - xf|| + radius ||z||_{V^-1}: of the noise-free step, at all N at once.

    `enough`: the N at which the certificate is expected to reach the tolerance, a forecast and no
    bound; infinite where the model does not reach xf within it.
    """

    certificate: float
    enough: float


def look(
    data: Triangle,
    z: ArrayLike,
    xf: ArrayLike,
    sigma: float,
    delta: float,
    tolerance: float,
    lams: Sequence[float] = GRID,
) -> Look:
    """Certificate at z after any number of looks, and how many pairs the tolerance will need.

    Stopping at the first certificate <= tolerance is valid. Forecast: with V ~ N Gamma,
    N = sigma^2 rho^2(N) ||z||^2_{Gamma^-1} / (tolerance - ||H z - xf||)^2, twice.
    """
    m = fit(data)
    z, xf = np.asarray(z, dtype=np.float64), np.asarray(xf, dtype=np.float64)
    left = float(np.linalg.norm(m.H @ z - xf))
    level = least_squares_level(data, delta, lams)
    step = bound(known_noise(data, sigma, delta, lams), z)
    if left >= tolerance or not np.isfinite(step):
        return Look(left + step, np.inf)
    h2, N = float(np.sum((m.white @ z) ** 2)) * data.N, float(data.N)
    for _ in range(2):
        later = data._replace(R=data.R * np.sqrt(N / data.N))
        level = least_squares_level(later, delta, lams)
        N = sigma**2 * level * h2 / (tolerance - left) ** 2
    return Look(left + step, float(np.ceil(N)))


def look_shares(looks: int, delta: float) -> Array:
    """delta / ((j + 1)(j + 2)) for j = 0..: what exact regions at planned looks may spend each."""
    j = np.arange(looks)
    return np.asarray(delta / ((j + 1.0) * (j + 2.0)))
