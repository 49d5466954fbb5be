"""The inequalities, each with its formula, its source and where it is best.

``L = log(1/delta)`` is called the level. `McDiarmid`, `Bousquet` and `Chebyshev` hold for every
setting with moments, the others for the one they name.
"""

from __future__ import annotations

import math
from itertools import cycle

import numpy as np

from ..formulas import column_excess, sum_of_others
from ._base import Inequality, Moments, Rates
from ._settings import Lines, OneStep, Product, finite

_SHARE = math.log(10.0)  # a tenth of delta for an event that is not the main one


# -- for every setting with moments ----------------------------------------------------------------


class McDiarmid(Inequality):
    """``E + sqrt(V L)`` where the mean is at most E and the squared ranges add up to ``2 V``.

    C. McDiarmid, "On the method of bounded differences", Surveys in Combinatorics, 1989; the mean
    is at most the root mean square. Repairs the route behind Lemma 4.2, whose exponent
    ``2 N eps^2 / g^2`` for one vector is false: ``N eps^2 / g^2`` is the right one. Best for few
    realizations and tiny delta.
    """

    at: Moments

    def radius(self, rates: Rates, level: float) -> float:
        """``c (E + sqrt(V L))``."""
        scale, mean, spread = self.at.ranges(rates)
        return scale * mcdiarmid(mean, spread, level)

    def level(self, rates: Rates, eps: float) -> float:
        """``(eps / c - E)^2 / V`` beyond E."""
        scale, mean, spread = self.at.ranges(rates)
        if scale == 0.0:
            return math.inf
        eps = eps / scale
        if eps <= mean:
            return 0.0
        return square((eps - mean) / math.sqrt(spread)) if spread > 0.0 else math.inf


class Bousquet(Inequality):
    """``E + sqrt(2 L (lam + 2 U E)) + U L / 3``: Talagrand's inequality, for many realizations.

    For the supremum of ``<v, average - mean>`` over unit vectors v: E its mean, at most the root
    mean square, ``lam`` the largest variance of a projection, ``U`` the largest deviation of one of
    N independent terms over N. O. Bousquet, "A Bennett concentration inequality and its application
    to suprema of empirical processes", C. R. Acad. Sci. Paris 334, 2002.
    """

    at: Moments

    def radius(self, rates: Rates, level: float) -> float:
        """See the class."""
        return bousquet(*self._constants(rates), level)

    def level(self, rates: Rates, eps: float) -> float:
        """The positive root of a quadratic in ``sqrt(L)``."""
        mean, variance, largest = self._constants(rates)
        if eps <= mean:
            return 0.0
        b = math.sqrt(2.0 * (variance + 2.0 * largest * mean))
        root = b + math.sqrt(b * b + 4.0 / 3.0 * largest * (eps - mean))
        return square(2.0 * (eps - mean) / root) if root > 0.0 else math.inf

    def _constants(self, rates: Rates) -> tuple[float, float, float]:
        at = self.at
        return at.rms(rates), at.variance(rates), at.farthest(rates) * max(rates)


class Chebyshev(Inequality):
    """``rms / sqrt(delta)``: ``P(error > eps) <= E error^2 / eps^2``. Best for delta above 0.3.

    For the average of runs this proves Lemma 3.1 for unbiased realizations.
    """

    at: Moments

    def radius(self, rates: Rates, level: float) -> float:
        """``rms e^(L/2)``."""
        return self.at.rms(rates) * math.exp(level / 2.0)

    def level(self, rates: Rates, eps: float) -> float:
        """``log(eps^2 / rms^2)``."""
        rms = self.at.rms(rates)
        if rms == 0.0:
            return math.inf
        return 2.0 * (math.log(eps) - math.log(rms)) if eps > 0.0 else 0.0


# -- for vectors and matrices ----------------------------------------------------------------------


class Hoeffding(Inequality):
    """``sqrt(W log(2 k / delta) / (2 N))``: Hoeffding's inequality for every entry.

    k nonzero entries in all, ``W = sum_j k_j g_j^2`` with ``k_j`` in line j; for a vector
    ``P(error > eps) <= 2 n exp(-2 N eps^2 / (n g^2))``. This is the route of the proof of Lemma
    4.2 with the norm constants in the exponent, where they belong. An entry takes the values 0
    and ``g_j`` only; the errors allowed to the entries of a line are proportional to ``g_j``.
    W. Hoeffding, "Probability inequalities for sums of bounded random variables", J. Amer. Stat.
    Assoc. 58, 1963. The most elementary, never the best by much.
    """

    def __init__(self, at: Lines) -> None:
        super().__init__(at)
        self._weight = float((at.nonzero * at.g**2).sum())
        self._log_terms = math.log(2.0 * max(1, int(at.nonzero.sum())))

    def radius(self, rates: Rates, level: float) -> float:
        """See the class."""
        return math.sqrt(self._weight * rates[0] * (level + self._log_terms) / 2.0)

    def level(self, rates: Rates, eps: float) -> float:
        """``2 N eps^2 / W - log(2 k)``."""
        scale = math.sqrt(self._weight * rates[0] / 2.0)
        return square(eps / scale) - self._log_terms if scale > 0.0 else math.inf


class Weissman(Inequality):
    """``g sqrt(2 (log(2^n - 2) + L) / N)`` in the 1-norm, n nonzero entries; best for few.

    ``P(||p_hat - p||_1 >= eps) <= (2^n - 2) exp(-N eps^2 / 2)``: T. Weissman et al., "Inequalities
    for the L1 deviation of the empirical distribution", HP Laboratories, HPL-2003-97, 2003. In the
    2-norm the radius is smaller by ``sqrt(2)``: the errors of the frequencies add up to 0, and then
    ``||z||_1 >= sqrt(2) ||z||_2``.
    """

    def __init__(self, at: Lines) -> None:
        super().__init__(at)
        self._factor = 2.0 if at.norm == "1" else 1.0
        self._gamma = float(at.g.sum())
        n = int(at.nonzero.sum())
        # log(2^n - 2), in which n = 0 stands for a vector without randomness
        self._log_sets = n * math.log(2.0) + math.log1p(-(2.0 ** (1 - n))) if n > 1 else 0.0

    def radius(self, rates: Rates, level: float) -> float:
        """See the class."""
        return self._gamma * math.sqrt(self._factor * rates[0] * (self._log_sets + level))

    def level(self, rates: Rates, eps: float) -> float:
        """``N eps^2 / (2 g^2) - log(2^n - 2)`` in the 1-norm."""
        scale = self._gamma * math.sqrt(self._factor * rates[0])
        return square(eps / scale) - self._log_sets if scale > 0.0 else math.inf


class Bernstein(Inequality):
    """``U l / 3 + sqrt((U l / 3)^2 + 2 v l)``: matrix Bernstein; best for large matrices.

    ``l = log((n + m) / delta)``, ``v = max(||T_A(1)||_2, max_j (g_j^2 - ||a_j||^2)) / N`` and ``U``
    the largest deviation of one line of one realization, over N: a sum of ``N m`` independent
    matrices of rank one. n and m do not count lines that are exact or zero. J. A. Tropp,
    "User-friendly tail bounds for sums of random matrices", Found. Comput. Math. 12, 2012.
    """

    def __init__(self, at: Lines) -> None:
        super().__init__(at)
        lines = at.lines[at.lines.any(axis=1)]
        self._log_sizes = math.log(max(1, sum(lines.shape)))
        self._variance = self._largest = 0.0
        if lines.size:
            total = column_excess(lines, np.ones(lines.shape[1]))  # T_A(1) = sum_j Cv(a_j)
            top = float(np.linalg.eigvalsh(total)[-1])
            self._variance = max(top, float(at.variances.max()))
            self._largest = math.sqrt(float(at.deviations.max()))

    def radius(self, rates: Rates, level: float) -> float:
        """See the class."""
        exponent = level + self._log_sizes
        linear = self._largest * rates[0] * exponent / 3.0
        return linear + math.sqrt(linear**2 + 2.0 * self._variance * rates[0] * exponent)

    def level(self, rates: Rates, eps: float) -> float:
        """``eps^2 / (2 (v + U eps / 3)) - log(n + m)``."""
        scale = self._variance * rates[0] + self._largest * rates[0] * eps / 3.0
        return eps * (eps / scale) / 2.0 - self._log_sizes if scale > 0.0 else math.inf


class Systematic(Inequality):
    """``sqrt(sum_j k_j g_j^2) / N``: sure, for systematic samples, whatever delta is.

    Each of the ``k_j`` nonzero entries of a line is hit ``floor(N p_i)`` or ``ceil(N p_i)`` times.
    """

    def __init__(self, at: Lines) -> None:
        super().__init__(at)
        self._sure = math.sqrt(float((at.nonzero * at.g**2).sum()))

    def radius(self, rates: Rates, level: float) -> float:
        """See the class."""
        return self._sure * rates[0]

    def level(self, rates: Rates, eps: float) -> float:
        """All or nothing."""
        return math.inf if eps >= self._sure * rates[0] else 0.0


# -- for product fusion ----------------------------------------------------------------------------


class _Bilinear(Inequality):
    """Product fusion, with a radius for ``||x0_hat - x0||``; levels by inversion."""

    at: Product

    def __init__(self, at: Product) -> None:
        super().__init__(at)
        start = Lines(at.x0[:, None], "vector", "2")
        self._start = McDiarmid(start), Weissman(start)

    def distance(self, r0: float, level: float) -> float:
        """Radius of ``||x0_hat - x0||_2``."""
        return min(one.at.unit * one.capped((r0,), level) for one in self._start)


class ProductMcDiarmid(_Bilinear):
    """McDiarmid's, in which ``xhat`` is close to ``x0`` with probability ``1 - delta/10``.

    The smaller of this radius and of that for any ``xhat`` is taken. For the state it implies the
    exponent ``N t^2 / (gf^2 + 3 g0^2 gA^2)``. Holds for different sizes of the entities.
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
    """Bousquet's for the linear part, McDiarmid's for the rest; best for many realizations.

    ``y_hat - y = [(xf_hat - xf) - A (x0_hat - x0) - (A_hat - A) x0] - (A_hat - A)(x0_hat - x0)``.
    The bracket is the average of N independent terms, one for each index (one size for all):
    Bousquet with 0.8 delta. The rest is O(1/N): with ``||x0_hat - x0|| <= r`` (0.1 delta), given
    ``x0_hat``, McDiarmid with 0.1 delta.
    """

    equal = "one linear term for each index"

    def radius(self, rates: Rates, level: float) -> float:
        """See the class; without a product of errors, Bousquet with delta."""
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


class SumOfParts(_Bilinear):
    """``rho_f + rho_0 + rho_A``: McDiarmid for each entity, each with its share of delta.

    ``rho_f = rms_f + sqrt(D_f^2 L' / (2 Nf))``; ``rho_0`` the same for ``A x0_hat`` and
    ``rho_A = sqrt(sum_j xhat_j^2 tau_j / NA) + sqrt(sum_j xhat_j^2 D_j^2 L' / (2 NA))`` for
    ``A_hat`` given ``x0_hat``, ``tau_j = tr(M Cv(a_j) M^T)``. ``L' = log(k / delta)`` with k the
    number of entities that are not exact, plus one for the distance of ``x0_hat`` from ``x0``.
    Never larger than the sum with norms in place of ``M``.
    """

    def radius(self, rates: Rates, level: float) -> float:
        """See the class."""
        r0, rf, rA = rates
        at = self.at
        sure = r0 == 0.0 or rA == 0.0
        parts = sum(rate > 0.0 for rate in rates) + (not sure)
        if parts == 0:
            return 0.0
        share = level + math.log(parts)
        t0, tf, _, _ = at.traces
        rho_f = math.sqrt(rf) * mcdiarmid(math.sqrt(tf), at.D_f**2 / 2.0, share)
        rho_0 = math.sqrt(r0) * mcdiarmid(math.sqrt(t0), at.D_0(0.0) ** 2 / 2.0, share)
        rms, spread = math.sqrt(float(at.x0**2 @ at.tau)), at.range_A(at.x0)
        if not sure:
            distance = self.distance(r0, share)
            # the norms at x0_hat are at most those at x0 plus this distance
            rms += math.sqrt(float(at.tau[at.hit].max(initial=0.0))) * distance
            spread = min(spread + at.slope_A * distance, at.cap_A)
        rho_A = math.sqrt(rA) * mcdiarmid(rms, spread**2 / 2.0, share)
        return rho_f + rho_0 + rho_A


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
        self._terms = tuple((1.0, 4.5 * finite(square(part))) for part in (at.moved, at.pushed))


# -- on plain numbers ------------------------------------------------------------------------------


def mcdiarmid(mean: float, spread: float, level: float) -> float:
    """``E + sqrt(V L)``."""
    return mean + math.sqrt(spread * level)


def bousquet(mean: float, variance: float, largest: float, level: float) -> float:
    """``E + sqrt(2 L (lam + 2 U E)) + U L / 3``."""
    return mean + math.sqrt(2.0 * level * (variance + 2.0 * largest * mean)) + largest * level / 3.0


def union(constant: float, levels: list[float]) -> float:
    """``-log(C sum_i exp(-level_i))``."""
    least = min(levels, default=math.inf)
    if least == math.inf:
        return math.inf
    return least - math.log(constant * sum(math.exp(least - x) for x in levels))


def square(x: float) -> float:
    """``x^2``, inf where it overflows (Python's power raises)."""
    return x * x
