"""The problem of a control within limits, as the core takes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from .._base import running, validation
from .._base.names import Labels, default_labels, weight
from .._base.reading import shown_labels
from .._base.records import Record, trusted
from .._base.types import Floats
from ..data.table import titled
from ..exceptions import InputError, ShapeError
from .limits import Cost, Entries, Limits, Named, as_cost, as_limits

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
    if weights.given or {"u", "rate", "x"}.intersection(within.given):
        return read_task(n, m, K, xf, within, weights, labels)
    for name in within.given:
        found = validation.show(getattr(within, name))
        raise InputError(f"`{name}` must be left out without limits, got {found}")
    return None


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
    rate, previous = _rates(within, low, high, named)
    Q, Qf, R, reference = weights.Q, weights.Qf, weights.R, weights.reference
    stage = np.zeros((n, n)) if Q is None else weight("Q", Q, n, labels=named.states)
    terminal = stage if Q is not None else np.eye(n)
    if Qf is not None:
        terminal = weight("Qf", Qf, n, labels=named.states)
    auto = R is None or (isinstance(R, str) and R == "auto")
    inputs = None if auto else weight("R", R, m, auto=True, labels=named.inputs)
    below = above = soft = None
    if within.x is not None:
        below, above = sides("limits.x", within.x, K, named)
        soft = SOFT * float(max(np.abs(stage).max(), np.abs(terminal).max()))
        if not (within.soft is None or within.soft is True):
            soft = None if within.soft is False else validation.positive("soft", within.soft)
    elif within.soft is not None:
        raise InputError("`soft` must be left out without limits of states, `Limits(x=)`")
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
    if time_limit is None:
        return None
    if task is None:
        raise InputError(
            f"`time_limit` must be left out without limits, got {validation.show(time_limit)}"
        )
    return validation.positive("time_limit", time_limit)


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
        entry = labels.input(i) if inputs else labels.state(i)
        raise InputError(
            f"`{name}` must have low <= high, got {low[k, i]:.6g} > {high[k, i]:.6g} for {entry} "
            f"in step {k}"
        )
    if (low == np.inf).any() or (high == -np.inf).any():
        raise InputError(f"`{name}` must leave room: low is inf or high is -inf somewhere")
    return low, high


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
        raise ShapeError(
            f"`{name}` must be a number or have shape ({m},) or ({K}, {m}), got {given.shape}"
        )
    # -0.0 + 0.0 is 0.0: one zero only
    return np.ascontiguousarray(np.broadcast_to(given, (K, m)) + 0.0)


def _rates(
    within: Limits, low: Floats, high: Floats, labels: Labels
) -> tuple[Floats | None, Floats | None]:
    """``|u(k) - u(k-1)|`` at most, and ``u(-1)``; refused where they leave no room."""
    if within.rate is None:
        if within.previous is not None:
            raise InputError("`previous` must be left out without `rate`")
        return None, None
    if within.previous is None:
        raise InputError(
            "`previous` must be given with `rate`: the input that is applied now, a number or (m,)"
        )
    m = low.shape[1]
    rate, previous = (
        validation.vector(
            name, [one] * m if isinstance(one, float) else one, length=m, labels=labels.inputs
        )
        for name, one in (("rate", within.rate), ("previous", within.previous))
    )
    if (rate <= 0.0).any():
        raise InputError(f"`rate` must be > 0, got {rate.min():.3g}")
    # what a later limit leaves: l'_k = max(l_k, l'_{k+1} - rate), and h' likewise
    below, above = low[-1], high[-1]
    for k in range(len(low) - 1, -1, -1):
        if k < len(low) - 1:
            below, above = np.maximum(low[k], below - rate), np.minimum(high[k], above + rate)
        if (below > above).any():
            i = int(np.argmax(below > above))
            raise InputError(
                f"`rate` is too small for `limits`: {labels.input(i)} cannot be within those of "
                f"step {k} and of the steps after it, {below[i] - above[i]:.3g} are missing"
            )
    off = np.maximum(below - rate - previous, previous - above - rate)
    if (off > 0.0).any():
        i = int(np.argmax(off))
        raise InputError(
            f"`previous` must be within `rate` of the limits, {labels.input(i)} is {off[i]:.3g} "
            "too far"
        )
    return rate, previous
