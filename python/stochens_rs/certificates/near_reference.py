"""The certificate of a plan near a reference that was fixed without the data of the model."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .._base.records import trusted
from ..identification.model import Model
from .certificate import Certificate, Radius, radius_at
from .of_model import Asked, certificate

if TYPE_CHECKING:
    from .._base.types import Floats
    from .of_model import ModelBasis

# The share of the probability of failure for the regions of any design, of the same pairs. Their
# radii depend on it by a logarithm: 1/10 costs them 2 % and what is near the reference 2 %. Fixed
# before the data, so that the smaller one may be taken after them.
ANY_DESIGN = 0.1


def near_reference(
    basis: ModelBasis, u: Floats, predicted: Floats, delta: float, asked: Asked
) -> Certificate | None:
    """Bound where the true system ends; None for a plan that no reference is declared for.

    That is decided without the data: by the number of steps, and an exact x0. Each radius is the
    smaller one of two that hold together: that near the reference, and that of any design.
    """
    model = basis.model
    if not isinstance(model, Model) or model.pilot is None or model.doubts:
        return None
    if len(u) != model.pilot.steps or basis.x0_error:
        return None
    plain, share = model._of_any_design, ANY_DESIGN if model._of_any_design is not None else 0.0
    task = basis.x0, basis.xf, np.ascontiguousarray(u), np.ascontiguousarray(predicted)
    known = model.assumptions.covariance, model.assumptions.known
    target, *parts, tube, components = model._piloted.near(
        model._reference, *task, known, delta * (1.0 - share), asked.noise
    )
    named = dict(zip(("reach", "quantile", "mismatch", "rest"), parts, strict=True))
    method = f"near a reference, {'with' if asked.noise else 'without'} noise"

    state: float = float(np.sum(parts[1:]))
    if plain is not None:
        other = certificate(replace(basis, model=plain), u, predicted, delta * share, asked)
        if other.target < target:
            named = dict(other.parts)
        target = min(target, other.target)
        state = min(state, float(other["state"].radius))
        components = np.minimum(components, other["components"].radius)
        tube = np.minimum(tube, other["tube"].radius)

    def radius(value: float | Floats, distance_from: str) -> Radius:
        reason = "too few data for this probability, or a pilot that says too little"
        return radius_at(value, distance_from, delta, method, reason)

    return trusted(
        Certificate,
        kind="guaranteed",
        delta=delta,
        quantities={
            "target": radius(target, "xf"),
            "state": radius(state, "the predicted state"),
            "components": radius(components, "xf, for each state"),
            "tube": radius(tube, "the predicted states, for each step"),
        },
        covers=(
            "target and state together, the components and the tube each on its own, over the "
            "noise of the data"
        ),
        assumption=f"{model.assumptions.text}, {model.pilot.said}",
        parts=named,
        warnings=model.warnings,
    )
