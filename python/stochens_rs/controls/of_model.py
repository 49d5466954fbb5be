"""Controls of models from data, of states and of readings, and what given inputs do."""

from __future__ import annotations

from dataclasses import replace
from time import monotonic
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .._base import show, validation
from .._base.names import weight
from .._base.numbers import ROUNDING
from .._base.records import trusted
from .._base.types import DELTA
from ..certificates.of_model import Asked, ModelBasis, trajectory
from ..ensembles.ensemble import Ensemble
from ..ensembles.law import Counts
from ..exceptions import InputError, InputTypeError, NonFiniteError
from ..feedback.loop import for_outputs
from ..fusion.fits import Fit
from ..identification.identified import Identified
from ..identification.model import Model
from ..limits.limits import Uncertain, as_limits
from ..limits.problem import checked_task, seconds, sides
from ..limits.solution import Horizon
from ..theory.exact import best_control
from .arguments import ending, fusion_over, step_warnings
from .bounds import within_state_limits
from .plan import Plan
from .rest import rest_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .._base.types import Floats
    from ..limits.limits import Cost, Limits, LimitsLike
    from .rest import Rest


BEYOND = 2.0  # times the largest value in the data from which a plan gets a warning


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
            basis, plain = trusted(ModelBasis, model, start, goal, off), Asked(noise=False)
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
    x, z, _, _, _, off, rounding = window.core.rest(model._H, y, u)
    room = model.region(DELTA)._core.bound(z, False)
    if off > room + rounding:
        raise InputError(
            f"`record` must be of a plant at rest: at the outputs {show.vector(y)} under the "
            f"inputs {show.vector(u)} the model moves by {off:.3g} in a step, of which its error "
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


def predict(
    model: Identified,
    x0: ArrayLike | Uncertain | None = None,
    inputs: ArrayLike | None = None,
    *,
    record: Record | None = None,
) -> Plan:
    """Predict the states, or readings, under given inputs, as those of a run that was kept apart.

    Parameters
    ----------
    model : Model or another model from data
        The model, with its regions.
    x0 : array_like, shape (n,), or Uncertain
        The initial state; for a model of states only.
    inputs : array_like, shape (K, m)
        The inputs, one row per step; required. They may be chosen after the data of the model, and
        those of a run that was kept apart may come from a feedback.
    record : (outputs, inputs)
        For a model of outputs, in place of x0: what was read before the first of `inputs`, as for
        `control`. `Regressors.stretches` cuts runs that were kept apart.

    Returns
    -------
    Plan
        With these inputs as its control, and as its target where the model ends; of outputs the
        predicted ones, at each step. `Plan.bound` has the tube that contains the true states, or
        the readings, `Plan.plot` draws it.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used, or the predicted states overflow.

    Notes
    -----
    The tube holds for all inputs at once, also for those that react to what is read, as the noise
    of each step is independent of what was before it. The run must have no part in the model.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> z = np.random.default_rng(1).standard_normal((40, 3))
    >>> x_next = 0.5 * z[:, :1] + z[:, 1:2] + 0.01 * z[:, 2:]
    >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], x_next)
    >>> model = se.identify(data, noise=0.01)
    >>> plan = se.predict(model, [1.0], [[0.0], [1.0]])
    >>> plan.predicted_states.round(1).ravel()
    array([1. , 0.5, 1.3])
    >>> plan.bound().state < 0.03
    True
    """
    if not isinstance(model, Identified):
        raise InputTypeError(f"`model` must be a model from data, got {validation.show(model)}")
    (n, m), known = model.B.shape, _start(model, x0, record)
    start = known["x0"]
    u = validation.inputs("inputs", inputs, cols=m, empty=False, labels=model.input_names).copy()
    path = trajectory(model._Theta, start, u)
    if not np.isfinite(path).all():
        raise NonFiniteError("the predicted states overflow: give fewer or smaller `inputs`")
    drift = trajectory(model._Theta, np.zeros(n), np.zeros_like(u))[-1]
    best = best_control(model.A, model.B, start, path[-1] - drift, len(u))
    exact = {"method": "exact", "size": None}
    info = {
        "x0": exact,
        "xf": exact,
        "A": {"method": "from data", "size": None},
        "warnings": (*beyond_data(model, path, u), *model.warnings),
    }
    basis = ModelBasis(model, xf=path[-1].copy(), given=True, **known)
    reachability = best.reachability()
    names: Any = {"labels": model.labels, "dt": model.dt}
    return Plan(u, path, reachability, "product", "completed", info, basis, **names)


def _start(model: Identified, x0: Any, record: Any) -> dict[str, Any]:
    """What a plan keeps of where it starts."""
    if isinstance(model, Model) and model.window is not None:
        if x0 is not None:
            raise InputError(
                "`x0` must be left out for a model of outputs: it starts from `record`"
            )
        start = start_of(model, record)
        return {"x0": start.x, "read": start.read, "at_rest": start.at_rest}
    if record is not None:
        raise InputError("`record` must be left out: it is for models of outputs")
    if x0 is None:
        raise InputError("`x0` must be the initial state, got None")
    off, given = (x0.radius, x0.values) if isinstance(x0, Uncertain) else (0.0, x0)
    x = validation.vector("x0", given, length=len(model.A), labels=model.state_names).copy()
    return {"x0": x, "x0_error": off}
