"""Accumulated least squares (ALSE), the solver behind `fuse` and `fuse_path`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import sqrt
from time import monotonic
from typing import Any, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import running
from .._base.numbers import norm
from .._base.records import Count, Options, Positive
from .._base.running import get_num_threads
from .._base.types import Floats, Status, worst
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputError
from .fits import Fit, fit_of

WeightSet: TypeAlias = Literal["simplex", "subsimplex", "per-column", "per-row"]
_LINES = {"per-column": "columns", "per-row": "rows"}  # that have weights of their own

# Relative to the norm of the target: with a smaller error, the target is in the hull. One sum of
# the closed form has a rounding error of a few eps; 16 leaves a margin.
_EXACT = 16.0 * float(np.finfo(float).eps)
# Seconds that a solve gets after the time limit: enough to return its starting point.
_LEAST_TIME = 1e-9


@dataclass(frozen=True, repr=False)
class Alse(Options):
    """Accumulated least squares with options, as the `method` of `fuse` and `fuse_path`.

    Attributes
    ----------
    weight_set : {"simplex", "subsimplex", "per-column", "per-row"}, default "simplex"
        "simplex": weights >= 0 with sum 1. "subsimplex": sum <= 1. "per-column": each column of a
        matrix has its own weights on the simplex; "per-row" the same for realizations sampled by
        rows. A fit per column or row can be used with product fusion only, because diagonal fusion
        needs one weight per realization.
    tol : float, default 1e-9
        The fit is "optimal" if its gap is at most ``tol * ||target||^2``. If the target is zero,
        the squared norm of a realization takes its place.
    time_limit : float, optional
        Time after which the best weights so far are returned, with status "user_limit" [s]. Checked
        every few milliseconds. Default: no limit.
    max_iter : int, optional
        The same limit in passes over the realizations (one product with S, one with its
        transpose). Default: 200 000.

    Raises
    ------
    InputError, InputTypeError
        If a value cannot be used.

    Examples
    --------
    >>> import stochens_rs as se
    >>> A, alse = [[0.9, 0.2], [-0.1, 0.8]], se.fusion.Alse("per-column")
    >>> se.fuse(se.sample(A, 100, rng=1), alse, target=A).error < 1e-12
    True
    """

    weight_set: WeightSet = "simplex"
    tol: Positive = 1e-9
    time_limit: Positive | None = None
    max_iter: Count | None = None


def require(options: Alse, ensemble: Ensemble) -> None:
    """Refuse weights per line that do not fit to the realizations."""
    if options.weight_set not in _LINES:
        return
    if len(ensemble.shape) == 1:
        raise InputError(
            "`weight_set` must be 'simplex' or 'subsimplex' for vectors, got "
            f"'{options.weight_set}'"
        )
    if ensemble._draws is not None and ensemble.axis != _LINES[options.weight_set]:
        raise InputError(
            f"`weight_set` must be 'per-{ensemble.axis[:-1]}' for realizations sampled by "
            f"{ensemble.axis}, got '{options.weight_set}'"
        )


def _for_core(options: Alse) -> tuple[bool, float, float | None, int | None, int]:
    """The arguments of the core."""
    subsimplex = options.weight_set == "subsimplex"
    return subsimplex, options.tol, options.time_limit, options.max_iter, get_num_threads()


def solve(ensemble: Ensemble, goal: Floats, options: Alse) -> Fit:
    """Solve ``min ||sum_s w_s E_s - goal||`` over the weight set."""
    info: dict[str, Any] = {"weight_set": options.weight_set, "tol": options.tol}
    draws, lines = ensemble._draws, ensemble._lines_of(goal)
    if draws is not None and (draws.lines == 1 or options.weight_set in _LINES):
        # the weights in the core, and their copy in NumPy's
        running.need("the weights", 2 * 8 * draws.size * draws.lines)
        weights, estimate, error, gap, relative, unseen = _core.closed_form(
            draws, lines, options.weight_set == "subsimplex"
        )
        return fit_of(
            ensemble,
            goal,
            "alse",
            weights if options.weight_set in _LINES else weights.ravel(),
            ensemble._from_core(estimate),
            error,
            gap,
            _status(relative, options),
            # sqrt(error^2 - gap), 0 where the gap is larger; no square overflows or vanishes
            lower_bound=error and error * sqrt(max(0.0, 1.0 - gap / error / error)),
            exact=error <= _EXACT * norm(goal),
            unseen=unseen,
            info=info | {"solver": "closed form", "iterations": 0},
        )
    if options.weight_set in _LINES:
        return _line_by_line(ensemble, goal, options, info)
    found = _core.alse(ensemble._core_realizations(), lines, _for_core(options))
    return fit_of(
        ensemble,
        goal,
        "alse",
        found.weights,
        ensemble._from_core(found.estimate),
        found.error,
        found.gap,
        found.status,
        lower_bound=found.lower_bound,
        exact=found.exact,
        unseen=found.unseen,
        info=info | {"solver": found.solver, "iterations": found.iterations},
    )


def path(
    ensemble: Ensemble, goal: Floats, options: Alse, counts: list[int], keep: bool
) -> tuple[Floats, Floats, tuple[Status, ...], Floats]:
    """Return errors, gaps, statuses and estimates (in the layout of the core) of all prefixes."""
    draws, lines = ensemble._draws, ensemble._lines_of(goal)
    if draws is None:
        fits = _each(((ensemble.prefix(k), goal) for k in counts), options)
        errors, gaps = (np.array([getattr(fit, name) for fit in fits]) for name in ("error", "gap"))
        stack = np.stack([fit.estimate.ravel() for fit in fits])
        return errors, gaps, tuple(fit.status for fit in fits), stack
    if draws.lines == 1 or options.weight_set in _LINES:
        errors, gaps, relative, stack = _core.alse_path(
            draws, lines, options.weight_set == "subsimplex", counts, keep
        )
        return errors, gaps, tuple(_status(gap, options) for gap in relative), stack
    errors, gaps, statuses, stack = _core.alse_prefixes(
        draws, lines, _for_core(options), counts, keep
    )
    return errors, gaps, tuple(statuses), stack


def _status(relative_gap: float, options: Alse) -> Status:
    """The status for a gap relative to the squared norm of the target."""
    return "optimal" if relative_gap <= options.tol else "optimal_inaccurate"


def _each(problems: Iterable[tuple[Ensemble, Floats]], options: Alse) -> list[Fit]:
    """Solve one problem after another within one time limit, and none after Ctrl-C."""
    start, limit, fits = monotonic(), options.time_limit, list[Fit]()
    for ensemble, goal in problems:
        left = None if limit is None else max(start + limit - monotonic(), _LEAST_TIME)
        fit = solve(ensemble, goal, replace(options, time_limit=left))
        if fit.status == "interrupted":
            limit = 0.0
        elif fit.status == "user_limit" and any(one.status == "interrupted" for one in fits):
            fit._keep(status="interrupted")
        fits.append(fit)
    return fits


def _line_by_line(ensemble: Ensemble, goal: Floats, options: Alse, info: dict[str, Any]) -> Fit:
    """Fuse dense realizations column by column (or row by row), each an ensemble of vectors.

    The squared errors and the gaps of the lines add up.
    """
    axis = 2 if options.weight_set == "per-column" else 1
    samples, goals = np.moveaxis(ensemble.dense(), axis, 0), np.moveaxis(goal, axis - 1, 0)
    problems = (
        (Ensemble.from_samples(own), np.ascontiguousarray(target))
        for own, target in zip(samples, goals, strict=True)
    )
    fits = _each(problems, replace(options, weight_set="simplex"))
    gap = float(sum(fit.gap or 0.0 for fit in fits))
    statuses = [fit.status for fit in fits]
    within = gap <= options.tol * norm(goal) * norm(goal) or set(statuses) == {"optimal"}
    within = within and "interrupted" not in statuses  # the caller must see Ctrl-C
    solvers = [fit.info["solver"] for fit in fits]
    return fit_of(
        ensemble,
        goal,
        "alse",
        np.stack([fit.weights for fit in fits], axis=1),
        np.stack([fit.estimate for fit in fits], axis=axis - 1),
        norm(np.array([fit.error for fit in fits])),
        gap,
        "optimal" if within else worst(statuses),
        lower_bound=norm(np.array([fit.lower_bound for fit in fits])),
        exact=all(fit.exact for fit in fits),
        unseen=sum(fit.unseen or 0 for fit in fits),
        info=info | {"solver": solvers, "iterations": sum(fit.info["iterations"] for fit in fits)},
    )
