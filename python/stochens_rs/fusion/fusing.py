"""Fusing realizations or models into one estimate: `fuse`; of many sizes: `fuse_path`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args, overload

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.types import ArrayLike, Floats, Status, norm
from ..data.trajectories import Trajectories, shared_rows
from ..ensembles.ensemble import Ensemble, core_of, from_core, lines_of
from ..ensembles.systems import SystemEnsemble, systems_in_order
from ..exceptions import InputError, InputTypeError, NonFiniteError, ShapeError
from ..identification.assumptions import Noise
from ..identification.checks import warn_of
from ..identification.identified import Identified
from ..identification.identifying import identify
from ..identification.model import Model, require_states
from . import fused_model
from .fits import Alse, Fit, Path, fit_of, path, require, solve
from .fused_model import FusedModel

Method: TypeAlias = Literal["uniform", "alse", "slse", "slse-safeguarded"]

METHODS: tuple[Method, ...] = get_args(Method)


@overload
def fuse(
    ensemble: Ensemble | SystemEnsemble | Sequence[Ensemble],
    method: Method | Alse = "uniform",
    *,
    target: ArrayLike | None = None,
    weights: ArrayLike | Literal["precision"] | None = None,
    variances: ArrayLike | None = None,
) -> Fit: ...
@overload
def fuse(
    ensemble: SystemEnsemble | Sequence[Any],
    method: Literal["alse"] | Alse,
    *,
    data: Trajectories | Sequence[Trajectories] | Model,
    noise: Noise | float | None = None,
    shrink: bool = True,
    independent: bool = False,
) -> FusedModel: ...
def fuse(
    ensemble: Ensemble | SystemEnsemble | Sequence[Any],
    method: Method | Alse = "uniform",
    *,
    target: ArrayLike | None = None,
    data: Trajectories | Sequence[Trajectories] | Model | None = None,
    weights: ArrayLike | Literal["precision"] | None = None,
    variances: ArrayLike | None = None,
    noise: Noise | float | None = None,
    shrink: bool = True,
    independent: bool = False,
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
    method : str or Alse, default "uniform"
        "uniform": the average. "alse" (accumulated least squares): the weights that minimise
        ``||sum_s w_s E_s - target||``; with `data`, those of the mixture of models that is nearest
        to the data. Its options, such as limits on time and weights per column, are those of
        `fusion.Alse`. "slse" (sequential least squares): one exact line search per realization.
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
    if data is not None:
        for one in data if isinstance(data, (list, tuple)) else [data]:
            runs = one.data if isinstance(one, Model) else one
            if isinstance(runs, Trajectories) and runs.outputs:
                raise InputError("`data` must have states, got readings: read it with states=")
        _, options = _method(method)
        if options is None or options.weight_set != "simplex":
            raise InputError(f"`method` must be 'alse' or Alse() with `data`, got {method!r:.40}")
        validation.left_out("with `data`", target=target, weights=weights, variances=variances)
        return _by_data(ensemble, data, noise, (shrink, independent), options)
    shrinks, own = (None if shrink is True else shrink), (None if independent is False else True)
    validation.left_out("without `data`", noise=noise, shrink=shrinks, independent=own)
    if isinstance(ensemble, SystemEnsemble):
        matrices = fused_model.stacked(ensemble, ensemble.c is not None)
        ensemble = Ensemble.from_samples(matrices, centre=ensemble.centre)
    elif isinstance(ensemble, (list, tuple)):
        ensemble = _of_senders(ensemble)
    given, name, options = _checked(ensemble, method)
    goal = None if target is None and name == "uniform" else _goal(given, target, name)
    # the weights, and at most two copies on the way
    running.need("the weights", 3 * 8 * given.size)
    if name != "uniform":
        validation.left_out(f"for method '{name}'", weights=weights, variances=variances)
    elif weights is not None or variances is not None:
        return _weighted(given, goal, weights, variances)
    if goal is None or name == "uniform":
        estimate = given.mean()
        error = None if goal is None else norm(estimate - goal)
        w = np.full(given.size, 1.0 / given.size)
    elif options is not None:
        return solve(given, goal, options)
    else:
        of_core = core_of(given), lines_of(given, goal)
        w, sums, errors, _ = _core.fuse_path(*of_core, name, [given.size], False)
        estimate, error = from_core(given, sums), float(errors[0])
    return fit_of(given, goal, name, estimate, w, error, None, "completed")


def fuse_path(
    ensemble: Ensemble,
    sizes: ArrayLike,
    method: Method | Alse = "uniform",
    *,
    target: ArrayLike,
    estimates: bool = False,
) -> Path:
    """Compute the error of the fusion of the first k realizations, for several k.

    Parameters
    ----------
    ensemble : Ensemble
        N realizations.
    sizes : array_like of int, shape (k,)
        Strictly increasing, from 1 to N.
    method : str or Alse, default "uniform"
        As in `fuse`; of `fusion.Alse` the `max_iter` is per size, and the `time_limit` for all
        sizes together. The sizes after the limit keep the weights of the last solved size (dense
        ensembles: of a solve without iterations) and have status "user_limit"; after Ctrl-C,
        "interrupted".
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
    ensemble, name, options = _checked(ensemble, method)
    grid = validation.sizes("sizes", sizes, maximum=ensemble.size)
    goal = _goal(ensemble, target, name)
    estimates = validation.flag("estimates", estimates)
    if estimates:
        # as the core returns them, transposed, and in the shape of the target
        running.need("the estimates of a path", 3 * grid.size * goal.nbytes)
    counts: list[int] = grid.tolist()
    gaps = None
    completed: Status = "completed"
    statuses = (completed,) * grid.size
    if options is None:
        of_core = core_of(ensemble), lines_of(ensemble, goal)
        _, _, errors, stack = _core.fuse_path(*of_core, name, counts, estimates)
    else:
        errors, gaps, statuses, stack = path(ensemble, goal, options, counts, estimates)
    kept = from_core(ensemble, stack, stack=True) if estimates else None
    return Path(grid, errors, name, statuses, gaps, kept)


def _method(method: object) -> tuple[Method, Alse | None]:
    """Check a method: its name, and the options of "alse"."""
    if isinstance(method, Alse):
        return "alse", method
    name = validation.choice("method", method, METHODS)
    return name, Alse() if name == "alse" else None


def _checked(ensemble: object, method: object) -> tuple[Ensemble, Method, Alse | None]:
    """Check realizations, the method, and its options."""
    if not isinstance(ensemble, Ensemble):
        raise InputTypeError(f"`ensemble` must be an Ensemble, got {type(ensemble).__name__}")
    name, options = _method(method)
    if options is not None:
        require(options, ensemble)
    return ensemble, name, options


def _goal(ensemble: Ensemble, target: ArrayLike | None, method: str) -> Floats:
    """Check the target that a method fits to."""
    if target is None:
        raise InputError(f"`target` is required for method '{method}': what to fit to")
    return validation.shaped("target", target, ensemble.shape)


def _of_senders(ensembles: Sequence[object]) -> Ensemble:
    """The realizations of several senders, one after another."""
    given = [validation.instance("ensemble", one, Ensemble) for one in ensembles]
    if not given:
        raise InputError("`ensemble` must have at least one Ensemble, got an empty list")
    for k, one in enumerate(given):
        if one.shape != given[0].shape:
            raise ShapeError(f"`ensemble[{k}]` must have shape {given[0].shape}, got {one.shape}")
    entries = sum(one.size for one in given) * math.prod(given[0].shape)
    running.need("the realizations of all senders", 3 * 8 * entries)
    centres = {one.centre for one in given}
    centre = centres.pop() if len(centres) == 1 else None
    return Ensemble.from_samples(np.concatenate([one.dense() for one in given]), centre=centre)


def _weighted(ensemble: Ensemble, goal: Floats | None, weights: object, variances: object) -> Fit:
    """Average with these weights; `fuse` says what the arguments are."""
    N, info = ensemble.size, dict[str, Any]()
    spread = None
    if variances is not None:
        spread = validation.vector("variances", variances, length=N)
        if spread.min() <= 0.0:
            raise InputError(f"`variances` must be positive, got {spread.min():g}")
        if ensemble.centre == "estimate":
            raise InputError("`variances` must be left out: realizations scatter about an estimate")
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
    error = None if goal is None else norm(estimate - goal)
    result = estimate, chosen, error, None, "completed"
    return fit_of(ensemble, goal, method, *result, info=info)


# -- models weighed by data -----------------------------------------------------------------------


def _by_data(
    models: object, data: object, noise: Any, asked: tuple[bool, bool], options: Alse
) -> FusedModel:
    """Weigh models by how well their mixture explains data; `asked`: `shrink`, `independent`."""
    shrink, independent = map(validation.flag, ("shrink", "independent"), asked)
    given = _models(models, data, independent)
    least = _least_squares(given, data, noise)
    given = systems_in_order("ensemble", given, least.labels)
    f = least.blocks[0]
    if f.rank == 0:
        raise InputError("`data` determine nothing: all states and inputs are 0")
    running.need("the models", 4 * 8 * given.size * given.n * (f.rank + len(f.columns)))
    with np.errstate(over="ignore", invalid="ignore"):
        S, t = fused_model.coordinates(given, least)
    if not np.isfinite(S).all() or not np.isfinite(np.vdot(S, S)):
        raise NonFiniteError("the squares of the data and the models overflow: scale them down")
    differences = (S - t).reshape(given.size, -1)
    fit = solve(Ensemble.from_samples(differences), np.zeros(differences.shape[1]), options)
    assert fit.gap is not None
    weights = fit.weights / fit.weights.sum()
    share = (
        _core.hull_share(fused_model.position(S, t, weights), fused_model.noise_of(least))
        if shrink
        else 0.0
    )
    fused = FusedModel(given, least, weights, share, fit.gap, fit.status)
    own = [text for text in fused.warnings if text not in least.warnings]
    warn_of(own, "fused.warnings")
    return fused


def _least_squares(given: SystemEnsemble, data: object, noise: Any) -> Model:
    """Least squares of the data, with what was declared; refused where the method needs more."""
    if isinstance(data, Model):
        validation.left_out("where `data` is a model, which has it", noise=noise)
        least = data
    elif isinstance(data, Identified):
        raise InputTypeError(f"`data` must be Trajectories or a Model, got {validation.show(data)}")
    else:
        least = identify(data, noise=noise, intercept=given.c is not None)  # type: ignore[arg-type]
    require_states(least, "data")
    fused_model.require_fit("data", least, given)
    validation.same_dt("data", least.dt, given.dt, "the models")
    if (law := least.assumptions.noise) != "gaussian":
        raise InputError(f"`data` must be identified with Gaussian noise, got '{law}'")
    return least


def _models(models: object, data: object, independent: bool) -> SystemEnsemble:
    """The models, refused where they are known to be made of the data."""
    if isinstance(models, SystemEnsemble):
        given = models
    else:
        items = validation.items("ensemble", models)
        for k, one in enumerate(items):
            if isinstance(one, Identified):
                _apart_from(k, one, data, independent)
        given = fused_model.ensemble_of("ensemble", items)
    if given.centre == "estimate" and not independent:
        raise InputError(
            "`ensemble` scatters about an estimate from data, and no region holds; pass "
            "independent=True if that is of other data"
        )
    return given


def _apart_from(k: int, one: Identified, data: object, independent: bool) -> None:
    """Refuse a model that was fitted on some of the data."""
    own = getattr(one, "data", None)
    if own is None:
        if not independent:
            raise InputError(f"`ensemble[{k}]` does not keep its data: pass independent=True")
        return
    sets = [data] if not isinstance(data, (list, tuple)) else data
    for other in sets:
        rows = getattr(other, "data", other)
        if isinstance(rows, Trajectories) and shared_rows(own, rows):
            raise InputError(f"`ensemble[{k}]` was fitted on pairs of `data`: see data.split()")
