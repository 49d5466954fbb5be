"""Certificates of controls within limits for a model from data, and limits that leave room."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from time import monotonic
from typing import TYPE_CHECKING

import numpy as np

from .._base.numbers import ROUNDING
from ..certificates.of_model import certificate, step_regions
from ..certificates.radius import Radius
from ..certificates.region_errors import trajectory
from .limited import Horizon

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..certificates.certificate import Certificate
    from ..certificates.model_basis import ModelBasis
    from ..certificates.of_model import Asked
    from .constraints import Task
    from .limited import Limited

HARD = "with hard limits of the states the best control may move by any multiple of an error"
SMALL = "the inputs have too little weight for what is known of the system: give a larger R"
ALONE, MOVED = "the limits alone", "how far the best control moves in the region"
_DIRECT = "a region over all steps at once says nothing of single steps"

ROUNDS = 8  # of moving limits inward; the radii settled after 2 to 4 in 300 random plans
AHEAD = 1e-6  # the solver keeps limits to 1e-9 of the states, which must not undo a round


def limited_certificate(
    basis: ModelBasis, limited: Limited, predicted: Floats, delta: float, asked: Asked
) -> Certificate:
    """Bound where the true system ends, and how far the control is from the best within limits.

    The certificate holds for any control that was chosen after the data; what is new is the
    comparison with the best control of the true system, in the same event: "excess", "control",
    and "states", ``(sum_k ||x(k) - y(k)||_{Q_k}^2)^(1/2)`` for the states x under u and y under it.
    """
    known = None if basis.model.doubts else step_regions(basis, delta, len(limited.u), asked)
    found = certificate(basis, limited.u, predicted, delta, asked, known)
    task, tube = limited.task, found.tube[1:]
    model = Horizon(task, basis.model.A, basis.model.B, R=limited.R)
    horizon, farthest = model.core, model.core.farthest(limited.u)
    region, control, excess, states = None, np.inf, np.inf, np.inf
    reason = found["target"].reason
    if task.state_low is not None and task.soft is None:
        reason = HARD
    elif known is not None:
        region, reason = (known[1][0], reason) if known[1] else (None, _DIRECT)
    if region is not None and np.isfinite(tube).all():
        at = np.ascontiguousarray(predicted[1:]), limited.u
        sure = len(tube) == 1 and not task.soft and not basis.x0_error and not asked.noise
        alpha = horizon.alpha(region._core, tube, *at, basis.x0 if sure else None)
        by = horizon.apart(region._core, *at, alpha, limited.gap)
        control, excess, states, reason = by.control, by.excess, by.state, SMALL

    def radius(value: float, distance_from: str, method: str = MOVED) -> Radius:
        return Radius._at(value, distance_from, delta, method, reason)

    best = "the best control within the limits"
    alone = farthest < control
    return found._with(
        control=radius(min(control, farthest), best, ALONE if alone else MOVED),
        excess=radius(excess, "the least J within the limits"),
        states=radius(states, f"the states under {best}, in the norm of Q"),
    )


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
    if task.state_low is None or task.state_high is None:
        return 0.0
    room = radii[1:]
    over = np.maximum(states[1:] + room - task.state_high, task.state_low - states[1:] + room)
    return max(0.0, float(over.max()))


def within_state_limits(
    basis: ModelBasis,
    first: Limited,
    delta: float,
    asked: Asked,
    time_limit: float | None = None,
) -> tuple[Limited, Certificate]:
    """A control under which the true system keeps hard limits of its states, and its certificate.

    `first` is the best control without a margin. The bands around its states say by how much to
    move the limits inward, and those of the control within them whether that was enough; if not,
    the limits move on. If that ends nowhere, its status is "infeasible" and `missing` says by
    how much. After `time_limit` seconds the limits move no further: then it is "user_limit".
    """
    end = inf if time_limit is None else monotonic() + time_limit
    model, task, found = basis.model, first.task, first
    at, bound, radii = _certified(basis, first, delta, asked)
    missing = lacking(task, at, radii)
    for _ in range(ROUNDS):
        inward = tightened(replace(task, R=first.R), radii * (1.0 + AHEAD))
        assert inward.state_low is not None
        assert inward.state_high is not None
        if not 0.0 < missing < np.inf or np.any(inward.state_low > inward.state_high):
            break
        left = end - monotonic()
        if left <= 0.0:
            found = replace(found, status="user_limit")
            break
        horizon = Horizon(inward, model.A, model.B, model.c)
        found = horizon.solve(basis.x0, time_limit=None if time_limit is None else left)
        at, bound, own = _certified(basis, found, delta, asked)
        missing, radii = lacking(task, at, own), np.maximum(radii, own)
    if missing > ROUNDING * float(np.abs(at).max()):
        status = found.status if found.status in ("user_limit", "interrupted") else "infeasible"
        found = replace(found, status=status, missing=missing)
    return replace(found, task=task), bound


def _certified(
    basis: ModelBasis, limited: Limited, delta: float, asked: Asked
) -> tuple[Floats, Certificate, Floats]:
    """The states of the model, the certificate, and the radius of each state, (K + 1, n)."""
    at = trajectory(basis.model._Theta, basis.x0, limited.u)
    found = certificate(basis, limited.u, at, delta, asked._replace(bands=True))
    bands = found.quantities.get("bands")
    radii = found.tube[:, None] if bands is None else np.asarray(bands.radius)
    return at, found, np.broadcast_to(radii, at.shape)
