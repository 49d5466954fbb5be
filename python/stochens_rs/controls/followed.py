"""The certificate of a plan that is followed with a feedback."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import validation
from .._base.numbers import norm
from .._base.records import trusted
from ..certificates.certificate import Certificate
from ..certificates.radius import Radius
from ..exceptions import InputError
from ..feedback import Loop, LoopCertificate
from ..theory.exact import EPS

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..certificates.model_basis import ModelBasis
    from ..identification.identified import Identified


def proof_of(
    name: str, model: Identified, gain: Loop | LoopCertificate, delta: float
) -> LoopCertificate:
    """The certificate of a feedback of this model; a `Loop` is certified with `delta`."""
    proof = gain.certificate(delta) if isinstance(gain, Loop) else gain
    validation.instance("gain", proof, LoopCertificate)
    own = model._in_states(model.region(proof.region.delta)).centre
    if not np.array_equal(own, proof.region.centre):
        raise InputError(f"`{name}` must be the model that `gain` was made for")
    return proof


def followed(
    basis: ModelBasis,
    u: Floats,
    predicted: Floats,
    gain: Loop | LoopCertificate,
    delta: float,
    noise: bool,
) -> Certificate:
    """Bound where the true system ends under ``u(k) + K (x - xh)``; half of delta is for noise."""
    proof = proof_of("plan", basis.model, gain, delta / 2.0 if noise else delta)
    region = proof.region
    left = delta - region.delta
    if left < 0.0 or (noise and left == 0.0):
        raise InputError(
            f"`delta` must be {'above' if noise else 'at least'} that of the region of `gain`, "
            f"{region.delta:g}, got {delta:g}"
        )
    # the centre of the region need not be the model that planned
    centred = _core.followed_inputs(region._core, basis.x0, u, predicted, proof.K)
    tube = proof.tube(
        basis.x0, len(u), inputs=centred, start=basis.x0_error, noise=left if noise else None
    )
    end = tube.states[-1] - basis.xf
    size = alone = float(tube.state_radii[-1])
    if np.isfinite(size):
        alone = min(norm(tube.model[-1, : region.n]), size)
    parts = {
        "reach": norm(end),
        "model error": alone,
        "start": size - alone if np.isfinite(size) else 0.0,
        "noise": tube.noise_radius,
    }
    reason = proof.reason or "the feedback is not certified"
    method = f"a certified feedback, {'with' if noise else 'without'} noise"

    def radius(value: float | Floats, distance_from: str) -> Radius:
        return Radius._at(value, distance_from, delta, method, reason)

    aside = np.linalg.norm(tube.states - predicted, axis=1)
    tubes, state = tube.radii + aside, float(tube.radii[-1] + aside[-1])
    return trusted(
        Certificate,
        kind="guaranteed",
        delta=delta,
        quantities={
            "target": radius(parts["reach"] + float(tube.radii[-1]), "xf"),
            "state": radius(state, "the predicted state"),
            "components": radius(np.abs(end) + tube.components[-1], "xf, for each state"),
            "tube": radius(tubes, "the predicted states, for each step"),
            "inputs": radius(
                (tube.input_components + np.abs(centred - u) + EPS * np.abs(u)).max(axis=0),
                "the planned ones, for each input in any step",
            ),
        },
        covers="all together, over the noise of the data" + (" and of the run" if noise else ""),
        assumption=region.assumption
        + "; inputs u(k) + K (x(k) - xh(k)) with states read exactly"
        + ("; Gaussian noise of the run independent of the data" if noise else ""),
        parts=parts,
        warnings=basis.model.warnings,
    )
