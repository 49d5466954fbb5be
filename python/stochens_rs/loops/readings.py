"""`ReadingLoop`: a loop from readings."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from time import perf_counter
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.names import Labels
from .._base.records import trusted
from .._base.running import warn
from .._base.types import ArrayLike, Floats, Status
from ..controls.of_model import Record, Start, Wanted, cost_of_outputs, plan_from, start_of, task_of
from ..controls.plan import Plan
from ..controls.set_point import (
    Aim,
    Target,
    in_window,
    moves,
    nearest_point,
    or_zero,
    points_of,
    rest_at,
    set_point,
    targets,
    way_of,
    weights_of,
)
from ..exceptions import InputError, NonFiniteError, SolverError
from ..export.header import BEYOND, LARGEST, evidence
from ..feedback import Loop, LoopCertificate, Watched
from ..feedback.bounds import Rest, Tube
from ..feedback.certificate import judged, sentence
from ..identification.changes import source_of
from ..identification.model import Model
from ..limits.limits import Cost, LimitsLike, as_cost, as_limits, steps_ahead
from ..limits.problem import forecast_of, loop_of, read_task
from ..validation.held_out import PredictedLoop
from .keep import Found, Keep, Kept, cut, lapsed, limits_of_readings, resumed
from .loop import ControlLoop
from .regulator import condensed, continued, warn_of_growth
from .sensors import Range, bounded, explained

ReadingStatus: TypeAlias = Status | Literal["filling", "cannot start", "gain"]
FALSE_ALARM = 1e-5  # of a call: the probability that a true reading is rejected
SURE = 3.0  # deviations of the noise: what a loop runs with knows the next readings so well
EASE = 0.01  # of the weights of the inputs of a gain: what those cost that are known beforehand
STRAYS = 20  # calls, more than those that follow, whose readings no system explains
SETTLES = 100  # calls behind the last target in which what was added to the inputs dies out
MOVED = 0.01  # of the range of the limits: how far the set point may move without a new problem


class Reading(NamedTuple):
    """One call of a `ReadingLoop`.

    Attributes
    ----------
    y : ndarray, shape (n_outputs,)
        What was read; nan where it was missing.
    predicted : ndarray, shape (n_outputs,), or None
        What the model predicted one step before; None at the first call.
    u : ndarray, shape (m,)
        The input returned.
    bias : ndarray, shape (n_outputs,)
        The estimate of a constant that is added to the next readings.
    status : str
        "gain", or that of the plan; "filling" or "cannot start" while the window does not say
        enough; "held": the last input once more. With `keep` also "kept": an earlier plan goes on;
        "infeasible": no plan was accepted yet, the input is ``K x`` within the limits; "unproved":
        the promise has ended. Of a gain "unproved" while the readings do not follow the model, one
        is not read for 20 calls, or is far outside of the logs and does not integrate.
    seconds : float
        The time that the call took [s].
    target : ndarray, shape (n_outputs,)
        What the outputs should be next; nan where one is free.
    rejected : bool
        Whether it was rejected: what was predicted counts in its place.
    reason : str or None
        What was wrong with the reading and what was done, or what the loop waits for.
    watch : Watched or None
        What ``loop.watch`` says, if there is one.
    """

    y: Floats
    predicted: Floats | None
    u: Floats
    bias: Floats
    status: ReadingStatus
    seconds: float
    target: Floats
    rejected: bool = False
    reason: str | None = None
    watch: Watched | None = None


class ReadingLoop(ControlLoop[Reading]):
    """Feedback ``u = loop(y)`` from readings y to an input.

    Made by `regulate` for a model of outputs, or for a `Loop` of one. It keeps the window of the
    model, for which no observer is needed. One thread at a time.

    What is missing in the window is estimated by a Kalman filter, from the first call on: the loop
    runs where what it does not know moves the next readings by 3 standard deviations of their noise
    at most, and `max_missing` calls in a row at most had no reading. Else it holds its last input.
    A reading y is missing if it is nan, inf or a million times the largest in the data, or rejected
    as too far from what was predicted, p, for every system of the region, ``||T (y - p)|| > q + ||T
    D|| ||W z||``, T whitening the noise: a true one with at most 1e-5 a call, in the event of the
    region, for Gaussian noise without a disturbance. Three rejected in a row, or three that are off
    by the same among a few others, are a change of the plant: they are taken for true. Every call
    that is not as usual says so in the log.

    With `offset_free` a constant e that is added to each next reading is learned, ``e+ = e + L (y -
    p)``, and cut to what the limits of the inputs can take off. If the loop then comes to rest,
    with no input at a limit, the outputs `rest.exact` are at their targets, whatever constants act
    on inputs, states and sensors, and whatever the plant is; m of them, or of their combinations,
    can be held. Where a sensor reads wrong, it is held at the wrong place.

    With `keep` limits of readings are kept with a probability: ``loop.kept``, see `Kept`.

    Parameters
    ----------
    system : Model or Loop
        A model of outputs, or the gain of one.
    steps, target, limits, cost, offset_free, hold, max_missing, keep
        As in `regulate`.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> rng = np.random.default_rng(3)
    >>> y, u = np.zeros((200, 1)), rng.standard_normal((199, 1))
    >>> for t in range(1, 199):
    ...     y[t + 1] = 1.2 * y[t] - 0.4 * y[t - 1] + u[t] + 0.1 * rng.standard_normal(1)
    >>> model = se.identify(se.Trajectories([y], [u], outputs=True), window=se.Window(lags=2))
    >>> loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True)
    >>> loop([0.0]), loop([1.0]).round(1), loop.full
    (array([0.]), array([-0.7]), True)
    >>> plan = se.control(model, record=(y, u), target=[1.0], steps=5)
    >>> plan.predicted_outputs[-2:].ravel().round(3), plan.bound(0.05).tube.shape
    (array([1., 1.]), (6,))
    """

    __slots__ = (
        "_acted",  # the input before that of the last call
        "_ahead",  # whether the last plan looked ahead along targets
        "_aimed",  # of `_point`: target, where free outputs stay, inputs
        "_asked",
        "_at_rest",
        "_bias",
        "_drift",
        "_fading",  # what is added since a swap, and its factor from call to call; 0: none
        "_forward",
        "_given",  # the inputs that are measured, now and to come, (h, m); nan where one is chosen
        "_high",
        "_law",
        "_learning",
        "_lost",  # calls in a row in which each output was not read
        "_low",
        "_max_missing",
        "_measures",  # whether there are inputs that are measured
        "_most",
        "_moves",  # the target from that of `_point`, its slope, and inputs
        "_past",  # the first states of the window, if the outputs had been at the targets
        "_point",
        "_policy",
        "_range",  # of the outputs in the logs
        "_rate",
        "_rows",
        "_runs",
        "_solved",
        "_solver",
        "_started",
        "_steps",
        "_strays",  # calls of late whose readings no system of the region explains
        "_system",  # A, B, c of the plans
        "_way",  # of the window along the targets to come, and these
        "_weights",
        "_window",
        "kept",
        "model",
    )

    _system: tuple[Any, ...]
    _way: tuple[Floats, Floats] | None

    def __init__(
        self,
        system: Model | Loop,
        steps: int | None,
        target: Target | None,
        limits: LimitsLike,
        cost: Cost | None,
        offset_free: bool | float | None,
        hold: ArrayLike | None,
        max_missing: int,
        keep: Keep | None = None,
    ) -> None:
        gain = system if isinstance(system, Loop) else None
        model = system.model if isinstance(system, Loop) else system
        if not isinstance(model, Model) or model.window is None:
            raise InputError(
                "`offset_free` must be left out for a model of states: pass what was read as "
                "outputs=, and identify(data, window=)"
            )
        if offset_free is None:
            raise InputError(
                "`offset_free` must be given for a model of outputs: True where a constant "
                "disturbance may act at the inputs, else False"
            )
        m, labels, within = model.m, model.labels, as_limits(limits)
        policy: Any
        task: Any  # there is one: R is given
        asked, outputs, self._system = None, None, ()
        weights = cost_of_outputs(model, as_cost(cost))
        if gain and (steps is not None or cost is not None):
            raise InputError("`steps` and `cost` must be left out for a Loop, which has its gain")
        self.kept: Kept | None = None
        if weights.reference is not None:
            raise InputError("`cost` must have no reference for a model of outputs: give `target`")
        if gain:
            K = 1
            if within.x is not None:
                raise InputError(
                    "`limits` of outputs need a loop that plans: regulate(model, steps, ...)"
                )
            if within.forecast is not None:
                raise InputError("`forecast` must be None for a Loop, see `gain(given=)`")
            start = np.zeros(model.n)
            task = read_task(model.n, m, K, start, within, Cost(), labels, gain.given)
            fixed, of_inputs = np.isin(model.input_names, gain.given), model.data.pairs()[1]
            policy, ahead = gain.K.copy(), np.where(fixed, of_inputs.mean(axis=0), np.nan)[None]
        else:
            K = validation.size("steps", steps)
            weights = replace(weights, R="auto") if weights.R is None else weights
            outputs, (ahead, _) = weights_of(model, weights), forecast_of(within, K, labels)
            given, weights = weights, continued(weights, model, within, K)
            hard = keep is not None and within.soft is False
            wider = replace(within, soft=None) if hard else within
            task, self._system, _ = task_of(model, K, np.zeros(model.n), wider, weights)
            policy, asked = task, (K, within, weights)
            if weights is given:
                warn_of_growth(task, *self._system[:2])
        self._rate = np.full(m, np.inf) if task.rate is None else task.rate
        if keep is not None:
            made = limits_of_readings(system, task, keep, within, offset_free)
            policy, self._system, self.kept = made
        drift = None
        if not isinstance(offset_free, bool | np.bool_):
            drift = np.full(m, validation.positive("offset_free", offset_free))
        elif offset_free:
            # a copy: NumPy can crash on strided arrays where memory runs out
            drift = 0.01 * np.sqrt(np.square(model.data.pairs()[1].copy()).mean(axis=0))
        self._low, self._high, self._weights = task.low[0].copy(), task.high[0].copy(), outputs
        fixed = ~np.isnan(ahead[0])
        self._low[fixed], self._high[fixed] = -np.inf, np.inf
        before = np.zeros(m) if task.previous is None else task.previous
        safe = before if hold is None else validation.vector("hold", hold, length=m).copy()
        first = np.clip(safe, self._low, self._high)
        if hold is not None and ((first != safe) | (np.abs(safe - before) > self._rate)).any():
            raise InputError(
                "`hold` must be within the limits of the inputs, and within `rate` of `previous`, "
                f"got {safe.tolist()}"
            )
        super().__init__(trusted(Labels, model.outputs, model.input_names), first)
        self._max_missing = validation.size("max_missing", max_missing, minimum=0)
        self._policy, self._asked, self._drift, self._steps = policy, asked, drift, K
        self._of(model, gain)
        self._solved = np.zeros(model.n), np.zeros(m)  # of the problem that is solved, at rest
        self._rows, self._way = self._padded(targets(model, target)), None
        here = model.data.pairs()[0].mean(axis=0)
        self._given, self._measures, self._acted = ahead, bool(fixed.any()), self._safe
        self._require(self._rows, here)
        self._aimed = self._rows[0], here, ahead[-1]
        self._restore((None, ()))
        self._forward = self._feed_forward()
        self._forget()

    def _of(self, model: Model, gain: Loop | None) -> None:
        """Take what the loop needs of a model, and of the cost of its gain."""
        self.model, self._learning, self._law = model, bias_of(model, self._drift), None
        if gain is not None and gain.S is not None and gain.R is not None:
            self._law = gain.S, gain.R
        most = BEYOND * np.hstack([np.abs(one).max(axis=0) for one in model.data.pairs()[:2]])
        self._most = np.where(most > 0.0, most, np.finfo(np.float64).max)

    def _restore(self, core: Any) -> None:
        warm, window, *kept = core
        if kept:
            self.kept = resumed(kept[0])
        self._point = self._without_limits(*self._aimed)
        y, u, _ = self.model.data.pairs()
        self._range = Range(self.model)
        wide = np.hstack([one.std(axis=0) + np.ptp(one, axis=0) for one in (y, u)])
        self._window = _core.Readings(
            self.model.regressors.core,
            np.ascontiguousarray(self.model.coefficients),
            self._learning[2],
            (y.mean(axis=0), wide, self._most[: y.shape[1]].copy()),
            gate_of(self.model),
            self._learning,
            self._toward(),
            self._max_missing,
        )
        self._window.resume(*window)
        self._solver: _core.Loop | None = None  # of plans, for a disturbance near this one
        if not isinstance(self._policy, np.ndarray):
            self._solver_at(*self._solved).resume(warm)

    def _saved(self) -> Any:
        warm, window = self._solver and self._solver.warm(), self._window.state()
        return warm, window, None if self.kept is None else self.kept.__getstate__()

    def _forget(self) -> None:
        self._safe = np.where(np.isfinite(self._rate), self._last, self._safe)
        self._window.resume()
        self._bias: Floats = np.zeros(self.model.n_outputs)
        self._fading, self._past = (np.zeros(self.model.m), 0.0), self._rows[0]
        self._runs = self._started = self._at_rest = self._ahead = False
        self._strays, self._lost = 0, np.zeros(self.model.n_outputs, dtype=int)
        if self.kept is not None:
            self.kept.reset()
            self._solver = None
        if not isinstance(self._policy, np.ndarray):
            self._solver_at(*self._solved).resume(None)

    def __call__(
        self,
        y: ArrayLike,
        *,
        applied: ArrayLike | None = None,
        target: Target | None = None,
        given: ArrayLike | None = None,
    ) -> Floats:
        """Compute the input for the readings now.

        Parameters
        ----------
        y : array_like, shape (n_outputs,)
            The readings; nan for one that is missing.
        applied : array_like, shape (m,), optional
            The input that acted since the last call, where it was not what that returned.
        target : as `target`, optional
            Another target from this call on.
        given : array_like, one number for each of ``gain(given=)`` or of a forecast
            What is measured of these inputs now; nan: as at the last call. A loop that plans also
            takes rows of them: now, and what is forecast for the next steps, of which the last
            stays.

        Returns
        -------
        ndarray, shape (m,)
            The input, within its limits, with what was given at its places; `hold` until the window
            tells enough.

        Raises
        ------
        InputError, InputTypeError
            If the readings have another shape or are no numbers, the target is none, or another
            thread is in a call. The loop is then as it was before the call.
        """
        started, labels = perf_counter(), self.labels
        with self._turn():
            read = validation.measured("y", y, labels.states)
            acted, why = self._last, []
            if applied is not None:
                acted = validation.measured("applied", applied, labels.inputs)
                wrong = validation.broken(acted, self._most[len(read) :], labels.inputs)
                if wrong is not None:
                    acted, why = self._last, [wrong]
            now = self._measured(given) if given is not None or self._measures else self._given
            if target is not None:
                self._follow(targets(self.model, target))
            if self._measures:
                self._given = now
                self._window.aim(self._toward())
            with np.errstate(all="ignore"):
                return self._stepped(read, acted, why, started)

    def _measured(self, given: Any) -> Floats:
        """The inputs that are measured and forecast; one that cannot be true is as before."""
        names, own = self.model.input_names, np.flatnonzero(~np.isnan(self._given[0]))
        if (given is None) != (not len(own)):
            wanted = ", ".join(names[j] for j in own) or "left out"
            raise InputError(f"`given` must be {wanted}, got {validation.show(given)}")
        rows: Any = given if np.ndim(given) == 2 and len(np.asarray(given)) else [given]
        if len(rows) > 1 and self._asked is None:
            raise InputError(f"`given` must be one row for a gain, got {len(rows)}")
        ahead, now = np.full((len(rows), len(names)), np.nan), self._given[0, own]
        for row, one in zip(ahead, rows, strict=True):
            found = validation.measured("given", one, [names[j] for j in own])
            good = np.abs(found) <= self._most[self.model.n_outputs + own]
            row[own] = now = np.where(good, found, now)
        return ahead

    def _stepped(self, y: Floats, acted: Floats, why: list[str], started: float) -> Floats:
        """Take the reading in, or what is predicted in its place."""
        found = self._window.step(y, acted, self._bias, self._started)
        predicted, bias, off, believed, follows, x, whole = found
        u = self._last
        other = bool(why)
        status: ReadingStatus = "held" if self._started else "filling"
        if not whole:
            why.append(str(validation.broken(y, self._most[: len(y)], self.labels.states)))
        if believed:
            why.append("rejected 3 times, and so no false reading: now taken for true")
        rejected = off > 1.0 and not believed
        if rejected:
            why.append(f"rejected, {off:.3g} times as far off as the gate is wide")
        if (kept := self.kept) is not None:
            now = self._window.now
            known = follows == "runs" and now is not None and now[1]
            if not known:
                why += kept.end("not all readings came")
                if kept.ended is None and follows == "runs":
                    follows = "waits"  # the first window is one of true readings
                kept.since += follows != "runs"
            elif other or not np.array_equal(acted, u):
                why += kept.end("another input acted")
        if follows == "runs":
            try:
                if not self._started and np.isnan(self._rows[0]).any():
                    self._aim(self._aimed[0], x[: len(y)].copy())  # what is free stays where it is
                    self._window.aim(self._toward())
                u, status = self._input(x, bias, acted, why)
            except InputError:  # what overflows, or leaves no room within the limits
                follows = "lost"
        self._runs = follows == "runs"
        if follows == "lost":
            self._window.resume()
            why.append("the window is lost: it begins anew")
        else:
            self._bias = bias
        if status == "gain":
            status = self._judged(y, off, rejected, why)
        if follows == "waits":
            waits, stuck = self._waits()
            why.append(waits)
            status = "cannot start" if stuck and not self._started else status
        self._started = self._started or self._runs
        how: Any = {"predicted": predicted, "rejected": rejected, "reason": "; ".join(why) or None}
        return self._returned(u, y, acted, started, status=status, **how)

    def _judged(self, y: Floats, off: float, rejected: bool, why: list[str]) -> ReadingStatus:
        """Whether what was proved of the gain can be true of these readings."""
        seen = np.abs(y) <= self._most[: len(y)]
        self._strays = min(max(self._strays + (1 if off > 1.0 else -1), 0), 2 * STRAYS)
        self._lost = np.where(seen, 0, self._lost + 1)
        wrong = None if rejected else self._range.outside(np.where(seen, y, np.nan))
        i = int(self._lost.argmax())
        if self._lost[i] >= STRAYS:
            wrong = f"{self.model.outputs[i]} was not read in the last {self._lost[i]} calls"
        if self._strays >= STRAYS:
            wrong = "the readings do not follow the model: for many calls no system explains them"
        if wrong is None:
            return "gain"
        why.append(f"{wrong}: nothing is proved")
        return "unproved"

    def _waits(self) -> tuple[str, bool]:
        """What the loop waits for, and whether it will do."""
        now = self._window.now
        assert now is not None
        _, _, excess, since, calls, read, stuck = now
        known = f"the next readings are known to {math.sqrt(excess):.3g} deviations of their noise"
        if stuck:
            i = int(np.argmin(read))
            name = self.model.outputs[i]
            return f"of {name} {read[i]} of {calls} were read: {known}, must be 3", stuck
        left = show.number_of(max(1, self.model.regressors.fill + 1 - since), "complete reading")
        if excess <= SURE**2:
            return f"the window fills: {left} in a row to come", stuck
        return f"{known}: {SURE:g} will do, or {left} in a row", stuck

    def start(self, record: Record) -> Floats:
        """Fill the window from a record that just happened.

        Parameters
        ----------
        record : (outputs, inputs)
            Rows that were read, the last one now, and the inputs between them, as in `control`.

        Returns
        -------
        ndarray, shape (m,)
            The input for the last reading.

        Raises
        ------
        InputError, InputTypeError
            If the record does not fill the window.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> rng = np.random.default_rng(3)
        >>> y, u = np.zeros((200, 1)), rng.standard_normal((199, 1))
        >>> for t in range(1, 199):
        ...     y[t + 1] = 1.2 * y[t] - 0.4 * y[t - 1] + u[t] + 0.1 * rng.standard_normal(1)
        >>> model = se.identify(se.Trajectories([y], [u], outputs=True), window=se.Window(lags=2))
        >>> loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True)
        >>> loop.start(([[0.2], [0.1]], [[0.0]])).round(2)
        array([-0.02])
        >>> loop.full
        True
        """
        started = perf_counter()
        with self._turn():
            found = start_of(self.model, record)
            self._begin()
            self._given = np.where(np.isnan(self._given[:1]), np.nan, found.acted)
            self._window.aim(self._toward())
            self._window.start(found.x)
            why: list[str] = []
            u, status = self._input(found.x, self._bias, found.acted, why)
            self._at_rest, self._runs, self._started = found.at_rest, True, True
            about = u, found.read, np.full(self.model.m, np.nan), started
            reason = "; ".join(why) or None
            return self._returned(*about, predicted=None, status=status, reason=reason)

    def _input(self, x: Floats, bias: Floats, acted: Floats, why: list[str]) -> tuple[Floats, Any]:
        """The input within the limits, and how it was found: ``u = u_s + K (x - x_s)``."""
        self._acted, (more, by) = acted, self._fading
        if by:
            self._fading = more * by, by
        u: Floats | None
        if isinstance(self._policy, np.ndarray):
            added = self._forward[0] + more if by else self._forward[0]
            law = self._policy, added, self._rate, self._low, self._high
            u, status = self._point.input(x, bias, self._moves, law, acted), "gain"
        else:
            if self.kept is None:
                plan, status, _ = self._planned(x, bias, acted)
                v = plan[0]
            else:
                v, status = self._kept(self.kept, x, bias, acted, why)
            near = np.minimum(np.maximum(v, acted - self._rate), acted + self._rate)
            within = np.minimum(np.maximum(near, self._low), self._high)
            u = within if math.isfinite(v.sum()) else None
            if self.kept is not None:
                why += cut(self.kept, v, within, acted)
        if u is None:
            raise NonFiniteError("`y` is too large: the input overflows")
        if self.kept is not None and self.kept.ended:
            status = "unproved"
        return u, status

    def _planned(self, x: Floats, bias: Floats, acted: Floats) -> Found:
        """The best plan from here, its status and gap."""
        xs, us, way = self._coming(bias)
        solver, off = self._solver_at(xs, us), np.zeros(len(self._system[0]))
        if self.kept is not None:
            off += self._whole(x, xs, acted) - self._whole(xs, xs, us)
        else:
            off[: len(x)] = x - xs
            if np.isfinite(self._rate).any():
                # the nearest input from which one step leads back within the limits
                reached = np.clip(acted, self._low - self._rate, self._high + self._rate)
                solver.follow(reached - us)
        if way is not None:
            solver.toward(np.pad(way, [(0, 0), (0, len(off) - len(bias))]))
        found = solver.solve(off, None)
        plan = found.control[: self._steps * len(us)].reshape(-1, len(us)) + us
        return plan, found.status, found.gap

    def _whole(self, x: Floats, read: Floats, acted: Floats) -> Floats:
        """The states of the plans: the window, and behind it readings, inputs and their changes."""
        if self.kept is None or self.kept.behind is None:
            return np.hstack([x, read[: len(self._system[0]) - len(x)]])
        (reads, acts), rates = self.kept.behind, len(self.kept.below) > 0
        behind = *[read[: self.model.n_outputs]] * reads, *[acted] * acts
        changes = np.zeros(len(acted)), self.kept.proof.K @ x - acted
        return np.hstack([x, *behind, *changes * rates])

    def _kept(
        self, kept: Kept, x: Floats, bias: Floats, acted: Floats, why: list[str]
    ) -> tuple[Floats, Status]:
        """The input of the newest plan that keeps the limits, or of the one before."""

        def planned() -> Found:
            plan, status, gap = self._planned(x, bias, acted)
            return np.clip(plan, self._low, self._high), status, gap

        def again() -> Found:
            self._solver = None
            return planned()

        try:
            whole = self._whole(x, x, acted)[: kept.n]
            _, u, status, _ = kept.choose(whole, planned(), again, math.inf)
            why += lapsed(kept, whole)
        except SolverError as error:
            self._solver, u, status = None, kept.proof.K @ x, "infeasible"
            why.append(str(error))
        return u, status

    def _coming(self, bias: Floats) -> tuple[Floats, Floats, Floats | None]:
        """Window and inputs at rest, and along targets to come how far the window is to be off."""
        if not self._ahead and len(self._rows) == 1:
            return *self._point.moving(bias, *self._moves), None
        start, slope, off = way_of(self._rows, self._steps, self._aimed[0])
        xs, us = self._point.moving(bias, start, slope, self._moves[2])
        pole = self.model.regressors.pole or 0.0
        self._past = pole * self._past + (1.0 - pole) * self._rows[0]
        way = in_window(self.model, off, or_zero(self._past - xs[: len(bias)]))
        settled = np.abs(way) <= 1e-12 / BEYOND * self._most[: len(bias)]
        self._ahead = len(self._rows) > 1 or not settled.all()
        return xs, us, way

    def _solver_at(self, xs: Floats, us: Floats) -> _core.Loop:
        """The problem whose limits are those from a point of rest, or from one that is near."""
        task: Any = self._policy
        far, before = self._far, np.hstack(self._solved[::-1])
        near = (np.abs(np.hstack([us, xs]) - before)[: len(far)] <= far).all()
        if self._solver is None:
            (A, B, _), kept = self._system, self.kept
            within = task if kept is None else kept.tightened(task)
            self._solver, near = loop_of(within, A, B, None), np.False_
        if self._measures or not near:
            given = steps_ahead(self._given, task.steps) if self._measures else None
            # at rest the first lags or filters are the readings, which may stand behind the window
            self._solver.about(us, self._whole(xs, xs, us), given)
            self._solved = xs, us
        return self._solver

    @property
    def _far(self) -> Floats:
        """How far a point of rest may move without a new problem: the inputs, and limited outputs.

        The first lags or filters of the window at rest are the outputs.
        """
        room: Floats = self._high - self._low
        task = self._policy
        if not isinstance(task, np.ndarray) and task.state_low is not None:  # of (x, y)
            first, last = self.model.n, self.model.n + self.model.n_outputs
            room = np.hstack([room, (task.state_high[0] - task.state_low[0])[first:last]])
        return MOVED * room

    def _aim(self, target: Floats, now: Floats) -> None:
        """Choose the rows that hold a target; outputs that are free and integrate stay at `now`."""
        self._aimed = target, now, self._measured_last
        self._point = self._without_limits(*self._aimed)
        self._forward = self._feed_forward()

    @property
    def _measured_last(self) -> Floats:
        """The inputs that are measured, at the end of a plan; nan where one is chosen."""
        given: Floats = self._given[: self._steps][-1]
        return given

    def _without_limits(self, target: Floats, now: Floats, given: Floats) -> _core.SetPoint:
        """The set point as it is asked for: what the inputs cannot do is cut in each call."""
        inf = np.full(self.model.m, np.inf)
        return nearest_point(self.model, Aim(target, self._weights, (-inf, inf), now, given))[1]

    def _require(self, rows: Floats, now: Floats) -> None:
        """Refuse targets that are too large, or rest in no system: the first and the last row."""
        if (np.abs(rows) > self._most[: rows.shape[1]]).any():
            raise InputError("`target` is too large: a million times the largest in the data")
        limits, given = (self._low, self._high), self._given[0]
        for row in rows[:: max(1, len(rows) - 1)]:
            try:
                set_point(self.model, Aim(row, self._weights, limits, now, given))
            except InputError as error:
                if not self._measures:
                    raise
                # they may be others, and then so is what the loop can hold
                own = zip(self.model.input_names, given, strict=True)
                at = ", ".join(f"{name} = {v:.4g}" for name, v in own if not np.isnan(v))
                warn(f"with {at}, {error}")

    def _follow(self, rows: Floats) -> None:
        """Go to other targets, from this call on; the state of the loop stays."""
        names = "_rows", "_point", "_aimed", "_forward", "_moves", "_way", "_past"
        before = {name: getattr(self, name) for name in names}
        now = self._window.now
        here = self._aimed[1] if now is None else now[0][: rows.shape[1]]
        with np.errstate(all="ignore"):
            self._require(rows, here)
            try:
                self._past = self._past if self._ahead else self._rows[0]
                self._rows = rows = self._padded(rows)
                if (np.isnan(rows[0]) == np.isnan(self._aimed[0])).all():
                    self._forward = self._feed_forward()
                else:
                    self._aim(rows[0], here)
                self._window.aim(self._toward())
            except BaseException:
                for name, value in before.items():
                    setattr(self, name, value)
                raise

    def _padded(self, rows: Floats) -> Floats:
        """Targets to come, the last one for some more calls."""
        if len(rows) == 1 or self._law is None:
            return rows
        return np.vstack([rows, np.repeat(rows[-1:], SETTLES, axis=0)])

    def _returned(self, u: Floats, y: Floats, acted: Floats, started: float, **how: Any) -> Floats:
        """The input of a call that began at `started`, written down; next comes the next target."""
        about = {"bias": self._bias, "target": self._rows[0]}
        if len(self._rows) > 1:
            self._rows, self._forward = self._rows[1:], self._forward[1:]
            self._way = self._way and (self._way[0][1:], self._way[1][1:])
            self._window.aim(self._toward())
        if self._measures:
            u = np.where(np.isnan(self._given[0]), u, self._given[0])
        took = perf_counter() - started
        return self._entered(Reading(y=y, u=u, seconds=took, **about, **how), u, y, acted)

    def _toward(self) -> tuple[Floats, Floats, Floats, Floats]:
        """What a bias adds to the inputs that hold the target, these inputs, and the limits."""
        row, (way, slopes) = self._rows[0], moves(self._rows, 1, self._aimed[0])
        self._moves = way[0], slopes[0], or_zero(self._measured_last - self._aimed[2])
        inputs = np.minimum(np.maximum(self._at(row)[1], self._low), self._high)
        return self._point.of_bias[len(row) :].copy(), inputs, self._low, self._high

    def _at(self, row: Floats) -> tuple[Floats, Floats]:
        """The window and the inputs at rest at a target, without a bias."""
        none = np.zeros(len(row))
        return self._point.moving(none, or_zero(row - self._aimed[0]), none, self._moves[2])

    def _feed_forward(self) -> Floats:
        """What targets to come add to the input of the gain, (h, m), 0 without weights.

        With it the loop of the model goes the way ``x*`` of the least ``sum |y - r|_Q^2 + EASE |u -
        u_s|_R^2``, Q and R of the gain: these are weighed against noise, and what is known
        beforehand has none.
        """
        rows, model = self._rows, self.model
        forward: Floats = np.zeros((len(rows), model.m))
        if self._law is None or len(rows) == 1:
            self._way = None
            return forward
        (S, R), none, n, p = self._law, np.zeros(model.n_outputs), model.n, model.n_outputs
        own, chosen = np.zeros(model.m), np.isnan(self._given[0])
        steps, slopes = moves(rows, len(rows), self._aimed[0])
        found = [self._point.moving(none, *one, own) for one in zip(steps, slopes, strict=False)]
        x, u = (np.array(each) for each in zip(*found, strict=True))
        A, B, K, H = model.A, model.B, self._policy, model.coefficients @ model.loop.J
        Q = (S - A.T @ S @ (A + B @ K))[:p, :p]  # of Riccati's equation
        w = u[:, ~chosen] @ B[:, ~chosen].T + (0.0 if model.c is None else model.c)
        start = self._point.moving(none, steps[0], none, own)[0]
        if self._way is not None and np.allclose(rows[0], self._way[1][0], equal_nan=True):
            start = self._way[0][0]
        of = A, B[:, chosen], H[:, :n], H[:, n : n + model.m][:, chosen]
        parts = *of, Q, EASE * R[np.ix_(chosen, chosen)], K[chosen], x, u[:, chosen], w
        A, B, C, D, Q, R, K, x, u, w = map(np.ascontiguousarray, parts)
        forward[:, chosen], way = _core.preview((A, B, C, D), (Q, R), K, (x, u, w), start)
        if not np.isfinite(forward).all():
            raise NonFiniteError("`target` is too large: the inputs overflow")
        forward[-1] = 0.0  # the last target stays
        self._way = way, rows
        return forward

    def _readings(self) -> Floats:
        most = self._most[: len(self._bias)]
        calls = [(np.abs(one.y) <= most, np.nan if one.rejected else one.y) for one in self._log]
        return np.array([np.where(seen, y, np.nan) for seen, y in calls])

    def _drawn(self) -> dict[str, Any]:
        none = np.full(len(self._bias), np.nan)
        guess = [none if one.predicted is None else one.predicted for one in self._log]
        return {"target": np.array([one.target for one in self._log]), "predicted": np.array(guess)}

    @property
    def _dt(self) -> float | None:
        return self.model.dt

    @property
    def target(self) -> Floats:
        """The target of the next call, (n_outputs,); nan where an output is free.

        It can be set: to a target as in `regulate`, or to rows of one for each call to come, of
        which the last stays. A loop that plans, or has a gain from weights, looks ahead along
        them; other gains follow the slope. Constants and ramps are followed exactly by the model.
        """
        row: Floats = self._rows[0].copy()
        return row

    @target.setter
    def target(self, target: Target) -> None:
        with self._turn():
            self._follow(targets(self.model, target))

    @property
    def rest(self) -> Rest:
        """Where the loop will rest at its last target, and how far from it any system may rest.

        Of the region at 95 %, with what is held as in `exact`, which needs `offset_free`.
        """
        about = self._weights, (self._low, self._high), self._aimed[1], self._measured_last
        found = rest_at(self.model, nearest_point(self.model, Aim(self._rows[-1], *about))[1])
        return found if self._learning[0].any() else replace(found, exact=())

    @property
    def full(self) -> bool:
        """Whether the window is full enough for the loop to run."""
        return self._runs

    @property
    def bias(self) -> Floats:
        """The estimate of a constant that is added to each next reading, (n_outputs,)."""
        return self._bias.copy()

    @property
    def explanation(self) -> str | None:
        """What the bias that was learned at rest says, beside noise and the error of the model.

        A constant that acts at the inputs, or elsewhere (a load), or a sensor that reads wrong by
        so much, or "undecided which": without more outputs than inputs the first explains all, and
        of n outputs one is named alone where ``n >= m + 2``, as far as they move the next readings
        in different directions. None where nothing acts that noise and the region do not explain
        (with 1e-4 at rest), or the loop is not at rest for long enough: some 100 calls without a
        missing reading.
        """
        L = self._learning[0]
        if not L.any():
            return None
        calls = math.ceil(1.0 / np.abs(np.linalg.eigvals(L)).min())
        recent = list(self._log)[-calls:]
        if len(recent) < calls or any(one.reason or one.predicted is None for one in recent):
            return None
        T = np.linalg.inv(np.linalg.cholesky(self._learning[2]))
        half = recent[calls // 2 :]
        off = np.linalg.norm(T @ np.array([self._bias - half[0].bias, self._bias]).T, axis=0)
        if off[0] > max(1.0, 0.2 * off[1]):
            return None
        names = "y", "u", "bias"
        y, u, bias = (np.mean([getattr(one, name) for one in half], axis=0) for name in names)
        return explained(self.model, bias, L, y, u, len(half))

    @property
    def limits(self) -> tuple[Floats, Floats]:
        """The limits (low, high) of the input that is returned, each (m,)."""
        return self._low.copy(), self._high.copy()

    @property
    def plan(self) -> Plan:
        """The plan of a loop that plans, from the last reading on if no new one comes.

        ``loop.plan.bound(delta)`` bounds the readings along this plan, followed to its end; the
        loop replaces it at the next reading, so that nothing follows for all time. For loops that
        estimate no disturbance, behind a window of which no reading was missing.
        """
        if self._asked is None or self.kept is not None:
            raise InputError(
                "`plan` needs a loop that plans, without `keep`: regulate(model, steps, ...)"
            )
        if self._learning[0].any():
            raise InputError("`plan` needs offset_free=False: its bound knows no estimated bias")
        now = self._window.now
        if now is None or not now[1]:
            raise InputError("`plan` needs a full window, of which no reading was missing")
        steps, limits, cost = self._asked
        if limits.rate is not None:
            limits = replace(limits, previous=self._acted)
        if limits.forecast is not None:
            columns = zip(self.model.input_names, self._given.T, strict=True)
            now_on: Any = {name: one for name, one in columns if not np.isnan(one[0])}
            limits = replace(limits, forecast=replace(limits.forecast, values=now_on))
        read = validation.frozen(self._log[-1].y.copy())
        start = Start(now[0], read, self._at_rest, self._acted)
        # the target of the last call is gone; a plan has those of the steps behind it
        rows = np.vstack([self._rows[:1], self._rows])
        point = self._without_limits(rows[: steps + 1][-1], self._aimed[1], self._measured_last)
        return plan_from(self.model, start, (point, rows, self._past), Wanted(steps, limits, cost))

    def _predictions(self) -> PredictedLoop:
        if self._measures:
            raise InputError("`validate` is for loops without measured inputs: their way is open")
        model, noise = self.model, self.model.covariance
        unit = np.ones(model.n_outputs) if noise is None else np.sqrt(np.diag(noise))
        sizes = self._rows[-1].copy(), np.where(unit > 0.0, unit, 1.0)
        about = model.n_outputs, model.m, *sizes, self.labels, model.dt
        return PredictedLoop(self._path, self._along, *about)

    def _path(self, run: Floats) -> Floats:
        """The readings of a run until the loop begins, and from there on those of its model."""
        loop, model, path = self._fresh(), self.model, run.copy()
        ahead = model.coefficients @ model.loop.J
        for k in range(len(run) - 1):
            u = loop(path[k])
            now = loop._window.now
            if now is not None and loop._started:
                path[k + 1] = ahead @ np.hstack([now[0], u, np.ones(int(model.intercept))])
        return path if loop._started else np.full_like(path, np.inf)

    def swap(self, gain: Loop) -> None:
        """Go on with another gain from the next call on, without a jump of the input.

        The window, targets and limits are kept. The bias that was learned changes by the difference
        of what both models predict of the next readings. The difference of the last input and that
        of the new gain is added to the next input, and dies out as the slowest mode of the new
        loop: a stable loop comes to rest where it would without it.

        Parameters
        ----------
        gain : Loop
            Of the same or another model of these outputs and inputs, with the same window:
            ``regulate(gain, ...).certificate()`` says what is certain of it.

        Raises
        ------
        InputError, InputTypeError
            If the loop plans, or the gain is of another window, is not stable for its model, or
            cannot hold the target; or another thread is in a call. The loop then goes on with the
            old one.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> rng = np.random.default_rng(3)
        >>> y, u = np.zeros((200, 1)), rng.standard_normal((199, 1))
        >>> for t in range(1, 199):
        ...     y[t + 1] = 1.2 * y[t] - 0.4 * y[t - 1] + u[t] + 0.1 * rng.standard_normal(1)
        >>> model = se.identify(se.Trajectories([y], [u], outputs=True), window=se.Window(lags=2))
        >>> loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True)
        >>> before = [loop([1.0]) for _ in range(3)]
        >>> loop.swap(se.gain(model, 1.0, 100.0))
        >>> bool(abs(loop([1.0]) - before[-1]) < 0.2)
        True
        """
        model, fixed = validation.instance("gain", gain, Loop).model, ~np.isnan(self._given[0])
        if self._asked is not None or not isinstance(model, Model):
            raise InputError("`gain` must be of a model, and takes the place of a gain, not a plan")
        one, other = (replace(of.regressors, found=None) for of in (model, self.model))
        if one != other or gain.given != tuple(np.array(one.inputs)[fixed].tolist()):
            raise InputError("`gain` must have the signals, the window and `given` of this loop")
        radius = max(float(np.abs(gain.E).max()), np.finfo(float).tiny)
        if radius >= 1.0:
            raise InputError(f"`gain` must be stable for its model, its radius is {radius:.4g}")
        new, now, more = copy.copy(self), self._window.now, np.zeros(model.m)
        new._policy = gain.K.copy()
        new._of(model, gain)
        new._strays = 0
        new._require(new._rows, new._aimed[1])
        new._restore(new._saved())
        new._forward, new._fading = new._feed_forward(), (more, radius)
        if self._runs and now is not None:
            if new._learning[0].any():  # the next readings are predicted as before
                row = np.hstack([now[0], self._last, np.ones(int(model.intercept))])
                before, after = (of.coefficients @ of.loop.J @ row for of in (self.model, model))
                new._bias = self._bias + before - after
            more = self._last - new._input(now[0], new._bias, self._acted, [])[0]
        new._fading = np.where(fixed, 0.0, more), radius
        with self._turn():
            for name in self.__slots__:
                setattr(self, name, getattr(new, name))

    def certificate(self, delta: float = 0.05) -> LoopCertificate:
        """Check whether all systems of a region are stable in this loop, estimate included.

        Parameters
        ----------
        delta : float, default 0.05
            The probability that the true system is not in the region of the model.

        Returns
        -------
        LoopCertificate
            Of the states (x, e), e the learned bias, away from the limits. If it is certified, the
            loop of every system of the region comes to rest at one point for each constant that
            acts, and with `offset_free` at the targets of `rest.exact`.

        Raises
        ------
        InputError, InputTypeError
            If the loop plans ahead: only one with a gain has a certificate.

        Notes
        -----
        ``u = K x + F e + constant``, ``F = T_u - K T_x``, T what one unit of e adds to the inputs
        and the window that hold the set point, and ``e+ = e + L (y - y^)``. The error of a sensor
        is never removed.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> rng = np.random.default_rng(3)
        >>> y, u = np.zeros((200, 1)), rng.standard_normal((199, 1))
        >>> for t in range(1, 199):
        ...     y[t + 1] = 1.2 * y[t] - 0.4 * y[t - 1] + u[t] + 0.1 * rng.standard_normal(1)
        >>> model = se.identify(se.Trajectories([y], [u], outputs=True), window=se.Window(lags=2))
        >>> loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True)
        >>> loop.certificate(0.05).status
        'certified'
        """
        if not isinstance(self._policy, np.ndarray):
            raise InputError(
                "`certificate` needs a loop with a gain: regulate(gain(model, Q, R), ...). Of one "
                "that plans anew nothing is proved for all time; plan.bound(delta) bounds each plan"
            )
        model, K, names = self.model, self._policy, self.model.labels
        region = model.region(validation.probability("delta", delta))
        p, L = model.n_outputs, self._learning[0]
        r = p if L.any() else 0
        source = source_of(model, region, L if r else None)
        if r:
            K = np.hstack([K, self._point.of_bias[p:] - K @ self._point.states_of_bias])
            more = tuple(f"bias[{name}]" for name in model.outputs)
            names = Labels((*names.states, *more), names.inputs)
        xs, us = self._at(self._rows[-1])
        target = np.hstack([xs, np.zeros(r), us])
        about = source.entered(region), K, names, model
        return judged(*about, target=target if target.any() else None, source=source)

    def tube(self, steps: int, *, delta: float = 0.05, noise: float | None = None) -> Tube:
        """Bound where every system of the region goes from here, along the targets to come.

        Parameters
        ----------
        steps : int
            The number of steps K.
        delta : float, default 0.05
            As in `certificate`.
        noise : float, optional
            As in `LoopCertificate.tube`.

        Returns
        -------
        Tube
            Around the way of the centre of the region in this loop, for which no constant acts that
            is not learned yet; infinite unless the loop is certified. It holds as long as no input
            is at a limit and no reading is missing or rejected.

        Raises
        ------
        InputError, InputTypeError
            As `certificate`; or if the window is not full, a reading in it was missing, inputs are
            measured, for many calls no system of the region explains the readings or one did not
            come, or an input of the centre is beyond its limits.

        Notes
        -----
        ``u = ub + K (x - xb) + F (e - eb)`` about the centre (xb, eb) under the same targets: their
        feed-forward is a function of the targets alone.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> rng = np.random.default_rng(3)
        >>> y, u = np.zeros((200, 1)), rng.standard_normal((199, 1))
        >>> for t in range(1, 199):
        ...     y[t + 1] = 1.2 * y[t] - 0.4 * y[t - 1] + u[t] + 0.1 * rng.standard_normal(1)
        >>> model = se.identify(se.Trajectories([y], [u], outputs=True), window=se.Window(lags=2))
        >>> loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True)
        >>> u = loop.start(([[0.2], [0.1]], [[0.0]]))
        >>> loop.tube(20).radii[:2].round(2)
        array([0.  , 0.01])
        """
        proof, now = self.certificate(delta), self._window.now
        if now is None or not now[1] or not self._runs:
            raise InputError("`tube` needs a full window, of which no reading was missing")
        if max(self._strays, *self._lost) >= STRAYS:
            raise InputError("`tube` has no proof: readings are missing, or do not fit the model")
        if self._measures:
            raise InputError("`tube` is for loops without measured inputs: their way is not known")
        K, model = validation.size("steps", steps), self.model
        ways, slopes = moves(self._rows, K, self._aimed[0])
        (more, by), forward = self._fading, steps_ahead(self._forward, K)
        x, e, u = now[0], self._bias, self._last
        first = np.hstack([x, e[: proof.region.n - len(x)]])
        inputs = np.empty((K, model.m))
        c = np.zeros(model.n) if model.c is None else model.c
        for k in range(K):
            inputs[k] = u
            x, e = model.A @ x + model.B @ u + c, e - self._learning[0] @ e
            xs, us = self._point.moving(e, ways[k], slopes[k], self._moves[2])
            u = self._policy @ (x - xs) + forward[k] + us + more * by**k
        changes = np.abs(np.diff(inputs, axis=0, prepend=self._acted[None]))
        far = (np.clip(inputs, self._low, self._high) != inputs) | (changes > 1.000001 * self._rate)
        if far.any():
            k, j = np.argwhere(far)[0]
            raise InputError(
                f"`tube` is about inputs within limits: {model.input_names[j]} of the centre, "
                f"{inputs[k, j]:.3g}, would be cut in step {k}"
            )
        return proof.tube(first, K, inputs=inputs, noise=noise)

    def to_c(
        self, path: Any, *, name: str = "controller", proof: LoopCertificate | None = None
    ) -> None:
        """Write the loop as one C99 header, as it is now: with its target, and an empty window.

        Parameters
        ----------
        path : path
            The file, ``controller.h``.
        name : str, default "controller"
            What its names begin with: ``controller_start(&s)``, then ``controller_step(&s, y, u)``
            with the readings y, nan where one is missing. Between two calls
            ``controller_target(&s, r)`` is ``loop.target = r``, and ``s.applied`` can be set to the
            input that acted if it was not u.
        proof : LoopCertificate, optional
            Of a loop with a gain: its sentence stands in the head. Default: `certificate` at 5 %.

        Raises
        ------
        InputError, InputTypeError
            If an argument cannot be used, or the proof is of another gain, or of a loop that plans;
            or the loop has measured inputs, targets to come, a free output that integrates, or too
            many limits of outputs for a header of 1 MB.

        Examples
        --------
        >>> import pathlib, tempfile, numpy as np, stochens_rs as se
        >>> rng = np.random.default_rng(3)
        >>> y, u = np.zeros((200, 1)), rng.standard_normal((199, 1))
        >>> for t in range(1, 199):
        ...     y[t + 1] = 1.2 * y[t] - 0.4 * y[t - 1] + u[t] + 0.1 * rng.standard_normal(1)
        >>> model = se.identify(se.Trajectories([y], [u], outputs=True), window=se.Window(lags=2))
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "controller.h"
        >>> se.regulate(se.gain(model, 1.0, 1.0), offset_free=True).to_c(path)
        >>> "controller_real target[" in path.read_text()
        True
        """
        model, row, now = self.model, self._rows[0], self._aimed[1]
        if self.kept is not None:
            raise InputError("`to_c` writes no loop with `keep`: its promise needs its plans")
        if len(self._rows) > 1 or self._measures:
            raise InputError("`to_c` writes loops of one target and without inputs that are given")
        places = [self._without_limits(row, at, self._given[0]).place for at in (now, now + 1.0)]
        if not np.allclose(places[0], places[1]):
            raise InputError("`to_c` needs a target of each output that integrates: some are free")
        law, part = {"law": "u = us + K (x - xs), x the window"}, ["policy_gain"]
        sizes, tables, about = {"M": model.m}, {"K": self._policy}, law
        # a gain without weights follows the slope
        more = 2 if self._law is None and self._asked is None else 1
        if isinstance(self._policy, np.ndarray):
            certified = self.certificate()
            about |= sentence(certified.K, certified if proof is None else proof)
        else:
            task, (A, B) = self._policy, self._system[:2]
            sizes, tables, about = condensed(task, A, B, first=model.n)
            part, about = ["horizon", "policy_plan"], about | sentence(None, proof)
        sizes |= {"N": model.n, "TARGETS": more}
        about["target"] = "the outputs wanted at the next call"
        about["target"] += ", and at the one behind it" * (more > 1)
        tables |= {"far": self._far, "most_rate": self._rate}
        counts, numbers = self._window.tables()
        none, own = np.zeros(model.n_outputs), np.zeros(model.m)
        base = np.hstack(self._point.moving(none, none, none, own))
        for of, at in ("target", [1.0, 0.0]), ("slope", [0.0, 1.0]):
            ways = (np.outer(at, unit) for unit in np.diag(~np.isnan(row) * 1.0))
            each = (self._point.moving(none, step, slope, own) for step, slope in ways)
            moved = [np.hstack(one) - base for one in each]
            tables[f"xs_of_{of}"], tables[f"us_of_{of}"] = np.split(np.transpose(moved), [model.n])
        tables["xs_of_bias"] = self._point.states_of_bias
        tables["us_of_bias"] = self._point.of_bias[len(row) :]
        tables["xs"], tables["us"] = self._at(row)
        tables |= {"first_target": or_zero(row), "floor": self._low, "ceiling": self._high}
        tables |= {"begin": self._safe, "most": np.minimum(self._most, LARGEST)}
        about |= evidence(model.labels, model.dt, model, model.outputs)
        tables |= dict(numbers)
        self._write(path, name, [*part, "readings"], sizes | dict(counts), tables, about)

    def __repr__(self) -> str:
        full = "" if self.full else ", the window is not full"
        also = ", offset-free" if self._learning[0].any() else ""
        return (
            f"<ReadingLoop: {', '.join(self.model.outputs)} to "
            f"{', '.join(self.model.input_names)}{also}, {show.number_of(len(self._log), 'call')}"
            f"{full}>"
        )


def gate_of(model: Model) -> _core.Gate | None:
    """The gate of a model, also of one in doubt; None where no bound of its noise is known."""
    found = bounded(model)
    return None if found is None else _core.Gate.of(found[0].core, found[1], FALSE_ALARM)


def bias_of(model: Model, drift: Floats | None) -> tuple[Floats, Floats, Floats]:
    """The gain L of a bias that is learned, what is not known of it, and the noise, each (p, p)."""
    p, read = model.n_outputs, model.data.pairs()[0]
    squares, noise = (read.std(axis=0) + np.ptp(read, axis=0)) ** 2, model.covariance
    if noise is None and drift is not None:
        raise InputError("`offset_free` must be False: the noise of the model is not known")
    noise = np.diag(1e-6 * squares) if noise is None else noise
    noise = noise + 1e-12 * np.diag(squares + np.diag(noise))  # of exact data: rounding
    if drift is None:
        return np.zeros((p, p)), np.zeros((p, p)), noise
    return (*_core.bias_gain(points_of(model).of_inputs, drift, noise), noise)
