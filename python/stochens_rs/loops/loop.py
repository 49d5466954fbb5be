"""What all loops beside a plant share: turns of threads, the log, copies, the way out."""

from __future__ import annotations

import copy
import threading
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar, cast

import numpy as np

from .._base import show, validation
from .._base.files import Durable
from .._base.names import Labels
from .._base.records import SavedRecord
from .._base.types import DELTA, ArrayLike, Figure, Floats, Self, SubFigure
from ..exceptions import InputError
from ..export.header import write
from ..feedback import Watch
from ..plots.panels import Inputs, draw_calls
from ..validation.held_out import Asked, PredictedLoop, Runs, Validation, validated_loop
from .keep import Kept

LOGGED = 1000  # calls that the log keeps
# Made anew in a copy, from what `_saved` says.
CORE = ("_matrices", "_point", "_range", "_solver", "_window", "kept")

Entry = TypeVar("Entry")


class LoopState(SavedRecord):
    """What a loop is made of and where it stands, without its log.

    Attributes
    ----------
    kind : str
        The name of its class.
    parts : dict
        Its attributes by name.
    """

    kind: str
    parts: dict[str, Any]


class ControlLoop(Durable, Generic[Entry]):
    """A loop that is called once in each step; it has no attributes but its own.

    A copy, a pickle and a saved file go on where it is; a file has no log.

    What is measured comes in by `validation.measured`: a wrong type or shape raises and changes
    nothing. What a broken sensor sends (nan, inf, 1e300) does not stop the loop: it gives the last
    input once more, and the reason is in the log. No number that is not finite is kept.
    """

    _kind = LoopState._kind
    __slots__ = ("__weakref__", "_busy", "_calls", "_last", "_log", "_safe", "_watch", "labels")

    _watch: Watch | None
    kept: Kept | None

    def __init__(self, labels: Labels, safe: Floats) -> None:
        self.labels = labels  # of what is read, and of the inputs
        self._busy = threading.Lock()
        self._log: deque[Entry] = deque(maxlen=LOGGED)
        self._calls, self._watch = 0, None
        self._safe = self._last = safe  # the input before the first one, and that returned last

    @property
    def calls(self) -> int:
        """The number of calls since the loop was made or reset, held ones included."""
        return self._calls

    @property
    def watch(self) -> Watch | None:
        """The alarm that looks at each call, of `LoopCertificate.watch`; can be set.

        `reset` leaves its evidence and an alarm, which are about the plant, until `Watch.clear`;
        the reading before it and the next one are no pair.
        """
        return self._watch

    @watch.setter
    def watch(self, watch: Watch | None) -> None:
        if watch is not None:
            validation.instance("watch", watch, Watch)._attach(self)
        self._watch = watch

    @property
    def log(self) -> tuple[Entry, ...]:
        """The last 1000 calls, the latest at the end."""
        return tuple(self._log)

    def reset(self) -> None:
        """Forget the last plan and its active limits, or the window, and the log.

        With a rate, the last input remains the one that is applied now.

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
            self._begin()

    def validate(
        self,
        runs: Runs,
        delta: float = DELTA,
        *,
        beta: float | None = None,
        scale: ArrayLike | None = None,
        weights: ArrayLike | None = None,
    ) -> Validation:
        """Bound where the next run of this loop will be, from runs of it, for any noise and plant.

        Parameters
        ----------
        runs : Trajectories or array_like of shape (M, K + 1, n)
            States or readings of runs of this loop that had no part in it, all of them, from starts
            that vary as later ones will: a run that diverged or was aborted has fewer rows, or nan.
            The inputs of Trajectories must be what this loop gives at them.
        delta, beta, weights
            As for `Plan.validate`: 19 runs for 95 %, 59 with confidence 95 %.
        scale : array_like, shape (n,) or (K + 1, n), optional
            Units of the deviations, > 0, fixed before these runs. The default is the standard
            deviation of the noise of one step for a `Model`, else 1.

        Returns
        -------
        Validation
            ``tube`` around ``p(k)``, the states of the loop around its model from the run's own
            start, and ``target``, the distance of x(K) from the last set point. Of a loop from
            readings x are these; it predicts from its first input on, and ``target`` is of the
            outputs that have one.

        Raises
        ------
        InputError, InputTypeError
            If the runs do not fit this loop, or had other inputs: of another controller, of one
            that was tuned or swapped in between, or with held ones.

        Notes
        -----
        As for `Plan.validate`. The loop begins each run at its first row, without a plan or a
        reading, and with a rate of change from the input that is applied now. A run in which a loop
        from readings never knew enough to begin is one that diverged. A loop that was tuned after
        the runs were seen needs fresh ones.

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
        asked = Asked.checked(delta, beta, scale, weights)
        return validated_loop(self._predictions(), runs, asked)

    def plot(self, *, figure: Figure | SubFigure | None = None) -> Figure:
        """Draw the calls in the log: what was measured, inputs, and the time of each call.

        An input is thick where it is at one of its limits; held ones are marked. Where a reading
        was missing or rejected, that which was predicted is drawn in its place.

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
        log: Any = self._log
        if not log:
            raise InputError("the log is empty: there is nothing to draw before the first call")
        u, held = np.array([call.u for call in log]), [call.status == "held" for call in log]
        low, high = (np.broadcast_to(side, u.shape) for side in self.limits)
        inputs = Inputs(u, self.labels.input_axes, low, high, np.array(held))
        times = np.array([call.seconds for call in log])
        about = self.labels.state_axes, inputs, times
        return draw_calls(self._readings(), *about, dt=self._dt, figure=figure, **self._drawn())

    @property
    def limits(self) -> tuple[Floats, Floats]:
        """The limits (low, high) of the input, each (m,) or (K, m)."""
        raise NotImplementedError

    @property
    def _dt(self) -> float | None:
        raise NotImplementedError

    def _drawn(self) -> dict[str, Any]:
        """The target of each call, and what was predicted, for `plot`."""
        raise NotImplementedError

    def _predictions(self) -> PredictedLoop:
        """What `validate` compares runs with."""
        raise NotImplementedError

    def _readings(self) -> Floats:
        """What was read in the calls of the log, nan where it was not known."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        log: Any = self._log
        if not log:
            return show.card(self, [])
        times = 1e6 * np.array([call.seconds for call in log])
        rows = {
            "last input": show.vector(self._last),
            "last calls": counted(log),
            "time of a call": f"{np.median(times):.3g} µs (median), {times.max():.3g} µs at most",
        }
        drawn = show.states(np.arange(len(log)), self._readings(), "readings over the calls")
        return show.card(self, rows.items(), drawn)

    def _along(self, read: Floats) -> Floats:
        """What the loop gives along a run."""
        loop: Any = self._fresh()
        return np.array([loop(one) for one in read])

    def _write(self, path: Any, name: str, parts: list[str], *of: dict[str, Any]) -> None:
        """Write the header of a controller from its sizes, tables and head, with the alarm."""
        (sizes, tables, about), name = of, validation.text("name", name)
        if "target" in about:
            about = about | {"target": f"{name}_target(&s, r), r = {about['target']}"}
        write(path, name, parts, sizes, tables, about, watch=self.watch)

    def _begin(self) -> None:
        self._log.clear()
        self._calls = 0
        self._forget()
        self._last = self._safe
        if self._watch is not None:
            self._watch._skip()

    def _forget(self) -> None:
        """Begin anew but for the log."""
        raise NotImplementedError

    def _saved(self) -> Any:
        """The state of the objects of the core."""
        raise NotImplementedError

    def _restore(self, core: Any) -> None:
        """Make the objects of the core, with this state."""
        raise NotImplementedError

    def __getstate__(self) -> dict[str, Any]:
        with self._turn():
            slots = (*ControlLoop.__slots__, *type(self).__slots__)
            names = [name for name in slots if name not in ("__weakref__", "_busy", *CORE)]
            parts = {"core": self._saved(), **{name: getattr(self, name) for name in names}}
            return {**parts, "_watch": None if self.watch is None else self.watch.__getstate__()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        core, watch = state.pop("core"), state.pop("_watch")
        self._busy = threading.Lock()
        for name, value in state.items():
            setattr(self, name, value)
        self._watch = None if watch is None else Watch.__new__(Watch)
        if self._watch is not None:
            self._watch.__setstate__(watch)
            self._watch._attach(self)
        self._restore(core)

    def _to_sections(self) -> dict[str, Any]:
        parts = self.__getstate__()
        del parts["_log"]
        return LoopState(type(self).__name__, parts)._to_sections()

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Self:
        state = LoopState._from_sections(sections)
        slots = {*ControlLoop.__slots__, *cls.__slots__} - {"__weakref__", "_busy", "_log", *CORE}
        if state.kind != cls.__name__ or set(state.parts) != {"core", *slots}:
            raise InputError(f"the state must be of a {cls.__name__}, got one of a {state.kind}")
        loop = cls.__new__(cls)
        loop.__setstate__({"_log": deque(maxlen=LOGGED), **state.parts})
        return loop

    def _fresh(self) -> Self:
        """A copy that begins anew."""
        other = copy.deepcopy(self)
        other.reset()
        return other

    @contextmanager
    def _turn(self) -> Iterator[None]:
        if not self._busy.acquire(blocking=False):
            raise InputError("this loop is in use by another thread: give each thread its own copy")
        try:
            yield
        finally:
            self._busy.release()

    def _entered(self, entry: Entry, u: Floats, read: Floats, acted: Floats) -> Floats:
        """Write a call down, with what the watch says; what is returned is the caller's own."""
        if self.watch is not None:
            found, of = self.watch(read, u, applied=acted), cast(Any, entry)
            why = [] if of.reason is None else [of.reason]
            if found.status == "alarm" and self.kept is not None:
                why += self.kept.end("the watch rings")
            entry = of._replace(watch=found, reason="; ".join(why) or None)
        self._last = u
        self._calls += 1
        self._log.append(entry)
        return u.copy()


def counted(calls: Iterable[Any]) -> str:
    """``40 optimal, 2 held``."""
    seen = Counter(call.status for call in calls)
    return ", ".join(f"{count} {status}" for status, count in seen.items())
