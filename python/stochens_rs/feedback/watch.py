"""`Watch`: whether the plant in a loop is still one of those that its certificate covers."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias
from weakref import ref

import numpy as np

from .._base import show, validation
from .._base.files import Durable
from .._base.names import Labels
from .._base.records import SavedRecord
from .._base.types import ArrayLike, Axes, Floats, Self
from ..exceptions import InputError
from ..identification.changes import Changes, Predictor
from ..plots.lines import draw_evidence

WatchStatus: TypeAlias = Literal["quiet", "alarm", "blind", "skipping"]
LawOfWatch: TypeAlias = Literal["variance", "gaussian", "symmetric", "bounded"]
LAWS: tuple[LawOfWatch, ...] = ("variance", "gaussian", "symmetric", "bounded")
CREDIBLE = 0.95
HISTORY = 10_000  # calls whose evidence is drawn
LOST = 20  # calls in a row in which something is missing, so that it is no chance
OTHERWISE = 3.0  # times the size in the logs, or parts of it, where one that is not linear differs
FIXED = ("proof", "promise", "law", "moving")  # what a watch is made of


@dataclass(frozen=True)
class Watched:
    """One call of a `Watch`.

    Attributes
    ----------
    status : str
        "quiet"; "alarm" since the last `Watch.clear`; "blind": for 200 pairs only louder noise
        could have been seen; "skipping": no pair was complete in this call.
    evidence : float
        The alarm is at `Watch.threshold`.
    alarms : int
        How many there were.
    reason : str or None
        What cannot have been measured (inf, or beyond 1e140), and is taken as missing; or what is
        missing for so long that nothing is watched.
    """

    status: WatchStatus | str
    evidence: float
    alarms: int
    reason: str | None = None


class WatchState(SavedRecord):
    """What a watch is made of and where it stands.

    Attributes
    ----------
    parts : dict
        Its attributes by name.
    """

    parts: dict[str, Any]


class Watch(Durable):
    """An alarm whose false alarms are bounded, for all plants of a region and any feedback.

    Made by `LoopCertificate.watch`. A copy, a pickle or a file goes on bit by bit.

    Attributes
    ----------
    proof : LoopCertificate
        What it watches over.
    promise : float
        The mean number of steps between false alarms, or below 1 the probability of one ever.
    law : str
        What is assumed of the noise.
    moving : bool
        Whether the plant may move inside the region.
    history : deque of float
        The evidence of the last 10 000 calls.
    """

    _kind = "watch"

    def __init__(self, proof: Any, promise: float, law: LawOfWatch, moving: bool) -> None:
        self.proof, self.promise, self.law, self.moving = proof, promise, law, moving
        if proof.source is None:
            raise InputError("`proof` has no model to watch: it must be made by `certificate`")
        self._source: Predictor = proof.source
        self._core = self._source.watch(law, moving, promise)
        self.history: deque[float] = deque(maxlen=HISTORY)
        self._next = np.full(len(self._source.window.inputs), np.nan)
        self._loop: Any = None
        self._lost = np.zeros(sum(map(len, self.names)), dtype=int)
        self._onset: list[float] | None = None

    def __call__(self, y: ArrayLike, u: ArrayLike, *, applied: ArrayLike | None = None) -> Watched:
        """Look at one step.

        Parameters
        ----------
        y : array_like, shape (n_outputs,)
            The readings now, of a model of states the states; nan for one that is missing, by
            chance or by a rule on the past, never by its value.
        u : array_like, shape (m,)
            The inputs that act from now on, within their limits.
        applied : array_like, shape (m,), optional
            What acted since the last call, where it was not the u of that.

        Returns
        -------
        Watched

        Raises
        ------
        InputError, InputTypeError
            If they have another shape or are no numbers.
        """
        outputs, inputs = self.names
        read, acts = validation.measured("y", y, outputs), validation.measured("u", u, inputs)
        acted = self._next if applied is None else validation.measured("applied", applied, inputs)
        now, names = np.concatenate([read, acts]), (*outputs, *inputs)
        broken = validation.broken(np.where(np.isnan(now), 0.0, now), 1e140, names)
        status, evidence, alarms = self._step(read, acted)
        found = Watched(status, evidence, alarms, broken or self._missing)
        self.history.append(found.evidence)
        self._next = acts.copy()
        return found

    @property
    def _missing(self) -> str | None:
        """What was missing in the last calls, if for so long that it is no chance."""
        i = int(self._lost.argmax())
        if self._lost[i] < LOST:
            return None
        return f"nothing is watched: {sum(self.names, ())[i]} is missing for {self._lost[i]} calls"

    def _step(self, read: Floats, acted: Floats) -> tuple[str, float, int]:
        self._lost = np.where(np.isfinite(np.concatenate([read, acted])), 0, self._lost + 1)
        found: tuple[str, float, int] = self._core.step(read, acted)
        return found

    @property
    def names(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The names of what is read and of the inputs."""
        return self._source.window.outputs, self._source.window.inputs

    def tables(self) -> Any:
        """List the sizes and numbers of the alarm, for a controller in C.

        Returns
        -------
        tuple of (list of (name, int), list of (name, ndarray))

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> z = np.random.default_rng(1).standard_normal((60, 3))
        >>> data = se.Trajectories.from_pairs(z[:, :1], z[:, 1:2], z @ [[0.5], [1.0], [0.1]])
        >>> proof = se.gain(se.identify(data), 1.0, 1.0).certificate(0.05)
        >>> sizes, numbers = proof.watch(level=0.01).tables()
        >>> len(sizes) > 0
        True
        """
        return self._core.tables()

    @property
    def threshold(self) -> float:
        """The evidence at which there is an alarm."""
        return float(self._core.now[0])

    def _name(self, direction: int, column: int) -> str:
        """What a bet is on."""
        outputs, columns = self._source.window.outputs, self._source.window.regressor_names
        if direction >= len(outputs):
            return columns[column]
        load = column == len(columns) or columns[column] == "1"
        return f"{'load' if load else columns[column]} on {outputs[direction]}"

    @property
    def onset(self) -> tuple[float, float] | None:
        """Between which calls the change began that the first alarm since `clear` saw.

        With 95 % for Gaussian noise and one change of coefficients or noise that stays, where
        nothing is known of the time beforehand; of the last 1000 calls. None without an alarm, or
        where each row has a region of its own.
        """
        if self._onset is None:  # found once for each alarm
            self._onset = self._core.onset(1.0 - CREDIBLE)
        return None if self._onset is None else (self._onset[0], self._onset[1])

    @property
    def alarm(self) -> str | None:
        """What the first alarm since `clear` saw, and when that began, see `onset`; or None."""
        first = self._core.now[3]
        if first is None:
            return None
        call, part, direction, column, fell = first
        what = "a change of several effects" if part == 4 else "the noise is larger than its bound"
        if part < 3:
            name = self._name(direction, column)
            effect = "" if name.startswith("load on ") else "the effect of "
            what = f"{effect}{name} is {'smaller' if fell else 'larger'}"
        since = "when it began cannot be told"
        if self.onset is not None:
            first_one, last = self.onset
            since = f"from between calls {first_one:.0f} and {last:.0f} on ({CREDIBLE:.0%})"
        return f"{what}, {since}, alarm at call {call:.0f}{self._elsewhere}"

    @property
    def _elsewhere(self) -> str:
        """Which inputs moved otherwise before an alarm than in the logs, if one did."""
        own, found = self._source.window, []
        logged = self._source.sizes[own.count * len(own.outputs) :]
        for name, now, before in zip(own.inputs, self._core.acting(), logged, strict=False):
            if now > OTHERWISE * before or OTHERWISE * now < before:
                found.append(f"{name} was of {now:.3g}, in the logs of {before:.3g}")
        return f"; or the plant is not linear: {show.listed(found)} (rms)" if found else ""

    def sees(self, steps: int = 200) -> dict[str, float]:
        """What would be seen now within so many steps: a rule from the last 200 pairs, no bound.

        Parameters
        ----------
        steps : int, default 200
            The delay.

        Returns
        -------
        dict
            For each input the least relative change of its effect, for each reading the least load
            in deviations of its noise; infinite where it would take longer, or where the noise of a
            reading is rounding or follows from that of others: there nothing is watched.

        Raises
        ------
        InputError, InputTypeError
            If `steps` is not a whole number > 0.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> rng = np.random.default_rng(1)
        >>> x, u, w = rng.standard_normal((3, 60, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> watch, x = proof.watch(every=1e4), np.zeros(1)
        >>> for u in rng.standard_normal((60, 1)):  # an input of half the effect
        ...     seen = watch(x, u)
        ...     x = 0.5 * x + 0.5 * u + 0.1 * rng.standard_normal(1)
        >>> sorted(watch.sees(100))
        ['load on x[0]', 'u[0]']
        >>> watch.sees(100)["u[0]"] < 0.5  # it would have been seen
        True
        """
        found = self._core.sights(float(validation.size("steps", steps)))
        blind = set(range(len(self.names[0]))).difference(self._core.rows)
        no_load = {f"load on {self.names[0][i]}": np.inf for i in blind}
        return {self._name(*at): least for *at, least in found} | no_load

    def changes(self, level: float = 0.05) -> Changes:
        """What changed, from the pairs after the first alarm since `clear`; looks are free.

        Parameters
        ----------
        level : float, default 0.05
            The probability of error of all that is said from these pairs.

        Returns
        -------
        Changes
            For Gaussian or sub-Gaussian noise, and a plant that stays as it is after the alarm.

        Raises
        ------
        InputError, InputTypeError
            If `level` is not a number between 0 and 1.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> rng = np.random.default_rng(1)
        >>> x, u, w = rng.standard_normal((3, 60, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> watch, x = proof.watch(every=1e4), np.zeros(1)
        >>> for u in rng.standard_normal((60, 1)):  # an input of half the effect
        ...     seen = watch(x, u)
        ...     x = 0.5 * x + 0.5 * u + 0.1 * rng.standard_normal(1)
        >>> watch.changes().explanations  # one effect alone cannot tell more
        ('u[0]', 'x[0](k+1)')
        """
        return self._source.changes(self._core, validation.probability("level", level))

    def hold(self, level: float = 0.05) -> Any:
        """What is still certified of the gain, by the pairs after the alarm alone.

        Parameters
        ----------
        level : float, default 0.05
            The probability that the plant is not in the region of these pairs.

        Returns
        -------
        LoopCertificate
            Before an alarm the one that is watched over. Behind it "certified": the old gain holds
            again, with what these pairs prove of the plant; "undetermined" while they are too few,
            or where `clear` forgot them.

        Raises
        ------
        InputError, InputTypeError
            If `level` is not a number between 0 and 1.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> rng = np.random.default_rng(1)
        >>> x, u, w = rng.standard_normal((3, 60, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> watch, x = proof.watch(every=1e4), np.zeros(1)
        >>> for u in rng.standard_normal((60, 1)):  # an input of half the effect
        ...     seen = watch(x, u)
        ...     x = 0.5 * x + 0.5 * u + 0.1 * rng.standard_normal(1)
        >>> watch.hold().status  # also with an input of half the effect
        'certified'
        """
        if self.alarm is None and not self._core.now[2]:
            return self.proof
        region = None if self.alarm is None else self.changes(level).region
        if region is None:
            few = "the pairs after the alarm are too few: excite the inputs"
            gone = "an alarm was cleared, and with it the pairs after it: certify with a new model"
            return self.proof.of(None, gone if self.alarm is None else few)
        return self.proof.of(self._source.entered(region))

    def _require(self, labels: Labels) -> None:
        """Refuse other signals than those that are watched."""
        own = labels.states, labels.inputs
        if self.names != own:
            raise InputError(f"`watch` must be of {own}, got one of {self.names}")

    def _attach(self, loop: Any) -> None:
        """Be the watch of a loop, which calls it; refused while it is that of another one."""
        self._require(loop.labels)
        other = self._loop and self._loop()
        if other is not None and other is not loop and other.watch is self:
            raise InputError("`watch` is that of another loop, of one plant: set copy.copy(watch)")
        self._loop = ref(loop)

    def _skip(self) -> None:
        """Say that the next call does not follow on the last one, as where the plant was moved."""
        read, acted = (np.full(len(names), np.nan) for names in self.names)
        self._step(read, acted)

    def clear(self) -> None:
        """Take the alarm as seen: quiet until the next one; the pairs after it are forgotten.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> rng = np.random.default_rng(1)
        >>> x, u, w = rng.standard_normal((3, 60, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> watch, x = proof.watch(every=1e4), np.zeros(1)
        >>> for u in rng.standard_normal((60, 1)):  # an input of half the effect
        ...     seen = watch(x, u)
        ...     x = 0.5 * x + 0.5 * u + 0.1 * rng.standard_normal(1)
        >>> seen.status, watch.alarm is None
        ('alarm', False)
        >>> watch.clear()
        >>> watch.alarm is None, watch.hold().status
        (True, 'undetermined')
        """
        self._core.clear()
        self._onset = None

    def plot(self, *, ax: Axes | None = None) -> Axes:
        """Draw the evidence over the last calls, with the threshold.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        InputError
            Before the first call.
        ImportError
            If matplotlib is not installed.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> rng = np.random.default_rng(1)
        >>> x, u, w = rng.standard_normal((3, 60, 1))
        >>> data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
        >>> proof = se.gain(se.identify(data, noise=0.1), 1.0, 1.0).certificate(0.05)
        >>> watch, x = proof.watch(every=1e4), np.zeros(1)
        >>> for u in rng.standard_normal((60, 1)):  # an input of half the effect
        ...     seen = watch(x, u)
        ...     x = 0.5 * x + 0.5 * u + 0.1 * rng.standard_normal(1)
        >>> watch.plot().get_ylabel()
        'evidence of a change'
        """
        if not self.history:
            raise InputError("the history is empty: there is nothing to draw before the first call")
        return draw_evidence(np.array(self.history), self.threshold, dt=self.proof.dt, ax=ax)

    def __getstate__(self) -> dict[str, Any]:
        own = {name: getattr(self, name) for name in FIXED}
        history, state = np.array(self.history), self._core.state()
        now = {"history": history, "next": self._next, "lost": self._lost}
        return {**own, "state": state, **now}

    def __setstate__(self, state: dict[str, Any]) -> None:
        Watch.__init__(self, *(state[name] for name in FIXED))
        self._core.resume(state["state"])
        self._next = np.array(state["next"])
        self.history.extend(state["history"].tolist())
        self._lost = np.array(state["lost"])

    def _to_sections(self) -> dict[str, Any]:
        return WatchState(self.__getstate__())._to_sections()

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Self:
        watch = cls.__new__(cls)
        watch.__setstate__(WatchState._from_sections(sections).parts)
        return watch

    @property
    def statement(self) -> str:
        """What is promised of false alarms, in words."""
        p = self.promise
        often = f"one in {p:.4g} steps" if p >= 1 else f"{p:.3g} ever"
        null = "a plant that moves inside the region" if self.moving else "a constant plant"
        return f"false alarms at most {often} for {null}, noise '{self.law}'"

    def __repr__(self) -> str:
        last = "".join(f"; {one}" for one in (self.alarm, self._missing) if one)
        calls = show.number_of(len(self.history), "call")
        return f"<Watch: {self.statement}, {calls}{last}>"
