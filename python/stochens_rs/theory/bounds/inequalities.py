"""The inequalities for every setting and those for vectors and matrices, with their sources.

``L = log(1/delta)`` is called the level. `McDiarmid`, `Bousquet` and `Chebyshev` hold for every
setting with moments; `fused_inequalities` has those for controls.
"""

from __future__ import annotations

import math

import numpy as np

from ..formulas import column_excess
from .base import Inequality, Moments, Rates
from .settings import Lines

# -- for every setting with moments ----------------------------------------------------------------


class McDiarmid(Inequality):
    """``E + sqrt(V L)`` where the mean is at most E and the squared ranges add up to ``2 V``.

    C. McDiarmid, "On the method of bounded differences", Surveys in Combinatorics, 1989; the mean
    is at most the root mean square. The printed exponent of Lemma 4.2 for one vector,
    ``2 N eps^2 / g^2``, is false; this gives ``N eps^2 / g^2``. Best for few realizations and tiny
    delta.
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
    4.2 with the norm constants in the exponent. An entry takes the values 0 and ``g_j`` only; the
    errors allowed to the entries of a line are proportional to ``g_j``.
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
    the largest deviation of one line of one realization, over N: the average is a sum of ``N m``
    independent matrices of rank one. Exact and zero lines do not count in n and m. J. A. Tropp,
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
    """``sqrt(sum_j k_j g_j^2) / N``: for systematic samples, never exceeded, for every delta.

    Each of the ``k_j`` nonzero entries of a line is hit ``floor(N p_i)`` or ``ceil(N p_i)`` times.
    """

    def __init__(self, at: Lines) -> None:
        super().__init__(at)
        self._sure = math.sqrt(float((at.nonzero * at.g**2).sum()))

    def radius(self, rates: Rates, level: float) -> float:
        """See the class."""
        return self._sure * rates[0]

    def level(self, rates: Rates, eps: float) -> float:
        """inf from the radius on, 0 below."""
        return math.inf if eps >= self._sure * rates[0] else 0.0


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
