"""`regulate`: a loop for a system, a model, or a model of readings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, overload

import numpy as np

from .._base import validation
from .._base.types import ArrayLike
from ..exceptions import InputError
from ..feedback import Loop
from ..identification.identified import Identified
from ..identification.model import Model
from ..limits.limits import Cost, LimitsLike, as_cost, as_limits
from ..limits.problem import read_task
from .keep import Keep, kept_of
from .readings import ReadingLoop
from .regulator import Regulator, checked_model, continued, warn_of_growth

if TYPE_CHECKING:
    from ..controls.set_point import Target
    from ..system.system import System


@overload
def regulate(
    system: System | Identified | Any,
    steps: int,
    target: ArrayLike | None = None,
    *,
    limits: LimitsLike = None,
    cost: Cost | None = None,
    time_limit: float | None = None,
    keep: Keep | None = None,
) -> Regulator: ...
@overload
def regulate(
    system: Model | Loop,
    steps: int | None = None,
    target: Target | None = None,
    *,
    limits: LimitsLike = None,
    cost: Cost | None = None,
    offset_free: bool | float,
    hold: ArrayLike | None = None,
    max_missing: int = 3,
    keep: Keep | None = None,
) -> ReadingLoop: ...


def regulate(
    system: System | Identified | Any,
    steps: int | None = None,
    target: Target | None = None,
    *,
    limits: LimitsLike = None,
    cost: Cost | None = None,
    time_limit: float | None = None,
    keep: Keep | None = None,
    offset_free: bool | float | None = None,
    hold: ArrayLike | None = None,
    max_missing: int = 3,
) -> Regulator | ReadingLoop:
    """Make a feedback that plans K steps ahead at every state and returns the first input.

    Parameters
    ----------
    system : System, model or Loop
        A System, anything `System.from_any` takes, or a model from data. Or the `Loop` of a model
        of outputs, whose gain then takes the place of plans.
    steps : int
        The number of steps K of each plan; left out for a Loop.
    target : array_like, shape (n,), or (n_outputs,) for a model of outputs, optional
        Where the states or the outputs are to stay; default: the origin. Of outputs nan, or what a
        mapping of names leaves out, is free; rows of them, (h, n_outputs), are one for each call,
        of which the last stays. A target that is a point of rest of no system in the region
        raises, with the nearest one.
    limits : Limits, tuple (low, high) or mapping, optional
        As in `control`. What differs from step to step belongs to the steps of each plan: the
        input that is returned is always that of the first one. With a rate, `previous` is the input
        applied before the first call; later it is the one returned last, or `applied`. A Loop has
        limits of inputs and rates. With a `forecast`, for a model of outputs, each call takes what
        is measured and forecast then.
    cost : Cost, optional
        As in `control`; a reference has the states wanted over the steps of each plan.
    time_limit : float, optional
        Seconds after which a call returns the best plan so far, with status "user_limit"; looked
        at within factorizations.
    keep : Keep, optional
        For a model from data: a gain that is certified for all systems its region allows, with
        which the limits are kept in so many calls, with its probability; see Notes. For a model of
        outputs these are hard limits of readings, inputs and their changes, without `offset_free`.
    offset_free : bool or float, optional
        For a model of outputs, as all that follows, and to be given there: whether a constant that
        is added to the readings is learned and taken off. True: as inputs that drift by 1 % of
        their rms in the data in a step; a number: by this much.
    hold : array_like, shape (m,), optional
        The input while the window fills; default 0.
    max_missing : int, default 3
        In how many calls in a row no reading may come: the prediction of the model counts in their
        place. Behind them the loop holds its last input.

    Returns
    -------
    Regulator or ReadingLoop
        ``u = loop(x)``, nan where the state is not known. For a model of outputs ``u = loop(y)``,
        see `ReadingLoop`. ``loop.watch = proof.watch()`` looks at each call, see its log.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; or a power of A overflows, named by its exponent.
    ResourceError
        If the problem does not fit into the memory this process may use.
    SolverError
        With `keep`: what is kept back for noise leaves no room within the limits, or has no bound.

    Notes
    -----
    Limits of single inputs: all that does not depend on the state is computed here, and a call
    begins at the active limits of the call before, shifted by one step. Its work is bounded: at
    most 20 exchanges of active limits, 25 factorizations of an interior point and 5 more exchanges,
    and the same once more with orthogonal factors where rounding asks for them. Each plan's gap is
    computed from the data, and is in the log.

    With limits of rates or states a call begins at the active limits of the call before, too, and
    exchanges them at most 10 times; where that does not lead to a plan whose gap is certified, the
    plan is solved from no earlier one: milliseconds in place of tenths of one.

    Without Qf, with Q and R, the last states are weighed by what follows a plan: the cost of the
    gain that `gain` makes. Without limits, or where none is met any more, the loop is then that
    gain for every K. With other weights it needs a K that is long enough, and a warning says where
    it grows.

    With `keep` a plan from x(j) is followed by ``u = v + K (x - xb)``. Its states and inputs are
    off by at most ``sqrt(h'L h) ||c|| / (1 - theta)`` for the model (`LoopCertificate.tube`) and
    ``zeta sqrt(h'Y h)`` for noise, with zeta for the union over all sides of limits and all pairs
    ``j < k <= T``, as plans begin at states that noise has moved. `Kept` says which plans are
    accepted; where the newest is not, the status is "kept"; where none was yet, "infeasible": the
    log says which limit lacks how much, and the input is ``K x`` within the limits, without the
    promise. The noise must be Gaussian, white and independent of the data, the states read exactly,
    and the system the linear one of the data.

    The states of a model of outputs are its window, known exactly while all readings come: what is
    white is what no window predicts. The promise begins with the first full window. `Kept` says
    where it ends; the status is "unproved" from then on, and the loop goes on.

    Examples
    --------
    >>> import stochens_rs as se
    >>> cost = se.Cost(Q=1.0, R=1.0)
    >>> loop, x = se.regulate(([[1.0]], [[1.0]]), 1, limits=(-1.0, 1.0), cost=cost), [5.0]
    >>> for _ in range(6):
    ...     u = loop(x)
    ...     x = x + u
    >>> [round(float(call.u[0]), 3) for call in loop.log]
    [-1.0, -1.0, -1.0, -1.0, -0.618, -0.236]

    With `keep`:

    >>> import numpy as np
    >>> x, u, w = np.random.default_rng(1).standard_normal((3, 100, 1))
    >>> data = se.Trajectories.from_pairs(x, u, 0.9 * x + u + 0.05 * w)
    >>> model = se.identify(data, noise=0.05)
    >>> gain = se.gain(model, 1.0, 1.0)
    >>> loop = se.regulate(model, 5, limits=(-1.0, 1.0), keep=se.Keep(gain, calls=50))
    >>> loop([2.0]).round(2), loop.kept.tightening.round(2)
    (array([-0.23]), array([0.23, 0.12]))
    """
    read = isinstance(system, Loop) or (isinstance(system, Model) and system.window is not None)
    if read or offset_free is not None:
        what = "a Loop" if isinstance(system, Loop) else "a model of outputs"
        if time_limit is not None:
            raise InputError(
                f"`time_limit` must be left out for {what}: the work of a call is bounded as it is"
            )
        model: Any = system
        how = offset_free, hold, max_missing, keep
        return ReadingLoop(model, steps, target, limits, cost, *how)
    if hold is not None:
        raise InputError("`hold` is for models of outputs: must be left out")
    validation.size("max_missing", max_missing, minimum=0)
    checked = checked_model(system)
    n, m = checked.B.shape
    K, goal = validation.size("steps", steps), np.zeros(n)
    if target is not None:
        goal = validation.vector("target", target, length=n, labels=checked.state_names)
    given, within = as_cost(cost), as_limits(limits)
    weights = continued(given, checked, within, K)
    if within.forecast is not None:
        raise InputError("`forecast` of `limits` is for models of outputs: give None")
    if target is not None and weights.reference is not None:
        raise InputError("`target` must be None with a reference, whose last row takes its place")
    task = read_task(n, m, K, goal, within, weights, checked.labels)
    if weights is given:
        warn_of_growth(task, checked.A, checked.B)
    kept = None if keep is None else kept_of(checked, task, keep)
    return Regulator(checked, task, time_limit, kept)
