"""Weights of given models by measured data: what `fuse` does with ``data=``."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from .. import _core
from .._base import numbers, running, show, validation
from .._base.names import Labels, order_of
from ..ensembles.ensemble import Ensemble
from ..ensembles.systems import SystemEnsemble
from ..exceptions import DataWarning, InputError, InputTypeError, NonFiniteError, ShapeError
from ..identification.identified import Identified
from ..identification.identifying import identify
from ..identification.model import Model
from . import alse
from .fused_model import FusedModel, coordinates, noise_of, position, stacked, units


def fuse_by_data(
    models: object,
    data: object,
    noise: Any,
    shrink: bool,
    independent: bool,
    options: alse.AlseOptions,
) -> FusedModel:
    """Choose the weights by the data and mix; `fuse` says what the arguments are."""
    given = _models(models, data, validation.flag("independent", independent))
    least = _least_squares(given, data, noise)
    given = given._in_order("ensemble", least.labels)
    f = least._blocks[0]
    if f.rank == 0:
        raise InputError("`data` determine nothing: all states and inputs are 0")
    running.need("the models", 4 * 8 * given.size * given.n * (f.rank + len(f.columns)))
    with np.errstate(over="ignore", invalid="ignore"):
        S, t = coordinates(stacked(given, least.intercept), f, units(least))
    if not np.isfinite(S).all() or not np.isfinite(np.vdot(S, S)):
        raise NonFiniteError("the squares of the data and the models overflow: scale them down")
    shrink = validation.flag("shrink", shrink)
    differences = (S - t).reshape(given.size, -1)
    fit = alse.solve(Ensemble.from_samples(differences), np.zeros(differences.shape[1]), options)
    weights, share = fit.weights / fit.weights.sum(), 0.0
    if shrink:
        share = _core.hull_share(position(S, t, weights), noise_of(least))
    assert fit.gap is not None
    fused = FusedModel(given, least, weights, share, fit.gap, fit.status)
    own = [text for text in fused.warnings if text not in least.warnings]
    if own:
        more = len(own) - 1
        said = f"; {show.number_of(more, 'more warning')}: see fused.warnings" if more else ""
        warnings.warn(DataWarning(own[0] + said), stacklevel=3)
    return fused


def _least_squares(given: SystemEnsemble, data: object, noise: Any) -> Model:
    """Least squares of the data, with what was declared; refused where the method needs more."""
    if isinstance(data, Model):
        if noise is not None:
            raise InputError("`noise` must be left out: `data` is a model that has it")
        least = data
    elif isinstance(data, Identified):
        raise InputTypeError(f"`data` must be Trajectories or a Model, got {validation.show(data)}")
    else:
        for one in data if isinstance(data, (list, tuple)) else [data]:
            if getattr(one, "outputs", ()):
                raise InputError(
                    "`data` must have states, got readings: models of states cannot be weighed by "
                    "readings of some of them; pass runs with all states of the models, states="
                )
        least = identify(data, noise=noise, intercept=given.c is not None)  # type: ignore[arg-type]
    least._require_states("data")
    if (least.n, least.m) != (given.n, given.m):
        raise ShapeError(
            f"`data` must have n={given.n} m={given.m} as the models, got n={least.n} m={least.m}"
        )
    if given.c is not None and not least.intercept:
        raise InputError("`data` must be a model with intercept, as the models have offsets")
    validation.same_dt("data", least.dt, given.dt, "the models")
    assumed = least.assumptions
    if least.known is not None:
        raise InputError("`data` must be identified without known entries")
    if assumed.noise != "gaussian":
        raise InputError(f"`data` must be identified with Gaussian noise, got '{assumed.noise}'")
    return least


def _models(models: object, data: object, independent: bool) -> SystemEnsemble:
    """The models, refused where they are known to be made of the data."""
    if isinstance(models, SystemEnsemble):
        given = models
    else:
        items = validation.items("ensemble", models)
        for k, one in enumerate(items):
            if isinstance(one, Identified):
                _apart_from(k, one, data, independent)
        given = _stack(items)
    if given.centre == "estimate" and not independent:
        raise InputError(
            "`ensemble` scatters about an estimate from data: models fitted on the same data look "
            "better than they are, and no region holds; pass independent=True if they are from "
            "other data"
        )
    return given


def _apart_from(k: int, one: Identified, data: object, independent: bool) -> None:
    """Refuse a model that was fitted on some of the data."""
    own = getattr(one, "data", None)
    if own is None:
        if not independent:
            raise InputError(
                f"`ensemble[{k}]` is a model from data that it does not keep: pass "
                "independent=True if they are other data than `data`"
            )
        return
    sets = [data] if not isinstance(data, (list, tuple)) else data
    for other in sets:
        rows = getattr(other, "data", other)
        if hasattr(rows, "_rows") and shared_rows(own, rows):
            raise InputError(
                f"`ensemble[{k}]` was fitted on pairs that are also in `data`: it looks better "
                "than it is, and no region holds; fit it on other runs, see data.split()"
            )


def shared_rows(a: Any, b: Any) -> int:
    """How many different pairs (x, u, x_next) two data sets share, aligned by name."""
    if a._rows.shape[1] != b._rows.shape[1]:
        return 0
    try:
        named = (Labels(one.state_names, one.input_names) for one in (b, a))
        order = order_of("data", *named)
    except InputError:  # of other signals
        return 0
    x, u, x_next = b.pairs()
    mine = np.hstack([order.of_states(x), order.of_inputs(u), order.of_states(x_next)])
    return numbers.shared(a._rows, mine)


def _stack(items: list[Any]) -> SystemEnsemble:
    """One ensemble of systems, pairs (A, B) and models from data."""
    made = SystemEnsemble.from_systems(
        [one.system if isinstance(one, Identified) else one for one in items]
    )
    models = [one if isinstance(one, Identified) else None for one in items]
    if all(one is None or one.c is None for one in models):
        return made
    c = np.zeros((made.size, made.n))
    for k, one in enumerate(models):
        if one is not None and one.c is not None:
            c[k] = order_of(f"systems[{k}]", one.labels, made.labels).of_states(one.c)
    return replace(made, c=c)
