"""ALSE behind `fuse` and `fuse_path`: which of the core's ways, and the certificate as a record."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base import gate, memory
from .._base.numbers import norm
from .._base.threads import get_num_threads
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputError
from .fits import Fit, worst

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

WEIGHTS = ("simplex", "subsimplex", "per-column", "per-row")
# an error up to this many rounding units of the target says that the target is in the hull
_ROUNDING = 16.0 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class Wishes:
    """Which weights, how well, and what may be spent on them."""

    weights: str
    tol: float
    time_limit: float | None
    max_iter: int | None

    @property
    def subsimplex(self) -> bool:
        """Whether the weights may add up to less than one."""
        return self.weights == "subsimplex"

    @property
    def per_line(self) -> bool:
        """Whether every column (or row) has weights of its own."""
        return self.weights in ("per-column", "per-row")

    def for_core(self) -> tuple[bool, float, float | None, int | None, int]:
        """As the core takes them."""
        return self.subsimplex, self.tol, self.time_limit, self.max_iter, get_num_threads()

    def status(self, relative_gap: float) -> str:
        """What a gap relative to the squared target says."""
        return "optimal" if relative_gap <= self.tol else "optimal_inaccurate"


class Clock:
    """One time limit for several solutions, counted from the moment it is made."""

    def __init__(self, wish: Wishes) -> None:
        self._wish = wish
        self._start = monotonic()

    def left(self) -> Wishes:
        """Return the wishes with the time that is left (a moment at least: a start costs that)."""
        if self._wish.time_limit is None:
            return self._wish
        left = self._start + self._wish.time_limit - monotonic()
        return replace(self._wish, time_limit=max(left, 1e-9))

    def end(self) -> None:
        """Leave no time for what is still to come: the caller has asked to stop."""
        self._wish = replace(self._wish, time_limit=0.0)


def wishes(
    ensemble: Ensemble,
    method: str,
    weights: str,
    tol: float,
    time_limit: float | None,
    max_iter: int | None,
) -> Wishes:
    """Check what only "alse" takes."""
    kind = gate.choice("weights", weights, WEIGHTS)
    tol = gate.positive("tol", tol)
    seconds = None if time_limit is None else gate.positive("time_limit", time_limit)
    passes = None if max_iter is None else gate.size("max_iter", max_iter)
    if method != "alse":
        if kind != "simplex":
            raise InputError(f"`weights` must be 'simplex' for method '{method}', got '{kind}'")
        for name, value in (("time_limit", seconds), ("max_iter", passes)):
            if value is not None:
                raise InputError(f"`{name}` is for method 'alse', and `method` is '{method}'")
    if kind in ("per-column", "per-row"):
        axis = "columns" if kind == "per-column" else "rows"
        if len(ensemble.shape) == 1:
            raise InputError(
                f"`weights` must be 'simplex' or 'subsimplex' for vectors, got '{kind}': a vector "
                "is one line"
            )
        if ensemble._draws is not None and ensemble.axis != axis:
            raise InputError(
                f"`weights` must be 'per-{ensemble.axis[:-1]}' for realizations sampled by "
                f"{ensemble.axis}, got '{kind}': only the lines that were sampled decouple"
            )
    return Wishes(kind, tol, seconds, passes)


def solve(ensemble: Ensemble, goal: Floats, wish: Wishes) -> Fit:
    """Solve ``min ||sum_s w_s E_s - goal||`` over the weights that were wished for."""
    info: dict[str, Any] = {"weights": wish.weights, "tol": wish.tol}
    draws = ensemble._draws
    if draws is not None and (draws.lines == 1 or wish.per_line):
        return _closed_form(ensemble, draws, goal, wish, info)
    if wish.per_line:
        return _line_by_line(ensemble, goal, wish, info)
    found = _core.alse(ensemble._core_realizations(), ensemble._lines_of(goal), wish.for_core())
    info |= {"solver": found.solver, "iterations": found.iterations}
    return Fit(
        estimate=ensemble._from_core(found.estimate),
        weights=found.weights,
        error=found.error,
        gap=found.gap,
        status=found.status,
        method="alse",
        lower_bound=found.lower_bound,
        exact=found.exact,
        unseen=found.unseen,
        info=info,
        target=goal,
        ensemble=ensemble,
    )


def path(
    ensemble: Ensemble,
    draws: _core.Draws,
    goal: Floats,
    wish: Wishes,
    counts: list[int],
    keep: bool,
) -> tuple[Floats, Floats, tuple[str, ...], Floats]:
    """Errors, gaps, statuses and estimates (as the core lays them out) of growing prefixes."""
    lines = ensemble._lines_of(goal)
    if draws.lines == 1 or wish.per_line:
        errors, gaps, relative, stack = _core.alse_path(draws, lines, wish.subsimplex, counts, keep)
        return errors, gaps, tuple(wish.status(gap) for gap in relative), stack
    errors, gaps, statuses, stack = _core.alse_prefixes(draws, lines, wish.for_core(), counts, keep)
    return errors, gaps, tuple(statuses), stack


def _closed_form(
    ensemble: Ensemble, draws: _core.Draws, goal: Floats, wish: Wishes, info: dict[str, Any]
) -> Fit:
    memory.need("the weights", 2 * 8 * draws.size * draws.lines)
    weights, estimate, error, gap, relative, unseen = _core.closed_form(
        draws, ensemble._lines_of(goal), wish.subsimplex
    )
    return Fit(
        estimate=ensemble._from_core(estimate),
        weights=weights if wish.per_line else weights.ravel(),
        error=error,
        gap=gap,
        status=wish.status(relative),
        method="alse",
        lower_bound=_least_error(error, gap),
        exact=error <= _ROUNDING * norm(goal),
        unseen=unseen,
        info=info | {"solver": "closed form", "iterations": 0},
        target=goal,
        ensemble=ensemble,
    )


def _line_by_line(ensemble: Ensemble, goal: Floats, wish: Wishes, info: dict[str, Any]) -> Fit:
    """Dense realizations: every column (or row) is an ensemble of vectors.

    The squared errors add up, and so do the gaps: the vertices of the weight set are chosen line
    by line.
    """
    axis = 2 if wish.weights == "per-column" else 1
    samples, clock = ensemble.dense(), Clock(replace(wish, weights="simplex"))
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
    within = gap <= wish.tol * norm(goal) * norm(goal) or set(statuses) == {"optimal"}
    within = within and "interrupted" not in statuses  # Ctrl-C must not get lost
    info |= {"solver": [fit.info["solver"] for fit in fits]}
    return Fit(
        estimate=np.stack([fit.estimate for fit in fits], axis=axis - 1),
        weights=np.stack([fit.weights for fit in fits], axis=1),
        error=error,
        gap=gap,
        status="optimal" if within else worst(statuses),
        method="alse",
        lower_bound=norm(np.array([fit.lower_bound for fit in fits])),
        exact=all(fit.exact for fit in fits),
        unseen=sum(fit.unseen or 0 for fit in fits),
        info=info | {"iterations": sum(fit.info["iterations"] for fit in fits)},
        target=goal,
        ensemble=ensemble,
    )


def _least_error(error: float, gap: float) -> float:
    """``sqrt(error^2 - gap)``, 0 where the gap is larger; no square overflows or vanishes."""
    return 0.0 if error == 0.0 else error * sqrt(max(0.0, 1.0 - gap / error / error))
