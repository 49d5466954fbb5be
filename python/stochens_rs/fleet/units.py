"""The units of a fleet, as the core takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .. import _core
from .._base import validation
from .._base.numbers import shared
from .._base.records import Record, require_shapes
from .._base.running import get_num_threads
from .._base.types import Floats
from ..ensembles import SystemEnsemble
from ..exceptions import InputError, ShapeError
from ..fusion.fused_model import ensemble_of
from ..identification.identified import Identified
from ..limits.problem import Task

if TYPE_CHECKING:
    from ..system.system import System


Systems: TypeAlias = "SystemEnsemble | Sequence[System | Identified | Any]"


@dataclass(frozen=True, eq=False)
class Units(Record):
    """Units ``x_s(k+1) = A_s x_s(k) + B_s u(k) + c_s``, and where they shall go.

    Attributes
    ----------
    systems : SystemEnsemble
        The units.
    x0 : ndarray, shape (N, n) or (1, n)
        Where they begin; one row: all at the same place.
    task : Task
        What is wanted of all, and the limits.
    """

    systems: SystemEnsemble
    x0: Floats
    task: Task

    def __post_init__(self) -> None:
        super().__post_init__()
        N, n, task = self.systems.size, self.systems.n, self.task
        if validation.kept("x0", self.x0, ndim=(2,)).shape not in ((1, n), (N, n)):
            raise ShapeError(f"`x0` must have shape ({n},) or ({N}, {n}), got {self.x0.shape}")
        require_shapes(task, low=(task.steps, self.systems.m), reference=(task.steps, n))

    @property
    def size(self) -> int:
        """The number of units N."""
        return self.systems.size

    @property
    def arrays(self) -> tuple[Floats, Floats, Floats | None, Floats]:
        """What the core takes."""
        s = self.systems
        return s.A, s.B, s.c, self.x0

    def rows(self) -> Floats:
        """All numbers of each unit, with where it begins, in one row."""
        s, N = self.systems, self.size
        c = np.zeros((N, s.n)) if s.c is None else s.c
        x0 = np.broadcast_to(self.x0, (N, s.n))
        return np.hstack([s.A.reshape(N, -1), s.B.reshape(N, -1), c, x0])

    def of_design(self, design: Units) -> int:
        """How many of these units are among those of the design, but for rounding.

        Of a law that draws equal units, fresh ones may be equal to some of the design; there only
        the design as a whole is refused.
        """
        mine, theirs = self.rows(), design.rows()
        if len(np.unique(theirs, axis=0)) == design.size:
            return shared(theirs, mine)
        return self.size if sorted(mine.tolist()) == sorted(theirs.tolist()) else 0

    def misses(self, u: Floats) -> tuple[Floats, Floats]:
        """The miss of every unit (N,), and by how much it leaves limits of states, else 0."""
        return _core.fleet_misses(self.arrays, self.task, u, get_num_threads())


def read_systems(systems: Systems) -> SystemEnsemble:
    """Units as one record; models that are no units are refused."""
    if not isinstance(systems, SystemEnsemble):
        return ensemble_of("systems", validation.items("systems", systems))
    if systems.centre == "estimate":
        raise InputError(
            "`systems` scatter about an estimate, as drawn models of one plant do: they are no "
            "units of a fleet, and no risk of that plant follows; use control(model, ...), or "
            "SystemEnsemble(A, B) if these are units"
        )
    return systems
