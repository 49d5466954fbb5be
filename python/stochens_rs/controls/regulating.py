"""`regulate`: from a system or a model to a `Regulator`."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import validation
from ..exceptions import InputError
from .constraints import checked_task
from .cost import Cost, as_cost
from .keeping import kept_of
from .regulator import Regulator, checked_model

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..feedback import Loop, LoopCertificate
    from ..identification.identified import Identified
    from ..system import System
    from .limits import LimitsLike


def regulate(
    system: System | Identified | Any,
    steps: int,
    xf: ArrayLike | None = None,
    *,
    limits: LimitsLike = None,
    cost: Cost | None = None,
    time_limit: float | None = None,
    gain: Loop | LoopCertificate | None = None,
    keep: float = 0.95,
    calls: int | None = None,
) -> Regulator:
    """Make a feedback that plans K steps ahead at every state and returns the first input.

    Parameters
    ----------
    system : System or model
        A System, anything `System.from_any` takes, or a model from data.
    steps : int
        The number of steps K of each plan.
    xf : array_like, shape (n,), optional
        The target; default: the origin.
    limits : Limits, or tuple (low, high), optional
        As in `control`. What differs from step to step belongs to the steps of each plan: the
        input that is returned is always that of the first one. With a rate, `previous` is the input
        applied before the first call; later it is the one returned last.
    cost : Cost, optional
        As in `control`; a reference has the states wanted over the steps of each plan.
    time_limit : float, optional
        Seconds after which a call returns the best plan so far, with status "user_limit"; looked
        at within factorizations.

    Returns
    -------
    Regulator
        ``u = loop(x)``; ``loop(hold=True)`` where the state is not known.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; or a power of A overflows, named by its exponent.
    ResourceError
        If the problem does not fit into the memory this process may use.
    SolverError
        From a call, with a gain: no plan from the first state keeps the limits; it says which one,
        by how much, and what is kept back for the model and for noise.

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

    A feedback corrects errors of the model at the next state. That the loop is stable does not
    follow: it needs a K that is long enough, or a weight Qf that continues the cost.

    With a gain a plan from x(j) is followed by ``u = v + K (x - xb)``. Its states and inputs are
    off by at most ``sqrt(h'L h) ||c|| / (1 - theta)`` for the model (`LoopCertificate.tube`) and
    ``zeta sqrt(h'Y h)`` for noise, with zeta for the union over all sides of limits and all pairs
    ``j < k <= T``, as plans begin at states that noise has moved. `Kept` says which plans are
    accepted; where the newest is not, the status is "kept". The noise must be Gaussian, white and
    independent of the data, the states read exactly, and the system the linear one of the data.

    Examples
    --------
    >>> import stochens_rs as se
    >>> cost = se.Cost(Q=1.0, R=1.0)
    >>> loop, x = se.regulate(([[1.0]], [[1.0]]), 1, limits=(-1.0, 1.0), cost=cost), [5.0]
    >>> for _ in range(6):
    ...     u = loop(x)
    ...     x = x + u
    >>> [float(call.u[0]) for call in loop.log]
    [-1.0, -1.0, -1.0, -1.0, -0.5, -0.25]

    With a gain:

    >>> import numpy as np
    >>> x, u, w = np.random.default_rng(1).standard_normal((3, 100, 1))
    >>> data = se.Trajectories.from_pairs(x, u, 0.9 * x + u + 0.05 * w)
    >>> model = se.identify(data, sigma=0.05)
    >>> gain = se.gain(model, 1.0, 1.0)
    >>> loop = se.regulate(model, 5, limits=(-1.0, 1.0), gain=gain, calls=50)
    >>> loop([2.0]).round(2), loop.kept.tightening.round(2)
    (array([-0.23]), array([0.23, 0.12]))
    """
    checked = checked_model(system)
    n, m = checked.B.shape
    K = validation.size("steps", steps)
    goal = None if xf is None else validation.vector("xf", xf, length=n, labels=checked.state_names)
    weights = as_cost(cost)
    if goal is not None and weights.reference is not None:
        raise InputError("`xf` must be None with a reference, whose last row takes its place")
    if weights.R is None:  # a task also without limits
        weights = replace(weights, R="auto")
    goal = np.zeros(n) if goal is None else goal
    task = checked_task(n, m, K, goal, limits, weights, checked.labels)
    assert task is not None
    if gain is None and calls is not None:
        raise InputError("`calls` must be left out without `gain`")
    kept = None if gain is None else kept_of(checked, task, gain, keep, calls)
    return Regulator(checked, task, time_limit, kept=kept)
