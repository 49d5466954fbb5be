"""Scalar laws that the statements about measured data need: quantiles, series, roots.

Distribution functions are SciPy's (extra `dev`), asked for when a function is called. Written out
here are the logarithm of 1F1 and the upper limit of a noncentrality, which SciPy does not have.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def scipy() -> Any:
    """SciPy (it loads its parts when asked), or a message that names the missing package."""
    try:
        import scipy  # type: ignore[import-untyped]
    except ImportError:
        raise ImportError(
            "this part of `stochens_rs.reference` needs SciPy: install `scipy` (extra `dev`)"
        ) from None
    return scipy


def root(f: Callable[[float], float], low: float, high: float) -> float:
    """The point of [low, high] where the monotone f changes its sign, to rounding."""
    if f(low) * f(high) > 0.0:
        raise ValueError(f"no change of sign between {low:g} and {high:g}")
    return float(scipy().optimize.brentq(f, low, high, xtol=1e-300, rtol=8.9e-16, maxiter=500))


def chi2_quantile(probability: float, degrees: float) -> float:
    """x with P(chi2 <= x) = `probability`; 0 without degrees of freedom."""
    if degrees == 0:
        return 0.0
    return float(scipy().stats.chi2.ppf(probability, degrees))


def chi2_upper(delta: float, degrees: float) -> float:
    """x with P(chi2 > x) = `delta`, accurate for small `delta`; 0 without degrees of freedom."""
    if degrees == 0:
        return 0.0
    return float(scipy().stats.chi2.isf(delta, degrees))


def f_upper(delta: float, a: float, b: float) -> float:
    """x with P(F_{a, b} > x) = `delta`."""
    return float(scipy().stats.f.isf(delta, a, b))


def normal_quantile(covariance: Array, delta: float) -> float:
    """t with P(||x|| > t) = `delta` for x ~ N(0, covariance).

    With b = min lam_i, sum lam_i g_i^2 / b is a mixture of chi^2 of n + 2 k degrees with weights
    a_0 = prod sqrt(b / lam_i), a_(k+1) = sum_i h_i / (2 (k + 1)), h_i <- (1 - b / lam_i) (h_i +
    a_k), which are positive with sum 1 (Ruben 1962). Eigenvalues are raised to .001 of the largest.
    """
    values = np.linalg.eigvalsh(covariance)
    top = float(values[-1])
    if top <= 0.0:
        return 0.0
    lam = np.maximum(values[values > 1e-15 * len(values) * top] / top, 1e-3)
    b = float(lam.min())
    weights, h = [float(np.prod(np.sqrt(b / lam)))], np.zeros(len(lam))
    total = weights[0]
    while total < 1.0 - 1e-12 and len(weights) < 30_000:
        h = (1.0 - b / lam) * (h + weights[-1])
        weights.append(float(h.sum()) / (2.0 * len(weights)))
        total += weights[-1]
    degrees = len(lam) / 2.0 + np.arange(len(weights))
    above = scipy().special.gammaincc

    def left(q: float) -> float:
        return float(np.dot(weights, above(degrees, q / (2.0 * b)))) - delta

    high = 1.001 * chi2_upper(delta, len(lam))
    return float(np.sqrt(top * root(left, 1e-6 * high, high)))


def log_hyp1f1(a: float, b: float, c: float) -> float:
    """log 1F1(a; b; c) for 0 < a <= b, c >= 0: all terms (a)_k / (b)_k c^k / k! are positive.

    Summed in logarithms. The ratio of successive terms is at most c / (k + 1), so that what is
    left out after k = K > 2 c is at most twice the term K.
    """
    if a == b:
        return c
    if c == 0.0:
        return 0.0
    special = scipy().special
    k = np.arange(int(2.0 * c + 60.0))
    logs = special.gammaln(a + k) - special.gammaln(a) - special.gammaln(b + k) + special.gammaln(b)
    logs += k * np.log(c) - special.gammaln(k + 1.0)
    top = logs.max()
    return float(top + np.log(np.sum(np.exp(logs - top))))


def noncentrality_limit(x: float, degrees: float, delta: float) -> float:
    """sup {L : P(chi2_degrees(L) <= x) >= delta}, 0 if that set is empty; 0 if degrees = 0.

    An upper limit for L with confidence 1 - delta, from one value x of the noncentral law.
    """
    if degrees == 0 or x <= 0.0:
        return 0.0
    law = scipy().stats

    def left(L: float) -> float:
        p = law.ncx2.cdf(x, degrees, L) if L > 0.0 else law.chi2.cdf(x, degrees)
        return float(p) - delta

    if left(0.0) <= 0.0:
        return 0.0
    high = 1.0
    while left(high) > 0.0:
        high *= 2.0
    return root(left, 0.0, high)
