"""The inequalities, as formulas of a setting, its rates and a level ``L = log(1/delta)``.

`bousquet` holds for every average of independent terms, `mcdiarmid` and `product_bousquet` for
product fusion, the others for vectors and matrices.
"""

from __future__ import annotations

import math

from .base import Moments, Rates
from .settings import Lines, Product

_SHARE = math.log(10.0)  # level of a tenth of delta, the share of an event that is not the main one


def bousquet(at: Moments, rates: Rates, level: float) -> float:
    """``E + sqrt(2 L (lam + 2 U E)) + U L / 3``: Talagrand's inequality, for many realizations.

    For the supremum of ``<v, average - mean>`` over unit vectors v: E its mean, at most the root
    mean square, ``lam`` the largest variance of a projection, ``U`` the largest deviation of one of
    N independent terms over N. O. Bousquet, "A Bennett concentration inequality and its application
    to suprema of empirical processes", C. R. Acad. Sci. Paris 334, 2002.
    """
    return supremum(at.rms(rates), at.variance(rates), at.farthest(rates) * max(rates), level)


# -- for vectors and matrices ----------------------------------------------------------------------


def weissman(at: Lines, rates: Rates, level: float) -> float:
    """``g sqrt(2 (log(2^n - 2) + L) / N)`` in the 1-norm, n nonzero entries; best for few.

    ``P(||p_hat - p||_1 >= eps) <= (2^n - 2) exp(-N eps^2 / 2)``: T. Weissman et al., "Inequalities
    for the L1 deviation of the empirical distribution", HP Laboratories, HPL-2003-97, 2003. In the
    2-norm the radius is smaller by ``sqrt(2)``: the errors of the frequencies add up to 0, and then
    ``||z||_1 >= sqrt(2) ||z||_2``.
    """
    n = int(at.nonzero.sum())
    # log(2^n - 2), in which n = 0 stands for a vector without randomness
    log_sets = n * math.log(2.0) + math.log1p(-(2.0 ** (1 - n))) if n > 1 else 0.0
    factor = 2.0 if at.norm == "1" else 1.0
    return float(at.g.sum()) * math.sqrt(factor * rates[0] * (log_sets + level))


def bernstein(at: Lines, rates: Rates, level: float) -> float:
    """``U l / 3 + sqrt((U l / 3)^2 + 2 v l)``: matrix Bernstein; best for large matrices.

    ``l = log((n + m) / delta)``, ``v = max(||T_A(1)||_2, max_j (g_j^2 - ||a_j||^2)) / N`` and ``U``
    the largest deviation of one line of one realization, over N: the average is a sum of ``N m``
    independent matrices of rank one. Exact and zero lines do not count in n and m. J. A. Tropp,
    "User-friendly tail bounds for sums of random matrices", Found. Comput. Math. 12, 2012.
    """
    exponent = level + math.log(max(1, sum(at.lines[at.lines.any(axis=1)].shape)))
    linear = math.sqrt(float(at.deviations.max(initial=0.0))) * rates[0] * exponent / 3.0
    return linear + math.sqrt(linear**2 + 2.0 * at.matrix_variance * rates[0] * exponent)


def systematic(at: Lines, rates: Rates, level: float) -> float:
    """``sqrt(sum_j k_j g_j^2) / N``: for systematic samples, never exceeded, for every delta.

    Each of the ``k_j`` nonzero entries of a line is hit ``floor(N p_i)`` or ``ceil(N p_i)`` times.
    """
    return math.sqrt(float((at.nonzero * at.g**2).sum())) * rates[0]


# -- for product fusion ----------------------------------------------------------------------------


def mcdiarmid(at: Product, rates: Rates, level: float) -> float:
    """``E + sqrt(V L)``, E the root mean square, for ``x0_hat`` near ``x0`` or for any ``x0_hat``.

    C. McDiarmid, "On the method of bounded differences", Surveys in Combinatorics, 1989.
    The smaller of two radii: in one ``||x0_hat - x0||`` exceeds its own radius with probability
    ``delta/10``, and the rest of delta is for McDiarmid. For the state this implies the exponent
    ``N t^2 / (gf^2 + 3 g0^2 gA^2)``. The sizes of the entities may differ.
    """
    r0, _, rA = rates
    mean = at.rms(rates)
    surely = differences(mean, at.spread(rates), level)
    if r0 == 0.0 or rA == 0.0:
        return surely
    likely = at.range_A(at.x0) + at.slope_A * _distance(at, r0, level + _SHARE)
    spread = at.spread_linear(rates) + likely**2 * rA / 2.0
    return min(surely, differences(mean, spread, level - math.log(0.9)))


def product_bousquet(at: Product, rates: Rates, level: float) -> float:
    """Bousquet for the linear part, McDiarmid for the rest; best for many realizations.

    ``y_hat - y = [(xf_hat - xf) - A (x0_hat - x0) - (A_hat - A) x0] - (A_hat - A)(x0_hat - x0)``.
    The bracket is the average of N independent terms, one for each index (one size for all):
    Bousquet with 0.8 delta. The rest is O(1/N): with ``||x0_hat - x0|| <= r`` (0.1 delta), given
    ``x0_hat``, McDiarmid with 0.1 delta. With x0 or A exact there is no rest, and Bousquet has all
    of delta.
    """
    r0, rf, rA = rates
    t0, tf, tA, _ = at.traces
    mean = math.sqrt(t0 * r0 + tf * rf + tA * rA)
    constants = mean, at.variance(rates), at.farthest_linear(rates) * max(rates)
    if r0 == 0.0 or rA == 0.0:
        return supremum(*constants, level)
    share = level + _SHARE
    largest_tau = float(at.tau[at.hit].max(initial=0.0))
    rest = differences(math.sqrt(largest_tau * rA), at.slope_A**2 * rA / 2.0, share)
    return supremum(*constants, level - math.log(0.8)) + _distance(at, r0, share) * rest


def _distance(at: Product, r0: float, level: float) -> float:
    """Radius for ``||x0_hat - x0||_2``: the smaller one of Bousquet and Weissman."""
    rates, start = (r0,), at.start
    found = bousquet(start, rates, level), weissman(start, rates, level)
    return start.unit * min(*found, start.cap(rates))


# -- on plain numbers ------------------------------------------------------------------------------


def differences(mean: float, spread: float, level: float) -> float:
    """``E + sqrt(V L)``."""
    return mean + math.sqrt(spread * level)


def supremum(mean: float, variance: float, largest: float, level: float) -> float:
    """``E + sqrt(2 L (lam + 2 U E)) + U L / 3``."""
    return mean + math.sqrt(2.0 * level * (variance + 2.0 * largest * mean)) + largest * level / 3.0
