"""``x(k+1) = A x(k) + B u(k)`` over K steps: checked arguments, powers of A, ``C_K``, states."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from math import inf, sqrt
from typing import Any

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.numbers import norm
from .._base.records import cached_property
from .._base.types import Floats
from ..exceptions import NonFiniteError
from ..system.system import System
from .records import EPS as EPS
from .records import PlanError, Reachability, Verdict


def checked_ends(system: object, x0: object, xf: object) -> tuple[System, Floats, Floats]:
    """Check a system, its initial state and its target."""
    checked = System.from_any(system)
    how: Any = {"length": checked.n, "labels": checked.state_names}
    return checked, validation.vector("x0", x0, **how), validation.vector("xf", xf, **how)


def checked_motion(system: object, x0: object, u: object) -> tuple[System, Floats, Floats]:
    """Check a system, its initial state and its inputs."""
    checked = System.from_any(system)
    start = validation.vector("x0", x0, length=checked.n, labels=checked.state_names)
    return checked, start, validation.inputs("u", u, cols=checked.m, labels=checked.input_names)


def checked_steps(steps: object, n: int, m: int) -> int:
    """Check the number of steps against the memory that C_K and the powers of A take."""
    K = validation.size("steps", steps)
    # C_K with the work space of its factors, the powers of A with that of their norms, the states
    # and the control
    running.need(f"a control over {K} steps", (8 * n * m + 3 * n * n + n + m) * K * 8)
    return K


def matrix_powers(A: Floats, K: int, name: str = "A") -> Floats:
    """``[I, A, ..., A^K]``, (K + 1, n, n)."""
    powers = np.empty((K + 1, *A.shape))
    powers[0], powers[1:2] = np.eye(len(A)), A
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(1, K):
            powers[k + 1] = powers[k] @ A
            if not np.isfinite(powers[k + 1]).all():
                raise NonFiniteError(
                    f"`{name}` to the power {k + 1} overflows: take fewer steps, or scale the "
                    "time step down"
                )
    return powers


def controllability(powers: Floats, B: Floats) -> Floats:
    """``C_K = [B, A B, ..., A^{K-1} B]``, (n, m K), from ``[I, A, ..., A^{K-1}]``.

    Its blocks meet u(K-1), ..., u(0).
    """
    n, m = B.shape
    blocks = np.empty((len(powers), n, m))
    blocks[0] = B
    with np.errstate(over="ignore", invalid="ignore"):
        np.matmul(powers[1:], B, out=blocks[1:])
    if not np.isfinite(blocks).all():
        raise NonFiniteError("`A` to a power times `B` overflows: take fewer steps")
    return np.ascontiguousarray(blocks.transpose(1, 0, 2).reshape(n, -1))


def states(A: Floats, B: Floats, x0: Floats, u: Floats) -> Floats:
    """``x(k+1) = A x(k) + B u(k)`` from ``x(0) = x0``, (K + 1, n)."""
    x = np.empty((len(u) + 1, x0.size))
    x[0] = x0
    with np.errstate(over="ignore", invalid="ignore"):
        for k, u_k in enumerate(u):
            x[k + 1] = A @ x[k] + B @ u_k
    if not np.isfinite(x).all():
        k = int(np.argwhere(~np.isfinite(x))[0, 0])
        raise NonFiniteError(
            f"the state overflows at step {k}: scale the problem down, or take fewer steps"
        )
    return x


def spectral_norms(powers: Floats) -> Floats:
    """2-norm of every matrix of a stack."""
    return np.asarray(np.linalg.norm(powers, ord=2, axis=(1, 2)), dtype=np.float64)


REACHABLE = sqrt(EPS)  # 1.5e-8: relative residuals up to here, half of the digits, count as 0
LARGEST = 1e20  # times ||y|| / ||C_K||: `lower` is about controls up to there where rank is unsure


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
    running.need("the pseudoinverse of B", 8 * B.nbytes)  # factors, inverse and work space
    left, right, singular_values, condition, inverse = _core.pseudoinverse(B)
    if not np.isfinite(singular_values).all():
        raise NonFiniteError("the singular values of `B` overflow: scale the problem down")
    s = singular_values[: len(left)]
    return Factors(B, left.T, s, right.T, singular_values, condition, inverse)


@dataclass(frozen=True, eq=False)
class Best:
    """The best control for one right-hand side.

    `v` is in the order of ``C_K``: u(K-1), ..., u(0). `off` bounds how far the matrix that was
    factored can be from the exact one, its factors included, and `unsure` the rounding of
    ``xf - A^K x0`` in doubles. `control_rounding` and `state_rounding` bound ``||v - v*||`` and
    ``||C_K (v - v*)||`` for the exact control v*; `lower` and `upper` the least distance from the
    target, `lower` for all controls up to `size` in norm.
    """

    A: Floats
    B: Floats
    factors: Factors
    free: Floats
    needed: Floats
    v: Floats
    missed: Floats
    unsure: float
    off: float
    steps: int
    control_rounding: float
    state_rounding: float
    lower: float
    upper: float
    size: float

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
        """The part of the target that no control reaches, with bounds."""
        needed, gain = length(self.needed), float(self.factors.singular_values[0])
        # the wish is known to about eps of its own size, the unit of the rest
        near = max(REACHABLE * needed, self.unsure)
        verdict: Verdict
        if self.upper <= near:
            verdict = "reachable"
        elif self.lower > near and 2.0 * self.size * gain >= LARGEST * needed:
            verdict = "not reachable"
        else:
            verdict = "undecided"
        residual = length(self.missed)
        return Reachability(
            verdict=verdict,
            residual=residual,
            relative=residual / needed if needed else 0.0,
            lower=self.lower,
            upper=self.upper,
            size=self.size,
            rank=len(self.factors.s),
            condition=self.factors.condition,
        )

    @property
    def gap(self) -> float:
        """A lower bound of the smallest singular value of the exact matrix; inf for rank 0."""
        return gap(self.factors, self.off)

    def amplified(self, state: float) -> float:
        """What an error of the wish moves the control by at most; inf if no gap is known."""
        if not state:
            return 0.0
        return state / self.gap if self.gap > 0.0 else inf

    @property
    def moves(self) -> bool:
        """Whether `B v` can be told apart from the rounding of ``xf - A x0`` in doubles."""
        return norm(self.pushed) > self.unsure

    @property
    def arrives(self) -> bool:
        """Whether the state reached can be told apart from 0."""
        return norm(self.reached) > self.unsure + self.state_rounding

    def aside(self, u: Floats) -> Floats:
        """``(I - C_K^+ C_K) u`` in the order of ``C_K``: the part without effect on the state."""
        v, V = self._reversed(u), self.factors.V
        return np.asarray(v - V @ (V.T @ v))

    def error(self, u: Floats, x0: Floats) -> PlanError:
        """Compare another control, in the order of time, with this one."""
        with np.errstate(over="ignore", invalid="ignore"):
            # u - v = wrong + rest exactly (Knuth)
            other = self._reversed(u)
            wrong = other - self.v
            back = wrong - other
            rest = (other - (wrong - back)) - (self.v + back)
            representable(wrong, rest)
            shift, off = _core.pushed(self.A, self.B, self.steps, wrong, rest)
        representable(shift)
        control, state, residual = length(wrong), length(shift), length(self.missed)
        (to, size), (where, last) = self.compared("control", x0), self.compared("state", x0)
        # a norm of entries that are rounded once is rounded by 2 eps at most
        return PlanError(
            control=control,
            control_relative=_ratio(control, size),
            state=state,
            state_relative=_ratio(state, last),
            residual=residual,
            control_rounding=self.control_rounding + 2.0 * EPS * control,
            state_rounding=self.state_rounding + off + 2.0 * EPS * max(state, residual),
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


def best(B: Floats, free: Floats, needed: Floats) -> Best:
    """Solve ``B v = needed`` for the control that adds `needed` to `free` in one step."""
    nothing = np.zeros(len(B))
    made = _solved(np.zeros((len(B), len(B))), B, B, nothing, needed, 1, 0.0)
    return replace(made, free=free, unsure=EPS * (norm(free) + norm(free + needed)))


def best_control(
    A: Floats, B: Floats, x0: Floats, xf: Floats, steps: int = 1, name: str = "A"
) -> Best:
    """Solve ``A^K x0 + C_K v = xf``; `name` is that of `A` in messages."""
    C, off = _rounded_controllability(A, B, steps, name)
    return _solved(A, B, C, x0, xf, steps, off, name)


def _rounded_controllability(A: Floats, B: Floats, steps: int, name: str) -> tuple[Floats, float]:
    """``[B, A B, ..., A^{K-1} B]``, and a bound of its rounding in the Frobenius norm.

    ``A X`` is rounded by at most ``n eps |A| |X|``, and that is carried on (Higham, Accuracy and
    Stability of Numerical Algorithms (2002), 3.5).
    """
    if steps == 1:
        return B, 0.0
    blocks, wrong, size = [B], [np.zeros_like(B)], np.abs(A)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(steps - 1):
            wrong.append(size @ (wrong[-1] + len(A) * EPS * np.abs(blocks[-1])))
            blocks.append(A @ blocks[-1])
    C = np.hstack(blocks)
    if not np.isfinite(C).all():
        matrix_powers(A, steps, name)  # refuses a power that overflows
        raise NonFiniteError("`A` to a power times `B` overflows: take fewer steps")
    return C, norm(np.hstack(wrong))


def _solved(
    A: Floats,
    B: Floats,
    C: Floats,
    x0: Floats,
    xf: Floats,
    steps: int,
    off: float,
    name: str = "A",
) -> Best:
    found = factors(C)
    off += found.off
    A, B = np.ascontiguousarray(A), np.ascontiguousarray(B)
    parts = (
        np.ascontiguousarray(found.U.T),
        np.ascontiguousarray(found.V.T),
        found.singular_values,
        gap(found, off),
    )
    vectors, numbers = _core.best_control(
        A, B, steps, parts, np.ascontiguousarray(x0), np.ascontiguousarray(xf)
    )
    v, free, needed, missed = vectors
    control, state, upper, lower, size, unit = numbers
    if not (np.isfinite(free).all() and np.isfinite(needed).all()):
        matrix_powers(A, steps, name)  # refuses a power that overflows
    with np.errstate(over="ignore", invalid="ignore"):
        made = Best(
            A=A,
            B=B,
            factors=found,
            free=free,
            needed=needed,
            v=v,
            missed=missed,
            unsure=(len(B) + 1) * EPS * unit,
            off=off,
            steps=steps,
            control_rounding=control,
            state_rounding=state,
            lower=lower,
            upper=upper,
            size=size,
        )
        representable(free, needed, v, missed, made.pushed, made.reached)
    return made


def gap(found: Factors, off: float) -> float:
    """A lower bound of the least singular value that is not 0, of a matrix at a distance `off`."""
    return float(found.s[-1]) - off if len(found.s) else inf


def length(x: Floats) -> float:
    """``||x||``, rounded once."""
    return math.hypot(*x.ravel().tolist())


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
