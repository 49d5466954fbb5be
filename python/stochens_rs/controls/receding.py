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
        """The active limits of the last call; the next one begins at them, shifted by a step."""

    def resume(self, warm: Signs | None) -> None:
        """Begin there; None: from anew."""


def solver_of(horizon: Horizon) -> Solver:
    """The solver for the kind of limits and the number of inputs."""
    task = horizon.task
    if horizon.long or not task.boxed:
        return Receding(horizon)
    M, state, target = horizon.weighted
    low, high = task.low.ravel(), task.high.ravel()
    return _core.BoxSolver(M, horizon.cost(), low, high, task.low.shape[1], state, target)


class Receding:
    """Long horizons, and limits of rates and states: a problem for each call."""

    def __init__(self, horizon: Horizon) -> None:
        self._horizon = horizon
        self._warm: Signs | None = None

    def solve(self, given: Floats, time_limit: float | None) -> _core.BoxControl:
        """As `Solver.solve`."""
        task, warm = self._horizon.task, self._warm
        K, m = task.low.shape
        if warm is not None:
            later = np.vstack([warm[1:], warm[-1:]])  # one step later, the last step once more
            kinds = np.split(later, [m, m if task.rate is None else 2 * m], axis=1)
            warm = np.concatenate([kind.ravel() for kind in kinds])
        found = self._horizon.best(given, task, time_limit, warm)
        kinds = [found.active]
        if isinstance(found, _core.RowsControl):
            kinds += [np.sign(found.rates), np.sign(found.states)]
        self._warm = np.hstack([kind.reshape(K, -1) for kind in kinds]).astype(np.int8)
        return found

    def warm(self) -> Signs | None:
        """As `Solver.warm`."""
        return self._warm

    def resume(self, warm: Signs | None) -> None:
        """As `Solver.resume`."""
        self._warm = warm
