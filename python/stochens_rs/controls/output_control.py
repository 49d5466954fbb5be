"""The control for a model of outputs: from a record that happened to outputs that stay."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._base import html, validation
from .._base.types import DELTA
from ..certificates.model_basis import ModelBasis
from ..exceptions import InputError
from ..feedback.gaining import for_outputs
from .model_control import model_control

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification.model import Model
    from .cost import Cost
    from .limits import Limits
    from .plan import Plan


class Rest(NamedTuple):
    """A rest point of a model of outputs."""

    x: Floats
    u: Floats
    # what one unit of a constant input adds to the state (n, m), and to the next output (p, m)
    states: Floats
    outputs: Floats


def record_of(model: Model, record: Any) -> Floats:
    """Return the state of the model at the end of a record ``(outputs, inputs)``."""
    assert model.window is not None
    if not isinstance(record, tuple | list) or len(record) != 2:
        raise InputError(
            "`record` must be a pair (outputs, inputs) of rows that were measured, see "
            f"Trajectories.last_record(), got {validation.show(record)}"
        )
    return model.window.state_of(*record)


def rest_of(model: Model, target: Any, delta: float = DELTA) -> Rest:
    """Return where the model stays at ``y = target``, by least squares in the constant inputs.

    Refused where the data say that no input holds it there.
    """
    window, p, m = model.window, model.n_outputs, model.m
    assert window is not None
    r = np.zeros(p)
    if target is not None:
        r = validation.vector("target", target, length=p, labels=model.outputs).copy()
    J, H, one = model._loop.J, model._H, np.ones(int(model.intercept))

    def after(y: Floats, u: Floats) -> tuple[Floats, Floats]:
        """The state and z where outputs and inputs were always these."""
        x = window.state_of(np.tile(y, (window.fill + 1, 1)), np.tile(u, (window.fill, 1)))
        return x, J @ np.concatenate([x, u, one])

    start, z = after(r, np.zeros(m))
    moved = [after(r, unit) for unit in np.eye(m)]
    states = np.column_stack([x - start for x, _ in moved])
    per = np.column_stack([other - z for _, other in moved])
    outputs = H @ per
    u = np.asarray(np.linalg.lstsq(outputs, r - H @ z, rcond=None)[0], dtype=np.float64)
    there = z + per @ u
    off = float(np.linalg.norm(H @ there - r))
    room = model.region(delta)._core.bound(there, False)
    if off > room + 1e-12 * float(np.abs(H * there).sum()):
        raise InputError(
            "`target` must be a point of rest: with no constant input do the outputs stay at "
            f"{html.vector(r)}; with the best one they move by {off:.3g} in a step, of which "
            f"the error of the model explains {room:.3g}"
        )
    return Rest(start + states @ u, u, states, outputs)


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
    if record is None:
        raise InputError(
            f"`record` needs {model.window.fill + 1} rows of outputs and {model.window.fill} of "
            "inputs that were measured, got none: a model of outputs starts from what happened, "
            "see Trajectories.last_record()"
        )
    if limits.x is not None:
        raise InputError("`limits` of states are for models of states: give those of inputs")
    start, K = record_of(model, record), validation.size("steps", steps)
    if model.window.count > K:
        raise InputError(
            f"`steps` must be {model.window.count} at least, so that the window can be at rest in "
            f"the end, got {K}"
        )
    goal = rest_of(model, target).x
    weights = cost_of_outputs(model, cost)
    plan = model_control(model, start, goal, K, "product", limits, weights, None, time_limit)
    last = validation.frozen(np.asarray(record[0], dtype=np.float64)[-1])
    return replace(plan, basis=ModelBasis(model, start, goal, 0.0, last))
