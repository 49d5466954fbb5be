"""The results of fusion: `Fit` for one estimate, `Path` for the errors over the sample size."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from .._base import validation
from .._base.numbers import ROUNDING
from .._base.records import Dense, Line, SavedRecord, require_shapes
from .._base.types import Floats, Status
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputError, NonFiniteError, ShapeError
from ..theory.exact import EPS

if TYPE_CHECKING:
    from numpy.typing import NDArray

_BLOCK = 1 << 20  # entries of dense realizations at a time


@dataclass(frozen=True, eq=False, repr=False)
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

    def __post_init__(self) -> None:
        super().__post_init__()
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
        if len(self.weights) != N:
            raise ShapeError(f"`weights` must have {N} rows, got {len(self.weights)}")
        lines = (N,) if 1 in (self.weights.ndim, len(shape)) else (N, shape[not self._by_rows])
        if self.weights.shape != lines:
            raise ShapeError(f"`weights` must have shape {lines}, got {self.weights.shape}")
        self._check_sum(self.ensemble)

    def _check_sum(self, ensemble: Ensemble) -> None:
        """Refuse an estimate that is not ``sum_s weights[s] E_s``, but for rounding."""
        if self.weights.ndim == 1:
            found = ensemble.combine(self.weights)
        else:
            found, last = np.zeros(self.shape), 0
            product = "sij,si->ij" if self._by_rows else "sij,sj->ij"
            for block in ensemble._dense_blocks(max(1, _BLOCK // self.estimate.size)):
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


@dataclass(frozen=True, eq=False, repr=False)
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

    def __post_init__(self) -> None:
        super().__post_init__()
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


def fit_of(
    ensemble: Ensemble,
    goal: Floats | None,
    method: str,
    weights: Floats,
    estimate: Floats,
    error: float | None,
    gap: float | None = None,
    status: Status = "completed",
    **more: Any,
) -> Fit:
    """The fit of these realizations; its estimate was just computed as the weighted sum."""
    made = Fit(estimate, weights, error, gap, status, method, target=goal, **more)
    made._keep(ensemble=ensemble)  # unchecked: the sum is of these
    return made
