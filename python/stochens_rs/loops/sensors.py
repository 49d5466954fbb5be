"""What a learned bias says of a loop at rest: a constant that acts, or a sensor that is wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._base import show
from .._base.types import DELTA
from ..controls.set_point import points_of
from ..exceptions import StochensError
from ..identification.model import Model, asked_region
from ..identification.region import Wish

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification.region import Region

FALSE_ALARM = 1e-4


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


def explained(model: Model, bias: Floats, L: Floats, y: Floats, u: Floats) -> str | None:
    """What explains a bias at rest at (y, u), learned with L, beside noise and the region."""
    if (found := bounded(model)) is None:
        return None
    region, noise = found
    causes_of = points_of(model).causes(region.core, noise, L, bias, (y, u), FALSE_ALARM)
    if causes_of is None:
        return None
    acting, sensors, two = causes_of
    causes = []
    if acting is not None:
        pairs = zip(acting, model.input_names, strict=True)
        causes = [f"a constant acts, as {show.listed([f'{v:.3g} at {name}' for v, name in pairs])}"]
    for i, more in sensors:
        much = f"{abs(more):.3g} {'more' if more > 0.0 else 'less'}"
        others = "the others say" if model.n_outputs > 1 else "the model says"
        causes.append(f"{model.outputs[i]} reads {much} than {others}")
    if not causes:
        tail = "two of them are wrong" if two else "the plant is not the model"
        return (
            f"the readings contradict each other at rest, and no single sensor explains it: {tail}"
        )
    text = ", or ".join(causes)
    return text if len(causes) == 1 else f"{text}: undecided which"
