"""Fusing realizations with weights on the simplex: uniform, ALSE, SLSE."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np

from .. import _core
from .._base import gate, memory, numbers
from .._base.types import Floats, Status
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputError, InputTypeError, ShapeError
from . import alse
from .alse import WeightSet
from .fits import Fit, Path

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

Method: TypeAlias = Literal["uniform", "alse", "slse", "slse-safeguarded"]

METHODS: tuple[Method, ...] = get_args(Method)


def fuse(
    ensemble: Ensemble,
    method: Method = "uniform",
    *,
    target: ArrayLike | None = None,
    weight_set: WeightSet = "simplex",
    tol: float = 1e-9,
    time_limit: float | None = None,
    max_iter: int | None = None,
) -> Fit:
    """Fuse the realizations of an ensemble into one estimate.

    Parameters
    ----------
    ensemble : Ensemble
        N realizations of a vector or matrix.
    method : {"uniform", "alse", "slse", "slse-safeguarded"}, default "uniform"
        "uniform": the average. "alse" (accumulated least squares): the weights that minimise
        ``||sum_s w_s E_s - target||``. "slse" (sequential least squares): one exact line search
        per realization. "slse-safeguarded": each followed by a line search towards the running
        average, so that the error is never larger than that of "uniform".
    target : array_like, shape of a realization, optional
        The vector or matrix that the least-squares methods fit to, such as a nominal model or a
        held-out estimate; required for them. "uniform" uses it only for the reported error. In
        the paper it is the exact vector or matrix.
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
    Fit
        Estimate, weights, error, gap and status. Ctrl-C during "alse" of a matrix returns the
        best weights so far, with status "interrupted"; a second Ctrl-C raises KeyboardInterrupt.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    SolverError
        If the solver cannot solve the problem.

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
    """
    name = _checked(ensemble, method)
    options = alse.checked_options(ensemble, name, weight_set, tol, time_limit, max_iter)
    goal = None if target is None and name == "uniform" else _goal(ensemble, target, name)
    # the weights, and at most two copies on the way
    memory.need("the weights", 3 * 8 * ensemble.size)
    if name == "uniform":
        estimate = ensemble.mean()
        error = None if goal is None else numbers.norm(estimate - goal)
        equal = np.full(ensemble.size, 1.0 / ensemble.size)
        return Fit(estimate, equal, error, None, "completed", name, target=goal, ensemble=ensemble)
    assert goal is not None
    if name == "alse":
        return alse.solve(ensemble, goal, options)
    steps = _core.slse(
        ensemble._core_realizations(),
        ensemble._lines_of(goal),
        name,
        [ensemble.size],
        False,
    )
    estimate = ensemble._from_core(steps[1])
    error = float(steps[2][0])
    return Fit(estimate, steps[0], error, None, "completed", name, target=goal, ensemble=ensemble)


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
    "uniform", "slse" and the closed form take one pass over the realizations. ALSE of matrices is
    solved for every size, starting from the last solution where that is faster. "uniform" and
    "alse" of dense ensembles are computed for every size separately.

    Examples
    --------
    >>> import stochens_rs as se
    >>> A = [[0.9, 0.2], [-0.1, 0.8]]
    >>> path = se.fuse_path(se.sample(A, 1000, rng=1), [10, 100, 1000], "slse", target=A)
    >>> bool(path.errors[0] > path.errors[2])
    True
    """
    name = _checked(ensemble, method)
    options = alse.checked_options(ensemble, name, weight_set, tol, time_limit, max_iter)
    grid = gate.sizes("sizes", sizes, maximum=ensemble.size)
    goal = _goal(ensemble, target, name)
    estimates = gate.flag("estimates", estimates)
    if estimates:
        # as the core returns them, transposed, and in the shape of the target
        memory.need("the estimates of a path", 3 * grid.size * goal.nbytes)
    counts: list[int] = grid.tolist()
    draws, lines = ensemble._draws, ensemble._lines_of(goal)
    gaps: Floats | None = None
    completed: Status = "completed"
    statuses = (completed,) * grid.size
    if name in ("slse", "slse-safeguarded"):
        _, _, errors, stack = _core.slse(
            ensemble._core_realizations(), lines, name, counts, estimates
        )
    elif name == "uniform" and draws is not None:
        errors, stack = _core.uniform_path(draws, lines, counts, estimates)
    elif name == "alse" and draws is not None:
        errors, gaps, statuses, stack = alse.path(ensemble, draws, goal, options, counts, estimates)
    else:
        errors, gaps, statuses, stack = _one_by_one(ensemble, goal, name, options, counts)
    kept = ensemble._stack_from_core(stack) if estimates else None
    return Path(grid, errors, name, statuses, gaps, kept)


def _one_by_one(
    ensemble: Ensemble, goal: Floats, method: str, options: alse.AlseOptions, sizes: list[int]
) -> tuple[Floats, Floats | None, tuple[Status, ...], Floats]:
    """Fuse every prefix separately, all within one time limit."""
    clock, interrupted = alse.Clock(options), False
    fits = []
    for k in sizes:
        prefix = ensemble.prefix(k)
        if method == "alse":
            fit = alse.solve(prefix, goal, clock.left())
            if interrupted and fit.status == "user_limit":
                fit = replace(fit, status="interrupted")
            elif fit.status == "interrupted":
                interrupted = True
                clock.end()
            fits.append(fit)
        else:
            fits.append(fuse(prefix, "uniform", target=goal))
    errors = np.array([fit.error for fit in fits], dtype=np.float64)
    gaps = np.array([fit.gap for fit in fits], dtype=np.float64) if method == "alse" else None
    stack = np.stack([fit.estimate.ravel() for fit in fits])
    return errors, gaps, tuple(fit.status for fit in fits), stack


def _goal(ensemble: Ensemble, target: ArrayLike | None, method: str) -> Floats:
    if target is None:
        raise InputError(
            f"`target` is required for method '{method}': the vector or matrix to fit to "
            "(a nominal model or a held-out estimate)"
        )
    goal = gate.array("target", target, ndim=(1, 2))
    if goal.shape != ensemble.shape:
        raise ShapeError(
            f"`target` must have shape {ensemble.shape} as a realization, got {goal.shape}"
        )
    return goal


def _checked(ensemble: object, method: str) -> str:
    if not isinstance(ensemble, Ensemble):
        raise InputTypeError(
            "`ensemble` must be an Ensemble (see `sample`, `Ensemble.from_samples`), "
            f"got {type(ensemble).__name__}"
        )
    return gate.choice("method", method, METHODS)
