"""The best control of known data, the state it leads to, and the rounding errors of both.

``y = xf - x_free`` is what a control has to add to the free motion. ``v = B^+ y`` is the smallest
of the controls that come nearest to it; over several steps ``C_K`` takes the place of ``B``.
``B^+`` is not formed here: with ``v = V (1/s) (U^T y)`` and one step of refinement, the error of
``B v`` is about ``eps ||B|| ||v||``; with the matrix ``B^+`` it would be ``eps condition ||y||``.

One rank rule for everything: singular values up to ``eta sigma_max``, ``eta = max(n, m) eps``,
count as 0. Allowances for rounding: the computed factors are those of a matrix at a distance of at
most ``theta ||B||`` (LAPACK Users' Guide, 4.9), with ``theta = (2 max(n, m) + 4) eps`` (measured:
``2.41 max(n, m) eps`` at most, for 2 700 matrices of up to 300 rows, half of them badly scaled).
Wedin, BIT 13 (1973) 217-232, bounds the effect on ``v`` and ``B v``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf, sqrt

import numpy as np

from .. import _core
from .._base import memory
from .._base.numbers import norm
from .._base.types import Floats
from ..exceptions import NonFiniteError
from .dynamics import controllability, matrix_powers
from .records import PlanError, Reachability

EPS = float(np.finfo(np.float64).eps)
REACHABLE = sqrt(EPS)  # 1.5e-8: relative residuals up to here, half of the digits, count as 0


@dataclass(frozen=True, eq=False)
class Factors:
    """``B = U diag(s) V^T`` with the numerical rank as inner size."""

    B: Floats
    U: Floats
    s: Floats
    V: Floats
    singular_values: Floats
    condition: float
    inverse: Floats

    def solve(self, y: Floats) -> Floats:
        """``B^+ y``, refined once: that brings ``B v`` 3 to 5 times nearer, at any condition."""
        v = self._apply(y)
        return v + self._apply(y - self.B @ v)

    def missed(self, y: Floats) -> Floats:
        """``(I - B B^+) y``."""
        return np.zeros_like(y) if len(self.s) == len(y) else y - self.U @ (self.U.T @ y)

    @property
    def off(self) -> float:
        """``theta ||B||``."""
        return float((2 * max(self.B.shape) + 4) * EPS * self.singular_values[0])

    @property
    def spread(self) -> float:
        """``eta ||B||_F``: rounding of a product ``B w`` with ``||w|| = 1``."""
        return float(max(self.B.shape) * EPS * norm(self.singular_values))

    def _apply(self, y: Floats) -> Floats:
        return np.asarray(self.V @ ((self.U.T @ y) / self.s))


def factors(B: Floats) -> Factors:
    """Factor a matrix; the work space is checked against memory."""
    B = np.ascontiguousarray(B)
    memory.need("the pseudoinverse of B", 8 * B.nbytes)  # factors, inverse and work space
    left, right, singular_values, condition, inverse = _core.pseudoinverse(B)
    if not np.isfinite(singular_values).all():
        raise NonFiniteError("the singular values of `B` overflow: scale the problem down")
    s = singular_values[: len(left)]
    return Factors(B, left.T, s, right.T, singular_values, condition, inverse)


@dataclass(frozen=True, eq=False)
class Best:
    """The best control for one right-hand side.

    `v` is in the order of ``C_K``: u(K-1), ..., u(0). `unsure` bounds the rounding in the norm of
    `needed` (``y``), `off` how far the matrix that was factored can be from the exact one, its
    factors included.
    """

    factors: Factors
    free: Floats
    needed: Floats
    v: Floats
    missed: Floats
    unsure: float
    off: float
    steps: int

    @property
    def u(self) -> Floats:
        """The control in the order of time: u(0), ..., u(K-1), (m K,)."""
        return self._reversed(self.v)

    def _reversed(self, u: Floats) -> Floats:
        """From the order of time, (m K,) or (K, m), to that of ``C_K``, or back."""
        return u.reshape(self.steps, -1)[::-1].ravel()

    @cached_property
    def pushed(self) -> Floats:
        """``B v``."""
        return np.asarray(self.factors.B @ self.v)

    @property
    def reached(self) -> Floats:
        """The state that the control leads to."""
        return np.asarray(self.free + self.pushed)

    def reachability(self) -> Reachability:
        """The part of the target that no control reaches, with its rounding error."""
        residual, needed = norm(self.missed), norm(self.needed)
        relative = residual / needed if needed else 0.0
        # if y = B v, then ||(I - P_hat) y|| = ||(I - P_hat) (B - B_hat) v|| <= off ||v||
        rounding = self.unsure + self.off * norm(self.v)
        return Reachability(
            residual=residual,
            relative=relative,
            rank=len(self.factors.s),
            condition=self.factors.condition,
            reachable=relative <= REACHABLE or residual <= rounding,
            rounding=rounding,
        )

    @property
    def gap(self) -> float:
        """A lower bound of the smallest singular value of the exact matrix; inf for rank 0."""
        return float(self.factors.s[-1]) - self.off if len(self.factors.s) else inf

    @property
    def _turned(self) -> float:
        """Effect of the rounded range: ``||P_hat (I-P) y|| <= off / sigma_min ||(I-P) y||``."""
        residual = norm(self.missed)
        if not residual:
            return 0.0
        return self.off / self.gap * residual if self.gap > 0.0 else inf

    @property
    def state_rounding(self) -> float:
        """Bound on the rounding error of ``||B v||``, of the state and of the residual."""
        return self.unsure + (self.off + self.factors.spread) * norm(self.v) + self._turned

    @property
    def control_rounding(self) -> float:
        """Bound on that of ``||v||``: ``(unsure + 2 off ||v|| + turned) / sigma_min``."""
        if self.gap <= 0.0:
            return inf
        size = norm(self.v)
        return (self.unsure + 2.0 * self.off * size + self._turned) / self.gap + EPS * size

    @property
    def moves(self) -> bool:
        """Whether ``B v`` can be told apart from 0."""
        return norm(self.pushed) > self.unsure + self._turned

    @property
    def arrives(self) -> bool:
        """Whether the state reached can be told apart from 0."""
        return norm(self.reached) > self.state_rounding

    def aside(self, u: Floats) -> Floats:
        """``(I - C_K^+ C_K) u`` in the order of ``C_K``: the part without effect on the state."""
        v, V = self._reversed(u), self.factors.V
        return np.asarray(v - V @ (V.T @ v))

    def error(self, u: Floats, x0: Floats) -> PlanError:
        """Compare another control, in the order of time, with this one."""
        with np.errstate(over="ignore", invalid="ignore"):
            wrong = self._reversed(u) - self.v
            shift = self.factors.B @ wrong
        representable(wrong, shift)
        control, state = norm(wrong), norm(shift)
        (to, size), (where, length) = self.compared("control", x0), self.compared("state", x0)
        return PlanError(
            control=control,
            control_relative=_ratio(control, size),
            state=state,
            state_relative=_ratio(state, length),
            residual=norm(self.missed),
            control_rounding=self.control_rounding + EPS * control,
            state_rounding=self.state_rounding + self.factors.spread * control,
            control_relative_to=to,
            state_relative_to=where,
        )

    def compared(self, quantity: str, x0: Floats) -> tuple[str, float]:
        """The vector that an error is relative to, by its name in `PlanError`, and its norm."""
        if quantity == "control":
            if self.moves:
                return "v", norm(self.v)
            name, size = "B^+ A x0", norm(self.factors.solve(self.free))
        elif self.arrives:
            return "x_actual", norm(self.reached)
        else:
            name, size = "x0", norm(x0)
        return (name, size) if size else ("nothing", 0.0)


def best(
    B: Floats, free: Floats, needed: Floats, unsure: float, off: float = 0.0, steps: int = 1
) -> Best:
    """Solve for the control that adds `needed` to `free`.

    `off` bounds the rounding in `B` itself, ``C_K`` for several steps.
    """
    representable(free, needed)
    found = factors(B)
    with np.errstate(over="ignore", invalid="ignore"):
        v, missed = found.solve(needed), found.missed(needed)
        made = Best(found, free, needed, v, missed, unsure, off + found.off, steps)
        representable(v, missed, made.pushed, made.reached)
    return made


def best_control(
    A: Floats, B: Floats, x0: Floats, xf: Floats, steps: int = 1, name: str = "A"
) -> Best:
    """Solve ``A^K x0 + C_K v = xf``; `name` is that of `A` in messages."""
    powers = matrix_powers(A, steps, name)
    C = controllability(powers[:-1], B)
    with np.errstate(over="ignore", invalid="ignore"):
        free = powers[-1] @ x0
        unsure, off = summed(powers[-1], x0, xf), 0.0
        if steps > 1:
            # A^(k+1) = A^k A is rounded by n eps ||A^k|| ||A|| for k > 0, and that is carried on:
            # ||error of A^k|| <= n eps ||A|| sum_{0 < i < k} ||A^i|| ||A^(k-1-i)||
            unit = len(A) * EPS
            size = np.linalg.norm(powers, axis=(1, 2))
            size[0] = 1.0
            rounded = np.append(0.0, size[1:])  # A^0 is exact
            wrong = np.append(0.0, unit * size[1] * np.convolve(rounded, size)[:steps])
            off = norm(B) * norm((wrong + unit * rounded)[:-1])
            unsure += norm(x0) * float(wrong[-1])
        return best(C, free, xf - free, unsure, off, steps)


def summed(A: Floats, x: Floats, other: Floats) -> float:
    """Bound of the rounding in ``other - A x``: ``(n + 1) eps || |A| |x| + |other| ||``.

    Higham, Accuracy and Stability of Numerical Algorithms (2002), 3.5.
    """
    unit = (len(x) + 1) * EPS
    return norm(np.abs(A) @ (unit * np.abs(x)) + unit * np.abs(other))


def representable(*results: Floats) -> None:
    """Refuse results that overflowed."""
    if not all(np.isfinite(result).all() for result in results):
        raise NonFiniteError(
            "`A x0`, `xf - A x0`, the control or the state it leads to overflows: scale the "
            "problem down"
        )


def _ratio(value: float, reference: float) -> float:
    if reference:
        return value / reference
    return inf if value else 0.0
