"""The problem of a control within limits, as the core takes it, and its solution."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import isnan
from typing import Annotated, Any

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.names import Labels, default_labels, weight
from .._base.reading import shown_labels, titled
from .._base.records import Record, require_shapes, trusted
from .._base.running import get_num_threads
from .._base.types import ROUNDING, Floats, NDArray, Status
from ..exceptions import InputError, NonFiniteError, ShapeError
from ..rng import Key
from ..theory.drawn_bounds import PlanErrors
from ..theory.exact import matrix_powers
from .limits import Cost, Entries, Limits, Named, as_cost, as_limits, steps_ahead

SOFT = 1e3  # weight of soft state limits, in units of the largest eigenvalue of Q


class Task(Record):
    """``J(u) = sum_k ||x(k) - r(k)||^2_{Q_k} + ||u(k-1) - u_s||^2_R``, k = 1, ..., K, and limits.

    Attributes
    ----------
    low, high : ndarray, shape (K, m)
        Limits of the inputs; infinite where there is none, equal where an input is fixed.
    stage, terminal : ndarray, shape (n, n)
        ``Q_k`` for k < K, and ``Q_K``.
    reference : ndarray, shape (K, n)
        ``r(1), ..., r(K)``.
    R : ndarray, shape (m, m), or None
        None: ``1e-8 tr(G'QG) / (m K)`` times I, from the estimate; see `regular`.
    rate, previous : ndarray, shape (m,), or None
        ``|u(k) - u(k-1)| <= rate``, with ``u(-1) = previous``.
    state_low, state_high : ndarray, shape (K, n), or None
        Limits of ``x(1), ..., x(K)``.
    soft : float or None
        The weight of ``||max(0, x - high)||^2 + ||max(0, low - x)||^2`` in J; None: hard limits.
    follows : bool
        Whether the reference was given; else all its rows are the target.
    resting : ndarray, shape (m,), or None
        ``u_s``, the inputs that hold the target; None: 0.
    """

    low: Annotated[Floats, "step input", "infinite"]
    high: Annotated[Floats, "step input", "infinite"]
    stage: Annotated[Floats, "state state"]
    terminal: Annotated[Floats, "state state"]
    reference: Annotated[Floats, "step state"]
    R: Annotated[Floats, "input input"] | None = None
    rate: Annotated[Floats, "input", "infinite"] | None = None
    previous: Annotated[Floats, "input", "infinite"] | None = None
    state_low: Annotated[Floats, "step state", "infinite"] | None = None
    state_high: Annotated[Floats, "step state", "infinite"] | None = None
    soft: float | None = None
    follows: bool = False
    resting: Annotated[Floats, "input", "infinite"] | None = None

    @property
    def steps(self) -> int:
        """The number of steps K."""
        return len(self.low)

    @property
    def boxed(self) -> bool:
        """Whether there are limits of single inputs only."""
        return self.rate is None and self.state_low is None


def checked_task(
    n: int,
    m: int,
    K: int,
    xf: Floats | None,
    limits: Any = None,
    cost: Any = None,
    labels: Labels | None = None,
) -> Task | None:
    """What `limits` and `cost` ask for, checked; None if they ask for nothing.

    `xf` is the target, which a reference replaces. Messages use the names in `labels`.
    """
    within, weights = as_limits(limits), as_cost(cost)
    if weights.given or {"u", "rate", "x", "forecast"}.intersection(within.given):
        return read_task(n, m, K, xf, within, weights, labels)
    validation.left_out("without limits", **within.given)
    return None


def read_task(
    n: int,
    m: int,
    K: int,
    xf: Floats | None,
    within: Limits,
    weights: Cost,
    labels: Labels | None = None,
    measured: Sequence[str] = (),
) -> Task:
    """Check limits and weights of K steps to `xf`; without any, ``||x(K) - xf||`` alone counts.

    `measured` are inputs that a gain does not choose.
    """
    named = labels or default_labels(n, m)
    chosen = np.isnan(forecast_of(within, 1, named)[0][0]) & ~np.isin(named.inputs, measured)
    running.need(f"`steps` = {K}: the limits and the reference", 8 * K * (2 * m + 3 * n))
    low, high = inputs_within(within, K, named)
    rate, previous = _rates(within, low, high, named, chosen)
    Q, Qf, R, reference = weights.Q, weights.Qf, weights.R, weights.reference
    stage = np.zeros((n, n)) if Q is None else weight("Q", Q, n, labels=named.states)
    terminal = stage if Q is not None else np.eye(n)
    if Qf is not None:
        terminal = weight("Qf", Qf, n, labels=named.states)
    auto = R is None or (isinstance(R, str) and R == "auto")
    inputs = None if auto else weight_of_inputs(R, chosen, named)
    below = above = soft = None
    if within.x is not None:
        below, above = sides("limits.x", within.x, K, named)
        soft = SOFT * float(max(np.abs(stage).max(), np.abs(terminal).max()))
        if not (within.soft is None or within.soft is True):
            soft = None if within.soft is False else validation.positive("soft", within.soft)
    else:
        validation.left_out("without limits of states, `Limits(x=)`", soft=within.soft)
    # of the inputs that keep limits of states a weight R takes the least
    least = within.x is not None and soft != 0.0 and inputs is not None and inputs.any()
    if not stage.any() and not terminal.any() and not least:
        raise InputError(
            "`Q` and `Qf` must not both be 0: every control would be the best; without them give R "
            "and limits of states, `Limits(x=, soft=False)`"
        )
    if reference is not None:
        how: Any = {"rows": K + 1, "cols": n, "labels": named.states}
        xf = validation.matrix("reference", reference, **how)[1:]
    elif xf is None:
        raise InputError("`xf` must be given without a reference, `Cost(reference=)`")
    wanted = np.ascontiguousarray(np.broadcast_to(xf, (K, n)))
    ends = low, high, stage, terminal, wanted, inputs, rate, previous, below, above
    return trusted(Task, *ends, soft=soft, follows=reference is not None)


def seconds(time_limit: Any, task: Task | None) -> float | None:
    """The time for the task [s], checked."""
    if task is None:
        validation.left_out("without limits", time_limit=time_limit)
    return None if time_limit is None else validation.positive("time_limit", time_limit)


def sides(
    name: str, pair: tuple[Entries, Entries] | None, K: int, labels: Labels
) -> tuple[Floats, Floats]:
    """The pair (low, high) of `Limits` as two arrays (K, m), infinite where there is no limit."""
    inputs = name == "limits"
    names = labels.inputs if inputs else labels.states
    first, last = pair or (None, None)
    low = _side(f"{name}[0]", first, K, names, -np.inf)
    high = _side(f"{name}[1]", last, K, names, np.inf)
    wrong = np.argwhere(low > high)
    if len(wrong):
        k, i = (int(j) for j in wrong[0])
        found = f"{low[k, i]:.6g} > {high[k, i]:.6g} for {labels.entry(i, inputs=inputs)}"
        raise InputError(f"`{name}` must have low <= high, got {found} in step {k}")
    if (low == np.inf).any() or (high == -np.inf).any():
        raise InputError(f"`{name}` must leave room: low is inf or high is -inf somewhere")
    return low, high


def inputs_within(within: Limits, K: int, labels: Labels) -> tuple[Floats, Floats]:
    """Limits of the inputs, (K, m) each, equal where one is forecast."""
    fixed, pair = forecast_of(within, K, labels)[0], sides("limits", within.u, K, labels)
    low, high = (np.where(np.isnan(fixed), side, fixed) for side in pair)
    return low, high


def forecast_of(within: Limits, K: int, labels: Labels) -> tuple[Floats, Floats]:
    """What inputs will be that are not chosen, nan for the others, and how far from it, (K, m)."""

    def ahead(of: Entries, none: float) -> Floats:
        if isinstance(of, Named):
            of = Named(steps_ahead(of.values, K), of.names)
        return _side("forecast", of, K, labels.inputs, none)

    found: Any = within.forecast
    values = ahead(found and found.values, np.nan)
    return values, np.where(np.isnan(values), 0.0, ahead(found and found.error, 0.0))


def _side(name: str, value: Entries, K: int, names: tuple[str, ...], none: float) -> Floats:
    """A side in the order of `names`; `none` for those that are not named."""
    m, given = len(names), np.asarray(none if value is None else value)
    if isinstance(value, Named):
        named = [titled(one, names) for one in value.names]
        for one in named:
            if one not in names:
                raise InputError(
                    f"`{name}` names {one!r:.40}, but there are {shown_labels(names)}"
                    f"{validation.nearest(one, names)}"
                )
        given = np.full((*value.values.shape[:-1], m), none)
        given[..., [names.index(one) for one in named]] = value.values
    if given.shape not in ((), (m,), (K, m)):
        raise ShapeError(f"`{name}` must be a number, ({m},) or ({K}, {m}), got {given.shape}")
    # -0.0 + 0.0 is 0.0: one zero only
    return np.ascontiguousarray(np.broadcast_to(given, (K, m)) + 0.0)


def weight_of_inputs(R: Any, chosen: NDArray[np.bool_], labels: Labels) -> Floats:
    """The weight R, (m, m), also from one of the inputs that are chosen alone."""
    names = [one for one, own in zip(labels.inputs, chosen, strict=True) if own]
    if not isinstance(R, np.ndarray) or R.shape[-1] != len(names):
        return weight("R", R, len(chosen), labels=labels.inputs)
    full = np.zeros((len(chosen),) * 2)
    full[np.ix_(chosen, chosen)] = weight("R", R, len(names), labels=names)
    return full


def _of_inputs(name: str, value: Entries, chosen: NDArray[np.bool_], labels: Labels) -> Floats:
    """Numbers (m,) from one, from those of all or of the chosen inputs, or by name; else inf."""
    names = np.array(labels.inputs, dtype=object)
    if isinstance(value, np.ndarray):
        if value.shape not in ((len(names),), (chosen.sum(),)):
            raise ShapeError(
                f"`{name}` must be a number, {show.number_of(int(chosen.sum()), 'number')} for "
                f"{show.listed([*names[chosen]])}, or numbers by name, got shape {value.shape}"
            )
        value = Named(value, (*(names if len(value) == len(names) else names[chosen]),))
    found: Floats = _side(name, value, 1, labels.inputs, np.inf)[0]
    return found


def _rates(
    within: Limits, low: Floats, high: Floats, labels: Labels, chosen: NDArray[np.bool_]
) -> tuple[Floats | None, Floats | None]:
    """``|u(k) - u(k-1)|`` at most, and ``u(-1)``; refused where they leave no room."""
    if within.rate is None:
        validation.left_out("without `rate`", previous=within.previous)
        return None, None
    if within.previous is None:
        raise InputError("`previous` must be given with `rate`: the input now, a number or (m,)")
    rate, previous = (
        _of_inputs(name, one, chosen, labels)
        for name, one in (("rate", within.rate), ("previous", within.previous))
    )
    if (rate <= 0.0).any():
        raise InputError(f"`rate` must be > 0, got {rate.min():.3g}")
    rate = np.where(chosen, rate, np.inf)
    unknown = ~np.isfinite(previous)
    if (unknown & (rate < np.inf)).any():
        i = int(np.argmax(unknown & (rate < np.inf)))
        raise NonFiniteError(
            f"`previous` must be a finite number for {labels.entry(i, inputs=True)}, which has a "
            "rate"
        )
    previous = np.where(unknown, 0.0, previous)
    # what a later limit leaves: l'_k = max(l_k, l'_{k+1} - rate), and h' likewise
    below, above = low[-1], high[-1]
    for k in range(len(low) - 1, -1, -1):
        if k < len(low) - 1:
            below, above = np.maximum(low[k], below - rate), np.minimum(high[k], above + rate)
        if (below > above).any():
            i = int(np.argmax(below > above))
            raise InputError(
                f"`rate` is too small for `limits`: {labels.entry(i, inputs=True)} cannot be "
                f"within those of step {k} and of the steps after it, {below[i] - above[i]:.3g} "
                "are missing"
            )
    off = np.maximum(below - rate - previous, previous - above - rate)
    if (off > 0.0).any():
        i = int(np.argmax(off))
        raise InputError(
            f"`previous` must be within `rate` of the limits, {labels.entry(i, inputs=True)} is "
            f"{off[i]:.3g} too far"
        )
    return rate, previous


OPTIMAL = 1e-9  # the gap of an "optimal" control, in units of J(u), as in the core


class Limited(Record):
    """What is known about a control within limits. Made by `control`, and ``plan.limited`` there.

    Attributes
    ----------
    task : Task
        What was minimised.
    R : ndarray, shape (m, m)
        The weight of the inputs that was used.
    u : ndarray, shape (K, m)
        The control; inside its limits exactly.
    active : ndarray of int8, shape (K, m)
        -1 at the lower limit, 1 at the upper one.
    multipliers : ndarray, shape (K, m)
        Of the limits of the inputs, >= 0.
    gap : float
        ``J(u) - min J`` is at most this, recomputed from the data of the problem.
    distance : float
        ``(||G (u - u*)||_Q^2 + ||u - u*||_R^2)^(1/2)`` is at most this.
    objective : float
        ``J(u)``.
    missed : float or None
        What the limits cost: ``J(u)`` less the least J without limits; 0 if none is active, None if
        the time limit came before.
    status : str
        "optimal", or why it is not.
    missing : float
        By how much hard state limits cannot be met; 0 if they can. Else the control is the best
        one within limits that are wider by this, and so are gap and distance.
    state_active : ndarray of int8, shape (K, n), optional
        Of ``x(1), ..., x(K)``: -1 at or below the lower limit to rounding, 1 at or above the
        upper one, else 0; None without limits of states.
    feedback : ndarray, shape (K, m, n), optional
        Where the system grows so much over the steps that rounding of the inputs may: the plan is
        ``u(k) + feedback[k] (x(k) - xh(k))`` within the limits of the inputs, and `objective`,
        `gap` and `distance` are those of a plan that is followed so. None where `u` alone will do.
    states : ndarray, shape (K, n), optional
        Then the states ``xh(1), ..., xh(K)`` of that plan.
    open_until : int, optional
        Then the steps over which the inputs alone lead to these states, to 1e-7 of the largest.
    open_objective : float, optional
        Then J of the inputs alone; infinite where it overflows.
    """

    task: Task
    R: Annotated[Floats, "input input"]
    u: Annotated[Floats, "step input"]
    active: Annotated[NDArray[np.int8], "step input"]
    multipliers: Annotated[Floats, "step input", "infinite"]
    gap: float
    distance: float
    objective: float
    missed: float | None
    status: Status
    missing: float = 0.0
    state_active: Annotated[NDArray[np.int8], "step state"] | None = None
    feedback: Annotated[Floats, "step input state", "infinite"] | None = None
    states: Annotated[Floats, "step state", "infinite"] | None = None
    open_until: int | None = None
    open_objective: float | None = None

    def _check(self) -> None:
        require_shapes(self, u=self.task.low.shape, states=self.task.reference.shape)

    @property
    def rate_active(self) -> NDArray[np.int8]:
        """1 where an input rises by its rate to rounding, -1 where it falls by it, else 0; (K, m).

        Row k is of the change ``u(k) - u(k-1)``.
        """
        rate, previous = self.task.rate, self.task.previous
        if rate is None or previous is None:
            return np.zeros(self.u.shape, dtype=np.int8)
        change = np.diff(self.u, axis=0, prepend=previous[None])
        size = np.maximum(np.abs(self.u).max(axis=0), np.abs(previous))
        room = ROUNDING * np.maximum(np.where(rate < np.inf, rate, 0.0), size)
        at = np.abs(change) >= rate - room
        return np.where(at, np.sign(change), 0.0).astype(np.int8)


class Horizon:
    """A system ``x(k+1) = A x(k) + B u(k) + c`` and a task, whose best control the core computes.

    `wanted` and `R` take the place of the reference and of the weight R of `task`.
    """

    def __init__(
        self,
        task: Task,
        A: Floats,
        B: Floats,
        c: Floats | None = None,
        *,
        wanted: Floats | None = None,
        R: Floats | None = None,
    ) -> None:
        self.task, self.A, self.B, self._resting = task, A, B, task.resting
        if (rest := task.resting) is not None:  # of v = u - u_s, which is weighed: c + B u_s
            previous = None if task.previous is None else task.previous - rest
            low, high = task.low - rest, task.high - rest
            task = replace(task, low=low, high=high, previous=previous, resting=None)
            c = np.ascontiguousarray(B @ rest if c is None else c + B @ rest)
        with _exponents(task, A):
            self.core = _core.Horizon(A, B, c, task, wanted, R)
        if not self.core.long:
            self.need()

    def need(self) -> None:
        """Refuse a condensed map that does not fit into the memory this process may use."""
        columns = self.task.low.size + len(self.A) + 1
        running.need("the control within limits", 8 * self.core.rows * columns * 3)

    def objective(self, x0: Floats, u: Floats) -> float:
        """``J(u)``, with the weight of soft limits."""
        return self.core.objective(x0, u if self._resting is None else u - self._resting)

    def solve(self, x0: Floats, *, time_limit: float | None = None) -> Limited:
        """The best control from x0."""
        found = self.core.solve(x0, time_limit)
        u, followed = found.u, found.followed
        if self._resting is not None:
            u = np.clip(u + self._resting, self.task.low, self.task.high)
        more: dict[str, Any] = {}
        if followed is not None and followed[2] < len(u):  # else the inputs alone lead there
            states, feedback, until, alone = followed
            more = {"states": states, "feedback": feedback.reshape(*u.shape, -1)}
            more |= {"open_until": until, "open_objective": alone}
        missed = None if isnan(found.missed) else found.missed
        gaps = found.gap, found.distance, found.objective, missed
        ended = found.status, found.missing, found.state_active
        made = self.task, self.core.r, u, found.active, found.multipliers
        return Limited(*made, *gaps, *ended, **more)


def loop_of(task: Task, A: Floats, B: Floats, c: Floats | None) -> _core.Loop:
    """What solves the plans of a `Regulator`, one state after another."""
    with _exponents(task, A):
        return _core.Loop(A, B, c, task)


@contextmanager
def _exponents(task: Task, A: Floats) -> Iterator[None]:
    """Where something overflows, name the power of A that does, if one does."""
    try:
        yield
    except NonFiniteError:
        matrix_powers(A, task.steps)
        raise


# Costs [ns] of one control within limits, measured on one thread (x86-64), within a factor of
# three. They decide how many are drawn, and change no probability.
_SOLVE, _PER_CUBE, _PER_ENTRY = 5e3, 3.0, 15.0


@dataclass(frozen=True, eq=False)
class MovedTarget:
    """``||P_Q (b^ - b)||_Q``, P_Q onto the range of the exact map, ``b_k = r(k) - A^k x0``.

    With soft limits of the states ``||dc||_W + ||dr||_Q``, ``c_k = A^k x0``, W with their weight.
    """

    plan: PlanErrors
    exact: Horizon

    @property
    def cost(self) -> float:
        """As `Errors.cost`."""
        # over several steps, or with soft limits, a problem of twice as many states is drawn
        twice = self.exact.task.steps > 1 or self.exact.task.soft is not None
        return (4.0 if twice else 1.0) * self.plan.cost

    def rounded(self, radii: tuple[float, ...]) -> tuple[float, ...]:
        """As `Errors.rounded`."""
        x0, xf, _ = (np.linalg.norm(entity.values) for entity in self.plan.entities)
        _, start, goal = self.exact.core.norms()
        size = float(start * x0 + goal * xf)
        return tuple(radius + ROUNDING * (radius + size) for radius in radii)

    def draw(self, runs: int, key: Key) -> Floats:
        """Independent errors, (runs, 1)."""
        x0, xf, _ = (np.ascontiguousarray(entity.values) for entity in self.plan.entities)
        how = runs, self.cost, key.bytes32, get_num_threads()
        drawn, rows = _drawn(self.plan)
        return self.exact.core.moved_targets(drawn, rows, self.plan.paired, x0, xf, *how)[:, None]


@dataclass(frozen=True, eq=False)
class LimitedErrors:
    """``||M (u - v)||``, ``||u - v||_2`` and ``J(u) - J(v)``, v the best of the exact system.

    u is the control within limits of the estimates that a run draws. With R="auto" each run has
    its own R, in u and in v.
    """

    plan: PlanErrors
    exact: Horizon
    limited: Limited
    follows: bool  # whether the reference is xf

    @property
    def cost(self) -> float:
        """As `Errors.cost`."""
        rows, d, n = self.exact.core.rows, self.limited.u.size, len(self.exact.A)
        solve = _SOLVE + _PER_CUBE * d**3 + _PER_ENTRY * (rows + d) * d
        return float(100.0 * (n + 2) * n + solve * (2.0 if self.limited.task.R is None else 1.0))

    def rounded(self, radii: tuple[float, ...]) -> tuple[float, ...]:
        """As `Errors.rounded`."""
        size = float(np.abs(self.limited.u).max(initial=0.0))
        gain, _, _ = self.exact.core.norms()
        scales = gain * size, size, (gain * size) ** 2
        return tuple(r + ROUNDING * (r + scale) for r, scale in zip(radii, scales, strict=True))

    def draw(self, runs: int, key: Key) -> Floats:
        """Independent errors, (runs, 3)."""
        x0 = np.ascontiguousarray(self.plan.entities[0].values)
        law = *_drawn(self.plan), x0, self.follows, self.limited.task.R is None
        return self.exact.core.drawn_errors(*law, runs, self.cost, key.bytes32, get_num_threads())


def _drawn(plan: PlanErrors) -> tuple[tuple[Any, Any, Any], bool]:
    """The entities as the core takes them, and whether A is drawn by rows."""
    x0, xf, A = plan.entities
    lines = A.argument(transpose=not (plan.rows and A.drawn))
    return (x0.argument(), xf.argument(), lines), plan.rows
