"""`ReadingLoop`: feedback from readings, for models of outputs."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import html, validation
from .._base.reading import read
from .._base.signal_names import Labels
from .._base.types import Floats, Status
from ..exceptions import InputError, InputTypeError, NonFiniteError, ShapeError
from ..feedback import LoopCertificate
from .limited import loop_of
from .output_control import Start, plan_from, start_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..identification.model import Model
    from .constraints import Task
    from .cost import Cost
    from .limits import LimitsLike
    from .output_control import Record, Rest
    from .plan import Plan

ReadingStatus: TypeAlias = Status | Literal["filling", "gain"]
LOGGED = 1000  # calls that the log keeps
SEEN = 1e-10  # of the largest effect of a constant input: what is less is rounding
MOVED = 0.01  # of the range of the limits: how far the disturbance may move without a new problem


@dataclass(frozen=True, eq=False)
class Reading:
    """One call of a `ReadingLoop`.

    Attributes
    ----------
    y : ndarray, shape (n_outputs,)
        What was read; nan where it was missing.
    predicted : ndarray, shape (n_outputs,), or None
        What the model predicted one step before; None while the window fills.
    u : ndarray, shape (m,)
        The input returned.
    disturbance : ndarray, shape (m,)
        The estimate of what acts at the inputs.
    status : str
        "gain", that of the plan, or "filling".
    seconds : float
        The time that the call took [s].
    """

    y: Floats
    predicted: Floats | None
    u: Floats
    disturbance: Floats
    status: ReadingStatus
    seconds: float


class ReadingLoop:
    """Feedback ``u = loop(y)``: readings in, input out.

    Made by `regulate` for a model of outputs, or for a `Loop` of one. It keeps the window of the
    model, for which no observer is needed. One thread at a time.

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
    >>> model = se.identify(se.Trajectories([y], [u], outputs=True), lags=2)
    >>> loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True)
    >>> loop([0.0]), loop([1.0]).round(1), loop.full
    (array([0.]), array([-0.7]), True)
    >>> plan = se.control(model, record=(y, u), target=[1.0], steps=5)
    >>> plan.predicted_outputs[-2:].ravel().round(3), plan.bound(0.05).tube.shape
    (array([1., 1.]), (6,))
    """

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
        assert model.window is not None
        self.model, self._rest, self._policy = model, rest, policy
        self._low, self._high, self._hold, self._most = low, high, hold, max_missing
        self._asked = asked
        self._ahead = model._H @ model._loop.J
        self._tail = np.ones(int(model.intercept))
        self._along, gain = disturbance_of(model, rest, drift)
        self._gain = self._along @ gain
        self._inner = gain, rest.outputs @ self._along
        self._solver: _core.Loop | None = None  # of plans, for a disturbance near this one
        self._solved = np.zeros(model.m)
        self._log: deque[Reading] = deque(maxlen=LOGGED)
        self.reset()

    def reset(self) -> None:
        """Forget the window, the disturbance and the log."""
        m = self.model.m
        self._x: Floats | None = None
        self._y: list[Floats] = []
        self._u: list[Floats] = []
        self._acted, self._missed, self._d = self._hold.copy(), 0, np.zeros(m)
        self._at_rest = False
        self._log.clear()
        if not isinstance(self._policy, np.ndarray):
            self._at(self._d)
        if self._solver is not None:
            self._solver.resume(None)

    def __getstate__(self) -> dict[str, Any]:
        warm = None if self._solver is None else self._solver.warm()
        return {**vars(self), "_solver": None, "warm": warm}

    def __setstate__(self, state: dict[str, Any]) -> None:
        warm = state.pop("warm")
        vars(self).update(state)
        if not isinstance(self._policy, np.ndarray):
            self._at(self._solved)
        if self._solver is not None:
            self._solver.resume(warm)

    def __call__(self, y: ArrayLike, *, applied: ArrayLike | None = None) -> Floats:
        """Compute the input for the readings now.

        Parameters
        ----------
        y : array_like, shape (n_outputs,)
            The readings; nan for one that is missing, in place of which the model's prediction
            counts, at most `max_missing` steps in a row.
        applied : array_like, shape (m,), optional
            The input that acted since the last call, where it was not what that returned.

        Returns
        -------
        ndarray, shape (m,)
            The input, within its limits; `hold` until the window is full.

        Raises
        ------
        InputError, InputTypeError
            If the readings cannot be used, or too many in a row are missing. The loop is then as
            it was before the call.
        """
        started = perf_counter()
        read_now = self._checked(y)
        acted = self._acted
        if applied is not None:
            acted = validation.vector("applied", applied, length=self.model.m).copy()
        if self._x is None:
            return self._filled(read_now, acted, started)
        predicted = self._ahead @ np.concatenate([self._x, acted, self._tail])
        predicted += self._rest.outputs @ self._d
        known, missed = np.isnan(read_now), 0
        seen = read_now
        if known.any():
            missed, seen = self._missed + 1, np.where(known, predicted, read_now)
            if missed > self._most:
                raise InputError(
                    f"`y` must be known now: {html.number_of(self._missed, 'reading')} in a row "
                    f"were missing, of {self._most} that may be (max_missing)"
                )
        d = self._d + self._gain @ (seen - predicted)
        assert self.model.window is not None
        x = self.model.window._core.advance(self._x, seen, acted)
        u, status = self._input(x, d)
        self._x, self._d, self._missed = x, d, missed
        return self._noted(read_now, predicted, u, status, started)

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
        found = start_of(self.model, record)
        u, status = self._input(found.x, np.zeros(self.model.m))
        self.reset()
        self._x, self._at_rest = found.x, found.at_rest
        return self._noted(found.read, None, u, status, started)

    def _checked(self, y: ArrayLike) -> Floats:
        try:
            found = np.array(read("y", y), dtype=np.float64, ndmin=1)
        except (TypeError, ValueError):
            raise InputTypeError(f"`y` must be numbers, got {validation.show(y)}") from None
        if found.shape != (self.model.n_outputs,):
            wanted = ", ".join(self.model.outputs)
            raise ShapeError(f"`y` must have the readings {wanted}, got shape {found.shape}")
        if np.isinf(found).any():
            raise NonFiniteError("`y` must be finite, or nan where a reading is missing")
        return found

    def _filled(self, y: Floats, acted: Floats, started: float) -> Floats:
        window = self.model.window
        assert window is not None
        d, u, status = self._d, self._hold.copy(), "filling"
        if np.isnan(y).any():  # a window may not reach over a gap
            self._y, self._u = [], []
            return self._noted(y, None, u, "filling", started)
        ys, us = [*self._y, y], [*self._u, acted] if self._y else []
        if len(ys) > window.fill:
            x = window.state_of(np.array(ys), np.array(us))
            u, status = self._input(x, d)
            self._x, ys, us = x, [], []
        self._y, self._u = ys, us
        return self._noted(y, None, u, status, started)

    def _input(self, x: Floats, d: Floats) -> tuple[Floats, Any]:
        """The input within the limits, and how it was found."""
        off = x + self._rest.states @ d - self._rest.x
        if isinstance(self._policy, np.ndarray):
            v, status = self._policy @ off, "gain"
        else:
            self._at(d)
            assert self._solver is not None
            try:
                found = self._solver.solve(off, None)
            except NonFiniteError:
                raise NonFiniteError("`y` is too large: its cost overflows") from None
            v, status = found.control[: len(d)], found.status
        return np.clip(v + self._rest.u - d, self._low, self._high), status

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
        self, y: Floats, predicted: Floats | None, u: Floats, status: Any, started: float
    ) -> Floats:
        self._acted = u.copy()
        took = perf_counter() - started
        self._log.append(Reading(y, predicted, u.copy(), self._d, status, took))
        return u

    @property
    def log(self) -> tuple[Reading, ...]:
        """The last 1000 calls, the latest at the end."""
        return tuple(self._log)

    @property
    def full(self) -> bool:
        """Whether the window is full."""
        return self._x is not None

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
        window = self.model.window
        assert window is not None
        recent = [call.y for call in self._log][-window.fill - 1 :]
        if self._x is None or np.isnan(recent).any():
            raise InputError("`plan` needs a full window, of which no reading was missing")
        steps, limits, cost = self._asked
        start = Start(self._x, validation.frozen(recent[-1].copy()), self._at_rest)
        return plan_from(self.model, start, self._rest.x, steps, limits, cost)

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
        entered = region._entered(ABc, J, G, model.m)
        return LoopCertificate._judged(entered, K, names, model)

    def __repr__(self) -> str:
        said = "" if self.full else ", the window is not full"
        also = ", offset-free" if len(self._inner[0]) else ""
        return (
            f"<ReadingLoop: {', '.join(self.model.outputs)} to "
            f"{', '.join(self.model.input_names)}{also}, {html.number_of(len(self._log), 'call')}"
            f"{said}>"
        )


def disturbance_of(model: Model, rest: Rest, drift: Floats | None) -> tuple[Floats, Floats]:
    """The directions P (m, r) of the disturbances that the outputs show, and the gain (r, p).

    ``d = P xi``, xi a random walk of steps of covariance I that is seen through ``rest.outputs P``;
    its steady gain is the transpose of that of a regulator of the transposed system.
    """
    m, p = model.m, model.n_outputs
    if drift is None:
        return np.zeros((m, 0)), np.zeros((0, p))
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
    K, _, _ = _core.feedback_gain(np.eye(r), seen, np.eye(r), noise)
    return drift[:, None] * Vt[:r].T, -K.T
