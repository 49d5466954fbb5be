"""The control for a model from data: the smallest one, or that of the smallest certificate."""

from __future__ import annotations

from dataclasses import replace
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import validation
from .._base.numbers import ROUNDING
from .._base.records import trusted
from ..certificates.model_basis import ModelBasis
from ..certificates.of_model import Asked
from ..certificates.region_errors import trajectory
from ..ensembles.counts import Counts
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputError, InputTypeError
from ..fusion.fits import Fit
from ..theory.exact import best_control
from .arguments import ending, fusion_over, step_warnings
from .constraints import checked_task, seconds
from .limit_certificate import within_state_limits
from .limited import Horizon
from .plan import Plan
from .uncertain import Uncertain

BEYOND = 2.0  # times the largest value in the data from which a plan gets a warning

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification.identified import Identified
    from .cost import Cost
    from .limits import Limits


def model_control(
    model: Identified,
    x0: Any,
    xf: Any,
    steps: int,
    fusion: str,
    limits: Limits,
    cost: Cost,
    time_limit: float | None,
    resting: Floats | None = None,
) -> Plan:
    """Compute the control for a model; the arguments are those of `control`.

    Inputs cost what they differ from `resting`, those that hold the target; default 0.
    """
    n, m = model.B.shape
    labels = model.labels
    off = x0.radius if isinstance(x0, Uncertain) else 0.0
    start = _exact("x0", x0.values if isinstance(x0, Uncertain) else x0, labels.states)
    goal = _exact("xf", ending(cost.reference, xf, labels.states), labels.states)
    K, how = fusion_over(steps, fusion, n, m)
    if how != "product":
        raise InputError("`fusion` must be 'product' for a model from data, got 'diagonal'")
    task = checked_task(n, m, K, goal, limits, cost, labels)
    if task is not None and resting is not None and resting.any():
        task = replace(task, resting=resting)
    time = seconds(time_limit, task)
    # what the offset alone adds over K steps
    drift = trajectory(model._Theta, np.zeros(n), np.zeros((K, m)))[-1]
    found = best_control(model.A, model.B, start, goal - drift, K)
    u, limited = found.u.reshape(K, m), None
    if task is not None:
        end = None if time is None else monotonic() + time
        limited = Horizon(task, model.A, model.B, model.c).solve(start, time_limit=time)
        if task.state_low is not None and task.soft is None:
            basis, plain = trusted(ModelBasis, model, start, goal, off), Asked(False, False, False)
            left = None if end is None else end - monotonic()
            limited, _ = within_state_limits(basis, limited, model._delta, plain, left)
        u = limited.u
    else:
        # what acts by rounding alone is 0: the data may say nothing of such an input
        effect = np.abs(u) * np.linalg.norm(model.B, axis=0)
        u = np.where(effect > ROUNDING * effect.max(), u, 0.0)
    reachability = found.reachability()
    exact = {"method": "exact", "size": None}
    info: dict[str, Any] = {"x0": exact, "xf": exact, "A": {"method": "from data", "size": None}}
    info["singular_values"] = found.factors.singular_values
    predicted = trajectory(model._Theta, start, u)
    if limited is not None and limited.closed and limited.states is not None:
        predicted = np.vstack([start, limited.states])
    info["warnings"] = (
        *beyond_data(model, predicted, u),
        *model.warnings,
        *step_warnings(found, exact=False),
    )
    return trusted(
        Plan,
        u=u,
        predicted_states=predicted,
        reachability=reachability,
        fusion=how,
        status="completed" if limited is None else limited.status,
        info=info,
        basis=trusted(ModelBasis, model, start, goal, off),
        limited=limited,
        labels=labels,
        dt=model.dt,
    )


def beyond_data(model: Identified, states: Floats, u: Floats) -> tuple[str, ...]:
    """A warning if the plan leaves what was measured, where a plant need not be linear."""
    seen = model._largest
    if seen is None:
        return ()
    names = (*model.state_names, *model.input_names)
    planned = np.hstack([np.abs(states[:-1]).max(axis=0), np.abs(u).max(axis=0)])
    times = np.divide(planned, seen, out=np.zeros_like(planned), where=seen > 0.0)
    most = int(np.argmax(times))
    if times[most] <= BEYOND:
        return ()
    return (
        f"the plan takes {names[most]} to {planned[most]:.3g}, {times[most]:.2g} times the largest "
        "in the data: the certificate holds if the plant is linear there, too",
    )


def _exact(name: str, value: Any, names: tuple[str, ...]) -> Floats:
    if isinstance(value, Fit | Ensemble | Counts):
        mean = "its mean()" if isinstance(value, Ensemble) else "its estimate"
        rest = " or the exact target"
        if name == "x0":
            rest = ", in Uncertain(.., radius) if x0 may be that far from it"
        raise InputTypeError(
            f"`{name}` must be an array with a model from data, got "
            f"{validation.article(type(value))}: pass {mean}{rest}"
        )
    return validation.vector(name, value, length=len(names), labels=names).copy()
