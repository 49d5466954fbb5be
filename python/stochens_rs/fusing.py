"""Fusing realizations with weights on the simplex: uniform, ALSE, SLSE."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from . import _core, _gate
from ._threads import get_num_threads
from .ensembles import Ensemble
from .exceptions import InputError, InputTypeError, ShapeError
from .results import Fit, Path

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Method: TypeAlias = Literal["uniform", "alse", "slse", "slse-safeguarded"]
Weights: TypeAlias = Literal["simplex", "subsimplex"]

METHODS = ("uniform", "alse", "slse", "slse-safeguarded")
_WEIGHTS = ("simplex", "subsimplex")


def fuse(
    ensemble: Ensemble,
    method: Method = "uniform",
    *,
    target: ArrayLike | None = None,
    weights: Weights = "simplex",
    tol: float = 1e-9,
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
    weights : {"simplex", "subsimplex"}, default "simplex"
        The weights of "alse" are nonnegative and add up to one, or to at most one.
    tol : float, default 1e-9
        "alse" is "optimal" when its gap is at most ``tol * ||target||^2`` (times the squared norm
        of a realization if the target is zero).

    Returns
    -------
    Fit
        Estimate, weights, error, gap and status.

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
    (The paper's weights ``|w_k|`` do not add up to one.) Everything else is solved numerically;
    the gap is recomputed from the realizations and decides the status.
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
    name, subsimplex, tol = _checked(ensemble, method, weights, tol)
    goal = None if target is None and name == "uniform" else _goal(ensemble, target, name)
    _gate.memory("the weights", 3 * 8 * ensemble.size)
    if name == "uniform":
        estimate = ensemble.mean()
        error = None if goal is None else _norm(estimate - goal)
        size = ensemble.size
        return Fit(
            estimate, np.full(size, 1.0 / size), error, None, "completed", name, {}, ensemble
        )
    assert goal is not None
    if name == "alse":
        return _alse(ensemble, goal, subsimplex, tol)
    steps = _core.slse(
        ensemble._core_realizations(),
        ensemble._lines_of(goal),
        name == "slse-safeguarded",
        [ensemble.size],
        False,
    )
    estimate = ensemble._from_core(steps[1])
    return Fit(estimate, steps[0], float(steps[2][0]), None, "completed", name, {}, ensemble)


def fuse_path(
    ensemble: Ensemble,
    sizes: ArrayLike,
    method: Method = "uniform",
    *,
    target: ArrayLike,
    weights: Weights = "simplex",
    tol: float = 1e-9,
    estimates: bool = False,
) -> Path:
    """Compute the error after the first k realizations, for each k of a grid.

    Parameters
    ----------
    ensemble : Ensemble
        N realizations.
    sizes : array_like of int, shape (k,)
        Strictly increasing, from 1 to N.
    method, weights, tol
        As in `fuse`.
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
    name, subsimplex, tol = _checked(ensemble, method, weights, tol)
    grid = _gate.sizes("sizes", sizes, maximum=ensemble.size)
    goal = _goal(ensemble, target, name)
    if estimates:
        _gate.memory("the estimates of a path", 3 * grid.size * goal.nbytes)
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
    elif name == "alse" and draws is not None and draws.lines == 1:
        errors, gaps, relative, stack = _core.alse_path(draws, lines, subsimplex, counts, estimates)
        statuses = tuple("optimal" if g <= tol else "optimal_inaccurate" for g in relative)
    elif name == "alse" and draws is not None:
        errors, gaps, solved, stack = _core.alse_prefixes(
            draws, lines, subsimplex, tol, get_num_threads(), counts, estimates
        )
        statuses = tuple(solved)
    else:
        fits = [
            fuse(ensemble.prefix(k), method, target=goal, weights=weights, tol=tol) for k in counts
        ]
        errors = np.array([fit.error for fit in fits], dtype=np.float64)
        stack = np.stack([fit.estimate.ravel() for fit in fits])
        statuses = tuple(fit.status for fit in fits)
        if name == "alse":
            gaps = np.array([fit.gap for fit in fits], dtype=np.float64)
    kept = ensemble._stack_from_core(stack) if estimates else None
    return Path(grid, errors, name, statuses, gaps, kept)


def _alse(ensemble: Ensemble, goal: NDArray[np.float64], subsimplex: bool, tol: float) -> Fit:
    lines = ensemble._lines_of(goal)
    info: dict[str, Any] = {"weights": "subsimplex" if subsimplex else "simplex", "tol": tol}
    draws = ensemble._draws
    if draws is not None and draws.lines == 1:
        weights, estimate, error, gap, relative = _core.closed_form(draws, lines, subsimplex)
        status = "optimal" if relative <= tol else "optimal_inaccurate"
        info |= {"solver": "closed form", "iterations": 0}
    else:
        weights, estimate, error, gap, status, solver, iterations, exact = _core.alse(
            ensemble._core_realizations(), lines, subsimplex, tol, get_num_threads()
        )
        info |= {"solver": solver, "iterations": iterations, "exact": exact}
    return Fit(ensemble._from_core(estimate), weights, error, gap, status, "alse", info, ensemble)


def _goal(ensemble: Ensemble, target: ArrayLike | None, method: str) -> NDArray[np.float64]:
    if target is None:
        raise InputError(
            f"`target` is required for method '{method}': the vector or matrix to fit to "
            "(a nominal model or a held-out estimate)"
        )
    goal = _gate.array("target", target, ndim=(len(ensemble.shape),))
    if goal.shape != ensemble.shape:
        raise ShapeError(f"`target` must have shape {ensemble.shape}, got {goal.shape}")
    return goal


def _checked(ensemble: object, method: str, weights: str, tol: float) -> tuple[str, bool, float]:
    """Check what `fuse` and `fuse_path` share: the method, whether "subsimplex", the tolerance."""
    if not isinstance(ensemble, Ensemble):
        raise InputTypeError(
            f"`ensemble` must be an Ensemble (see `sample`), got {type(ensemble).__name__}"
        )
    name = _gate.choice("method", method, METHODS)
    subsimplex = _gate.choice("weights", weights, _WEIGHTS) == "subsimplex"
    tol = _gate.positive("tol", tol)
    if subsimplex and name != "alse":
        raise InputError(f"`weights` must be 'simplex' for method '{name}', got 'subsimplex'")
    return name, subsimplex, tol


def _norm(values: NDArray[np.float64]) -> float:
    """2-norm of all entries, scaled so that squares neither overflow nor vanish."""
    largest = float(np.abs(values).max())
    return largest and largest * float(np.linalg.norm((values / largest).ravel()))
