"""Certificates of controls within limits for a model from data, and limits that leave room."""

from __future__ import annotations

from dataclasses import replace
from math import inf, sqrt
from time import monotonic
from typing import TYPE_CHECKING

import numpy as np

from .._base.numbers import ROUNDING
from .._base.records import trusted
from ..certificates.of_model import certificate, step_regions
from ..certificates.radius import Radius
from ..certificates.region_errors import spread, trajectory
from .limited import Horizon
from .uncertain_map import HARD, SMALL, Around, product

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..certificates.certificate import Certificate
    from ..certificates.model_basis import ModelBasis
    from ..certificates.of_model import Asked
    from ..identification.region import Region
    from .constraints import Task
    from .limited import Limited

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
    found = certificate(basis, limited.u, predicted, delta, asked)
    task, tube = limited.task, found.tube[1:]
    model = Horizon(task, basis.model.A, basis.model.B, R=limited.R)
    horizon, farthest = model.core, model.core.farthest(limited.u)
    region, control, excess, states = None, np.inf, np.inf, np.inf
    reason = found["target"].reason
    if task.state_low is not None and task.soft is None:
        reason = HARD
    elif not basis.model.doubts:
        _, regions, _ = step_regions(basis, delta, len(limited.u), asked)
        region, reason = (regions[0], reason) if regions else (None, _DIRECT)
    if region is not None and np.isfinite(tube).all():
        alpha = float(np.sqrt(horizon.weights(True) @ tube**2))
        if len(tube) == 1 and not task.soft and not basis.x0_error and not asked.noise:
            alpha = min(alpha, _weighted(region, basis, limited, predicted))
        at = np.ascontiguousarray(predicted[1:])
        by = horizon.apart(_around(basis, region), at, limited.u, alpha, limited.gap)
        control, excess, states, reason = by.control, by.excess, by.state, SMALL

    def radius(value: float, distance_from: str, method: str = MOVED) -> Radius:
        because = None if np.isfinite(value) else reason
        return trusted(Radius, value, distance_from, 1.0 - delta, method, because)

    best = "the best control within the limits"
    alone = farthest < control
    return found._with(
        control=radius(min(control, farthest), best, ALONE if alone else MOVED),
        excess=radius(excess, "the least J within the limits"),
        states=radius(states, f"the states under {best}, in the norm of Q"),
    )


def _weighted(region: Region, basis: ModelBasis, limited: Limited, predicted: Floats) -> float:
    """``||Q^1/2 D z|| <= sqrt(factor ||Q^1/2 S Q^1/2||) ||z||`` of one step, D of one part."""
    n, d = region.centre.shape
    if len(region.parts) > 1:
        return float(np.inf)
    part, (_, half) = region.parts[0], limited.task.weights()
    z = np.concatenate([basis.x0, limited.u[0], np.ones(d - n - region.m)])
    size = sqrt(part.factor * float(np.linalg.norm(half @ part.S @ half.T, 2)))
    away = float(np.linalg.norm(half @ (region.centre @ z - predicted[1])))
    return away + product(size, part.length(z))


def _around(basis: ModelBasis, region: Region) -> Around:
    """The radii of the region around the model."""
    n, m = region.n, region.m
    columns = slice(n), slice(n, n + m)
    shift_A, shift_B = (
        np.ascontiguousarray(region.centre[:, part] - X)
        for part, X in zip(columns, (basis.model.A, basis.model.B), strict=True)
    )
    # ||D' p|| <= sum over the parts of sqrt(factor p' S p) ||white||, of the columns of A and of B
    sizes = [_lengths(region, part) for part in columns]
    parts = []
    for part, of_A, of_B in zip(region.parts, *sizes, strict=True):
        S = np.zeros((n, n))
        S[np.ix_(part.rows, part.rows)] = part.S
        parts.append((float(part.factor), S, of_A, of_B))
    a, b = (
        spread(region, part) + float(np.linalg.norm(shift, 2))
        for part, shift in zip(columns, (shift_A, shift_B), strict=True)
    )
    return Around((a, b), (shift_A, shift_B), parts)


def _lengths(region: Region, columns: slice) -> list[float]:
    """``sup ||v||`` in the norm of V^-1 over ``||v||_2 = 1`` in these columns, for each part."""
    d = region.centre.shape[1]
    chosen, found = np.arange(d)[columns], []
    for part in region.parts:
        inside = np.isin(part.columns, chosen)
        seen = all(np.isfinite(part.length(e)) for e in np.eye(d)[part.columns[inside]])
        size = float(np.linalg.norm(part.white[:, inside], 2)) if inside.any() else 0.0
        found.append(size if seen else float(np.inf))
    return found


def tightened(task: Task, radii: Floats) -> Task:
    """The task with limits of ``x(k)`` moved inward by ``radii[k]``, k = 0, ..., K.

    A state within the new limits may be wrong by the radius in any direction.
    """
    if task.state_low is None or task.state_high is None:
        return task
    room = np.asarray(radii)[1:, None]
    return replace(task, state_low=task.state_low + room, state_high=task.state_high - room)


def lacking(task: Task, states: Floats, radii: Floats) -> float:
    """By how much the states (K + 1, n), each wrong by its radius, may leave the limits; or 0."""
    if task.state_low is None or task.state_high is None:
        return 0.0
    room = np.asarray(radii)[1:, None]
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

    `first` is the best control without a margin. The tube around its states says by how much to
    move the limits inward, and the tube of the control within those whether that was enough; if
    not, the limits move on. If that ends nowhere, its status is "infeasible" and `missing` says by
    how much. After `time_limit` seconds the limits move no further: then it is "user_limit".
    """
    end = inf if time_limit is None else monotonic() + time_limit
    model, task, found = basis.model, first.task, first
    at, bound = _certified(basis, first, delta, asked)
    missing, radii = lacking(task, at, bound.tube), bound.tube
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
        at, bound = _certified(basis, found, delta, asked)
        missing, radii = lacking(task, at, bound.tube), np.maximum(radii, bound.tube)
    if missing > ROUNDING * float(np.abs(at).max()):
        status = found.status if found.status in ("user_limit", "interrupted") else "infeasible"
        found = replace(found, status=status, missing=missing)
    return replace(found, task=task), bound


def _certified(
    basis: ModelBasis, limited: Limited, delta: float, asked: Asked
) -> tuple[Floats, Certificate]:
    """The states of the model and the certificate."""
    at = trajectory(basis.model._Theta, basis.x0, limited.u)
    return at, certificate(basis, limited.u, at, delta, asked)
