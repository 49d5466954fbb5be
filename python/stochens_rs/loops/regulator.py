"""`Regulator`: a loop that plans anew at every state."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.names import order_of, weight
from .._base.types import ArrayLike, Floats, Status
from ..certificates.of_model import trajectory
from ..exceptions import InputError, NonFiniteError, ShapeError, SolverError
from ..export.header import believed, evidence
from ..feedback import Watched
from ..feedback.certificate import sentence
from ..identification.identified import Identified
from ..limits.limits import Cost, Limits
from ..limits.problem import (
    Horizon,
    Task,
    forecast_of,
    inputs_within,
    loop_of,
    read_task,
    weight_of_inputs,
)
from ..system.system import System
from ..validation.held_out import PredictedLoop
from .keep import Found, Kept, cut, lapsed, resumed
from .loop import ControlLoop, counted

MOST = 33_000  # numbers of plans with limits of states in C: 1 MB of text


class Call(NamedTuple):
    """One call of a `Regulator`.

    Attributes
    ----------
    x : ndarray, shape (n,)
        What was measured.
    u : ndarray, shape (m,)
        The input returned.
    status : str
        That of the plan; "held"; "kept" where an earlier plan goes on; "unproved" where the limits
        that were promised with `keep` are promised no more.
    gap : float
        ``J - min J`` of the plan is at most this; nan for a held or kept input.
    seconds : float
        The time that the call took [s].
    reason : str or None
        Why the state could not be used ("held"), no plan is accepted ("infeasible"), or a promise
        has ended.
    watch : Watched or None
        What ``loop.watch`` says, if there is one.
    """

    x: Floats
    u: Floats
    status: Status
    gap: float
    seconds: float
    reason: str | None = None
    watch: Watched | None = None


class WorstTime(NamedTuple):
    """What the search for a plan computes in a call at most.

    Attributes
    ----------
    factorizations : int
        Factorizations of a matrix, and updates of one.
    operations : float
        Operations with numbers, about.
    seconds : float
        Their time on this machine, by the time that each part takes now [s].
    """

    factorizations: int
    operations: float
    seconds: float


def condensed(
    task: Task, A: Floats, B: Floats, c: Floats | None = None, first: int = 0
) -> tuple[Any, Any, Any]:
    """The sizes and tables of plans in C, and what the head says of them.

    The first states of a model of readings are its window, whose limits are those behind them.
    """
    (K, m), n, rates = task.low.shape, len(A), int(task.rate is not None)
    low, high, limited = task.low.ravel(), task.high.ravel(), np.zeros(0, dtype=np.int64)
    if task.state_low is not None and task.state_high is not None:
        if task.soft is None:
            raise InputError("`to_c` writes soft limits of states: leave out `soft=False`")
        limited = np.flatnonzero(np.isfinite(task.state_low) | np.isfinite(task.state_high))
        low = np.hstack([low, task.state_low.ravel()[limited]])
        high = np.hstack([high, task.state_high.ravel()[limited]])
    size = len(low)
    flash = size * (size + 1) // 2 + size * (n + 3)
    if len(limited) and flash > MOST:
        raise InputError(
            f"`to_c` would write {flash} numbers for {K * m} inputs and {len(limited)} limited "
            f"states, must be {MOST} at most (1 MB): give fewer steps, or limits of fewer states"
        )
    inverse, free, offset = Horizon(task, A, B, c).core.condensed()
    most = 4 * (size + rates * K * m) + 20
    H = np.zeros((size, size))  # the inverse, and the states
    H[np.tril_indices(size)] = inverse
    wide = int(np.linalg.cond(H + np.tril(H, -1).T) > 1e4)  # single precision has 7 digits
    sizes = {"N": n, "M": m, "STEPS": K, "RATES": rates, "EXCHANGES": most, "WIDE": wide}
    sizes |= {"STATES": len(limited), "RESTS": n - first if len(limited) else 0}
    tables: dict[str, Any] = {"inverse": inverse, "map": free[:, : first or n], "offset": offset}
    tables |= {"low": low, "high": high, "column": limited % n - first}
    tables |= {"rate": np.zeros(m) if task.rate is None else task.rate}
    work = f"{most} at most, each {9 * size**2} operations at most; no factorization"
    memory = f"{8 * flash} bytes of tables, {4 * size * (size + 16)} of state, in double precision"
    law = f"the first input of the best plan over {K} steps within the limits"
    law += ", those of states at a cost" * bool(len(limited))
    return sizes, tables, {"law": law, "exchanges": work, "plans": memory}


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
    kept : Kept, optional
        The limits that are kept with a stated probability.
    """

    __slots__ = (
        "_held",
        "_matrices",
        "_most",
        "_plan",
        "_solver",
        "_system",
        "_task",
        "_time_limit",
        "kept",
    )
    _matrices: tuple[Floats, Floats, Floats | None]  # A, B and c in the order of this loop

    def __init__(
        self,
        system: System | Identified,
        task: Task,
        time_limit: float | None = None,
        kept: Kept | None = None,
    ) -> None:
        checked, limit = checked_model(system), time_limit
        self._time_limit = None if limit is None else validation.positive("time_limit", limit)
        self.labels = checked.labels
        self.kept = None if kept is None else validation.instance("kept", kept, Kept)
        self._set(checked, validation.instance("task", task, Task))
        self._plan: Floats | None = None
        self._held = 0
        self._last = np.zeros(self.m) if task.previous is None else task.previous
        super().__init__(self.labels, self._start())

    def _acting(self) -> Task:
        """The task from the input that acts now on."""
        task = self._task
        return task if task.rate is None else replace(task, previous=self._last.copy())

    def _start(self) -> Floats:
        """The input before the first plan: the one that acts, or 0, within the limits."""
        none = np.zeros(self.m) if self._task.rate is None else self._last
        return np.clip(none, self._task.low[0], self._task.high[0])

    def _set(self, system: System | Identified, task: Task, warm: Any = None) -> None:
        """Compute all but what depends on the state, for calls that begin at the limits `warm`.

        Nothing changes if that raises.
        """
        sizes, wanted = system.B.shape, (task.reference.shape[1], task.low.shape[1])
        if sizes != wanted:
            raise ShapeError(
                "`system` must have n={} and m={} as this loop, got n={} and m={}".format(
                    *wanted, *sizes
                )
            )
        order, n = order_of("system", system.labels, self.labels), wanted[0]
        c, seen = None, np.zeros(n)
        if isinstance(system, Identified):
            c = None if system.c is None else order.of_states(system.c)
            seen = order.of_states(seen if system.largest is None else system.largest[:n])
        A, B = (np.ascontiguousarray(M) for M in order.matrices(system.A, system.B))
        within = task if self.kept is None else self.kept.tightened(task)
        self._solver = loop_of(within, A, B, c)
        self._solver.resume(warm)
        self._system, self._task, self._matrices = system, task, (A, B, c)
        self._most = believed(seen)

    def to_c(self, path: Any, *, name: str = "controller") -> None:
        """Write the loop as one C99 header, as it is now: begun anew.

        Parameters
        ----------
        path : path
            The file, ``controller.h``.
        name : str, default "controller"
            What its names begin with: ``controller_start(&s)``, then ``controller_step(&s, y, u)``
            with the states y for the first input u of the best plan. ``controller_target(&s, r)``
            is ``loop.target = r``.

        Raises
        ------
        InputError, InputTypeError
            If an argument cannot be used, the loop keeps limits with a probability, or has limits
            of states that are hard or too many for a header of 1 MB.
        SolverError
            If an input has no weight.

        Notes
        -----
        ``H^-1`` of the plans is a table, with limited states ``[I; G] H^-1 [I; G]'``. A dual
        active-set method (Goldfarb and Idnani 1983) begins at the active limits of the call before
        and exchanges one at a time; the head says how many at most, and the work of each. A call
        that would need more returns a safe input, and a code. Inputs agree with those of this loop
        to rounding: 1e-12 of the terms that add up to them.

        Examples
        --------
        >>> import pathlib, tempfile, stochens_rs as se
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "controller.h"
        >>> se.regulate(([[1.0]], [[1.0]]), 3, limits=(-1.0, 1.0)).to_c(path)
        >>> "exchanges: 32 at most" in path.read_text()
        True
        """
        if self.kept is not None:
            raise InputError("`to_c` writes no loop with `keep`: its promise needs its plans")
        task, (A, B, c) = self._task, self._matrices
        goal = task.reference if task.follows else task.reference[:1]
        none = np.zeros_like(task.reference)
        sizes, tables, about = condensed(replace(task, reference=none), A, B, c)

        units = np.eye(goal.size).reshape(-1, *goal.shape)
        each = (Horizon(task, A, B, wanted=none + unit).core.condensed() for unit in units)
        tables["aims"] = np.transpose([offset for _, _, offset in each])
        tables |= {"begin": self._start(), "most": self._most, "goal": goal}
        sizes["TARGETS"] = len(goal)
        rows = "a row for each step of a plan" if task.follows else "the states wanted from then on"
        about["target"] = rows
        about |= evidence(self.labels, self._dt, self._system, self.labels.states)
        about |= sentence(None, None)
        self._write(path, name, ["horizon", "regulator"], sizes, tables, about)

    def __call__(self, x: ArrayLike) -> Floats:
        """Compute the input for the state x.

        Parameters
        ----------
        x : array_like, shape (n,)
            The state now; nan where it is not known.

        Returns
        -------
        ndarray, shape (m,)
            The input, within its limits.

        Raises
        ------
        InputError, InputTypeError
            If x has another shape or is no numbers, or another thread is in a call. After any
            exception the loop is as it was before the call.

        Examples
        --------
        >>> import stochens_rs as se
        >>> loop = se.regulate(([[1.0]], [[1.0]]), 3, limits=(-1.0, 1.0))
        >>> loop([5.0]), loop([float("nan")]), loop.log[-1].status
        (array([-1.]), array([-1.]), 'held')
        """
        started = perf_counter()
        with self._turn():
            state = validation.measured("x", x, self.labels.states)
            reason = validation.broken(state, self._most, self.labels.states)
            status: Status = "held"
            plan, u, gap, held = self._plan, self._last, np.nan, 0
            try:
                found = None if reason else self._solve(state, self._time_limit)
            except NonFiniteError:
                found, reason = None, "`x` is too large: its cost overflows"
            if found is None:  # go on by the plan, behind its end with its last input
                held = self._held + 1
                if self.kept is not None:
                    self.kept.since += 1
                    reason = "; ".join([str(reason), *self.kept.end("a state was not known")])
                elif plan is not None:
                    u = np.clip(plan[min(held, self.steps - 1)], *self.limits)
            elif self.kept is None:
                plan, status, gap = found
                u = found[0][0].copy()
            else:
                plan, u, status, gap, reason = self._kept(self.kept, state, found, started)
            # nothing above has changed the loop, so that an exception leaves it as it was
            self._plan, self._held = plan, held
            if self._task.rate is not None:
                self._solver.follow(u)
            call = Call(state, u, status, gap, perf_counter() - started, reason)
            return self._entered(call, u, state, self._last)

    def _kept(
        self, kept: Kept, x: Floats, found: Found, started: float
    ) -> tuple[Floats | None, Floats, Status, float, str | None]:
        limit = self._time_limit

        def again() -> Found:
            self._set(self._system, self._acting())
            left = None if limit is None else max(limit - perf_counter() + started, 1e-6)
            return self._solve(x, left)

        try:
            plan, v, status, gap = kept.choose(x, found, again, started + (limit or np.inf))
            u = np.clip(v, kept.low[self.n :], kept.high[self.n :])
            reason = "; ".join(cut(kept, v, u, self._last) + lapsed(kept, x)) or None
            return plan, u, "unproved" if kept.ended else status, gap, reason
        except SolverError as error:
            self._set(self._system, self._acting())  # without what was kept back for the model
            u = np.clip(kept.proof.K @ x, kept.low[self.n :], kept.high[self.n :])
            return None, u, "infeasible", np.nan, str(error)

    def _solve(self, x: Floats, limit: float | None) -> Found:
        found = self._solver.solve(x, limit)
        shape = self._task.low.shape
        return found.control[: shape[0] * shape[1]].reshape(shape), found.status, found.gap

    def _saved(self) -> Any:
        return self._solver.warm(), None if self.kept is None else self.kept.__getstate__()

    def _restore(self, core: Any) -> None:
        warm, kept = core
        self.kept = resumed(kept)
        self._set(self._system, self._acting(), warm)

    def _forget(self) -> None:
        self._plan, self._held, self._safe = None, 0, self._start()
        if self.kept is not None:
            self.kept.reset()
            self._set(self._system, self._acting())
        self._solver.resume(None)

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

    def worst_time(self) -> WorstTime:
        """Bound the work of a call, whatever the state, by the most rounds that a search can take.

        Returns
        -------
        WorstTime
            Of the plan, without the microseconds that Python takes around it; infinite where the
            search has no bound: over hundreds of steps without rates, where the system grows by 1e4
            over the steps, or with `keep`.

        Raises
        ------
        InputError
            If another thread is in a call.

        Notes
        -----
        The work is bounded by construction; calls are faster by a factor of 10 to 1000. The time is
        no guarantee: it is the work times what its parts took when this was called, and an
        operating system can interrupt any call for longer. Hard limits of states that cannot be
        met, and plans that rounding hides, ask an interior point, whose work is not in it; the
        latter not with a `time_limit`.

        Examples
        --------
        >>> import stochens_rs as se
        >>> loop = se.regulate(([[1.0]], [[1.0]]), 3, limits=(-1.0, 1.0))
        >>> loop.worst_time().factorizations
        120
        """
        with self._turn():
            found = None if self.kept else self._solver.most()
        return WorstTime(0, np.inf, np.inf) if found is None else WorstTime(*found)

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
            self._set(checked, self._acting(), self._solver.warm())
            if not self.labels.given:
                self.labels = checked.labels

    @property
    def target(self) -> Floats:
        """Where the states are to stay, (n,), or the states wanted over the steps of each plan.

        It can be set: to a target, or to a row for each step of a plan, (K, n), if the loop has a
        reference; the last plan and the active limits are kept. All that does not depend on the
        state is then computed anew; a controller in C has a table for it.
        """
        rows = self._task.reference
        return rows.copy() if self._task.follows else rows[0].copy()

    @target.setter
    def target(self, target: ArrayLike) -> None:
        if self.kept is not None:
            raise InputError("`target` cannot change with `keep`: its limits are about one target")
        rows, shape = validation.array("target", target, ndim=(1, 2)), self.target.shape
        if rows.shape != shape:
            raise ShapeError(f"`target` must have shape {shape}, got {rows.shape}")
        with self._turn():
            task = replace(self._acting(), reference=rows + np.zeros_like(self._task.reference))
            self._set(self._system, task, self._solver.warm())

    def _predictions(self) -> PredictedLoop:
        covariance = getattr(self._system, "covariance", None)
        unit = np.ones(self.n) if covariance is None else np.sqrt(np.diag(covariance))
        unit = order_of("system", self._system.labels, self.labels).of_states(unit)
        target = validation.frozen(self._task.reference[-1].copy())
        sizes = target, np.where(unit > 0.0, unit, 1.0)
        return PredictedLoop(self._path, self._along, self.n, self.m, *sizes, self.labels, self._dt)

    def _path(self, run: Floats) -> Floats:
        """The states of the loop around its model, from the start of a run."""
        loop, (A, B, c) = self._fresh(), self._matrices
        Theta = np.hstack([A, B, np.zeros((len(A), 0)) if c is None else c[:, None]])
        path = [run[0]]
        for _ in run[1:]:
            path.append(trajectory(Theta, path[-1], loop(path[-1])[None])[-1])
        return np.array(path)

    @property
    def _dt(self) -> float | None:
        return self._system.dt if isinstance(self._system.dt, float) else None

    def _readings(self) -> Floats:
        unknown = np.full(self.n, np.nan)
        return np.array([unknown if call.status == "held" else call.x for call in self._log])

    def _drawn(self) -> dict[str, Any]:
        return {"target": self._task.reference[-1]}

    def __repr__(self) -> str:
        last = f", the last: {counted(self.log[-10:])}" if self._log else ""
        return (
            f"<Regulator: n={self.n} m={self.m}, {show.number_of(self.steps)}, "
            f"{show.number_of(self._calls, 'call')}{last}>"
        )


def continued(cost: Cost, system: System | Identified, within: Limits, steps: int) -> Cost:
    """`cost` itself, or where Q and R are given alone with the cost of the gain of `gain` as Qf."""
    if cost.Q is None or cost.Qf is not None or cost.R is None or isinstance(cost.R, str):
        return cost
    n, names = len(system.A), system.labels
    low, high = inputs_within(within, steps, names)
    chosen = np.flatnonzero((low < high).any(axis=0))
    free = np.isnan(forecast_of(within, 1, names)[0][0])
    Q, R = weight("Q", cost.Q, n, labels=names.states), weight_of_inputs(cost.R, free, names)
    A, B = np.ascontiguousarray(system.A), np.ascontiguousarray(system.B[:, chosen])
    R = np.ascontiguousarray(R[chosen][:, chosen])
    try:
        return replace(cost, Qf=_core.feedback_gain(A, B, Q, R, names.states)[1])
    except (SolverError, InputError):  # no gain holds all that Q weighs, or R is 0
        return cost


def warn_of_growth(task: Task, A: Floats, B: Floats) -> None:
    """Warn where a loop is unstable for its own model: its gain without limits, by columns."""
    if not task.stage.any() and not task.terminal.any():
        return
    n, m = B.shape
    cost = Cost(Q=task.stage, Qf=task.terminal, R="auto" if task.R is None else task.R)
    loop = loop_of(read_task(n, m, task.steps, np.zeros(n), Limits(), cost), A, B, None)
    gain = np.transpose([loop.solve(x, None).control[:m] for x in np.eye(n)])
    radius = np.abs(np.linalg.eigvals(A + B @ gain)).max()
    if radius > 1.0 + 1e-9:
        running.warn(
            f"the loop grows by {radius:.4g} in each call, for its own model and without limits: "
            "take more `steps`, or Cost(Q=, R=) without Qf, which then weighs all that follows"
        )


def checked_model(system: Any) -> System | Identified:
    """A model as it is, anything else as a `System`."""
    return system if isinstance(system, Identified) else System.from_any(system)
