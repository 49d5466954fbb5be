"""What fusion returns: frozen records, each field with its shape and meaning.

A ``status`` says how a computation ended; wrong input raises instead. "completed": a method with
nothing to optimise ran through. "optimal": the recomputed gap is within the tolerance. The others
come with feasible weights, the best found, and a larger gap, which is reported:
"optimal_inaccurate": no solver got further; "user_limit": the time or the passes granted ran out;
"interrupted": Ctrl-C.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import gate, html
from .._base.records import by_constructor
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputTypeError, NonFiniteError, ShapeError

if TYPE_CHECKING:
    from numpy.typing import NDArray

# How a computation ended, the most reassuring first.
STATUSES = ("completed", "optimal", "optimal_inaccurate", "user_limit", "interrupted")


@dataclass(frozen=True, eq=False, repr=False)
class Fit:
    """Fused realizations of one vector or matrix.

    Attributes
    ----------
    estimate : ndarray, shape of a realization
        ``sum_s weights[s] E_s``.
    weights : ndarray, shape (N,)
        Nonnegative; their sum is 1 (at most 1 for ``weights="subsimplex"``). Shape (N, m) for
        ``weights="per-column"``: ``weights[:, j]`` belongs to column j; (N, n) for "per-row".
    error : float or None
        ``||estimate - target||`` (2-norm; Frobenius for matrices); None without a target.
    gap : float or None
        For ALSE: ``max_v <f', w - v>`` over the weight set, ``f = ||sum w E - target||^2``,
        recomputed from the realizations; ``f - min f <= gap``. None for other methods.
    status : str
        "completed", "optimal", "optimal_inaccurate", "user_limit" or "interrupted".
    method : str
        The method asked for.
    lower_bound : float or None
        For ALSE: no weights of the set have an error below this one; from the gap, or from the
        entries that no realization hits, whichever says more. None for other methods.
    exact : bool
        For ALSE: the target lies in the hull of the realizations; what is left of the error is
        rounding.
    unseen : int or None
        For ALSE: entries of the target that are not zero while they are in every realization. No
        weights reach them: the error is at least their norm. None for other methods.
    info : dict
        For ALSE "solver", "iterations" and the settings; empty for other methods.
    target : ndarray, shape of a realization, or None
        What was fitted to, or what the error of a uniform average is measured against.
    ensemble : Ensemble
        The realizations.
    """

    estimate: NDArray[np.float64]
    weights: NDArray[np.float64]
    error: float | None
    gap: float | None
    status: str
    method: str
    lower_bound: float | None = None
    exact: bool = False
    unseen: int | None = None
    info: dict[str, Any] = field(default_factory=dict)
    target: NDArray[np.float64] | None = None
    ensemble: Ensemble | None = None

    def __post_init__(self) -> None:
        gate.kept("estimate", self.estimate)
        gate.kept("weights", self.weights)
        if self.target is not None:
            gate.kept("target", self.target, shape=self.estimate.shape)
        for name in ("error", "gap", "lower_bound"):
            value = getattr(self, name)
            if value is not None:
                finite(name, value)
        gate.choice("status", self.status, STATUSES)
        gate.text("method", self.method)
        gate.flag("exact", self.exact)
        if self.ensemble is None:
            return
        N, shape = gate.instance("ensemble", self.ensemble, Ensemble).size, self.ensemble.shape
        if shape != self.shape:
            raise ShapeError(f"`ensemble` must have shape {self.shape}, got {shape}")
        if len(self.weights) != N:
            raise ShapeError(f"`weights` must have {N} rows, got {len(self.weights)}")

    def __reduce__(self) -> tuple[Any, ...]:
        return by_constructor(self)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the estimate."""
        return self.estimate.shape

    def _repr_html_(self) -> str:
        rows = [
            ("realizations N", html.grouped(len(self.weights))),
            ("shape", html.shape(self.shape)),
            ("distance to the target", self.error),
            ("no weights come nearer than", self.lower_bound),
            ("gap of the squared distance", self.gap),
            ("entries never seen", self.unseen or None),
        ]
        return html.card(self, rows)

    def __repr__(self) -> str:
        error = "" if self.error is None else f", error {self.error:.3g}"
        gap = "" if self.gap is None else f", gap {self.gap:.1e}"
        return f"<Fit {self.method}: {len(self.weights)} realizations, {self.status}{error}{gap}>"


@dataclass(frozen=True, eq=False, repr=False)
class Path:
    """A fusion after the first k realizations, for a grid of k.

    Attributes
    ----------
    sizes : ndarray of int64, shape (k,)
        The prefix sizes, increasing.
    errors : ndarray, shape (k,)
        ``||estimate - target||`` after the first ``sizes[i]`` realizations.
    method : str
        The method asked for.
    statuses : tuple of str
        One status per size.
    gaps : ndarray, shape (k,), or None
        The gap of each ALSE solution; None for other methods.
    estimates : ndarray, shape (k, ...), or None
        The estimates, if they were asked for.
    """

    sizes: NDArray[np.int64]
    errors: NDArray[np.float64]
    method: str
    statuses: tuple[str, ...]
    gaps: NDArray[np.float64] | None = None
    estimates: NDArray[np.float64] | None = None

    def _repr_html_(self) -> str:
        first, last = (html.grouped(int(self.sizes[k])) for k in (0, -1))
        rows = [
            ("realizations N", f"{first} to {last}, {len(self.sizes)} sizes"),
            ("error", f"{self.errors[0]:.4g} at the first, {self.errors[-1]:.4g} at the last"),
        ]
        about = "error over N, both logarithmic"
        return html.card(self, rows, html.lines(self.sizes, [self.errors], about, log=True))

    def __post_init__(self) -> None:
        for name in ("errors", "gaps"):
            values = getattr(self, name)
            if values is not None:
                finite(name[:-1], float(values[int(np.argmin(np.isfinite(values)))]))

    def __repr__(self) -> str:
        return (
            f"<Path {self.method}: {len(self.sizes)} sizes from {self.sizes[0]} to "
            f"{self.sizes[-1]}, last error {self.errors[-1]:.3g}>"
        )


def worst(statuses: list[str]) -> str:
    """Pick the least reassuring of some statuses."""
    return max(statuses, key=STATUSES.index)


def finite(name: str, value: object) -> None:
    """Refuse a figure of a fit that is no number, or too large for one."""
    if not gate.is_real(value):
        raise InputTypeError(f"`{name}` must be a real number, got {gate.show(value)}")
    if not isfinite(value):
        raise NonFiniteError(f"the {name} of the fit overflows ({value}): scale the problem down")
