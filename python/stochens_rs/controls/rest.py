"""Where a model of readings can stay: its points of rest, and the nearest one to a target."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.types import DELTA
from ..exceptions import DataWarning, InputError
from ..identification.window import spread

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification.model import Model


RANK = 1e-10  # of the largest singular value: what is less is rounding
NEAR = 3.0  # standard deviations of the innovations from which another point of rest is said


class Rest(NamedTuple):
    """A rest point of a model of outputs."""

    x: Floats
    u: Floats
    y: Floats
    # what one unit of a constant input adds to the state (n, m), and to the next output (p, m)
    states: Floats
    outputs: Floats


class Still(NamedTuple):
    """A model at rest, ``z = N (y, u, 1)``: all that is constant for one model and its limits."""

    N: Floats  # (d, p + m + 1)
    M: Floats  # (p, p + m), [I - H N_y, -H N_u]
    c: Floats  # (p,), H N_1
    unit: Floats  # (p + m,), of outputs and inputs
    low: Floats
    high: Floats


def rest_of(model: Model, target: Any, weights: Floats | None, low: Floats, high: Floats) -> Rest:
    """Return where the model rests nearest to ``y = target``, within the limits of the inputs.

    Refused where no system that the data allow rests at the target. The points of rest are the
    (y, u) with ``M (y, u) = c``, of dimension m where a gain stabilizes the model, whether it
    integrates or not; the nearest has the least ``(y - r)'Q(y - r)``, Q the `weights`, without them
    the squares of 1 / the range of each output. Least squares in u alone go astray for two outputs
    and one input: what u cannot move it leaves where it is asked for.
    """
    p, names = model.n_outputs, model.outputs
    r = np.zeros(p)
    if target is not None:
        r = validation.vector("target", target, length=p, labels=names).copy()
    still = _still(model, low, high)
    Q = np.diag(still.unit[:p] ** -2.0) if weights is None or not weights.any() else weights
    v, held = _nearest(still, r, Q)
    y, u = v[:p], v[p:]
    sd = np.sqrt(np.diag(_covariance(model)))
    if (np.abs(y - r) > NEAR * sd + 1e-9 * np.abs(r)).any():
        place = f"the nearest is {show.vector(y)} with the inputs {show.vector(u)}"
        if held:
            place += f", held by the limit of {', '.join(model.input_names[i] for i in held)}"
        if _none_rests(model, still, r):
            raise InputError(
                f"`target` must be a point of rest, but {show.vector(r)} is one in no system that "
                f"the data allow ({show.percent(DELTA)}): {place}"
            )
        said = f"`target` {show.vector(r)} is no point of rest of the model: {place}, and is taken"
        warnings.warn(DataWarning(said), stacklevel=4)
    return _at(model, y, u)


def _at(model: Model, y: Floats, u: Floats) -> Rest:
    assert model.window is not None
    x, _, _, states, outputs, _, _ = model.window.core.rest(
        model._H, np.ascontiguousarray(y), np.ascontiguousarray(u)
    )
    return Rest(x, u, y, states, outputs)


def _covariance(model: Model) -> Floats:
    found = model.covariance
    p = model.n_outputs
    return np.zeros((p, p)) if found is None else found[:p, :p]


def _still(model: Model, low: Floats, high: Floats) -> Still:
    window, p, m = model.window, model.n_outputs, model.m
    assert window is not None
    N = np.column_stack([spread(window, unit) for unit in np.eye(p + m + 1)])
    N = N[: window.length]
    HN = model._H @ N
    y, u, _ = model.data.pairs()
    ranges = np.hstack([np.ptp(y, axis=0), np.ptp(u, axis=0)])
    unit = np.where(ranges > 0.0, ranges, 1.0)
    M = np.hstack([np.eye(p) - HN[:, :p], -HN[:, p : p + m]])
    sizes = np.linalg.svd(M * unit / np.abs(M * unit).max(axis=1, keepdims=True), compute_uv=False)
    if not sizes[-1] > RANK * sizes[0]:
        outputs = ", ".join(model.outputs)
        raise InputError(f"`target` must be left out: no feedback holds {outputs} in this model")
    c = HN[:, p + m] if model.intercept else np.zeros(p)
    return Still(N, M, c, unit, low, high)


def _nearest(still: Still, r: Floats, Q: Floats) -> tuple[Floats, list[int]]:
    """The nearest (y, u), and the inputs that are held by their limits (an active set of rows)."""
    p, unit = len(r), still.unit
    low, high = still.low / unit[p:], still.high / unit[p:]
    root = _core.weight_root(np.ascontiguousarray(Q * np.outer(unit[:p], unit[:p])))
    active: dict[int, float] = {}
    v = np.zeros(len(unit))
    for _ in range(4 * len(low) + 4):
        rows = np.vstack([still.M * unit, *(np.eye(len(unit))[p + i] for i in active)])
        start = np.linalg.lstsq(rows, np.hstack([still.c, *active.values()]), rcond=None)[0]
        T = np.linalg.svd(rows)[2][len(rows) :].T
        # the shortest of all that are nearest
        v = (
            start
            + T @ np.linalg.lstsq(root @ T[:p], root @ (r / unit[:p] - start[:p]), rcond=None)[0]
        )
        u = v[p:]
        over = np.maximum(low - u, u - high)
        over[list(active)] = -np.inf
        if over.max() > RANK * (1.0 + np.abs(u).max()):
            i = int(np.argmax(over))
            active[i] = float(low[i] if u[i] < low[i] else high[i])
            continue
        # the slope of the distance along each active row: it must rise away from its limit
        slope = np.hstack([root.T @ (root @ (v[:p] - r / unit[:p])), np.zeros(len(low))])
        along = np.linalg.lstsq(rows.T, slope, rcond=None)[0][p:]
        wrong = [
            i
            for i, s in zip(active, along, strict=True)
            if low[i] < high[i] and (s < -RANK if active[i] == low[i] else s > RANK)
        ]
        if not wrong:
            break
        del active[wrong[0]]
    v = v * unit
    v[p:] = np.clip(v[p:], still.low, still.high)
    return v, sorted(active)


def _none_rests(model: Model, still: Still, r: Floats) -> bool:
    """Whether no system of the region rests at the outputs r, with any inputs within the limits."""
    region, m = model.region(DELTA), model.m
    z = still.N[:, :-1] @ np.hstack([r, np.zeros(m)]) + still.N[:, -1] * float(model.intercept)
    per = still.N[:, len(r) : -1]
    unit = still.unit[len(r) :]
    sides = still.low / unit, still.high / unit
    for part in region.parts:
        rows = np.asarray(part.rows)
        lacking = region.centre[rows] @ z - r[rows], region.centre[rows] @ per * unit
        least, size = least_of(part, lacking, (z, per * unit), sides)
        if least > 1e-9 * size:
            return True
    return False


def least_of(
    part: _core.RegionPart,
    lacking: tuple[Floats, Floats],
    at_rest: tuple[Floats, Floats],
    sides: tuple[Floats, Floats],
) -> tuple[float, float]:
    """The least f(u) within limits, and the size of its terms; -inf where it is not known.

    With ``z = z_0 + z_1 u`` and ``C z - r = l_0 + l_1 u`` the equation ``(Theta - C) z = r - C z``
    has a solution ``Theta = C + D G W``, ``||G|| <= 1``, exactly where ``f(u) = |D^-1 (l_0 + l_1
    u)|^2 - |W (z_0 + z_1 u)|^2 <= 0``; where f is convex its least value is that of a box.
    """
    D = np.asarray(part.S) * part.factor
    if not np.isfinite(D).all() or np.asarray(part.missing).size:
        return -np.inf, 1.0
    columns, W, root = part.columns, np.asarray(part.white), np.linalg.cholesky(D)
    (a, b), (c, d) = (
        (np.linalg.solve(root, one) for one in lacking),
        (W @ one[columns] for one in at_rest),
    )
    curve, slope = b.T @ b - d.T @ d, b.T @ a - d.T @ c
    if not np.linalg.eigvalsh(curve)[0] > RANK * np.trace(b.T @ b):
        return -np.inf, 1.0  # the data do not determine what constant inputs do
    half = np.linalg.cholesky(curve).T
    y, none = -np.linalg.solve(half.T, slope), np.zeros(len(slope))
    u = _core.box_control(np.ascontiguousarray(half), y, none, *sides, None, None).control
    return float(u @ curve @ u + 2.0 * slope @ u + a @ a - c @ c), float(a @ a + c @ c)
