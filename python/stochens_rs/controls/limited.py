"""The best control within limits: the problem as least squares, solved by the core."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, sqrt
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from .. import _core
from .._base import gate, memory
from .._base.numbers import ROUNDING, norm
from .._base.records import Record, require_shapes
from .._base.types import STATUSES, Floats, Status
from ..exceptions import InputError, NonFiniteError
from ..theory.dynamics import matrix_powers, states
from ..theory.exact import EPS
from .task import REGULAR, Task, root

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    _Steps: TypeAlias = tuple[Floats, Floats, Floats, Floats, Floats, Floats, Floats]

# From this many inputs on the recursion of Riccati is faster than condensed matrices (measured).
LONG = 250
OPTIMAL = 1e-9  # the gap of an "optimal" control, in units of J(0) + J(u), as in the core


@dataclass(frozen=True, eq=False)
class Limited(Record):
    """What is known about a control within limits.

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
    missed : float
        What the limits cost: ``J(u)`` less the least J without limits; 0 if none is active.
    status : str
        "optimal", or why it is not.
    missing : float
        By how much hard state limits cannot be met; 0 if they can. Else the control is the best
        one within limits that are wider by this, and so are gap and distance.
    state_active : ndarray of int8, shape (K, n), optional
        Of ``x(1), ..., x(K)``: -1 at or below the lower limit to rounding, 1 at or above the
        upper one, else 0; None without limits of states.
    """

    task: Task
    R: Floats
    u: Floats
    active: NDArray[np.int8]
    multipliers: Floats
    gap: float
    distance: float
    objective: float
    missed: float
    status: Status
    missing: float = 0.0
    state_active: NDArray[np.int8] | None = None

    def __post_init__(self) -> None:
        gate.instance("task", self.task, Task)
        K, m = gate.kept("u", self.u, shape=self.task.low.shape).shape
        states = self.task.reference.shape
        require_shapes(self, R=(m, m), active=(K, m), multipliers=(K, m), state_active=states)
        gate.choice("status", self.status, STATUSES)

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
        return _sides(change, -rate, rate, np.maximum(rate, size))

    @property
    def limits_active(self) -> bool:
        """Whether an input is at a limit or changes by its rate, or a state is at a limit."""
        found = self.active, self.rate_active, self.state_active
        return any(bool(one.any()) for one in found if one is not None)

    def exact(self, xf: ArrayLike | None) -> Task:
        """The same task with the exact target, and with the weight R that was used."""
        wanted = self.task.reference
        if not self.task.follows:
            if xf is None:
                raise InputError("`xf` must be given: this plan has no reference")
            wanted = np.ascontiguousarray(
                np.broadcast_to(gate.vector("xf", xf, length=len(wanted[0])), wanted.shape)
            )
        elif xf is not None:
            raise InputError("`xf` must be None: this plan has a reference")
        return replace(self.task, reference=wanted, R=self.R)


def _sides(values: Floats, low: Floats, high: Floats, size: Floats) -> NDArray[np.int8]:
    """1 where `values` are at `high` or above to rounding beside `size`, -1 at `low` or below."""
    near = ROUNDING * size
    found = np.where(values >= high - near, 1, np.where(values <= low + near, -1, 0))
    return found.astype(np.int8)


class Horizon:
    """``x(k) = f(k) + sum_j G_kj u(j)`` as weighted least squares: ``J(u) = ||M u - y||^2 + u'Ru``.

    In `weighted`, ``y = target - state x0``. Of `task` only `previous` may be changed later.
    """

    def __init__(self, task: Task, A: Floats, B: Floats, c: Floats | None = None) -> None:
        n, m = B.shape
        K = task.steps
        A, B = np.ascontiguousarray(A), np.ascontiguousarray(B)  # as the core takes them
        self.task, self.A, self.B, self.c = task, A, B, c
        self.offset = np.zeros(n) if c is None else c
        powers = matrix_powers(A, K)
        with np.errstate(over="ignore", invalid="ignore"):
            self.pushes = powers[:-1] @ B  # A^p B
            self.powers = powers
            self.roots = task.weights()
            stage, terminal = self.roots
            # tr(G'QG) = sum_p (K - 1 - p) ||Q^1/2 A^p B||^2 + ||Qf^1/2 A^p B||^2
            left = np.arange(K - 1, -1, -1)
            size = np.sum((stage @ self.pushes) ** 2, axis=(1, 2)) @ left
            size += np.sum((terminal @ self.pushes) ** 2)
        if not np.isfinite(size):
            raise NonFiniteError("the weighted effect of the inputs overflows: scale it down")
        regular = REGULAR * float(size) / (m * K) or 1.0
        self.R: Floats = regular * np.eye(m) if task.R is None else task.R

    @property
    def long(self) -> bool:
        """Whether the recursion of Riccati is used."""
        return self.task.steps * self.B.shape[1] >= LONG and self.task.steps > 1

    @cached_property
    def drift(self) -> Floats:
        """``x(1), ..., x(K)`` from 0 without inputs: what the offset c does."""
        n, K = len(self.A), self.task.steps
        if self.c is None:
            return np.zeros((K, n))
        return states(self.A, np.eye(n), np.zeros(n), np.broadcast_to(self.offset, (K, n)))[1:]

    @cached_property
    def weighted(self) -> tuple[Floats, Floats, Floats]:
        """``M`` (rows, m K), ``state`` (rows, n) and ``target`` (rows,)."""
        K, (n, m) = self.task.steps, self.B.shape
        stage, terminal = self.roots
        # F x(k) = M u + state x0 + F drift(k) for all pairs (k, F)
        steps = [(k, stage) for k in range(1, K)] if len(stage) else []
        steps.append((K, terminal))
        wanted = self.task.reference - self.drift
        target = np.concatenate([factor @ wanted[k - 1] for k, factor in steps])
        rows = sum(len(factor) for _, factor in steps)
        memory.need("the control within limits", 8 * rows * (m * K + n + 1) * 3)
        M, state = np.zeros((rows, K, m)), np.empty((rows, n))
        row = 0
        for k, factor in steps:
            part = slice(row, row := row + len(factor))
            # x(k) = A^k x0 + sum_{j<k} A^(k-1-j) B u(j)
            M[part, :k] = np.einsum("rn,pnm->rpm", factor, self.pushes[k - 1 :: -1][:k])
            state[part] = factor @ self.powers[k]
        return M.reshape(rows, K * m), state, target

    def cost(self) -> Floats:
        """R of all inputs: its diagonal (m K,), or the matrix."""
        K, R = self.task.steps, self.R
        diagonal = np.diag(R)
        if np.array_equal(R, np.diag(diagonal)):
            return np.tile(diagonal, K)
        return np.asarray(np.kron(np.eye(K), R), dtype=np.float64)

    def objective(self, x0: Floats, u: Floats) -> float:
        """``J(u)``, with the weight of soft limits."""
        off = states(self.A, self.B, x0, u)[1:] + self.drift
        stage, terminal = self.roots
        value = float(np.sum((u @ self.R) * u))
        away = off - self.task.reference
        value += float(np.sum((away[:-1] @ stage.T) ** 2) + np.sum((terminal @ away[-1]) ** 2))
        low, high, soft = self.task.state_low, self.task.state_high, self.task.soft
        if soft is not None and low is not None and high is not None:
            beyond = np.maximum(off - high, 0.0) + np.maximum(low - off, 0.0)
            value += soft * float(np.sum(beyond**2))
        return float(value)

    def in_two_norm(self, distance: float) -> tuple[float, float]:
        """What a distance in the norm of the problem is for the control and the last state."""
        least = float(np.linalg.eigvalsh(self.R)[0])
        if not self.long:
            M = np.vstack([self.weighted[0], np.kron(np.eye(self.task.steps), root(self.R))])
            values = np.linalg.svd(M, compute_uv=False)
            sure = values[-1] - max(M.shape) * EPS * values[0]
            least = max(least, sure**2 if len(values) == M.shape[1] and sure > 0.0 else 0.0)
        control = distance / sqrt(least) if least > 0.0 else inf
        lowest = float(np.linalg.eigvalsh(self.task.terminal)[0])
        pushed = norm(self.pushes)
        state = pushed * control if pushed else 0.0  # no input moves a state: not 0 inf
        return control, min(state, distance / sqrt(lowest)) if lowest > 0.0 else state

    def solve(self, x0: Floats, *, time_limit: float | None = None) -> Limited:
        """The best control from x0."""
        task = self.task
        found = self.best(x0, task, time_limit)
        shape = task.low.shape
        u = found.control.reshape(shape)
        least = found.objective
        state_active = None
        if task.state_low is not None and task.state_high is not None:
            along = states(self.A, self.B, x0, u)[1:] + self.drift
            low, high = task.state_low, task.state_high
            state_active = _sides(along, low, high, np.abs(along).max(axis=0))
        if found.active.any() or not task.boxed:
            least = self.best(x0, task.unlimited(), None).objective
        return Limited(
            task=task,
            R=self.R,
            u=u,
            active=found.active.reshape(shape),
            multipliers=found.multipliers.reshape(shape),
            gap=found.gap,
            distance=found.distance,
            objective=found.objective,
            missed=max(0.0, found.objective - least),
            status=found.status,
            missing=found.missing if isinstance(found, _core.RowsControl) else 0.0,
            state_active=state_active,
        )

    def best(self, x0: Floats, task: Task, time_limit: float | None) -> _core.BoxControl:
        """The best control from x0 as the core has it."""
        if not task.boxed:
            # x less what c does
            below, above = (
                None if side is None else side - self.drift
                for side in (task.state_low, task.state_high)
            )
            limits = task.low, task.high, task.rate, task.previous, below, above, task.soft
            return _core.rows_control(*self._steps(x0, task), *limits, time_limit)
        if self.long:
            return self.by_recursion(x0, task, None, time_limit)
        M, state, target = self.weighted
        low, high = task.low.ravel(), task.high.ravel()
        return _core.box_control(M, target - state @ x0, self.cost(), low, high, None, time_limit)

    def by_recursion(
        self, x0: Floats, task: Task, warm: NDArray[np.int8] | None, time_limit: float | None
    ) -> _core.BoxControl:
        """The same by Riccati's recursion, begun at the active limits `warm`."""
        limits = task.low, task.high
        return _core.horizon_control(*self._steps(x0, task), *limits, warm, time_limit)

    def _steps(self, x0: Floats, task: Task) -> _Steps:
        wanted = task.reference - self.drift
        return self.A, self.B, x0, wanted, task.stage, task.terminal, self.R
