"""The command with the least mean or the least largest miss, and what it rests on."""

from __future__ import annotations

from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import memory
from .._base.threads import get_num_threads
from .._base.types import Floats, Status
from ..theory.exact import EPS
from .task import REGULAR, root

if TYPE_CHECKING:
    from .fleet_units import Units

TOLERANCE = 1e-7  # of the largest miss, relative
GOOD = 1e-9  # of the mean of the squared misses, relative to J(0) + J(u)
SQUARED = 1e-10  # eigenvalues of H below this share are better had without squares
SAME = 1e-6  # two largest misses are the same up to this, relative; commands up to its root


@dataclass(frozen=True)
class Design:
    """What was found: `value`, `lower_bound` as in `FleetPlan`; `working` was solved for."""

    u: Floats
    value: float
    lower_bound: float
    status: Status
    working: list[int]
    support: tuple[int, ...] = ()


@dataclass(frozen=True)
class Box:
    """Limits of the inputs (K m,), and their weight R in one step, or None."""

    low: Floats
    high: Floats
    R: Floats | None

    def cost(self, d: int) -> Floats:
        """``R`` of all inputs, shape (d, d)."""
        if self.R is None:
            return np.zeros((d, d))
        return np.asarray(np.kron(np.eye(d // len(self.R)), self.R), dtype=np.float64)

    def split(self, d: int) -> tuple[Floats, Floats]:
        """``r`` (d,) and ``F`` (rows, d) with ``R = diag(r) + F'F``, r as large as that allows."""
        if self.R is None:
            return np.zeros(d), np.zeros((0, d))
        K, r = d // len(self.R), np.diag(self.R)
        rest = self.R - np.diag(r)
        if not rest.any():
            return np.tile(r, K), np.zeros((0, d))
        least = max(0.0, float(np.linalg.eigvalsh(self.R)[0]))
        F = root(self.R - least * np.eye(len(r)))
        return np.full(d, least), np.ascontiguousarray(np.kron(np.eye(K), F))

    @property
    def free(self) -> int:
        """The number of inputs that are not fixed."""
        return int(np.count_nonzero(self.low < self.high))


def least_mean(units: Units, box: Box, time_limit: float | None) -> Design:
    """Minimise ``J(u) = mean_s ||G_s u - b_s||_Q^2 + ||u||_R^2``.

    By the moments H and f; where H is ill-conditioned, by an orthogonal triangle of all rows. The
    gap is that of the gradient from the residuals of all units, which also corrects u.
    """
    d, threads = units.inputs, get_num_threads()
    memory.need("the moments of a fleet", 8 * (d + 1) ** 2 * 68)
    H, _, at_zero = _core.fleet_moments(units.arrays, threads)
    R = box.cost(d)
    values, along = np.linalg.eigh(H + R)
    half = np.sqrt(np.maximum(values, 0.0))
    if values[0] <= SQUARED * values[-1]:
        rows = _core.fleet_triangle(units.arrays)[:, :d] / np.sqrt(units.size)
        _, half, V = np.linalg.svd(np.vstack([rows, root(R)]), full_matrices=False)
        along = V.T
    some = half > d * EPS * max(float(half.max()), 1e-300)
    half, along = half[some], along[:, some]
    M = np.ascontiguousarray((along * half).T) if half.size else np.zeros((1, d))
    size = np.linalg.norm(M, axis=0)
    M[:, size <= d * EPS * size.max()] = 0.0  # rounding of inputs that move no unit

    def solve(u: Floats, g: Floats) -> _core.BoxControl:
        """Minimise the quadratic of these factors with half the gradient g at u."""
        y = half * (along.T @ u) - along.T @ g / half if half.size else np.zeros(1)
        return _core.box_control(M, y, np.zeros(d), box.low, box.high, None, time_limit)

    @np.errstate(over="ignore", invalid="ignore")
    def judge(u: Floats) -> tuple[float, float, Floats]:
        """``J(u)``, how far it can be from the least, and half its gradient."""
        square, g = _core.fleet_slope(units.arrays, u, threads)
        g = g + R @ u
        # J(u) - J(v) <= <J'(u), u - v> for all v within the limits
        ends = np.maximum(g * (u - box.low), g * (u - box.high))
        wolfe = 2.0 * float(np.sum(np.where(g == 0.0, 0.0, ends)))
        # and J(u) - min J <= e'H^-1 e, e the part of J'/2 that no limit balances
        e = np.where(((u == box.low) & (g > 0.0)) | ((u == box.high) & (g < 0.0)), 0.0, g)
        inside = along.T @ e
        outside = np.linalg.norm(e - along @ inside)
        largest = float(half.max()) if half.size else 0.0
        rounding = d * EPS * largest * (np.sqrt(at_zero) + largest * np.linalg.norm(u))
        newton = float(np.sum((inside / half) ** 2)) if outside <= rounding else np.inf
        return float(square + u @ R @ u), max(0.0, min(wolfe, newton)), g

    status: Status = "optimal"
    u = np.clip(np.zeros(d), box.low, box.high)
    J, gap, g = judge(u)
    for _ in range(4):
        found = solve(u, g)
        J2, gap2, g2 = judge(found.control)
        status = found.status
        if gap2 < gap or J2 < J:
            u, J, gap, g = found.control, J2, gap2, g2
        else:
            break
        if status in ("user_limit", "interrupted") or gap <= EPS * (at_zero + J):
            break
    if status in ("optimal", "optimal_inaccurate"):
        status = "optimal" if gap <= GOOD * (at_zero + J) else "optimal_inaccurate"
    return Design(u, float(np.sqrt(J)), float(np.sqrt(max(0.0, J - gap))), status, [])


def tiny_weight(units: Units) -> tuple[Floats, int] | None:
    """``R = 1e-8 max_s tr(G_s'Q G_s) / (K m) I``, and the unit whose map is that large.

    None if no input moves a unit. By the largest, not by the mean: then R is that of one unit, and
    the units that carry a command, together with this one, give the same command.
    """
    gains = _core.fleet_gains(units.arrays, get_num_threads())
    widest = int(np.argmax(gains))
    share = REGULAR * float(gains[widest]) / units.inputs
    return (share * np.eye(units.systems.m), widest) if share > 0.0 else None


def least_worst(
    units: Units,
    box: Box,
    skip: list[int],
    start: list[int],
    time_limit: float | None = None,
) -> Design:
    """Minimise ``max_s (||G_s u - b_s||_Q^2 + ||u||_R^2)^(1/2)`` over the units not in `skip`."""
    u, value, lower, working, shares, status, _ = _core.fleet_worst(
        units.arrays,
        box.low,
        box.high,
        box.split(units.inputs),
        skip,
        start,
        TOLERANCE,
        time_limit,
        get_num_threads(),
    )
    carried = sorted(s for s, x in zip(working, shares, strict=True) if x > 1e-6)
    return Design(u, value, lower, status, working, tuple(carried))


def without(
    units: Units, box: Box, count: int, time_limit: float | None
) -> tuple[Design, tuple[int, ...]]:
    """Leave out `count` units, each time the one without which the value falls most.

    Returns the design and the units left out, in their order.
    """
    end = None if time_limit is None else monotonic() + time_limit

    def left() -> float | None:
        return None if end is None else max(1e-3, end - monotonic())

    gone: list[int] = []
    now = least_worst(units, box, [], [], time_limit)
    while len(gone) < count and now.status not in ("user_limit", "interrupted"):
        # the value among those solved for, without one of them: below that of all the others
        others = {i: [s for s in now.working if s != i] for i in now.support}
        values = {
            i: least_worst(units.part(few), box, [], list(range(len(few))), left()).value
            for i, few in others.items()
            if few
        }
        out = min(values, key=lambda i: values[i]) if values else now.working[0]
        gone.append(out)
        now = least_worst(units, box, gone, others.get(out, []), left())
    return now, tuple(gone)


def verified_support(units: Units, box: Box, found: Design, skip: list[int]) -> list[int] | None:
    """Units that alone give the same command and value, none of them dispensable; None if unknown.

    One after another is left out where nothing changes without it, so that of copies one remains.
    """

    def same(few: list[int]) -> bool:
        alone = least_worst(units.part(few), box, [], list(range(len(few))))
        near = np.abs(alone.u - found.u).max() <= np.sqrt(SAME) * np.abs(found.u).max()
        unsure = SAME * found.value + found.value - found.lower_bound
        return bool(near and abs(alone.value - found.value) <= unsure)

    kept = sorted(set(found.working) - set(skip))
    if not same(kept):
        return None
    if found.support and same(list(found.support)):
        kept = list(found.support)
    for s in list(kept):
        rest = [i for i in kept if i != s]
        if rest and same(rest):
            kept = rest
    return kept
