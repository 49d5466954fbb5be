"""Quantiles of the roots that measure the error of least squares with Gaussian noise.

G (n, d) is standard normal and E_nu an independent Wishart matrix W_n(I, nu). The largest root of
E_nu^-1 G G' is Roy's (1953), that of G G' the largest root of a Wishart matrix. Both laws are
the Pfaffian of a small matrix of incomplete beta or gamma functions (Chiani 2014, 2016), which
double precision can evaluate up to about 10 rows: `roy_fault` and `wishart_fault` say how well.
Beyond, `polynomial_roots` has the same laws. For traces and joint sets, and where both fail, all
roots are drawn with 2 p - 1 beta variables (Edelman and Sutton 2008).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import polynomial_roots
from .laws import chi2_quantile, chi2_upper, f_upper, lower_order_quantile, order_quantile, root
from .laws import scipy as _scipy

Array = NDArray[np.float64]

SEED = 20_140_801  # simulated quantiles are the same in every call
MANY = 2**20  # samples from which on the exact law is slow, and the inequality for rare events good
DRAWS = 100_000
TRUSTED = 1e-2  # a formula is used if its fault is at most this part of delta


# -- exact laws ------------------------------------------------------------------------------------


def roy_cdf(theta: float, p: int, d: int, nu: int) -> float:
    """P(lam / (1 + lam) <= theta) for the largest root lam of E_nu^-1 G G', G (p, d), nu >= p.

    With m = (d - p - 1) / 2, k = (nu - p - 1) / 2 and B_i = beta(theta; m + i, k + 1):
    C sqrt(det A), A skew with A_ij = B_i B_j - 2 b_ij, where b_ii = B_i^2 / 2 and
    b_{i,j+1} = ((m + j) b_ij - beta(theta; 2 m + i + j, 2 k + 2)) / (m + j + k + 1);
    for odd p bordered by the B_i (Chiani 2016). Rounding: see `roy_fault`; noise far below the
    median.
    """
    if p > d:
        p, d, nu = d, p, nu + d - p
    special = _scipy().special

    def beta(a: float, b: float) -> float:  # incomplete, not divided by the complete one
        return float(special.betainc(a, b, theta) * special.beta(a, b))

    m, k = (d - p - 1) / 2.0, (nu - p - 1) / 2.0
    B = [beta(m + i, k + 1.0) for i in range(1, p + 1)]
    A = np.zeros((p + p % 2, p + p % 2))
    for i in range(1, p + 1):
        b = B[i - 1] ** 2 / 2.0
        for j in range(i, p):
            b = ((m + j) * b - beta(2.0 * m + i + j, 2.0 * k + 2.0)) / (m + j + k + 1.0)
            A[i - 1, j] = B[i - 1] * B[j] - 2.0 * b
        if p % 2:
            A[i - 1, p] = B[i - 1]
    lg, r = special.gammaln, np.arange(1, p + 1)
    C = (p / 2.0) * np.log(np.pi) + np.sum(
        lg((r + 2.0 * m + 2.0 * k + p + 2.0) / 2.0)
        - lg(r / 2.0)
        - lg((r + 2.0 * m + 1.0) / 2.0)
        - lg((r + 2.0 * k + 1.0) / 2.0)
    )
    return _root_of_determinant(A - A.T, float(C))


def wishart_cdf(x: float, p: int, d: int) -> float:
    """P(largest root of G G' <= x), G (p, d), order irrelevant.

    With a = (d - p - 1) / 2 and P(s, y) the regularised lower gamma function: K sqrt(det A),
    A_ij = P(a + i, x/2) P(a + j, x/2) - 2 b_ij, b_ii = P(a + i, x/2)^2 / 2, b_{i,j+1} = b_ij -
    2^-(2a+i+j) Gamma(2a+i+j) / (Gamma(a+j+1) Gamma(a+i)) P(2a+i+j, x), for odd p bordered by
    P(a + i, x/2), and K = pi^(p/2) prod_i Gamma(a + i) / (Gamma((d - i + 1) / 2) Gamma(i / 2))
    up to a power of 2 (Chiani 2014).
    """
    if p > d:
        p, d = d, p
    special = _scipy().special
    a = (d - p - 1) / 2.0
    P = [float(special.gammainc(a + i, x / 2.0)) for i in range(1, p + 1)]
    lg = special.gammaln
    A = np.zeros((p + p % 2, p + p % 2))
    for i in range(1, p + 1):
        b = P[i - 1] ** 2 / 2.0
        for j in range(i, p):
            s = 2.0 * a + i + j
            log = -s * np.log(2.0) + lg(s) - lg(a + j + 1.0) - lg(a + i)
            b -= np.exp(log) * special.gammainc(s, x)
            A[i - 1, j] = P[i - 1] * P[j] - 2.0 * b
        if p % 2:
            A[i - 1, p] = P[i - 1]
    r = np.arange(1, p + 1)
    # pi^(p^2/2) 2^(a p + p (p + 1)/2) prod Gamma(a + i) / (2^(p d/2) Gamma_p(d/2) Gamma_p(p/2));
    # the powers of 2 cancel, as do those of pi in Gamma_p but pi^(p/2).
    K = (p / 2.0) * np.log(np.pi) + np.sum(lg(a + r) - lg((d - r + 1) / 2.0) - lg(r / 2.0))
    return _root_of_determinant(A - A.T, float(K))


def _root_of_determinant(A: Array, log_factor: float) -> float:
    sign, log = np.linalg.slogdet(A)
    return float(np.exp(log_factor + 0.5 * log)) if sign > 0 else 0.0


@cache
def roy_fault(n: int, d: int, nu: int) -> float:
    """|F(1) - 1|: the law is a Pfaffian of numbers that nearly cancel, and F(1) must be 1."""
    return _fault(roy_cdf(1.0, n, d, nu))


@cache
def wishart_fault(n: int, d: int) -> float:
    """|F(inf) - 1| of `wishart_cdf`, likewise."""
    return _fault(wishart_cdf(np.inf, n, d))


def _fault(value: float) -> float:
    return abs(value - 1.0) if np.isfinite(value) else np.inf


# -- the beta model --------------------------------------------------------------------------------


def beta_roots(n: int, d: int, nu: int, size: int, gen: np.random.Generator) -> Array:
    """`size` draws of all p = min(n, d) roots of E_nu^-1 G G', (size, p), nu >= n.

    lam = t / (1 - t), t the eigenvalues of B B', B upper bidiagonal with the diagonal
    c_p, c_{p-1} s'_{p-1}, .., c_1 s'_1 and above it -s_p c'_{p-1}, .., -s_2 c'_1, where
    c_k^2 ~ Beta((a + k)/2, (b + k)/2), c'_k^2 ~ Beta(k/2, (a + b + 1 + k)/2), s^2 = 1 - c^2,
    a = d - p, b = nu - p (Edelman and Sutton 2008).
    """
    if n > d:
        n, d, nu = d, n, nu + d - n
    p, a, b = n, d - n, nu - n
    k = np.arange(p, 0, -1)
    c2 = gen.beta((a + k) / 2.0, (b + k) / 2.0, (size, p))
    e2 = gen.beta(k[1:] / 2.0, (a + b + 1 + k[1:]) / 2.0, (size, p - 1))
    diagonal, above = c2.copy(), (1.0 - c2[:, :-1]) * e2  # squares
    diagonal[:, 1:] *= 1.0 - e2
    T = np.zeros((size, p, p))
    i = np.arange(p)
    T[:, i, i] = diagonal
    T[:, i[:-1], i[:-1]] += above
    T[:, i[1:], i[:-1]] = -np.sqrt(diagonal[:, 1:] * above)  # eigvalsh reads this half only
    t = np.clip(np.linalg.eigvalsh(T), 0.0, 1.0 - 1e-16)
    return np.asarray(t / (1.0 - t))


def smallest_wishart_root(n: int, N: int, size: int, gen: np.random.Generator) -> Array:
    """`size` draws of the smallest eigenvalue of W_n(I, N), N >= n.

    Of B B', B bidiagonal of independent chi: N, N - 1, .. degrees on the diagonal, n - 1, .., 1
    beside it (Dumitriu and Edelman 2002).
    """
    i = np.arange(n)
    diagonal = gen.chisquare(N - i, (size, n))
    beside = gen.chisquare(n - 1 - i[:-1], (size, n - 1))
    T = np.zeros((size, n, n))
    T[:, i, i] = diagonal
    T[:, i[1:], i[1:]] += beside
    T[:, i[1:], i[:-1]] = np.sqrt(diagonal[:, :-1] * beside)
    return np.asarray(np.maximum(np.linalg.eigvalsh(T)[:, 0], 0.0))


# -- quantiles -------------------------------------------------------------------------------------


@cache
def roy_quantile(n: int, d: int, nu: int, delta: float) -> float:
    """q with P(largest root of E_nu^-1 G G' <= q) = 1 - delta; infinite for nu < n.

    By the form of the law that is nearer to 1 at the end, if that is within a hundredth of delta;
    else from `DRAWS` draws of the beta model.
    """
    if nu < n:
        return np.inf
    if min(n, d) == 1:  # n = 1: an F ratio; d = 1: Hotelling's
        return (max(n, d) / (nu - n + 1)) * f_upper(delta, max(n, d), nu - n + 1)
    single = roy_quantile(n, 1, nu, delta)  # below: the formula is noise far in the lower tail
    low, high = single / (1.0 + single), 1.0 - 1e-15
    faults = {F: _fault(F(1.0, n, d, nu)) for F in (roy_cdf, polynomial_roots.roy_cdf)}
    best = min(faults, key=lambda F: faults[F])
    if faults[best] <= TRUSTED * delta:
        theta = _inverse(partial(best, p=n, d=d, nu=nu), 1.0 - delta, low, high)
        return theta / (1.0 - theta)
    roots = beta_roots(n, d, nu, DRAWS, np.random.default_rng(SEED))
    return order_quantile(roots[:, -1], delta)


@cache
def wishart_quantile(n: int, d: int, delta: float) -> float:
    """q with P(largest root of G G' <= q) = 1 - delta, G (n, d)."""
    if min(n, d) == 1:
        return chi2_upper(delta, max(n, d))
    high = (np.sqrt(n) + np.sqrt(d) + np.sqrt(2.0 * np.log(2.0 / delta))) ** 2
    low = chi2_upper(delta, max(n, d))
    faults = {F: _fault(F(np.inf, n, d)) for F in (wishart_cdf, polynomial_roots.wishart_cdf)}
    best = min(faults, key=lambda F: faults[F])
    if faults[best] <= TRUSTED * delta:
        return _inverse(partial(best, p=n, d=d), 1.0 - delta, low, float(high))
    G = np.random.default_rng(SEED).standard_normal((DRAWS // 10, n, d))
    return order_quantile(np.linalg.norm(G, 2, axis=(1, 2)) ** 2, delta)


def _inverse(cdf: Callable[[float], float], level: float, low: float, high: float) -> float:
    return root(lambda x: cdf(x) - level, low, high)


@cache
def scalar_quantile(n: int, d: int, nu: int, delta: float) -> float:
    """q with P(largest root of G G' <= q c) = 1 - delta, c ~ chi2_{n nu} independent of G (n, d).

    The mean over c by 200 points of Gauss and Legendre between its 1e-16 quantiles.
    """
    if nu < 1:
        return np.inf
    if n == 1:
        return d * f_upper(delta, d, nu) / nu
    law = _scipy().stats.chi2(n * nu)
    low, high = float(law.ppf(1e-16)), float(law.isf(1e-16))
    x, w = np.polynomial.legendre.leggauss(200)
    c = low + (x + 1.0) * (high - low) / 2.0
    mass = w * (high - low) / 2.0 * law.pdf(c)

    def left(q: float) -> float:
        return float(mass @ [polynomial_roots.wishart_cdf(q * y, n, d) for y in c]) - (1.0 - delta)

    middle = wishart_quantile(n, d, delta) / (n * nu)
    return root(left, 0.1 * middle, 10.0 * middle + wishart_quantile(n, d, delta / 4.0) / low)


@cache
def diagonal_quantile(n: int, d: int, nu: int, delta: float) -> float:
    """q of the largest root of C^-1/2 G G' C^-1/2, C diagonal of n independent chi2_nu; drawn."""
    if nu < 1:
        return np.inf
    gen = np.random.default_rng(SEED)
    draws = DRAWS // 5
    G = gen.standard_normal((draws, n, d)) / np.sqrt(gen.chisquare(nu, (draws, n, 1)))
    return order_quantile(np.linalg.norm(G, 2, axis=(1, 2)) ** 2, delta)


def row_quantile(n: int, d: int, nu: int, delta: float) -> float:
    """q of max_i ||g_i||^2 / c_i, rows g_i of G, c_i ~ chi2_nu.

    (d / nu) F^-1_{d, nu}((1 - delta)^(1/n)).
    """
    if nu < 1:
        return np.inf
    each = -np.expm1(np.log1p(-delta) / n)  # 1 - (1 - delta)^(1/n)
    return d / nu * f_upper(each, d, nu)


@cache
def smallest_quantile(n: int, N: int, delta: float) -> float:
    """a with P(smallest eigenvalue of W_n(I, N) < a) = delta; 0 for N < n. Drawn if it must be.

    For a delta that no draw shows: P(smallest singular value < sqrt N - sqrt n - t) <= exp(-t^2/2)
    (Davidson and Szarek 2001).
    """
    if n > N:
        return 0.0
    rare = delta * (DRAWS + 1) < 1.0
    below = float(max(0.0, np.sqrt(N) - np.sqrt(n) - np.sqrt(-2.0 * np.log(delta))) ** 2)
    if rare and N > MANY:
        return below
    if n == 1:
        return chi2_quantile(delta, N)
    if _fault(polynomial_roots.wishart_cdf(np.inf, n, N)) <= TRUSTED * delta:
        above = partial(polynomial_roots.wishart_cdf, np.inf, n, N)
        return root(lambda a: 1.0 - delta - above(above=a), 0.0, float(chi2_quantile(delta, N)))
    if rare:
        return below
    draws = smallest_wishart_root(n, N, DRAWS, np.random.default_rng(SEED))
    return max(0.0, lower_order_quantile(draws, delta))


class Joint(NamedTuple):
    """Radii that hold together: ||Gamma||_2 <= spectral and ||Gamma||_F <= frobenius."""

    spectral: float
    frobenius: float
    stretch: float  # t: how much the squares are larger than each quantile alone


@cache
def trace_quantile(n: int, d: int, nu: int, delta: float) -> float:
    """q of tr(E_nu^-1 G G'), the trace of Lawley and Hotelling; drawn."""
    return _trace_draws(n, d, nu, delta)[1]


@cache
def joint_radii(n: int, d: int, nu: int, delta: float) -> Joint:
    """Radii for the largest root and the trace of E_nu^-1 G G' in one event of 1 - delta.

    t q_R and t q_T, t the quantile of max(lam_max / q_R, tr / q_T) over the same draws.
    """
    if nu < n:
        return Joint(np.inf, np.inf, 1.0)
    roots, q_T = _trace_draws(n, d, nu, delta)
    q_R = roy_quantile(n, d, nu, delta)
    t = order_quantile(np.maximum(roots[:, -1] / q_R, roots.sum(axis=1) / q_T), delta)
    return Joint(float(np.sqrt(t * q_R)), float(np.sqrt(t * q_T)), t)


def _trace_draws(n: int, d: int, nu: int, delta: float) -> tuple[Array, float]:
    roots = beta_roots(n, d, nu, DRAWS, np.random.default_rng(SEED))
    return roots, order_quantile(roots.sum(axis=1), delta)
