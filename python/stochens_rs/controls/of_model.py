"""Controls of models from data, of states and of readings, and what given inputs do."""

from __future__ import annotations

from dataclasses import replace
from time import monotonic
from typing import Any, Literal, NamedTuple, TypeAlias, TypeGuard

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.names import Labels
from .._base.records import trusted
from .._base.types import DELTA, ROUNDING, ArrayLike, Floats
from ..certificates.of_model import ModelBasis, trajectory
from ..exceptions import InputError, InputTypeError, NonFiniteError
from ..feedback.loop import for_outputs
from ..identification.identified import Identified
from ..identification.model import Model
from ..limits.limits import Cost, LimitsLike, Uncertain, as_limits
from ..limits.problem import (
    Horizon,
    Limited,
    Task,
    checked_task,
    forecast_of,
    inputs_within,
    read_task,
    seconds,
)
from ..theory import exact
from .bounds import within_state_limits
from .plan import Plan
from .set_point import Aim, in_window, or_zero, set_point, targets, way_of, weights_of

BEYOND = 2.0  # times the largest value in the data from which a plan gets a warning


def of_outputs(
    system: object, states: dict[str, Any], readings: dict[str, Any]
) -> TypeGuard[Model]:
    """Whether it is a model of outputs; refuses the arguments that are for the other kind."""
    outputs = isinstance(system, Model) and system.window is not None
    for name, value in (states if outputs else readings).items():
        if value is not None:
            why = ": it is for models of outputs"
            if outputs:
                why = " for a model of outputs: it starts from `record`, and goes to `target`"
            raise InputError(f"`{name}` must be left out{why}")
    if not outputs and states["x0"] is None:
        raise InputError("`x0` must be the initial state, got None")
    return outputs


def ending(reference: Any, xf: Any, names: tuple[str, ...]) -> Any:
    """The target: xf, or the last row of a reference."""
    if reference is None and xf is None:
        raise InputError("`xf` must be given without `reference`")
    if reference is None:
        return xf
    if xf is not None:
        raise InputError("`xf` must be None with `reference`, whose last row takes its place")
    return validation.matrix("reference", reference, cols=len(names), labels=names)[-1]


def basis_in_states(model: Identified, x0: Any, xf: Any) -> ModelBasis:
    """What a plan for a model of states keeps of its arguments."""
    radius, values = (x0.radius, x0.values) if isinstance(x0, Uncertain) else (0.0, x0)
    names = model.labels.states
    start = validation.vector("x0", values, length=len(names), labels=names).copy()
    goal = validation.vector("xf", xf, length=len(names), labels=names).copy()
    return trusted(ModelBasis, model, start, goal, radius)


class Wanted(NamedTuple):
    """Arguments of `control` for a model."""

    steps: Any
    limits: LimitsLike
    cost: Cost
    time_limit: float | None = None


def model_control(
    basis: ModelBasis,
    wanted: Wanted,
    resting: Floats | None = None,
    way: Floats | None = None,
) -> Plan:
    """Compute the control for a model.

    Inputs cost what they differ from `resting`, those that hold the target; default 0. The first
    states are to follow `way`, (K, p).
    """
    model, started = basis.model, monotonic()
    n, m = model.B.shape
    K = exact.checked_steps(wanted.steps, n, m)
    task, system, x0 = task_of(model, K, basis.xf, wanted.limits, wanted.cost)
    if task is not None and resting is not None and resting.any():
        task = replace(task, resting=resting)
    if task is not None and way is not None:
        reference = task.reference.copy()
        reference[:, : way.shape[1]] = way
        task = replace(task, reference=reference, follows=True)
    time = seconds(wanted.time_limit, task)
    found, limited = _best(basis, K), None
    if task is None:
        u = found.u.reshape(K, m)
        # what acts by rounding alone is 0: the data may say nothing of such an input
        effect = np.abs(u) * np.linalg.norm(model.B, axis=0)
        u = np.where(effect > ROUNDING * effect.max(), u, 0.0)
    else:
        x0[:n] = basis.x0
        limited = Horizon(task, *system).solve(x0, time_limit=time)
        if task.state_low is not None and task.soft is None:
            left = None if time is None else time - (monotonic() - started)
            limited, _ = within_state_limits(basis, limited, model.level, left)
        u = limited.u
    path = trajectory(model.Theta, basis.x0, u)
    if limited is not None and limited.states is not None:
        path = np.vstack([basis.x0, limited.states[:, :n]])
    # a window is led only as far as its outputs are asked for
    further = () if basis.window is not None else step_warnings(found, sure=False)
    return _planned(basis, u, path, found, limited, further)


def task_of(
    model: Identified, K: int, xf: Floats, limits: LimitsLike, cost: Cost
) -> tuple[Task | None, tuple[Floats, Floats, Floats | None], Floats]:
    """What is asked of a model, the system it is asked of, and a state of this one.

    Of a model of outputs with limits of readings that is ``(x, y)``, x the window, so that they are
    limits of states: ``y(t+1) = Theta J (x, u, 1)``.
    """
    within, (n, m) = as_limits(limits), model.B.shape
    system: Any = model.A, model.B, model.c
    if not isinstance(model, Model) or model.window is None or within.x is None:
        return checked_task(n, m, K, xf, within, cost, model.labels), system, np.zeros(n)
    p = model.n_outputs
    if within.soft is False:
        raise InputError(
            "`soft` must not be False for a model of outputs, as noise leads beyond any limit: "
            "give a weight, or leave it out; regulate(keep=) keeps hard ones with a probability"
        )
    names = Labels(model.outputs, model.input_names)
    own: Any = read_task(p, m, K, np.zeros(p), within, Cost(Q=weights_of(model, cost)), names)
    task = read_task(n, m, K, xf, replace(within, x=None, soft=None), cost, model.labels)
    free = np.full((K, n), np.inf)
    ahead = model.coefficients @ model.loop.J
    task = replace(
        task,
        stage=np.pad(task.stage, (0, p)),
        terminal=np.pad(task.terminal, (0, p)),
        reference=np.pad(task.reference, [(0, 0), (0, p)]),
        state_low=np.hstack([-free, own.state_low]),
        state_high=np.hstack([free, own.state_high]),
        soft=own.soft,
    )
    c = None if model.c is None else np.hstack([model.c, ahead[:, n + m]])
    A = np.pad(np.vstack([model.A, ahead[:, :n]]), [(0, 0), (0, p)])
    B = np.vstack([model.B, ahead[:, n : n + m]])
    return task, (np.ascontiguousarray(A), np.ascontiguousarray(B), c), np.zeros(n + p)


def _best(basis: ModelBasis, K: int) -> exact.Best:
    """The best control without limits; ``xf`` less what the offset alone adds over K steps."""
    model, goal = basis.model, basis.xf
    if model.c is not None:
        zeros = np.zeros((K, model.B.shape[1]))
        goal = goal - trajectory(model.Theta, 0.0 * goal, zeros)[-1]
    return exact.best_control(model.A, model.B, basis.x0, goal, K)


def _planned(
    basis: ModelBasis,
    u: Floats,
    path: Floats,
    found: exact.Best,
    limited: Limited | None = None,
    further: tuple[str, ...] = (),
) -> Plan:
    """The plan of these inputs, which lead the model along `path`.

    It has a warning if it leaves what was measured, where a plant need not be linear.
    """
    model = basis.model
    beyond: tuple[str, ...] = ()
    if (seen := model.largest) is not None:
        size = np.hstack([np.abs(path[:-1]).max(axis=0), np.abs(u).max(axis=0)])
        times = np.divide(size, seen, out=np.zeros_like(size), where=seen > 0.0)
        most = int(np.argmax(times))
        if times[most] > BEYOND:
            name = (*model.state_names, *model.input_names)[most]
            beyond = (
                f"the plan takes {name} to {size[most]:.3g}, {times[most]:.2g} times the largest "
                "in the data: the certificate holds if the plant is linear there, too",
            )
    given = {"method": "exact", "size": None}
    info: dict[str, Any] = {"x0": given, "xf": given, "A": {"method": "from data", "size": None}}
    info["warnings"] = (*beyond, *model.warnings, *further)
    info["singular_values"] = found.factors.singular_values
    status = "completed" if limited is None else limited.status
    about = "product", status, info, basis, limited, model.labels, model.dt
    return trusted(Plan, u, path, found.reachability(), *about)  # type: ignore[arg-type]


def step_warnings(found: exact.Best, *, sure: bool) -> tuple[str, ...]:
    """Warnings about an estimated C_K; for one step it is B, which is exact.

    C_K has the rank of C_n for K > n (Cayley and Hamilton); rounding hides it where A grows.
    """
    (n, m), K, rank = found.B.shape, found.steps, len(found.factors.s)
    if rank < n < K:
        C = exact.controllability(exact.matrix_powers(found.A, n - 1), found.B)
        rank = max(rank, len(exact.factors(C).s))
    if rank < n and K > 1:
        return (
            f"the inputs of {K} steps move {rank} of {n} directions of the states: other targets "
            "are not reached, and an error of the model may change which",
        )
    if m * K == n and K > 1 and not sure:
        return (
            f"{K} steps have just as many inputs as states, {n}: a small error of the model may "
            f"change the control much; take more than {K} steps",
        )
    return ()


Record: TypeAlias = (
    "tuple[ArrayLike, ArrayLike] | Literal['rest'] | tuple[Literal['rest'], ArrayLike, ArrayLike]"
)


class Start(NamedTuple):
    """Where a record ends: state and last readings, whether rest was declared, the last input."""

    x: Floats
    read: Floats
    at_rest: bool
    acted: Floats


def start_of(model: Model, record: Any) -> Start:
    """Return where a record of the arguments of `control` ends.

    Rest is refused where the data say that the model does not stay there.
    """
    window, p, m = model.regressors, model.n_outputs, model.m
    if record is None:
        raise InputError(
            f"`record` needs {window.fill + 1} rows of outputs and {window.fill} of inputs that "
            "were measured, got none: see Trajectories.last_record()"
        )
    if isinstance(record, str):
        record = (record, np.zeros(p), np.zeros(m))
    if not isinstance(record, tuple | list) or len(record) not in (2, 3):
        raise InputError(
            "`record` must be a pair (outputs, inputs) of rows that were measured, "
            f'"rest" or ("rest", outputs, inputs), got {validation.show(record)}'
        )
    if len(record) == 2:
        x = window.state_of(*record)
        read = np.asarray(record[0], dtype=np.float64)[-1]
        acted = np.vstack([np.zeros(m), np.asarray(record[1], dtype=np.float64)])[-1]
        return Start(x, validation.frozen(read), False, acted)
    validation.choice("record", record[0], ("rest",))
    y = validation.vector("record", record[1], length=p, labels=model.outputs).copy()
    u = validation.vector("record", record[2], length=m, labels=model.input_names).copy()
    x, z, off, rounding = window.core.rest(model.coefficients, y, u)
    room = model.region(DELTA).core.bound(z, False)
    if off > room + rounding:
        raise InputError(
            f"`record` must be of a plant at rest: at the outputs {show.vector(y)} under the "
            f"inputs {show.vector(u)} the model moves by {off:.3g} in a step, of which its error "
            f"explains {room:.3g}"
        )
    return Start(x, validation.frozen(y), True, u)


def cost_of_outputs(model: Model, cost: Cost) -> Cost:
    """The cost with weights of outputs as weights of states."""
    own = ((name, one) for name, one in cost.given.items() if name in ("Q", "Qf"))
    return replace(cost, **{name: for_outputs(model, one) for name, one in own})  # type: ignore[arg-type]


def output_control(model: Model, record: Any, target: Any, wanted: Wanted) -> Plan:
    """Compute the control for a model of outputs; the arguments are those of `control`."""
    start, K = start_of(model, record), validation.size("steps", wanted.steps)
    limits, cost = as_limits(wanted.limits), cost_of_outputs(model, wanted.cost)
    if limits.rate is not None and limits.previous is None:
        limits = replace(limits, previous=start.acted)
    if model.regressors.count > K:
        raise InputError(
            f"`steps` must be {model.regressors.count} at least, so that the window can be at rest "
            f"in the end, got {K}"
        )
    rows = targets(model, target)
    low, high = (side[-1].copy() for side in inputs_within(limits, K, model.labels))
    fixed = np.where((low == high) & (low < high).any(), low, np.nan)
    aim = Aim(rows[: K + 1][-1], weights_of(model, cost), (low, high), start.read, fixed)
    goal = set_point(model, aim), rows, rows[0]
    return plan_from(model, start, goal, Wanted(K, limits, cost, wanted.time_limit))


def plan_from(
    model: Model, start: Start, goal: tuple[_core.SetPoint, Floats, Floats], wanted: Wanted
) -> Plan:
    """The plan along targets, with the set point of that in the end.

    `goal` has the set point, the targets of the times 0, 1, .., and the first states of the window
    now if the outputs had been at their targets. Inputs cost what they differ from those in the
    end.
    """
    (point, rows, first), K, p = goal, wanted.steps, model.n_outputs
    _, slope, off = way_of(rows, K, rows[: K + 1][-1])
    x, u = point.moving(np.zeros(p), np.zeros(p), slope, np.zeros(model.m))
    _, apart = forecast_of(as_limits(wanted.limits), K, model.labels)
    about = start.x, x, 0.0, start.read, start.at_rest, False, apart if apart.any() else None
    basis, way = trusted(ModelBasis, model, *about), None
    if len(rows) > 1:
        ramp = x[:p] - np.arange(K, -1, -1)[:, None] * slope
        way = ramp[1:] + in_window(model, off, or_zero(first - ramp[0]))
        if wanted.cost.R is None:  # a task also without limits
            wanted = wanted._replace(cost=replace(wanted.cost, R="auto"))
    return model_control(basis, wanted, u, way)


def predict(
    model: Identified,
    x0: ArrayLike | Uncertain | None = None,
    inputs: ArrayLike | None = None,
    *,
    record: Record | None = None,
) -> Plan:
    """Predict the states or readings under given inputs, for example of a run that was kept apart.

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
    nothing = np.zeros(len(model.A))
    if of_outputs(model, {"x0": x0}, {"record": record}):
        start = start_of(model, record)
        basis = ModelBasis(model, start.x, nothing, 0.0, start.read, start.at_rest)
    else:
        basis = basis_in_states(model, x0, nothing)
    names = model.input_names
    u = validation.inputs("inputs", inputs, cols=model.B.shape[1], empty=False, labels=names).copy()
    path = trajectory(model.Theta, basis.x0, u)
    if not np.isfinite(path).all():
        raise NonFiniteError("the predicted states overflow: give fewer or smaller `inputs`")
    basis = replace(basis, xf=path[-1].copy(), given=True)
    return _planned(basis, u, path, _best(basis, len(u)))
