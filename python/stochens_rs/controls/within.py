"""What a plan says about its limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._base.labels import Labels, default_labels
from .._base.numbers import norm
from ..theory.dynamics import states
from ..theory.exact import EPS
from ..theory.records import PlanError
from .limited import Horizon

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

    from .._base.types import Floats
    from .limited import Limited


class Within:
    """The properties of a `Plan` within limits; None where it has neither limits nor weights."""

    limited: Limited | None

    @property
    def active(self) -> NDArray[np.int8] | None:
        """-1 where an input is at its lower limit, 1 at the upper one, else 0; (K, m)."""
        return None if self.limited is None else self.limited.active

    @property
    def rate_active(self) -> NDArray[np.int8] | None:
        """1 where an input rises by its rate to rounding, -1 where it falls by it, else 0; (K, m).

        Row k is of the change ``u(k) - u(k-1)``.
        """
        return None if self.limited is None else self.limited.rate_active

    @property
    def state_active(self) -> NDArray[np.int8] | None:
        """-1 where a state is at its lower limit or beyond, 1 at the upper one, else 0; (K, n).

        Of ``x(1), ..., x(K)``, to rounding; None without limits of states.
        """
        return None if self.limited is None else self.limited.state_active

    @property
    def multipliers(self) -> Floats | None:
        """By how much J falls per unit of each limit of an input, >= 0; (K, m)."""
        return None if self.limited is None else self.limited.multipliers

    @property
    def gap(self) -> float | None:
        """``J(u) - min J`` is at most this."""
        return None if self.limited is None else self.limited.gap

    @property
    def objective(self) -> float | None:
        """``J(u)``."""
        return None if self.limited is None else self.limited.objective

    @property
    def missed(self) -> float | None:
        """What the limits cost: ``J(u)`` less the least J without limits; nan if time was out."""
        return None if self.limited is None else self.limited.missed

    @property
    def limits_active(self) -> bool | None:
        """Whether an input is at a limit or changes by its rate, or a state is at a limit."""
        return None if self.limited is None else self.limited.limits_active


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


def cost_text(limited: Limited, worst: str = "") -> str:
    """What the limits cost and how many are active, in a few words.

    `worst`: the state that misses hard limits most.
    """
    text = f"J={limited.objective:.3g}"
    if limited.missed > 0.0:
        text += f", {limited.missed:.2g} of it for the limits"
    text += f"; {at_limits(limited)}"
    if limited.status == "infeasible":
        text += f"; state limits missed by {limited.missing:.3g}{worst and f' ({worst} most)'}"
    return text


def worst_state(limited: Limited, states: Floats, labels: Labels | None) -> str:
    """The state that is farthest beyond its hard limits, in words; "" if none is."""
    task = limited.task
    if task.state_low is None or task.state_high is None or limited.status != "infeasible":
        return ""
    over = np.maximum(states[1:] - task.state_high, task.state_low - states[1:]).max(axis=0)
    named = labels or default_labels(states.shape[1], task.low.shape[1])
    return named.state(int(np.argmax(over))) if over.max() > 0.0 else ""


def cost_rows(limited: Limited) -> Iterator[tuple[str, object]]:
    """The same as rows of a table."""
    yield "objective J(u)", limited.objective
    yield "of it for the limits", limited.missed
    yield "off the least J by", f"{limited.gap:.2g} at most"
    low, high = (int(np.count_nonzero(limited.active == side)) for side in (-1, 1))
    yield "inputs at a limit", f"{low} at the lower, {high} at the upper, of {limited.active.size}"
    if limited.task.rate is not None:
        fall, rise = (int(np.count_nonzero(limited.rate_active == side)) for side in (-1, 1))
        yield "inputs at their rate", f"{fall} falling, {rise} rising, of {limited.active.size}"
    at = limited.state_active
    if at is not None:
        low, high = (int(np.count_nonzero(at == side)) for side in (-1, 1))
        yield "states at a limit", f"{low} at the lower, {high} at the upper, of {at.size}"
    if limited.status == "infeasible":
        yield "state limits missed by", limited.missing


def limited_error(
    limited: Limited, A: Floats, B: Floats, x0: Floats, xf: ArrayLike | None, u: Floats
) -> PlanError:
    """Compare `u` with the best control of an exact system within the same limits."""
    horizon = Horizon(limited.exact(xf), A, B)
    best = horizon.solve(x0)
    wrong = u - best.u
    reached = states(A, B, x0, best.u)[-1]
    target = horizon.task.reference[-1]
    control, state = norm(wrong), norm(states(A, B, 0.0 * x0, wrong)[-1])
    size, length = norm(best.u), norm(reached)
    where = "x_actual" if length else "x0"
    length = length or norm(x0)
    if not length:
        where = "nothing"
    off_control, off_state = horizon.in_two_norm(best.distance)
    pushed = norm(horizon.pushes)
    return PlanError(
        control=control,
        control_relative=_ratio(control, size),
        state=state,
        state_relative=_ratio(state, length),
        residual=norm(target - reached),
        control_rounding=off_control + EPS * (size + control),
        state_rounding=off_state + (u.size + len(x0)) * EPS * pushed * (size + control),
        control_relative_to="v" if size else "nothing",
        state_relative_to=where,
        objective=horizon.objective(x0, u) - best.objective,
    )


def _ratio(value: float, size: float) -> float:
    return value / size if size else np.inf if value else 0.0
