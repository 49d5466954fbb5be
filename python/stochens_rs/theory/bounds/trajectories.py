"""Bounds for the average of N runs of the sampled system, open loop, fresh draws at every step.

``xhat(s, k+1) = A^(s,k) xhat(s, k) + B^(s,k) u(k)``, ``xhat(s, 0) = x0^s``: Lemma 4.3, corrected.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ... import _gate
from ...exceptions import NonFiniteError, ShapeError
from ..moments._formulas import _AXES, Array, Axis, _excess, _vector_covariance
from ._base import Bound, Rates, unit_of
from ._inequalities import mcdiarmid, mcdiarmid_level


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
        self._A = _gate.matrix("A", A, square=True)
        self._B = _gate.matrix("B", B, rows=len(self._A))
        start = _gate.vector("x0", x0, length=len(self._A))
        inputs = _gate.matrix("u", u, cols=self._B.shape[1])
        self._axis = _gate.choice("axis", axis, _AXES)
        self._sample_B = bool(sample_B)
        # linear in (x0, u), so that their unit is that of the result
        self._unit = max(unit_of(start) if start.any() else 0.0, float(np.abs(inputs).max())) or 1.0
        self._x0, self._u = start / self._unit, inputs / self._unit
        with np.errstate(over="ignore", invalid="ignore"):
            self._mean_square = self._trace()
        self._prepare()

    def _prepare(self) -> None:
        """Compute the constants of the bound."""

    def _trace(self) -> float:
        """``tr S_K``: ``S_{k+1} = A S_k A^T + E[A^s M A^sT] - A M A^T + T_B(u_k * u_k)``."""
        A, B, axis = self._A, self._B, self._axis
        mean, S = self._x0, _vector_covariance(self._x0)
        for u in self._u:
            S = A @ S @ A.T + _excess(A, S + np.outer(mean, mean), axis)
            if self._sample_B:
                S = S + _excess(B, np.outer(u, u), axis)
            mean = A @ mean + B @ u
        return _finite(max(0.0, float(np.trace(S))))

    def _rms(self, rates: Rates) -> float:
        return math.sqrt(self._mean_square * rates[0])


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
    the last control shifts all runs alike and does not count.) Rows: ``gA`` is the largest
    1-norm of a realization, ``max_j sum_i rho_i [a_ij != 0]``, and B likewise. Lemma 4.3 has no K
    in its bound, while ``tr S_K`` may grow geometrically.

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
        gain = _largest_one_norm(self._A, self._axis)
        radius = float(np.abs(self._x0).sum())
        with np.errstate(over="ignore"):
            for k, u in enumerate(self._u):
                last = k == len(self._u) - 1
                radius = gain * radius + self._pushed(u, last)
        self._spread = _finite(2.0 * radius * radius)

    def _pushed(self, u: Array, last: bool) -> float:
        """The largest 1-norm that the control adds to a run."""
        if not self._sample_B:
            return 0.0 if last else float(np.abs(self._B @ u).sum())
        if self._axis == "columns":
            return float(np.abs(self._B).sum(axis=0) @ np.abs(u))
        largest = np.where(self._B != 0.0, np.abs(u), 0.0).max(axis=1)
        return float(np.abs(self._B).sum(axis=1) @ largest)

    def _radius(self, rates: Rates, level: float) -> float:
        return mcdiarmid(self._rms(rates), self._spread * rates[0], level)

    def _level(self, rates: Rates, eps: float) -> float:
        return mcdiarmid_level(self._rms(rates), self._spread * rates[0], eps)


class OneStepMcDiarmid(Trajectory):
    """The sharp form for one step: ``sqrt(tr S_1 / N) + sqrt(V L / N)``.

    Parameters
    ----------
    A : (n, n) array_like
        State matrix.
    B : (n, m) array_like
        Input matrix.
    x0 : (n,) array_like
        Initial state.
    u : (1, m) array_like
        The control.
    sample_B : bool, default True
        Whether ``B`` is sampled, too; else it is known exactly, and ``h = 0``.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Trajectory`, or `u` has more than one step.

    Notes
    -----
    ``V = 2 g0^2 gA^2 + sum_j u_j^2 h_j^2``. The coordinates of one run are ``A^s x0^s``, one entry
    of at most ``g0 gA``, and the columns of ``B^s``; ``gA`` is taken over the columns that ``x0``
    reaches. Columns only.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> A, B, x0, u = [[1.0, 0.0], [2.0, 5.0]], [[1.0], [1.0]], [1.0, 1.0], [[2.0]]
    >>> bound = bounds.OneStepMcDiarmid(A, B, x0, u)
    >>> round(bound.radius(10_000, 0.01), 4)
    0.3664
    """

    name = "McDiarmid, one step"
    source = "bounded differences in A^s x0^s and in every column of B^s"

    def __init__(
        self, A: ArrayLike, B: ArrayLike, x0: ArrayLike, u: ArrayLike, *, sample_B: bool = True
    ) -> None:
        super().__init__(A, B, x0, u, sample_B=sample_B)

    def _prepare(self) -> None:
        gA, g0, pushed = _one_step(self)
        self._spread = _finite(2.0 * (g0 * gA) ** 2 + float((pushed**2).sum()))

    def _radius(self, rates: Rates, level: float) -> float:
        return mcdiarmid(self._rms(rates), self._spread * rates[0], level)

    def _level(self, rates: Rates, eps: float) -> float:
        return mcdiarmid_level(self._rms(rates), self._spread * rates[0], eps)


class OneStepHoeffding(Trajectory):
    """Lemma 4.3 for one step with the constants that make it true.

    Parameters
    ----------
    A : (n, n) array_like
        State matrix.
    B : (n, m) array_like
        Input matrix.
    x0 : (n,) array_like
        Initial state.
    u : (1, m) array_like
        The control.
    sample_B : bool, default True
        Whether ``B`` is sampled, too; else it is known exactly, and ``gB = 0``.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Trajectory`, or `u` has more than one step.

    Notes
    -----
    ``P(error > eps) <= 4 [exp(-2 N eps^2 / (9 ||u||^2 gB^2)) + exp(-2 N eps^2 / (9 gA^2 g0^2))]``,
    dimension-free, and implied by :class:`OneStepMcDiarmid`. The printed second exponent has
    ``||A||`` for ``gA``, the printed third ``||x0||`` for ``g0``; both are false. Columns only.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> A, B, x0, u = [[1.0, 0.0], [2.0, 5.0]], [[1.0], [1.0]], [1.0, 1.0], [[2.0]]
    >>> bound = bounds.OneStepHoeffding(A, B, x0, u)
    >>> round(bound.radius(10_000, 0.01), 4)
    0.5192
    """

    name = "Hoeffding, one step"
    source = "implied by the sharp form: its exponent is at most 4/3 above, and e^(4/3) < 4"

    def __init__(
        self, A: ArrayLike, B: ArrayLike, x0: ArrayLike, u: ArrayLike, *, sample_B: bool = True
    ) -> None:
        super().__init__(A, B, x0, u, sample_B=sample_B)

    def _prepare(self) -> None:
        gA, g0, pushed = _one_step(self)
        gB = float(np.abs(self._B).sum(axis=0).max()) if pushed.any() else 0.0
        self._scales = (
            4.5 * _finite((gA * g0) ** 2),
            4.5 * _finite((float(np.linalg.norm(self._u)) * gB) ** 2),
        )

    def _level(self, rates: Rates, eps: float) -> float:
        exponents = [(eps / math.sqrt(s * rates[0])) ** 2 for s in self._scales if s * rates[0]]
        least = min(exponents, default=math.inf)
        if least == math.inf:
            return math.inf
        return least - math.log(4.0 * sum(math.exp(least - x) for x in exponents))


def _one_step(bound: Trajectory) -> tuple[float, float, Array]:
    """``gA`` over the columns that x0 reaches, ``g0``, and ``|u_j| h_j``."""
    if len(bound._u) != 1:
        raise ShapeError(f"`u` must have shape (1, m): one step, got {len(bound._u)} steps")
    reached = bound._A[:, bound._x0 != 0.0]
    gA = float(np.abs(reached).sum(axis=0).max(initial=0.0))
    pushed = np.abs(bound._u[0]) * np.abs(bound._B).sum(axis=0) * bound._sample_B
    return gA, float(np.abs(bound._x0).sum()), pushed


def _largest_one_norm(A: Array, axis: str) -> float:
    """Largest induced 1-norm of a realization."""
    if axis == "columns":
        return float(np.abs(A).sum(axis=0).max())
    return float((np.abs(A).sum(axis=1) @ (A != 0.0)).max())


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise NonFiniteError("the moments of the trajectory overflow: scale the problem down")
    return value
