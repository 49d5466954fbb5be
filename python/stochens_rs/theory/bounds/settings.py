"""The settings: checked data of every quantity, and the numbers that inequalities need.

Notation: ``g = ||w||_1``, ``g_j`` for line j of a matrix, ``L = log(1/delta)``.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from ..._base.types import Floats
from ..formulas import column_excess, sum_of_others
from .base import Moments, Rates, unit_of
from .geometry import Geometry, largest_norm


class Lines(Moments):
    """The average of N realizations of a vector, or of the lines of a matrix (as columns here).

    Lines with fewer than two nonzero entries are always exact and left out; the others have
    ``p_i = |a_i| / g``. The norm is that of all entries, the same for rows and columns; "1" is for
    one line.
    """

    def __init__(self, lines: Floats, quantity: str, norm: str) -> None:
        super().__init__(quantity, norm)
        lines = lines[:, np.count_nonzero(lines, axis=0) >= 2]
        self.unit = unit_of(lines)
        self.lines = lines / self.unit
        self.g = np.abs(self.lines).sum(axis=0)
        self.nonzero = np.count_nonzero(self.lines, axis=0)
        # sigma_j^2 = g_j^2 - ||a_j||^2, without cancellation
        self.variances = (np.abs(self.lines) * sum_of_others(self.lines)).sum(axis=0)
        self.sigma = math.sqrt(float(self.variances.sum()))
        # the largest ||g sign(a_i) e_i - a||^2 = (g - |a_i|)^2 + sum_{k != i} a_k^2 of each line
        deviations = sum_of_others(self.lines) ** 2 + sum_of_others(self.lines**2)
        self.deviations = np.where(self.lines != 0.0, deviations, 0.0).max(axis=0, initial=0.0)

    def rms(self, rates: Rates) -> float:
        """``sqrt(sum_j (g_j^2 - ||a_j||^2) / N)``."""
        return self.sigma * math.sqrt(rates[0])

    def variance(self, rates: Rates) -> float:
        """``max_j lambda_max(Cv(a_j)) / N``."""
        return self._top * rates[0]

    def farthest(self, rates: Rates) -> float:
        """All realizations at the atoms that are farthest from the mean."""
        if self.norm != "1":
            return math.sqrt(float(self.deviations.sum()))
        # ||g sign(w_i) e_i - w||_1 = 2 (g - |w_i|)
        return 2.0 * float(sum_of_others(self.lines)[self.lines != 0.0].max(initial=0.0))

    @cached_property
    def matrix_variance(self) -> float:
        """``max(||T_A(1)||_2, max_j (g_j^2 - ||a_j||^2))``, of Bernstein's inequality."""
        if not self.lines.size:
            return 0.0
        total = column_excess(self.lines, np.ones(self.lines.shape[1]))  # T_A(1) = sum_j Cv(a_j)
        return max(float(np.linalg.eigvalsh(total)[-1]), float(self.variances.max()))

    @cached_property
    def _top(self) -> float:
        tops = self.g**2 * largest_eigenvalues(np.abs(self.lines) / self.g)
        return float(tops.max(initial=0.0))


class Control(Geometry, Moments):
    """The fused control ``u`` under uniform weights, or the state ``B u`` it leads to.

    The error is ``||B (u - v*)||_2`` or ``||u - v*||_2`` for ``v* = B+ (xf - A x0)``. All
    realizations must be independent. The paper's lemmas use norms of the data; the moments and
    diameters here are those of the image under ``B B+`` (state) or ``B+`` (control), never larger.
    """

    entities = ("x0", "xf", "A")

    def farthest(self, rates: Rates) -> float:
        """The error is convex in every line: no average is worse than the worst realization."""
        r0, rf, rA = rates
        if r0 == 0.0 or rA == 0.0:
            return self.farthest_linear(rates)
        return self.farthest_linear((0.0, rf, 0.0)) + self.reach_z

    def farthest_linear(self, rates: Rates) -> float:
        """Largest deviation of ``M (xf^s - A x0^s - A^s x0)`` over the entities with a rate."""
        r0, rf, rA = rates
        largest = self.reach_A if rA > 0.0 else 0.0
        if rf > 0.0:
            largest += largest_norm(self.atoms_f - (self.M @ self.xf)[:, None])
        if r0 > 0.0:
            largest += largest_norm(self.atoms_0 - (self.M @ (self.A @ self.x0))[:, None])
        return largest

    def spread_linear(self, rates: Rates) -> float:
        """Half the summed squared ranges of ``xf_hat`` and ``x0_hat``."""
        r0, rf, rA = rates
        return (self.D_f**2 * rf + self.D_0(rA) ** 2 * r0) / 2.0

    def top(self, rates: Rates, *, both: bool) -> float:
        """``lambda_max`` of the covariance of one realization of each entity with a rate."""
        covariance = self.covariance(*rates, both=both)
        return max(0.0, float(np.linalg.eigvalsh(covariance)[-1])) if covariance.size else 0.0


class Product(Control):
    """Product fusion, ``u = B+ (xf_hat - A_hat x0_hat)``: all entities averaged first.

    The product makes the error bilinear: ``y_hat - y = (xf_hat - xf) - A (x0_hat - x0)
    - (A_hat - A) x0_hat``. Given ``x0_hat``, the last term is an average of independent terms; a
    share of delta is for the distance of ``x0_hat`` from ``x0``.
    """

    @cached_property
    def start(self) -> Lines:
        """The average of the realizations of ``x0``."""
        return Lines(self.x0[:, None], "vector", "2")

    def rms(self, rates: Rates) -> float:
        """``sqrt(tr Cov)``, exact (`moments.control_covariance`, `moments.state_covariance`)."""
        return math.sqrt(self.mean_square(*rates))

    def spread(self, rates: Rates) -> float:
        """``V``: ``2 V = D_f^2 / Nf + D_0^2 / N0 + sum_j xhat_j^2 D_j^2 / NA``, for every ``xhat``.

        These are the squared ranges of the martingale differences, for realizations revealed in
        the order ``xf``, ``x0``, ``A``. ``D_f`` and ``D_j`` are the diameters of the atoms of
        ``xf`` and of column j, ``D_0^2`` is the largest ``||M (A d)||^2 + E||M (A_hat - A) d||^2``
        for the difference d of two atoms of ``x0``. The last sum is at most ``g0^2 max_j D_j^2``.
        """
        r0, _, rA = rates
        largest = self.range_A(self.x0) if r0 == 0.0 or rA == 0.0 else self.cap_A
        return self.spread_linear(rates) + largest**2 * rA / 2.0

    def variance(self, rates: Rates) -> float:
        """Largest variance of the linear part."""
        return self.top(rates, both=False) * max(rates)


class Paired(Control):
    """Diagonal fusion, the average of N controls: ``xf^s`` and ``z^s = A^s x0^s`` are independent.

    An entity that is known exactly has no realizations in the pairs.
    """

    equal = "diagonal fusion pairs the realizations"

    def rms(self, rates: Rates) -> float:
        """``sqrt(tr Cov)``, exact (`moments.control_covariance`, `moments.state_covariance`)."""
        return math.sqrt(self.paired_mean_square(*rates))

    def variance(self, rates: Rates) -> float:
        """``lambda_max(M (Cv(xf) + C_z) M^T) / N``, the covariance of one pair."""
        return self.top(rates, both=True) * max(rates)


def largest_eigenvalues(p: Floats) -> Floats:
    """Largest eigenvalue of ``diag(p) - p p^T`` for each column p, from above.

    Interlacing puts it between the two largest entries, where ``sum_i p_i^2 / (p_i - x)`` grows
    through 1 once.
    """
    if p.size == 0:
        return np.zeros(p.shape[1])
    below, above = np.partition(p, -2, axis=0)[-2:]
    for _ in range(60):  # halvings: more than the 53 bits of a float
        middle = (below + above) / 2.0
        with np.errstate(divide="ignore", invalid="ignore"):
            secular = (p**2 / (p - middle)).sum(axis=0)
        beyond = ~(secular < 1.0)  # a middle that meets an entry is beyond, too
        above = np.where(beyond, middle, above)
        below = np.where(beyond, below, middle)
    return np.asarray(above, dtype=np.float64)
