"""The risk of a fresh unit by the units of the design, from the bounds of `theory.scenario`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .._base import gate
from ..exceptions import InputError
from ..theory import scenario
from .fleet_risk import Method, RiskBound

if TYPE_CHECKING:
    from .._base.types import Floats

# Radii (N,) or None, and the probability that one of them fails.
Radii: TypeAlias = "tuple[Floats | None, float]"


def threshold_of(misses: Floats, removed: Sequence[int]) -> float:
    """The largest miss of the units that were not left out."""
    return float(np.delete(misses, removed).max())


def design_risk(
    method: Method,
    beta: float,
    misses: Floats,
    removed: Sequence[int],
    free: int,
    widest: int | None,
    radii: Radii,
    verified: Callable[[], list[int] | None],
) -> RiskBound:
    """Bound the risk of a fresh unit, from the units of the design.

    `free` is the number of variables, `widest` the unit that R was taken from, if any; `verified`
    finds the units that alone give the command, None if they do not.
    """
    N, threshold, (radius, failing) = len(misses), threshold_of(misses, removed), radii
    if removed and method != "discarding":
        raise InputError(
            f"`method` {method!r} does not hold after units were left out: use 'discarding' or "
            "validate(new_units)"
        )
    if radius is not None and method != "compression":
        raise InputError("`radius` needs method='compression', or validate(new_units)")
    count = free + 1 + (widest is not None)  # the variables, the value, and R
    if method == "a priori":
        found = scenario.a_priori(N, count, beta)
        return RiskBound(found, beta, method, N, count, threshold)
    if method == "discarding":
        if any(misses[s] <= threshold for s in removed):
            raise InputError(
                "a unit that was left out misses no more than the threshold, so that this bound "
                "does not hold: use validate(new_units)"
            )
        found = scenario.discarding(N, len(removed), count, beta)
        return RiskBound(found, beta, method, N, count, threshold)
    support = verified()
    if support is not None and widest is not None:
        support = sorted({*support, widest})
    count = N if support is None else len(support)
    if radius is not None:
        # the unit that sets the threshold belongs to the subset
        sums = misses + radius
        top = int(np.argmax(sums))
        threshold = float(sums[top])
        count = min(N, count + (support is not None and top not in support))
    law = scenario.judged if method == "judged" else scenario.compression
    sure = support is not None
    return RiskBound(law(N, count, beta), beta, method, N, count, threshold, failing, verified=sure)


def checked_radii(radius: Any, delta: Any, size: int) -> Radii:
    """Radii (N,) and the probability that one of them fails, or (None, 0)."""
    if radius is None:
        if delta is not None:
            raise InputError("`delta` must be left out without `radius`")
        return None, 0.0
    if delta is None:
        raise InputError("`delta` must be given with `radius`: how often a radius fails")
    radii = gate.vector("radius", radius, length=size)
    if (radii < 0.0).any():
        raise InputError(f"`radius` must be >= 0, got {radii.min():.3g}")
    return radii, gate.probability("delta", delta)
