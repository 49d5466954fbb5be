"""Certificates of plans for models from data: of states, of outputs, near a reference."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .. import _core
from .._base import show
from .._base.records import NotNegative, Record
from .._base.types import Floats, norm
from ..exceptions import InputError, ShapeError
from ..identification.assumptions import Assumptions
from ..identification.identified import Identified
from ..identification.model import Model
from ..identification.region import Region
from ..identification.window import Regressors
from ..theory.exact import states
from .certificate import Certificate, certificate_of


class ModelBasis(Record):
    """What a plan for a model from data keeps.

    Attributes
    ----------
    model : Identified
        The model, with its regions.
    x0, xf : ndarray, shape (n,)
        Initial state and target.
    x0_error : float
        How far the true initial state may be from `x0`, in the 2-norm.
    read : ndarray, shape (n_outputs,), or None
        For a model of outputs, the last readings of the record that led to `x0`.
    at_rest : bool
        Whether that record was not measured: the plant was declared to be at rest.
    given : bool
        Whether the inputs were given, and `xf` is where the model ends: there is no target then.
    apart : ndarray, shape (K, m), or None
        For a model of outputs, how far inputs may be from the plan, as where one is a forecast.
    """

    model: Identified
    x0: Annotated[Floats, "state"]
    xf: Annotated[Floats, "state"]
    x0_error: NotNegative = 0.0
    read: Floats | None = None
    at_rest: bool = False
    given: bool = False
    apart: Floats | None = None

    def _check(self) -> None:
        n = len(self.model.A)
        if len(self.x0) != n:
            raise ShapeError(f"`x0` must have shape ({n},), got {self.x0.shape}")
        outputs = (len(self.names),) if self.window else ()
        if (() if self.read is None else self.read.shape) != outputs:
            raise ShapeError("`read` must have the last readings of a model of outputs, else None")

    @property
    def window(self) -> Regressors | None:
        """That of a model of outputs."""
        return self.model.window

    @property
    def target(self) -> Floats | None:
        """Where the states, or the outputs, are to end; None where the inputs were given."""
        if self.given:
            return None
        return self.xf if self.read is None else self.xf[: len(self.read)]

    @property
    def names(self) -> tuple[str, ...]:
        """Those of the outputs, or of the states."""
        return self.model.outputs

    def outputs(self, states: Floats, u: Floats) -> Floats | None:
        """What was read, and what a model of outputs leads to from each of the states but the last.

        (K + 1, n_outputs); None for a model of states.
        """
        if not isinstance(self.model, Model) or self.read is None:
            return None
        ones = np.ones((len(u), int(self.model.intercept)))
        ahead = np.hstack([states[:-1], u, ones]) @ (self.model.coefficients @ self.model.loop.J).T
        return np.vstack([self.read, ahead])


class SizedNoise(NamedTuple):
    """Noise to come that is not in the region: ``||[w(0) .. w(K-1)]|| <= radius`` after `root`^-1.

    `root` (n, n) is a root of the known covariance.
    """

    radius: float
    root: Floats


class GaussianNoise(NamedTuple):
    """Gaussian noise to come, independent of the data, of covariance at most ``root root'``.

    Given the data, its part ``sum_i A^(k-1-i) w(i)`` of e(k) is Gaussian, A that of the centre.
    `end` is the level of its quantile for the last state, `before` that of each earlier one, with
    what the error of the model makes of it.
    """

    root: Floats
    end: float
    before: float


ToCome: TypeAlias = SizedNoise | GaussianNoise


def trajectory(Theta: Floats, x0: Floats, u: Floats) -> Floats:
    """The states (K + 1, n) of ``x(k+1) = Theta (x(k), u(k), 1)``."""
    n = len(Theta)
    ones = np.ones((len(u), Theta.shape[1] - n - u.shape[1]))
    return states(Theta[:, :n], Theta[:, n:], x0, np.hstack([u, ones]))


# Of the probability of failure with Gaussian noise to come: the region, the noise of the last
# state, and that of earlier states. For one step the last share goes to the noise, too. Fixed
# before the data.
REGION, END, BEFORE = 0.5, 0.4, 0.1


class Question(NamedTuple):
    """What is to be bounded: where `u` leads the true system; `predicted` are the model's states.

    `delta`, `noise` and `bands` are the arguments of `Plan.bound`.
    """

    basis: ModelBasis
    u: Floats
    predicted: Floats
    delta: float
    noise: bool = False
    bands: bool = False

    def method(self, name: str) -> str:
        """How the radii were found, in words."""
        return f"{name} {'with' if self.noise else 'without'} noise"


def certificate(
    of: Question, known: tuple[tuple[Region, ...], ToCome | None] | None = None
) -> Certificate:
    """Bound where the true system ends; `known` is what `step_regions` returns."""
    basis, model, K, own = of.basis, of.basis.model, len(of.u), False
    bands: Floats | None
    if model.doubts:
        reason, said = model.doubts[0], "none that would do"
        tube, bands = np.full(K + 1, np.inf), np.full(of.predicted.shape, np.inf)
        tube[0], bands[0] = basis.x0_error, basis.x0_error
        components = bands[-1]
        parts = [norm(of.predicted[-1] - basis.xf), np.inf, basis.x0_error]
        target, control, why = np.inf, np.inf, None
    else:
        regions, to_come = known or step_regions(of)
        apart: Region | None = None
        if K == 1 and _sharper_by_rows(of, regions[0]):
            apart = model.region(of.delta, components=True)  # type: ignore[call-arg]
        own = apart is not None or isinstance(to_come, GaussianNoise)
        best, (target, *parts), components, tube, bands, control, why = _core.certify(
            (basis.x0, basis.x0_error),
            basis.xf,
            of.predicted,
            [(region.core, of.u, to_come, K == 1) for region in regions],
            None if apart is None else (apart.core, of.u, None, False),
            of.bands,
        )
        said, missing = _said(basis, regions[0], to_come), regions[best].missing
        reason = "too few data, or too many steps"
        if missing:
            reason = f"the data do not determine the system along {', '.join(missing[:3])}"
    method = of.method("several steps" if K > 1 else "one step")
    quantities = {
        "target": (target, "xf"),
        "state": (float(tube[-1]), "the predicted state"),
        "control": (control, "the exact best control", method, why or reason),
        "components": (components, "xf, for each state"),
        "tube": (tube, "the predicted states, for each step"),
    }
    if of.bands:
        quantities["bands"] = (bands, "the predicted states, for each step and state")
    alone = "; components and bands are a statement of their own" if own else ""
    return certificate_of(
        of.delta,
        method,
        reason,
        quantities,
        covers=f"all together, over the noise of the data{alone}",
        assumption=said,
        parts=dict(zip(("reach", "model error", "start"), parts, strict=True)),
        warnings=model.warnings,
    )


def _said(basis: ModelBasis, region: Region, to_come: ToCome | None) -> str:
    """The assumptions in words."""
    text = region.assumption
    if basis.x0_error:
        text += f"; x0 within {basis.x0_error:.4g}"
    if to_come is not None:
        of = "of the same size" if isinstance(to_come, SizedNoise) else "independent of the data"
        text += f"; noise to come {of}, at half of the probability of failure"
    return text


def _noise_to_come(model: Identified) -> Literal["Gaussian", "sized", "region", "unknown"]:
    """What bounds the noise of a run to come: its law and covariance, its size, or the region."""
    source = getattr(model, "least_squares", model)  # of a fused model
    assumed: Assumptions | None = getattr(source, "assumptions", None)
    if assumed is None:
        return "region"
    if assumed.known is not None:
        return "Gaussian" if assumed.noise == "gaussian" else "sized"
    if not isinstance(model, Model):
        return "region"
    if assumed.noise != "gaussian" or len(model.blocks) > 1:
        return "unknown"
    return "region" if assumed.design == "independent" else "Gaussian"


def step_regions(of: Question) -> tuple[tuple[Region, ...], ToCome | None]:
    """The regions for K steps, in one event, and the noise to come where that is not in them."""
    model, kind, K, delta = of.basis.model, _noise_to_come(of.basis.model), len(of.u), of.delta
    options: dict[str, Any] = {}
    if K > 1 and not (isinstance(model, Model) and len(model.blocks) > 1):
        options["frobenius"] = True
    if of.noise and kind == "region":
        options["future"] = K
    elif of.noise and kind == "Gaussian":
        delta *= REGION
        if isinstance(model, Model) and model.assumptions.known is None and model.pilot is None:
            options["method"] = "mixture"  # which bounds the covariance as well
    elif of.noise and kind == "sized":
        delta /= 2.0
    elif of.noise:
        raise InputError(
            "`noise` must be False: this model has neither noise of known covariance or size "
            "(`sigma` of identify) nor Gaussian noise without single known entries"
        )
    try:
        regions = model.regions(delta, **options)
    except InputError as error:
        if "future" not in options:
            raise
        raise InputError(f"`noise` must be False: {error}") from None
    if not of.noise or kind == "region":
        return regions, None
    # too few pairs for a bound of the covariance: infinite
    n, root = regions[0].n, np.diag(np.full(regions[0].n, np.inf))
    of_noise = regions[0].noise if kind == "Gaussian" else model.assumptions.known  # type: ignore[attr-defined]
    if of_noise is not None:
        root = _core.covariance_root(np.ascontiguousarray(of_noise))
    if kind == "Gaussian":
        end = END if K > 1 else END + BEFORE
        before = BEFORE * of.delta / max(K - 1, 1)
        return regions, GaussianNoise(root, end * of.delta, before)
    bounded = model.assumptions.noise == "bounded"  # type: ignore[attr-defined]
    return regions, SizedNoise(sqrt(K) * (1.0 if bounded else _core.one_noise(n, delta / K)), root)


def _sharper_by_rows(of: Question, region: Region) -> bool:
    """Whether regions by rows are smaller for components, decided without the data."""
    model = of.basis.model
    return (
        isinstance(model, Model)
        and not of.noise
        and len(region.parts) == 1
        and model.n > 1
        and model.pilot is None
        and model.assumptions.covariance != "scalar"
    )


def output_certificate(
    basis: ModelBasis, u: Floats, delta: float, noise: bool, gain: Floats | None = None
) -> Certificate:
    """Bound where the outputs of the true system are under `u`; `noise`: the readings.

    With a `gain` K (m, n) under ``u + K (x - xh)``, x the window, xh that of the plan.
    """
    model = basis.model
    assert isinstance(model, Model)
    rows, outputs, r = model.regressors.count, model.n_outputs, basis.target
    if noise and model.noise != "gaussian":
        raise InputError("`noise` must be False: that to come is bounded for Gaussian noise alone")
    # a covariance that is not known is bounded by the mixture alone, whatever the data
    own = noise and model.assumptions.known is None and model.assumptions.tail == 0.0
    own = own and model.pilot is None
    region = model.region(delta * REGION if noise else delta, method="mixture" if own else "auto")
    none = np.full((outputs, outputs), np.inf)
    covariance = none if region.noise is None else np.ascontiguousarray(region.noise)
    level = (covariance, delta * (1.0 - REGION)) if noise else None
    system = model.loop.ABc, model.loop.J, model.loop.G, model.m
    about = region.core, system, basis.x0, u, gain
    _, predicted, mean, read = _core.output_tube(*about, level, basis.apart)
    near = near_rows(basis, u, delta, noise, gain)
    if near is not None:
        mean, read = ((np.linalg.norm(of, axis=1), of) for of in (near[0], near[0] + near[1]))
    tube, components = mean if read is None else read
    if model.doubts:
        for radii in (mean[0], tube, components):
            radii[1:] = np.inf
    off = np.zeros_like(predicted) if r is None else np.abs(predicted - r)
    last = slice(-rows, None)
    away = np.linalg.norm(off, axis=1)[last]
    target = norm(away + tube[1:][last])
    model_error = mean[0] if basis.apart is None else _core.output_tube(*about, None, None)[2][0]
    parts = {"reach": norm(away), "model error": norm(model_error[1:][last])}
    if basis.apart is not None:
        parts["forecast"] = norm((mean[0] - model_error)[1:][last])
    if noise:
        parts["noise"] = norm((tube - mean[0])[1:][last]) if np.isfinite(target) else np.inf
    what = "readings" if noise else "means of the readings"
    method = f"window of {model.regressors.text}, {'with' if noise else 'without'} noise"
    if gain is not None:
        method += ", followed with the gain"
    if near is not None:
        method += ", near a reference"
    reason = "too few pairs, or too many steps for an unstable model (a feedback keeps it small)"
    if model.doubts:
        reason = model.doubts[0]
    elif region.missing:
        reason = f"the data do not determine the system along {', '.join(region.missing[:3])}"
    of = f"{what} of {show.listed(model.outputs)} at step {len(u)}"
    goal = "the predicted outputs" if r is None else "the target"
    quantities = {
        "last": ((off + components[1:])[-1], f"{goal}, {of}"),
        "target": (target, f"{goal}, the last {len(away)} {what} together"),
        "tube": (tube, f"the predicted outputs, {what} of each step"),
        "mean": (mean[0], "the predicted outputs, their mean given the record"),
        "readings": (components, f"the predicted outputs, {what} of each output"),
        "outputs": (off + components[1:], f"{goal}, {what} of each output"),
    }
    said = region.assumption
    if gain is not None:
        said += "; inputs u(k) + K (x(k) - xh(k)), x the window of the readings"
    if noise:
        share = "half" if near is None else ".44"
        said += f"; noise to come independent of the data, at {share} of the probability of failure"
    if basis.apart is not None:
        most = zip(model.input_names, basis.apart.max(axis=0), strict=True)
        within = (f"{name} within {show.at_most(off)}" for name, off in most if off > 0.0)
        said += f"; declared: {', '.join(within)} of the forecast"
    said += "; declared: the plant was at rest" if basis.at_rest else "; the record happened"
    return certificate_of(
        delta,
        method,
        reason,
        quantities,
        covers="target and tube together, and all radii of single outputs together, over the noise "
        + ("of the data and of the run" if noise else "of the data"),
        assumption=f"{said}; the number of steps was fixed beforehand",
        parts=parts,
        warnings=model.warnings,
    )


def near_rows(
    basis: ModelBasis, u: Floats, delta: float, noise: bool, gain: Floats | None
) -> tuple[Floats, Floats] | None:
    """Of each step and output bounds of its mean, and of noise; None for a plan without reference.

    That is decided without the data: by the number of steps, an exact x0, and a declared gain.
    """
    model = basis.model
    if not isinstance(model, Model) or model.pilot is None or model.doubts:
        return None
    pilot, off = model.pilot, basis.x0_error or basis.apart is not None
    if pilot.steps != len(u) or (gain is not None and pilot.follow is None) or off:
        return None
    assert pilot.start is not None
    assert pilot.inputs is not None

    def course(Theta: Floats, x0: Floats, inputs: Floats, K: Floats | None) -> Any:
        J, ABc, G = map(np.ascontiguousarray, model.regressors.loop(Theta))
        rows = np.ascontiguousarray(inputs), None if K is None else np.ascontiguousarray(K)
        return (ABc, J, G, model.m), np.ascontiguousarray(x0), *rows

    return model.piloted.followed(
        course(model.coefficients, basis.x0, u, gain),
        course(pilot.model, pilot.start, pilot.inputs, None if gain is None else pilot.follow),
        (model.assumptions.covariance, model.assumptions.known),
        delta,
        noise,
    )


NEAR = "near a reference,"


def near_states(
    of: Question, rows: tuple[Floats, Floats], gain: Floats | None = None
) -> Certificate:
    """Bound where the true system ends, near a reference: followed with a gain, or with noise."""
    basis, model = of.basis, of.basis.model
    assert isinstance(model, Model)
    assert model.pilot is not None
    whole, off = rows[0] + rows[1], np.abs(of.predicted[-1] - basis.xf)
    alone, tube = norm(rows[0][-1]), np.linalg.norm(whole, axis=1)
    parts = {"reach": norm(off), "model error": alone}
    if of.noise:
        parts["noise"] = float(tube[-1]) - alone
    quantities = {
        "target": (norm(off) + tube[-1], "xf"),
        "state": (tube[-1], "the predicted state"),
        "components": (off + whole[-1], "xf, for each state"),
        "tube": (tube, "the predicted states, for each step"),
    }
    if gain is not None:  # |K e|_i <= sum_j |K_ij| |e_j|
        inputs = (whole[:-1] @ np.abs(gain).T).max(axis=0)
        quantities["inputs"] = (inputs, "the planned ones, for each input in any step")
    return certificate_of(
        of.delta,
        of.method(NEAR if gain is None else "near a reference, followed with the gain,"),
        "too few data for this probability, or a pilot that says too little",
        quantities,
        covers="all together, over the noise of the data" + " and of the run" * of.noise,
        assumption=f"{model.assumptions.text}, {model.pilot.said}"
        + "; inputs u(k) + K (x(k) - xh(k)) with states read exactly" * (gain is not None)
        + "; noise of the run independent of the data" * of.noise,
        parts=parts,
        warnings=model.warnings,
    )


# The share of the probability of failure for the regions of any design, of the same pairs. Their
# radii depend on it by a logarithm: 1/10 costs them 2 % and what is near the reference 2 %. Fixed
# before the data, so that the smaller one may be taken after them.
ANY_DESIGN = 0.1


def near_reference(of: Question) -> Certificate | None:
    """Bound where the true system ends; None for a plan that no reference is declared for.

    That is decided without the data: by the number of steps, and an exact x0. Each radius is the
    smaller one of two that hold together: that near the reference, and that of any design.
    """
    basis, model = of.basis, of.basis.model
    if not isinstance(model, Model) or model.pilot is None or model.doubts:
        return None
    if len(of.u) != model.pilot.steps or basis.x0_error:
        return None
    if of.noise and model.pilot.root is not None:  # apart from the reference
        rows = near_rows(basis, of.u, of.delta, True, None)
        return None if rows is None else near_states(of, rows)
    plain, share = model.of_any_design, ANY_DESIGN if model.of_any_design is not None else 0.0
    task = basis.x0, basis.xf, np.ascontiguousarray(of.u), np.ascontiguousarray(of.predicted)
    known = model.assumptions.covariance, model.assumptions.known
    target, *parts, tube, components = model.piloted.near(
        model.reference, *task, known, of.delta * (1.0 - share), of.noise
    )
    named = dict(zip(("reach", "quantile", "mismatch", "rest"), parts, strict=True))
    state: float = float(np.sum(parts[1:]))
    if plain is not None:
        by = replace(basis, model=plain)
        other = certificate(of._replace(basis=by, delta=of.delta * share))
        if other.target < target:
            named = dict(other.parts)
        target = min(target, other.target)
        state = min(state, float(other["state"].radius))
        components = np.minimum(components, other["components"].radius)
        tube = np.minimum(tube, other["tube"].radius)
    return certificate_of(
        of.delta,
        of.method(NEAR),
        "too few data for this probability, or a pilot that says too little",
        {
            "target": (target, "xf"),
            "state": (state, "the predicted state"),
            "components": (components, "xf, for each state"),
            "tube": (tube, "the predicted states, for each step"),
        },
        covers=(
            "target and state together, the components and the tube each on its own, over the "
            "noise of the data"
        ),
        assumption=f"{model.assumptions.text}, {model.pilot.said}",
        parts=named,
        warnings=model.warnings,
    )
