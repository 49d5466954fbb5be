"""The error of a plan within limits against the best control of an exact system."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._base.numbers import norm
from ..theory.dynamics import states
from ..theory.exact import EPS
from ..theory.records import PlanError
from .limited import Horizon

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .._base.types import Floats
    from .limited import Limited


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
