"""`Stream`: the sequential algorithm, whose control improves with every realization."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base import html, memory, validation
from .._base.durable import Durable
from .._base.files import PathLike
from .._base.progress import Progress, progress_bar
from .._base.types import Floats
from ..exceptions import InputError
from ..rng import Key, RngLike, as_key
from ..system import System
from ..theory.dynamics import checked_ends
from .records import StreamRun, Trace
from .state import ENTITIES, SLOTS, Identity, Slots, from_sections, to_sections
from .step_loop import Checkpoints, Rule, checked_stop, run_until

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


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
        memory.need("a stream", (80 if safe else 64) * n * n + 40 * n * m)
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
            ("steps", html.grouped(self.steps)),
            ("realizations", html.counts(self.counts)),
            ("error of the state", self.error),
            ("certificate", self.certificate),
            ("control u", html.vector(self.u)),
        ]
        return html.card(self, rows, html.errors(self.trace.steps, self.trace.errors))

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
            return f"<{name}, {html.counted(self.steps)}, {errors}>"
        except InputError:  # in a signal handler, or in a process forked while a thread used it
            return f"<{name}, in use>"
