"""A bound on the error of a control within limits, relative to the best one within them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from ..exceptions import InputError
from ..theory.drawn_bounds import not_simulated, radii
from .limit_certificate import HARD, SMALL
from .limited import Horizon
from .limited_errors import LimitedErrors, MovedTarget
from .plan_bound import KEY, certificate_of_laws, distances, plan_errors

if TYPE_CHECKING:
    from .._base.types import Floats, Fusion
    from ..certificates.certificate import Certificate
    from .limited import Limited
    from .provenance import Basis

FIRM = "limits: firm nonexpansiveness"
_MANY = "without a weight of the inputs more than one control is the best"


def limited_bound(
    basis: Basis,
    limited: Limited,
    predicted: Floats,
    delta: float,
    fusion: Fusion = "product",
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
                cause = _formula(basis, exact, delta, fusion, reason)
        else:
            follows = basis.xf.kind != "exact" and not task.follows
            law = LimitedErrors(errors, exact, limited, follows)
            if task.boxed:
                cause = radii(law, delta, KEY)
                reason = None if cause else not_simulated(delta, law.cost)
            name = "simulated" if cause else "uncertain map"
            cause = cause or _apart(basis, limited, predicted, exact, delta)
        x0 = np.ascontiguousarray(x0)
        state, control, excess, missed = exact.core.error(x0, limited, cause, off)
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


def _formula(basis: Basis, exact: Horizon, delta: float, fusion: Fusion, why: str) -> float:
    """A bound of the distance of `MovedTarget` that needs no simulation."""
    if fusion == "diagonal":
        raise InputError(
            "no formula bounds a control within limits of paired realizations (use "
            f"fusion='product'), and {why}"
        )
    errors = distances(basis, delta, "Frobenius")
    x0_hat, _, A_hat = (np.ascontiguousarray(estimate) for estimate in basis.estimates)
    return exact.core.moved_target(errors, A_hat, x0_hat)


def _apart(
    basis: Basis, limited: Limited, predicted: Floats, exact: Horizon, delta: float
) -> _core.Apart:
    """How far the control is from the best where the map moves with A."""
    e0, ef, eA = distances(basis, delta, "spectral")
    alpha = exact.core.along(np.ascontiguousarray(predicted), (e0, ef, eA))
    model = Horizon(limited.task, basis.estimates[2], basis.B, R=limited.R)
    n, m = basis.B.shape
    every, unit = np.arange(n), np.eye(n)
    part = _core.RegionPart(every, every, unit, unit, unit[:, :0].copy(), 1.0, unit, eA * eA)
    centre = np.hstack([basis.estimates[2], basis.B])
    region = _core.Region(centre, m, (part,), None, False)  # ||A - A^|| <= eA
    states = np.ascontiguousarray(predicted[1:])
    return model.core.apart(region, states, limited.u, alpha, limited.gap)
