"""`Limited`: the solution of a problem within limits, and how far from the best it is."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import isnan
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from .. import _core
from .._base import running
from .._base.numbers import ROUNDING
from .._base.records import Record, require_shapes
from .._base.running import get_num_threads
from .._base.types import Floats, Status
from ..exceptions import NonFiniteError
from ..theory.exact import matrix_powers
from .problem import Task

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from ..rng import Key
    from ..theory.drawn_bounds import PlanErrors


OPTIMAL = 1e-9  # the gap of an "optimal" control, in units of J(u), as in the core


@dataclass(frozen=True, eq=False)
class Limited(Record):
    """What is known about a control within limits. Made by `control`, and ``plan.limited`` there.

    Attributes
    ----------
    task : Task
        What was minimised.
    R : ndarray, shape (m, m)
        The weight of the inputs that was used.
    u : ndarray, shape (K, m)
        The control; inside its limits exactly.
    active : ndarray of int8, shape (K, m)
        -1 at the lower limit, 1 at the upper one.
    multipliers : ndarray, shape (K, m)
        Of the limits of the inputs, >= 0.
    gap : float
        ``J(u) - min J`` is at most this, recomputed from the data of the problem.
    distance : float
        ``(||G (u - u*)||_Q^2 + ||u - u*||_R^2)^(1/2)`` is at most this.
    objective : float
        ``J(u)``.
    missed : float or None
        What the limits cost: ``J(u)`` less the least J without limits; 0 if none is active, None if
        the time limit came before.
    status : str
        "optimal", or why it is not.
    missing : float
        By how much hard state limits cannot be met; 0 if they can. Else the control is the best
        one within limits that are wider by this, and so are gap and distance.
    state_active : ndarray of int8, shape (K, n), optional
        Of ``x(1), ..., x(K)``: -1 at or below the lower limit to rounding, 1 at or above the
        upper one, else 0; None without limits of states.
    feedback : ndarray, shape (K, m, n), optional
        Where the system grows so much over the steps that rounding of the inputs may: the plan is
        ``u(k) + feedback[k] (x(k) - xh(k))`` within the limits of the inputs, and `objective`,
        `gap` and `distance` are those of a plan that is followed so. None where `u` alone will do.
    states : ndarray, shape (K, n), optional
        Then the states ``xh(1), ..., xh(K)`` of that plan.
    open_until : int, optional
        Then the steps over which the inputs alone lead to these states, to 1e-7 of the largest.
    open_objective : float, optional
        Then J of the inputs alone; infinite where it overflows.
    """

    task: Task
    R: Annotated[Floats, "input input"]
    u: Annotated[Floats, "step input"]
    active: Annotated[NDArray[np.int8], "step input"]
    multipliers: Annotated[Floats, "step input", "infinite"]
    gap: float
    distance: float
    objective: float
    missed: float | None
    status: Status
    missing: float = 0.0
    state_active: Annotated[NDArray[np.int8], "step state"] | None = None
    feedback: Annotated[Floats, "step input state", "infinite"] | None = None
    states: Annotated[Floats, "step state", "infinite"] | None = None
    open_until: int | None = None
    open_objective: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        require_shapes(self, u=self.task.low.shape, states=self.task.reference.shape)

    @property
    def rate_active(self) -> NDArray[np.int8]:
        """1 where an input rises by its rate to rounding, -1 where it falls by it, else 0; (K, m).

        Row k is of the change ``u(k) - u(k-1)``.
        """
        rate, previous = self.task.rate, self.task.previous
        if rate is None or previous is None:
            return np.zeros(self.u.shape, dtype=np.int8)
        change = np.diff(self.u, axis=0, prepend=previous[None])
        size = np.maximum(np.abs(self.u).max(axis=0), np.abs(previous))
        at = np.abs(change) >= rate - ROUNDING * np.maximum(rate, size)
        return np.where(at, np.sign(change), 0.0).astype(np.int8)


class Horizon:
    """A system ``x(k+1) = A x(k) + B u(k) + c`` and a task, whose best control the core computes.

    `wanted` and `R` take the place of the reference and of the weight R of `task`.
    """

    def __init__(
        self,
        task: Task,
        A: Floats,
        B: Floats,
        c: Floats | None = None,
        *,
        wanted: Floats | None = None,
        R: Floats | None = None,
    ) -> None:
        self.task, self.A, self.B, self._resting = task, A, B, task.resting
        if (rest := task.resting) is not None:  # of v = u - u_s, which is weighed: c + B u_s
            previous = None if task.previous is None else task.previous - rest
            low, high = task.low - rest, task.high - rest
            task = replace(task, low=low, high=high, previous=previous, resting=None)
            c = np.ascontiguousarray(B @ rest if c is None else c + B @ rest)
        with _exponents(task, A):
            self.core = _core.Horizon(A, B, c, task, wanted, R)
        if not self.core.long:
            self.need()

    def need(self) -> None:
        """Refuse a condensed map that does not fit into the memory this process may use."""
        columns = self.task.low.size + len(self.A) + 1
        running.need("the control within limits", 8 * self.core.rows * columns * 3)

    def objective(self, x0: Floats, u: Floats) -> float:
        """``J(u)``, with the weight of soft limits."""
        return self.core.objective(x0, u if self._resting is None else u - self._resting)

    def solve(self, x0: Floats, *, time_limit: float | None = None) -> Limited:
        """The best control from x0."""
        found = self.core.solve(x0, time_limit)
        u, followed = found.u, found.followed
        if self._resting is not None:
            u = np.clip(u + self._resting, self.task.low, self.task.high)
        more: dict[str, Any] = {}
        if followed is not None and followed[2] < len(u):  # else the inputs alone lead there
            states, feedback, until, alone = followed
            more = {"states": states, "feedback": feedback.reshape(*u.shape, -1)}
            more |= {"open_until": until, "open_objective": alone}
        missed = None if isnan(found.missed) else found.missed
        gaps = found.gap, found.distance, found.objective, missed
        ended = found.status, found.missing, found.state_active
        made = self.task, self.core.r, u, found.active, found.multipliers
        return Limited(*made, *gaps, *ended, **more)


def loop_of(task: Task, A: Floats, B: Floats, c: Floats | None) -> _core.Loop:
    """What solves the plans of a `Regulator`, one state after another."""
    with _exponents(task, A):
        return _core.Loop(A, B, c, task)


@contextmanager
def _exponents(task: Task, A: Floats) -> Iterator[None]:
    """Where something overflows, name the power of A that does, if one does."""
    try:
        yield
    except NonFiniteError:
        matrix_powers(A, task.steps)
        raise


# Costs [ns] of one control within limits, measured on one thread (x86-64), within a factor of
# three. They decide how many are drawn, and change no probability.
_SOLVE, _PER_CUBE, _PER_ENTRY = 5e3, 3.0, 15.0


@dataclass(frozen=True, eq=False)
class MovedTarget:
    """``||P_Q (b^ - b)||_Q``, P_Q onto the range of the exact map, ``b_k = r(k) - A^k x0``.

    With soft limits of the states ``||dc||_W + ||dr||_Q``, ``c_k = A^k x0``, W with their weight.
    """

    plan: PlanErrors
    exact: Horizon

    @property
    def cost(self) -> float:
        """As `Errors.cost`."""
        # over several steps, or with soft limits, a problem of twice as many states is drawn
        twice = self.exact.task.steps > 1 or self.exact.task.soft is not None
        return (4.0 if twice else 1.0) * self.plan.cost

    def rounded(self, radii: tuple[float, ...]) -> tuple[float, ...]:
        """As `Errors.rounded`."""
        x0, xf, _ = (np.linalg.norm(entity.values) for entity in self.plan.entities)
        _, start, goal = self.exact.core.norms()
        size = float(start * x0 + goal * xf)
        return tuple(radius + ROUNDING * (radius + size) for radius in radii)

    def draw(self, runs: int, key: Key) -> Floats:
        """Independent errors, (runs, 1)."""
        x0, xf, _ = (np.ascontiguousarray(entity.values) for entity in self.plan.entities)
        how = runs, self.cost, key.bytes32, get_num_threads()
        drawn, rows = _drawn(self.plan)
        return self.exact.core.moved_targets(drawn, rows, self.plan.paired, x0, xf, *how)[:, None]


@dataclass(frozen=True, eq=False)
class LimitedErrors:
    """``||M (u - v)||``, ``||u - v||_2`` and ``J(u) - J(v)``, v the best of the exact system.

    u is the control within limits of the estimates that a run draws. With R="auto" each run has
    its own R, in u and in v.
    """

    plan: PlanErrors
    exact: Horizon
    limited: Limited
    follows: bool  # whether the reference is xf

    @property
    def cost(self) -> float:
        """As `Errors.cost`."""
        rows, d, n = self.exact.core.rows, self.limited.u.size, len(self.exact.A)
        solve = _SOLVE + _PER_CUBE * d**3 + _PER_ENTRY * (rows + d) * d
        return float(100.0 * (n + 2) * n + solve * (2.0 if self.limited.task.R is None else 1.0))

    def rounded(self, radii: tuple[float, ...]) -> tuple[float, ...]:
        """As `Errors.rounded`."""
        size = float(np.abs(self.limited.u).max(initial=0.0))
        gain, _, _ = self.exact.core.norms()
        scales = gain * size, size, (gain * size) ** 2
        return tuple(r + ROUNDING * (r + scale) for r, scale in zip(radii, scales, strict=True))

    def draw(self, runs: int, key: Key) -> Floats:
        """Independent errors, (runs, 3)."""
        x0 = np.ascontiguousarray(self.plan.entities[0].values)
        law = *_drawn(self.plan), x0, self.follows, self.limited.task.R is None
        return self.exact.core.drawn_errors(*law, runs, self.cost, key.bytes32, get_num_threads())


def _drawn(plan: PlanErrors) -> tuple[tuple[Any, Any, Any], bool]:
    """The entities as the core takes them, and whether A is drawn by rows."""
    x0, xf, A = plan.entities
    lines = A.argument(transpose=not (plan.rows and A.drawn))
    return (x0.argument(), xf.argument(), lines), plan.rows
