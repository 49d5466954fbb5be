"""`ReadingLoop`: a loop from readings."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.names import Labels
from .._base.types import Floats, Status
from ..controls.of_model import Start, plan_from, start_of
from ..exceptions import InputError, NonFiniteError
from ..feedback import LoopCertificate
from ..identification.region import entered
from ..limits.solution import loop_of
from .loop import BEYOND, ControlLoop
from .window import Contents, ReadingWindow, gate_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ..controls.of_model import Record, Rest
    from ..controls.plan import Plan
    from ..identification.model import Model
    from ..limits.limits import Cost, LimitsLike
    from ..limits.problem import Task


ReadingStatus: TypeAlias = Status | Literal["filling", "cannot start", "gain"]
BELIEVED = 3  # rejected readings in a row, behind which the next ones are taken for true
SEEN = 1e-10  # of the largest effect of a constant input: what is less is rounding
MOVED = 0.01  # of the range of the limits: how far the disturbance may move without a new problem
USELESS = 1e12  # of the excess of a window: what it holds says nothing


@dataclass(frozen=True, eq=False)
class Reading:
    """One call of a `ReadingLoop`.

    Attributes
    ----------
    y : ndarray, shape (n_outputs,)
        What was read; nan where it was missing.
    predicted : ndarray, shape (n_outputs,), or None
        What the model predicted one step before; None at the first call.
    u : ndarray, shape (m,)
        The input returned.
    disturbance : ndarray, shape (m,)
        The estimate of what acts at the inputs.
    status : str
        "gain", or that of the plan; "filling" or "cannot start" while the window does not say
        enough; "held": the last input once more.
    seconds : float
        The time that the call took [s].
    reason : str or None
        What was wrong with the reading and what was done, or what the loop waits for.
    """

    y: Floats
    predicted: Floats | None
    u: Floats
    disturbance: Floats
    status: ReadingStatus
    seconds: float
    reason: str | None = None


class ReadingLoop(ControlLoop[Reading]):
    """Feedback ``u = loop(y)``: readings in, input out.

    Made by `regulate` for a model of outputs, or for a `Loop` of one. It keeps the window of the
    model, for which no observer is needed. One thread at a time.

    What is missing in the window is estimated by a Kalman filter, from the first call on: the loop
    runs where what it does not know moves the next readings by 3 standard deviations of their noise
    at most, and `max_missing` calls in a row at most had no reading. Else it holds its last input.
    A reading is missing if it is nan, inf or a million times the largest in the data, or if `Gate`
    rejects it: a true one with at most 1e-5 a call, in the event of the region, for Gaussian noise
    without a disturbance. Three rejected in a row are a change of the plant: they are taken for
    true. A disturbance is cut to what the limits can take off. Every call that is not as usual says
    so in the log.

    Parameters
    ----------
    model : Model
        Of outputs.
    rest : Rest
        Where to.
    policy : ndarray, shape (m, n), or Task
        The gain K, or what each plan minimises, in deviations from the rest point.
    low, high : ndarray, shape (m,)
        Limits of the inputs.
    drift : ndarray, shape (m,), or None
        By how much a disturbance at the inputs changes in a step; None: it is not estimated.
    hold : ndarray, shape (m,)
        The input while the window fills.
    max_missing : int
        How many readings in a row may be missing.
    asked : tuple (steps, limits, cost), optional
        Of a loop that plans, as they were given.

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
        "_along",
        "_asked",
        "_at_rest",
        "_d",
        "_gain",
        "_gate",
        "_high",
        "_hold",
        "_inner",
        "_low",
        "_most",
        "_most_missing",
        "_now",
        "_policy",
        "_raw",
        "_rejected",
        "_rest",
        "_runs",
        "_solved",
        "_solver",
        "_spread",
        "_started",
        "_window",
        "model",
    )

    def __init__(
        self,
        model: Model,
        rest: Rest,
        policy: Floats | Task,
        low: Floats,
        high: Floats,
        drift: Floats | None,
        hold: Floats,
        max_missing: int,
        asked: tuple[int, LimitsLike, Cost] | None = None,
    ) -> None:
        super().__init__(hold)
        self.model, self._rest, self._policy = model, rest, policy
        self._low, self._high, self._hold, self._most_missing = low, high, hold, max_missing
        self._asked = asked
        self._along, gain, self._spread = disturbance_of(model, rest, drift)
        self._gain = self._along @ gain
        self._inner = gain, rest.outputs @ self._along
        self._gate, self._window = gate_of(model), ReadingWindow(model)
        most = BEYOND * np.hstack([np.abs(one).max(axis=0) for one in model.data.pairs()[:2]])
        self._most = np.where(most > 0.0, most, np.finfo(np.float64).max)
        self._solver: _core.Loop | None = None  # of plans, for a disturbance near this one
        self._solved = np.zeros(model.m)
        self._forget()

    def _forget(self) -> None:
        self._cleared(self._hold)
        self._now: Contents | None = None
        self._raw: Contents | None = None  # the window with what was rejected
        self._d: Floats = np.zeros(self.model.m)
        self._rejected = 0  # in a row
        self._runs = self._started = self._at_rest = False
        if not isinstance(self._policy, np.ndarray):
            self._at(self._d)
        if self._solver is not None:
            self._solver.resume(None)

    def reset(self) -> None:
        """Forget the window, the disturbance and the log."""
        with self._turn():
            self._forget()

    def __getstate__(self) -> dict[str, Any]:
        with self._turn():
            warm = None if self._solver is None else self._solver.warm()
            names = {"_calls", "_last", "_log", *ReadingLoop.__slots__} - {"_solver", "_window"}
            return {"warm": warm, "_solver": None, **{name: getattr(self, name) for name in names}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        warm = state.pop("warm")
        super().__init__(state["_hold"])
        for name, value in state.items():
            setattr(self, name, value)
        self._window = ReadingWindow(self.model)
        if not isinstance(self._policy, np.ndarray):
            self._at(self._solved)
        if self._solver is not None:
            self._solver.resume(warm)

    def __call__(self, y: ArrayLike, *, applied: ArrayLike | None = None) -> Floats:
        """Compute the input for the readings now.

        Parameters
        ----------
        y : array_like, shape (n_outputs,)
            The readings; nan for one that is missing.
        applied : array_like, shape (m,), optional
            The input that acted since the last call, where it was not what that returned.

        Returns
        -------
        ndarray, shape (m,)
            The input, within its limits; `hold` until the window tells enough.

        Raises
        ------
        InputError, InputTypeError
            If the readings have another shape or are no numbers, or another thread is in a call.
            The loop is then as it was before the call.
        """
        started, model = perf_counter(), self.model
        with self._turn():
            read = validation.measured("y", y, model.outputs)
            acted, why = self._last, None
            if applied is not None:
                given = validation.measured("applied", applied, model.input_names)
                most = self._most[model.n_outputs :]
                why = validation.broken(given, most, model.input_names)
                acted = given if why is None else acted
            with np.errstate(all="ignore"):
                return self._stepped(read, acted, [] if why is None else [why], started)

    def _stepped(self, y: Floats, acted: Floats, why: list[str], started: float) -> Floats:
        """Take the reading in, or what is predicted in its place."""
        most, now, raw, rejected = self._most[: len(y)], self._now, self._raw, self._rejected
        seen = np.abs(y) <= most
        if not seen.all():
            why.append(str(validation.broken(y, most, self.model.outputs)))
        if now is None:
            return self._kept(y, None, self._window.begun(y, acted, seen), self._d, why, started)
        shift, model = self._rest.outputs @ self._d, self.model
        z = model._loop.J @ self._window.entering(now, acted)
        off = self._off(y, now, z, shift, seen) if self._started else 0.0
        if off > 1.0 and rejected < BELIEVED:
            raw = raw or now
            ahead = model._H @ model._loop.J @ self._window.entering(raw, acted) + shift
            raw, rejected = self._window.advanced(raw, y, acted, seen, ahead), rejected + 1
            seen = np.zeros(len(y), dtype=bool)
            why.append(f"rejected, {off:.3g} times as far off as the gate is wide")
        elif off > 1.0:
            now, raw = raw or now, None
            z = model._loop.J @ self._window.entering(now, acted)
            why.append(f"rejected {BELIEVED} times in a row: now taken for true")
        else:
            raw, rejected = None, 0
        predicted = model._H @ z + shift
        came = np.where(seen, y - predicted, 0.0) if self._started else np.zeros(len(y))
        d = self._d + self._gain @ came
        if self._gate is not None:  # alone, a cut would leave a part of a false reading behind
            d = self._rest.u - np.clip(self._rest.u - d, self._low, self._high)
        now = self._window.advanced(now, y, acted, seen, predicted)
        return self._kept(y, predicted, now, d, why, started, raw, rejected)

    def _off(
        self, y: Floats, now: Contents, z: Floats, shift: Floats, seen: NDArray[np.bool_]
    ) -> float:
        """How far off a reading is, in widths of the gate, with the disturbance or without it."""
        if self._gate is None or not seen.any():
            return 0.0
        off, more = y - self._gate.centre @ z, self._window.unknown(now)
        found = self._gate.excess(off, z, seen, more)
        if found > 1.0 and shift.any():
            more = self._spread if more is None else self._spread + more
            found = min(found, self._gate.excess(off - shift, z, seen, more))
        return found

    def _kept(
        self,
        y: Floats,
        predicted: Floats | None,
        now: Contents,
        d: Floats,
        why: list[str],
        started: float,
        raw: Contents | None = None,
        rejected: int = 0,
    ) -> Floats:
        """Keep what was found if it is finite, and give the input."""
        runs = now.tells(self._started) and now.missed <= self._most_missing
        u, status = self._last, "held" if self._started else "filling"
        good = math.isfinite(now.x.sum() + d.sum()) and now.excess < USELESS
        if good and runs:
            try:
                u, status = self._input(now.x, d)
            except NonFiniteError:
                good = False
        if not good:
            runs, self._now, self._raw, self._rejected = False, None, None, 0
            why.append("the window is lost: it begins anew")
        else:
            self._now, self._raw, self._rejected, self._d = now, raw, rejected, d
        self._runs, self._started = runs, self._started or runs
        if good and not runs:
            why.append(self._window.lacks(now))
            status = "cannot start" if now.stuck and not self._started else status
        return self._noted(y, predicted, u, status, started, "; ".join(why) or None)

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
        """
        started = perf_counter()
        with self._turn():
            found = start_of(self.model, record)
            u, status = self._input(found.x, np.zeros(self.model.m))
            self._forget()
            self._now, self._at_rest = self._window.full(found.x), found.at_rest
            self._runs = self._started = True
            return self._noted(found.read, None, u, status, started)

    def _input(self, x: Floats, d: Floats) -> tuple[Floats, Any]:
        """The input within the limits, and how it was found."""
        off = x + self._rest.states @ d - self._rest.x
        if isinstance(self._policy, np.ndarray):
            v, status = self._policy @ off, "gain"
        else:
            self._at(d)
            assert self._solver is not None
            found = self._solver.solve(off, None)
            v, status = found.control[: len(d)], found.status
        u = v + self._rest.u - d
        if not math.isfinite(u.sum()):
            raise NonFiniteError("`y` is too large: the input overflows")
        return np.minimum(np.maximum(u, self._low), self._high), status

    def _at(self, d: Floats) -> None:
        """Make the problem whose limits are those of ``v = u - u_s + d``, if they moved far."""
        task: Any = self._policy
        far = MOVED * (self._high - self._low)
        if self._solver is not None and (np.abs(d - self._solved) <= far).all():
            return
        by = d - self._rest.u
        moved = replace(task, low=task.low + by, high=task.high + by)
        warm = None if self._solver is None else self._solver.warm()
        A, B = (np.ascontiguousarray(one) for one in (self.model.A, self.model.B))
        solver = loop_of(moved, A, B, None)
        solver.resume(warm)
        self._solver, self._solved = solver, d

    def _noted(
        self,
        y: Floats,
        predicted: Floats | None,
        u: Floats,
        status: Any,
        started: float,
        reason: str | None = None,
    ) -> Floats:
        took = perf_counter() - started
        return self._entered(Reading(y, predicted, u, self._d, status, took, reason), u)

    @property
    def full(self) -> bool:
        """Whether the window tells enough, so that the loop runs."""
        return self._runs

    @property
    def disturbance(self) -> Floats:
        """The estimate of the constant that acts at the inputs, (m,)."""
        return self._d.copy()

    @property
    def limits(self) -> tuple[Floats, Floats]:
        """The limits (low, high) of the input that is returned, each (m,)."""
        return self._low.copy(), self._high.copy()

    @property
    def plan(self) -> Plan:
        """What a loop that plans would do from the last reading on, without any new one.

        ``loop.plan.bound(delta)`` bounds the readings along this plan, followed to its end; the
        loop replaces it at the next reading, so that nothing follows for all time. For loops that
        estimate no disturbance, behind a window of which no reading was missing.
        """
        if self._asked is None:
            raise InputError("`plan` needs a loop that plans: regulate(model, steps, ...)")
        if len(self._inner[0]):
            raise InputError(
                "`plan` needs offset_free=False: its bound knows no estimated disturbance"
            )
        now = self._now
        if now is None or now.P is not None:
            raise InputError("`plan` needs a full window, of which no reading was missing")
        steps, limits, cost = self._asked
        start = Start(now.x, validation.frozen(self._log[-1].y.copy()), self._at_rest)
        return plan_from(self.model, start, self._rest, steps, limits, cost)

    def certificate(self, delta: float = 0.05) -> LoopCertificate:
        """Say whether all systems of a region are stable in this loop, its estimate included.

        Parameters
        ----------
        delta : float, default 0.05
            The probability that the true system is not in the region of the model.

        Returns
        -------
        LoopCertificate
            Of the states (x, d), d the estimate of the disturbance, away from the limits. If it is
            certified, the loop goes to one point of rest for each constant disturbance.

        Raises
        ------
        InputError, InputTypeError
            If the loop plans ahead: only one with a gain has a certificate.

        Notes
        -----
        ``u = K x + (K E - I) d + constant``, E what one unit of a constant input adds to x, and
        ``d+ = d + Kd (y - y^)``, along the directions of d that the outputs show. With the target
        0, no intercept and a disturbance at the inputs the outputs come to rest at 0, for every
        system of the region; with as many inputs as outputs at the target. Else they rest near it.
        The bias of a sensor is never removed.
        """
        if not isinstance(self._policy, np.ndarray):
            raise InputError(
                "`certificate` needs a loop with a gain: regulate(gain(model, Q, R), ...). Of one "
                "that plans anew nothing is proved for all time; plan.bound(delta) bounds each plan"
            )
        model, K, names = self.model, self._policy, self.model.labels
        region = model.region(validation.probability("delta", delta))
        ABc, J, G = model._loop.ABc, model._loop.J, model._loop.G
        n, (gain, seen) = model.n, self._inner
        r = len(gain)
        if r:
            K = np.hstack([K, (K @ self._rest.states - np.eye(model.m)) @ self._along])
            J = np.hstack([J[:, :n], np.zeros((len(J), r)), J[:, n:]])
            wide = np.hstack([ABc[:, :n], np.zeros((n, r)), ABc[:, n:]])
            below = np.eye(r, wide.shape[1], n)
            below[:, n : n + r] -= gain @ seen
            ABc, G = np.vstack([wide, below]), np.vstack([G, gain])
            more = tuple(f"disturbance[{i}]" for i in range(r))
            names = Labels((*names.states, *more), names.inputs)
        ABc, J, G = (np.ascontiguousarray(one) for one in (ABc, J, G))
        inside = entered(region, ABc, J, G, model.m)
        target = np.hstack([self._rest.x, np.zeros(r), self._rest.u])
        return LoopCertificate._judged(
            inside, K, names, model, target=target if target.any() else None
        )

    def __repr__(self) -> str:
        said = "" if self.full else ", the window is not full"
        also = ", offset-free" if len(self._inner[0]) else ""
        return (
            f"<ReadingLoop: {', '.join(self.model.outputs)} to "
            f"{', '.join(self.model.input_names)}{also}, {show.number_of(len(self._log), 'call')}"
            f"{said}>"
        )


def disturbance_of(model: Model, rest: Rest, drift: Floats | None) -> tuple[Floats, Floats, Floats]:
    """The directions P (m, r) of the disturbances that the outputs show, and the gain (r, p).

    And the covariance of what is not known of them, as the outputs see it (p, p).

    ``d = P xi``, xi a random walk of steps of covariance I that is seen through ``rest.outputs P``;
    its steady gain is the transpose of that of a regulator of the transposed system.
    """
    m, p = model.m, model.n_outputs
    if drift is None:
        return np.zeros((m, 0)), np.zeros((0, p)), np.zeros((p, p))
    U, sizes, Vt = np.linalg.svd(rest.outputs * drift, full_matrices=False)
    r = int(np.count_nonzero(sizes > SEEN * sizes[0]))
    covariance = model.covariance
    if r == 0 or covariance is None:
        raise InputError(
            "`offset_free` must be False: the model does not say what constant inputs do to the "
            "outputs"
        )
    seen = np.ascontiguousarray((U[:, :r] * sizes[:r]).T)
    noise = np.ascontiguousarray(covariance)
    K, S, _ = _core.feedback_gain(np.eye(r), seen, np.eye(r), noise)
    return drift[:, None] * Vt[:r].T, -K.T, seen.T @ S @ seen
