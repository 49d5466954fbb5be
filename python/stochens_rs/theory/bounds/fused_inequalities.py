"""The inequalities for fused controls, for the states they lead to, and for one step of runs.

``L = log(1/delta)`` is called the level.
"""

from __future__ import annotations

import math
from itertools import cycle

import numpy as np

from ..formulas import checked_finite, sum_of_others
from .base import Inequality, Rates
from .inequalities import McDiarmid, Weissman, bousquet, mcdiarmid, square, union
from .settings import MOMENT, Lines, OneStep, Product

_SHARE = math.log(10.0)  # level of a tenth of delta, the share of an event that is not the main one


# -- for product fusion ----------------------------------------------------------------------------


class _Bilinear(Inequality):
    """An inequality for product fusion, which needs a radius for ``||x0_hat - x0||``."""

    at: Product

    def __init__(self, at: Product) -> None:
        super().__init__(at)
        start = Lines(at.x0[:, None], "vector", "2")
        self._start = McDiarmid(start), Weissman(start)

    def distance(self, r0: float, level: float) -> float:
        """Radius for ``||x0_hat - x0||_2``: the smaller one of McDiarmid and Weissman."""
        return min(one.at.unit * one.capped((r0,), level) for one in self._start)


class ProductMcDiarmid(_Bilinear):
    """McDiarmid's inequality for ``x0_hat`` near ``x0``, or for any ``x0_hat`` if that is smaller.

    ``||x0_hat - x0||`` exceeds its radius with probability ``delta/10``; the rest of delta is for
    McDiarmid. For the state this implies the exponent ``N t^2 / (gf^2 + 3 g0^2 gA^2)``. The sizes
    of the entities may differ.
    """

    def radius(self, rates: Rates, level: float) -> float:
        """See the class; ``0.9 delta`` is left for McDiarmid."""
        r0, _, rA = rates
        at = self.at
        _, mean, spread = at.ranges(rates)
        surely = mcdiarmid(mean, spread, level)
        if r0 == 0.0 or rA == 0.0:
            return surely
        likely = at.range_A(at.x0) + at.slope_A * self.distance(r0, level + _SHARE)
        spread = at.spread_linear(rates) + likely**2 * rA / 2.0
        return min(surely, mcdiarmid(mean, spread, level - math.log(0.9)))


class ProductBousquet(_Bilinear):
    """Bousquet for the linear part, McDiarmid for the rest; best for many realizations.

    ``y_hat - y = [(xf_hat - xf) - A (x0_hat - x0) - (A_hat - A) x0] - (A_hat - A)(x0_hat - x0)``.
    The bracket is the average of N independent terms, one for each index (one size for all):
    Bousquet with 0.8 delta. The rest is O(1/N): with ``||x0_hat - x0|| <= r`` (0.1 delta), given
    ``x0_hat``, McDiarmid with 0.1 delta.
    """

    equal = "one linear term for each index"

    def radius(self, rates: Rates, level: float) -> float:
        """See the class; with x0 or A exact there is no rest, and Bousquet has all of delta."""
        r0, rf, rA = rates
        at = self.at
        t0, tf, tA, _ = at.traces
        mean = math.sqrt(t0 * r0 + tf * rf + tA * rA)
        constants = mean, at.variance(rates), at.farthest_linear(rates) * max(rates)
        if r0 == 0.0 or rA == 0.0:
            return bousquet(*constants, level)
        share = level + _SHARE
        largest_tau = float(at.tau[at.hit].max(initial=0.0))
        rest = mcdiarmid(math.sqrt(largest_tau * rA), at.slope_A**2 * rA / 2.0, share)
        return bousquet(*constants, level - math.log(0.8)) + self.distance(r0, share) * rest


# -- sums of exponentials: the paper's own route ---------------------------------------------------


class _Exponentials(Inequality):
    """``P(error > eps) <= C sum_i k_i exp(-eps^2 / (c_i r_i))``, r_i the rates."""

    _constant = 1.0
    _terms: tuple[tuple[float, float], ...]  # k_i, c_i

    def level(self, rates: Rates, eps: float) -> float:
        """See the class."""
        terms = [(k, c * rate) for (k, c), rate in zip(self._terms, cycle(rates), strict=False)]
        return union(
            self._constant, [square(eps / math.sqrt(c)) - math.log(k) for k, c in terms if c > 0.0]
        )


class ProductHoeffding(_Exponentials):
    """Hoeffding's inequality for every entry of every entity: Lemma 4.2, repaired.

    ``P(||B (u - v*)|| > eps) <= 2 n exp(-2 Nf eps^2 / (9 n gf^2))
    + 2 n exp(-2 N0 eps^2 / (9 n ||A||^2 g0^2)) + 2 n^2 exp(-2 NA eps^2 / (9 n^2 g0^2 gA^2))``:
    the constants n of the norms stand in the exponents. The weakest and most elementary.
    """

    def __init__(self, at: Product) -> None:
        super().__init__(at)
        n, lines = len(at.xf), at.A.T if at.by_rows else at.A
        gamma = float(np.abs(lines).sum(axis=0).max()) if sum_of_others(lines).any() else 0.0
        norm = float(np.linalg.norm(at.A, 2))
        self._terms = (  # x0, xf, A
            (2.0 * n, 4.5 * n * (norm * at.g0) ** 2),
            (2.0 * n, 4.5 * n * at.gf**2),
            (2.0 * n * n, 4.5 * (n * at.g0 * gamma) ** 2),
        )


class OneStepHoeffding(_Exponentials):
    """Lemma 4.3 for one step with the constants that make it true.

    ``P(error > eps) <= 4 [exp(-2 N eps^2 / (9 ||u||^2 gB^2)) + exp(-2 N eps^2 / (9 gA^2 g0^2))]``,
    dimension-free. Implied by McDiarmid's for one step, whose exponent is at most 4/3 above, and
    ``e^(4/3) < 4``; never the best. The printed second exponent has ``||A||`` for ``gA``, the
    printed third ``||x0||`` for ``g0``; both are false.
    """

    _constant = 4.0

    def __init__(self, at: OneStep) -> None:
        super().__init__(at)
        self._terms = tuple(
            (1.0, 4.5 * checked_finite(square(part), MOMENT)) for part in (at.moved, at.pushed)
        )
