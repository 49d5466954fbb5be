"""What a learned bias says of a loop at rest: a constant that acts, or a sensor that is wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._base import show
from .._base.types import DELTA
from ..controls.set_point import or_zero, points_of
from ..exceptions import StochensError
from ..identification.model import Model, asked_region
from ..identification.region import Wish

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification.region import Region

FALSE_ALARM = 1e-4
FAR = 2.0  # ranges of the logs, outside of which a reading is far
INTEGRATES = 1e-3  # of a deviation leaves in a step: no slower mode is told from an integrator


def bounded(model: Model) -> tuple[Region, Floats] | None:
    """The region of a model, also of one in doubt, and its noise; None where that has no bound."""
    if model.noise != "gaussian":
        return None
    try:
        own = model.assumptions.known is None and model.assumptions.tail == 0.0
        wish = Wish(min(DELTA, model.level), method="mixture" if own else "auto")
        region = asked_region(model, wish)
    except StochensError:
        return None
    if region.noise is None or len(region.noise) != model.n_outputs:
        return None
    return region, np.ascontiguousarray(region.noise)


class Range:
    """The outputs of the logs of a model, and whether readings are far outside of them."""

    def __init__(self, model: Model) -> None:
        y = model.data.pairs()[0]
        self.low, self.high, self.names = y.min(axis=0), y.max(axis=0), model.outputs
        self.width = np.maximum(self.high - self.low, np.finfo(float).tiny)
        # modes that integrate move all outputs along these, in ranges: they may go anywhere
        self.free = points_of(model).integrating(self.width, INTEGRATES)

    def outside(self, y: Floats) -> str | None:
        """The reading that is furthest outside; nan where it was not read."""
        off = or_zero((y - 0.5 * (self.low + self.high)) / self.width)
        off -= self.free.T @ (self.free @ off)
        i = int(np.abs(off).argmax())
        if abs(off[i]) <= FAR + 0.5:
            return None
        return (
            f"{self.names[i]} = {y[i]:.4g} is far outside of the logs, which had "
            f"{self.low[i]:.4g} to {self.high[i]:.4g}"
        )


def explained(
    model: Model, bias: Floats, L: Floats, y: Floats, u: Floats, calls: int = 1
) -> str | None:
    """What explains a bias at rest at (y, u), the mean of so many calls, learned with L."""
    if (own := bounded(model)) is None:
        return None
    learned = np.ascontiguousarray(bias), calls, L, own[1], np.hstack([y, u])
    found = points_of(model).causes(own[0].core, learned, FALSE_ALARM)
    if found is None:
        return None
    (constants, sensors, two), causes = found, []
    if constants is not None:
        pairs = zip(constants, model.input_names, strict=True)
        causes = [f"a constant acts, as {show.listed([f'{v:.3g} at {name}' for v, name in pairs])}"]
    elif model.m + 1 >= len(sensors):  # any bias is explained by a sensor and constants
        causes = [f"a load acts elsewhere than at {show.listed(list(model.input_names))}"]
    for name, size in zip(model.outputs, sensors, strict=True):
        if size is not None:
            much = f"{abs(size):.3g} {'more' if size > 0.0 else 'less'}"
            others = "the others say" if len(sensors) > 1 else "the model says"
            causes.append(f"{name} reads {much} than {others}")
    if not causes:
        return (
            "no constant at the inputs and no single sensor explains what was learned at rest: a "
            f"load acts elsewhere, or {'two sensors are wrong, or ' * two}the plant is not the "
            "model: undecided which"
        )
    text = ", or ".join(causes)
    return text if len(causes) == 1 else f"{text}: undecided which"
