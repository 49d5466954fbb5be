"""Limits of states that a loop keeps with a probability."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.numbers import ROUNDING
from .._base.records import cached_property
from ..controls.errors import proof_of
from ..exceptions import InputError, InputTypeError, SolverError
from ..feedback import Loop, LoopCertificate
from ..identification.identified import Identified

if TYPE_CHECKING:
    from collections.abc import Callable

    from .._base.types import Floats, Status
    from ..limits.problem import Task
    from ..system.system import System


if TYPE_CHECKING:
    Found = tuple[Floats, Status, float]
    Short = tuple[int, int, float, float, float]  # row, step, amount, model, noise

ROUNDS = 8  # plans of the first call, each with limits that are tighter by what the last needed
ROOM = 1.02  # how much more than the last plan needed is kept back for the model


class Kept:
    """Limits that a loop keeps in its first calls, together with a stated probability.

    Made by `regulate` with a `gain`, and ``loop.kept`` there. A plan from the state x(j) is
    followed by ``u = v + K (x - xb)``, xb the states of the model under v, and ``v = K xb`` behind
    it, which leads to the origin. It is accepted if it keeps limits that are tighter by what the
    errors of the model and noise can add, for every system of the region and until the states are
    inside for good. Else the plan before goes on, which stays accepted: what was accepted once
    never becomes infeasible.

    Attributes
    ----------
    proof : LoopCertificate
        What is proved of the gain, with the region of systems.
    calls : int
        The number of calls since the first that the promise is about.
    eps : float
        The probability that is given away for noise.
    low, high : ndarray, shape (n + m,)
        The limits of states and inputs.
    missing : float
        By how much the last plan missed the tighter limits; 0 if it was accepted.
    """

    def __init__(
        self, proof: LoopCertificate, low: Floats, high: Floats, eps: float, calls: int
    ) -> None:
        self.proof, self.low, self.high, self.eps, self.calls = proof, low, high, eps, calls
        self.reset()

    def reset(self) -> None:
        """Begin anew: the next call is the first one."""
        self._model = np.zeros(len(self.low))
        self._start: Floats | None = None
        self._plan: Floats | None = None
        self._since = 0
        self.missing = 0.0

    @cached_property
    def _core(self) -> _core.Keeper:
        noise = self.proof._noise("keep", self.eps)
        made = _core.Keeper.of(self.proof._core, self.low, self.high, *noise, self.calls)
        if made is None:
            raise SolverError("no bound of what noise does in this loop could be proved")
        return made

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_core"}

    @property
    def keep(self) -> float:
        """All limits are kept in all calls with at least this probability."""
        return 1.0 - self.proof.region.delta - self.eps

    @property
    def noise(self) -> Floats:
        """What is kept back for noise, shape (n + m,), in the units of states and inputs."""
        return self._core.noise

    @property
    def model(self) -> Floats:
        """What is kept back for the error of the model, (n + m,); 0 if the first plan had room."""
        return self._model.copy()

    @property
    def tightening(self) -> Floats:
        """Both together: the plans keep limits that are tighter by this, shape (n + m,)."""
        return self.model + self.noise

    def _tightened(self, task: Task) -> Task:
        """The task with the tighter limits; nothing is off yet when the first input is applied."""
        model, noise, n = self.model, self.noise, task.reference.shape[1]
        off = model + noise
        wide = self.high - self.low - 2.0 * off
        if (wide <= 0.0).any():
            i = int(np.argmin(wide))
            self._refuse(i, None, float(-wide[i] / 2.0), float(model[i]), float(noise[i]))
        inputs = np.tile(off[n:], (task.steps, 1))
        inputs[0] = 0.0
        made = replace(task, low=task.low + inputs, high=task.high - inputs)
        if task.state_low is None or task.state_high is None:
            return made
        states = {"state_low": task.state_low + off[:n], "state_high": task.state_high - off[:n]}
        return replace(made, **states)  # type: ignore[arg-type]

    def _choose(
        self, x: Floats, found: Found, again: Callable[[], Found], left: Callable[[], float]
    ) -> tuple[Floats, Floats, Status, float]:
        """The plan to go on with, its input at x, status and gap.

        `again` plans anew, while there is time `left`.
        """
        plan, status, gap = found
        short, first = self._judged(x, plan), self._plan is None
        for _ in range(ROUNDS if first else 1):
            if short is None or left() <= 0.0 or not self._widened(x, plan, short):
                break
            plan, status, gap = again()
            short = self._judged(x, plan)
        if first and short is not None:
            self._refuse(*short)
        if short is None:
            self._start, self._plan, self._since, self.missing = x, plan, 0, 0.0
            return plan, plan[0].copy(), status, gap
        assert self._start is not None
        assert self._plan is not None
        self._since, self.missing = self._since + 1, short[2]
        u = self._core.follow(self._start, self._plan, self._since, x)
        return self._plan, u, "kept", np.nan

    def _unplanned(self, x: Floats) -> Floats:
        """The input where no plan was ever accepted: that of the gain, within the limits."""
        n = len(x)
        return np.clip(self.proof.K @ x, self.low[n:], self.high[n:])

    def _judged(self, x: Floats, plan: Floats) -> Short | None:
        return self._core.judge(x, plan, self._plan is None)[0]

    def _widened(self, x: Floats, plan: Floats, short: Short) -> bool:
        """Keep back what this plan would have needed for the model, if that is more."""
        _, _, amount, part, _ = short
        later = self._plan is not None
        if later and amount > part * (1.0 + ROUNDING):
            return False  # noise alone is too much for it
        model = np.maximum(self._model, ROOM * self._core.judge(x, plan, True)[1])
        if not np.isfinite(model).all() or (model == self._model).all():
            return False
        if later and (self.high - self.low <= 2.0 * (model + self.noise)).any():
            return False
        self._model = model
        return True

    def _refuse(
        self, row: int, step: int | None, amount: float, model: float, noise: float
    ) -> NoReturn:
        labels = self.proof.labels
        name = (*labels.states, *labels.inputs)[row]
        where = "" if step is None else f" in step {step}"
        self.reset()
        self.missing = amount
        if not np.isfinite(amount):
            raise SolverError("no plan from this state comes to rest within the limits")
        raise SolverError(
            f"no plan from this state keeps the limits with {self.keep:.3g}: {name}{where} lacks "
            f"{amount:.3g} beside {model:.3g} for the error of the model, which more data reduce, "
            f"and {noise:.3g} for noise"
        )

    def __repr__(self) -> str:
        return (
            f"<Kept: every limit in {show.counted(self.calls)} together with {self.keep:.4g}, for "
            "the linear system the data came from, with states read exactly and Gaussian noise>"
        )


@dataclass(frozen=True)
class Keep:
    """That limits are kept by a certified gain over so many calls; an option of `regulate`.

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
    calls: int
    probability: float = 0.95

    def __post_init__(self) -> None:
        if not isinstance(self.gain, Loop | LoopCertificate):
            raise InputTypeError(
                f"`gain` must be a Loop or a LoopCertificate, got {validation.show(self.gain)}"
            )
        validation.size("calls", self.calls, maximum=1_000_000)
        validation.probability("probability", self.probability)


def kept_of(system: System | Identified, task: Task, keep: Keep) -> Kept:
    """What `regulate` is to keep, for its model and its limits."""
    validation.instance("keep", keep, Keep)
    n, m, share = task.reference.shape[1], task.low.shape[1], keep.probability
    if not isinstance(system, Identified):
        raise InputError("`system` must be the model that the gain of `keep` was made for")
    proof = proof_of("system", system, keep.gain, (1.0 - share) / 2.0)
    region = proof.region
    if proof.status != "certified":
        raise InputError(f"`keep` must have a certified gain, got {proof!r}")
    if region.centre.shape[1] > n + m:
        raise InputError("`system` must be without an intercept: with one 0 is no point of rest")
    eps = 1.0 - share - region.delta
    if eps <= 0.0:
        raise InputError(
            f"`probability` must be below 1 - delta = {1.0 - region.delta:g}, got {share:g}"
        )
    if task.rate is not None or (task.state_low is not None and task.soft is not None):
        what = "`rate`" if task.rate is not None else "soft limits of states: give soft=False"
        raise InputError(f"`limits` must be without {what}, with `keep`")
    sides = []
    for states, inputs in ((task.state_low, task.low), (task.state_high, task.high)):
        free = np.full((task.steps, n), -np.inf if inputs is task.low else np.inf)
        sides.append(np.hstack([free if states is None else states, inputs]))
    low, high = sides
    if not ((low == low[0]).all() and (high == high[0]).all()):
        raise InputError("`limits` must be the same in all steps, with `keep`")
    low, high = low[0].copy(), high[0].copy()
    if not (np.isfinite(low).any() or np.isfinite(high).any()):
        raise InputError("`limits` must have a finite one, with `keep`")
    if not ((low < 0.0).all() and (high > 0.0).all()):
        raise InputError("`limits` must have low < 0 < high, with `keep`")
    made = Kept(proof, low, high, eps, keep.calls)
    made.noise  # noqa: B018  refuses what has no bound of the noise
    return made
