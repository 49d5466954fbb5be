"""Certificates of a control of a model of outputs, and of a plan near a reference."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import show
from .._base.numbers import norm
from .._base.records import trusted
from ..exceptions import InputError
from ..identification.model import Model
from .certificate import Certificate, Radius, radius_at
from .of_model import REGION, Asked, certificate

if TYPE_CHECKING:
    from .._base.types import Floats
    from .of_model import ModelBasis


def output_certificate(
    basis: ModelBasis, u: Floats, delta: float, noise: bool, gain: Floats | None = None
) -> Certificate:
    """Bound where the outputs of the true system are under `u`; `noise`: the readings.

    With a `gain` K (m, n) under ``u + K (x - xh)``, x the window, xh that of the plan.
    """
    model = basis.model
    assert isinstance(model, Model)
    assert model.window is not None
    rows, outputs, r = model.window.count, model.n_outputs, basis.target
    if noise and model.noise != "gaussian":
        raise InputError(
            "`noise` must be False: the noise of readings to come is bounded for Gaussian noise"
        )
    # a covariance that is not known is bounded by the mixture alone, whatever the data
    own = noise and model.assumptions.known is None and model.assumptions.tail == 0.0
    region = model.region(delta * REGION if noise else delta, method="mixture" if own else "auto")
    none = np.full((outputs, outputs), np.inf)
    covariance = none if region.noise is None else np.ascontiguousarray(region.noise)
    level = (covariance, delta * (1.0 - REGION)) if noise else None
    system = model._loop.ABc, model._loop.J, model._loop.G, model.m
    found = _core.output_tube(region._core, system, basis.x0, u, gain, level)
    _, predicted, mean, read = found
    tube, components = mean if read is None else read
    if model.doubts:
        for radii in (mean[0], tube, components):
            radii[1:] = np.inf
    off = np.zeros_like(predicted) if r is None else np.abs(predicted - r)
    last = slice(-rows, None)
    away = np.linalg.norm(off, axis=1)[last]
    target = norm(away + tube[1:][last])
    parts = {"reach": norm(away), "model error": norm(mean[0][1:][last])}
    if noise:
        parts["noise"] = norm((tube - mean[0])[1:][last]) if np.isfinite(target) else np.inf
    what = "readings" if noise else "means of the readings"
    method = f"window of {model.window.text}, {'with' if noise else 'without'} noise"
    if gain is not None:
        method += ", followed with the gain"
    reason = "too few pairs, or too many steps for an unstable model (a feedback keeps it small)"
    if model.doubts:
        reason = model.doubts[0]
    elif region.missing:
        reason = f"the data do not determine the system along {', '.join(region.missing[:3])}"

    def radius(value: float | Floats, distance_from: str) -> Radius:
        return radius_at(value, distance_from, delta, method, reason)

    of = f"{what} of {show.listed(model.outputs)} at step {len(u)}"
    goal = "the predicted outputs" if r is None else "the target"
    quantities = {
        "last": radius((off + components[1:])[-1], f"{goal}, {of}"),
        "target": radius(target, f"{goal}, the last {len(away)} {what} together"),
        "tube": radius(tube, f"the predicted outputs, {what} of each step"),
        "mean": radius(mean[0], "the predicted outputs, their mean given the record"),
        "readings": radius(components, f"the predicted outputs, {what} of each output"),
        "outputs": radius(off + components[1:], f"{goal}, {what} of each output"),
    }
    said = region.assumption
    if gain is not None:
        said += "; inputs u(k) + K (x(k) - xh(k)), x the window of the readings"
    if noise:
        said += "; noise to come independent of the data, at half of the probability of failure"
    said += "; declared: the plant was at rest" if basis.at_rest else "; the record happened"
    return trusted(
        Certificate,
        kind="guaranteed",
        delta=delta,
        quantities=quantities,
        covers="target and tube together, and all radii of single outputs together, over the noise "
        + ("of the data and of the run" if noise else "of the data"),
        assumption=f"{said}; the number of steps was fixed beforehand",
        parts=parts,
        warnings=model.warnings,
    )


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
