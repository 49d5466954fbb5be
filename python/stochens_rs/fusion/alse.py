"""Accumulated least squares (ALSE), the solver behind `fuse` and `fuse_path`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from time import monotonic
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.numbers import norm
from .._base.running import get_num_threads
from .._base.types import Floats, Status, worst
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputError
from .fits import Fit

WeightSet: TypeAlias = Literal["simplex", "subsimplex", "per-column", "per-row"]
WEIGHT_SETS: tuple[WeightSet, ...] = get_args(WeightSet)

# Relative to the norm of the target: with a smaller error, the target is in the hull. One sum of
# the closed form has a rounding error of a few eps; 16 leaves a margin.
_EXACT = 16.0 * float(np.finfo(float).eps)
# Seconds that a solve gets after the time limit: enough to return its starting point.
_LEAST_TIME = 1e-9


@dataclass(frozen=True)
class AlseOptions:
    """Weight set, tolerance, and limits on time and passes."""

    weight_set: WeightSet
    tol: float
    time_limit: float | None
    max_iter: int | None

    @property
    def subsimplex(self) -> bool:
        """Whether the weights may add up to less than one."""
        return self.weight_set == "subsimplex"

    @property
    def per_line(self) -> bool:
        """Whether every column (or row) has its own weights."""
        return self.weight_set in ("per-column", "per-row")

    def for_core(self) -> tuple[bool, float, float | None, int | None, int]:
        """Return the arguments of the core."""
        return self.subsimplex, self.tol, self.time_limit, self.max_iter, get_num_threads()

    def status(self, relative_gap: float) -> Status:
        """Return the status for a gap relative to the squared norm of the target."""
        return "optimal" if relative_gap <= self.tol else "optimal_inaccurate"


class Clock:
    """One time limit for several solves, counted from the construction."""

    def __init__(self, options: AlseOptions) -> None:
        self._options = options
        self._start = monotonic()

    def left(self) -> AlseOptions:
        """Return the options with the remaining time as their limit."""
        if self._options.time_limit is None:
            return self._options
        left = self._start + self._options.time_limit - monotonic()
        return replace(self._options, time_limit=max(left, _LEAST_TIME))

    def end(self) -> None:
        """Set the remaining time to zero, after Ctrl-C."""
        self._options = replace(self._options, time_limit=0.0)


def checked_options(
    ensemble: Ensemble | None,
    method: str,
    weight_set: WeightSet,
    tol: float,
    time_limit: float | None,
    max_iter: int | None,
) -> AlseOptions:
    """Check the arguments that only "alse" takes; `ensemble` is None for weights by data."""
    kind = validation.choice("weight_set", weight_set, WEIGHT_SETS)
    tol = validation.positive("tol", tol)
    seconds = None if time_limit is None else validation.positive("time_limit", time_limit)
    passes = None if max_iter is None else validation.size("max_iter", max_iter)
    if ensemble is None and kind != "simplex":
        raise InputError(f"`weight_set` must be 'simplex' with `data`, got '{kind}'")
    if ensemble is not None and method != "alse":
        if kind != "simplex":
            raise InputError(f"`weight_set` must be 'simplex' for method '{method}', got '{kind}'")
        for name, value in (("time_limit", seconds), ("max_iter", passes)):
            if value is not None:
                raise InputError(f"`{name}` must be None for method '{method}'")
    if ensemble is not None and kind in ("per-column", "per-row"):
        axis = "columns" if kind == "per-column" else "rows"
        if len(ensemble.shape) == 1:
            raise InputError(
                f"`weight_set` must be 'simplex' or 'subsimplex' for vectors, got '{kind}'"
            )
        if ensemble._draws is not None and ensemble.axis != axis:
            raise InputError(
                f"`weight_set` must be 'per-{ensemble.axis[:-1]}' for realizations sampled by "
                f"{ensemble.axis}, got '{kind}'"
            )
    return AlseOptions(kind, tol, seconds, passes)


def solve(ensemble: Ensemble, goal: Floats, options: AlseOptions) -> Fit:
    """Solve ``min ||sum_s w_s E_s - goal||`` over the weight set."""
    info: dict[str, Any] = {"weight_set": options.weight_set, "tol": options.tol}
    draws = ensemble._draws
    if draws is not None and (draws.lines == 1 or options.per_line):
        return _closed_form(ensemble, draws, goal, options, info)
    if options.per_line:
        return _line_by_line(ensemble, goal, options, info)
    found = _core.alse(ensemble._core_realizations(), ensemble._lines_of(goal), options.for_core())
    info |= {"solver": found.solver, "iterations": found.iterations}
    bounds: dict[str, Any] = {
        "lower_bound": found.lower_bound,
        "exact": found.exact,
        "unseen": found.unseen,
    }
    estimate, ended = ensemble._from_core(found.estimate), (found.error, found.gap, found.status)
    return Fit._of(ensemble, goal, "alse", found.weights, estimate, *ended, **bounds, info=info)


def path(
    ensemble: Ensemble,
    draws: _core.Draws,
    goal: Floats,
    options: AlseOptions,
    counts: list[int],
    keep: bool,
) -> tuple[Floats, Floats, tuple[Status, ...], Floats]:
    """Return errors, gaps, statuses and estimates (in the layout of the core) of all prefixes."""
    lines = ensemble._lines_of(goal)
    if draws.lines == 1 or options.per_line:
        errors, gaps, relative, stack = _core.alse_path(
            draws, lines, options.subsimplex, counts, keep
        )
        return errors, gaps, tuple(options.status(gap) for gap in relative), stack
    errors, gaps, statuses, stack = _core.alse_prefixes(
        draws, lines, options.for_core(), counts, keep
    )
    return errors, gaps, tuple(statuses), stack


def _closed_form(
    ensemble: Ensemble, draws: _core.Draws, goal: Floats, options: AlseOptions, info: dict[str, Any]
) -> Fit:
    # the weights in the core, and their copy in NumPy's
    running.need("the weights", 2 * 8 * draws.size * draws.lines)
    weights, estimate, error, gap, relative, unseen = _core.closed_form(
        draws, ensemble._lines_of(goal), options.subsimplex
    )
    return Fit._of(
        ensemble,
        goal,
        "alse",
        weights if options.per_line else weights.ravel(),
        ensemble._from_core(estimate),
        error,
        gap,
        options.status(relative),
        # sqrt(error^2 - gap), 0 where the gap is larger; no square overflows or vanishes
        lower_bound=error and error * sqrt(max(0.0, 1.0 - gap / error / error)),
        exact=error <= _EXACT * norm(goal),
        unseen=unseen,
        info=info | {"solver": "closed form", "iterations": 0},
    )


def _line_by_line(
    ensemble: Ensemble, goal: Floats, options: AlseOptions, info: dict[str, Any]
) -> Fit:
    """Fuse dense realizations column by column (or row by row), each an ensemble of vectors.

    The squared errors and the gaps of the lines add up.
    """
    axis = 2 if options.weight_set == "per-column" else 1
    samples, clock = ensemble.dense(), Clock(replace(options, weight_set="simplex"))
    fits = []
    for own, target in zip(
        np.moveaxis(samples, axis, 0), np.moveaxis(goal, axis - 1, 0), strict=True
    ):
        line = Ensemble.from_samples(own)
        fits.append(solve(line, np.ascontiguousarray(target), clock.left()))
        if fits[-1].status == "interrupted":
            clock.end()
    error = norm(np.array([fit.error for fit in fits]))
    gap = float(sum(fit.gap or 0.0 for fit in fits))
    statuses = [fit.status for fit in fits]
    within = gap <= options.tol * norm(goal) * norm(goal) or set(statuses) == {"optimal"}
    within = within and "interrupted" not in statuses  # the caller must see Ctrl-C
    info |= {"solver": [fit.info["solver"] for fit in fits]}
    return Fit._of(
        ensemble,
        goal,
        "alse",
        np.stack([fit.weights for fit in fits], axis=1),
        np.stack([fit.estimate for fit in fits], axis=axis - 1),
        error,
        gap,
        "optimal" if within else worst(statuses),
        lower_bound=norm(np.array([fit.lower_bound for fit in fits])),
        exact=all(fit.exact for fit in fits),
        unseen=sum(fit.unseen or 0 for fit in fits),
        info=info | {"iterations": sum(fit.info["iterations"] for fit in fits)},
    )
