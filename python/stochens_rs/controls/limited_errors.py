"""The law of the error of a control within limits, whose realizations are drawn anew."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.numbers import ROUNDING
from .._base.threads import get_num_threads

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..rng import Key
    from ..theory.drawn_bounds import PlanErrors
    from .limited import Horizon, Limited

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
        found = self.exact.core.moved_targets(
            _told(self.plan), self.plan.rows, self.plan.paired, x0, xf,
            runs, self.cost, key.bytes32, get_num_threads(),
        )  # fmt: skip
        return found[:, None]


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
        told = _told(self.plan), self.plan.rows, x0, self.follows, self.limited.task.R is None
        how = runs, self.cost, key.bytes32, get_num_threads()
        return self.exact.core.drawn_errors(*told, *how)


def _told(plan: PlanErrors) -> tuple[Any, Any, Any]:
    x0, xf, A = plan.entities
    lines = A.argument(transpose=not (plan.rows and A.drawn))
    return x0.argument(), xf.argument(), lines
