"""`Stream`: Algorithm 1 on realizations that it draws, with stopping rules and checkpoints."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from .. import _core
from .._base import files, running, show, validation
from .._base.files import Durable, PathLike
from .._base.running import Progress, progress_bar
from .._base.types import ArrayLike, Axes, Floats, NDArray, Status
from ..exceptions import InputError, StateError, StateIOError
from ..plots.lines import draw_trace
from ..rng import Key, RngLike, as_key
from ..system.system import System
from ..theory.exact import checked_ends

ENTITIES = ("x0", "xf", "A")
Slots: TypeAlias = Literal["random", "round-robin", "gain"]
Rule: TypeAlias = Literal["certificate", "printed"]

_ENDLESS = 2**62  # more steps than any run can take
_SLICE = 0.2  # seconds between two calls of the progress bar
_SAME = ("key", "format", "B", "x0", "xf", "A")  # in all states of a stream


@dataclass(frozen=True)
class StreamRun:
    """The result of `Stream.run`.

    Attributes
    ----------
    status : {"converged", "max_steps", "time_limit", "interrupted"}
        How the run ended. "converged": the stopping rule is satisfied. "max_steps", "time_limit":
        this limit was reached first. "interrupted": Ctrl-C.
    steps : int
        Steps of this run.
    seconds : float
        Duration of this run [s].
    rule : str or None
        "certificate", "printed", or None if no tolerance was given.
    certificate : float or None
        The bound on ``||B (v - v*)||`` at the end.
    error : float
        ``||B (v - v*)||`` at the end.
    """

    status: Status
    steps: int
    seconds: float
    rule: str | None
    certificate: float
    error: float


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
    """Errors of a stream over its steps: the first 16, then 8 between k and 2 k.

    Attributes
    ----------
    steps : ndarray of int64, shape (k,)
        Number of steps taken.
    certificates : ndarray, shape (k,)
        The bound on ``||B (v - v*)||``.
    errors : ndarray, shape (k,)
        ``||B (v - v*)||`` without the rounding of v to doubles.
    step_sizes : ndarray, shape (k,)
        The step size t of each of these steps (1 at the start).
    """

    steps: NDArray[np.int64]
    certificates: Floats
    errors: Floats
    step_sizes: Floats

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the error and the certificate over the steps, both axes logarithmic.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw. Default: a new figure (``ax.figure``).

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            If matplotlib is not installed.

        Notes
        -----
        Step 0 and zeros cannot be drawn on logarithmic axes and are left out.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = ([[0.9, 0.2], [0.0, 1.0]], [[1.0], [0.5]])
        >>> stream = se.Stream(system, [1.0, 2.0], [0.0, 0.0], rng=1)
        >>> stream.step(100)
        >>> stream.trace.plot().get_xlabel()
        'step'
        """
        return draw_trace(self.steps, self.errors, self.certificates, ax)

    def _repr_html_(self) -> str:
        return show.card(self, [], show.errors(self.steps, self.errors))

    def __len__(self) -> int:
        return len(self.steps)

    def __repr__(self) -> str:
        last = f"{self.errors[-1]:.3g}" if len(self) else "none"
        end = int(self.steps[-1]) if len(self) else 0
        return f"<Trace: {len(self)} entries up to step {end}, last error {last}>"


class Stateful(Durable):
    """What is copied and pickled as it is saved."""

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self)._from_sections, (self._to_sections(),)


class Stream(Stateful):
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

    Attributes
    ----------
    key : Key
        The key of all realizations.

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
        n, m = self._shape = checked.n, checked.m
        order = validation.choice("slots", slots, get_args(Slots))
        safe = validation.flag("safeguard", safeguard)
        # laws, estimates, sums, tables of both matrices, and the pseudoinverse
        running.need("a stream", (80 if safe else 64) * n * n + 40 * n * m)
        self.key = as_key(rng)
        columns = np.ascontiguousarray(checked.A.T)
        self._core = _core.Stream(checked.B, start, goal, columns, _keys(self.key), safe, order)

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
        rule = validation.choice("rule", rule, get_args(Rule))
        limit = None if tol is None else validation.positive("tol", tol)
        most = None if max_steps is None else validation.size("max_steps", max_steps)
        seconds = None if time_limit is None else validation.positive("time_limit", time_limit)
        if limit is None and most is None and seconds is None:
            raise InputError("one of `tol`, `max_steps` and `time_limit` must be given")
        bar = progress_bar(progress, most, "stream", "step")
        path = None if checkpoint is None else files.checked_path("checkpoint", checkpoint)
        pause = validation.positive("every", every)
        started, first = time.monotonic(), self.steps
        status: Status = "interrupted"
        with ExitStack() as stack:
            lock = None if path is None else files.lock(path)
            if lock is not None and path is not None:
                stack.callback(lock.release)
                self._require_earlier(path)

            def save() -> float:
                if path is not None:
                    files.save(path, self._kind, self._to_sections(), lock)
                return time.monotonic() + pause

            def satisfied() -> bool:
                by = limit if rule == "certificate" else None
                return by is not None and self._core.certificate()[0] <= by

            due = time.monotonic() + pause
            try:
                with bar as report:
                    done: Status | None = "converged" if satisfied() else None
                    while done is None:
                        left = _ENDLESS if most is None else most - (self.steps - first)
                        rest = _SLICE
                        if seconds is not None:
                            rest = max(seconds - (time.monotonic() - started), 0.0)
                        own = None if limit is None else rule
                        end = self._core.advance(left, own, limit or 0.0, min(_SLICE, rest))
                        report(self.steps - first)
                        due = save() if time.monotonic() >= due else due
                        if end != "time_limit" or (seconds is not None and rest <= _SLICE):
                            done = "converged" if satisfied() else end
                    status = done
            except KeyboardInterrupt:
                pass  # the core stops between two steps
            except (StateError, StateIOError):
                raise  # from a checkpoint
            except BaseException:  # from `bar` or a signal handler
                save()
                raise
            try:
                save()
            except KeyboardInterrupt:
                if status == "interrupted":
                    raise  # the second one
                status = "interrupted"
                save()
        certificate, error = self._core.certificate()
        return StreamRun(
            status=status,
            steps=self.steps - first,
            seconds=time.monotonic() - started,
            rule=None if limit is None else rule,
            certificate=certificate,
            error=error,
        )

    def _require_earlier(self, path: str) -> None:
        """Raise if a file is anything else than an earlier state of this stream."""
        previous = path + ".prev"
        if not (os.path.lexists(path) or os.path.lexists(previous)):
            return
        _, theirs = files.load(path, self._kind)
        ours = self._to_sections()
        if any(k not in theirs or ours[k].tobytes() != theirs[k].tobytes() for k in _SAME):
            raise StateError(f"{path} must be of this problem, key and options, got another")
        there, here = int(theirs["steps"][0]), int(ours["steps"][0])
        if there > here:
            raise StateError(
                f"{path} is at step {there}, ahead of this stream at step {here}: load it "
                f"(`Stream.load`), choose another path, or remove it and {previous}"
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
        return {"key": np.frombuffer(bytes(self.key), np.uint8), **dict(self._core.to_sections())}

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Stream:
        state, made = dict(sections), cls.__new__(cls)
        key = np.asarray(state.pop("key", ()))
        if key.dtype != np.uint8 or key.shape != (32,):
            raise InputError("`state` must have 32 bytes in 'key'")
        made.key, made._core = Key(key.tobytes()), _core.Stream.from_sections(list(state.items()))
        if state["keys"].tobytes() != b"".join(_keys(made.key)):
            raise InputError("`state` must have the keys that follow from its key")
        n, m = state["format"][1:3].tolist()
        made._shape = n, m
        return made

    def __repr__(self) -> str:
        name = "Stream: n={}, m={}".format(*self._shape)
        try:
            certificate, error = self._core.certificate()
            errors = f"||B (v - v*)|| = {error:.3g} <= {certificate:.3g}"
            return f"<{name}, {show.number_of(self.steps)}, {errors}>"
        except InputError:  # in a signal handler, or in a process forked while a thread used it
            return f"<{name}, in use>"


def _keys(key: Key) -> list[bytes]:
    """The keys of the realizations of x0, xf and A, and of the choice of slots."""
    return [bytes(key.child(name)) for name in (*ENTITIES, "slots")]
