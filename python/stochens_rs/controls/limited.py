"""The best control within limits: the problem as least squares, solved by the core."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base import gate, memory
from .._base.records import by_constructor
from .._base.types import STATUSES, Floats, Status
from ..theory.dynamics import matrix_powers, states
from .task import REGULAR, Task

if TYPE_CHECKING:
    from numpy.typing import NDArray

# From this many inputs on the recursion of Riccati is faster than condensed matrices (measured).
LONG = 250


@dataclass(frozen=True, eq=False)
class Limited:
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
        ``J(u) - min J`` is at most this; recomputed from the data.
    distance : float
        ``(||G (u - u*)||_Q^2 + ||u - u*||_R^2)^(1/2)`` is at most this.
    objective : float
        ``J(u)``.
    missed : float
        What the limits cost: ``J(u)`` less the least J without limits.
    status : str
        "optimal", or why it is not.
    missing : float
        By how much hard state limits cannot be met; 0 if they can.
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

    def __post_init__(self) -> None:
        gate.instance("task", self.task, Task)
        gate.kept("u", self.u, ndim=(2,))
        gate.choice("status", self.status, STATUSES)

    def __reduce__(self) -> tuple[Any, ...]:
        return by_constructor(self)

    @property
    def limits_active(self) -> bool:
        """Whether an input is at a limit."""
        return bool(self.active.any())


class Horizon:
    """``x(k) = f(k) + sum_j G_kj u(j)`` as weighted least squares: ``J(u) = ||M u - y||^2 + u'Ru``.

    `state` is the matrix with ``y = target - state x0``.
    """

    def __init__(self, task: Task, A: Floats, B: Floats, c: Floats | None = None) -> None:
        n, m = B.shape
        K = task.steps
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
        regular = REGULAR * float(size) / (m * K) or 1.0
        self.R = regular * np.eye(m) if task.R is None else task.R

    @property
    def long(self) -> bool:
        """Whether the recursion of Riccati is used."""
        return self.task.steps * self.B.shape[1] >= LONG and self.task.steps > 1

    def drift(self) -> Floats:
        """``x(1), ..., x(K)`` from 0 without inputs: what the offset c does."""
        n, K = len(self.A), self.task.steps
        if self.c is None:
            return np.zeros((K, n))
        return states(self.A, np.eye(n), np.zeros(n), np.broadcast_to(self.offset, (K, n)))[1:]

    def weighted(self) -> tuple[Floats, Floats, Floats]:
        """``M`` (rows, m K), ``state`` (rows, n) and ``target`` (rows,)."""
        K, (n, m) = self.task.steps, self.B.shape
        stage, terminal = self.roots
        steps = [(k, stage) for k in range(1, K)] if len(stage) else []
        steps.append((K, terminal))
        rows = sum(len(factor) for _, factor in steps)
        memory.need("the control within limits", 8 * rows * (m * K + n + 1) * 3)
        M, state, target = np.zeros((rows, K, m)), np.empty((rows, n)), np.empty(rows)
        wanted = self.task.reference - self.drift()
        row = 0
        for k, factor in steps:
            part = slice(row, row := row + len(factor))
            # x(k) = A^k x0 + sum_{j<k} A^(k-1-j) B u(j)
            M[part, :k] = np.einsum("rn,pnm->rpm", factor, self.pushes[k - 1 :: -1][:k])
            state[part], target[part] = factor @ self.powers[k], factor @ wanted[k - 1]
        return M.reshape(rows, K * m), state, target

    def cost(self) -> Floats:
        """R of all inputs: its diagonal (m K,), or the matrix."""
        K, R = self.task.steps, self.R
        diagonal = np.diag(R)
        if np.array_equal(R, np.diag(diagonal)):
            return np.tile(diagonal, K)
        return np.kron(np.eye(K), R)

    def solve(self, x0: Floats, *, time_limit: float | None = None) -> Limited:
        """The best control from x0."""
        task = self.task
        found = self._solve(x0, task.low, task.high, time_limit)
        free = found
        if task.bounded:
            K, m = task.low.shape
            none = np.full((K, m), np.inf)
            free = self._solve(x0, -none, none, time_limit)
        shape = task.low.shape
        return Limited(
            task=task,
            R=self.R,
            u=found.control.reshape(shape),
            active=found.active.reshape(shape),
            multipliers=found.multipliers.reshape(shape),
            gap=found.gap,
            distance=found.distance,
            objective=found.objective,
            missed=max(0.0, found.objective - free.objective),
            status=found.status,
        )

    def _solve(
        self, x0: Floats, low: Floats, high: Floats, time_limit: float | None
    ) -> _core.BoxControl:
        task = self.task
        if self.long:
            wanted = task.reference - self.drift()
            weights = task.stage, task.terminal, self.R
            return _core.horizon_control(
                self.A, self.B, x0, wanted, *weights, low, high, None, time_limit
            )
        M, state, target = self.weighted()
        y = target - state @ x0
        return _core.box_control(M, y, self.cost(), low.ravel(), high.ravel(), None, time_limit)
