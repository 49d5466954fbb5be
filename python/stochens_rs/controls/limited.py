"""The best control within limits: the problem as least squares, solved by the core."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, isnan, nan, sqrt
from time import perf_counter
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from .. import _core
from .._base import memory, validation
from .._base.numbers import ROUNDING, norm
from .._base.records import Record, require_shapes
from .._base.types import STATUSES, Floats, Status
from ..exceptions import InputError, NonFiniteError
from ..theory.dynamics import matrix_powers, states
from ..theory.exact import EPS
from .constraints import REGULAR, Task, root

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    _Steps: TypeAlias = tuple[Floats, Floats, Floats, Floats, Floats, Floats, Floats]

# From this many inputs on the recursion of Riccati is faster than condensed matrices (measured for
# few states), unless its work, n^2 (3 n + 4 m) for each step and factorization, is larger.
LONG = 250
FACTORS = 8  # that are usual
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
        What the limits cost: ``J(u)`` less the least J without limits; 0 if none is active, nan if
        the time limit came before.
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
        validation.instance("task", self.task, Task)
        K, m = validation.kept("u", self.u, shape=self.task.low.shape).shape
        states = self.task.reference.shape
        require_shapes(self, R=(m, m), active=(K, m), multipliers=(K, m), state_active=states)
        validation.choice("status", self.status, STATUSES)

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
                np.broadcast_to(validation.vector("xf", xf, length=len(wanted[0])), wanted.shape)
            )
        elif xf is not None:
            raise InputError("`xf` must be None: this plan has a reference")
        return replace(self.task, reference=wanted, R=self.R)


def _sides(values: Floats, low: Floats, high: Floats, size: Floats) -> NDArray[np.int8]:
    """1 where `values` are at `high` or above to rounding beside `size`, -1 at `low` or below."""
    near = ROUNDING * size
    found = np.where(values >= high - near, 1, np.where(values <= low + near, -1, 0))
    return found.astype(np.int8)


def _left(time_limit: float | None, started: float) -> float | None:
    return None if time_limit is None else max(0.0, time_limit - (perf_counter() - started))


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
        with np.errstate(over="ignore", invalid="ignore"):
            self.pushes = np.empty((K, n, m))  # A^p B
            self.pushes[0] = B
            for p in range(1, K):
                self.pushes[p] = A @ self.pushes[p - 1]
            self.roots = task.weights()
            # Q^1/2 A^p B, of the stages and at the end
            self._seen = tuple(factor @ self.pushes for factor in self.roots)
            # tr(G'QG) = sum_p (K - 1 - p) ||Q^1/2 A^p B||^2 + ||Qf^1/2 A^p B||^2
            left = np.arange(K - 1, -1, -1)
            size = np.sum(self._seen[0] ** 2, axis=(1, 2)) @ left + np.sum(self._seen[1] ** 2)
        if not np.isfinite(size):
            matrix_powers(A, K)  # raises if one of them overflows, with its exponent
            raise NonFiniteError("the weighted effect of the inputs overflows: scale it down")
        regular = REGULAR * float(size) / (m * K) or 1.0
        self.R: Floats = regular * np.eye(m) if task.R is None else task.R

    @cached_property
    def powers(self) -> Floats:
        """``I, A, ..., A^K``, (K + 1, n, n)."""
        return matrix_powers(self.A, self.task.steps)

    @property
    def long(self) -> bool:
        """Whether the recursion of Riccati is used."""
        (n, m), K = self.B.shape, self.task.steps
        if K * m < LONG or K == 1:
            return False
        rows = (K - 1) * len(self.roots[0]) + len(self.roots[1])
        condensed, recursion = (K * m) ** 2 * (rows + K * m), K * n * n * (3 * n + 4 * m)
        return K >= LONG or condensed > FACTORS * recursion

    @cached_property
    def drift(self) -> Floats:
        """``x(1), ..., x(K)`` from 0 without inputs: what the offset c does."""
        n, K = len(self.A), self.task.steps
        if self.c is None:
            return np.zeros((K, n))
        return states(self.A, np.eye(n), np.zeros(n), np.broadcast_to(self.offset, (K, n)))[1:]

    @cached_property
    def condensed(self) -> Floats:
        """``M`` (rows, m K): ``F x(k)`` of the inputs for the roots F of the weights, k = 1..K."""
        K, m = self.task.steps, self.B.shape[1]
        stage, terminal = self._seen
        rows, row = (K - 1) * stage.shape[1] + terminal.shape[1], 0
        memory.need("the control within limits", 8 * rows * (m * K + len(self.A) + 1) * 3)
        M = np.zeros((rows, K, m))
        for k in range(1, K + 1):
            seen = terminal if k == K else stage
            # x(k) = A^k x0 + sum_{j<k} A^(k-1-j) B u(j)
            part = slice(row, row := row + seen.shape[1])
            M[part, :k] = seen[k - 1 :: -1].transpose(1, 0, 2)
        return M.reshape(rows, K * m)

    def _weighed(self, along: Floats) -> Floats:
        """``F x(k)`` of x(1), ..., x(K), (K, n) or (K, n, columns), below each other."""
        stage, terminal = self.roots
        parts = [stage @ x for x in along[:-1]] if len(stage) else []
        return np.concatenate([*parts, terminal @ along[-1]])

    @cached_property
    def weighted(self) -> tuple[Floats, Floats, Floats]:
        """``M`` (rows, m K), ``state`` (rows, n) and ``target`` (rows,)."""
        state = self._weighed(self.powers[1:])
        return self.condensed, state, self._weighed(self.task.reference - self.drift)

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
            M = np.vstack([self.condensed, np.kron(np.eye(self.task.steps), root(self.R))])
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
        task, started = self.task, perf_counter()
        found = self.best(x0, task, time_limit)
        shape = task.low.shape
        u = found.control.reshape(shape)
        least = nan if found.status == "user_limit" else found.objective
        state_active = None
        if task.state_low is not None and task.state_high is not None:
            along = states(self.A, self.B, x0, u)[1:] + self.drift
            low, high = task.state_low, task.state_high
            state_active = _sides(along, low, high, np.abs(along).max(axis=0))
        if found.status != "user_limit" and (found.active.any() or not task.boxed):
            free = self.best(x0, task.unlimited(), _left(time_limit, started))
            least = nan if free.status == "user_limit" else free.objective
        return Limited(
            task=task,
            R=self.R,
            u=u,
            active=found.active.reshape(shape),
            multipliers=found.multipliers.reshape(shape),
            gap=found.gap,
            distance=found.distance,
            objective=found.objective,
            missed=nan if isnan(least) else max(0.0, found.objective - least),
            status=found.status,
            missing=found.missing if isinstance(found, _core.RowsControl) else 0.0,
            state_active=state_active,
        )

    def best(
        self, x0: Floats, task: Task, time_limit: float | None, warm: NDArray[np.int8] | None = None
    ) -> _core.BoxControl:
        """The best control from x0 as the core has it, begun at the active limits `warm`."""
        if not task.boxed:
            # x less what c does
            below, above = (
                None if side is None else side - self.drift
                for side in (task.state_low, task.state_high)
            )
            rows = task.low, task.high, task.rate, task.previous, below, above, task.soft
            return _core.rows_control(*self._steps(x0, task), *rows, warm, time_limit)
        if self.long:
            limits = task.low, task.high
            return _core.horizon_control(*self._steps(x0, task), *limits, warm, time_limit)
        started, alone = perf_counter(), states(self.A, self.B, x0, np.zeros(task.low.shape))[1:]
        y = self._weighed(task.reference - self.drift - alone)
        M, low, high = self.condensed, task.low.ravel(), task.high.ravel()
        left = _left(time_limit, started)
        return _core.box_control(M, y, self.cost(), low, high, warm, left)

    def _steps(self, x0: Floats, task: Task) -> _Steps:
        wanted = task.reference - self.drift
        return self.A, self.B, x0, wanted, task.stage, task.terminal, self.R
