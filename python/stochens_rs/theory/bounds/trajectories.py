"""Bounds for the average of N runs of the sampled system, open loop, fresh draws at every step.

``xhat(s, k+1) = A^(s,k) xhat(s, k) + B^(s,k) u(k)``, ``xhat(s, 0) = x0^s``: Lemma 4.3, corrected.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ..._base import gate
from ..._base.types import Axis
from ...exceptions import NonFiniteError
from ..formulas import AXES, Array
from ..moments import trajectory_covariance, trajectory_mean
from ._base import Bound, Rates, unit_of
from ._inequalities import (
    bousquet,
    bousquet_level,
    chebyshev_level,
    mcdiarmid,
    mcdiarmid_level,
    square,
)


class Trajectory(Bound):
    """Common to the bounds for ``||mean of the runs - x(K)||_2``.

    Parameters
    ----------
    A : (n, n) array_like
        State matrix.
    B : (n, m) array_like
        Input matrix.
    x0 : (n,) array_like
        Initial state.
    u : (K, m) array_like
        The controls, the same in every run.
    axis : {"columns", "rows"}, default "columns"
        Which lines of ``A`` and ``B`` are sampled.
    sample_B : bool, default True
        Whether ``B`` is sampled, too; else it is known exactly.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or the moments overflow.

    Notes
    -----
    Needs injective indices: a realization that is reused at a later step makes the mean of the
    runs biased, and no bound on the distance to ``x(K)`` can hold.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> issubclass(bounds.TrajectoryMcDiarmid, bounds.Trajectory)
    True
    """

    quantity = "trajectory"
    norm = "2"

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        x0: ArrayLike,
        u: ArrayLike,
        *,
        axis: Axis = "columns",
        sample_B: bool = True,
    ) -> None:
        self._A = gate.matrix("A", A, square=True)
        self._B = gate.matrix("B", B, rows=len(self._A))
        start = gate.vector("x0", x0, length=len(self._A))
        inputs = gate.matrix("u", u, cols=self._B.shape[1])
        self._axis = gate.choice("axis", axis, AXES)
        self._sample_B = gate.flag("sample_B", sample_B)
        # linear in (x0, u), so that their unit is that of the result
        self._unit = max(unit_of(start) if start.any() else 0.0, float(np.abs(inputs).max())) or 1.0
        self._x0, self._u = start / self._unit, inputs / self._unit
        self._mean = trajectory_mean((self._A, self._B), self._x0, self._u)[-1]
        self._covariance = trajectory_covariance(
            (self._A, self._B),
            self._x0,
            self._u,
            sample_B=self._sample_B,
            axis="rows" if self._axis == "rows" else "columns",
        )[-1]
        self._mean_square = finite(max(0.0, float(np.trace(self._covariance))))
        with np.errstate(over="ignore", invalid="ignore"):
            self._range = self._reach()
            # an exact B shifts all runs alike, in the last step: neither R_K nor the mean has it
            shift = 0.0 if self._sample_B else self._B @ self._u[-1]
            self._farthest = self._range + float(np.linalg.norm(self._mean - shift))
        self._prepare()

    def _prepare(self) -> None:
        """Compute the constants of the bound."""

    def _largest_error(self, rates: Rates) -> float:
        return self._farthest if math.isfinite(self._farthest) else math.inf

    def _rms(self, rates: Rates) -> float:
        return math.sqrt(self._mean_square * rates[0])

    def _reach(self) -> float:
        """``R_K``, a bound on ``||xhat(s, K)||_2``."""
        return self._one_norm() if self._axis == "columns" else self._by_entries()

    def _one_norm(self) -> float:
        """``R_K``, columns: 1-norms."""
        gain = float(np.abs(self._A).sum(axis=0).max())
        h = np.abs(self._B).sum(axis=0)
        radius = float(np.abs(self._x0).sum())
        for k, u in enumerate(self._u):
            exact = 0.0 if k == len(self._u) - 1 else float(np.abs(self._B @ u).sum())
            radius = gain * radius + (float(h @ np.abs(u)) if self._sample_B else exact)
        return radius

    def _by_entries(self) -> float:
        """``R_K``, rows: a bound for every entry."""
        r = np.where(self._x0 != 0.0, np.abs(self._x0).sum(), 0.0)
        for k, u in enumerate(self._u):
            r = _row_range(self._A, r)
            if self._sample_B:
                r = r + _row_range(self._B, np.abs(u))
            elif k < len(self._u) - 1:
                r = r + np.abs(self._B @ u)
        return float(np.linalg.norm(r))


class TrajectoryMcDiarmid(Trajectory):
    """McDiarmid's inequality after K steps: ``sqrt(tr S_K / N) + R_K sqrt(2 L / N)``.

    Parameters
    ----------
    A, B, x0, u, axis, sample_B
        As in :class:`Trajectory`.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Trajectory`.

    Notes
    -----
    ``S_K`` is the exact covariance of one run, and ``R_k`` bounds ``||xhat(s, k)||_1``:
    ``R_0 = g0``, ``R_{k+1} = gA R_k + sum_j |u_j(k)| h_j`` with ``h_j = ||b_j||_1``. (With B exact
    the last control shifts all runs alike and does not count.) Rows: ``R_K = ||r(K)||_2``, where
    ``r`` bounds every entry, ``r_i(k+1) = rho_i max_j r_j(k) + h_i max_j |u_j(k)|`` over the j that
    row i of A, of B can hit. Lemma 4.3 has no K in its bound, while ``tr S_K`` may grow
    geometrically.

    Examples
    --------
    >>> import numpy as np
    >>> from stochens_rs.theory import bounds
    >>> A = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2.0)
    >>> x0, u = np.full(2, 0.5**0.5), np.zeros((10, 1))
    >>> round(bounds.TrajectoryMcDiarmid(A, [[1.0], [0.0]], x0, u).radius(10_000, 0.01), 3)
    1.826
    """

    name = "McDiarmid"
    source = "bounded differences 2 R_K / N in N independent runs; mean at most the exact rms"

    def _prepare(self) -> None:
        self._spread = finite(2.0 * square(self._range))

    def _radius(self, rates: Rates, level: float) -> float:
        return mcdiarmid(self._rms(rates), self._spread * rates[0], level)

    def _level(self, rates: Rates, eps: float) -> float:
        return mcdiarmid_level(self._rms(rates), self._spread * rates[0], eps)


class TrajectoryBousquet(Trajectory):
    """Bousquet's inequality after K steps: ``E + sqrt(2 L (lam + 2 U E)) + U L / 3``.

    Parameters
    ----------
    A, B, x0, u, axis, sample_B
        As in :class:`Trajectory`.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Trajectory`.

    Notes
    -----
    ``E^2 = tr S_K / N``, ``lam = lambda_max(S_K) / N`` and ``U = (R_K + ||x(K)||) / N`` with the
    exact covariance ``S_K`` of one run and ``R_K`` of :class:`TrajectoryMcDiarmid` (with B exact
    both without ``B u(K - 1)``). For many runs
    this is the best, as typical runs are far shorter than ``R_K``.

    Examples
    --------
    >>> import numpy as np
    >>> from stochens_rs.theory import bounds
    >>> A = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2.0)
    >>> x0, u = np.full(2, 0.5**0.5), np.zeros((10, 1))
    >>> round(bounds.TrajectoryBousquet(A, [[1.0], [0.0]], x0, u).radius(10_000, 0.01), 3)
    1.45
    """

    name = "Bousquet"
    source = "supremum of <v, average of the runs - x(K)> over unit vectors v"

    def _prepare(self) -> None:
        finite(self._farthest)
        self._variance = max(0.0, float(np.linalg.eigvalsh(self._covariance)[-1]))

    def _constants(self, rates: Rates) -> tuple[float, float, float]:
        return self._rms(rates), self._variance * rates[0], self._farthest * rates[0]

    def _radius(self, rates: Rates, level: float) -> float:
        return bousquet(*self._constants(rates), level)

    def _level(self, rates: Rates, eps: float) -> float:
        return bousquet_level(*self._constants(rates), eps)


class TrajectoryChebyshev(Trajectory):
    """Chebyshev's inequality after K steps: ``sqrt(tr S_K / (N delta))``.

    Parameters
    ----------
    A, B, x0, u, axis, sample_B
        As in :class:`Trajectory`.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Trajectory`.

    Notes
    -----
    ``S_K`` is the exact covariance of one run. This proves Lemma 3.1 for unbiased realizations.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> bound = bounds.TrajectoryChebyshev([[1.0]], [[1.0], [1.0]][:1], [3.0], [[2.0]])
    >>> bound.radius(10, 0.1)
    0.0
    """

    name = "Chebyshev"
    source = "Markov's inequality for the squared error"

    def _radius(self, rates: Rates, level: float) -> float:
        return self._rms(rates) * math.exp(level / 2.0)

    def _level(self, rates: Rates, eps: float) -> float:
        return chebyshev_level(self._rms(rates), eps)


def _row_range(A: Array, r: Array) -> Array:
    """``rho_i max_j r_j`` over the entries that row i can hit."""
    largest = np.where(A != 0.0, r, 0.0).max(axis=1)
    return np.asarray(np.abs(A).sum(axis=1) * largest, dtype=np.float64)


def finite(value: float) -> float:
    """Refuse what overflowed."""
    if not math.isfinite(value):
        raise NonFiniteError("the moments of the trajectory overflow: scale the problem down")
    return value
