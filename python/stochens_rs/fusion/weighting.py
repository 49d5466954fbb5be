"""Fusion with weights that are given, or follow from variances."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import numbers, validation
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputError
from .fits import Fit

if TYPE_CHECKING:
    from .._base.types import Floats


def weighted(ensemble: Ensemble, goal: Floats | None, weights: object, variances: object) -> Fit:
    """Average with these weights; `fuse` says what the arguments are."""
    N, info = ensemble.size, dict[str, Any]()
    spread = None
    if variances is not None:
        spread = validation.vector("variances", variances, length=N)
        if spread.min() <= 0.0:
            raise InputError(f"`variances` must be positive, got {spread.min():g}")
        if ensemble.centre == "estimate":
            raise InputError(
                "`variances` must be left out: the realizations scatter about an estimate from "
                "data, so that no error follows"
            )
    method, chosen = "uniform", np.full(N, 1.0 / N)
    if isinstance(weights, str):
        method = validation.choice("weights", weights, ("precision",))
        if spread is None:
            raise InputError("`variances` must be given for weights='precision'")
        # w_s ~ 1 / v_s, the least sum w_s^2 v_s of all weights with sum 1
        chosen = spread.min() / spread
    elif weights is not None:
        method, chosen = "weighted", validation.vector("weights", weights, length=N)
        if chosen.min() < 0.0 or not chosen.any():
            raise InputError("`weights` must be nonnegative and not all 0")
        chosen = chosen / chosen.max()
    chosen = chosen / chosen.sum()
    if spread is not None:
        # rms^2 = sum w_s^2 v_s for independent realizations with the truth as mean
        largest = float(spread.max())
        info["rms"] = float(np.sqrt(np.sum(chosen**2 * (spread / largest)))) * largest**0.5
    estimate = ensemble.combine(chosen)
    error = None if goal is None else numbers.norm(estimate - goal)
    return Fit(
        estimate=estimate,
        weights=chosen,
        error=error,
        gap=None,
        status="completed",
        method=method,
        info=info,
        target=goal,
    )._of(ensemble)
