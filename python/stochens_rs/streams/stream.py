"""Steps until a stopping rule or a limit is met, with checkpoints."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np

from .. import _core
from .._base import files, running, saving, show, validation
from .._base.files import PathLike
from .._base.running import Progress, progress_bar
from .._base.saving import Durable
from .._base.types import Floats, Status
from ..exceptions import InputError, StateError, StateIOError
from ..rng import Key, RngLike, as_key
from ..system.system import System
from ..theory.exact import checked_ends
from .state import ENTITIES, SLOTS, Identity, Slots, StreamRun, Trace, from_sections, to_sections

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from typing_extensions import Self


class Checkpoints:
    """Saves a stream during a run; locks the file from the start of the run to its end."""

    def __init__(self, stream: Durable, path: PathLike | None, every: float) -> None:
        self._stream = stream
        self._path = None if path is None else files.checked_path("checkpoint", path)
        self._every = validation.positive("every", every)
        self._lock: _core.StateLock | None = None
        self._last = time.monotonic()

    def __enter__(self) -> Self:
        if self._path is not None:
            self._lock = saving.lock(self._path)
            try:
                self._check_earlier(self._path)
            except BaseException:  # the caller may handle it and use the file again
                self._lock.release()
                raise
        return self

    def __exit__(self, *_: object) -> None:
        if self._lock is not None:
            self._lock.release()

    def _check_earlier(self, path: str) -> None:
        """Raise if the file is anything else than an earlier state of the same stream."""
        previous = path + ".prev"
        if not (os.path.lexists(path) or os.path.lexists(previous)):
            return
        _, theirs = saving.load(path, self._stream._kind)
        ours = self._stream._to_sections()
        if "digest" not in theirs or theirs["digest"].tobytes() != ours["digest"].tobytes():
            raise StateError(
                f"{path} must be a state of this problem, key and options, got another"
            )
        there, here = int(theirs["steps"][0]), int(ours["steps"][0])
        if there > here:
            raise StateError(
                f"{path} is at step {there}, ahead of this stream at step {here}: load it "
                "(`Stream.load`), choose another path, or remove it "
                f"and {previous}"
            )

    def due(self) -> None:
        """Save if the time between two checkpoints has passed."""
        if self._path is not None and time.monotonic() - self._last >= self._every:
            self.save()

    def save(self) -> None:
        """Save now."""
        if self._path is not None:
            sections = self._stream._to_sections()
            saving.save(self._path, self._stream._kind, sections, self._lock)
            self._last = time.monotonic()


Rule: TypeAlias = Literal["certificate", "printed"]
RULES: tuple[Rule, ...] = get_args(Rule)

_ENDLESS = 2**62  # more steps than any run can take
_SLICE = 0.2  # seconds between two calls of the progress bar


@dataclass(frozen=True)
class Stop:
    """When a run ends; `rule` is None without a tolerance."""

    rule: Rule | None
    tol: float
    max_steps: int | None
    time_limit: float | None


def checked_stop(
    tol: float | None, max_steps: int | None, time_limit: float | None, rule: Rule
) -> Stop:
    """Check the arguments of `Stream.run` that say when it ends."""
    name = validation.choice("rule", rule, RULES)
    limit = None if tol is None else validation.positive("tol", tol)
    most = None if max_steps is None else validation.size("max_steps", max_steps)
    seconds = None if time_limit is None else validation.positive("time_limit", time_limit)
    if limit is None and most is None and seconds is None:
        raise InputError("one of `tol`, `max_steps` and `time_limit` must be given")
    return Stop(None if limit is None else name, limit or 0.0, most, seconds)


def run_until(
    core: _core.Stream,
    stop: Stop,
    bar: AbstractContextManager[Callable[[int], object]],
    checkpoints: Checkpoints,
) -> Status:
    """Take steps until `stop`, and save at the end, also after an exception in a callback."""
    status: Status = "interrupted"
    try:
        with bar as report:
            status = _take_steps(core, stop, report, checkpoints)
    except KeyboardInterrupt:
        pass  # the core stops between two steps
    except (StateError, StateIOError):
        raise  # from a checkpoint
    except BaseException:  # from `bar` or a signal handler
        checkpoints.save()
        raise
    try:
        checkpoints.save()
    except KeyboardInterrupt:
        if status == "interrupted":
            raise  # the second one
        status = "interrupted"
        checkpoints.save()
    return status


def _take_steps(
    core: _core.Stream, stop: Stop, report: Callable[[int], object], checkpoints: Checkpoints
) -> Status:
    def steps() -> int:
        return core.counts()[0]

    def satisfied() -> bool:
        return stop.rule == "certificate" and core.certificate()[0] <= stop.tol

    if satisfied():
        return "converged"
    first, started = steps(), time.monotonic()
    while True:
        left = _ENDLESS if stop.max_steps is None else stop.max_steps - (steps() - first)
        rest = _SLICE
        if stop.time_limit is not None:
            rest = stop.time_limit - (time.monotonic() - started)
        end = core.advance(left, stop.rule, stop.tol, min(_SLICE, max(rest, 0.0)))
        report(steps() - first)
        checkpoints.due()
        if end != "time_limit" or (stop.time_limit is not None and rest <= _SLICE):
            return "converged" if satisfied() else end


class Stream(Durable):
    """Algorithm 1 of the paper, on realizations that the stream draws itself.

    Each step draws one realization E for one slot (x0, xf or A) and moves the estimate F of that
    slot, and the control v, by one exact line search towards the target T (the given x0, xf or A):
    ``t = clip(<T - F, E - F> / ||E - F||^2, 0, 1)``, ``F <- (1 - t) F + t E``,
    ``v <- (1 - t) v + t v'``, with ``v' = B^+ (xf - A x0)`` computed from E and the estimates of
    the other slots. The stream starts with one realization per slot.

    Parameters
    ----------
    system : System or pair (A, B)
        The system, or anything `System.from_any` takes; A is exact or nominal. Realizations of A
        are drawn column by column.
    x0, xf : array_like, shape (n,)
        Exact or nominal initial state and target.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness. Realization k of x0 is realization k of
        ``sample(x0, ..., rng=key.child("x0"))``; "xf" and "A" alike.
    safeguard : bool, default False
        A second line search per step, towards the mean of the realizations of the slot. The error
        of each estimate is then never larger than that of this mean.
    slots : {"random", "round-robin", "gain"}, default "random"
        Which slot the step is for. "random": each with probability 1/3, as in the paper.
        "round-robin": in turn. "gain": the slot with the largest guaranteed decrease of the mean
        squared error of the state, ``c^2 d^4 / (V + d^2)`` for an error d of the slot, with
        ``c = ||A||`` for x0, 1 for xf, ``||F0||`` for A.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    ResourceError
        If the stream does not fit into memory.

    Notes
    -----
    *Invariant* (corrected Algorithm 1): ``v = B^+ (Ff - FA F0)`` after every step. A step
    costs O(n) (more above n = 300 or so, where A leaves the processor's caches), `u`, `certificate`
    and `error` O(n^2 + n m). All running sums are computed again every ``16 max(n, 16)`` steps;
    `drift` is the largest correction so far.

    *Mean-square bound*, for ``n_i`` realizations in slot i, chosen independently of them, and
    ``V = E ||E - T||^2``: ``E ||B (v - v*)||^2 <= 3 [Vf / n_f + ||A||^2 V0 / n_0 +
    (VA / n_A) (||x0|| + sqrt(V0 / n_0))^2]``.

    *Threads.* Threads can share a stream; each call locks it. A signal handler that uses a stream
    during a call gets an InputError, as does a process that was forked during one. A signal handler
    that waits for another thread's call on the stream deadlocks.

    *Reproducibility.* The result depends on the arguments, the key and the number of steps only.

    Examples
    --------
    >>> import stochens_rs as se
    >>> A, B = [[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]]
    >>> stream = se.Stream((A, B), [1.0, 2.0], [0.0, 0.0], rng=1)
    >>> run = stream.run(tol=1e-3)
    >>> run.status, run.error <= run.certificate <= 1e-3, stream.u.shape
    ('converged', True, (2,))
    """

    _kind = "stream"

    def __init__(
        self,
        system: System | Any,
        x0: ArrayLike,
        xf: ArrayLike,
        *,
        rng: RngLike = None,
        safeguard: bool = False,
        slots: Slots = "random",
    ) -> None:
        checked, start, goal = checked_ends(system, x0, xf)
        inputs, n, m = checked.B, checked.n, checked.m
        order = validation.choice("slots", slots, SLOTS)
        safe = validation.flag("safeguard", safeguard)
        # laws, estimates, sums, tables of both matrices, and the pseudoinverse
        running.need("a stream", (80 if safe else 64) * n * n + 40 * n * m)
        columns = np.ascontiguousarray(checked.A.T)
        self._identity = Identity(as_key(rng), safe, order, n, m)
        self._digest = self._identity.digest(inputs, start, goal, columns)
        keys = self._identity.keys()
        self._core = _core.Stream(inputs, start, goal, columns, keys, safe, order)

    @property
    def key(self) -> Key:
        """The key of all realizations."""
        return self._identity.key

    @property
    def digest(self) -> str:
        """SHA-256 of key, options, B, x0, xf and A, as 64 hexadecimal digits."""
        return self._digest

    @property
    def steps(self) -> int:
        """Steps taken so far."""
        return self._core.counts()[0]

    @property
    def counts(self) -> dict[str, int]:
        """Realizations used so far, for "x0", "xf" and "A"."""
        return dict(zip(ENTITIES, self._core.counts()[1], strict=True))

    @property
    def u(self) -> Floats:
        """The control v of the estimates, rounded to doubles, shape (m,)."""
        return self._core.control()

    @property
    def estimates(self) -> dict[str, Floats]:
        """Estimates of "x0" (n,), "xf" (n,), "A" (n, n)."""
        x0, xf, columns = self._core.estimates()
        return {"x0": x0, "xf": xf, "A": np.ascontiguousarray(columns.T)}

    @property
    def residuals(self) -> dict[str, float]:
        """``||F - T||`` for "x0", "xf" (2-norm) and "A" (Frobenius)."""
        return dict(zip(ENTITIES, self._core.residuals(), strict=True))

    @property
    def certificate(self) -> float:
        """Upper bound on `error`: ``||P [(Ff - xf) - A (F0 - x0)]|| + ||FA - A|| ||F0||``.

        ``P = B B^+``; and what rounding may add, that of `u` to doubles included.
        """
        return self._core.certificate()[0]

    @property
    def error(self) -> float:
        """``||B (u - v*)||``, ``v* = B^+ (xf - A x0)``: distance from the best reachable state."""
        return self._core.certificate()[1]

    @property
    def drift(self) -> float:
        """The largest rounding error of ``FA F0`` so far, relative to ``||FA|| ||F0||``."""
        return self._core.drift()

    @property
    def trace(self) -> Trace:
        """Errors and certificates at a few hundred steps at most."""
        steps, values = self._core.trace()
        return Trace(steps.astype(np.int64), values[:, 0], values[:, 1], values[:, 2])

    def step(self, count: int = 1) -> None:
        """Take steps.

        Parameters
        ----------
        count : int, default 1
            Number of steps, at least 1.

        Raises
        ------
        InputTypeError, SizeError
            If `count` is not such a number.
        KeyboardInterrupt
            On Ctrl-C, between two steps; `steps` has the number taken.

        Examples
        --------
        >>> import stochens_rs as se
        >>> stream = se.Stream(([[2.0]], [[1.0]]), [1.0], [0.0], rng=1)
        >>> stream.step(10)
        >>> stream.steps, float(stream.u[0])
        (10, -2.0)
        """
        self._core.advance(validation.size("count", count), None, 0.0, None)

    def run(
        self,
        *,
        tol: float | None = None,
        max_steps: int | None = None,
        time_limit: float | None = None,
        rule: Rule = "certificate",
        progress: Progress = False,
        checkpoint: PathLike | None = None,
        every: float = 60.0,
    ) -> StreamRun:
        """Take steps until the stopping rule is satisfied or a limit is met.

        Parameters
        ----------
        tol : float, optional
            Absolute tolerance of the rule, in units of the state for "certificate", of the
            control for "printed". None: no rule, only limits.
        max_steps : int, optional
            Maximum number of steps of this run.
        time_limit : float, optional
            Maximum time of this run [s].
        rule : {"certificate", "printed"}, default "certificate"
            "certificate": stop when `certificate` is at most `tol`; checked every n steps.
            "printed", as in the paper: stop when a step, at O(n m), changes the control by at most
            `tol`. That is not convergence: a repeated realization changes nothing.
        progress : bool or callable, default False
            True: a progress bar. A callable: ``progress(steps, max_steps)``, five times a second.
        checkpoint : path, optional
            File to `save` the stream to during the run and at its end, locked meanwhile. An
            existing file must be an earlier state of this stream.
        every : float, default 60
            Time between two checkpoints [s].

        Returns
        -------
        StreamRun
            With status "converged", "max_steps", "time_limit" or "interrupted".

        Raises
        ------
        InputError, InputTypeError
            If an argument cannot be used, or none of `tol`, `max_steps`, `time_limit` is given.
        StateError, StateLockedError, StateIOError
            If `checkpoint` is not an earlier state of this stream, is in use by another run, or
            cannot be saved; the stream can still be used.

        Notes
        -----
        Ctrl-C ends the run between two steps with status "interrupted"; a second one during the
        last save raises KeyboardInterrupt. The stream can be run again. With rule "certificate" and
        tol > 0, a run without limits ends with probability one.

        Examples
        --------
        >>> import stochens_rs as se
        >>> stream = se.Stream(([[0.9, 0.2], [0.0, 1.0]], [[1.0], [0.5]]), [1.0, 2.0], [0.0, 0.0])
        >>> stream.run(max_steps=1000).status
        'max_steps'
        """
        stop = checked_stop(tol, max_steps, time_limit, rule)
        bar = progress_bar(progress, stop.max_steps, "stream", "step")
        started, first = time.monotonic(), self.steps
        with Checkpoints(self, checkpoint, every) as checkpoints:
            status = run_until(self._core, stop, bar, checkpoints)
        certificate, error = self._core.certificate()
        return StreamRun(
            status=status,
            steps=self.steps - first,
            seconds=time.monotonic() - started,
            rule=stop.rule,
            certificate=certificate,
            error=error,
        )

    def _repr_html_(self) -> str:
        rows = [
            ("steps", show.grouped(self.steps)),
            ("realizations", show.counts(self.counts)),
            ("error of the state", self.error),
            ("certificate", self.certificate),
            ("control u", show.vector(self.u)),
        ]
        return show.card(self, rows, show.errors(self.trace.steps, self.trace.errors))

    def _to_sections(self) -> dict[str, Any]:
        return to_sections(self._identity, self._digest, self._core)

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Stream:
        made = cls.__new__(cls)
        made._identity, made._digest, made._core = from_sections(sections)
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return Stream._from_sections, (self._to_sections(),)

    def __repr__(self) -> str:
        name = f"Stream: n={self._identity.n}, m={self._identity.m}"
        try:
            certificate, error = self._core.certificate()
            errors = f"||B (v - v*)|| = {error:.3g} <= {certificate:.3g}"
            return f"<{name}, {show.counted(self.steps)}, {errors}>"
        except InputError:  # in a signal handler, or in a process forked while a thread used it
            return f"<{name}, in use>"
