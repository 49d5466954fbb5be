"""A plan or a loop on runs that were held out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.names import Labels, order_of
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
from .fresh_systems import Source, Validation, rank_of

Runs: TypeAlias = "Trajectories | SystemEnsemble | Sequence[System] | Sequence[ArrayLike] | Any"

# Of the size of a state: the least unit of its deviations, also where no noise acts on it.
_LEAST = 1e-3
# Recorded inputs may be rounded: by this much of the largest one they are those of the plan.
_INPUTS = 1e-6


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
        if not isinstance(self.basis, ModelBasis) or not isinstance(self.basis.model, Model):
            return units
        if self.basis.model.covariance is None:
            return units
        A, added = map(np.ascontiguousarray, self.basis.model.with_outputs)
        units = _core.noise_deviations(A, added, K)[:, :n]
        floor = np.maximum(_LEAST * size, np.finfo(float).tiny)
        return np.where(np.isfinite(units), np.maximum(units, floor), size)


def validated(
    plan: Predicted,
    runs: Runs,
    delta: float,
    beta: float | None,
    x0: ArrayLike | None,
    scale: ArrayLike | None,
    weights: ArrayLike | None,
) -> Validation:
    """Check the arguments of `Plan.validate` and compute the order statistics."""
    delta = validation.probability("delta", delta)
    sure = None if beta is None else validation.probability("beta", beta)
    units = plan.scale() if scale is None else _scale(scale, plan.states)
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
            free = _core.validation_mean(np.ascontiguousarray(states[:, -1]), target, delta)
    return _judged(scores, units, target, delta, sure, weights, source, free)


def validated_loop(
    loop: PredictedLoop,
    runs: Runs,
    delta: float,
    beta: float | None,
    scale: ArrayLike | None,
    weights: ArrayLike | None,
) -> Validation:
    """The same for runs of a loop, each predicted by the loop from its own start."""
    delta = validation.probability("delta", delta)
    sure = None if beta is None else validation.probability("beta", beta)
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
    units = np.tile(loop.scale, (K, 1)) if scale is None else _scale(scale, like.states)
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
    return _judged(scores, units, target, delta, sure, weights, "runs of a loop", None)


def _judged(
    scores: tuple[Floats, Floats],
    units: Floats,
    target: Floats,
    delta: float,
    sure: float | None,
    weights: ArrayLike | None,
    source: Source,
    free: float | None,
) -> Validation:
    """The order statistics of the scores."""
    size, rank = len(scores[1]), None
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
                "`runs` scatter about an estimate, as drawn models of one plant do: they are "
                "no fresh systems, and nothing of the plant follows from them"
            )
        return runs
    if isinstance(runs, (np.ndarray, Trajectories)) or not hasattr(runs, "__iter__"):
        return None
    given = validation.items("runs", runs)
    if any(isinstance(one, Identified) for one in given):
        raise InputError(
            "`runs` must not be models from data: a model is off its plant, and no error of it is "
            "in the number"
        )
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
            raise InputError(
                f"`runs` must have the inputs of this {of}, run {r} has others: what runs under "
                "other inputs did says nothing of this one"
            )
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
