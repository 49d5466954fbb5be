"""The repr and the table of a plan: its expected end, its realizations, what limits cost."""

from __future__ import annotations

from math import hypot, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import show
from .._base.names import Labels, default_labels
from .._base.numbers import norm
from .._base.types import Floats
from ..certificates.of_model import ModelBasis
from ..exceptions import StochensError
from ..theory.exact import best_control

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from ..fusion.provenance import Basis
    from ..limits.solution import Limited
    from ..theory.records import Reachability


# Multiplications that a repr may cost, about 20 ms: n^4 for the covariance of A (n matrices n x n),
# K n^3 for the powers of A, K^2 n m for the factors of C_K.
_CHEAP = 1e7
ROUNDED = 1e-9  # shares up to here are said to be rounding


def expectation(
    reach: Reachability,
    basis: Basis | ModelBasis | None,
    end: Floats,
    steps: int,
    covariance: Callable[[], Floats],
) -> str:
    """Describe how far the model ends from its target, and the true system from xf.

    The model ends at `end`; `covariance` computes that of the true system's last state.
    """
    text = reach.text
    if isinstance(basis, ModelBasis) and basis.given:
        return "inputs given; true system: see bound()"
    if isinstance(basis, ModelBasis):
        there = _place(norm(basis.xf - end), "xf", basis.x0, basis.xf)
        return f"{text}; the model ends {there}; true system: see bound()"
    if basis is None or basis.xf.estimate is None:
        return text
    known = [one.estimate for one in (basis.x0, basis.xf) if one.estimate is not None]
    goal = "xf" if basis.xf.kind == "exact" else "the estimated xf"
    away = norm(basis.xf.estimate - end)
    exact = all(entity.kind == "exact" for entity in basis.entities)
    text += f"; {'' if exact else 'with the estimates: '}ends {_place(away, goal, *known)}"
    rms = _expected(basis, steps, covariance)
    return text if rms is None else f"{text}; true system: about {rms:.2g} from xf (rms)"


def _place(off: float, goal: str, *states: Floats) -> str:
    """``at xf`` where the distance is rounding beside the states."""
    at = off <= ROUNDED * max(map(norm, states))
    return f"at {goal}" if at else f"{off:.2g} from {goal}"


def _expected(basis: Basis, K: int, covariance: Callable[[], Floats]) -> float | None:
    """Root mean square distance from xf over the draws; exact for one step, else to order 1 / N.

    None if it is unknown or costly, or if nothing is drawn.
    """
    n, m = basis.B.shape
    kinds = {entity.kind for entity in basis.entities}
    if kinds == {"exact"} or n**4 + K * n * (n * n + K * m) > _CHEAP:
        return None
    try:
        spread = sqrt(max(0.0, float(np.trace(covariance()))))
        x0, xf, A = basis.values
        return hypot(spread, norm(best_control(A, basis.B, x0, xf, K).missed))
    except StochensError:
        return None


def made_from(info: dict[str, Any]) -> Iterator[tuple[str, object]]:
    """The realizations behind each entity, and the warnings."""
    for name in ("x0", "xf", "A"):
        one = info.get(name)
        if isinstance(one, dict) and "method" in one:
            count = one.get("size")
            size = f", {show.grouped(count)} realizations" if isinstance(count, int) else ""
            yield name, f"{one['method']}{size}"
    warnings = info.get("warnings")
    yield from (("warning", text) for text in (warnings if isinstance(warnings, tuple) else ()))


def at_limits(limited: Limited) -> str:
    """How many inputs are at a limit and at their rate, and how many states, in a few words."""
    count = int(np.count_nonzero(limited.active))
    text = f"{count or 'none'} of {limited.active.size} inputs at a limit"
    if limited.task.rate is not None:
        text += f", {np.count_nonzero(limited.rate_active) or 'none'} at their rate"
    at = limited.state_active
    if at is not None:
        text += f", {np.count_nonzero(at) or 'none'} of {at.size} states at a limit"
    return text


def least(limited: Limited) -> str:
    """How far the cost is from the least one, in a few words."""
    if limited.gap <= ROUNDED * abs(limited.objective):
        return "the least cost, to rounding"
    return f"the cost is within {show.at_most(limited.gap, 2)} of the least"


def cost_text(limited: Limited, worst: str = "") -> str:
    """What the limits cost and how many are active, in a few words.

    `worst`: the state that misses hard limits most.
    """
    text = f"J={limited.objective:.3g}"
    if limited.missed is not None and limited.missed > 0.0:
        text += f", {limited.missed:.2g} of it for the limits"
    text += f"; {at_limits(limited)}"
    if limited.missing > 0.0:
        text += f"; state limits missed by {limited.missing:.3g}{worst and f' ({worst} most)'}"
    return text + (f"; {alone(limited)}" if limited.closed else "")


def alone(limited: Limited) -> str:
    """From where the plan must be followed, and what its inputs cost alone, in a few words."""
    return (
        f"follow with `feedback` from step {limited.open_until} on, inputs alone "
        f"J={limited.open_objective:.3g}"
    )


def worst_state(limited: Limited, states: Floats, labels: Labels | None) -> str:
    """The state that is farthest beyond its hard limits, in words; "" if none is."""
    task = limited.task
    if task.state_low is None or task.state_high is None or not limited.missing:
        return ""
    over = np.maximum(states[1:] - task.state_high, task.state_low - states[1:]).max(axis=0)
    named = labels or default_labels(states.shape[1], task.low.shape[1])
    return named.state(int(np.argmax(over))) if over.max() > 0.0 else ""


def cost_rows(limited: Limited) -> Iterator[tuple[str, object]]:
    """The same as rows of a table."""
    yield "objective J(u)", limited.objective
    yield "of it for the limits", limited.missed
    yield "solved", least(limited)
    low, high = (int(np.count_nonzero(limited.active == side)) for side in (-1, 1))
    yield "inputs at a limit", f"{low} at the lower, {high} at the upper, of {limited.active.size}"
    if limited.task.rate is not None:
        fall, rise = (int(np.count_nonzero(limited.rate_active == side)) for side in (-1, 1))
        yield "inputs at their rate", f"{fall} falling, {rise} rising, of {limited.active.size}"
    at = limited.state_active
    if at is not None:
        low, high = (int(np.count_nonzero(at == side)) for side in (-1, 1))
        yield "states at a limit", f"{low} at the lower, {high} at the upper, of {at.size}"
    if limited.missing > 0.0:
        yield "state limits missed by", limited.missing
    if limited.closed:
        yield "unstable", alone(limited)
