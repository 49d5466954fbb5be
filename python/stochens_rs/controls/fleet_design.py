"""The command with the least mean or the least largest miss, and what it rests on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import monotonic
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import memory
from .._base.threads import get_num_threads
from .._base.types import Floats, Status
from .constraints import REGULAR

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .fleet_units import Units

TOLERANCE = 1e-7  # of the largest miss, relative
FLOOR = 1e-9  # of the largest miss at the start: values closer than this are the same
NEAR, SQUARES = 1e-6, 1e-9  # "optimal": gap, or that of the squares relative to J(0) + J(u)

STOPPED = ("user_limit", "interrupted")


@dataclass(frozen=True)
class Design:
    """What was found: `value`, `lower_bound`, `support` as in `FleetPlan`; `working` was solved."""

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

    def split(self, d: int) -> tuple[Floats, Floats]:
        """``r`` (d,) and ``F`` (rows, d) with ``R = diag(r) + F'F``, r as large as that allows."""
        if self.R is None:
            return np.zeros(d), np.zeros((0, d))
        K, r = d // len(self.R), np.diag(self.R)
        rest = self.R - np.diag(r)
        if not rest.any():
            return np.tile(r, K), np.zeros((0, d))
        least = max(0.0, float(np.linalg.eigvalsh(self.R)[0]))
        F = _core.weight_root(self.R - least * np.eye(len(r)))
        return np.full(d, least), np.ascontiguousarray(np.kron(np.eye(K), F))


def least_mean(units: Units, box: Box, time_limit: float | None) -> Design:
    """Minimise ``J(u) = mean_s ||G_s u - b_s||_Q^2 + ||u||_R^2``."""
    memory.need("the moments of a fleet", 8 * (units.inputs + 1) ** 2 * 68)
    u, value, lower, status = _core.fleet_mean(
        units.arrays, box.low, box.high, box.R, time_limit, get_num_threads()
    )
    return Design(u, value, lower, status, [])


def tiny_weight(units: Units, skip: Sequence[int] = ()) -> tuple[Floats, int] | None:
    """``R = 1e-8 max_s tr(G_s'Q G_s) / (K m) I``, and the unit whose map is that large.

    None if no input moves a unit. By the largest, not by the mean: then R is that of one unit.
    """
    gains = _core.fleet_gains(units.arrays, get_num_threads())
    gains[list(skip)] = 0.0
    widest = int(np.argmax(gains))
    share = REGULAR * float(gains[widest]) / units.inputs
    return (share * np.eye(units.systems.m), widest) if share > 0.0 else None


def weighed(units: Units, box: Box, tiny: bool, skip: Sequence[int] = ()) -> tuple[Box, int | None]:
    """`box`, if `tiny` with the tiny weight of the units not in `skip`, and the unit it is of."""
    found = tiny_weight(units, skip) if tiny else None
    return (box, None) if found is None else (replace(box, R=found[0]), found[1])


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


@dataclass(frozen=True)
class Worst:
    """A command with the least largest miss: `removed`, `widest` as in `FleetPlan`."""

    design: Design
    box: Box
    removed: tuple[int, ...]
    widest: int | None


def worst_of_few(
    units: Units, box: Box, tiny: bool, discard: int, time_limit: float | None
) -> Worst:
    """Leave out `discard` units and find the command, solved for a few units alone.

    The units left out go one by one, each time the one without which the value falls most.
    """
    began = monotonic()

    def left() -> float | None:
        return None if time_limit is None else max(1e-3, began + time_limit - monotonic())

    gone: list[int] = []
    own, widest = weighed(units, box, tiny)
    now = least_worst(units, own, [], [], time_limit)
    while len(gone) < discard and now.status not in STOPPED:
        # the value among those solved for, without one of them: below that of all the others
        others = {i: [s for s in now.working if s != i] for i in now.support}
        values = {
            i: least_worst(units.part(few), own, [], list(range(len(few))), left()).value
            for i, few in others.items()
            if few
        }
        out = min(values, key=lambda i: values[i]) if values else now.working[0]
        gone.append(out)
        if out == widest:
            own, widest = weighed(units, box, tiny, gone)
        now = least_worst(units, own, gone, others.get(out, []), left())
    # what a stop cut short may take as long again
    budget = monotonic() - began if now.status in STOPPED else None
    few = of_few(units, own, tiny, widest, now, gone, budget)
    return Worst(few, own, tuple(gone), widest)


def of_few(
    units: Units,
    box: Box,
    tiny: bool,
    widest: int | None,
    found: Design,
    gone: list[int],
    budget: float | None,
) -> Design:
    """Solve again for the few units that carry `found`: a function of these and of nothing else.

    They are taken in the order of the fleet, from one start, with the R of these units, so that
    `certify` can count them. The units are chosen freely: first those with multipliers, then all
    that the last problem was solved for. Where a stop leaves no command, `found` is that of all.
    """
    kept = np.delete(np.arange(units.size), gone)

    def largest(u: Floats, R: Floats | None) -> float:
        beside = (
            0.0 if R is None else float(np.sum(u.reshape(-1, len(R)) @ R * u.reshape(-1, len(R))))
        )
        return float(_core.fleet_misses(units.arrays, u, beside, get_num_threads())[kept].max())

    start = np.clip(np.zeros(units.inputs), box.low, box.high)
    if np.array_equal(found.u, start):
        return replace(found, support=())  # the command of no unit
    at_start, status = largest(start, box.R), found.status
    best: Design | None = None
    for some in (found.support, found.working):
        few = distinct(units, sorted({*some, *(() if widest is None else (widest,))}))
        part = units.part(few)
        alone = least_worst(part, weighed(part, box, tiny)[0], [], list(range(len(few))), budget)
        if alone.status in STOPPED:
            status = alone.status
            break
        value = largest(alone.u, box.R)
        if best is None or value < best.value:
            best = replace(found, u=alone.u, value=value, support=tuple(few))
        if value <= found.value + TOLERANCE * found.value + FLOOR * at_start:
            break
    if best is None:
        return replace(found, status=status, support=tuple(int(s) for s in kept))
    if best.value >= at_start:
        best = replace(found, u=start, value=at_start, support=())
    lower = min(found.lower_bound, best.value)
    gap, squares = best.value - lower, best.value**2 - lower**2
    if status not in STOPPED:
        near = gap <= NEAR * at_start or squares <= SQUARES * (at_start**2 + best.value**2)
        status = "optimal" if near else "optimal_inaccurate"
    return replace(best, lower_bound=lower, status=status)


def distinct(units: Units, chosen: list[int]) -> list[int]:
    """The first of each group of equal units."""
    rows = units.part(chosen).rows()
    return [chosen[i] for i in sorted(np.unique(rows, axis=0, return_index=True)[1])]
