"""Limits of states that a loop keeps with a probability."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, TypeAlias

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.records import Options, Probability, cached_property
from .._base.types import ROUNDING, Floats, Status
from ..controls.bounds import proof_of
from ..exceptions import InputError, SolverError
from ..feedback import Loop, LoopCertificate
from ..feedback.certificate import noise_bound
from ..identification.identified import Identified
from ..identification.region import entered
from ..identification.window import Regressors
from ..limits.problem import Task

if TYPE_CHECKING:
    from ..limits.limits import Limits
    from ..system.system import System

Found: TypeAlias = tuple[Floats, Status, float]  # a plan (K, m), and its gap
# of a loop from readings: the names of all limits, changes of inputs as rows of states and inputs,
# and whether readings and the last inputs are states behind the window
Rows: TypeAlias = tuple[tuple[str, ...], Floats, tuple[bool, bool] | None]
ROUNDS = 8  # plans of the first call, each with limits that are tighter by what the last needed
ROOM = 1.02  # how much more than the last plan needed is kept back for the model


class Kept:
    """Limits that a loop keeps in its first calls, together with a stated probability.

    Made by `regulate` with `keep`, and ``loop.kept`` there. A plan from the state x(j) is
    followed by ``u = v + K (x - xb)``, xb the states of the model under v, and ``v = K xb`` behind
    it, which leads to the origin. It is accepted if it keeps limits that are tighter by what the
    errors of the model and noise can add, for every system of the region and until the states are
    inside for good. Else the plan before goes on, which stays accepted: what was accepted once
    never becomes infeasible.

    For a model of outputs the states are the window, with limited readings behind filters, and
    limited changes of the inputs are below these, as in `names`. The promise begins with the first
    window of which every reading came.

    The promise ends after its calls, and where a state is not known or beyond its limits, a
    reading is missing or rejected, another input acted than was returned, an input had to be cut to
    its limits, or the watch of the loop rings: `ended` and the log then say so. The loop goes on by
    such plans, from its estimate of the window, with status "unproved", until `reset`.

    Attributes
    ----------
    proof : LoopCertificate
        What is proved of the gain, with the region of systems.
    calls : int
        The number of calls since the first that the promise is about.
    eps : float
        The probability that is given away for noise.
    low, high : ndarray, shape (n + m,)
        The limits of states and inputs; of readings also of changes, as all arrays below.
    names : tuple of str
        What each limit is of.
    missing : float
        By how much the last plan missed the tighter limits; 0 if it was accepted.
    ended : str or None
        Why nothing is promised any more.
    rows : tuple (names, below, behind) or None
        Of a model of outputs: what each limit is of, changes of inputs as rows of states and
        inputs, and whether readings and last inputs are states behind the window.
    """

    def __init__(
        self,
        proof: LoopCertificate,
        low: Floats,
        high: Floats,
        eps: float,
        calls: int,
        rows: Rows | None = None,
    ) -> None:
        self.proof, self.low, self.high, self.eps, self.calls = proof, low, high, eps, calls
        names = *proof.labels.states, *proof.labels.inputs
        self.names, self.below, self.behind = rows or (names, np.zeros((0, len(low))), None)
        self.reset()

    def reset(self) -> None:
        """Begin anew: the next call is the first one.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 60, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> model = se.identify(data, noise=0.1)
        >>> keep = se.Keep(se.gain(model, 1.0, 1.0), calls=20)
        >>> loop = se.regulate(model, 5, limits=(-1.0, 1.0), keep=keep)
        >>> u = loop([0.1])
        >>> loop.kept.reset()
        >>> loop.kept.since, loop.kept.model.tolist()
        (0, [0.0, 0.0])
        """
        self._model = np.zeros(len(self.low))
        self._start: Floats | None = None
        self._plan: Floats | None = None
        self.since, self.count = 0, 0  # steps since the plan began, and calls since the first plan
        self.missing = 0.0
        self.ended: str | None = None

    @cached_property
    def _core(self) -> _core.Keeper:
        feedback, (noise, eps) = self.proof._core, noise_bound(self.proof, "keep", self.eps)
        if self.behind and any(self.behind) and self.proof.source is not None:
            of, K = self.proof.source, self.proof.K
            region = entered(of.region, *followed(of.window, of.region.centre, self.behind), len(K))
            K = np.pad(K, [(0, 0), (0, region.n - K.shape[1])])
            feedback, noise = feedback.behind(region.linear, K), np.array(region.noise)
        limits = self.low, self.high, self.below
        made = _core.Keeper.of(feedback, limits, noise, eps, self.calls)
        if made is None:
            raise SolverError(
                "no bound of what noise does in this loop could be proved: take more data, another "
                "gain, or limits of fewer kinds"
            )
        return made

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_core"}

    def end(self, cause: str) -> list[str]:
        """Promise no limit any more if one was; what to say of it, if it is news.

        Parameters
        ----------
        cause : str
            Why.

        Returns
        -------
        list of str
            One sentence, or none if nothing was promised.

        Raises
        ------
        InputTypeError
            If `cause` is no text.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 60, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> model = se.identify(data, noise=0.1)
        >>> keep = se.Keep(se.gain(model, 1.0, 1.0), calls=20)
        >>> loop = se.regulate(model, 5, limits=(-1.0, 1.0), keep=keep)
        >>> u = loop([0.1])
        >>> loop.kept.end("the plant was opened"), loop.kept.end("again")
        (['no limit is promised any more: the plant was opened'], [])
        """
        if self._plan is None or self.ended is not None:
            return []
        self.ended = f"no limit is promised any more: {validation.text('cause', cause)}"
        return [self.ended]

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.names) - len(self.proof.K) - len(self.below)

    @property
    def keep(self) -> float:
        """The probability with which all limits are kept in all calls, at least."""
        return 1.0 - self.proof.region.delta - self.eps

    @property
    def noise(self) -> Floats:
        """The margin of the limits for noise, shape (n + m,), in the units of states and inputs."""
        return self._core.noise

    @property
    def model(self) -> Floats:
        """The margin for the error of the model, (n + m,); 0 if the first plan had room."""
        return self._model.copy()

    @property
    def tightening(self) -> Floats:
        """Both margins together, shape (n + m,): the plans keep limits that are tighter by this."""
        return self.model + self.noise

    def tightened(self, task: Task) -> Task:
        """Tighten limits by both margins; those of the first input stay.

        Parameters
        ----------
        task : Task
            What plans minimise, and its limits.

        Returns
        -------
        Task
            The same within limits that are tighter by `tightening`.

        Raises
        ------
        SolverError
            If the margins leave no room between two limits.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 60, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> model = se.identify(data, noise=0.1)
        >>> keep = se.Keep(se.gain(model, 1.0, 1.0), calls=20)
        >>> loop = se.regulate(model, 5, limits=(-1.0, 1.0), keep=keep)
        >>> from stochens_rs.limits.problem import Task
        >>> one, far = np.eye(1), np.ones((5, 1))
        >>> task = Task(-far, far, one, one, reference=0.0 * far)
        >>> loop.kept.tightened(task).high[:2].round(3)
        array([[1.   ],
               [0.896]])
        """
        model, noise, n, m = self.model, self.noise, self.n, task.low.shape[1]
        off = model + noise
        wide = self.high - self.low - 2.0 * off
        if (wide <= 0.0).any():
            i = int(np.argmin(wide))
            self._refuse(i, None, float(-wide[i] / 2.0), float(model[i]), float(noise[i]))
        inputs = np.tile(off[n : n + m], (task.steps, 1))
        inputs[0] = 0.0
        made = replace(task, low=task.low + inputs, high=task.high - inputs)
        if task.state_low is None or task.state_high is None:
            return made
        states, changes = (np.tile(of, (task.steps, 1)) for of in (off[:n], off[n + m :]))
        first = changes * np.where(np.arange(task.steps) > 0, 1.0, 1e-6)[:, None]  # for rounding
        states = np.hstack([states, first, changes])
        low, high = task.state_low + states, task.state_high - states
        return replace(made, state_low=low, state_high=high)

    def choose(
        self, x: Floats, found: Found, again: Callable[[], Found], until: float
    ) -> tuple[Floats, Floats, Status, float]:
        """Accept a plan, or go on with the one before.

        Parameters
        ----------
        x : ndarray, shape (n,)
            The state.
        found : tuple (plan, status, gap)
            The newest plan from there.
        again : callable
            Plans anew, within limits that are tighter by then.
        until : float
            When to stop, of `time.perf_counter`.

        Returns
        -------
        plan, u, status, gap
            The plan to go on with, and its input at x.

        Raises
        ------
        SolverError
            If no plan was accepted yet.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 60, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> model = se.identify(data, noise=0.1)
        >>> keep = se.Keep(se.gain(model, 1.0, 1.0), calls=20)
        >>> loop = se.regulate(model, 5, limits=(-1.0, 1.0), keep=keep)
        >>> found = np.zeros((5, 1)), "optimal", 0.0  # no input at all
        >>> plan, u, status, gap = loop.kept.choose(np.array([0.01]), found, lambda: found, np.inf)
        >>> u.tolist(), status
        ([0.0], 'optimal')
        """
        plan, status, gap = found
        first = self._plan is None
        short, part = self._core.judge(x, plan, first)
        for _ in range(ROUNDS if first else 1):
            if short is None or perf_counter() >= until:
                break
            if not first and short[2] > short[3] * (1.0 + ROUNDING):
                break  # noise alone is too much for it
            # keep back what this plan would have needed for the model, if that is more
            part = part if first else self._core.judge(x, plan, True)[1]
            model = np.maximum(self._model, ROOM * part)
            narrow = (self.high - self.low <= 2.0 * (model + self.noise)).any()
            new = np.isfinite(model).all() and (model > self._model).any()
            if not new or (narrow and not first):
                break
            self._model = model
            plan, status, gap = again()
            short, part = self._core.judge(x, plan, first)
        if short is None:
            self._start, self._plan, self.since, self.missing = x, plan, 0, 0.0
            return plan, plan[0].copy(), status, gap
        if self._start is None or self._plan is None:
            self._refuse(*short)
        self.since, self.missing = self.since + 1, short[2]
        u = self._core.follow(self._start, self._plan, self.since, x)
        return self._plan, u, "kept", np.nan

    def _refuse(
        self, row: int, step: int | None, amount: float, model: float, noise: float
    ) -> NoReturn:
        # what is kept back for the model is of a plan from a state
        of = "no plan" if step is None and model == 0.0 else "no plan from this state"
        where = "between its limits" if step is None else f"in step {step}"
        self.reset()
        self.missing = amount
        if not np.isfinite(amount):
            raise SolverError(f"{of} comes to rest within the limits")
        raise SolverError(
            f"{of} keeps the limits with {self.keep:.3g}: {self.names[row]} {where} lacks "
            f"{amount:.3g} beside {model:.3g} for the error of the model, which more data reduce, "
            f"and {noise:.3g} for noise"
        )

    def __repr__(self) -> str:
        read = "with states read exactly"
        if self.behind is not None:
            read = "while all readings come and the inputs act as returned,"
        ended = f"; {self.ended}" if self.ended else ""
        return (
            f"<Kept: every limit in {show.number_of(self.calls)} together with {self.keep:.4g}, "
            f"for the linear system the data came from, {read} and Gaussian noise{ended}>"
        )


def cut(kept: Kept, v: Floats, u: Floats, acted: Floats) -> list[str]:
    """The promise ends where v had to be cut to u, but for rounding; what to say of it."""
    off = np.abs(v - u) > 1e-9 * (np.abs(v) + np.abs(acted))
    return kept.end("an input had to be cut to its limits") if off.any() else []


def lapsed(kept: Kept, x: Floats) -> list[str]:
    """The promise ends after its calls, and where x is beyond a limit; what to say of it."""
    n, kept.count = len(x), kept.count + 1
    beyond = np.maximum(kept.low[:n] - x, x - kept.high[:n]) > 1e-9 * np.abs(x)
    if beyond.any():
        return kept.end(f"{kept.names[int(beyond.argmax())]} was beyond its limits")
    return kept.end("its calls are over") if kept.count > kept.calls + 1 else []


def resumed(state: dict[str, Any] | None) -> Kept | None:
    """What a saved loop keeps."""
    if state is None:
        return None
    made = Kept.__new__(Kept)
    vars(made).update(state)
    return made


class Keep(Options, eq=True):
    """Limits that a certified gain keeps over a number of calls; an option of `regulate`.

    Parameters
    ----------
    gain : Loop or LoopCertificate
        A gain that is certified for all systems the region of the model allows.
    calls : int
        For how many calls T the limits hold, fixed before the run.
    probability : float, default 0.95
        The probability of all of it, of the region and the noise together.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> x, u, w = np.random.default_rng(1).standard_normal((3, 100, 1))
    >>> data = se.Trajectories.from_pairs(x, u, 0.9 * x + u + 0.05 * w)
    >>> gain = se.gain(se.identify(data, noise=se.Noise(sigma=0.05)), 1.0, 1.0)
    >>> se.Keep(gain, calls=50, probability=0.9).probability
    0.9
    """

    gain: Loop | LoopCertificate
    calls: Annotated[int, partial(validation.size, maximum=1_000_000)]
    probability: Probability = 0.95


def kept_of(system: System | Identified, task: Task, keep: Keep, rows: Rows | None = None) -> Kept:
    """What `regulate` is to keep, for its model and its limits."""
    validation.instance("keep", keep, Keep)
    share, n = keep.probability, task.reference.shape[1]
    last = n
    if rows is not None:
        n, last = len(rows[0]) - len(rows[1]) - task.low.shape[1], len(rows[0]) - task.low.shape[1]
    if not isinstance(system, Identified):
        raise InputError("`system` must be the model that the gain of `keep` was made for")
    proof = proof_of("system", system, keep.gain, (1.0 - share) / 2.0)
    region = proof.region
    if proof.status != "certified":
        raise InputError(f"`keep` must have a certified gain, got {proof!r}")
    if region.centre.shape[1] > region.n + region.m:
        raise InputError("`system` must be without an intercept: with one 0 is no point of rest")
    eps = 1.0 - share - region.delta
    if eps <= 0.0:
        raise InputError(
            f"`probability` must be below 1 - delta = {1.0 - region.delta:g}, got {share:g}"
        )
    high = np.full((task.steps, last), np.inf) if task.state_high is None else task.state_high
    low = -high if task.state_low is None else task.state_low
    low, high = (
        np.hstack([of[:, :n], inputs, of[:, n:last]])
        for of, inputs in ((low, task.low), (high, task.high))
    )
    for wrong, wanted in (
        (task.rate is not None, "without `rate`"),
        (
            task.state_low is not None and task.soft is not None,
            "without soft limits of states: give soft=False",
        ),
        ((low != low[0]).any() or (high != high[0]).any(), "the same in all steps"),
        (not (np.isfinite(low).any() or np.isfinite(high).any()), "with a finite one"),
        ((low >= 0.0).any() or (high <= 0.0).any(), "low < 0 < high"),
    ):
        if wrong:
            raise InputError(f"`limits` must be {wanted}, with `keep`")
    made = Kept(proof, low[0].copy(), high[0].copy(), eps, keep.calls, rows)
    made.noise  # noqa: B018  refuses what has no bound of the noise
    return made


def followed(
    window: Regressors, Theta: Floats, behind: tuple[bool, bool]
) -> tuple[Floats, Floats, Floats]:
    """``[A B]``, J and G of a window with readings and the last inputs behind it, or without."""
    (J, AB, G), m, (read, acted) = window.loop(Theta), len(window.inputs), behind
    n, p = G.shape
    AB = np.vstack([AB, *[Theta @ J] * read, *[np.eye(m, n + m, n)] * acted])
    G = np.vstack([G, *[np.eye(p)] * read, *[np.zeros((m, p))] * acted])
    AB, J = (np.insert(M, [n] * (len(G) - n), 0.0, axis=1) for M in (AB, J))
    return AB, J, G


def limits_of_readings(
    system: Any, task: Task, keep: Keep, limits: Limits, offset_free: Any
) -> tuple[Task, tuple[Floats, Floats, None], Kept]:
    """The task of `task_of` with hard limits of the states of `followed`, these, and the rest."""
    validation.instance("keep", keep, Keep)
    model: Any = system.model if isinstance(system, Loop) else system
    noise, soft = model.assumptions, limits.x is not None and limits.soft is not False
    given = isinstance(keep.gain, Loop) and keep.gain.given
    for wrong, text in (
        (system is not model, "`system` must be the model of a Loop, for plans"),
        (offset_free, "`offset_free` must be False: what is learned moves the loop"),
        (limits.forecast, "`forecast` must be None: plans choose all inputs"),
        (model.intercept, "`system` must be without an intercept: with one 0 is no point of rest"),
        (noise.tail, "`system` must be without a `tail`, which is no white noise"),
        (noise.noise != "gaussian", f"`system` must have Gaussian noise, got {noise.noise} noise"),
        (soft, "`limits` must be without soft limits of outputs: give soft=False"),
        (given, "`keep` must have a gain of all inputs: make it without `given`"),
    ):
        if wrong:
            raise InputError(f"{text}, with `keep`")
    window, m, rates = model.regressors, model.m, task.rate is not None
    last = tuple(f"{u}(-1)" for u in window.inputs)
    read = task.state_low is not None and window.pole is not None
    behind = read, rates and last[0] not in window.state_names
    states = (*window.state_names, *window.outputs * read, *last * behind[1])
    known, first, n = followed(window, model.coefficients, behind)[0], model.n, len(states)
    shape = m * rates, n + m
    changes = np.eye(*shape, n) - np.eye(*shape, states.index(last[0]) if rates else 0)
    high = np.full((task.steps, n + 2 * len(changes)), np.inf)
    low = -high
    if task.state_low is not None and task.state_high is not None:  # of (x, y)
        at = first * read + np.arange(model.n_outputs)
        low[:, at], high[:, at] = task.state_low[:, first:], task.state_high[:, first:]
    if task.rate is not None:
        high[:, n : n + m], high[-1, n + m :] = task.rate, task.rate
        low[:, n:] = -high[:, n:]
    wide = (0, high.shape[1] - first)
    stage, terminal = (np.pad(M[:first, :first], wide) for M in (task.stage, task.terminal))
    reference = np.pad(task.reference[:, :first], [(0, 0), wide])
    own = task.low, task.high, stage, terminal, reference, task.R
    task = Task(*own, state_low=low, state_high=high)
    names = (*states, *window.inputs, *(f"change of {u}" for u in window.inputs * rates))
    kept = kept_of(model, task, keep, (names, changes, behind))
    if rates:  # planned with them: the changes, and the one to the gain behind the plan
        ahead = kept.proof.K @ known[:first] - np.eye(m, n + m, n)
        known = np.vstack([known, changes, ahead])
    A, B = np.split(known, [n], axis=1)
    A = np.pad(A, [(0, 0), (0, len(A) - n)])
    return task, (A, np.ascontiguousarray(B), None), kept
