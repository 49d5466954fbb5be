"""Estimates by weights: `Fit`, `Path` over sample sizes, and the solver `Alse` behind `fuse`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import field, replace
from math import isfinite, sqrt
from time import monotonic
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.records import Count, Dense, Line, Options, Positive, SavedRecord, require_shapes
from .._base.running import get_num_threads
from .._base.types import ROUNDING, Floats, NDArray, Status, norm, worst
from ..ensembles.ensemble import Ensemble, blocks_of, core_of, from_core, lines_of
from ..exceptions import InputError, NonFiniteError, ShapeError
from ..theory.exact import EPS

_BLOCK = 1 << 20  # entries of dense realizations at a time


class Fit(SavedRecord):
    """The estimate of one vector or matrix, fused from its realizations.

    Attributes
    ----------
    estimate : ndarray, shape of a realization
        ``sum_s weights[s] E_s``.
    weights : ndarray, shape (N,)
        Nonnegative, with sum 1 (at most 1 for ``weight_set="subsimplex"``). Shape (N, m) for
        ``weight_set="per-column"``: ``weights[:, j]`` are those of column j; (N, n) for "per-row".
    error : float or None
        ``||estimate - target||`` (2-norm; Frobenius for matrices); None without a target.
    gap : float or None
        For ALSE: ``max_v <f', w - v>`` over the weight set, with ``f = ||sum w E - target||^2``,
        computed from the realizations; ``f - min f <= gap``. None for other methods.
    status : {"completed", "optimal", "optimal_inaccurate", "user_limit", "interrupted"}
        How the fusion ended. "completed": the method has nothing to optimise. "optimal": the gap
        is within the tolerance. The others have the best weights found and a larger gap:
        "optimal_inaccurate" if no solver got further, "user_limit" at the limit on time or passes,
        "interrupted" after Ctrl-C.
    method : str
        The fusion method.
    lower_bound : float or None
        For ALSE: no weights of the set give a smaller error. The larger of two bounds: from the
        gap, and from the entries that no realization hits. None for other methods.
    exact : bool
        For ALSE: True if the target lies in the hull of the realizations, so that the error is
        rounding only.
    unseen : int or None
        For ALSE: number of nonzero entries of the target that are zero in every realization. The
        error is at least the norm of these entries. None for other methods.
    info : dict
        For ALSE "solver", "iterations", "weight_set" and "tol"; empty for other methods.
    target : ndarray, shape of a realization, or None
        What the weights were fitted to; for "uniform", what the error is measured against.
    ensemble : Ensemble
        The realizations.
    """

    estimate: Dense
    weights: Dense
    error: float | None
    gap: float | None
    status: Status
    method: Line
    lower_bound: float | None = None
    exact: bool = False
    unseen: int | None = None
    info: dict[str, Any] = field(default_factory=dict)
    target: Floats | None = None
    ensemble: Ensemble | None = None

    def _check(self) -> None:
        if self.target is not None:
            validation.kept("target", self.target, shape=self.estimate.shape)
        for name in ("error", "gap", "lower_bound"):
            _finite(name, getattr(self, name))
        apart = np.abs(self.weights - 1.0 / len(self.weights)).max() if len(self.weights) else 0.0
        if self.method == "uniform" and not apart <= ROUNDING / len(self.weights):
            raise InputError(
                f"`weights` must be 1 / {len(self.weights)} each for method 'uniform', got "
                f"{self.weights.min():.6g} to {self.weights.max():.6g}"
            )
        if self.ensemble is None:
            return
        N, shape = self.ensemble.size, self.ensemble.shape
        if shape != self.shape:
            raise ShapeError(f"`ensemble` must have shape {self.shape}, got {shape}")
        lines = (N,) if 1 in (self.weights.ndim, len(shape)) else (N, shape[not self._by_rows])
        require_shapes(self, weights=lines)
        self._check_sum(self.ensemble)

    def _check_sum(self, ensemble: Ensemble) -> None:
        """Refuse an estimate that is not ``sum_s weights[s] E_s``, but for rounding."""
        if self.weights.ndim == 1:
            found = ensemble.combine(self.weights)
        else:
            found, last = np.zeros(self.shape), 0
            product = "sij,si->ij" if self._by_rows else "sij,sj->ij"
            for block in blocks_of(ensemble, max(1, _BLOCK // self.estimate.size)):
                first, last = last, last + len(block)
                found += np.einsum(product, block, self.weights[first:last])
        if ensemble.atoms is not None:
            largest = np.abs(ensemble.atoms)
        else:
            assert ensemble.samples is not None
            largest = np.maximum(ensemble.samples.max(axis=0), -ensemble.samples.min(axis=0))
        # a sum of N terms, in any order, is rounded by N eps sum |w E| at most, and so are weights
        # that are products of N factors
        total = max(1.0, float(np.abs(self.weights).sum(axis=0).max()))
        slack = (ROUNDING + 4.0 * EPS * ensemble.size) * total
        if not (np.abs(self.estimate - found) <= slack * largest).all():
            off = float(np.abs(self.estimate - found).max())
            raise InputError(
                "`estimate` must be the sum of the realizations of `ensemble` with `weights`, got "
                f"one that differs from it by {off:.3g}"
            )

    @property
    def _by_rows(self) -> bool:
        """Whether weights of lines belong to rows."""
        return self.info.get("weight_set") == "per-row"

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the estimate."""
        return self.estimate.shape

    def __repr__(self) -> str:
        error = "" if self.error is None else f", error {self.error:.3g}"
        gap = "" if self.gap is None else f", gap {self.gap:.1e}"
        return f"<Fit {self.method}: {len(self.weights)} realizations, {self.status}{error}{gap}>"


class Path(SavedRecord):
    """Errors of the fusion of the first k realizations, for several k.

    Attributes
    ----------
    sizes : ndarray of int64, shape (k,)
        The prefix sizes, increasing.
    errors : ndarray, shape (k,)
        ``||estimate - target||`` after the first ``sizes[i]`` realizations.
    method : str
        The fusion method.
    statuses : tuple of str
        One status per size, as in `Fit`.
    gaps : ndarray, shape (k,), or None
        The gap of each ALSE solution; None for other methods.
    estimates : ndarray, shape (k, ...), or None
        The estimates, if ``estimates=True``.
    """

    sizes: Annotated[NDArray[np.int64], "size"]
    errors: Annotated[Floats, "size", "infinite"]
    method: str
    statuses: tuple[Status, ...]
    gaps: Annotated[Floats, "size", "infinite"] | None = None
    estimates: Floats | None = None

    def _check(self) -> None:
        if self.estimates is not None:
            validation.kept("estimates", self.estimates, ndim=(2, 3))
            require_shapes(self, estimates=(len(self.sizes), *self.estimates.shape[1:]))
        _finite("error", float(self.errors.sum()))
        _finite("gap", None if self.gaps is None else float(self.gaps.sum()))

    def __repr__(self) -> str:
        return (
            f"<Path {self.method}: {len(self.sizes)} sizes from {self.sizes[0]} to "
            f"{self.sizes[-1]}, last error {self.errors[-1]:.3g}>"
        )


def _finite(name: str, value: float | None) -> None:
    if value is not None and not isfinite(value):
        raise NonFiniteError(f"the {name} of the fit overflows ({value}): scale the problem down")


def fit_of(ensemble: Ensemble, goal: Floats | None, method: str, *result: Any, **more: Any) -> Fit:
    """The fit of these realizations; `result` is estimate, weights, error, gap and status.

    The estimate was just computed as the weighted sum.
    """
    estimate, weights, error, gap, status = result
    made = Fit(estimate, weights, error, gap, status, method, target=goal, **more)
    made._keep(ensemble=ensemble)  # unchecked: the sum is of these
    return made


WeightSet: TypeAlias = Literal["simplex", "subsimplex", "per-column", "per-row"]
_LINES = {"per-column": "columns", "per-row": "rows"}  # that have weights of their own

# Relative to the norm of the target: with a smaller error, the target is in the hull. One sum of
# the closed form has a rounding error of a few eps; 16 leaves a margin.
_EXACT = 16.0 * float(np.finfo(float).eps)
# Seconds that a solve gets after the time limit: enough to return its starting point.
_LEAST_TIME = 1e-9


class Alse(Options, eq=True):
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
        wanted = f"'simplex' or 'subsimplex' for vectors, got {options.weight_set!r}"
        raise InputError(f"`weight_set` must be {wanted}")
    if ensemble.is_singleton and ensemble.axis != _LINES[options.weight_set]:
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
    of_core, lines = core_of(ensemble), lines_of(ensemble, goal)
    draws = of_core if isinstance(of_core, _core.Draws) else None
    if draws is not None and (draws.lines == 1 or options.weight_set in _LINES):
        # the weights in the core, and their copy in NumPy's
        running.need("the weights", 2 * 8 * draws.size * draws.lines)
        weights, estimate, error, gap, relative, unseen = _core.closed_form(
            draws, lines, options.weight_set == "subsimplex"
        )
        weights = weights if options.weight_set in _LINES else weights.ravel()
        status = _status(relative, options)
        # sqrt(error^2 - gap), 0 where the gap is larger; no square overflows or vanishes
        lower_bound = error and error * sqrt(max(0.0, 1.0 - gap / error / error))
        exact = error <= _EXACT * norm(goal)
        info |= {"solver": "closed form", "iterations": 0}
    elif options.weight_set in _LINES:
        return _line_by_line(ensemble, goal, options, info)
    else:
        found = _core.alse(of_core, lines, _for_core(options))
        weights, estimate, error, gap = found.weights, found.estimate, found.error, found.gap
        status, lower_bound = found.status, found.lower_bound
        exact, unseen = found.exact, found.unseen
        info |= {"solver": found.solver, "iterations": found.iterations}
    more: dict[str, Any] = {"lower_bound": lower_bound, "exact": exact, "unseen": unseen}
    result = from_core(ensemble, estimate), weights, error, gap, status
    return fit_of(ensemble, goal, "alse", *result, info=info, **more)


def path(
    ensemble: Ensemble, goal: Floats, options: Alse, counts: list[int], keep: bool
) -> tuple[Floats, Floats, tuple[Status, ...], Floats]:
    """Return errors, gaps, statuses and estimates (in the layout of the core) of all prefixes."""
    of_core, lines = core_of(ensemble), lines_of(ensemble, goal)
    draws = of_core if isinstance(of_core, _core.Draws) else None
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
        np.stack([fit.estimate for fit in fits], axis=axis - 1),
        np.stack([fit.weights for fit in fits], axis=1),
        norm(np.array([fit.error for fit in fits])),
        gap,
        "optimal" if within else worst(statuses),
        lower_bound=norm(np.array([fit.lower_bound for fit in fits])),
        exact=all(fit.exact for fit in fits),
        unseen=sum(fit.unseen or 0 for fit in fits),
        info=info | {"solver": solvers, "iterations": sum(fit.info["iterations"] for fit in fits)},
    )
