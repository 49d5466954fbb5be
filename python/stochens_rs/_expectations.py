"""Where a plan is expected to end, for the line that shows it: by its model, and by the law."""

from __future__ import annotations

from math import hypot, sqrt
from typing import TYPE_CHECKING

import numpy as np

from ._alse import norm
from ._exact import one_step
from .exceptions import StochensError
from .results import Plan, reach_text

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .trajectory_plans import TrajectoryPlan

# operations that a line of text may cost: some 20 ms
_CHEAP = 1e7


def expectation(plan: Plan | TrajectoryPlan) -> str:
    """Describe how far the model is from reaching its target, and the system from the true one."""
    basis = plan._basis
    if basis is None or basis.xf.estimate is None:
        return reach_text(plan.reachability)
    ends = plan.predicted_state if isinstance(plan, Plan) else plan.predicted_states[-1]
    exact = all(entity.kind == "exact" for entity in basis.entities)
    text = (
        f"{reach_text(plan.reachability)}; {'' if exact else 'with the estimates: '}ends "
        f"{norm(basis.xf.estimate - ends):.2g} from "
        f"{'' if basis.xf.kind == 'exact' else 'the estimated '}xf"
    )
    rms = _expected(plan)
    return text if rms is None else f"{text}; true system: about {rms:.2g} from xf (rms)"


def _expected(plan: Plan | TrajectoryPlan) -> float | None:
    """Root mean square distance from xf over the draws; None unknown, without draws, or costly.

    Exact over one step, to leading order in 1 / N over several.
    """
    basis = plan._basis
    assert basis is not None
    kinds = {entity.kind for entity in basis.entities}
    (n, m), K = basis.B.shape, 1 if isinstance(plan, Plan) else plan.steps
    if kinds == {"exact"} or n**4 + K * n * (n * n + K * m) > _CHEAP:
        return None
    try:
        C: NDArray[np.float64] = plan.covariance()
        if isinstance(plan, Plan):
            x0, xf, A = (entity.values for entity in basis.entities)
            assert x0 is not None
            assert xf is not None
            assert A is not None
            missed = norm(one_step(A, basis.B, x0, xf).missed)
            return hypot(sqrt(max(0.0, float(np.trace(basis.B @ C @ basis.B.T)))), missed)
        return sqrt(max(0.0, float(np.trace(C))))
    except StochensError:
        return None
