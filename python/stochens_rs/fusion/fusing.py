"""Fusing realizations with weights on the simplex: uniform, ALSE, SLSE."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import gate, memory, numbers
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputError, InputTypeError, ShapeError
from . import alse
from .fits import Fit, Path

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Method: TypeAlias = Literal["uniform", "alse", "slse", "slse-safeguarded"]
Weights: TypeAlias = Literal["simplex", "subsimplex", "per-column", "per-row"]

METHODS = ("uniform", "alse", "slse", "slse-safeguarded")


def fuse(
    ensemble: Ensemble,
    method: Method = "uniform",
    *,
    target: ArrayLike | None = None,
    weights: Weights = "simplex",
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
        ``||sum_s w_s E_s - target||``. "slse" (sequential): one exact line search per realization.
        "slse-safeguarded": followed by one towards the running average, so that the result is
        never worse than "uniform".
    target : array_like, shape of a realization, optional
        What the least-squares methods fit to: a nominal model or a held-out estimate. Required
        for them; for "uniform" it is used for the reported error only. In the paper's analysis it
        is the exact vector or matrix.
    weights : {"simplex", "subsimplex", "per-column", "per-row"}, default "simplex"
        The weights of "alse" are nonnegative and add up to one, or to at most one. "per-column"
        gives every column of a matrix weights of its own, each on the simplex ("per-row" for
        realizations sampled by rows). Such a fit is for product fusion, where only the estimate
        counts: one realization then has no weight, so controls cannot be averaged with them.
    tol : float, default 1e-9
        "alse" is "optimal" when its gap is at most ``tol * ||target||^2`` (times the squared norm
        of a realization if the target is zero).
    time_limit : float, optional
        Seconds after which "alse" returns the best weights so far, status "user_limit". The
        solver looks at the clock every few milliseconds; by default it takes the time it needs.
    max_iter : int, optional
        Passes over the realizations (one product with S, one with its transpose) after which it
        does so; by default the solver's own limit, 200 000.

    Returns
    -------
    Fit
        Estimate, weights, error, gap and status. Ctrl-C during "alse" of a matrix returns the
        best weights so far, status "interrupted"; a second one raises KeyboardInterrupt.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    SolverError
        If the solver refuses the problem.

    Notes
    -----
    For singleton vectors ALSE has a closed form (Lemma 4.4, corrected): with
    ``tau_k = sign(w_k) target_k / g``, the total weight of the realizations that hit k is the
    Euclidean projection of tau, on the entries seen, onto the simplex; it is shared equally.
    (The paper's weights ``|w_k|`` do not add up to one.) With weights per column the columns of
    a matrix decouple into this form, and the error is zero as soon as every entry was hit.
    Everything else is solved numerically; the gap is recomputed from the realizations and decides
    the status. When the target lies in the hull of the realizations, the solver stops there and
    says so (`Fit.exact`); this happens at a finite N, near twice the dimension of the hull or
    when the rarest entry has been hit, whichever is later.
    SLSE is Lemma 4.5 with the recursion on the fused F: ``F <- (1 - t) F + t E``,
    ``t = clip(<E* - F, E - F> / ||E - F||^2, 0, 1)``. It is at least as good as "uniform" in the
    mean square (independent, unbiased realizations), not for every sample, as the paper has it;
    with the safeguard, for every sample.

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
    wish = alse.wishes(ensemble, name, weights, tol, time_limit, max_iter)
    goal = None if target is None and name == "uniform" else _goal(ensemble, target, name)
    memory.need("the weights", 3 * 8 * ensemble.size)
    if name == "uniform":
        estimate = ensemble.mean()
        error = None if goal is None else numbers.norm(estimate - goal)
        equal = np.full(ensemble.size, 1.0 / ensemble.size)
        return Fit(estimate, equal, error, None, "completed", name, target=goal, ensemble=ensemble)
    assert goal is not None
    if name == "alse":
        return alse.solve(ensemble, goal, wish)
    steps = _core.slse(
        ensemble._core_realizations(),
        ensemble._lines_of(goal),
        name == "slse-safeguarded",
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
    weights: Weights = "simplex",
    tol: float = 1e-9,
    time_limit: float | None = None,
    max_iter: int | None = None,
    estimates: bool = False,
) -> Path:
    """Compute the error after the first k realizations, for each k of a grid.

    Parameters
    ----------
    ensemble : Ensemble
        N realizations.
    sizes : array_like of int, shape (k,)
        Strictly increasing, from 1 to N.
    method, weights, tol, max_iter
        As in `fuse`; `max_iter` holds for every size.
    time_limit : float, optional
        As in `fuse`, for all sizes together: those that come too late keep the weights of the
        last one (dense ensembles: those of a moment's work), with their error and gap, status
        "user_limit". Ctrl-C does the same, status "interrupted".
    target : array_like, shape of a realization
        What the errors are measured against, and what the least-squares methods fit to.
    estimates : bool, default False
        Whether to keep the estimates.

    Returns
    -------
    Path
        Errors, statuses and gaps; the estimates if asked for.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    SolverError
        If the solver refuses a problem.

    Notes
    -----
    "uniform", "slse" and the closed form need one pass over the realizations; ALSE for matrices
    is solved for every prefix, from the last solution where that pays; dense ensembles are fused
    prefix by prefix.

    Examples
    --------
    >>> import stochens_rs as se
    >>> A = [[0.9, 0.2], [-0.1, 0.8]]
    >>> path = se.fuse_path(se.sample(A, 1000, rng=1), [10, 100, 1000], "slse", target=A)
    >>> bool(path.errors[0] > path.errors[2])
    True
    """
    name = _checked(ensemble, method)
    wish = alse.wishes(ensemble, name, weights, tol, time_limit, max_iter)
    grid = gate.sizes("sizes", sizes, maximum=ensemble.size)
    goal = _goal(ensemble, target, name)
    estimates = gate.flag("estimates", estimates)
    if estimates:
        memory.need("the estimates of a path", 3 * grid.size * goal.nbytes)
    counts: list[int] = grid.tolist()
    draws, lines = ensemble._draws, ensemble._lines_of(goal)
    gaps: NDArray[np.float64] | None = None
    statuses: tuple[str, ...] = ("completed",) * grid.size
    if name in ("slse", "slse-safeguarded"):
        safeguard = name == "slse-safeguarded"
        _, _, errors, stack = _core.slse(
            ensemble._core_realizations(), lines, safeguard, counts, estimates
        )
    elif name == "uniform" and draws is not None:
        errors, stack = _core.uniform_path(draws, lines, counts, estimates)
    elif name == "alse" and draws is not None:
        errors, gaps, statuses, stack = alse.path(ensemble, draws, goal, wish, counts, estimates)
    else:
        errors, gaps, statuses, stack = _one_by_one(ensemble, goal, name, wish, counts)
    kept = ensemble._stack_from_core(stack) if estimates else None
    return Path(grid, errors, name, statuses, gaps, kept)


def _one_by_one(
    ensemble: Ensemble, goal: NDArray[np.float64], method: str, wish: alse.Wishes, sizes: list[int]
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None, tuple[str, ...], NDArray[np.float64]]:
    """Dense realizations: every prefix by itself, all within one time limit."""
    clock, interrupted = alse.Clock(wish), False
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


def _goal(ensemble: Ensemble, target: ArrayLike | None, method: str) -> NDArray[np.float64]:
    if target is None:
        raise InputError(
            f"`target` is required for method '{method}': the vector or matrix to fit to "
            "(a nominal model or a held-out estimate)"
        )
    goal = gate.array("target", target, ndim=(len(ensemble.shape),))
    if goal.shape != ensemble.shape:
        raise ShapeError(f"`target` must have shape {ensemble.shape}, got {goal.shape}")
    return goal


def _checked(ensemble: object, method: str) -> str:
    if not isinstance(ensemble, Ensemble):
        raise InputTypeError(
            "`ensemble` must be an Ensemble (see `sample`, `Ensemble.from_samples`), "
            f"got {type(ensemble).__name__}"
        )
    return gate.choice("method", method, METHODS)
