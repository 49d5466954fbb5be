"""`regulate`: feedback within limits in a receding horizon."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base import gate, html
from .._base.types import Floats
from ..exceptions import InputError, ShapeError
from ..identification.identified import Identified
from ..system import System
from .limited import Horizon, Limited
from .task import Task, checked_task

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

LOGGED = 1000  # calls that the log keeps


@dataclass(frozen=True, eq=False)
class Call:
    """One call of a `Regulator`.

    Attributes
    ----------
    x : ndarray, shape (n,), or None
        The state; None for a held input.
    u : ndarray, shape (m,)
        The input returned.
    status : str
        That of the plan, or "held".
    gap : float
        ``J - min J`` of the plan is at most this; nan for a held input.
    seconds : float
        The time the call took [s].
    """

    x: Floats | None
    u: Floats
    status: str
    gap: float
    seconds: float


class Regulator:
    """Feedback ``u = loop(x)``: the first input of the best plan over the next K steps.

    Made by `regulate`. Not to be shared between threads.
    """

    def __init__(self, system: Any, task: Task, time_limit: float | None) -> None:
        self._task, self._time_limit = task, time_limit
        self._plan: Floats | None = None
        self._held = 0
        self._log: deque[Call] = deque(maxlen=LOGGED)
        self._calls = 0
        self._prepare(system)

    def __call__(self, x: ArrayLike | None, *, hold: bool = False) -> Floats:
        """Compute the input for the state x.

        Parameters
        ----------
        x : array_like, shape (n,)
            The state now; None with ``hold=True``.
        hold : bool, default False
            No state is known: return the next input of the last plan. At most K - 1 times in a row.

        Returns
        -------
        ndarray, shape (m,)
            The input, within its limits.

        Raises
        ------
        InputError, InputTypeError
            If x cannot be used, is not finite, or there is nothing left to hold; the loop is then
            as it was before the call.

        Examples
        --------
        >>> import stochens_rs as se
        >>> loop = se.regulate(([[1.0]], [[1.0]]), 3, limits=(-1.0, 1.0))
        >>> loop([5.0]), loop(None, hold=True)
        (array([-1.]), array([-1.]))
        """
        started = perf_counter()
        if gate.flag("hold", hold):
            if x is not None:
                raise InputError("`x` must be None with hold=True: with a state call loop(x)")
            return self._hold(started)
        state = gate.vector("x", x, length=self.n)
        control, status, gap = self._solve(state)
        # nothing above has changed the loop, so that an exception leaves it as it was
        self._plan, self._held = control, 0
        return self._noted(state, control[0].copy(), status, gap, started)

    def _hold(self, started: float) -> Floats:
        if self._plan is None:
            raise InputError("`hold` needs a plan: call loop(x) first")
        if self._held + 1 >= len(self._plan):
            raise InputError(
                f"`hold` is possible {len(self._plan) - 1} times in a row with "
                f"steps={len(self._plan)}: the last plan is used up"
            )
        self._held += 1
        return self._noted(None, self._plan[self._held].copy(), "held", np.nan, started)

    def _noted(
        self, x: Floats | None, u: Floats, status: str, gap: float, started: float
    ) -> Floats:
        if self._task.rate is not None:
            self._task = replace(self._task, previous=u.copy())
        self._log.append(Call(x, u.copy(), status, gap, perf_counter() - started))
        self._calls += 1
        return u

    def _prepare(self, system: Any) -> None:
        """All that does not depend on the state."""
        A, B, c = _matrices(system)
        if self._plan is not None and (len(A), B.shape[1]) != (self.n, self.m):
            raise ShapeError(
                f"`system` must have n={self.n} and m={self.m} as this loop, got n={len(A)} and "
                f"m={B.shape[1]}"
            )
        horizon = Horizon(self._task, A, B, c)
        solver = None
        if self._task.boxed and not horizon.long:
            M, state, target = horizon.weighted()
            low, high = self._task.low.ravel(), self._task.high.ravel()
            solver = _core.BoxSolver(M, horizon.cost(), low, high, B.shape[1], state, target)
        self._system, self._horizon, self._solver = system, horizon, solver

    def _solve(self, x: Floats) -> tuple[Floats, str, float]:
        if self._solver is None:
            self._horizon.task = self._task
            found: Limited = self._horizon.solve(x, time_limit=self._time_limit)
            return found.u, found.status, found.gap
        solved = self._solver.solve(x, self._time_limit)
        return solved.control.reshape(self._task.low.shape), solved.status, solved.gap

    def __getstate__(self) -> dict[str, Any]:
        state = {k: v for k, v in vars(self).items() if k not in ("_solver", "_horizon")}
        return state | {"warm": None if self._solver is None else self._solver.warm()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        warm = state.pop("warm")
        vars(self).update(state)
        plan, self._plan = self._plan, None
        self._prepare(self._system)
        self._plan = plan
        if self._solver is not None:
            self._solver.resume(warm)

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self._horizon.A)

    @property
    def m(self) -> int:
        """The number of inputs."""
        return int(self._horizon.B.shape[1])

    @property
    def steps(self) -> int:
        """The number of steps K of a plan."""
        return self._task.steps

    @property
    def plan(self) -> Floats | None:
        """The last plan, shape (K, m); None before the first call."""
        return None if self._plan is None else self._plan.copy()

    @property
    def held(self) -> int:
        """How many inputs in a row were held."""
        return self._held

    @property
    def log(self) -> Sequence[Call]:
        """The last 1000 calls."""
        return tuple(self._log)

    def swap(self, system: Any) -> None:
        """Go on with another system or model from the next call on.

        Parameters
        ----------
        system : System or model
            Of the same size; for example ``stream.model`` of a `ModelStream`.

        Raises
        ------
        InputError, InputTypeError
            If it cannot be used; the loop then goes on with the old one.

        Examples
        --------
        >>> import stochens_rs as se
        >>> loop = se.regulate(([[1.0]], [[1.0]]), 3, limits=(-1.0, 1.0))
        >>> loop.swap(([[0.9]], [[1.0]]))
        """
        self._prepare(system)

    def reset(self) -> None:
        """Forget the last plan and the log.

        Examples
        --------
        >>> import stochens_rs as se
        >>> loop = se.regulate(([[1.0]], [[1.0]]), 3, limits=(-1.0, 1.0))
        >>> loop.reset()
        """
        self._plan, self._held, self._calls = None, 0, 0
        self._log.clear()
        if self._solver is not None:
            self._solver.resume(None)

    def __repr__(self) -> str:
        held = f", {self._held} held" if self._held else ""
        over = html.counted(self.steps)
        return f"<Regulator: n={self.n} m={self.m}, {over}, {self._calls} calls{held}>"


def regulate(
    system: Any,
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
    """Make a feedback that plans K steps ahead at every state and applies the first input.

    Parameters
    ----------
    system : System or model
        A System, anything `System.from_any` takes, or a model from data.
    steps : int
        The number of steps K of each plan.
    xf : array_like, shape (n,), optional
        The target; default: the origin.
    limits, rate, previous, Q, Qf, R, state_limits, soft
        As in `control`; `previous` is the input applied before the first call.
    reference : array_like, shape (K + 1, n), optional
        The states wanted over the steps of each plan, in place of `xf`.
    time_limit : float, optional
        Seconds after which a plan is returned as it is, with status "user_limit".

    Returns
    -------
    Regulator
        ``u = loop(x)``.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; or a power of A overflows, named by its exponent.

    Notes
    -----
    Box limits: all that does not depend on the state is computed here; a call begins at the active
    limits of the call before, shifted by one step. At most 15 exchanges of active limits are
    followed by at most 25 steps of an interior point, so that the time of a call is bounded.

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
    A, B, _ = _matrices(system)
    n, m = B.shape
    K = gate.size("steps", steps)
    goal = None
    if reference is None:
        goal = np.zeros(n) if xf is None else gate.vector("xf", xf, length=n)
    task = checked_task(
        n,
        m,
        K,
        goal,
        limits=limits,
        rate=rate,
        previous=previous,
        Q=Q,
        Qf=Qf,
        R=R or "auto",
        reference=reference,
        state_limits=state_limits,
        soft=soft,
    )
    assert task is not None
    seconds = None if time_limit is None else gate.positive("time_limit", time_limit)
    return Regulator((A, B, _), task, seconds)


def _matrices(system: Any) -> tuple[Floats, Floats, Floats | None]:
    """A, B and the offset of a system or a model."""
    if isinstance(system, Identified):
        return np.array(system.A), np.array(system.B), system.c
    if isinstance(system, tuple) and len(system) == 3:
        return system
    checked = System.from_any(system)
    return checked.A, checked.B, None
