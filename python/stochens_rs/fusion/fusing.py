"""Fusing realizations or models into one estimate: `fuse`; of many sizes: `fuse_path`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args, overload

import numpy as np

from .. import _core
from .._base import numbers, running, validation
from .._base.types import Floats, Status
from ..ensembles.ensemble import Ensemble
from ..ensembles.systems import SystemEnsemble
from ..exceptions import InputError, InputTypeError, ShapeError
from . import alse
from .alse import WeightSet
from .by_data import fuse_by_data
from .fits import Fit, Path
from .fused_model import FusedModel, stacked

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ..data import Trajectories
    from ..identification.assumptions import Noise
    from ..identification.model import Model

Method: TypeAlias = Literal["uniform", "alse", "slse", "slse-safeguarded"]

METHODS: tuple[Method, ...] = get_args(Method)


@overload
def fuse(
    ensemble: Ensemble | SystemEnsemble | Sequence[Ensemble],
    method: Method = "uniform",
    *,
    target: ArrayLike | None = None,
    weights: ArrayLike | Literal["precision"] | None = None,
    variances: ArrayLike | None = None,
    weight_set: WeightSet = "simplex",
    tol: float = 1e-9,
    time_limit: float | None = None,
    max_iter: int | None = None,
) -> Fit: ...
@overload
def fuse(
    ensemble: SystemEnsemble | Sequence[Any],
    method: Literal["alse"],
    *,
    data: Trajectories | Sequence[Trajectories] | Model,
    noise: Noise | float | None = None,
    shrink: bool = True,
    independent: bool = False,
    tol: float = 1e-9,
    time_limit: float | None = None,
    max_iter: int | None = None,
) -> FusedModel: ...
def fuse(
    ensemble: Ensemble | SystemEnsemble | Sequence[Any],
    method: Method = "uniform",
    *,
    target: ArrayLike | None = None,
    data: Trajectories | Sequence[Trajectories] | Model | None = None,
    weights: ArrayLike | Literal["precision"] | None = None,
    variances: ArrayLike | None = None,
    noise: Noise | float | None = None,
    shrink: bool = True,
    independent: bool = False,
    weight_set: WeightSet = "simplex",
    tol: float = 1e-9,
    time_limit: float | None = None,
    max_iter: int | None = None,
) -> Fit | FusedModel:
    """Fuse realizations or models into one estimate.

    Parameters
    ----------
    ensemble : Ensemble, list of them, SystemEnsemble, or list of systems or models
        N realizations of a vector or matrix; of a SystemEnsemble the matrices ``[A B c]``; of a
        list of Ensembles the realizations of all, as those of several senders. With
        `data`: models that were fixed before the data or made of other data, as a SystemEnsemble
        or a list of systems, pairs ``(A, B)`` and Models; the names of the data in another order
        are brought into its order.
    method : str, default "uniform"
        "uniform": the average. "alse" (accumulated least squares): the weights that minimise
        ``||sum_s w_s E_s - target||``; with `data`, those of the mixture of models that is nearest
        to the data. "slse" (sequential least squares): one exact line search per realization.
        "slse-safeguarded": each followed by a line search towards the running average, so that the
        error is never larger than that of "uniform".
    target : array_like, shape of a realization, optional
        The vector or matrix that the least-squares methods fit to, such as a nominal model or a
        held-out estimate; required for them without `data`. "uniform" uses it only for the
        reported error. In the paper it is the exact vector or matrix.
    data : Trajectories, list of them, or Model, optional
        Measured runs that weigh the models. A Model from `identify` brings its assumptions with
        it: a known covariance, an intercept, a scale. Models that were fitted on some of these
        pairs are refused; where `ensemble` keeps no data, you declare by the call that there are
        none.
    weights : array_like of shape (N,) or "precision", optional
        Weights >= 0 for "uniform", divided by their sum; "precision": in proportion to
        ``1 / variances``.
    variances : array_like, shape (N,), optional
        ``E ||E_s - mean||^2`` of each realization. Then `Fit.info` has "rms".
    noise : Noise or float, optional
        For runs as `data`, as in `identify`.
    shrink : bool, default True
        With `data`: whether least squares takes part, with the share that the data call for.
        False: a mixture of the models alone.
    independent : bool, default False
        Your declaration that models which scatter about an estimate (``centre="estimate"``), or
        come from data they do not keep, are independent of `data`.
    weight_set : {"simplex", "subsimplex", "per-column", "per-row"}, default "simplex"
        For "alse". "simplex": weights >= 0 with sum 1. "subsimplex": sum <= 1. "per-column": each
        column of a matrix has its own weights on the simplex; "per-row" the same for realizations
        sampled by rows. A fit per column or row can be used with product fusion only, because
        diagonal fusion needs one weight per realization.
    tol : float, default 1e-9
        "alse" is "optimal" if its gap is at most ``tol * ||target||^2``. If the target is zero,
        the squared norm of a realization takes its place.
    time_limit : float, optional
        Time after which "alse" returns the best weights so far, with status "user_limit" [s].
        Checked every few milliseconds. Default: no limit.
    max_iter : int, optional
        The same limit in passes over the realizations (one product with S, one with its
        transpose). Default: 200 000.

    Returns
    -------
    Fit or FusedModel
        Estimate, weights, error, gap and status; with `data` a `FusedModel`, which has regions.
        Ctrl-C during "alse" of a matrix returns the best weights so far, with status
        "interrupted"; a second Ctrl-C raises KeyboardInterrupt.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it. If models were fitted on `data`.
    SolverError
        If the solver cannot solve the problem.

    Warns
    -----
    DataWarning
        With `data`: as `FusedModel.warnings`, such as that no mixture explains the data.

    Notes
    -----
    *ALSE* of singleton vectors has a closed form (Lemma 4.4, corrected): with
    ``tau_k = sign(w_k) target_k / g``, the total weight of the realizations that hit entry k is
    the Euclidean projection of tau, restricted to the entries hit, onto the simplex. These
    realizations share it equally. (The paper's weights ``|w_k|`` do not add up to one.) With
    weights per column, each column of a matrix has this closed form, and the error is zero as
    soon as every nonzero entry has been hit. All other problems are solved numerically; the
    status follows from the gap, computed from the realizations. If the target lies in the hull of
    the realizations, the solver stops there and sets `Fit.exact`. This happens at a finite N:
    near twice the dimension of the hull, or when the rarest entry has been hit, if that is later.

    *SLSE* is Lemma 4.5 with the recursion on the fused F: ``F <- (1 - t) F + t E``,
    ``t = clip(<target - F, E - F> / ||E - F||^2, 0, 1)``. For independent, unbiased realizations
    its mean-square error is at most that of "uniform". For a single sample it can be larger,
    unlike the paper states; with the safeguard it cannot.

    *By data*: with H least squares and ``V = sum z z'`` over the data, the weights minimise
    ``||(sum_s w_s Theta_s - H) V^1/2||_F``, which is least squares of the data over mixtures; each
    row in units of its noise, see `FusedModel.distance`. The share of H is ``max(0, 1 - c / ||(F -
    H) V^1/2||_F^2)``, with ``c = sigma^2 min(1.5 (q - 2), chi^2_{q; 0.01})`` for q directions of
    the data beside the face that the mixture F is in: the data come in where they contradict the
    models, and for an independent design and a covariance that is known but for a factor the
    mean-square error is below that of least squares for every system with q > 2 (after James and
    Stein 1961; Bock 1982). See also `FusedModel.region`. With hardly more pairs than unknowns, an
    error in this norm says little of fresh states and inputs, and ``shrink=False`` may be better.

    *Weights*: for independent realizations with the truth as mean and these variances, the error
    of the average has the mean square ``sum_s w_s^2 variances[s] = rms^2``, least for "precision".
    Where the data are at hand, `identify` of all of them together is better than any weights.

    Examples
    --------
    >>> import stochens_rs as se
    >>> w = [3.0, -1.0, 0.5, 2.0]
    >>> ensemble = se.sample(w, 200, rng=1)
    >>> se.fuse(ensemble).estimate.shape
    (4,)
    >>> fit = se.fuse(ensemble, "alse", target=w)
    >>> fit.status, fit.error < 1e-12
    ('optimal', True)

    Two models of a system weighed by 30 measured steps:

    >>> import numpy as np
    >>> A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.0], [1.0]])
    >>> z = np.random.default_rng(1).standard_normal((30, 5))
    >>> x, u, w = z[:, :2], z[:, 2:3], 0.1 * z[:, 3:]
    >>> data = se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + w)
    >>> models = [(1.1 * A, B), (0.9 * A, B)]
    >>> fused = se.fuse(models, "alse", data=data, noise=se.Noise(sigma=0.1, design="independent"))
    >>> fused
    <FusedModel: 2 models, n=2 m=1, 30 pairs, 44.1 % least squares>
    >>> fused.region(0.05).contains(A, B)
    True
    """
    of_data = {
        "noise": noise,
        "shrink": None if shrink is True else shrink,
        "independent": None if independent is False else independent,
    }
    of_realizations = {"target": target, "weights": weights, "variances": variances}
    if data is not None:
        if validation.choice("method", method, METHODS) != "alse":
            raise InputError(f"`method` must be 'alse' with `data`, got '{method}'")
        _refuse("with `data`", **of_realizations)
        limits = alse.checked_options(None, "alse", weight_set, tol, time_limit, max_iter)
        return fuse_by_data(ensemble, data, noise, shrink, independent, limits)
    _refuse("without `data`", **of_data)
    if isinstance(ensemble, SystemEnsemble):
        matrices = stacked(ensemble, ensemble.c is not None)
        ensemble = Ensemble.from_samples(matrices, centre=ensemble.centre)
    elif isinstance(ensemble, (list, tuple)):
        ensemble = of_senders(ensemble)
    given, name = checked_ensemble(ensemble, method)
    options = alse.checked_options(given, name, weight_set, tol, time_limit, max_iter)
    goal = None if target is None and name == "uniform" else checked_goal(given, target, name)
    # the weights, and at most two copies on the way
    running.need("the weights", 3 * 8 * given.size)
    if weights is not None or variances is not None:
        if name != "uniform":
            raise InputError(f"`weights` and `variances` must be left out for method '{name}'")
        return _weighted(given, goal, weights, variances)
    if goal is None or name == "uniform":
        estimate = given.mean()
        error = None if goal is None else numbers.norm(estimate - goal)
        w = np.full(given.size, 1.0 / given.size)
    elif name == "alse":
        return alse.solve(given, goal, options)
    else:
        of_core = given._core_realizations(), given._lines_of(goal)
        w, sums, errors, _ = _core.fuse_path(*of_core, name, [given.size], False)
        estimate, error = given._from_core(sums), float(errors[0])
    return Fit._of(given, goal, name, w, estimate, error)


def fuse_path(
    ensemble: Ensemble,
    sizes: ArrayLike,
    method: Method = "uniform",
    *,
    target: ArrayLike,
    weight_set: WeightSet = "simplex",
    tol: float = 1e-9,
    time_limit: float | None = None,
    max_iter: int | None = None,
    estimates: bool = False,
) -> Path:
    """Compute the error of the fusion of the first k realizations, for several k.

    Parameters
    ----------
    ensemble : Ensemble
        N realizations.
    sizes : array_like of int, shape (k,)
        Strictly increasing, from 1 to N.
    method, weight_set, tol, max_iter
        As in `fuse`; `max_iter` is per size.
    time_limit : float, optional
        As in `fuse`, for all sizes together [s]. The sizes after the limit keep the weights of
        the last solved size (dense ensembles: of a solve without iterations) and have status
        "user_limit"; after Ctrl-C, "interrupted".
    target : array_like, shape of a realization
        The vector or matrix that the errors are measured against and the least-squares methods
        fit to.
    estimates : bool, default False
        Whether to keep the estimates.

    Returns
    -------
    Path
        Errors, statuses and gaps, and the estimates if ``estimates=True``.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    SolverError
        If the solver cannot solve a problem.

    Notes
    -----
    All but ALSE of matrices and of dense ensembles take one pass over the realizations. ALSE of
    matrices is solved for every size, starting from the last solution where that is faster; that of
    dense ensembles is solved for every size separately.

    Examples
    --------
    >>> import stochens_rs as se
    >>> A = [[0.9, 0.2], [-0.1, 0.8]]
    >>> path = se.fuse_path(se.sample(A, 1000, rng=1), [10, 100, 1000], "slse", target=A)
    >>> bool(path.errors[0] > path.errors[2])
    True
    """
    ensemble, name = checked_ensemble(ensemble, method)
    options = alse.checked_options(ensemble, name, weight_set, tol, time_limit, max_iter)
    grid = validation.sizes("sizes", sizes, maximum=ensemble.size)
    goal = checked_goal(ensemble, target, name)
    estimates = validation.flag("estimates", estimates)
    if estimates:
        # as the core returns them, transposed, and in the shape of the target
        running.need("the estimates of a path", 3 * grid.size * goal.nbytes)
    counts: list[int] = grid.tolist()
    draws, gaps = ensemble._draws, None
    completed: Status = "completed"
    statuses = (completed,) * grid.size
    if name != "alse":
        _, _, errors, stack = _core.fuse_path(
            ensemble._core_realizations(), ensemble._lines_of(goal), name, counts, estimates
        )
    elif draws is not None:
        errors, gaps, statuses, stack = alse.path(ensemble, draws, goal, options, counts, estimates)
    else:
        errors, gaps, statuses, stack = _one_by_one(ensemble, goal, options, counts)
    kept = ensemble._stack_from_core(stack) if estimates else None
    return Path(grid, errors, name, statuses, gaps, kept)


def _weighted(ensemble: Ensemble, goal: Floats | None, weights: object, variances: object) -> Fit:
    """Average with these weights; `fuse` says what the arguments are."""
    N, info = ensemble.size, dict[str, Any]()
    spread = None
    if variances is not None:
        spread = validation.vector("variances", variances, length=N)
        if spread.min() <= 0.0:
            raise InputError(f"`variances` must be positive, got {spread.min():g}")
        if ensemble.centre == "estimate":
            raise InputError(
                "`variances` must be left out: the realizations scatter about an estimate from "
                "data, so that no error follows"
            )
    method, chosen = "uniform", np.full(N, 1.0 / N)
    if isinstance(weights, str):
        method = validation.choice("weights", weights, ("precision",))
        if spread is None:
            raise InputError("`variances` must be given for weights='precision'")
        # w_s ~ 1 / v_s, the least sum w_s^2 v_s of all weights with sum 1
        chosen = spread.min() / spread
    elif weights is not None:
        method, chosen = "weighted", validation.vector("weights", weights, length=N)
        if chosen.min() < 0.0 or not chosen.any():
            raise InputError("`weights` must be nonnegative and not all 0")
        chosen = chosen / chosen.max()
    chosen = chosen / chosen.sum()
    if spread is not None:
        # rms^2 = sum w_s^2 v_s for independent realizations with the truth as mean
        largest = float(spread.max())
        info["rms"] = float(np.sqrt(np.sum(chosen**2 * (spread / largest)))) * largest**0.5
    estimate = ensemble.combine(chosen)
    error = None if goal is None else numbers.norm(estimate - goal)
    return Fit._of(ensemble, goal, method, chosen, estimate, error, info=info)


def _one_by_one(
    ensemble: Ensemble, goal: Floats, options: alse.AlseOptions, sizes: list[int]
) -> tuple[Floats, Floats, tuple[Status, ...], Floats]:
    """ALSE of every prefix separately, all within one time limit."""
    clock, interrupted = alse.Clock(options), False
    fits = []
    for k in sizes:
        fit = alse.solve(ensemble.prefix(k), goal, clock.left())
        if interrupted and fit.status == "user_limit":
            fit = replace(fit, status="interrupted")
        elif fit.status == "interrupted":
            interrupted = True
            clock.end()
        fits.append(fit)
    errors, gaps = (np.array([getattr(fit, name) for fit in fits]) for name in ("error", "gap"))
    stack = np.stack([fit.estimate.ravel() for fit in fits])
    return errors, gaps, tuple(fit.status for fit in fits), stack


def _refuse(where: str, **arguments: object) -> None:
    """Refuse arguments that have no meaning here."""
    for name, value in arguments.items():
        if value is not None:
            raise InputError(f"`{name}` must be left out {where}")


def of_senders(ensembles: Sequence[object]) -> Ensemble:
    """The realizations of several senders, one after another."""
    given = [validation.instance("ensemble", one, Ensemble) for one in ensembles]
    if not given:
        raise InputError("`ensemble` must have at least one Ensemble, got an empty list")
    for k, one in enumerate(given):
        if one.shape != given[0].shape:
            raise ShapeError(
                f"`ensemble[{k}]` must have shape {given[0].shape} as the first, got {one.shape}"
            )
    entries = sum(one.size for one in given) * math.prod(given[0].shape)
    running.need("the realizations of all senders", 3 * 8 * entries)
    centres = {one.centre for one in given}
    centre = centres.pop() if len(centres) == 1 else None
    return Ensemble.from_samples(np.concatenate([one.dense() for one in given]), centre=centre)


def checked_goal(ensemble: Ensemble, target: ArrayLike | None, method: str) -> Floats:
    """Check the target that a method fits to."""
    if target is None:
        raise InputError(
            f"`target` is required for method '{method}': the vector or matrix to fit to "
            "(a nominal model or a held-out estimate)"
        )
    goal = validation.array("target", target, ndim=(1, 2))
    if goal.shape != ensemble.shape:
        raise ShapeError(
            f"`target` must have shape {ensemble.shape} as a realization, got {goal.shape}"
        )
    return goal


def checked_ensemble(ensemble: object, method: object) -> tuple[Ensemble, Method]:
    """Check that realizations are an Ensemble, and the name of their method."""
    if not isinstance(ensemble, Ensemble):
        raise InputTypeError(
            "`ensemble` must be an Ensemble (see `sample`, `Ensemble.from_samples`), "
            f"got {type(ensemble).__name__}"
        )
    return ensemble, validation.choice("method", method, METHODS)
