"""Errors of plans: against a known system, typical ones, their covariance, with a feedback."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.numbers import norm
from .._base.records import Count, FromZero, Probability, SavedRecord, trusted
from .._base.running import get_num_threads
from .._base.types import QUANTITIES, Floats
from ..certificates.certificate import Certificate, Radius, radius_at
from ..certificates.of_model import ModelBasis
from ..exceptions import InputError, SizeError
from ..feedback import Loop, LoopCertificate
from ..fusion.provenance import Basis
from ..identification.model import Model
from ..limits.problem import Horizon
from ..rng import as_key
from ..theory import moments
from ..theory.exact import EPS, PlanError, states
from ..validation.fresh_systems import needed, rank_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from .._base.types import Fusion, Quantity, Scheme
    from ..identification.identified import Identified
    from ..limits.problem import Limited
    from ..rng import RngLike


@dataclass(frozen=True, eq=False, repr=False)
class Typical(SavedRecord):
    """An approximate error bar of a plan from data, beside its certificate; it is no bound.

    Made by `Plan.typical` and, of means, by `DataStream.typical`.

    Attributes
    ----------
    miss : float
        A share ``1 - delta`` of the drawn models ends within this of the target.
    certified : float
        ``plan.bound(delta).target``, which does bound the distance; infinite where nothing does.
    delta : float
        The share of drawn models that miss by more.
    draws : int
        The number of drawn models.
    noise : bool
        Whether both include the noise of the run to come.
    assumption : str
        What `miss` rests on, in words.
    """

    miss: FromZero
    certified: FromZero
    delta: Probability
    draws: Count
    noise: bool
    assumption: str

    def __repr__(self) -> str:
        run = "with noise" if self.noise else "without noise"
        return (
            f"<Typical: certified {show.at_most(self.certified)}, typical {self.miss:.3g}, "
            f"{show.percent(self.delta)}, {run}>"
        )

    def _repr_html_(self) -> str:
        drawn = f"{self.draws} models, from the confidence distribution of the data"
        share = show.percent(self.delta)
        typical = f"approximate, no bound: {share} of the models drawn miss by less"
        return show.card(self, [("typical", typical), ("drawn", drawn), ("for", self.assumption)])


def typical(
    basis: Basis | ModelBasis | None,
    u: Floats,
    predicted: Floats,
    bound: Callable[..., Certificate],
    delta: float,
    draws: int,
    rng: RngLike,
    noise: bool | None,
) -> Typical:
    """Draw the misses of models from the law of the estimate, where it can be trusted.

    Without a target they are those of the last of the states or outputs that were `predicted`.
    """
    model = basis.model if isinstance(basis, ModelBasis) else None
    if not isinstance(basis, ModelBasis) or not isinstance(model, Model):
        raise InputError(
            "`typical` needs a plan for a model by `identify`: only there the law of the estimate "
            "is known, and no data were looked at in between"
        )
    if model.warnings:
        raise InputError(f"`typical` must not be trusted beside a warning: {model.warnings[0]}")
    window, assumed, rows = model.window, model.assumptions, model.n_outputs
    noisy = window is not None if noise is None else validation.flag("noise", noise)
    certified = bound(delta, noise=noisy).target
    if basis.x0_error:
        raise InputError("`typical` needs an exact x0, not an Uncertain one")
    if assumed.tail:
        raise InputError("`typical` is not for models with a tail: its law is not known")
    law = model._law(windows=True)
    if assumed.known is None and law[-1] < 2 * rows:
        raise InputError(
            f"`typical` needs {2 * rows} more pairs than unknowns of a row where the covariance "
            f"is unknown, this model has {law[-1]}"
        )
    key, threads, goal = bytes(as_key(rng).child("typical")), get_num_threads(), basis.target
    if goal is None:
        goal = predicted[1:][-(1 if window is None else window.count) :].ravel()
    exact = "states without error" if window is None else f"the window of {window.text} exact"
    text = (
        f"{assumed.text}; {exact}; number and lengths of the runs fixed beforehand; "
        f"residuals {'not tested' if model.checks is None else 'without a warning'}"
    )
    of = None if window is None else window.core

    def misses(size: int) -> Floats:
        return _core.drawn_misses(law, basis.x0, u, goal, noisy, size, key, threads, of)

    return ranked(misses, certified, delta, draws, noisy, text)


def ranked(
    misses: Callable[[int], Floats],
    certified: float,
    delta: float,
    draws: int,
    noise: bool,
    assumption: str,
) -> Typical:
    """The order statistic of so many misses."""
    count = validation.size("draws", draws)
    rank = rank_of(count, delta)
    if rank > count:
        raise SizeError(
            f"`draws` must be at least {needed(delta)} for delta={delta:g}, got {count}"
        )
    miss = _core.validation_rank(misses(count), rank)
    return Typical(miss, certified, delta, count, noise, assumption)


def plan_covariance(basis: Basis, steps: int, fusion: Fusion, quantity: Quantity) -> Floats:
    """Compute the covariance of the last state or of the control (see `Plan.covariance`)."""
    of_control = validation.choice("quantity", quantity, QUANTITIES) == "control"
    fitted = [entity.name for entity in basis.entities if entity.kind == "fitted"]
    schemes = {entity.kind for entity in basis.entities} - {"exact"}
    unknown = None
    if steps > 1 and of_control:
        raise InputError(
            f"`quantity` must be 'state' over {steps} steps, got 'control': the control is not "
            "linear in A, and no formula is known for its covariance"
        )
    if fitted:
        unknown = f": the weights of `{fitted[0]}` depend on the realizations"
    elif len(schemes) > 1:
        unknown = " of iid and systematic samples together"
    elif steps > 1 and schemes == {"systematic"}:
        unknown = f" over {steps} steps of systematic samples"
    if unknown:
        raise InputError(f"no formula is known for the covariance{unknown}")
    (x0, xf, A), sizes, axis = basis.values, basis.sizes, basis.A.axis
    system = A, basis.B
    if steps > 1:
        return moments.final_state_covariance(system, x0, xf, steps, sizes, axis=axis)
    covariance = moments.control_covariance if of_control else moments.state_covariance
    scheme: Scheme = "systematic" if schemes == {"systematic"} else "iid"
    return covariance(system, x0, xf, sizes, fusion=fusion, axis=axis, scheme=scheme)


def limited_error(
    limited: Limited, A: Floats, B: Floats, x0: Floats, xf: ArrayLike | None, u: Floats
) -> PlanError:
    """Compare `u` with the best control of an exact system within the same limits."""
    task = replace(limited.task, R=limited.R)
    if task.follows != (xf is None):
        which = (
            "None: this plan has a reference"
            if task.follows
            else "given: this plan has no reference"
        )
        raise InputError(f"`xf` must be {which}")
    if xf is not None:
        task = replace(task, reference=np.tile(xf, (task.steps, 1)))
    horizon = Horizon(task, A, B)
    best = horizon.solve(x0)
    wrong = u - best.u
    reached = states(A, B, x0, best.u)[-1]
    control, state = norm(wrong), norm(states(A, B, 0.0 * x0, wrong)[-1])
    size, length = norm(best.u), norm(reached)
    where = "x_actual" if length else "x0"
    length = length or norm(x0)
    off_control, off_state = horizon.core.in_two_norm(best.distance)
    pushed = (u.size + len(x0)) * EPS * norm(horizon.core.pushes())
    return PlanError(
        control=control,
        control_relative=_ratio(control, size),
        state=state,
        state_relative=_ratio(state, length),
        residual=norm(task.reference[-1] - reached),
        control_rounding=off_control + EPS * (size + control),
        state_rounding=off_state + pushed * (size + control),
        control_relative_to="v" if size else "nothing",
        state_relative_to=where if length else "nothing",
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
