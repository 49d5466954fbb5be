"""The risk of a fresh unit by the units of the design, from the bounds of `theory.scenario`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from .._base import validation
from ..exceptions import InputError
from ..theory import scenario
from .fleet_risk import Method, RiskBound
from .plan_validation import needed, rank_of

if TYPE_CHECKING:
    from .._base.types import Floats, Status

# Radii (N,) or None, and the probability that one of them fails.
Radii: TypeAlias = "tuple[Floats | None, float]"


def threshold_of(misses: Floats, removed: Sequence[int]) -> float:
    """The largest miss of the units that were not left out."""
    return float(np.delete(misses, removed).max())


class Made(NamedTuple):
    """What a bound of the risk takes of a plan; `variables` of the convex problem.

    `misses` are infinite where limits of states were left.
    """

    misses: Floats
    removed: Sequence[int]
    discard: int
    support: int
    variables: int
    status: Status


def design_risk(method: Method, beta: float, plan: Made, radii: Radii) -> RiskBound:
    """Bound the risk of a fresh unit, from the units of the design."""
    N, (radius, failing) = len(plan.misses), radii
    threshold = threshold_of(plan.misses, plan.removed)
    if threshold == np.inf:
        raise InputError(
            "units of the design leave the limits of states, so that no bound follows from them: "
            "use validate(new_units)"
        )
    if method == "compression":
        if radius is not None:
            threshold = threshold_of(plan.misses + radius, plan.removed)
        count = plan.support
        found = scenario.compression(N, count, beta, violations=plan.discard)
        return RiskBound(found, beta, method, N, count, threshold, failing)
    if plan.status != "optimal":
        raise InputError(
            f"`method` {method!r} needs an optimal plan, this one is {plan.status!r}: use "
            "'compression', or validate(new_units)"
        )
    if radius is not None:
        raise InputError("`radius` needs method='compression', or validate(new_units)")
    count = plan.variables
    if method == "discarding":
        if any(plan.misses[s] <= threshold for s in plan.removed):
            raise InputError(
                "a unit that was left out misses no more than the threshold, so that this bound "
                "does not hold: use 'compression', or validate(new_units)"
            )
        found = scenario.discarding(N, len(plan.removed), count, beta)
        return RiskBound(found, beta, method, N, count, threshold)
    if plan.discard:
        raise InputError(
            f"`method` {method!r} does not hold after units were left out: use 'compression', "
            "'discarding' or validate(new_units)"
        )
    return RiskBound(scenario.a_priori(N, count, beta), beta, method, N, count, threshold)


def quantile(scores: Floats, epsilon: float, beta: float) -> tuple[float, int]:
    """The miss that at most the share `epsilon` of all units exceeds, and how many of these do."""
    size, rank = len(scores), rank_of(len(scores), epsilon, beta)
    if rank > size:
        raise InputError(
            f"`epsilon` {epsilon:g} with `beta` {beta:g} needs {needed(epsilon, beta)} fresh units "
            f"at least, got {size}"
        )
    limit = float(np.partition(scores, rank - 1)[rank - 1])
    if limit == np.inf:
        raise InputError(
            f"`epsilon` {epsilon:g} allows for {size - rank} of these units: more of them leave "
            "their limits of states"
        )
    return limit, size - rank


def checked_radii(radius: Any, delta: Any, size: int) -> Radii:
    """Radii (N,) and the probability that one of them fails, or (None, 0)."""
    if radius is None:
        if delta is not None:
            raise InputError("`delta` must be left out without `radius`")
        return None, 0.0
    if delta is None:
        raise InputError("`delta` must be given with `radius`: how often a radius fails")
    radii = validation.vector("radius", radius, length=size)
    if (radii < 0.0).any():
        raise InputError(f"`radius` must be >= 0, got {radii.min():.3g}")
    return radii, validation.probability("delta", delta)
