"""What all loops beside a plant share: turns of threads, the log, the way out."""

from __future__ import annotations

import threading
from collections import Counter, deque
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from .._base import show
from .._base.types import Floats, Status
from ..exceptions import InputError
from ..plots.panels import Inputs, draw_calls

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure, SubFigure

    from ..limits.problem import Task


LOGGED = 1000  # calls that the log keeps
BEYOND = 1e6  # times the largest in the data from which a number is that of a broken sensor

Entry = TypeVar("Entry")


class ControlLoop(Generic[Entry]):
    """A loop that is called once in each step; it has no attributes but its own.

    What is measured comes in by `validation.measured`: a wrong type or shape raises and changes
    nothing. What a broken sensor sends (nan, inf, 1e300) does not stop the loop: `_held` gives the
    last input once more, and the reason is in the log. No number that is not finite is kept.
    """

    __slots__ = ("__weakref__", "_busy", "_calls", "_last", "_log")

    def __init__(self, safe: Floats) -> None:
        self._busy = threading.Lock()
        self._log: deque[Entry] = deque(maxlen=LOGGED)
        self._calls = 0
        self._last = safe  # the input that was returned last

    @property
    def calls(self) -> int:
        """The number of calls since the loop was made or reset, held ones included."""
        return self._calls

    @property
    def log(self) -> tuple[Entry, ...]:
        """The last 1000 calls, the latest at the end."""
        return tuple(self._log)

    @contextmanager
    def _turn(self) -> Iterator[None]:
        if not self._busy.acquire(blocking=False):
            raise InputError("this loop is in use by another thread: give each thread its own copy")
        try:
            yield
        finally:
            self._busy.release()

    def _entered(self, entry: Entry, u: Floats) -> Floats:
        """Write a call down; what is returned is the caller's own."""
        self._last = u
        self._calls += 1
        self._log.append(entry)
        return u.copy()

    def _cleared(self, safe: Floats) -> None:
        self._log.clear()
        self._calls, self._last = 0, safe


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
        That of the plan; "held", or "kept" where an earlier plan goes on.
    gap : float
        ``J - min J`` of the plan is at most this; nan for a held or kept input.
    seconds : float
        The time that the call took [s].
    reason : str or None
        Why the state could not be used ("held"), or no plan is accepted ("infeasible").
    """

    x: Floats | None
    u: Floats
    status: Status
    gap: float
    seconds: float
    reason: str | None = None


def counted(calls: Sequence[Call]) -> str:
    """``40 optimal, 2 held``."""
    seen = Counter(call.status for call in calls)
    return ", ".join(f"{count} {status}" for status, count in seen.items())


def facts(calls: Sequence[Call]) -> Iterator[tuple[str, object]]:
    """Rows about the calls for a notebook."""
    if calls:
        times = 1e6 * np.array([call.seconds for call in calls])
        yield "last calls", counted(calls)
        yield "time of a call", f"{np.median(times):.3g} µs (median), {times.max():.3g} µs at most"
        yield "last input", show.vector(calls[-1].u)


def curves(calls: Sequence[Call], n: int) -> str:
    """The states over the calls, drawn small."""
    if not calls:
        return ""
    return show.states(np.arange(len(calls)), _states(calls, n), "states over the calls")


def drawn_calls(
    calls: Sequence[Call],
    task: Task,
    names: tuple[Sequence[str], Sequence[str]],
    dt: float | None,
    figure: Figure | SubFigure | None,
) -> Figure:
    """States, inputs as steps within the limits of the first step, time of each call."""
    if not calls:
        raise InputError("the log is empty: there is nothing to draw before the first call")
    n, m = task.reference.shape[1], task.low.shape[1]
    low, high = (np.broadcast_to(side[0], (len(calls), m)) for side in (task.low, task.high))
    held = np.array([call.status == "held" for call in calls])
    inputs = Inputs(np.array([call.u for call in calls]), names[1], low, high, held)
    took = np.array([call.seconds for call in calls])
    last = task.reference[-1]
    return draw_calls(_states(calls, n), names[0], inputs, last, took, dt=dt, figure=figure)


def _states(calls: Sequence[Call], n: int) -> Floats:
    """(T, n), nan where the state was not known."""
    unknown = np.full(n, np.nan)
    return np.array(
        [unknown if call.x is None or call.status == "held" else call.x for call in calls]
    )
