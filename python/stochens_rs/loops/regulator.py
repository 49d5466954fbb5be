"""`Regulator`: a loop that plans anew at every state."""

from __future__ import annotations

import copy
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import show, validation
from .._base.names import order_of
from .._base.types import DELTA
from ..certificates.of_model import trajectory
from ..exceptions import InputError, NonFiniteError, ShapeError, SolverError
from ..identification.identified import Identified
from ..limits.problem import Task
from ..limits.solution import loop_of
from ..system.system import System
from ..validation.fresh_systems import Validation
from ..validation.held_out import PredictedLoop, Runs, validated_loop
from .keep import Kept
from .loop import BEYOND, Call, ControlLoop, counted, curves, drawn_calls, facts

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure
    from numpy.typing import ArrayLike

    from .._base.names import Labels
    from .._base.types import Floats, Status


LARGEST = 1e150  # of a state of a system without data: its cost is a number


class Regulator(ControlLoop[Call]):
    """Feedback ``u = loop(x)``: the first input of the best plan over the next K steps.

    Made by `regulate`. It keeps the active limits of its last plan, at which the next call begins;
    a copy or a pickle goes on from there, and agrees to rounding. One thread at a time: a call
    during a call of another thread raises.

    A state that no sensor can have read (nan, inf, a million times the largest in the data of a
    model) does not stop the loop: the next input of the last plan is returned, then its last one,
    and before the first plan 0 within the limits. The log says "held", and why.

    Parameters
    ----------
    system : System or model
        What the plans are made with.
    task : Task
        What they minimise, and the limits.
    time_limit : float, optional
        Seconds after which a call returns the best plan so far.
    labels : Labels, optional
        The names in the order of `task`; the default is those of the system.
    kept : Kept, optional
        The limits that are kept with a stated probability.
    """

    __slots__ = (
        "_held",
        "_labels",
        "_most",
        "_plan",
        "_solver",
        "_system",
        "_task",
        "_time_limit",
        "kept",
    )

    def __init__(
        self,
        system: System | Identified,
        task: Task,
        time_limit: float | None = None,
        labels: Labels | None = None,
        kept: Kept | None = None,
    ) -> None:
        self._time_limit = (
            None if time_limit is None else validation.positive("time_limit", time_limit)
        )
        checked = checked_model(system)
        self._labels = checked.labels if labels is None else labels
        self.kept = kept
        self._set(checked, validation.instance("task", task, Task))
        self._plan: Floats | None = None
        self._held = 0
        super().__init__(self._safe)

    def _set(self, system: System | Identified, task: Task) -> None:
        """Compute all that does not depend on the state; nothing changes if that raises."""
        sizes, wanted = system.B.shape, (task.reference.shape[1], task.low.shape[1])
        if sizes != wanted:
            raise ShapeError(
                "`system` must have n={} and m={} as this loop, got n={} and m={}".format(
                    *wanted, *sizes
                )
            )
        order = order_of("system", system.labels, self._labels)
        c = system.c if isinstance(system, Identified) else None
        c = None if c is None else order.of_states(c)
        A, B = (np.ascontiguousarray(M) for M in order.matrices(system.A, system.B))
        within = task if self.kept is None else self.kept._tightened(task)
        solver = loop_of(within, A, B, c)
        self._system, self._task, self._solver = system, task, solver
        seen = system._largest if isinstance(system, Identified) else None
        self._most: Floats = np.full(self.n, LARGEST)
        if seen is not None:
            seen = order.of_states(seen[: self.n])
            self._most = np.where(seen > 0.0, BEYOND * seen, LARGEST)

    @property
    def _safe(self) -> Floats:
        """The input before the first plan: the one that acts, or 0, within the limits."""
        none = np.zeros(self.m) if self._task.previous is None else self._task.previous
        return np.clip(none, self._task.low[0], self._task.high[0])

    def __call__(self, x: ArrayLike | None = None, *, hold: bool = False) -> Floats:
        """Compute the input for the state x.

        Parameters
        ----------
        x : array_like, shape (n,)
            The state now. With ``hold=True`` it is not looked at and may be left out.
        hold : bool, default False
            The state is not known: return the next input of the last plan. Possible K - 1 times in
            a row; a call with a state starts the count again.

        Returns
        -------
        ndarray, shape (m,)
            The input, within its limits.

        Raises
        ------
        InputError, InputTypeError
            If x has another shape or is no numbers, there is nothing left to hold, or another
            thread is in a call. After any exception the loop is as it was before the call.

        Examples
        --------
        >>> import stochens_rs as se
        >>> loop = se.regulate(([[1.0]], [[1.0]]), 3, limits=(-1.0, 1.0))
        >>> loop([5.0]), loop(hold=True)
        (array([-1.]), array([-1.]))
        """
        started = perf_counter()
        with self._turn():
            if validation.flag("hold", hold):
                return self._hold(started)
            if x is None:
                raise InputError("`x` must be the state, or hold=True if it is not known, got None")
            state = validation.measured("x", x, self._labels.states)
            reason = validation.broken(state, self._most, self._labels.states)
            if reason is not None:
                return self._fault(state, reason, started)
            try:
                found = self._solve(state, self._time_limit)
            except NonFiniteError:
                return self._fault(state, "`x` is too large: its cost overflows", started)
            plan: Floats | None
            if self.kept is None:
                plan, status, gap = found
                u = found[0][0].copy()
            else:
                plan, u, status, gap, reason = self._kept(self.kept, state, found, started)
            # nothing above has changed the loop, so that an exception leaves it as it was
            self._plan, self._held = plan, 0
            return self._noted(state, u, status, gap, started, reason)

    def _kept(
        self, kept: Kept, x: Floats, found: tuple[Floats, Status, float], started: float
    ) -> tuple[Floats | None, Floats, Status, float, str | None]:
        def left() -> float:
            if self._time_limit is None:
                return np.inf
            return self._time_limit - perf_counter() + started

        def again() -> tuple[Floats, Status, float]:
            self._set(self._system, self._task)
            return self._solve(x, None if self._time_limit is None else max(left(), 1e-6))

        try:
            return *kept._choose(x, found, again, left), None
        except SolverError as error:
            self._set(self._system, self._task)  # without what was kept back for the model
            return None, kept._unplanned(x), "infeasible", np.nan, str(error)

    def _fault(self, x: Floats, reason: str, started: float) -> Floats:
        """Go on without a state: by the plan, behind its end with its last input."""
        u = self._last
        if self.kept is not None:
            self.kept._since += 1
        elif self._plan is not None:
            u = self._plan[min(self._held + 1, self.steps - 1)].copy()
        self._held += 1
        return self._noted(x, u, "held", np.nan, started, reason)

    def _hold(self, started: float) -> Floats:
        if self.kept is not None:
            raise InputError("`hold` must be False with a gain: the feedback needs the state")
        if self._plan is None:
            raise InputError("`hold` must be False before the first plan: call loop(x) first")
        if self._held + 1 >= self.steps:
            raise InputError(
                f"`hold` must be False now: a plan over {show.counted(self.steps)} has "
                f"{show.number_of(self.steps - 1, 'input')} to hold, and all are used"
            )
        self._held += 1
        return self._noted(None, self._plan[self._held].copy(), "held", np.nan, started)

    def _noted(
        self,
        x: Floats | None,
        u: Floats,
        status: Status,
        gap: float,
        started: float,
        reason: str | None = None,
    ) -> Floats:
        if self._task.rate is not None:
            self._task = replace(self._task, previous=u.copy())
            self._solver.follow(u)
        return self._entered(Call(x, u, status, gap, perf_counter() - started, reason), u)

    def _solve(self, x: Floats, limit: float | None) -> tuple[Floats, Status, float]:
        found = self._solver.solve(x, limit)
        shape = self._task.low.shape
        plan = found.control[: shape[0] * shape[1]].reshape(shape)
        return plan, found.status, found.gap

    def __getstate__(self) -> dict[str, Any]:
        with self._turn():
            return {
                "system": self._system,
                "labels": self._labels,
                "kept": self.kept,
                "task": self._task,
                "time_limit": self._time_limit,
                "plan": self._plan,
                "held": self._held,
                "calls": self._calls,
                "log": tuple(self._log),
                "last": self._last,
                "warm": self._solver.warm(),
            }

    def __setstate__(self, state: dict[str, Any]) -> None:
        words = ("system", "task", "time_limit", "labels", "kept")
        Regulator.__init__(self, *(state[word] for word in words))
        self._plan, self._held, self._calls = state["plan"], state["held"], state["calls"]
        self._log.extend(state["log"])
        self._last = state["last"]
        self._solver.resume(state["warm"])

    @property
    def n(self) -> int:
        """The number of states."""
        return int(self._task.reference.shape[1])

    @property
    def m(self) -> int:
        """The number of inputs."""
        return int(self._task.low.shape[1])

    @property
    def steps(self) -> int:
        """The number of steps K of a plan."""
        return self._task.steps

    @property
    def limits(self) -> tuple[Floats, Floats]:
        """The limits (low, high) of the input that is returned, each (m,)."""
        return self._task.low[0].copy(), self._task.high[0].copy()

    @property
    def plan(self) -> Floats | None:
        """The inputs of the last plan, shape (K, m); None before the first call.

        `predict` with them says where a model leads from x, and how far that is certain.
        """
        return None if self._plan is None else self._plan.copy()

    @property
    def held(self) -> int:
        """How many inputs in a row were held."""
        return self._held

    def swap(self, system: System | Identified | Any) -> None:
        """Go on with another system or model from the next call on.

        The last plan, to hold from, and the active limits at which the next call begins are kept.

        Parameters
        ----------
        system : System or model
            Of the same size; for example ``stream.model`` of a `ModelStream`. The names of this
            loop in another order are brought into its order.

        Raises
        ------
        InputError, InputTypeError
            If it cannot be used, or another thread is in a call; the loop then goes on with the
            old one.

        Examples
        --------
        >>> import stochens_rs as se
        >>> loop = se.regulate(([[1.0]], [[1.0]]), 3, limits=(-1.0, 1.0))
        >>> loop.swap(([[0.9]], [[1.0]]))
        """
        if self.kept is not None:
            raise InputError("`system` cannot change with a gain: its proof is about one model")
        checked = checked_model(system)
        with self._turn():
            warm = self._solver.warm()
            self._set(checked, self._task)
            self._solver.resume(warm)
            if not self._labels.given:
                self._labels = checked.labels

    def reset(self) -> None:
        """Forget the last plan, its active limits and the log; keep the system.

        With `rate`, the last input remains the one that is applied now.

        Examples
        --------
        >>> import stochens_rs as se
        >>> loop = se.regulate(([[1.0]], [[1.0]]), 3, limits=(-1.0, 1.0))
        >>> u = loop([5.0])
        >>> loop.reset()
        >>> loop.calls, loop.plan
        (0, None)
        """
        with self._turn():
            self._plan, self._held = None, 0
            self._cleared(self._safe)
            if self.kept is not None:
                self.kept.reset()
                self._set(self._system, self._task)
            self._solver.resume(None)

    def validate(
        self,
        runs: Runs,
        delta: float = DELTA,
        *,
        beta: float | None = None,
        scale: ArrayLike | None = None,
        weights: ArrayLike | None = None,
    ) -> Validation:
        """Say where the next run of this loop will be, from runs of it, whatever noise and plant.

        Parameters
        ----------
        runs : Trajectories or array_like of shape (M, K + 1, n)
            States of runs of this loop that had no part in it, all of them, from starts that vary
            as later ones will: a run that diverged or was aborted has fewer rows, or nan. The
            inputs of Trajectories must be what this loop gives at their states.
        delta, beta, weights
            As for `Plan.validate`: 19 runs for 95 %, 59 with confidence 95 %.
        scale : array_like, shape (n,) or (K + 1, n), optional
            Units of the deviations, > 0, fixed before these runs. The default is the standard
            deviation of the noise of one step for a `Model`, else 1.

        Returns
        -------
        Validation
            ``tube`` around ``p(k)``, the states of the loop around its model from the run's own
            start, and ``target``, the distance of x(K) from the last set point.

        Raises
        ------
        InputError, InputTypeError
            If the runs do not fit this loop, or had other inputs: of another controller, of one
            that was tuned or swapped in between, or with held ones.

        Notes
        -----
        As for `Plan.validate`. The loop begins each run without a plan, and with a rate of change
        from the input that is applied now. A loop that was tuned after the runs were seen needs
        fresh ones.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> loop = se.regulate(([[1.0]], [[1.0]]), 3, limits=(-1.0, 1.0))
        >>> rng = np.random.default_rng(1)
        >>> x = rng.uniform(1.0, 3.0, (19, 6, 1))
        >>> for run in x:
        ...     for k in range(5):
        ...         run[k + 1] = run[k] + loop(run[k]) + 0.1 * rng.standard_normal(1)
        >>> loop.validate(x, scale=[0.1])
        <Validation: 19 runs of a loop, x(K) within 0.483 of xf, tube 2.96 scales, 95 % each>
        """
        covariance = getattr(self._system, "covariance", None)
        unit = np.ones(self.n) if covariance is None else np.sqrt(np.diag(covariance))
        order = order_of("system", self._system.labels, self._labels)
        dt = self._system.dt if isinstance(self._system.dt, float) else None
        mine = PredictedLoop(
            self._path,
            self._inputs,
            self.n,
            self.m,
            validation.frozen(self._task.reference[-1].copy()),
            np.where(order.of_states(unit) > 0.0, order.of_states(unit), 1.0),
            self._labels,
            dt,
        )
        return validated_loop(mine, runs, delta, beta, scale, weights)

    def _fresh(self) -> Regulator:
        """A copy that has not planned yet."""
        other = copy.deepcopy(self)
        other.reset()
        return other

    def _inputs(self, states: Floats) -> Floats:
        """What the loop gives along a run."""
        loop = self._fresh()
        return np.array([loop(x) for x in states])

    def _path(self, x0: Floats, steps: int) -> Floats:
        """The states of the loop around its model."""
        loop, system = self._fresh(), self._system
        order = order_of("system", system.labels, self._labels)
        c = system.c if isinstance(system, Identified) else None
        offset = np.zeros((self.n, 0)) if c is None else order.of_states(c)[:, None]
        Theta = np.hstack([*order.matrices(system.A, system.B), offset])
        path = [x0]
        for _ in range(steps):
            path.append(trajectory(Theta, path[-1], loop(path[-1])[None])[-1])
        return np.array(path)

    def plot(self, *, figure: Figure | SubFigure | None = None) -> Figure:
        """Draw the calls in the log: states, inputs within their limits, time of each call.

        An input is thick where it is at one of its limits; held ones are marked.

        Parameters
        ----------
        figure : matplotlib Figure or SubFigure, optional
            Where to draw; the default is a new figure.

        Returns
        -------
        matplotlib Figure

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        InputError
            If the log is empty.

        Examples
        --------
        >>> import stochens_rs as se
        >>> loop, x = se.regulate(([[1.0]], [[1.0]]), 3, limits=(-1.0, 1.0)), 5.0
        >>> for _ in range(8):
        ...     x = x + loop([x])[0]
        >>> len(loop.plot().axes)
        3
        """
        system = self._system
        names = self._labels.state_axes, self._labels.input_axes
        dt = system.dt if isinstance(system.dt, float) else None
        return drawn_calls(self.log, self._task, names, dt, figure)

    def __repr__(self) -> str:
        said = f", the last: {counted(self.log[-10:])}" if self._log else ""
        return (
            f"<Regulator: n={self.n} m={self.m}, {show.counted(self.steps)}, "
            f"{show.number_of(self._calls, 'call')}{said}>"
        )

    def _repr_html_(self) -> str:
        low, high = self.limits
        calls = self.log
        bounds = f"{show.vector(low)} to {show.vector(high)}" if self._task.bounded else None
        rows = [("limits", bounds), *facts(calls), ("held in a row", self._held or None)]
        return show.card(self, rows, curves(calls, self.n))


def checked_model(system: Any) -> System | Identified:
    """A model as it is, anything else as a `System`."""
    return system if isinstance(system, Identified) else System.from_any(system)
