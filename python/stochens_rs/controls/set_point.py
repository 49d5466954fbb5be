"""Set points of models of readings: targets by name, and the nearest point of rest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.names import Labels, weight
from .._base.reading import titled
from .._base.types import DELTA, ArrayLike, Floats
from ..exceptions import InputError, NonFiniteError, ShapeError, StochensError
from ..feedback.bounds import Rest
from ..identification.model import Model
from ..limits.limits import Cost, rows_by_name, steps_ahead

# Of all outputs, or by name; rows of them are one for each step.
Target: TypeAlias = ArrayLike | Mapping[str, ArrayLike]
NEAR = 3.0  # standard deviations of the innovations from which another point of rest is said


def targets(model: Model, target: Any) -> Floats:
    """Rows of outputs, (h, n_outputs): one target, or one for each step; nan where one is free."""
    names = model.outputs
    if target is None:
        return np.zeros((1, len(names)))
    if isinstance(target, Mapping):
        target = {titled(name, names): value for name, value in target.items()}
        unknown = [name for name in target if name not in names]
        if unknown or not target:
            raise InputError(
                f"`target` must name some of the outputs {', '.join(names)}, got "
                f"{unknown or 'none'}"
            )
        found = rows_by_name("target", target)
        rows = np.full((len(found.values), len(names)), np.nan)
        rows[:, [names.index(name) for name in found.names]] = found.values
        return rows
    rows = np.atleast_2d(validation.array("target", target, ndim=(0, 1, 2), finite=False)).copy()
    if rows.shape[1] != len(names):
        raise ShapeError(
            f"`target` must have shape (n_outputs,) = ({len(names)},), or a row for each step, "
            f"got {np.shape(target)}"
        )
    held = ~np.isnan(rows)
    if np.isinf(rows).any() or not held[0].any() or (held != held[0]).any():
        raise InputError(
            "`target` must be finite, or nan for an output that is free, in all steps alike, and "
            f"of one output at least, got {validation.show(target)}"
        )
    return rows


def weights_of(model: Model, cost: Cost) -> Floats | None:
    """The weights of the outputs now, or of their first filters, (p, p), if there are any."""
    p, found = model.n_outputs, cost.Q if cost.Q is not None else cost.Qf
    if found is None:
        return None
    return np.ascontiguousarray(weight("Q", found, model.n)[:p, :p])


def or_zero(values: Floats) -> Floats:
    """0 in place of nan; `np.nan_to_num` takes ten times as long."""
    return np.where(np.isnan(values), 0.0, values)


def moves(rows: Floats, K: int, target: Floats) -> tuple[Floats, Floats]:
    """How far targets of the times 0 .. K are from one, (K + 1, p), and their slopes, (K, p)."""
    way = or_zero(steps_ahead(rows, K + 1) - target)
    return way, np.diff(way, axis=0)


def way_of(rows: Floats, K: int, target: Floats) -> tuple[Floats, Floats, Floats]:
    """The ramp to the end of the targets of the times 0 .. K, and how far they are from it.

    Its distance from `target` at time 0 and its slope, the median of theirs, each (p,), and
    (K + 1, p).
    """
    way, slopes = moves(rows, K, target)
    slope = np.median(slopes, axis=0)
    ramp = way[-1] - np.arange(K, -1, -1)[:, None] * slope
    return ramp[0], slope, way - ramp


def in_window(model: Model, off: Floats, first: Floats) -> Floats:
    """The first p states of a window whose outputs go along `off` (K + 1, p), at times 1 .. K."""
    if (pole := model.regressors.pole) is None:
        return off[1:]
    found = np.vstack([first, off[1:]])
    for k in range(1, len(off)):
        found[k] = pole * found[k - 1] + (1.0 - pole) * off[k]
    return found[1:]


class Aim(NamedTuple):
    """What outputs are to rest at, with which weights and within which limits of the inputs.

    Outputs that are free and integrate stay at `now`. Inputs that are `given` have these values,
    (m,), nan where one is chosen.
    """

    target: Floats
    weights: Floats | None
    limits: tuple[Floats, Floats]
    now: Floats
    given: Floats


def points_of(model: Model) -> _core.SetPoints:
    """The points of rest of a model of outputs."""
    theta = np.ascontiguousarray(model.coefficients)
    return _core.SetPoints(model.regressors.core, theta, model.ranges)


def nearest_point(model: Model, aim: Aim) -> tuple[_core.SetPoints, _core.SetPoint]:
    """Return the points of rest and the nearest to ``y = target``, within the limits of the inputs.

    With the least ``(y - r)'Q(y - r)``, Q the `weights`, without them the squares of 1 / the range
    of each output.
    """
    points, (target, weights, limits, now, given) = points_of(model), aim
    if not points.can_be_held:
        names = ", ".join(model.outputs)
        raise InputError(f"`target` must be left out: no feedback holds {names} in this model")
    if weights is None or not weights.any():
        weights = np.diag(model.ranges[: model.n_outputs] ** -2.0)
    point = points.at(target, weights, now, limits, given)
    if not np.isfinite(point.place).all():
        raise NonFiniteError("`target` is too large: the point of rest overflows")
    return points, point


def set_point(model: Model, aim: Aim) -> _core.SetPoint:
    """Return `nearest_point`; refused where no system that the data allow rests at the target."""
    p, names, target, limits = model.n_outputs, model.outputs, aim.target, aim.limits
    points, point = nearest_point(model, aim)
    y, u = point.place[:p], point.place[p:]
    variances = np.zeros(p) if model.covariance is None else np.diag(model.covariance)[:p]
    off = np.abs(y - target) > NEAR * np.sqrt(variances) + 1e-9 * np.abs(target)
    if not off.any():
        return point
    shown = show.vector(target, names if np.isnan(target).any() else ())
    place = f"the nearest is {show.vector(y)} with the inputs {show.vector(u)}"
    if point.at_limit:
        held = ", ".join(model.input_names[i] for i in point.at_limit)
        place += f", held by the limit of {held}"
    chosen = np.isnan(aim.given)
    m, wanted = int(chosen.sum()), int(np.count_nonzero(~np.isnan(target)))
    if wanted > m:
        place += (
            f"; {show.number_of(m, 'input')} can hold {show.number_of(m, 'output')}: give "
            f"`target` of {'one' if m == 1 else m} of them by name"
        )
    region, impossible = model.region(DELTA), False
    if wanted == p:
        least, size = points.lacking(region.core, target, limits)
        impossible = bool(least > 1e-9 * size)
    elif point.at_limit:
        # without limits the target would be held: do all systems need more than they leave?
        inf = np.full(model.m, np.inf)
        _, free = nearest_point(model, aim._replace(limits=(-inf, inf)))
        spread = free.spread(region.core)
        if spread is not None:
            middle, half = free.place[p:] + spread[0][p:], spread[1][p:]
            beyond = (middle - half > limits[1]) | (middle + half < limits[0])
            impossible = bool((beyond & chosen).any())
            needed = ", ".join(
                f"{name} at {v:.4g} ± {show.at_most(h)}"
                for name, v, h, own in zip(model.input_names, middle, half, chosen, strict=True)
                if own
            )
            place = f"it needs {needed}; {place}"
    if impossible:
        raise InputError(
            f"`target` must be a point of rest, but {shown} is one in no system that the data "
            f"allow ({show.percent(DELTA)}): {place}"
        )
    text = f"`target` {shown} is no point of rest of the model: {place}, and is taken"
    running.warn(text)
    return point


def rest_at(model: Model, point: _core.SetPoint, delta: float = DELTA) -> Rest:
    """Where all systems of a region rest that hold what this set point holds."""
    p, place = model.n_outputs, point.place
    try:
        spread = point.spread(model.region(delta).core)
    except StochensError:
        spread = None
    errors = np.full(len(place), np.inf)
    if spread is not None:
        errors = np.abs(spread[0]) + spread[1]
    labels = Labels(model.outputs, model.input_names)
    exact = tuple(name for name, held in zip(model.outputs, point.exact, strict=True) if held)
    radius = float(np.linalg.norm(errors[:p]))
    return Rest(place[:p], place[p:], errors[:p], errors[p:], radius, delta, labels, exact)
