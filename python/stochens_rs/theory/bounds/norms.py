"""Bounds in other norms: Weissman (1-norm of a vector), Bernstein (spectral norm of a matrix)."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..._base import gate
from ..._base.types import Axis
from ..formulas import column_excess, sum_of_others
from ._base import Rates
from ._inequalities import square
from .averages import Average


class Weissman(Average):
    """Weissman's inequality: ``g sqrt(2 (log(2^n - 2) + L) / N)`` in the 1-norm.

    Parameters
    ----------
    w : (n,) array_like
        The vector; n counts its nonzero entries.
    norm : {"1", "2"}, default "1"
        In the 2-norm the radius is smaller by ``sqrt(2)``: the errors of the frequencies add up
        to 0, and then ``||z||_1 >= sqrt(2) ||z||_2``.

    Raises
    ------
    InputError, InputTypeError
        `w` is not a finite vector, or `norm` is unknown.

    Notes
    -----
    ``P(||p_hat - p||_1 >= eps) <= (2^n - 2) exp(-N eps^2 / 2)``. Best for few nonzero entries.

    References
    ----------
    T. Weissman et al., "Inequalities for the L1 deviation of the empirical distribution", HP
    Laboratories, HPL-2003-97, 2003.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> round(bounds.Weissman([3.0, -1.0]).radius(10_000, 0.01), 4)
    0.1302
    """

    name = "Weissman"
    source = "union bound over all sets of atoms, Hoeffding for each"

    def __init__(self, w: ArrayLike, *, norm: Literal["1", "2"] = "1") -> None:
        super().__init__(gate.vector("w", w))
        self.norm = gate.choice("norm", norm, ("1", "2"))
        self._factor = 2.0 if self.norm == "1" else 1.0
        self._gamma = float(self._g.sum())
        n = int(np.count_nonzero(self._lines))
        # log(2^n - 2), in which n = 0 stands for a vector without randomness
        self._log_sets = n * math.log(2.0) + math.log1p(-(2.0 ** (1 - n))) if n > 1 else 0.0

    def _largest_error(self, rates: Rates) -> float:
        if self.norm == "2":
            return super()._largest_error(rates)
        # ||g sign(w_i) e_i - w||_1 = 2 (g - |w_i|)
        return 2.0 * float(sum_of_others(self._lines)[self._lines != 0.0].max(initial=0.0))

    def _radius(self, rates: Rates, level: float) -> float:
        return self._gamma * math.sqrt(self._factor * rates[0] * (self._log_sets + level))

    def _level(self, rates: Rates, eps: float) -> float:
        scale = self._gamma * math.sqrt(self._factor * rates[0])
        return square(eps / scale) - self._log_sets if scale > 0.0 else math.inf


class Bernstein(Average):
    """The matrix Bernstein inequality: ``U l / 3 + sqrt((U l / 3)^2 + 2 v l)``, spectral norm.

    Parameters
    ----------
    A : (n, m) array_like
        The matrix that is sampled line by line.
    axis : {"columns", "rows"}, default "columns"
        Which lines are sampled.

    Raises
    ------
    InputError, InputTypeError
        `A` is not a finite matrix, or `axis` is unknown.

    Notes
    -----
    ``l = log((n + m) / delta)``, ``v = max(||T_A(1)||_2, max_j (g_j^2 - ||a_j||^2)) / N`` and ``U``
    the largest deviation of one line of one realization, over N: a sum of ``N m`` independent
    matrices of rank one. n and m do not count lines that are exact or zero.

    References
    ----------
    J. A. Tropp, "User-friendly tail bounds for sums of random matrices", Found. Comput. Math. 12,
    2012.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> round(bounds.Bernstein([[1.0, -2.0], [0.5, 3.0]]).radius(10_000, 0.01), 4)
    0.1208
    """

    name = "Bernstein"
    source = "N m independent matrices of rank one, matrix Bernstein"

    def __init__(self, A: ArrayLike, *, axis: Axis = "columns") -> None:
        super().__init__(gate.matrix("A", A), axis=axis)
        self.norm = "spectral"
        lines = self._lines[self._lines.any(axis=1)]
        self._log_sizes = math.log(max(1, sum(lines.shape)))
        self._variance = self._largest = 0.0
        if lines.size == 0:
            return
        total = column_excess(lines, np.ones(lines.shape[1]))  # sum_j Cv(a_j)
        top = float(np.linalg.eigvalsh(total)[-1])
        self._variance = max(top, float(self._variances.max()))
        self._largest = math.sqrt(float(self._farthest.max()))

    def _radius(self, rates: Rates, level: float) -> float:
        exponent = level + self._log_sizes
        linear = self._largest * rates[0] * exponent / 3.0
        return linear + math.sqrt(linear**2 + 2.0 * self._variance * rates[0] * exponent)

    def _level(self, rates: Rates, eps: float) -> float:
        scale = self._variance * rates[0] + self._largest * rates[0] * eps / 3.0
        return eps * (eps / scale) / 2.0 - self._log_sizes if scale > 0.0 else math.inf
