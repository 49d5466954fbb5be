"""The arrays of plans with their dimensions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .._base.tabled import Cube, Tabled, Timed, named, over_time, padded
from ..rng import Key
from .basis import ModelBasis

if TYPE_CHECKING:
    from .._base.labels import Labels
    from .._base.types import Floats
    from ..theory.records import Reachability
    from .basis import Basis
    from .fleet_units import Units
    from .limited import Limited


class PlanArrays(Timed):
    """What `Plan` gives to data sets and tables."""

    u: Floats
    predicted_states: Floats
    reachability: Reachability
    fusion: str
    status: str
    info: dict[str, Any]
    basis: Basis | ModelBasis | None
    limited: Limited | None
    labels: Labels | None
    dt: float | None

    def _cube(self) -> Cube:
        clock, times = over_time(len(self.u), self.dt)
        variables: dict[str, Any] = {
            "predicted_states": ((clock, "state"), self.predicted_states, "state"),
            "u": ((clock, "input"), padded(self.u), "input"),
        }
        attrs: dict[str, Any] = {
            "fusion": self.fusion,
            "status": self.status,
            "residual": self.reachability.residual,
            "key": self.info["key"].hex if isinstance(self.info.get("key"), Key) else None,
        }
        if self.limited is not None:
            task = self.limited.task
            for name, rows, unit in (
                ("low", task.low, "input"),
                ("high", task.high, "input"),
                ("active", self.limited.active, None),
                ("rate_active", None if task.rate is None else self.limited.rate_active, None),
                ("multipliers", self.limited.multipliers, None),
            ):
                variables[name] = ((clock, "input"), padded(rows), unit)
            for name, side in (
                ("reference", task.reference),
                ("state_low", task.state_low),
                ("state_high", task.state_high),
            ):
                variables[name] = ((clock, "state"), padded(side, first=True), "state")
            attrs |= {"objective": self.limited.objective, "gap": self.limited.gap}
        if self.basis is not None and not isinstance(self.basis, ModelBasis):
            for one in self.basis.entities:
                attrs[f"size_{one.name}"] = one.size
                attrs[f"key_{one.name}"] = None if one.key is None else one.key.hex
        labels = named(self.labels, self.predicted_states.shape[1], self.u.shape[1])
        return Cube(variables, times, attrs, labels)


class FleetArrays(Tabled):
    """What `FleetPlan` gives to data sets."""

    u: Floats
    low: Floats
    high: Floats
    misses: Floats
    units: Units

    def _cube(self) -> Cube:
        _, steps = over_time(len(self.u) - 1, None)
        variables = {
            "u": (("step", "input"), self.u, "input"),
            "low": (("step", "input"), self.low, "input"),
            "high": (("step", "input"), self.high, "input"),
            "misses": (("unit",), self.misses, None),
        }
        names = ("risk", "status", "value", "lower_bound", "threshold")
        attrs = {name: getattr(self, name) for name in names}
        systems = self.units.systems
        return Cube(variables, steps, attrs, named(systems.labels, systems.n, systems.m))
