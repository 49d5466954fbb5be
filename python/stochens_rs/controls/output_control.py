"""The control for a model of outputs: from a record that happened to outputs that stay."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .._base import html, validation
from .._base.types import DELTA
from ..certificates.model_basis import ModelBasis
from ..exceptions import InputError
from ..feedback.gaining import for_outputs
from .limits import as_limits
from .model_control import model_control

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .._base.types import Floats
    from ..identification.model import Model
    from .cost import Cost
    from .limits import Limits, LimitsLike
    from .plan import Plan


Record: TypeAlias = (
    "tuple[ArrayLike, ArrayLike] | Literal['rest'] | tuple[Literal['rest'], ArrayLike, ArrayLike]"
)


class Rest(NamedTuple):
    """A rest point of a model of outputs."""

    x: Floats
    u: Floats
    # what one unit of a constant input adds to the state (n, m), and to the next output (p, m)
    states: Floats
    outputs: Floats


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


def rest_of(model: Model, target: Any, delta: float = DELTA) -> Rest:
    """Return where the model stays at ``y = target``, by least squares in the constant inputs.

    Refused where the data say that no input holds it there.
    """
    window, p = model.window, model.n_outputs
    assert window is not None
    r = np.zeros(p)
    if target is not None:
        r = validation.vector("target", target, length=p, labels=model.outputs).copy()
    x, z, u, states, outputs, off, rounding = window._core.rest(model._H, r)
    room = model.region(delta)._core.bound(z, False)
    if off > room + rounding:
        raise InputError(
            "`target` must be a point of rest: with no constant input do the outputs stay at "
            f"{html.vector(r)}; with the best one they move by {off:.3g} in a step, of which "
            f"the error of the model explains {room:.3g}"
        )
    return Rest(x, u, states, outputs)


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
    goal, weights = rest_of(model, target).x, cost_of_outputs(model, cost)
    return plan_from(model, start, goal, K, limits, weights, time_limit)


def plan_from(
    model: Model,
    start: Start,
    goal: Floats,
    K: int,
    limits: LimitsLike,
    cost: Cost,
    time_limit: float | None = None,
) -> Plan:
    """The plan from a window to another one; the weights are of states."""
    given = as_limits(limits), cost, None, time_limit
    plan = model_control(model, start.x, goal, K, "product", *given)
    return replace(plan, basis=ModelBasis(model, start.x, goal, 0.0, start.read, start.at_rest))
