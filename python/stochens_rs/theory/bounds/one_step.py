"""Bounds for the average of N runs after one step, columns only: sharp, and as Lemma 4.3 has it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ...exceptions import ShapeError
from ..formulas import Array
from ._base import Rates
from ._inequalities import mcdiarmid, mcdiarmid_level, square
from .trajectories import Trajectory, finite


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
        self._spread = finite(2.0 * square(g0 * gA) + float((pushed**2).sum()))

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
            4.5 * finite(square(gA * g0)),
            4.5 * finite(square(float(np.linalg.norm(self._u)) * gB)),
        )

    def _level(self, rates: Rates, eps: float) -> float:
        exponents = [square(eps / math.sqrt(s * rates[0])) for s in self._scales if s * rates[0]]
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
