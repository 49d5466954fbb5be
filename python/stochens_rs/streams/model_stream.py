"""`ModelStream`: a model and its certificate while measured data arrive."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, NamedTuple, overload

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.names import checked_names
from .._base.records import Positive, Probability, SavedRecord, cached_property
from .._base.running import get_num_threads
from .._base.types import DELTA, ArrayLike, Floats
from ..data.trajectories import Trajectories, in_order, pooled
from ..exceptions import InputError
from ..feedback import Loop
from ..identification import Window
from ..identification.assumptions import (
    Assumptions,
    Noise,
    as_noise,
    checked_assumptions,
    checked_scale,
)
from ..identification.model import Model
from ..identification.window import Regressors, rows_of, spread
from ..limits.limits import Cost, LimitsLike
from .snapshot import Look, LoopLook, Snapshot, look, look_at_loop, refuse
from .stream import Stateful

# The event of a stream refers to these: a stream must not go on with others.
_MIXTURES = _core.mixtures()


class Logs(SavedRecord):
    """Logs of outputs, and what was declared of them before the first one."""

    window: Regressors
    assumptions: Assumptions
    scale: Annotated[Floats, "column"]
    delta: Probability
    dt: Positive | None
    data: Trajectories | None = None

    @property
    def size(self) -> int:
        """How many pairs have a complete window."""
        return 0 if self.data is None else len(self.model.rows)

    @cached_property
    def model(self) -> Model:
        """The model of all logs so far, whose regions hold at all looks together."""
        if self.data is None:
            raise InputError("the stream has no log yet: update it with one")
        triangle = _core.triangle(rows_of(self.window, self.data)[1], get_num_threads())
        declared = self.assumptions, self.scale, self.window.intercept
        return Model(self.data, triangle, *declared, window=self.window, looks=self.delta)

    def with_more(self, x: Any) -> Logs:
        """With more runs."""
        new = validation.instance("x", x, Trajectories)
        if not new.outputs or new.dt != self.dt:
            raise InputError(f"`x` must be runs of outputs with dt={self.dt}, got {new!r}")
        made = replace(self, data=new if self.data is None else pooled([self.data, new], "x"))
        if not np.isfinite(made.model.triangle).all():  # refuses what fills no window, too
            raise InputError("`x` is too large: its squares overflow")
        return made

    @property
    def text(self) -> str:
        """What of, and how many pairs, in words."""
        return f"{self.window!r}, {show.number_of(self.size, 'pair')}"

    def sections(self) -> dict[str, Any]:
        """The parts of a file."""
        return {**self._to_sections(), "outputs": np.ones(1)}


class Pairs(NamedTuple):
    """Pairs of states: the triangle of their rows, and the state that the last one ended in."""

    begun: Snapshot  # without pairs: sizes, and what is assumed
    triangle: Floats
    size: int
    runs: int
    end: Floats

    @property
    def model(self) -> Snapshot:
        """The model of all pairs so far."""
        own = validation.frozen(self.triangle)
        return replace(self.begun, triangle=own, size=self.size, runs=self.runs)

    def with_more(self, rows: Floats) -> Pairs:
        """With more pairs."""
        # copies: NumPy 2.4 ends the process where strided arrays find no memory for its buffer
        n, triangle = self.begun.n, self.triangle.copy()
        begin, end = rows[:, :n].copy(), rows[:, -n:].copy()
        _core.triangle_update(triangle, rows)
        runs = int((begin[1:] != end[:-1]).any(axis=1).sum())
        runs += self.runs + int(self.size == 0 or (begin[0] != self.end).any())
        return Pairs(self.begun, triangle, self.size + len(rows), runs, end[-1].copy())

    @property
    def text(self) -> str:
        """What of, and how many pairs, in words."""
        of = self.begun
        dt = "" if of.dt is None else f" dt={of.dt:g}"
        pairs = show.number_of(self.size, "pair")
        return f"n={of.n} m={of.m}{dt}, {pairs}{of.assumptions.design_text}"

    def sections(self) -> dict[str, Any]:
        """The parts of a file."""
        return {**self.model._to_sections(), "end": self.end}


class ModelStream(Stateful):
    """The model ``x(k+1) = A x(k) + B u(k) + c + w(k)`` from pairs, as they arrive.

    With a `window` it is one of outputs, from whole logs, ``Trajectories(..., outputs=True)``.

    The model and its region may be asked for after every pair, inputs may be chosen from them, and
    the experiments may be stopped when a certificate is small enough: all looks at the stream are
    one event of probability 1 - `delta`.

    Parameters
    ----------
    n, m : int
        The numbers of states and inputs.
    noise : Noise or float, optional
        As in `identify`, with states measured without error. With ``design="independent"`` no state
        or input of a pair may depend on the noise of any pair, nor on a look; regions are then
        exact and usually smaller, but looks are possible at planned numbers of pairs only.
    intercept, scale
        As in `identify`.
    delta : float, default 0.05
        The probability that any look at the stream is wrong, at most, in (0, 1).
    first : int, optional
        For design "independent": the number of pairs N_0 of the first look, ``2 (n + d)`` if left
        out, d = n + m, or one more with intercept; the others are at ``ceil(N_0 2^(j/2))``.
    dt : float, optional
        The time between two steps [s].
    state_names, input_names : sequence of str, optional
        The names; the default is ``x[0]``, ``u[0]``, ..., of outputs ``y[0]``.
    window : Window or Regressors, optional
        For n outputs: ``Window(lags=, delay=)``, or that of a model of earlier runs,
        ``model.window``, which had no part in this stream. The logs themselves are kept then.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used, or contradicts another one.
    ResourceError
        If the stream does not fit into memory.

    Notes
    -----
    The pairs are kept as one triangle R with ``R' R = W' W`` for their rows (x, u, 1, x_next): a
    pair costs O((n + d)^2), and nothing grows with their number. Runs that diverged belong to the
    data: leaving them out makes every certificate wrong. The event is that of one stream: a stream
    that is started anew for the same decision needs a share of delta of its own.

    Examples
    --------
    Experiments under feedback until a control is certain to end within 0.2 of its target:

    >>> import numpy as np, stochens_rs as se
    >>> rng = np.random.default_rng(1)
    >>> stream = se.ModelStream(1, 1, noise=0.1)
    >>> x = np.array([0.0])
    >>> while True:
    ...     u = -0.5 * x + rng.standard_normal(1)
    ...     x_next = 0.9 * x + u + 0.1 * rng.standard_normal(1)
    ...     stream.update(x, u, x_next)
    ...     x = x_next
    ...     look = stream.look([0.0], [1.0], tol=0.2)
    ...     if look.stop:
    ...         break
    >>> bool(abs(look.u[0, 0] - 1.0) <= look.certificate.target <= 0.2)
    True
    """

    _kind = "pairs"

    def __init__(
        self,
        n: int,
        m: int,
        *,
        noise: Noise | float | None = None,
        intercept: bool = False,
        scale: ArrayLike = 1.0,
        delta: float = DELTA,
        first: int | None = None,
        dt: float | None = None,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        window: Window | Regressors | None = None,
    ) -> None:
        states, inputs = validation.size("n", n), validation.size("m", m)
        offset = validation.flag("intercept", intercept)
        if window is not None:
            given = state_names or [f"y[{i}]" for i in range(states)]
            named = checked_names(states, inputs, given, input_names)
            past, own = declared_window(window, named, offset), as_noise(noise)
            if first is not None or own.design != "adaptive":
                raise InputError("`window` must be left out with `first` or design='independent'")
            sizes: Any = spread(past, checked_scale(scale, states + inputs, offset))
            law = checked_assumptions(own, past.outputs)
            self._begin(Logs(past, law, sizes, delta, dt))
            return
        d = states + inputs + offset
        running.need("a stream", 4 * 8 * (d + states) ** 2)  # two triangles, the model
        names = checked_names(states, inputs, state_names, input_names)
        assumed = checked_assumptions(as_noise(noise), names[0])
        refuse(assumed)
        if first is not None and assumed.design == "adaptive":
            raise InputError("`first` needs design='independent': others may be looked at any time")
        begin = 2 * (states + d) if first is None else validation.size("first", first)
        about = Snapshot(
            triangle=validation.frozen(np.zeros((d + states,) * 2)),
            size=0,
            n=states,
            m=inputs,
            assumptions=assumed,
            scale=validation.frozen(checked_scale(scale, states + inputs, offset)),
            intercept=offset,
            delta=validation.probability("delta", delta),
            first=begin,
            dt=None if dt is None else validation.positive("dt", dt),
            state_names=names[0],
            input_names=names[1],
        )
        self._begin(Pairs(about, about.triangle, 0, 0, np.zeros(states)))

    def _begin(self, known: Pairs | Logs) -> None:
        """Start, or go on from what is known."""
        self._known, self._lock = known, threading.RLock()  # replaced as one, never changed

    def update(
        self,
        x: ArrayLike | Trajectories,
        u: ArrayLike | None = None,
        x_next: ArrayLike | None = None,
    ) -> None:
        """Take in pairs.

        Parameters
        ----------
        x : array_like of shape (n,) or (N, n), or Trajectories
            The state before the step, or those of N steps in the order of time; or whole runs,
            without `u` and `x_next`; of outputs these alone.
        u : array_like, shape (m,) or (N, m)
            The inputs.
        x_next : array_like, shape (n,) or (N, n)
            The states after the steps.

        Raises
        ------
        InputError, InputTypeError
            If a pair cannot be used, or the runs are not those of such a system. None of the pairs
            of this call is then taken in.

        Examples
        --------
        >>> import stochens_rs as se
        >>> stream = se.ModelStream(1, 1, noise=0.1)
        >>> stream.update([0.0], [1.0], [1.0])
        >>> stream.update([[1.0], [1.5]], [[1.0], [0.0]], [[1.5], [0.7]])
        >>> stream.size
        3
        """
        if isinstance(x, Trajectories):
            validation.left_out("with Trajectories", u=u, x_next=x_next)
        start = self._known
        more = x if isinstance(start, Logs) else pair_rows(start.begun, x, u, x_next)
        while True:  # again if another thread was faster: no pair is lost
            before: Any = self._known
            after = before.with_more(more)
            with self._lock:
                if self._known is before:
                    self._known = after
                    return

    @property
    def size(self) -> int:
        """The number of pairs taken in so far."""
        return self._known.size

    @property
    def model(self) -> Snapshot | Model:
        """The model after the pairs so far; later pairs do not change it. Of outputs a `Model`."""
        return self._known.model

    @overload
    def look(
        self,
        x0: ArrayLike,
        xf: ArrayLike | None = None,
        *,
        tol: float,
        steps: int = 1,
        u: ArrayLike | None = None,
        limits: LimitsLike = None,
        cost: Cost | None = None,
    ) -> Look: ...
    @overload
    def look(self, *, gain: Loop | ArrayLike) -> LoopLook: ...
    def look(
        self,
        x0: ArrayLike | None = None,
        xf: ArrayLike | None = None,
        *,
        tol: float | None = None,
        steps: int = 1,
        u: ArrayLike | None = None,
        limits: LimitsLike = None,
        cost: Cost | None = None,
        gain: Loop | ArrayLike | None = None,
    ) -> Look | LoopLook:
        """Ask whether the data are enough for a control within a tolerance, or for a feedback.

        Parameters
        ----------
        x0, xf : array_like, shape (n,)
            The initial state and the target; may depend on the data. With a reference in `cost` xf
            is left out. Of outputs the `record` and the `target` of `control`.
        tol : float
            The tolerance, in the units of the state (2-norm).
        steps : int, default 1
            The number of steps K.
        u : array_like, shape (K, m), optional
            A control of your own; None: the best one of the model.
        limits, cost : optional
            Limits and weights of the best one, as in `control`.
        gain : Loop or array_like, shape (m, n), optional
            In place of all others: a feedback ``u = K x``, such as ``gain(stream.model, Q, R)``.

        Returns
        -------
        Look or LoopLook
            The control, its certificate for the run without noise, and a forecast. With a gain its
            certificate for the region of this look, and a forecast.

        Raises
        ------
        InputError, InputTypeError
            If an argument cannot be used; or, for an independent design, if the number of pairs is
            not a planned one.

        Warns
        -----
        DataWarning
            If columns are tied exactly and not declared as `exact`: the certificate is infinite.

        Notes
        -----
        The target is within ``||xh(K) - xf|| + r_K`` with the model's states xh; for one step
        ``r_1 = sqrt(factor ||S||) ||(x0, u)||`` in the norm of V^-1, see `Region`. Stopping at the
        first one <= tol is valid, also within limits: the regions are for any inputs. Hard limits
        of states (``soft=False``) hold for every system of the region, without noise; ``missing``
        says by how much not.

        The forecast is the N with ``||xh(K) - xf|| + r_K(N) = tol`` for the same u, if V and S grow
        in proportion to N; with hard limits of states for the u of each N.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(1).standard_normal((300, 5))
        >>> x, u, w = z[:, :2], z[:, 2:3], 0.1 * z[:, 3:]
        >>> stream = se.ModelStream(2, 1, noise=0.1)
        >>> stream.update(x, u, 0.5 * x + u + w)
        >>> stream.look([1.0, 1.0], [0.0, 0.0], tol=0.1)
        <Look: within 0.04648 after 300 pairs, tol 0.1, enough>
        """
        model, best = self.model, {"limits": limits, "cost": cost}
        given: dict[str, Any] = {"x0": x0, "xf": xf, "tol": tol, "u": u, **best}
        if gain is not None:
            validation.left_out("with `gain`", **given)
            return look_at_loop(model, gain)
        if isinstance(model, Model):
            validation.left_out("with `window`", u=u)
            task = {"record": x0, "target": xf, "steps": steps, **best}
            return look(model, validation.positive("tol", tol), None, task)
        for name in ("x0", "tol") if u is None and cost is not None else ("x0", "xf", "tol"):
            if given[name] is None:
                raise InputError(f"`{name}` must be given, or a `gain`")
        limit = validation.positive("tol", tol)
        x0 = validation.vector("x0", x0, length=model.n, labels=model.state_names)
        if u is not None:
            validation.left_out("with `u`", **best)
            K = validation.size("steps", steps)
            u = validation.matrix("u", u, rows=K, cols=model.m, labels=model.input_names)
            xf = validation.vector("xf", xf, length=model.n, labels=model.state_names)
        return look(model, limit, u, {"x0": x0, "xf": xf, "steps": steps, **best})

    def __repr__(self) -> str:
        return f"<ModelStream: {self._known.text}>"

    def _repr_html_(self) -> str:
        start = self._known
        of = start if isinstance(start, Logs) else start.begun
        return show.card(self, [("assumed", of.assumptions.text)])

    def _to_sections(self) -> dict[str, Any]:
        return {**self._known.sections(), "mixtures": _MIXTURES}

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> ModelStream:
        about = dict(sections)
        mixtures, outputs = about.pop("mixtures"), about.pop("outputs", None)
        if not np.array_equal(mixtures, _MIXTURES):
            raise InputError("`mixtures` must be those of this version: its event is another")
        made = cls.__new__(cls)
        if outputs is not None:
            made._begin(Logs._from_sections(about))
            return made
        end, model = about.pop("end"), Snapshot._from_sections(about)
        own = validation.vector("end", end, length=model.n)
        made._begin(Pairs(model, model.triangle, model.size, model.runs, own))
        return made


def pair_rows(about: Snapshot, x: Any, u: Any, x_next: Any) -> Floats:
    """Check pairs or runs of a stream, and return their rows."""
    n, m = about.n, about.m
    if isinstance(x, Trajectories):
        if x.outputs:
            raise InputError("`x` must be runs of states, got outputs: see identify")
        validation.same_sizes("x", (x.n, x.m), (n, m), "this stream")
        if x.dt != about.dt:
            raise InputError(f"`x` must have dt={about.dt} as ModelStream(dt=), got dt={x.dt}")
        if about.assumptions.design == "independent" and not x.single:
            raise InputError("`x` must be single pairs for design='independent': use last_pairs()")
        before, inputs, after = in_order("x", x, about.labels)
    elif u is None or x_next is None:
        raise InputError("`u` and `x_next` must be given with `x`")
    elif validation.array("x", x, ndim=(1, 2)).ndim == 1:
        before = validation.vector("x", x, length=n)[None]
        inputs = validation.vector("u", u, length=m)[None]
        after = validation.vector("x_next", x_next, length=n)[None]
    else:
        before = validation.matrix("x", x, cols=n)
        inputs = validation.matrix("u", u, rows=len(before), cols=m)
        after = validation.matrix("x_next", x_next, rows=len(before), cols=n)
    running.need("the pairs", 8 * len(before) * len(about.triangle))
    return np.hstack([before, inputs, np.ones((len(before), int(about.intercept))), after])


def declared_window(window: Any, names: tuple[Any, Any], offset: bool) -> Regressors:
    """The window of these outputs and inputs, which no data of the stream choose."""
    if isinstance(window, Regressors):
        if (len(window.outputs), len(window.inputs)) != tuple(map(len, names)):
            raise InputError(f"`window` must be of the sizes of this stream, got {window}")
        if window.intercept != offset:
            raise InputError(f"`intercept` must be {window.intercept}, as that of the window")
        return window
    asked = validation.instance("window", window, Window)
    lags, delay = asked.lags, asked.delay
    if not isinstance(lags, int) or not isinstance(delay, int) or delay < 0 or asked.tail:
        raise InputError(
            "`window` must be Window(lags=, delay=) of numbers, without a tail, or `model.window` "
            f"of earlier runs, got {window}"
        )
    return Regressors(*names, lags, None, delay, offset)
