"""The control for a model of outputs: from a record that happened to outputs that stay."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .._base import html, validation
from .._base.types import DELTA
from .._base.weights import weight
from ..certificates.model_basis import ModelBasis
from ..exceptions import InputError
from ..feedback.gaining import for_outputs
from .constraints import sides
from .limits import as_limits
from .model_control import model_control
from .resting import rest_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .._base.types import Floats
    from ..identification.model import Model
    from .cost import Cost
    from .limits import Limits, LimitsLike
    from .plan import Plan
    from .resting import Rest


Record: TypeAlias = (
    "tuple[ArrayLike, ArrayLike] | Literal['rest'] | tuple[Literal['rest'], ArrayLike, ArrayLike]"
)


class Start(NamedTuple):
    """Where a record ends: the state, the last readings, and whether rest was declared."""

    x: Floats
    read: Floats
    at_rest: bool


def start_of(model: Model, record: Any) -> Start:
    """Return where a record of the arguments of `control` ends.

    Rest is refused where the data say that the model does not stay there.
    """
    window, p, m = model.window, model.n_outputs, model.m
    assert window is not None
    if record is None:
        raise InputError(
            f"`record` needs {window.fill + 1} rows of outputs and {window.fill} of inputs that "
            "were measured, got none: a model of outputs starts from what happened, see "
            "Trajectories.last_record()"
        )
    if isinstance(record, str):
        record = (record, np.zeros(p), np.zeros(m))
    if not isinstance(record, tuple | list) or len(record) not in (2, 3):
        raise InputError(
            "`record` must be a pair (outputs, inputs) of rows that were measured, see "
            'Trajectories.last_record(), or "rest" or ("rest", outputs, inputs), got '
            f"{validation.show(record)}"
        )
    if len(record) == 2:
        x = window.state_of(*record)
        read = np.asarray(record[0], dtype=np.float64)[-1]
        return Start(x, validation.frozen(read), False)
    validation.choice("record", record[0], ("rest",))
    y = validation.vector("record", record[1], length=p, labels=model.outputs).copy()
    u = validation.vector("record", record[2], length=m, labels=model.input_names).copy()
    x, z, _, _, _, off, rounding = window._core.rest(model._H, y, u)
    room = model.region(DELTA)._core.bound(z, False)
    if off > room + rounding:
        raise InputError(
            f"`record` must be of a plant at rest: at the outputs {html.vector(y)} under the "
            f"inputs {html.vector(u)} the model moves by {off:.3g} in a step, of which its error "
            f"explains {room:.3g}"
        )
    return Start(x, validation.frozen(y), True)


def cost_of_outputs(model: Model, cost: Cost) -> Cost:
    """The cost with weights of outputs as weights of states."""
    return replace(cost, Q=_weight(model, cost.Q), Qf=_weight(model, cost.Qf))


def _weight(model: Model, value: Any) -> Any:
    return None if value is None or np.ndim(value) == 0 else for_outputs(model, value)


def output_control(
    model: Model,
    record: Any,
    target: Any,
    steps: int,
    limits: Limits,
    cost: Cost,
    time_limit: float | None,
) -> Plan:
    """Compute the control for a model of outputs; the arguments are those of `control`."""
    assert model.window is not None
    if limits.x is not None:
        raise InputError("`limits` of states are for models of states: give those of inputs")
    start, K = start_of(model, record), validation.size("steps", steps)
    if model.window.count > K:
        raise InputError(
            f"`steps` must be {model.window.count} at least, so that the window can be at rest in "
            f"the end, got {K}"
        )
    weights = cost_of_outputs(model, cost)
    low, high = (side[-1] for side in sides("limits", limits.u, K, model.labels))
    rest = rest_of(model, target, output_weights(model, weights), low, high)
    return plan_from(model, start, rest, K, limits, weights, time_limit)


def output_weights(model: Model, cost: Cost) -> Floats | None:
    """The weights of the outputs now, or of their first filters, (p, p), if there are any."""
    p, found = model.n_outputs, cost.Q if cost.Q is not None else cost.Qf
    if found is None:
        return None
    return np.ascontiguousarray(weight("Q", found, model.n)[:p, :p])


def plan_from(
    model: Model,
    start: Start,
    rest: Rest,
    K: int,
    limits: LimitsLike,
    cost: Cost,
    time_limit: float | None = None,
) -> Plan:
    """The plan from a window to one at rest; weights of states, and of inputs from those there."""
    given = as_limits(limits), cost, time_limit
    plan = model_control(model, start.x, rest.x, K, "product", *given, resting=rest.u)
    return replace(plan, basis=ModelBasis(model, start.x, rest.x, 0.0, start.read, start.at_rest))
