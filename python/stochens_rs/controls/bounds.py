"""How wrong plans are: bounds of estimates, of models, within limits, followed; typical misses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf, sqrt
from time import monotonic
from typing import Any, Literal

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.records import Count, FromZero, Probability, SavedRecord, trusted
from .._base.types import QUANTITIES, ROUNDING, Floats, Fusion, norm
from ..certificates.certificate import Certificate, Radius, certificate_of, radius_at
from ..certificates.of_model import (
    ModelBasis,
    Question,
    certificate,
    near_reference,
    near_rows,
    near_states,
    output_certificate,
    step_regions,
    trajectory,
)
from ..exceptions import InputError, InputTypeError, ShapeError, SizeError
from ..feedback import Loop, LoopCertificate
from ..fusion.provenance import Basis, Known
from ..identification.identified import Identified
from ..identification.model import in_states
from ..limits.problem import Horizon, Limited, LimitedErrors, MovedTarget, Task
from ..rng import as_key
from ..theory.drawn_bounds import (
    Bounded,
    DrawnEntity,
    PlanErrors,
    drawn_bound,
    not_simulated,
    radii,
)
from ..theory.exact import EPS, checked_finite, matrix_powers
from ..validation.held_out import needed, rank_of

KEY = as_key(0).child("simulated bound")  # of the draws, which are the same in every call
LAWS = "the exact values are those that the realizations were drawn from, independently"
TARGETS = "the targets of the fits are the exact values that were fitted"


def plan_bound(
    basis: Basis, u: Floats, predicted: Floats, fusion: Fusion, delta: float
) -> Certificate:
    """Bound the errors of the control `u`, which leads the model along `predicted`."""
    errors = plan_errors(basis, len(u), fusion)
    best, reason = errors.best, None
    if not errors.random:
        error, names = best.error(u.ravel(), basis.values[0]), ("exact error",) * 2
        state, control = error.state + error.state_rounding, error.control + error.control_rounding
    else:
        if drawn := radii(errors, delta, KEY):
            (state, control), names = drawn, ("simulated",) * 2
        else:
            reason = not_simulated(delta, errors.cost)
            (state, control), names = _formulas(basis, u, predicted, errors, delta, fusion)
        # The rounding of the exact control v of the estimates, whatever the method. ||C_K (u - v)||
        # is known for the estimates, which is all over one step; over several it is at most
        # ||C_K|| ||u - v||. The averages themselves are rounded like xf - A^K x0.
        off_state, off_control = basis.rounding
        if errors.several:
            off_state = float(best.factors.singular_values[0]) * off_control
        state = state + 2.0 * best.unsure + off_state
        control = control + best.amplified(2.0 * best.unsure) + off_control
    if best.gap > 0.0 and np.isfinite(basis.rounding).all():
        checked_finite(np.array([state, control]), "bound")
    else:
        reason = _DIGITS
    target = float(np.hypot(state, best.upper)) * (1.0 + 4.0 * EPS)
    quantities = {
        "target": (target, "xf", names[0], reason),
        "state": (state, "where the exact control leads", names[0], reason),
        "control": (control, "the exact control", names[1], reason),
    }
    parts = {"estimates": state, "out of reach": best.upper * (1.0 + 4.0 * EPS)}
    return certificate_of_laws(basis, delta, errors.random, quantities, parts)


def certificate_of_laws(
    basis: Basis, delta: float, random: bool, quantities: dict[str, Any], parts: dict[str, float]
) -> Certificate:
    """The certificate of a plan of estimates: radius, what it is from, method, reason of each."""
    sure = 1.0 - delta if random else 1.0
    fitted = any(entity.kind == "fitted" for entity in basis.entities)
    each = "control and state each, target with state, over the draws of the realizations"
    return trusted(
        Certificate,
        kind="guaranteed" if random else "certain",
        delta=delta,
        quantities={
            name: trusted(Radius, radius, distance_from, sure, method, reason)
            for name, (radius, distance_from, method, reason) in quantities.items()
        },
        covers=each if random else "nothing was drawn",
        assumption=TARGETS if fitted else LAWS if random else "what was given is exact",
        parts=parts,
    )


_DIGITS = "the condition of C_K is so large that rounding leaves no digit of the control for sure"


def plan_errors(basis: Basis, steps: int, fusion: Fusion) -> PlanErrors:
    """The law of the errors of a plan whose entities are all known.

    Averages of realizations are random, fits and exact values are not.
    """
    rows = basis.A.axis == "rows"
    if fusion == "diagonal" and basis.A.kind == "systematic" and rows:
        raise InputError(
            "no bound is known for paired systematic realizations of rows: use fusion='product'"
        )
    x0, xf, A = (
        DrawnEntity(values, None, one.size, one.kind)
        if one.kind == "iid" or one.kind == "systematic"
        else DrawnEntity(values, one.estimate if one.kind == "fitted" else None)
        for one, values in zip(basis.entities, basis.values, strict=True)
    )
    return PlanErrors(basis.B, x0, xf, A, steps=steps, paired=fusion == "diagonal", rows=rows)


def _formulas(
    basis: Basis, u: Floats, predicted: Floats, errors: PlanErrors, delta: float, fusion: Fusion
) -> tuple[tuple[float, float], tuple[str, str]]:
    """Bounds of the state and of the control for a `delta` that cannot be simulated."""
    if len(u) > 1:
        return _along_trajectory(basis, u, predicted, errors, delta), ("sum of errors",) * 2
    if all(entity.kind in ("exact", "iid") for entity in basis.entities):
        x0, xf, A = basis.values
        state, control = (
            Bounded(quantity, ((A, basis.B), x0, xf), fusion=fusion, axis=basis.A.axis).least(
                basis.sizes, delta
            )
            for quantity in QUANTITIES
        )
        return (state[0], control[0]), (state[1], control[1])
    if fusion == "diagonal":
        raise InputError(
            "no formula bounds paired systematic realizations, which are dependent (use "
            f"fusion='product'), and {not_simulated(delta, errors.cost)}"
        )
    return _sum_of_errors(basis, errors, delta), ("sum of errors",) * 2


def _sum_of_errors(basis: Basis, errors: PlanErrors, delta: float) -> tuple[float, float]:
    """Bounds of ``||B (u - v)||`` and ``||u - v||`` by those of the estimates.

    ``B (v - u) = P [(xf - xf_hat) - A_hat (x0 - x0_hat) - (A - A_hat) x0]`` with ``P = B B^+``, so
    ``||B (u - v)|| <= ef + ||P A_hat|| e0 + eA (||x0_hat|| + e0)`` (the corrected proof of Lemma
    3.2), and with ``B^+`` in place of P for the control.
    """
    e0, ef, eA = distances(basis, delta, "Frobenius")
    x0_hat, _, A_hat = basis.estimates
    U, s = errors.best.factors.U, errors.best.factors.s
    if s.size == 0:
        return 0.0, 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        reached = U.T @ A_hat
        free = ef + eA * (float(np.linalg.norm(x0_hat)) + e0)
        state = free + float(np.linalg.norm(reached, 2)) * e0
        control = free / float(s[-1]) + float(np.linalg.norm(reached / s[:, None], 2)) * e0
    return checked_finite(state, "bound"), checked_finite(control, "bound")


def _along_trajectory(
    basis: Basis, u: Floats, predicted: Floats, errors: PlanErrors, delta: float
) -> tuple[float, float]:
    """``ef + ||A^K|| e0 + eA sum_k ||A^{K-1-k}|| ||xh(k)|| + ||xh(K) - xf_hat||``.

    This bounds ``||x(K) - xf||`` along the predicted states ``xh``; by Pythagoras
    ``||C (u - v)||^2`` is smaller by the squared residual.
    """
    _, xf_hat, _ = basis.estimates
    e0, ef, eA = distances(basis, delta, "spectral")
    norms = np.linalg.norm(matrix_powers(basis.values[2], len(u)), ord=2, axis=(1, 2))
    with np.errstate(over="ignore", invalid="ignore"):
        along = float(norms[-2::-1] @ np.linalg.norm(predicted[:-1], axis=1))
        total = ef + norms[-1] * e0 + eA * along + norm(predicted[-1] - xf_hat)
        # A xh + B u is rounded by (n + m) eps (||A||_F ||xh|| + ||B||_F ||u||) at most
        A, B = basis.values[2], basis.B
        sizes = np.linalg.norm(predicted[:-1], axis=1), np.linalg.norm(u, axis=1)
        terms = sum(B.shape) * EPS * ((norm(A) + eA) * sizes[0] + norm(B) * sizes[1])
        total += float(norms[-2::-1] @ terms)
        # total^2 - missed^2, of factors that do not overflow
        missed = max(0.0, norm(errors.best.missed) - errors.best.state_rounding)
        state = sqrt(max(0.0, total - missed)) * sqrt(total + missed)
        # u - v = C^+ C (u - v) + (I - C^+ C) u
        aside, gap = errors.best.aside(u.ravel()), errors.best.gap
        if gap <= 0.0:
            return errors.rounded((state, np.inf))
        # the rows of the factors are turned by at most off / gap
        turned = errors.best.off / gap * norm(u) if errors.best.factors.s.size < u.size else 0.0
        return errors.rounded((state, float(np.hypot(state / gap, norm(aside) + turned))))


def distances(basis: Basis, delta: float, matrix_norm: str) -> tuple[float, float, float]:
    """Bounds on the errors of the three estimates, all valid with probability 1 - delta."""
    shares = sum(entity.kind == "iid" for entity in basis.entities)

    def distance(entity: Known, values: Floats, estimate: Floats) -> float:
        matrix, size = entity.name == "A", entity.size
        axis = entity.axis if matrix else "columns"
        what: Literal["matrix", "vector"] = "matrix" if matrix else "vector"
        if entity.kind == "exact":
            return 0.0
        if entity.kind == "fitted":
            return float(np.linalg.norm(estimate - values, 2 if matrix else None))
        if entity.kind == "systematic":
            return Bounded(what, (values,), axis=axis, scheme="systematic").least((size,), delta)[0]
        how: Any = {"norm": matrix_norm if matrix else "2", "axis": axis}
        return drawn_bound(what, values, size=size, delta=delta / shares, **how)[0]

    e0, ef, eA = map(distance, basis.entities, basis.values, basis.estimates)
    return e0, ef, eA


HARD = "with hard limits of the states the best control may move by any multiple of an error"
SMALL = "the inputs have too little weight for what is known of the system: give a larger R"
ALONE, MOVED = "the limits alone", "how far the best control moves in the region"

ROUNDS = 8  # of moving limits inward; the radii settled after 2 to 4 in 300 random plans
AHEAD = 1e-6  # the solver keeps limits to 1e-9 of the states, which must not undo a round


def model_bound(
    of: Question, limited: Limited | None, noise: bool | None, bands: bool | None, gain: Any
) -> Certificate:
    """Bound where the true system ends; the arguments are those of `Plan.bound`."""
    basis = of.basis
    window = basis.window is not None
    every = bands if bands is not None else not window and gain is None
    noisy = validation.flag("noise", window if noise is None else noise)
    of = of._replace(noise=noisy, bands=validation.flag("bands", every))
    if of.bands and (window or gain is not None):
        other_than = "for a model of outputs" if window else "with `gain`"
        raise InputError(f"`bands` must be False {other_than}")
    K = None
    if gain is not None:
        if not isinstance(gain, (Loop, LoopCertificate)):
            raise InputTypeError(
                f"`gain` must be a Loop or its certificate, got {validation.show(gain)}"
            )
        K = np.ascontiguousarray(gain.K)
        if K.shape != basis.model.B.shape[::-1]:
            raise ShapeError(f"`gain` must be one of this model, got one of shape {K.shape}")
        if not window:
            return followed(of, gain)
    if window:
        return output_certificate(basis, of.u, of.delta, noisy, K)
    near = near_reference(of)
    if limited is None:
        return near or certificate(of)
    found = limited_certificate(of, limited)
    return found if near is None else near.over(found)


def limited_certificate(of: Question, limited: Limited) -> Certificate:
    """Bound where the true system ends, and how far the control is from the best within limits.

    The certificate holds for any control that was chosen after the data; what is new is the
    comparison with the best control of the true system, in the same event: "excess", "control",
    and "states", ``(sum_k ||x(k) - y(k)||_{Q_k}^2)^(1/2)`` for the states x under u and y under it.
    """
    basis = of.basis
    known = None if basis.model.doubts else step_regions(of)
    found = certificate(of, known)
    task, tube = limited.task, found.tube[1:]
    model = Horizon(task, basis.model.A, basis.model.B, R=limited.R)
    horizon, farthest = model.core, model.core.farthest(limited.u)
    region, control, excess, states = None, np.inf, np.inf, np.inf
    reason = found["target"].reason
    if task.state_low is not None and task.soft is None:
        reason = HARD
    elif known is not None:
        region = known[0][0]
    if region is not None and np.isfinite(tube).all():
        at = np.ascontiguousarray(of.predicted[1:]), of.u
        sure = len(tube) == 1 and not task.soft and not basis.x0_error and not of.noise
        alpha = horizon.alpha(region.core, tube, *at, basis.x0 if sure else None)
        by = horizon.apart(region.core, *at, alpha, limited.gap)
        control, excess, states, reason = by.control, by.excess, by.state, SMALL

    def radius(value: float, distance_from: str, method: str = MOVED) -> Radius:
        return radius_at(value, distance_from, of.delta, method, reason)

    best = "the best control within the limits"
    alone = farthest < control
    further = {
        "control": radius(min(control, farthest), best, ALONE if alone else MOVED),
        "excess": radius(excess, "the least J within the limits"),
        "states": radius(states, f"the states under {best}, in the norm of Q"),
    }
    fields = {**vars(found), "quantities": {**found.quantities, **further}}
    return trusted(Certificate, **fields)


def tightened(task: Task, radii: Floats) -> Task:
    """The task with limits of ``x(k)`` moved inward by ``radii[k]``, k = 0, ..., K; (K + 1, n).

    Each state within the new limits may be wrong by its radius.
    """
    if task.state_low is None or task.state_high is None:
        return task
    room = radii[1:]
    return replace(task, state_low=task.state_low + room, state_high=task.state_high - room)


def lacking(task: Task, states: Floats, radii: Floats) -> float:
    """By how much the states (K + 1, n), each wrong by its radius, may leave the limits; or 0."""
    inward, at = tightened(task, radii), states[1:]
    if inward.state_low is None or inward.state_high is None:
        return 0.0
    return max(0.0, float(np.maximum(at - inward.state_high, inward.state_low - at).max()))


def within_state_limits(
    basis: ModelBasis, first: Limited, delta: float, time_limit: float | None = None
) -> tuple[Limited, Certificate]:
    """A control under which the true system keeps hard limits of its states, and its certificate.

    `first` is the best control without a margin. The bands around its states say by how much to
    move the limits inward, and those of the control within them whether that was enough; if not,
    the limits move on. If that ends nowhere, its status is "infeasible" and `missing` says by
    how much. After `time_limit` seconds the limits move no further: then it is "user_limit".
    """
    end = inf if time_limit is None else monotonic() + time_limit
    model, task, found = basis.model, first.task, first

    def certified() -> tuple[Floats, Certificate, Floats]:
        """The states of the model, the certificate, and the radius of each state, (K + 1, n)."""
        at = trajectory(model.Theta, basis.x0, found.u)
        bound = certificate(Question(basis, found.u, at, delta, bands=True))
        bands = bound.quantities.get("bands")
        radii = bound.tube[:, None] if bands is None else np.asarray(bands.radius)
        return at, bound, np.broadcast_to(radii, at.shape)

    at, bound, radii = certified()
    missing = lacking(task, at, radii)
    for _ in range(ROUNDS):
        inward = tightened(replace(task, R=first.R), radii * (1.0 + AHEAD))
        if not 0.0 < missing < np.inf or np.any(inward.state_low > inward.state_high):  # type: ignore[operator]
            break
        left = end - monotonic()
        if left <= 0.0:
            found = replace(found, status="user_limit")
            break
        horizon = Horizon(inward, model.A, model.B, model.c)
        found = horizon.solve(basis.x0, time_limit=None if time_limit is None else left)
        at, bound, own = certified()
        missing, radii = lacking(task, at, own), np.maximum(radii, own)
    if missing > ROUNDING * float(np.abs(at).max()):
        status = found.status if found.status in ("user_limit", "interrupted") else "infeasible"
        found = replace(found, status=status, missing=missing)
    return replace(found, task=task), bound


FIRM = "limits: firm nonexpansiveness"
_MANY = "without a weight of the inputs more than one control is the best"


def limited_bound(
    basis: Basis, limited: Limited, predicted: Floats, delta: float, fusion: Fusion = "product"
) -> Certificate:
    """Bound the errors of a control within limits, which leads the model along `predicted`."""
    errors = plan_errors(basis, len(limited.u), fusion)
    task, (x0, xf, A) = limited.task, basis.values
    wanted = None if task.follows else np.tile(xf, (task.steps, 1))
    exact = Horizon(task, A, basis.B, wanted=wanted, R=limited.R)
    name, reason = "none", None
    cause: float | tuple[float, ...] | _core.Apart | None = None
    off: Floats | None = None
    hard = task.state_low is not None and task.soft is None and errors.random
    if hard:
        state, control, excess, missed = (np.inf,) * 4
        reason = HARD
    else:
        exact.need()
        if not errors.random:
            name = "exact error"
        elif task.steps == 1 or basis.A.kind == "exact":
            # ||du||_H <= d and ||du||_R <= d / 2 for d = ||P_Q (b^ - b)||_Q
            name, off = FIRM, np.ascontiguousarray(task.reference - predicted[1:])
            moved = MovedTarget(errors, exact)
            if drawn := radii(moved, delta, KEY):
                cause = drawn[0]
            else:
                reason = not_simulated(delta, moved.cost)
                if fusion == "diagonal":
                    raise InputError(
                        "no formula bounds a control within limits of paired realizations (use "
                        f"fusion='product'), and {reason}"
                    )
                x0_hat, _, A_hat = map(np.ascontiguousarray, basis.estimates)
                e = distances(basis, delta, "Frobenius")
                cause = exact.core.moved_target(e, A_hat, x0_hat)
        else:
            follows = basis.xf.kind != "exact" and not task.follows
            law = LimitedErrors(errors, exact, limited, follows)
            if task.boxed:
                cause = radii(law, delta, KEY)
                reason = None if cause else not_simulated(delta, law.cost)
            name = "simulated" if cause else "uncertain map"
            cause = cause or _apart(basis, limited, predicted, exact, delta)
        state, control, excess, missed = exact.core.error(
            np.ascontiguousarray(x0), limited, cause, off
        )
    # in the 2-norm where only the last state counts, with one weight
    scale = float(task.terminal[0, 0])
    plain = not task.stage.any() and np.array_equal(task.terminal, scale * np.eye(len(x0)))
    size = np.sqrt(scale) if plain else 1.0
    norm = "" if plain else ", in the norm of Q"
    best = "the best control within the limits"
    goal = "the reference" if task.follows else "xf"
    quantities = {
        "target": ((state + missed) / size, f"{goal}{norm}", name, reason),
        "state": (state / size, f"where {best} leads{norm}", name, reason),
        "control": (control, best, name, reason),
        "excess": (excess, "the least J within the limits", name, reason),
    }
    if np.isinf(control) and not hard:
        why = SMALL if name == "uncertain map" else _MANY
        quantities["control"] = (control, best, "none", why)
    parts = {"estimates": state / size, "out of reach": missed / size}
    return certificate_of_laws(basis, delta, errors.random, quantities, parts)


def _apart(
    basis: Basis, limited: Limited, predicted: Floats, exact: Horizon, delta: float
) -> _core.Apart:
    """How far the control is from the best where the map moves with A."""
    e0, ef, eA = distances(basis, delta, "spectral")
    alpha = exact.core.along(np.ascontiguousarray(predicted), (e0, ef, eA))
    A, B = basis.estimates[2], basis.B
    n, m = B.shape
    every, unit = np.arange(n), np.eye(n)
    part = _core.RegionPart(every, every, unit, unit, unit[:, :0].copy(), 1.0, unit, eA * eA)
    region = _core.Region(np.hstack([A, B]), m, (part,), None, False)  # ||A - A^|| <= eA
    model, states = Horizon(limited.task, A, B, R=limited.R), np.ascontiguousarray(predicted[1:])
    return model.core.apart(region, states, limited.u, alpha, limited.gap)


def proof_of(
    name: str, model: Identified, gain: Loop | LoopCertificate, delta: float
) -> LoopCertificate:
    """The certificate of a feedback of this model; a `Loop` is certified with `delta`."""
    proof = gain.certificate(delta) if isinstance(gain, Loop) else gain
    validation.instance("gain", proof, LoopCertificate)
    own = in_states(model, model.region(proof.region.delta)).centre
    if not np.array_equal(own, proof.region.centre):
        raise InputError(f"`{name}` must be the model that `gain` was made for")
    if model.doubts and proof.status == "certified":
        raise InputError(f"`{name}` must be of the model of `gain`, got another: {model.doubts[0]}")
    return proof


def followed(of: Question, gain: Loop | LoopCertificate) -> Certificate:
    """Bound where the true system ends under ``u(k) + K (x - xh)``; half of delta is for noise."""
    basis, u, predicted, delta, noise, _ = of
    K = np.ascontiguousarray(gain.K)
    near = near_rows(basis, u, delta, noise, K)
    if near is not None:
        return near_states(of, near, K)
    proof = proof_of("plan", basis.model, gain, delta / 2.0 if noise else delta)
    region = proof.region
    left = delta - region.delta
    if left < 0.0 or (noise and left == 0.0):
        raise InputError(
            f"`delta` must be {'above' if noise else 'at least'} that of the region of `gain`, "
            f"{region.delta:g}, got {delta:g}"
        )
    # the centre of the region need not be the model that planned
    centred = _core.followed_inputs(region.core, basis.x0, u, predicted, proof.K)
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
    aside = np.linalg.norm(tube.states - predicted, axis=1)
    tubes, state = tube.radii + aside, float(tube.radii[-1] + aside[-1])
    inputs = tube.input_components + np.abs(centred - u) + EPS * np.abs(u)
    return certificate_of(
        delta,
        of.method("a certified feedback,"),
        proof.reason or "the feedback is not certified",
        {
            "target": (parts["reach"] + float(tube.radii[-1]), "xf"),
            "state": (state, "the predicted state"),
            "components": (np.abs(end) + tube.components[-1], "xf, for each state"),
            "tube": (tubes, "the predicted states, for each step"),
            "inputs": (inputs.max(axis=0), "the planned ones, for each input in any step"),
        },
        covers="all together, over the noise of the data" + (" and of the run" if noise else ""),
        assumption=region.assumption
        + "; inputs u(k) + K (x(k) - xh(k)) with states read exactly"
        + ("; Gaussian noise of the run independent of the data" if noise else ""),
        parts=parts,
        warnings=basis.model.warnings,
    )


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
        least = min(needed(delta), 10**20)
        raise SizeError(f"`draws` must be at least {least} for delta={delta:g}, got {count}")
    miss = _core.validation_rank(misses(count), rank)
    said = f"approximate, no bound; {assumption}"
    return Typical(miss, certified, delta, count, noise, said)
