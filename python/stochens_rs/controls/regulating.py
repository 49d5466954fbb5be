"""`regulate`: from a system or a model to a `Regulator`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import validation
from .constraints import checked_task
from .regulator import Regulator, checked_model

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..identification.identified import Identified
    from ..system import System


def regulate(
    system: System | Identified | Any,
    steps: int,
    xf: ArrayLike | None = None,
    *,
    limits: Any = None,
    rate: ArrayLike | None = None,
    previous: ArrayLike | None = None,
    Q: ArrayLike | None = None,
    Qf: ArrayLike | None = None,
    R: ArrayLike | str | None = None,
    reference: ArrayLike | None = None,
    state_limits: Any = None,
    soft: float | bool | None = None,
    time_limit: float | None = None,
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
    limits, rate, Q, Qf, R, state_limits, soft
        As in `control`. What differs from step to step belongs to the steps of each plan: the
        input that is returned is always that of the first one.
    previous : float or array_like, shape (m,), optional
        With `rate`: the input applied before the first call. Later the one returned last.
    reference : array_like, shape (K + 1, n), optional
        The states wanted over the steps of each plan, in place of `xf`.
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

    Notes
    -----
    Limits of single inputs: all that does not depend on the state is computed here, and a call
    begins at the active limits of the call before, shifted by one step. Its work is bounded: at
    most 20 exchanges of active limits, 25 factorizations of an interior point and 5 more exchanges,
    and the same once more with orthogonal factors where rounding asks for them. Each plan's gap is
    computed from the data, and is in the log.

    With `rate` or `state_limits` a call begins at the active limits of the call before as well, and
    exchanges them at most 10 times; where that does not lead to a plan whose gap is certified, the
    plan is solved from no earlier one: milliseconds in place of tenths of one.

    A feedback corrects errors of the model at the next state. That the loop is stable does not
    follow: it needs a K that is long enough, or a weight Qf that continues the cost.

    Examples
    --------
    >>> import stochens_rs as se
    >>> loop, x = se.regulate(([[1.0]], [[1.0]]), 1, limits=(-1.0, 1.0), Q=1.0, R=1.0), [5.0]
    >>> for _ in range(6):
    ...     u = loop(x)
    ...     x = x + u
    >>> [float(call.u[0]) for call in loop.log]
    [-1.0, -1.0, -1.0, -1.0, -0.5, -0.25]
    """
    checked = checked_model(system)
    n, m = checked.B.shape
    K = validation.size("steps", steps)
    goal = None if xf is None else validation.vector("xf", xf, length=n, labels=checked.state_names)
    task = checked_task(
        n,
        m,
        K,
        np.zeros(n) if goal is None and reference is None else goal,
        limits=limits,
        rate=rate,
        previous=previous,
        Q=Q,
        Qf=Qf,
        R="auto" if R is None else R,  # given: a task also without limits
        reference=reference,
        state_limits=state_limits,
        soft=soft,
        labels=checked.labels,
    )
    assert task is not None
    return Regulator(checked, task, time_limit)
