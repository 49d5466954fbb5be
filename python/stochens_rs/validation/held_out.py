"""`Validation`: a plan or a loop on runs and systems that it was not made from."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.names import Labels, order_of
from .._base.records import Probability, SavedRecord
from .._base.running import get_num_threads
from .._base.types import ArrayLike, Floats
from ..certificates.of_model import ModelBasis
from ..data.trajectories import require_whole
from ..ensembles.systems import SystemEnsemble, systems_in_order
from ..exceptions import InputError, ShapeError
from ..fusion.provenance import Basis
from ..identification import Model, Trajectories
from ..identification.identified import Identified
from ..limits.problem import Limited
from ..system.system import System
from ..theory import scenario

Source: TypeAlias = Literal["runs", "runs of a loop", "fresh systems"]
Runs: TypeAlias = "Trajectories | SystemEnsemble | Sequence[System] | Sequence[ArrayLike] | Any"

# Of the size of a state: the least unit of its deviations, also where no noise acts on it.
_LEAST = 1e-3
# Recorded inputs may be rounded: by this much of the largest one they are those of the plan.
_INPUTS = 1e-6

_RUNS = (
    "the next run of this very {0}: the same {1}, hardware and limits, its start drawn and its end "
    "decided by the same rule. No run was left out, whatever came of it, and {2}, scale and delta "
    "were fixed before the runs were seen"
)
_SAME = {
    "runs": _RUNS.format("plan", "inputs", "plan"),
    "runs of a loop": _RUNS.format("loop", "controller, set points", "controller"),
    "fresh systems": (
        "this command on one more system, drawn as these were, from a start drawn as theirs. No "
        "system was left out, and plan, scale and delta were fixed before they were seen. Only "
        "what differs between the systems is covered: no noise acts in these runs"
    ),
}


class Validation(SavedRecord):
    """The next run stays in `tube`, and ends within `target`, with probability ``1 - delta`` each.

    Made by `Plan.validate` and `Regulator.validate`. It assumes nothing of the plant, of the noise
    or of the model, and says nothing of other plans: it is no certificate, and no number of it is
    added to one.

    Attributes
    ----------
    factor : float
        An order statistic of `deviations`; infinite where the runs are too few, see `reason`.
    tube : ndarray, shape (K + 1, n)
        ``|x(k) - p(k)|_i`` is at most this for all k and i at once: ``factor * scale``. p is the
        prediction from the run's own start, ``xh(k) + A_hat^k (x(0) - xh(0))``, so ``tube[0]`` is
        0. A plan that keeps no A_hat (diagonal fusion, made by hand) has ``p(k) = xh(k)``, k >= 1,
        and so has one of outputs: x are then the readings, and one of them is no start.
        Of a loop p is the loop around its own model.
    target : float
        ``||x(K) - xf||`` is at most this: an order statistic of `misses`.
    xf : ndarray, shape (n,)
        The target; where the plan has none, its last predicted state.
    delta : float
        `tube` fails with at most this probability, and so does `target`: each for itself.
    beta : float or None
        None: the probability is over the runs and the next one together. Else the runs can mislead
        with probability `beta`, and otherwise at most a share `delta` of all further runs fails.
    source : {"runs", "runs of a loop", "fresh systems"}
        What was compared with the plan or the loop.
    deviations : ndarray, shape (M,)
        Of each run, ``max |x(k) - p(k)|_i / scale(k)_i``; infinite where it diverged or ended
        early.
    misses : ndarray, shape (M,)
        ``||x(K) - xf||`` of each run.
    rank : int or None
        The order statistic is the one of this rank; ``M + 1`` where none is enough. None with
        weights.
    noise_free : float or None
        Of a plan whose runs all had the same start: with probability ``1 - delta`` the mean of
        x(K), where it ends without noise, is within this of xf. For Gaussian noise and a linear
        plant only, other than all else here; None where starts differ or a run diverged.
    """

    factor: float
    tube: Annotated[Floats, "time state", "infinite"]
    target: float
    xf: Annotated[Floats, "state"]
    delta: Probability
    beta: Probability | None
    source: Source
    deviations: Annotated[Floats, "run", "infinite"]
    misses: Annotated[Floats, "run", "infinite"]
    rank: int | None
    noise_free: float | None = None

    def _check(self) -> None:
        validation.size("tube", len(self.tube))
        size = validation.size("deviations", len(self.deviations))
        if self.rank is not None:
            validation.size("rank", self.rank, maximum=size + 1)

    @property
    def size(self) -> int:
        """The number of runs M."""
        return len(self.deviations)

    @property
    def diverged(self) -> int:
        """How many runs diverged or ended early."""
        return int(np.count_nonzero(np.isinf(self.misses)))

    @property
    def covers(self) -> str:
        """Which runs the numbers are about, and what must be the same, in words."""
        text = _SAME[self.source]
        if self.rank is None:
            text += (
                "; but starts were drawn from another density than the start to come, their ratio "
                "is the declared weight, and its law is known, not estimated"
            )
        if self.beta is not None:
            text += f"; with confidence {1.0 - self.beta:.9g}, if the runs are independent"
        return text

    @property
    def reason(self) -> str | None:
        """Why `factor` or `target` is infinite; None where both are finite."""
        if np.isfinite(self.factor) and np.isfinite(self.target):
            return None
        share, runs = _percent(1.0 - self.delta), show.number_of(self.size, "run")
        if self.rank is None:
            return f"the weights of {runs} beside that of the run to come cannot support {share}"
        if self.rank <= self.size:
            return (
                f"{self.diverged} of {runs} diverged or ended early; {share} allows for "
                f"{self.size - self.rank}"
            )
        alone, sure = needed(self.delta), needed(self.delta, self.beta or 0.05)
        at = _percent(1.0 - (self.beta or 0.05))
        if self.beta is not None:
            return f"{runs} cannot support {share} with confidence {at}: {sure} are needed"
        return (
            f"{runs} cannot support {share}: {alone} are needed ({sure} to say it with confidence "
            f"{at} for these very runs); {_percent(self.size / (self.size + 1))} is possible"
        )

    def coverage(self, beta: float = 0.05) -> float:
        """Bound the share of all further runs that stay in `tube`; the same for `target`.

        Parameters
        ----------
        beta : float, default 0.05
            Probability that the bound fails, over runs that are independent of each other.

        Returns
        -------
        float
            ``1 - epsilon`` of `theory.scenario.hold_out`, with the runs above the order statistic
            as violations; the exact law of the coverage, Beta(rank, M + 1 - rank), where no two
            scores are equal, and on the safe side else.

        Raises
        ------
        InputError, InputTypeError
            If the runs have weights: no such law is known then.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> A = 0.5 + 0.01 * np.random.default_rng(1).standard_normal((60, 1, 1))
        >>> plan = se.control(([[0.5]], [[1.0]]), [1.0], [0.0], steps=3)
        >>> held = plan.validate(se.SystemEnsemble(A, np.ones((60, 1, 1))))
        >>> held.rank, round(held.coverage(), 3)
        (58, 0.899)
        """
        beta = validation.probability("beta", beta)
        if self.rank is None:
            raise InputError("`coverage` is not known for runs with weights")
        if self.rank > self.size:
            return 1.0
        return 1.0 - scenario.hold_out(self.size, self.size - self.rank, beta)

    @property
    def _share(self) -> str:
        sure = "" if self.beta is None else f" with confidence {_percent(1.0 - self.beta)}"
        return f"{_percent(1.0 - self.delta)}{sure}"

    def __repr__(self) -> str:
        of = self.source if self.size > 1 else self.source.removesuffix("s")
        if np.isfinite(self.target):
            text = f"x(K) within {self.target:.3g} of xf, tube {self.factor:.3g} scales"
            text += f", {self._share} each"
        else:
            text = f"nothing is validated: {self.reason}"
        return f"<Validation: {self.size} {of}, {text}>"


def needed(delta: float, beta: float | None = None) -> int:
    """The smallest number of runs that can support ``1 - delta``, with confidence ``1 - beta``."""
    if beta is not None:
        return scenario.required_scenarios(delta, 1, beta)
    return math.ceil(1 / _written(delta)) - 1


def rank_of(size: int, delta: float, beta: float | None = None) -> int:
    """The rank of the order statistic: ``size + 1`` if no score is enough.

    The smallest j with ``j >= (1 - delta) (M + 1)``; with `beta` the smallest with
    ``P(Bin(M, delta) <= M - j) <= beta``.
    """
    if beta is None:
        return size + 1 - math.floor(_written(delta) * (size + 1))
    return _core.scenario_rank(size, delta, beta)


def _written(delta: float) -> Fraction:
    """`delta` as it is written: 0.3 is 3/10, so that 0.3 * 10 is 3."""
    return Fraction(repr(delta))


def _percent(share: float) -> str:
    return f"{math.floor(1e6 * share + 1e-6) / 1e4:g} %"  # never rounded up


class PredictedLoop(NamedTuple):
    """A loop: what its model predicts along a run from its start, and its inputs there.

    Of outputs the states of a run are its readings; those that are free have no target, nan.
    """

    path: Callable[[Floats], Floats]
    inputs: Callable[[Floats], Floats]
    n: int
    m: int
    target: Floats
    scale: Floats
    labels: Labels
    dt: float | None


class Predicted(NamedTuple):
    """What a plan predicts, and of what."""

    u: Floats
    states: Floats
    basis: Basis | ModelBasis | None
    limited: Limited | None
    labels: Labels
    dt: float | None

    @property
    def read(self) -> bool:
        """Whether these are outputs, whose start says nothing of how they move on."""
        return isinstance(self.basis, ModelBasis) and self.basis.window is not None

    @property
    def A(self) -> Floats:
        """How a deviation of the start moves on; 0 where the plan does not know."""
        n, known = self.states.shape[1], None if self.read else self.basis
        found = known.model.A if isinstance(known, ModelBasis) else known and known.A.estimate
        return np.zeros((n, n)) if found is None else np.ascontiguousarray(found)

    @property
    def xf(self) -> Floats:
        """The target; the last predicted state where the plan has none."""
        found: Floats | None = None
        if self.limited is not None and self.limited.task.follows and not self.read:
            found = self.limited.task.reference[-1]
        elif isinstance(self.basis, ModelBasis):
            found = self.basis.target
        elif self.basis is not None:
            goal = self.basis.xf
            found = goal.estimate if goal.values is None else goal.values
        return validation.frozen(self.states[-1] if found is None else found)

    @property
    def x0(self) -> Floats | None:
        """Where the plan begins; None if that is an estimate."""
        if isinstance(self.basis, ModelBasis):
            exact = self.basis.x0_error == 0.0
        else:
            exact = self.basis is None or self.basis.x0.kind == "exact"
        return self.states[0] if exact else None

    def scale(self) -> Floats:
        """Units of the deviations of x(1), ..., x(K), known before any run: (K, n).

        The largest predicted size of each state. For a model from data the deviation that its
        noise gives, ``sum_{p<k} A^p Sigma A^p'``, if that is not smaller by a factor of 1000.
        """
        K, n = self.u.shape[0], self.states.shape[1]
        size = np.abs(self.states).max(axis=0)
        size = np.where(size > 0.0, size, size.max() or 1.0)
        units = np.tile(size, (K, 1))
        model = self.basis.model if isinstance(self.basis, ModelBasis) else None
        if not isinstance(model, Model) or model.covariance is None:
            return units
        A, added = map(np.ascontiguousarray, model.with_outputs)
        units = _core.noise_deviations(A, added, K)[:, :n]
        floor = np.maximum(_LEAST * size, np.finfo(float).tiny)
        return np.where(np.isfinite(units), np.maximum(units, floor), size)


class Asked(NamedTuple):
    """The arguments of `validate`, checked where they are used first."""

    delta: float
    beta: float | None
    scale: ArrayLike | None
    weights: ArrayLike | None

    @classmethod
    def checked(cls, delta: float, beta: float | None, *about: ArrayLike | None) -> Asked:
        """Check both probabilities."""
        sure = None if beta is None else validation.probability("beta", beta)
        return cls(validation.probability("delta", delta), sure, *about)


def validated(plan: Predicted, runs: Runs, x0: ArrayLike | None, asked: Asked) -> Validation:
    """Compute the order statistics of `Plan.validate`."""
    units = plan.scale() if asked.scale is None else _scale(asked.scale, plan.states)
    target = plan.xf
    told = plan.states, plan.A, units, target
    systems, free = _systems(runs), None
    source: Source = "runs" if systems is None else "fresh systems"
    if systems is not None:
        if plan.read:
            raise InputError("`runs` must be runs for a plan of outputs: systems have no record")
        scores = _of_systems(plan, told, systems, x0)
    else:
        if x0 is not None:
            raise InputError("`x0` is for fresh systems: runs have their own starts")
        states = _states(plan, runs)
        scores = _core.validation_runs(told, states, get_num_threads())
        same = (states[:, 0] == states[0, 0]).all() and np.isfinite(states).all()
        if same and not plan.read:
            free = _core.validation_mean(np.ascontiguousarray(states[:, -1]), target, asked.delta)
    return _judged(scores, units, target, asked, source, free)


def validated_loop(loop: PredictedLoop, runs: Runs, asked: Asked) -> Validation:
    """The same for runs of a loop, each predicted by the loop from its own start."""
    if isinstance(runs, Trajectories):
        K = int(runs.lengths.max())
    else:
        read = [validation.read(f"runs[{r}]", one) for r, one in enumerate(_listed(runs))]
        K = max((len(one) for one in read if one.ndim), default=0) - 1
    if K < 1:
        raise ShapeError("`runs` must have one step at least")
    nothing = np.zeros((K, loop.m)), np.zeros((K + 1, loop.n))
    like = Predicted(*nothing, None, None, loop.labels, loop.dt)
    states = _states(like, runs, loop)
    units = np.tile(loop.scale, (K, 1)) if asked.scale is None else _scale(asked.scale, like.states)
    running.need("the predictions", states.nbytes)
    paths = np.array([loop.path(run) for run in np.nan_to_num(states)])
    lost = ~np.isfinite(paths).all(axis=(1, 2))  # nothing is predicted: as a run that ended
    states[lost], paths[lost] = np.nan, 0.0
    threads, held, n = get_num_threads(), ~np.isnan(loop.target), loop.n
    target = np.where(held, loop.target, paths[0, -1])
    told = paths.reshape(-1, n), np.zeros((n, n)), units, target
    scores = _core.validation_runs(told, states, threads)
    if not held.all():
        part = tuple(np.ascontiguousarray(one[..., held]) for one in (paths, units, target, states))
        p = len(part[2])
        own = part[0].reshape(-1, p), np.zeros((p, p)), part[1], part[2]
        scores = scores[0], _core.validation_runs(own, part[3], threads)[1]
    return _judged(scores, units, target, asked, "runs of a loop")


def _judged(
    scores: tuple[Floats, Floats],
    units: Floats,
    target: Floats,
    asked: Asked,
    source: Source,
    free: float | None = None,
) -> Validation:
    """The order statistics of the scores."""
    size, rank, (delta, sure, _, weights) = len(scores[1]), None, asked
    if weights is None:
        rank = rank_of(size, delta, sure)
        factor, miss = (_core.validation_rank(one, rank) for one in scores)
    else:
        if sure is not None:
            raise InputError("`beta` must be left out with `weights`: no confidence is known")
        given = validation.vector("weights", weights, length=size + 1)
        if (given < 0.0).any():
            raise InputError("`weights` must be >= 0")
        factor, miss = (_core.validation_weighted(one, given, delta) for one in scores)
    with np.errstate(all="ignore"):
        # a radius that is compared in doubles must not lose its own order statistic to rounding
        radii = factor * units * (1.0 + 4.0 * np.finfo(float).eps)
    tube = np.vstack([np.zeros((1, len(target))), radii])  # the start of a run is known
    return Validation(factor, tube, miss, target, delta, sure, source, *scores, rank, free)


def _systems(runs: Runs) -> SystemEnsemble | None:
    """The fresh systems, if it is systems that are given."""
    if isinstance(runs, SystemEnsemble):
        if runs.centre == "estimate":
            raise InputError(
                "`runs` scatter about an estimate: they are models of one plant, no fresh systems"
            )
        return runs
    if isinstance(runs, (np.ndarray, Trajectories)) or not hasattr(runs, "__iter__"):
        return None
    given = validation.items("runs", runs)
    if any(isinstance(one, Identified) for one in given):
        raise InputError("`runs` must not be models from data, which are off their plant")
    if given and all(isinstance(one, System) for one in given):
        return SystemEnsemble.from_systems(given)
    return None


def _of_systems(
    plan: Predicted, told: Any, systems: SystemEnsemble, x0: ArrayLike | None
) -> tuple[Floats, Floats]:
    n, m = plan.states.shape[1], plan.u.shape[1]
    if (systems.n, systems.m) != (n, m):
        raise ShapeError(
            f"`runs` must have n={n} and m={m}, got systems with n={systems.n} and m={systems.m}"
        )
    validation.same_dt("runs", systems.dt, plan.dt, "this plan")
    fresh, N = systems_in_order("runs", systems, plan.labels), systems.size
    start = plan.x0 if x0 is None else x0
    if start is None:
        raise InputError("`x0` must be given: this plan begins at an estimate of it")
    running.need("the fresh systems", fresh.A.nbytes + fresh.B.nbytes)
    A, B = (np.ascontiguousarray(M.transpose(0, 2, 1)) for M in (fresh.A, fresh.B))
    starts = validation.starts(start, N, n, plan.labels.states)
    matrices = A.reshape(N, n * n), B.reshape(N, m * n), fresh.c
    return _core.validation_systems(told, *matrices, starts, plan.u, get_num_threads())


def _listed(runs: Any) -> list[Any]:
    """The runs; an array (K + 1, n) is one."""
    single = isinstance(runs, np.ndarray) and runs.ndim == 2
    return [runs] if single else validation.items("runs", runs)


def _states(plan: Predicted, runs: Runs, loop: PredictedLoop | None = None) -> Floats:
    """The states of all runs, (M, K + 1, n), nan after the end of a run that ended early."""
    shape = plan.states.shape
    if isinstance(runs, Trajectories):
        return _of_trajectories(plan, runs, loop)
    if isinstance(runs, np.ndarray) and runs.shape[-2:] != shape:
        raise ShapeError(f"`runs` must be runs of shape {shape}, got an array of {runs.shape}")
    given = _listed(runs)
    if not given:
        raise ShapeError(f"`runs` must be runs of shape {shape}, got none")
    running.need("the runs", 8 * len(given) * shape[0] * shape[1])
    states = np.full((len(given), *shape), np.nan)
    for r, one in enumerate(given):
        run = validation.read(f"runs[{r}]", one)
        if run.ndim != 2 or run.shape[1] != shape[1] or not 0 < len(run) <= shape[0]:
            raise ShapeError(
                f"`runs[{r}]` must have shape {shape}, or fewer rows if it ended early, got "
                f"{run.shape}"
            )
        ended = run.dtype.kind == "f" and ~np.isfinite(run).all(axis=1)
        rows = int(np.argmax(ended)) if np.any(ended) else len(run)
        if rows:
            states[r, :rows] = validation.matrix(f"runs[{r}]", run[:rows])
    return states


def _of_trajectories(plan: Predicted, runs: Trajectories, loop: PredictedLoop | None) -> Floats:
    (rows, n), (K, m) = plan.states.shape, plan.u.shape
    if (runs.n, runs.m) != (n, m):
        raise ShapeError(f"`runs` must have n={n} and m={m}, got n={runs.n} and m={runs.m}")
    validation.same_dt("runs", runs.dt, plan.dt, "this plan" if loop is None else "this loop")
    require_whole(runs, "runs", "whether a run stayed inside is not known where rows are lost")
    order = order_of("runs", Labels(runs.state_names, runs.input_names), plan.labels)
    running.need("the runs", 8 * len(runs) * rows * n)
    states = np.full((len(runs), rows, n), np.nan)
    for r, (x, u) in enumerate(runs.runs):
        T = min(len(u), K)
        states[r, : T + 1] = order.of_states(x[: T + 1])
        wanted = plan.u[:T] if loop is None else loop.inputs(states[r, :T])
        if (np.abs(order.of_inputs(u[:T]) - wanted) > _INPUTS * np.abs(wanted).max()).any():
            of = "plan" if loop is None else "loop"
            raise InputError(f"`runs` must have the inputs of this {of}, run {r} has others")
    return states


def _scale(scale: ArrayLike, states: Floats) -> Floats:
    rows, n = states.shape
    given = validation.array("scale", scale, ndim=(1, 2))
    if given.shape == (rows, n):
        given = given[1:]
    elif given.shape != (n,):
        raise ShapeError(f"`scale` must have shape ({n},) or ({rows}, {n}), got {given.shape}")
    if (given <= 0.0).any():
        raise InputError("`scale` must be > 0 after the start")
    return np.ascontiguousarray(np.broadcast_to(given, (rows - 1, n)))
