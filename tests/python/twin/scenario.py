"""The risk of a worst-case design over N sampled units: bounds at confidence 1 - beta.

P(a fresh unit of the same law misses more than the value) <= eps, except with probability beta over
the N units. d counts all variables, the value too: d = m K + 1. Everything is in logarithms, by the
published sums: no difference 1 - cdf is formed. e = exp(x) is found by its sign change in x.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .laws import root, scipy

Array = NDArray[np.float64]

LOWEST = -690.0  # log of the smallest eps looked for


def log_choose(n: ArrayLike, k: ArrayLike) -> Array:
    """log C(n, k)."""
    g = scipy().special.gammaln
    n, k = np.asarray(n, dtype=np.float64), np.asarray(k, dtype=np.float64)
    return np.asarray(g(n + 1.0) - g(k + 1.0) - g(n - k + 1.0))


def log_sum(terms: ArrayLike) -> float:
    """log sum exp."""
    terms = np.asarray(terms, dtype=np.float64)
    top = np.max(terms)
    return float(top + np.log(np.sum(np.exp(terms - top))))


def log_at_most(N: int, k: int, x: float) -> float:
    """log P(Bin(N, e) <= k), e = exp(x): log sum_{i <= k} C(N, i) e^i (1 - e)^(N - i)."""
    i = np.arange(k + 1)
    return log_sum(log_choose(N, i) + i * x + (N - i) * np.log1p(-np.exp(x)))


def _solve(f: Callable[[float], float]) -> float:
    """exp(x) at the sign change of f; 1 if f is still positive just below x = 0."""
    near_one = -1e-15
    return 1.0 if f(near_one) > 0.0 else float(np.exp(root(f, LOWEST, near_one)))


def a_priori(N: int, d: int, beta: float) -> float:
    """sum_{i < d} C(N, i) e^i (1 - e)^(N - i) = beta, before the data (Campi, Garatti 2008)."""
    return 1.0 if d > N else _solve(lambda x: log_at_most(N, d - 1, x) - np.log(beta))


def required_scenarios(eps: float, d: int, beta: float) -> int:
    """The smallest N for which `a_priori` is at most eps."""
    x, log_beta = float(np.log(eps)), np.log(beta)
    low, high = d - 1, d
    while log_at_most(high, d - 1, x) > log_beta:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if log_at_most(middle, d - 1, x) > log_beta else (low, middle)
    return high


def judged(N: int, k: int, beta: float) -> float:
    """beta / (N + 1) sum_{m=k}^N C(m, k) t^(m-k) = C(N, k) t^(N-k), e = 1 - t.

    k units support the solution; convex and nondegenerate programs (Campi, Garatti 2018).
    """
    m = np.arange(k, N + 1)

    def f(x: float) -> float:
        log_t = np.log1p(-np.exp(x))
        left = np.log(beta) - np.log(N + 1) + log_sum(log_choose(m, k) + (m - k) * log_t)
        return float(log_choose(N, k) + (N - k) * log_t - left)

    return 1.0 if k >= N else _solve(f)


def compression(N: int, k: int, beta: float, r: int = 0) -> float:
    """C(N, k) P(Bin(N - k, e) <= r) = beta / N (Littlestone, Warmuth 1986).

    k units alone give the command; at most r of the others miss more than the threshold.
    """
    shift = float(log_choose(N, k)) + np.log(N) - np.log(beta)
    return 1.0 if k + r >= N else _solve(lambda x: log_at_most(N - k, r, x) + shift)


def relaxed(N: int, k: int, beta: float) -> tuple[float, float]:
    """Lower and upper bound of the risk of a program that pays for violations; k units matter.

    C(N, k) t^(N-k) = beta / 2N sum_{i=k}^{N-1} C(i, k) t^(i-k) + beta / 6N sum_{i=N+1}^{4N} C(i, k)
    t^(i-k), its two roots around t = 1 - k/N (Garatti, Campi 2022). Not after discarding units.
    """
    below, above = np.arange(k, N), np.arange(N + 1, 4 * N + 1)
    base = log_choose(N, k)
    first = np.log(beta / (2 * N)) + log_choose(below, k) - base
    second = np.log(beta / (6 * N)) + log_choose(above, k) - base

    def f(log_t: float) -> float:  # > 0 outside the two roots
        return log_sum(np.concatenate([first + (below - N) * log_t, second + (above - N) * log_t]))

    if k >= N:
        middle, upper = -50.0, 1.0
    else:
        middle = np.log1p(-k / N)
        t = np.exp(root(f, LOWEST, middle))
        upper = float(1.0 - t)
    lower = 0.0 if f(0.0) <= 0.0 else float(-np.expm1(root(f, middle, 0.0)))
    return lower, upper


def discarding(N: int, r: int, d: int, beta: float) -> float:
    """C(r+d-1, r) P(Bin(N, e) <= r + d - 1) = beta, by any rule (Campi, Garatti 2011).

    r is fixed beforehand, and every unit that was left out must violate the final (u, value).
    """
    k = r + d - 1
    shift = float(log_choose(k, r)) - np.log(beta)
    return 1.0 if k >= N else _solve(lambda x: log_at_most(N, k, x) + shift)


def hold_out(N: int, violations: int, beta: float) -> float:
    """P(Bin(N, e) <= violations) = beta: fresh units, any u (Clopper, Pearson 1934)."""
    log_beta = float(np.log(beta))
    return 1.0 if violations >= N else _solve(lambda x: log_at_most(N, violations, x) - log_beta)
