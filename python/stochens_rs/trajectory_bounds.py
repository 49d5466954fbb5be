"""How far the state after several steps can be from the target."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from . import _html
from ._alse import norm
from .exceptions import InputError, NonFiniteError
from .theory import bounds

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ._certificates import Known

    Floats: TypeAlias = NDArray[np.float64]

__all__ = ["TrajectoryBound"]


@dataclass(frozen=True)
class TrajectoryBound:
    """A bound of the distance between the state after the last step and the target.

    Attributes
    ----------
    state : float
        The bound of ``||x(K) - xf||``: the sum of the four parts.
    target : float
        ``||xf_hat - xf||``, or its radius.
    initial : float
        ``||A^K|| ||x0 - x0_hat||``.
    matrix : float
        ``||A - A_hat|| sum_k ||A^{K-1-k}|| ||xh(k)||`` along the predicted states ``xh``.
    residual : float
        ``||xh(K) - xf_hat||``: what the model itself leaves.
    delta : float
        Probability with which the bound may fail; 0 if it holds surely.
    """

    state: float
    target: float
    initial: float
    matrix: float
    residual: float
    delta: float

    def _repr_html_(self) -> str:
        return _html.record(self)


def total_bound(
    predicted: Floats,
    goal: Floats,
    e0: float,
    ef: float,
    eA: float,
    norms: Floats,
    delta: float,
) -> TrajectoryBound:
    """Add up the parts of the bound.

    Along the predicted states, for an estimated target `goal`, the errors of the three estimates
    and ``norms[k] >= ||A^k||``.
    """
    K = len(predicted) - 1
    along = np.array([norm(state) for state in predicted[:K]])
    with np.errstate(over="ignore", invalid="ignore"):
        matrix = eA * float(norms[K - 1 :: -1] @ along) if eA > 0.0 else 0.0
        initial = float(norms[K]) * e0 if e0 > 0.0 else 0.0
        residual = norm(predicted[K] - goal)
        total = ef + initial + matrix + residual
    if not math.isfinite(total):
        raise NonFiniteError("the bound overflows: take fewer steps, or more realizations")
    return TrajectoryBound(total, ef, initial, matrix, residual, delta)


def hat(entity: Known) -> Floats:
    """The estimate, which `control_steps` always keeps."""
    assert entity.estimate is not None
    return entity.estimate


def radius(entity: Known, delta: float) -> float:
    """How far an estimate is from the exact value with probability 1 - delta (A: 2-norm)."""
    if entity.kind == "exact":
        return 0.0
    if entity.error is not None:  # a fit: from its target
        return entity.error
    if entity.values is None or entity.size is None:
        raise InputError(
            f"the law of `{entity.name}` is unknown (realizations brought by the user), so there "
            "is no radius; use error_bound(system, x0, xf) with nominal values"
        )
    if entity.kind == "systematic":
        return bounds.Systematic(entity.values, axis=entity.axis).radius(entity.size, delta)
    if entity.values.ndim == 1:
        return bounds.best("vector", entity.values, size=entity.size, delta=delta).radius
    return bounds.best(
        "matrix", entity.values, size=entity.size, delta=delta, norm="spectral", axis=entity.axis
    ).radius
