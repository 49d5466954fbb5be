"""What a learned bias says of a loop at rest: a constant that acts, or a sensor that is wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import show
from .._base.types import DELTA
from ..exceptions import StochensError
from ..identification.model import Model, asked_region
from ..identification.region import Wish

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification.region import Region

FALSE_ALARM = 1e-4


def bounded(model: Model) -> Region | None:
    """The region of a model, also of one in doubt; None where no bound of its noise is known."""
    if model.noise != "gaussian":
        return None
    try:
        own = model.assumptions.known is None and model.assumptions.tail == 0.0
        wish = Wish(min(DELTA, model.level), method="mixture" if own else "auto")
        region = asked_region(model, wish)
    except StochensError:
        return None
    known = region.noise is not None and len(region.noise) == model.n_outputs
    return region if known else None


def explained(model: Model, bias: Floats, L: Floats, y: Floats, u: Floats) -> str | None:
    """What explains a bias at rest at (y, u), learned with L, beside noise and the region."""
    region = bounded(model)
    if region is None or region.noise is None:
        return None
    points = _core.SetPoints(
        model.regressors.core, np.ascontiguousarray(model.coefficients), model.ranges
    )
    noise = np.ascontiguousarray(region.noise)
    found = points.causes(region.core, noise, L, bias, (y, u), FALSE_ALARM)
    if found is None:
        return None
    acting, sensors, two = found
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
