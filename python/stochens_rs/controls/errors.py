"""Errors of plans: against a known system, their covariance, followed with a feedback."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import validation
from .._base.numbers import norm
from .._base.records import trusted
from .._base.types import QUANTITIES, Floats
from ..certificates.certificate import Certificate, Radius, radius_at
from ..exceptions import InputError
from ..feedback import Loop, LoopCertificate
from ..fusion.provenance import Basis
from ..limits.solution import Horizon
from ..theory import moments
from ..theory.exact import EPS, states
from ..theory.records import PlanError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .._base.types import Fusion, Quantity
    from ..certificates.of_model import ModelBasis
    from ..identification.identified import Identified
    from ..limits.solution import Limited


def plan_covariance(basis: Basis, steps: int, fusion: Fusion, quantity: Quantity) -> Floats:
    """Compute the covariance of the last state or of the control (see `Plan.covariance`)."""
    of_control = validation.choice("quantity", quantity, QUANTITIES) == "control"
    for entity in basis.entities:
        if entity.kind == "fitted":
            raise InputError(
                f"no formula is known for the covariance: the weights of `{entity.name}` depend "
                "on the realizations"
            )
    schemes = {entity.kind for entity in basis.entities} - {"exact"}
    if len(schemes) > 1:
        raise InputError(
            "no formula is known for the covariance of iid and systematic samples together"
        )
    x0, xf, A = basis.values
    if steps == 1:
        covariance = moments.control_covariance if of_control else moments.state_covariance
        return covariance(
            (A, basis.B),
            x0,
            xf,
            basis.sizes,
            fusion=fusion,
            axis=basis.A.axis,
            scheme="systematic" if "systematic" in schemes else "iid",
        )
    if of_control:
        raise InputError(
            f"`quantity` must be 'state' over {steps} steps, got 'control': the control is not "
            "linear in A, and no formula is known for its covariance"
        )
    if "systematic" in schemes:
        raise InputError(
            f"no formula is known for the covariance over {steps} steps of systematic samples"
        )
    return moments.final_state_covariance(
        (A, basis.B), x0, xf, steps, basis.sizes, axis=basis.A.axis
    )


def limited_error(
    limited: Limited, A: Floats, B: Floats, x0: Floats, xf: ArrayLike | None, u: Floats
) -> PlanError:
    """Compare `u` with the best control of an exact system within the same limits."""
    horizon = Horizon(limited.exact(xf), A, B)
    best = horizon.solve(x0)
    wrong = u - best.u
    reached = states(A, B, x0, best.u)[-1]
    target = horizon.task.reference[-1]
    control, state = norm(wrong), norm(states(A, B, 0.0 * x0, wrong)[-1])
    size, length = norm(best.u), norm(reached)
    where = "x_actual" if length else "x0"
    length = length or norm(x0)
    if not length:
        where = "nothing"
    off_control, off_state = horizon.in_two_norm(best.distance)
    pushed = norm(horizon.pushes)
    return PlanError(
        control=control,
        control_relative=_ratio(control, size),
        state=state,
        state_relative=_ratio(state, length),
        residual=norm(target - reached),
        control_rounding=off_control + EPS * (size + control),
        state_rounding=off_state + (u.size + len(x0)) * EPS * pushed * (size + control),
        control_relative_to="v" if size else "nothing",
        state_relative_to=where,
        objective=horizon.objective(x0, u) - best.objective,
    )


def _ratio(value: float, size: float) -> float:
    return value / size if size else np.inf if value else 0.0


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
        return radius_at(value, distance_from, delta, method, reason)

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
