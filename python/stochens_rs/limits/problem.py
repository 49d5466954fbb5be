"""The problem of a control within limits, as the core takes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.names import Labels, default_labels, weight
from .._base.reading import aligned, shown_labels
from .._base.records import Record, trusted
from .._base.types import Floats
from ..data.units import titled
from ..exceptions import InputError, InputTypeError, ShapeError
from .limits import Cost, Limits, Named, as_cost, as_limits, pair_of

SOFT = 1e3  # weight of soft state limits, in units of the largest eigenvalue of Q


@dataclass(frozen=True, eq=False)
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

    @property
    def bounded(self) -> bool:
        """Whether the inputs have a limit at all."""
        return bool(np.isfinite(self.low).any() or np.isfinite(self.high).any())

    def weights(self) -> tuple[Floats, Floats]:
        """Roots of the weights: ``Q^1/2`` of the stages, and of the last state."""
        return _core.weight_root(self.stage), _core.weight_root(self.terminal)


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
    named = labels or default_labels(n, m)
    within, weights = as_limits(limits), as_cost(cost)
    if not weights.given and within.u is None and within.rate is None and within.x is None:
        for name in within.given:
            raise InputError(
                f"`{name}` must be left out without limits, got "
                f"{validation.show(getattr(within, name))}"
            )
        return None
    return read_task(n, m, K, xf, within, weights, named)


def read_task(
    n: int,
    m: int,
    K: int,
    xf: Floats | None,
    within: Limits,
    weights: Cost,
    labels: Labels | None = None,
) -> Task:
    """Check limits and weights of K steps to `xf`; without any, ``||x(K) - xf||`` alone counts."""
    named = labels or default_labels(n, m)
    running.need(f"`steps` = {K}: the limits and the reference", 8 * K * (2 * m + 3 * n))
    low, high = sides("limits", within.u, K, named)
    speed, before = _rates(within.rate, within.previous, low, high, named)
    Q, Qf, R = weights.Q, weights.Qf, weights.R
    stage = np.zeros((n, n)) if Q is None else weight("Q", Q, n, labels=named.states)
    terminal = stage if Q is not None else np.eye(n)
    if Qf is not None:
        terminal = weight("Qf", Qf, n, labels=named.states)
    auto = R is None or (isinstance(R, str) and R == "auto")
    below, above = None, None
    if within.x is not None:
        below, above = sides("limits.x", within.x, K, named)
    inputs = None if auto else weight("R", R, m, auto=True, labels=named.inputs)
    # of the inputs that keep limits of states a weight R takes the least
    kept = within.x is not None and within.soft is not None and within.soft is not True
    least = kept and inputs is not None and inputs.any()
    if not stage.any() and not terminal.any() and not least:
        raise InputError(
            "`Q` and `Qf` must not both be 0: every control would be the best; without them give R "
            "and limits of states, `Limits(x=, soft=False)`"
        )
    return trusted(
        Task,
        low,
        high,
        stage,
        terminal,
        _reference(weights.reference, xf, K, named.states),
        inputs,
        speed,
        before,
        below,
        above,
        soft=_softness(within, max(np.abs(stage).max(), np.abs(terminal).max())),
        follows=weights.reference is not None,
    )


def seconds(time_limit: Any, task: Task | None) -> float | None:
    """The time for the task [s], checked."""
    if time_limit is None:
        return None
    if task is None:
        raise InputError(
            f"`time_limit` must be left out without limits, got {validation.show(time_limit)}"
        )
    return validation.positive("time_limit", time_limit)


def sides(name: str, value: Any, K: int, labels: Labels) -> tuple[Floats, Floats]:
    """The pair (low, high), each a number, (m,), (K, m) or None, as two arrays (K, m)."""
    names = labels.inputs if name == "limits" else labels.states
    pair = pair_of(name, value)
    if pair is None:
        return np.full((K, len(names)), -np.inf), np.full((K, len(names)), np.inf)
    low = _side(f"{name}[0]", pair[0], K, names, -np.inf)
    high = _side(f"{name}[1]", pair[1], K, names, np.inf)
    wrong = np.argwhere(low > high)
    if len(wrong):
        k, i = (int(j) for j in wrong[0])
        entry = (labels.input if name == "limits" else labels.state)(i)
        raise InputError(
            f"`{name}` must have low <= high, got {low[k, i]:.6g} > {high[k, i]:.6g} for {entry} "
            f"in step {k}"
        )
    if (low == np.inf).any() or (high == -np.inf).any():
        raise InputError(f"`{name}` must leave room: low is inf or high is -inf somewhere")
    return low, high


def _side(name: str, value: Any, K: int, names: tuple[str, ...], none: float) -> Floats:
    m = len(names)
    if value is None:
        return np.full((K, m), none)
    given = validation.read(name, _named_side(name, value, names, none))
    if given.dtype.kind not in "iuf":
        raise InputTypeError(f"`{name}` must be a number or an array of numbers")
    if given.shape not in ((), (m,), (K, m)):
        raise ShapeError(
            f"`{name}` must be a number or have shape ({m},) or ({K}, {m}), got {given.shape}"
        )
    if np.isnan(given).any():
        raise InputError(f"`{name}` must not be nan; use None or inf where there is no limit")
    # -0.0 + 0.0 is 0.0: one zero only
    return np.ascontiguousarray(np.broadcast_to(given.astype(np.float64), (K, m)) + 0.0)


def _named_side(name: str, value: Any, names: tuple[str, ...], none: float) -> Any:
    """A side in the order of `names`; `none` for those that are not named."""
    if not isinstance(value, Named):
        return aligned(name, value, names)
    named = [titled(one, names) for one in value.names]
    for one in named:
        if one not in names:
            raise InputError(
                f"`{name}` names {one!r:.40}, but there are {shown_labels(names)}"
                f"{validation.nearest(one, names)}"
            )
    at = [names.index(one) for one in named]
    full = np.full((*value.values.shape[:-1], len(names)), none)
    full[..., at] = value.values
    return full


def _rates(
    rate: Any, previous: Any, low: Floats, high: Floats, labels: Labels
) -> tuple[Floats | None, Floats | None]:
    m = low.shape[1]
    if rate is None:
        if previous is not None:
            raise InputError("`previous` must be left out without `rate`")
        return None, None
    rate = aligned("rate", rate, labels.inputs)
    given = validation.read("rate", rate)
    one = given.ndim == 0
    speed = (
        np.full(m, validation.positive("rate", rate))
        if one
        else validation.vector("rate", rate, length=m)
    )
    if (speed <= 0.0).any():
        raise InputError(f"`rate` must be > 0, got {speed.min():.3g}")
    if previous is None:
        raise InputError(
            "`previous` must be given with `rate`: the input that is applied now, a number or (m,)"
        )
    previous = aligned("previous", previous, labels.inputs)
    if validation.read("previous", previous).ndim == 0:
        previous = [previous] * m
    before = validation.vector("previous", previous, length=m)
    # what a later limit leaves: l'_k = max(l_k, l'_{k+1} - rate), and h' likewise
    below, above = low[-1], high[-1]
    for k in range(len(low) - 1, -1, -1):
        if k < len(low) - 1:
            below, above = np.maximum(low[k], below - speed), np.minimum(high[k], above + speed)
        if (below > above).any():
            i = int(np.argmax(below > above))
            raise InputError(
                f"`rate` is too small for `limits`: {labels.input(i)} cannot be within those of "
                f"step {k} and of the steps after it, {below[i] - above[i]:.3g} are missing"
            )
    off = np.maximum(below - speed - before, before - above - speed)
    if (off > 0.0).any():
        i = int(np.argmax(off))
        raise InputError(
            f"`previous` must be within `rate` of the limits, {labels.input(i)} is {off[i]:.3g} "
            "too far"
        )
    return speed, before


def _reference(value: Any, xf: Floats | None, K: int, names: tuple[str, ...]) -> Floats:
    """``r(1), ..., r(K)`` from (K + 1, n), or xf for all of them."""
    if value is None:
        if xf is None:
            raise InputError("`xf` must be given without a reference, `Cost(reference=)`")
        return np.ascontiguousarray(np.broadcast_to(xf, (K, len(names))))
    given = validation.matrix("reference", value, rows=K + 1, cols=len(names), labels=names)
    return np.ascontiguousarray(given[1:])


def _softness(limits: Limits, largest: float) -> float | None:
    if limits.x is None:
        if limits.soft is not None:
            raise InputError("`soft` must be left out without limits of states, `Limits(x=)`")
        return None
    if limits.soft is None or limits.soft is True:
        return SOFT * largest
    if limits.soft is False:
        return None
    return validation.positive("soft", limits.soft)
