"""The units of a fleet, as the core takes them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .. import _core
from .._base import validation
from .._base.names import default_labels, order_of, weight
from .._base.numbers import shared
from .._base.records import Record, require_shapes
from .._base.running import get_num_threads
from .._base.types import Floats
from ..ensembles import SystemEnsemble
from ..exceptions import InputError, InputTypeError, ShapeError
from ..identification.identified import Identified
from ..limits.limits import as_cost, as_limits
from ..limits.problem import Task, read_task

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

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


def read_units(
    systems: Systems, x0: ArrayLike, xf: Any, steps: int, limits: Any, cost: Any
) -> Units:
    """Check the arguments of `control_fleet` that are about its units."""
    fleet, within, weights = read_systems(systems), as_limits(limits), as_cost(cost)
    n, m = fleet.n, fleet.m
    if within.x is not None and within.soft is not False:
        raise InputError(
            "`soft` must be False: the limits of states of a fleet are hard, got "
            f"{validation.show(within.soft)}"
        )
    labels = fleet.labels or default_labels(n, m)
    if weights.R is not None:
        weight("R", weights.R, m, labels=labels.inputs)
    names = labels.states
    goal = None
    if weights.reference is None:
        goal = validation.vector("xf", xf, length=n, labels=names)
    K = validation.size("steps", steps, maximum=2**31 // m)
    task = read_task(n, m, K, goal, within, weights, labels)
    return Units(fleet, validation.starts(x0, fleet.size, n, names), task)


def read_systems(systems: Systems) -> SystemEnsemble:
    """Units as one record; models that are no units are refused."""
    if not isinstance(systems, SystemEnsemble):
        given = validation.items("systems", systems)
        if not any(isinstance(one, Identified) for one in given):
            return SystemEnsemble.from_systems(given)
        return _of_models(given)
    if systems.centre == "estimate":
        raise InputError(
            "`systems` scatter about an estimate, as drawn models of one plant do: they are no "
            "units of a fleet, and no risk of that plant follows; use control(model, ...), or "
            "SystemEnsemble(A, B) if these are units"
        )
    return systems


def _of_models(models: list[Any]) -> SystemEnsemble:
    """Units that are known through a model each."""
    first = models[0]
    for k, model in enumerate(models):
        if not isinstance(model, Identified):
            raise InputTypeError(
                f"`systems[{k}]` must be a model as another is, got {validation.show(model)}"
            )
        if model.B.shape != first.B.shape or model.dt != first.dt:
            raise ShapeError(f"`systems[{k}]` must have n, m and dt of the first")
    labels = next((model.labels for model in models if model.labels.given), None)
    orders = [order_of(f"systems[{k}]", one.labels, labels) for k, one in enumerate(models)]
    each = list(zip(models, orders, strict=True))
    pairs = [order.matrices(model.A, model.B) for model, order in each]
    n = len(first.A)
    offsets = [np.zeros(n) if one.c is None else order.of_states(one.c) for one, order in each]
    return SystemEnsemble(
        np.array([A for A, _ in pairs]),
        np.array([B for _, B in pairs]),
        np.array(offsets) if any(model.c is not None for model in models) else None,
        dt=first.dt,
        labels=labels,
    )
