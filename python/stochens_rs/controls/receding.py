"""What solves the plans of a `Regulator`, one state after another."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from .. import _core

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats
    from .limited import Horizon

    Signs = NDArray[np.int8]


class Solver(Protocol):
    """What `_core.BoxSolver` does; a call that raises changes nothing."""

    def solve(self, given: Floats, time_limit: float | None) -> _core.BoxControl:
        """The best control from a state, begun at the active limits of the one before."""

    def warm(self) -> Signs | None:
        """The active limits at which the next call begins, before they are shifted by a step."""

    def resume(self, warm: Signs | None) -> None:
        """Begin there; None: from anew."""


def solver_of(horizon: Horizon) -> Solver:
    """The solver for the kind of limits and the number of inputs."""
    task = horizon.task
    if not task.boxed:
        return Anew(horizon)
    if horizon.long:
        return Recursion(horizon)
    M, state, target = horizon.weighted
    low, high = task.low.ravel(), task.high.ravel()
    return _core.BoxSolver(M, horizon.cost(), low, high, task.low.shape[1], state, target)


class Recursion:
    """Riccati's recursion for long horizons."""

    def __init__(self, horizon: Horizon) -> None:
        self._horizon = horizon
        self._warm: Signs | None = None

    def solve(self, given: Floats, time_limit: float | None) -> _core.BoxControl:
        """As `Solver.solve`."""
        warm, m = self._warm, self._horizon.B.shape[1]
        if warm is not None:
            warm = np.concatenate([warm[m:], warm[-m:]])
        found = self._horizon.by_recursion(given, self._horizon.task, warm, time_limit)
        self._warm = found.active
        return found

    def warm(self) -> Signs | None:
        """As `Solver.warm`."""
        return self._warm

    def resume(self, warm: Signs | None) -> None:
        """As `Solver.resume`."""
        self._warm = warm


class Anew:
    """Limits of rates and states: each plan from the start."""

    def __init__(self, horizon: Horizon) -> None:
        self._horizon = horizon

    def solve(self, given: Floats, time_limit: float | None) -> _core.BoxControl:
        """As `Solver.solve`."""
        return self._horizon.best(given, self._horizon.task, time_limit)

    def warm(self) -> Signs | None:
        """There is none."""
        return None

    def resume(self, warm: Signs | None) -> None:
        """Nothing to begin at."""
