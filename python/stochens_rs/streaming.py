"""The sequential algorithm: a control that gets better with every realization."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from . import _core, _gate, _html
from ._durable import Checkpoints, Durable, PathLike
from ._progress import Progress, progress_bar
from .exceptions import InputError, StateError, StateIOError
from .rng import Key, RngLike, as_key
from .stream_records import StreamRun, Trace

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats: TypeAlias = NDArray[np.float64]

__all__ = ["Stream"]

Variant: TypeAlias = Literal["consistent", "semi", "literal"]
Slots: TypeAlias = Literal["random", "round-robin", "gain"]
Rule: TypeAlias = Literal["certificate", "printed"]

_VARIANTS = ("consistent", "semi", "literal")
_SLOTS = ("random", "round-robin", "gain")
_RULES = ("certificate", "printed")
_CHILDREN = ("x0", "xf", "A", "slots")
_ENDLESS = 2**62
_SLICE = 0.2  # seconds between two looks at the progress bar


class Stream(Durable):
    """Algorithm 1 of the paper on realizations that the stream draws itself.

    Every step draws one realization E for one slot (x0, xf or A), moves that slot's estimate F
    towards it as far as that helps, and the control with it:
    ``t = clip(<E* - F, E - F> / ||E - F||^2, 0, 1)``, ``F <- (1 - t) F + t E``,
    ``v <- (1 - t) v + t v'``, ``v' = B^+ (xf - A x0)`` from E and the other slots' estimates.
    The start is one realization per slot.

    Parameters
    ----------
    B : array_like, shape (n, m)
        Input matrix, known.
    x0, xf : array_like, shape (n,)
        What is drawn from and fitted to: exact or nominal initial state and target.
    A : array_like, shape (n, n)
        The same for the system matrix; its columns are drawn independently.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness. Realization k of slot "x0" is realization k of
        ``sample(x0, ..., rng=key.child("x0"))``, and so on for "xf" and "A".
    variant : {"consistent", "semi", "literal"}, default "consistent"
        The printed algorithm can be read in three ways; only the first converges. "semi" and
        "literal" are there for comparison: v' comes from the latest *realizations* of all slots,
        and "literal" also searches from the previous realization instead of the estimate.
    safeguard : bool, default False
        Follow every step by one more line search, towards the mean of the slot's realizations.
        Each estimate is then never worse than that mean. For "consistent" only.
    slots : {"random", "round-robin", "gain"}, default "random"
        Which slot moves: each with probability 1/3, as in the paper; in turn; or the one whose
        part of the squared error is sure to fall most in the mean, ``d^4 / (V + d^2)`` times the
        squared factor by which the slot's error d enters the state (``||A||``, 1, ``||F0||``).

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    ResourceError
        If the stream does not fit into the memory this process may use.

    Notes
    -----
    *Invariant* (corrected Algorithm 1): the control is affine in each slot, so in the consistent
    variant ``v = B^+ (Ff - FA F0)`` after every step. The stream keeps ``FA F0`` up to date in
    O(n) per step and applies ``B^+`` when `u` is asked for: a step costs O(n), reading `u`
    O(n m), reading `certificate` or `error` O(n^2). (In time, more than O(n) once the estimate of A
    no longer fits into the processor's caches, n > 300 or so: its entries are hit at random.)
    Everything that is carried along is
    recomputed from the estimates every ``16 max(n, 16)`` steps; `drift` says how far it had gone.

    *Mean-square bound*, with ``n_i`` realizations in slot i that do not depend on the choice of
    slots, ``V = E ||E - E*||^2``: ``E ||B (v - v*)||^2 <= 3 [Vf / n_f + ||A||^2 V0 / n_0 +
    (VA / n_A) (||x0|| + sqrt(V0 / n_0))^2]``.

    Any thread may use a stream; one waits for the other. Signal handlers run while it is at work:
    one that uses the same stream gets InputError; one that waits for a thread that uses it waits
    forever. A process that was forked while another thread used a stream gets InputError for it.

    A result is a function of the arguments, the key and the number of steps: not of how many
    calls took them, nor of whether the stream was saved and loaded between them.

    Examples
    --------
    >>> import stochens_rs as se
    >>> A, B = [[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]]
    >>> stream = se.Stream(B, [1.0, 2.0], [0.0, 0.0], A, rng=1)
    >>> run = stream.run(tol=1e-3)
    >>> run.status, run.certificate <= 1e-3, run.error <= run.certificate
    ('converged', True, True)
    >>> stream.u.shape
    (2,)
    """

    _kind = "stream"

    def __init__(
        self,
        B: ArrayLike,
        x0: ArrayLike,
        xf: ArrayLike,
        A: ArrayLike,
        *,
        rng: RngLike = None,
        variant: Variant = "consistent",
        safeguard: bool = False,
        slots: Slots = "random",
    ) -> None:
        inputs = _gate.matrix("B", B)
        n, m = inputs.shape
        start, goal = _gate.vector("x0", x0, length=n), _gate.vector("xf", xf, length=n)
        matrix = _gate.matrix("A", A, rows=n, cols=n)
        name = _gate.choice("variant", variant, _VARIANTS)
        order = _gate.choice("slots", slots, _SLOTS)
        safe = _gate.flag("safeguard", safeguard)
        if safe and name != "consistent":
            raise InputError(f"`safeguard` must be False for variant '{name}', got True")
        if order == "gain" and name == "literal":
            raise InputError(
                "`slots` must be 'random' or 'round-robin' for variant 'literal', which fuses "
                "nothing, got 'gain'"
            )
        # laws, estimates, sums, tables of both matrices, and the pseudoinverse
        _gate.memory("a stream", (80 if safe else 64) * n * n + 40 * n * m)
        key = as_key(rng)
        columns = np.ascontiguousarray(matrix.T)
        self._key = key
        self._shape = (n, m)
        self._options = (name, safe, order)
        self._digest = _digest(key, self._options, inputs, start, goal, columns)
        self._core = _core.Stream(inputs, start, goal, columns, _keys(key), name, safe, order)

    @property
    def key(self) -> Key:
        """The key that all realizations come from."""
        return self._key

    @property
    def variant(self) -> str:
        """The variant: "consistent", "semi" or "literal"."""
        return self._options[0]

    @property
    def digest(self) -> str:
        """SHA-256 of key, options, B, x0, xf and A: the same for the same problem, 64 digits."""
        return self._digest

    @property
    def steps(self) -> int:
        """Steps taken so far."""
        return self._core.counts()[0]

    @property
    def counts(self) -> dict[str, int]:
        """Realizations used so far, for "x0", "xf" and "A"."""
        return dict(zip(_CHILDREN, self._core.counts()[1], strict=False))

    @property
    def u(self) -> Floats:
        """The control v, shape (m,)."""
        return self._core.control()

    @property
    def estimates(self) -> dict[str, Floats]:
        """The estimates of "x0" (n,), "xf" (n,) and "A" (n, n); "literal": latest realizations."""
        x0, xf, columns = self._core.estimates()
        return {"x0": x0, "xf": xf, "A": np.ascontiguousarray(columns.T)}

    @property
    def residuals(self) -> dict[str, float]:
        """``||F - E*||`` for "x0", "xf" (2-norm) and "A" (Frobenius), summed from the entries."""
        return dict(zip(_CHILDREN, self._core.residuals(), strict=False))

    @property
    def certificate(self) -> float | None:
        """``||P [(Ff - xf) - A (F0 - x0)]|| + ||FA - A|| ||F0||``, P = B B^+.

        It bounds ``||B (v - v*)||``, ``v* = B^+ (xf - A x0)``; None for the variants whose
        control is not the one that their estimates give.
        """
        value = self._core.certificate()[0]
        return None if np.isnan(value) else value

    @property
    def error(self) -> float:
        """``||B (v - v*)||``: how far from the best state the control leads, an identity."""
        return self._core.certificate()[1]

    @property
    def drift(self) -> float:
        """The largest drift of ``FA F0`` repaired so far, relative to ``||FA|| ||F0||``."""
        return self._core.drift()

    @property
    def trace(self) -> Trace:
        """What was written down on the way; it does not depend on how many calls took the steps.

        At most a few hundred entries, however long the stream runs.
        """
        steps, values = self._core.trace()
        return Trace(steps.astype(np.int64), values[:, 0], values[:, 1], values[:, 2])

    def step(self, count: int = 1) -> None:
        """Take steps.

        Parameters
        ----------
        count : int, default 1
            How many, at least 1.

        Raises
        ------
        InputTypeError, SizeError
            If `count` is not such a number.
        KeyboardInterrupt
            On Ctrl-C, between two steps: `steps` says how many were taken, and all is in order.

        Examples
        --------
        >>> import stochens_rs as se
        >>> stream = se.Stream([[1.0]], [1.0], [0.0], [[2.0]], rng=1)
        >>> stream.step(10)
        >>> stream.steps, float(stream.u[0])
        (10, -2.0)
        """
        self._core.advance(_gate.size("count", count), None, 0.0, None)

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
        """Take steps until the control is good enough, or a limit is met.

        Parameters
        ----------
        tol : float, optional
            Tolerance of the rule, absolute: in units of the state for "certificate", of the
            control for "printed". None: no rule, only limits.
        max_steps : int, optional
            Most steps of this run.
        time_limit : float, optional
            Most seconds of this run [s].
        rule : {"certificate", "printed"}, default "certificate"
            "certificate": stop when `certificate` is at most `tol`; then so is `error`. It is
            looked at every n steps and at the start. "printed": stop when a step changes the
            control by at most `tol`, as in the paper. That is no sign of convergence: a useless
            or repeated realization changes nothing, so it stops at the first one, with any error
            (and a step costs O(n m)).
        progress : bool or callable, default False
            True: a bar on a terminal or in a notebook. A callable is called as
            ``progress(steps, max_steps)`` about five times a second.
        checkpoint : path, optional
            Where to `save` the stream on the way and at the end, however the run ends. What is
            there already must be a state of the same problem, key and options that is not ahead
            of this stream. Until the run ends, no other run or `save` can write there.
        every : float, default 60
            Seconds between two checkpoints [s].

        Returns
        -------
        StreamRun
            How the run ended: "converged", "max_steps", "time_limit" or "interrupted".

        Raises
        ------
        InputError, InputTypeError
            If an argument cannot be used, or none of `tol`, `max_steps`, `time_limit` is given,
            or the variant has no certificate.
        StateError
            If something else than an earlier state of this stream is at `checkpoint`.
        StateLockedError
            If another run has the same `checkpoint`; no step was taken.
        StateIOError
            If a checkpoint cannot be saved; the stream itself is in order.

        Notes
        -----
        Ctrl-C ends the run between two steps with status "interrupted" and raises nothing: the
        script goes on with its next line, and the stream with its next step whenever it is asked
        to. A second one, during the last save, raises. For tol > 0 the rule "certificate" is met
        with probability one.

        Examples
        --------
        >>> import stochens_rs as se
        >>> stream = se.Stream([[1.0], [0.5]], [1.0, 2.0], [0.0, 0.0], [[0.9, 0.2], [0, 1]], rng=1)
        >>> stream.run(max_steps=1000).status
        'max_steps'
        >>> stream.run(tol=1e-9, rule="printed").steps < 20
        True
        """
        rule_name = _gate.choice("rule", rule, _RULES)
        limit = None if tol is None else _gate.positive("tol", tol)
        most = None if max_steps is None else _gate.size("max_steps", max_steps)
        seconds = None if time_limit is None else _gate.positive("time_limit", time_limit)
        if limit is None and most is None and seconds is None:
            raise InputError("`tol`, `max_steps` or `time_limit` must be given: nothing ends a run")
        if limit is not None and rule_name == "certificate" and self.variant != "consistent":
            raise InputError(
                f"`tol` must be None for variant '{self.variant}' with rule 'certificate': its "
                "control has none"
            )
        if not callable(progress):
            _gate.flag("progress", progress)
        checked = None if limit is None else rule_name
        started, first = time.monotonic(), self.steps
        status = "interrupted"
        with Checkpoints(self, checkpoint, every) as checkpoints:
            try:
                with progress_bar(progress, most, "stream", "step") as report:
                    status = self._run(checked, limit or 0.0, most, seconds, report, checkpoints)
            except KeyboardInterrupt:
                pass  # the core stops between two steps
            except (StateError, StateIOError):
                raise  # of the checkpoints themselves
            except BaseException:  # of the caller: from `progress` or a signal's handler
                checkpoints.save()
                raise
            try:
                checkpoints.save()
            except KeyboardInterrupt:
                if status == "interrupted":
                    raise  # the second one
                status = "interrupted"
                checkpoints.save()
        certificate, error = self._core.certificate()
        return StreamRun(
            status=status,
            steps=self.steps - first,
            seconds=time.monotonic() - started,
            rule=checked,
            certificate=None if np.isnan(certificate) else certificate,
            error=error,
        )

    def _run(
        self,
        rule: str | None,
        tol: float,
        most: int | None,
        seconds: float | None,
        report: Callable[[int], object],
        checkpoints: Checkpoints,
    ) -> str:
        def satisfied() -> bool:
            return rule == "certificate" and self._core.certificate()[0] <= tol

        if satisfied():
            return "converged"
        first, started = self.steps, time.monotonic()
        while True:
            left = _ENDLESS if most is None else most - (self.steps - first)
            rest = _SLICE if seconds is None else seconds - (time.monotonic() - started)
            end = self._core.advance(left, rule, tol, min(_SLICE, max(rest, 0.0)))
            report(self.steps - first)
            checkpoints.due()
            if end != "time_limit" or (seconds is not None and rest <= _SLICE):
                return "converged" if satisfied() else end

    def _repr_html_(self) -> str:
        return _html.stream(self)

    def _to_sections(self) -> dict[str, Any]:
        """Return the state as named arrays of bytes, counters and numbers, digest included."""
        own = {"key": _bytes(bytes(self._key)), "digest": _bytes(bytes.fromhex(self._digest))}
        return own | dict(self._core.to_sections())

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Stream:
        """Make a stream of what `_to_sections` returned, after checking that it can be one."""
        state = dict(sections)
        own = {name: np.asarray(state.pop(name, ())) for name in ("key", "digest")}
        for name, array in own.items():
            if array.dtype != np.uint8 or array.shape != (32,):
                raise InputError(f"`state` must have 32 bytes in '{name}', got others or none")
        key, digest = Key(own["key"].tobytes()), own["digest"].tobytes().hex()
        core = _core.Stream.from_sections(list(state.items()))
        n, m, variant, safeguard, order = (int(v) for v in state["format"][1:])
        options = (_VARIANTS[variant], bool(safeguard), _SLOTS[order])
        arrays = (state["B"].reshape(n, m), state["x0"], state["xf"], state["A"].reshape(n, n))
        if state["keys"].tobytes() != b"".join(_keys(key)):
            raise InputError("`state` must have keys that belong to its key, got others")
        if _digest(key, options, *arrays) != digest:
            raise InputError("`state` must be of the problem that its digest names, got another")
        made = cls.__new__(cls)
        made._key, made._shape, made._options = key, (n, m), options
        made._digest, made._core = digest, core
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return Stream._from_sections, (self._to_sections(),)

    def __repr__(self) -> str:
        name = f"Stream ({self.variant}): n={self._shape[0]}, m={self._shape[1]}"
        try:
            certificate, error = self._core.certificate()
            bound = "" if np.isnan(certificate) else f" <= {certificate:.3g}"
            return f"<{name}, {_html.counted(self.steps)}, ||B (v - v*)|| = {error:.3g}{bound}>"
        except InputError:  # in a signal's handler, or in a child forked while a thread used it
            return f"<{name}, in use>"


def _keys(key: Key) -> list[bytes]:
    return [bytes(key.child(name)) for name in _CHILDREN]


def _bytes(value: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(value, dtype=np.uint8).copy()


def _digest(key: Key, options: tuple[str, bool, str], *arrays: Floats) -> str:
    """SHA-256 of what makes a stream what it is; shapes keep the numbers apart."""
    text = f"{options}{[array.shape for array in arrays]}"
    made = hashlib.sha256(b"stochens stream v1\0" + bytes(key) + text.encode() + b"\0")
    for array in arrays:
        made.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return made.hexdigest()
