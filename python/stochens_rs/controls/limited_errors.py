"""The law of the error of a control within limits, whose realizations are drawn anew."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base.numbers import ROUNDING
from .._base.threads import get_num_threads
from ..theory.bounds.drawn_errors import Entity, PlanErrors
from .constraints import REGULAR, root
from .limited import Horizon
from .uncertain_map import weights

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..rng import Key
    from .limited import Limited

_CHUNK = 1 << 23  # numbers in the matrices of the controls that are computed at a time
# Costs [ns] of one control within limits, measured on one thread (x86-64), within a factor of
# three. They decide how many are drawn, and change no probability.
_SOLVE, _PER_CUBE, _PER_ENTRY = 5e3, 3.0, 15.0


@dataclass(frozen=True, eq=False)
class MovedTarget:
    """``||P_Q (b^ - b)||_Q``, P_Q onto the range of the exact map, ``b_k = r(k) - A^k x0``.

    With soft limits of the states ``||dc||_W + ||dr||_Q``, ``c_k = A^k x0``, W of `weights`.
    """

    plan: PlanErrors
    exact: Horizon

    @property
    def cost(self) -> float:
        """As `Errors.cost`."""
        return (4.0 if self._twice else 1.0) * self.plan.cost

    @property
    def _twice(self) -> bool:
        """Whether a problem of twice as many states is drawn, which has x0 and xf apart."""
        return self.exact.task.steps > 1 or self.exact.task.soft is not None

    def rounded(self, radii: tuple[float, ...]) -> tuple[float, ...]:
        """As `Errors.rounded`."""
        x0, xf, _ = (np.linalg.norm(entity.values) for entity in self.plan.entities)
        _, start, _ = self.exact.weighted
        size = np.linalg.norm(start) * x0 + np.linalg.norm(_goal(self.exact)) * xf
        return tuple(radius + ROUNDING * (radius + float(size)) for radius in radii)

    def draw(self, runs: int, key: Key) -> Floats:
        """Independent errors, (runs, 1)."""
        x0, xf, A = self.plan.entities
        n, K = len(x0.values), self.exact.task.steps
        M, start, _ = self.exact.weighted
        goal, y = _goal(self.exact), self.plan.best.needed
        basis = onto(M) @ goal
        scale = np.ones(len(basis))
        soft = self.exact.task.soft is not None
        if self._twice:  # one step: y = (xf, -A x0), or (xf, -x0)
            x0, xf = _padded(x0, n, 0), _padded(xf, 0, n)
            powers = self.exact.powers[1:] if K > 1 else np.eye(n)[None]
            A = _corner(Entity(np.eye(n)) if K > 1 else A)
            y = xf.values - A.values @ x0.values
            basis = onto(M) @ np.hstack([goal, start])
            scale = np.ones(len(basis))
            if soft:
                some = weights(self.exact.task, soft=True)
                moved = np.vstack([root(W) @ P for W, P in zip(some, powers, strict=True)])
                basis = np.zeros((len(moved) + len(goal), 2 * n))
                basis[: len(moved), n:], basis[len(moved) :, :n] = moved, goal
                scale = np.repeat([1.0, np.inf], [len(moved), len(goal)])  # leaves ||dc||_W
        if not len(basis):
            return np.zeros((runs, 1))
        first, second, third = (np.ascontiguousarray(np.atleast_2d(p)) for p in (basis, scale, y))
        found = _core.simulate_plans(
            x0.argument(),
            xf.argument(),
            A.argument(transpose=not (self.plan.rows and A.drawn)),
            self.plan.rows,
            self.plan.paired,
            (first, second, third),
            False,
            runs,
            self.cost,
            key.bytes32,
            get_num_threads(),
        )
        whole, part = found.T
        if soft:
            whole = part + np.sqrt(np.maximum(whole**2 - part**2, 0.0))
        return np.asarray(whole[:, None])


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
        rows, d = self._M.shape
        draw = 100.0 * (len(self.exact.A) + 2) * len(self.exact.A)
        solve = _SOLVE + _PER_CUBE * d**3 + _PER_ENTRY * (rows + d) * d
        return float(draw + solve * (2.0 if self.limited.task.R is None else 1.0))

    def rounded(self, radii: tuple[float, ...]) -> tuple[float, ...]:
        """As `Errors.rounded`."""
        size = float(np.abs(self.limited.u).max(initial=0.0))
        gain = float(np.linalg.norm(self._M))
        scales = gain * size, size, (gain * size) ** 2
        return tuple(r + ROUNDING * (r + scale) for r, scale in zip(radii, scales, strict=True))

    @cached_property
    def _M(self) -> Floats:
        return self.exact.condensed

    def draw(self, runs: int, key: Key) -> Floats:
        """Independent errors, (runs, 3)."""
        rows, d = self._M.shape
        chunk = max(1, _CHUNK // ((rows + d) * d + (len(self.exact.A) + 2) ** 2))
        parts = [self._some(at, min(chunk, runs - at), key) for at in range(0, runs, chunk)]
        return np.concatenate(parts)

    def _some(self, first: int, runs: int, key: Key) -> Floats:
        x0, xf, A = self.plan.entities
        n, exact = len(x0.values), self.exact
        found = _core.simulate_plan_estimates(
            x0.argument(),
            xf.argument(),
            A.argument(transpose=not (self.plan.rows and A.drawn)),
            self.plan.rows,
            first,
            runs,
            self.cost,
            key.bytes32,
            get_num_threads(),
        )
        start, goal, A_hat = found[:, :n], found[:, n : 2 * n], found[:, 2 * n :]
        M, y, size = condensed(
            exact, A_hat.reshape(runs, n, n), start, goal if self.follows else None
        )
        (best_M, state, target), R = exact.weighted, exact.cost()
        d = R.shape[0]
        best_y = target - state @ x0.values
        full = np.diag(R)[None] if R.ndim == 1 else R[None]
        if self.limited.task.R is None:  # R of each run as rows of its own
            own = REGULAR * size / d
            own[own == 0.0] = 1.0
            full = own[:, None, None] * np.eye(d)
            v = self._controls(_stacked(best_M, own), np.broadcast_to(best_y, y.shape), 0.0 * R)
            u = self._controls(_stacked(M, own), y, 0.0 * R)
        else:
            v = self._controls(best_M[None], best_y[None], R)
            u = self._controls(M, y, R)
        wrong = u - v
        shift = wrong @ best_M.T
        cost = np.einsum("ri,rij,rj->r", wrong, np.broadcast_to(full, (runs, d, d)), wrong)
        slope = (v @ best_M.T - best_y) @ best_M + np.einsum("...i,...ij->...j", v, full)
        squares = np.sum(shift**2, axis=1)
        excess = np.maximum(2.0 * np.sum(slope * wrong, axis=1) + squares + cost, 0.0)
        return np.column_stack([np.sqrt(squares), np.linalg.norm(wrong, axis=1), excess])

    def _controls(self, M: Floats, y: Floats, R: Floats) -> Floats:
        """The best controls within the limits for the maps M (runs, rows, d)."""
        runs, rows, d = M.shape
        targets = np.zeros((runs, rows))
        targets[:, : y.shape[1]] = y
        low, high = self.exact.task.low.ravel(), self.exact.task.high.ravel()
        flat = np.ascontiguousarray(M.reshape(runs, rows * d))
        u, _ = _core.box_batch_each(flat, targets, R, low, high, False, get_num_threads())
        return u


def condensed(
    exact: Horizon, A: Floats, x0: Floats, xf: Floats | None
) -> tuple[Floats, Floats, Floats]:
    """M (runs, rows, m K), y (runs, rows) and tr(G'QG), for each A (runs, n, n) and x0 (runs, n).

    The reference is xf (runs, n) at all steps, or without it that of `exact`.
    """
    task, B, (runs, n) = exact.task, exact.B, x0.shape
    K, m = task.steps, B.shape[1]
    stage, terminal = exact.roots
    rows = len(stage) * (K - 1) + len(terminal)
    M, y = np.zeros((runs, rows, K, m)), np.empty((runs, rows))
    pushes, free, row = np.empty((runs, K, n, m)), x0, 0
    pushes[:, 0] = B
    for k in range(1, K + 1):
        free = np.einsum("rij,rj->ri", A, free)
        factor = stage if k < K else terminal
        part = slice(row, row := row + len(factor))
        wanted = task.reference[k - 1] if xf is None else xf
        y[:, part] = (wanted - free) @ factor.T
        for j in range(k):
            M[:, part, j] = factor @ pushes[:, k - 1 - j]
        if k < K:
            pushes[:, k] = A @ pushes[:, k - 1]
    flat = M.reshape(runs, rows, K * m)
    return flat, y, np.sum(flat**2, axis=(1, 2))


def onto(M: Floats) -> Floats:
    """``U'`` for an orthonormal basis U of the range of M."""
    U, s, _ = np.linalg.svd(M, full_matrices=False)
    tiny = max(M.shape) * np.finfo(np.float64).eps
    return np.ascontiguousarray(U[:, s > tiny * s.max(initial=0.0)].T)


def _stacked(M: Floats, own: Floats) -> Floats:
    """M (rows, d) or (runs, rows, d) over ``sqrt(own) I`` of each run."""
    d = M.shape[-1]
    some = np.broadcast_to(M, (len(own), *M.shape[-2:]))
    return np.concatenate([some, np.sqrt(own)[:, None, None] * np.eye(d)], axis=1)


def _goal(exact: Horizon) -> Floats:
    """What ``xf`` at all steps is multiplied by in y."""
    stage, terminal = exact.roots
    return np.vstack([*[stage] * (exact.task.steps - 1), terminal])


def _padded(entity: Entity, before: int, after: int) -> Entity:
    def pad(v: Floats) -> Floats:
        return np.concatenate([np.zeros(before), v, np.zeros(after)])

    estimate = None if entity.estimate is None else pad(entity.estimate)
    return replace(entity, values=pad(entity.values), estimate=estimate)


def _corner(entity: Entity) -> Entity:
    """``diag(0, A)`` of A."""

    def corner(A: Floats) -> Floats:
        n = len(A)
        whole = np.zeros((2 * n, 2 * n))
        whole[n:, n:] = A
        return whole

    estimate = None if entity.estimate is None else corner(entity.estimate)
    return replace(entity, values=corner(entity.values), estimate=estimate)
