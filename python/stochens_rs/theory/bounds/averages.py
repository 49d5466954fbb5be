"""Bounds on the error of an estimated vector (2-norm) or matrix (Frobenius norm)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..._base import gate
from ..._base.types import Axis
from ..formulas import AXES, Array, lines_of, sum_of_others
from ._base import Bound, Rates, unit_of
from ._inequalities import (
    bousquet,
    bousquet_level,
    chebyshev_level,
    largest_eigenvalues,
    mcdiarmid,
    mcdiarmid_level,
    square,
)


class Average(Bound):
    """Common to the bounds for the average of independent realizations of one entity.

    Parameters
    ----------
    target : (n,) or (n, m) array_like
        The vector, or the matrix that is sampled line by line.
    axis : {"columns", "rows"}, default "columns"
        Which lines of a matrix are sampled; without effect for a vector.

    Raises
    ------
    InputError, InputTypeError
        `target` is not a finite vector or matrix, or `axis` is unknown.

    Notes
    -----
    A line with fewer than two nonzero entries is always exact and left out. What is left has
    p_i = |a_i| / g per line; both norms are those of all entries, so that rows and columns differ
    by a transposition only.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> isinstance(bounds.Bousquet([1.0, 2.0]), bounds.Average)
    True
    """

    def __init__(self, target: ArrayLike, *, axis: Axis = "columns") -> None:
        checked = gate.array("target", target, ndim=(1, 2))
        gate.choice("axis", axis, AXES)
        self._set(checked[:, None] if checked.ndim == 1 else lines_of(checked, axis))
        self.quantity, self.norm = ("vector", "2") if checked.ndim == 1 else ("matrix", "Frobenius")

    def _set(self, lines: Array) -> None:
        """Keep the lines that are random, in their unit, and their 1-norms."""
        lines = lines[:, np.count_nonzero(lines, axis=0) >= 2]
        self._unit = unit_of(lines)
        self._lines = lines / self._unit
        self._g = np.abs(self._lines).sum(axis=0)
        # sigma_j^2 = g_j^2 - ||a_j||^2, without cancellation
        self._variances = (np.abs(self._lines) * sum_of_others(self._lines)).sum(axis=0)
        self._rms = math.sqrt(float(self._variances.sum()))
        # the largest ||g sign(a_i) e_i - a||^2 = (g - |a_i|)^2 + sum_{k != i} a_k^2 of each line
        deviations = sum_of_others(self._lines) ** 2 + sum_of_others(self._lines**2)
        self._farthest = np.where(self._lines != 0.0, deviations, 0.0).max(axis=0, initial=0.0)

    def _largest_error(self, rates: Rates) -> float:
        return math.sqrt(float(self._farthest.sum()))


class McDiarmid(Average):
    """McDiarmid's inequality: ``(rms + sqrt(L sum_j g_j^2)) / sqrt(N)``.

    Parameters
    ----------
    target : (n,) or (n, m) array_like
        The vector, or the matrix that is sampled line by line.
    axis : {"columns", "rows"}, default "columns"
        Which lines of a matrix are sampled; without effect for a vector.

    Raises
    ------
    InputError, InputTypeError
        `target` is not a finite vector or matrix, or `axis` is unknown.

    Notes
    -----
    ``rms^2 = sum_j (g_j^2 - ||a_j||^2)``, ``L = log(1/delta)``. Replacing one realization of one
    line moves the error by at most ``sqrt(2) g_j / N``, the distance of two atoms; the mean of
    the error is at most its root mean square. Repairs the route behind Lemma 4.2, whose exponent
    ``2 N eps^2 / g^2`` for one vector is false: ``N eps^2 / g^2`` is the right one.

    References
    ----------
    C. McDiarmid, "On the method of bounded differences", Surveys in Combinatorics, 1989.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> bound = bounds.McDiarmid([3.0, -1.0, 0.5])
    >>> round(bound.radius(10_000, 0.01), 4), bound.required_size(0.1, 0.01)
    (0.1282, 16433)
    """

    name = "McDiarmid"
    source = "bounded differences sqrt(2) g_j / N; mean at most sqrt(sum g_j^2 - ||a_j||^2) / N^.5"

    def __init__(self, target: ArrayLike, *, axis: Axis = "columns") -> None:
        super().__init__(target, axis=axis)
        self._spread = float((self._g**2).sum())

    def _radius(self, rates: Rates, level: float) -> float:
        return math.sqrt(rates[0]) * mcdiarmid(self._rms, self._spread, level)

    def _level(self, rates: Rates, eps: float) -> float:
        if rates[0] == 0.0:
            return math.inf
        return mcdiarmid_level(self._rms, self._spread, eps / math.sqrt(rates[0]))


class Bousquet(Average):
    """Bousquet's form of Talagrand's inequality: ``E + sqrt(2 L (lam + 2 U E)) + U L / 3``.

    Parameters
    ----------
    target : (n,) or (n, m) array_like
        The vector, or the matrix that is sampled line by line.
    axis : {"columns", "rows"}, default "columns"
        Which lines of a matrix are sampled; without effect for a vector.

    Raises
    ------
    InputError, InputTypeError
        `target` is not a finite vector or matrix, or `axis` is unknown.

    Notes
    -----
    ``E = sqrt(sum_j (g_j^2 - ||a_j||^2) / N)``, ``lam = max_j lambda_max(Cv(a_j)) / N``,
    ``U = sqrt(sum_j max_i (g_j^2 - 2 g_j |a_ij| + ||a_j||^2)) / N`` over the nonzero entries: the
    mean, the largest variance of a projection, and the largest deviation of one realization.

    References
    ----------
    O. Bousquet, "A Bennett concentration inequality and its application to suprema of empirical
    processes", C. R. Acad. Sci. Paris 334, 2002.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> round(bounds.Bousquet([3.0, -1.0, 0.5]).radius(10_000, 0.01), 4)
    0.1155
    """

    name = "Bousquet"
    source = "supremum of <v, average - mean> over unit vectors v, N independent terms"

    def __init__(self, target: ArrayLike, *, axis: Axis = "columns") -> None:
        super().__init__(target, axis=axis)
        lines, g = self._lines, self._g
        self._variance = float((g**2 * largest_eigenvalues(np.abs(lines) / g)).max(initial=0.0))

    def _constants(self, rates: Rates) -> tuple[float, float, float]:
        rate = rates[0]
        largest = self._largest_error(rates)
        return self._rms * math.sqrt(rate), self._variance * rate, largest * rate

    def _radius(self, rates: Rates, level: float) -> float:
        return bousquet(*self._constants(rates), level)

    def _level(self, rates: Rates, eps: float) -> float:
        return bousquet_level(*self._constants(rates), eps)


class Chebyshev(Average):
    """Chebyshev's inequality: ``rms / sqrt(N delta)``.

    Parameters
    ----------
    target : (n,) or (n, m) array_like
        The vector, or the matrix that is sampled line by line.
    axis : {"columns", "rows"}, default "columns"
        Which lines of a matrix are sampled; without effect for a vector.

    Raises
    ------
    InputError, InputTypeError
        `target` is not a finite vector or matrix, or `axis` is unknown.

    Notes
    -----
    ``P(error > eps) <= E error^2 / eps^2``. The best of all for large `delta` (from about 0.3).

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> bounds.Chebyshev([3.0, -1.0]).required_size(0.1, 0.01)
    60000
    """

    name = "Chebyshev"
    source = "Markov's inequality for the squared error"

    def _radius(self, rates: Rates, level: float) -> float:
        return self._rms * math.sqrt(rates[0]) * math.exp(level / 2.0)

    def _level(self, rates: Rates, eps: float) -> float:
        return chebyshev_level(self._rms * math.sqrt(rates[0]), eps)


class Hoeffding(Average):
    """Hoeffding's inequality for every entry: ``sqrt(W log(2 k / delta) / (2 N))``.

    Parameters
    ----------
    target : (n,) or (n, m) array_like
        The vector, or the matrix that is sampled line by line.
    axis : {"columns", "rows"}, default "columns"
        Which lines of a matrix are sampled; without effect for a vector.

    Raises
    ------
    InputError, InputTypeError
        `target` is not a finite vector or matrix, or `axis` is unknown.

    Notes
    -----
    k nonzero entries in all, ``W = sum_j k_j g_j^2`` with ``k_j`` in line j; for a vector
    ``P(error > eps) <= 2 n exp(-2 N eps^2 / (n g^2))``. This is the route of the proof of Lemma
    4.2 with the norm constants in the exponent, where they belong. An entry takes the values 0
    and ``g_j`` only; the errors allowed to the entries of a line are proportional to ``g_j``.

    References
    ----------
    W. Hoeffding, "Probability inequalities for sums of bounded random variables", J. Amer. Stat.
    Assoc. 58, 1963.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> round(bounds.Hoeffding([3.0, -1.0, 0.5]).radius(10_000, 0.01), 4)
    0.1394
    """

    name = "Hoeffding"
    source = "every entry has the range g_j; union bound over the nonzero entries"

    def __init__(self, target: ArrayLike, *, axis: Axis = "columns") -> None:
        super().__init__(target, axis=axis)
        counts = np.count_nonzero(self._lines, axis=0)
        self._weight = float((counts * self._g**2).sum())
        self._log_terms = math.log(2.0 * max(1, int(counts.sum())))

    def _radius(self, rates: Rates, level: float) -> float:
        return math.sqrt(self._weight * rates[0] * (level + self._log_terms) / 2.0)

    def _level(self, rates: Rates, eps: float) -> float:
        scale = math.sqrt(self._weight * rates[0] / 2.0)
        return square(eps / scale) - self._log_terms if scale > 0.0 else math.inf


class Systematic(Average):
    """The sure bound for systematic samples: ``sqrt(sum_j k_j g_j^2) / N``.

    Parameters
    ----------
    target : (n,) or (n, m) array_like
        The vector, or the matrix that is sampled line by line.
    axis : {"columns", "rows"}, default "columns"
        Which lines of a matrix are sampled; without effect for a vector.

    Raises
    ------
    InputError, InputTypeError
        `target` is not a finite vector or matrix, or `axis` is unknown.

    Notes
    -----
    Holds always, whatever `delta`: each of the ``k_j`` nonzero entries of a line is hit
    ``floor(N p_i)`` or ``ceil(N p_i)`` times. For ``scheme="systematic"`` only, to which no other
    bound of this module applies: its realizations are dependent.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> bounds.Systematic([3.0, -1.0, 0.5, -0.5]).radius(1000, 0.01)
    0.01
    """

    name = "systematic"
    source = "every count is within 1 of N p_i"

    def __init__(self, target: ArrayLike, *, axis: Axis = "columns") -> None:
        super().__init__(target, axis=axis)
        counts = np.count_nonzero(self._lines, axis=0)
        self._sure = math.sqrt(float((counts * self._g**2).sum()))

    def _radius(self, rates: Rates, level: float) -> float:
        return self._sure * rates[0]

    def _level(self, rates: Rates, eps: float) -> float:
        return math.inf if eps >= self._sure * rates[0] else 0.0
