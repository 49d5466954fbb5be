"""The clock of a log: its step, and what is wrong with its stamps, each in its own words."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._base import validation
from .._base.seconds import LATEST
from ..exceptions import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .tables import Run

NEAR = 0.25  # of a step: how far a stamp may be off if `dt` is declared
CLOSE = 0.05  # the same if it is not
IRREGULAR = 0.1  # share of stamps further off from which on a log has no sampling time
ROUNDED = 0.02  # share of equal stamps from which on they are rounded, and no row is there twice
_UNITS = {"ms": 1e3, "us": 1e6, "ns": 1e9, "min": 1 / 60, "h": 1 / 3600}
FEW = 0.1  # share of steps backwards up to which most others are one step of the clock
ENOUGH = 10  # rows of which it is said that their steps alternate
ALTERNATING = 0.8  # share of steps as long as the last but one, where those between are not


class Stamps(NamedTuple):
    """The time between two rows [s], and by what part of it a stamp may be off."""

    dt: float | None
    tolerance: float


def checked_stamps(runs: Sequence[Run], dt: object, tolerance: object) -> Stamps:
    """The time between two rows, and how far a stamp may be off.

    If it is not declared: the mean of ``step / round(step / median)`` over the steps that are near
    a multiple of their median; the median alone is wrong where stamps are rounded.
    """
    declared = None if dt is None else validation.positive("dt", dt)
    slack = CLOSE if declared is None else NEAR
    if tolerance is not None:
        slack = validation.positive("tolerance", tolerance, maximum=0.5)
    for run in runs:
        _refuse_disorder(run)
        _refuse_alternating(run)
        if run.times is not None and run.times.min() > LATEST:
            raise InputError(
                f"`time` must be in seconds, but {run.name} begins at {run.times[0]:.6g}: if that "
                "is in another unit, write it behind the name of the column, as t [ns]"
            )
    steps = [np.diff(run.times) for run in runs if run.times is not None and len(run.times) > 1]
    if declared is None and steps:
        known = np.concatenate(steps)
        parts = known / np.median(known)
        near = (np.abs(parts - np.round(parts)) <= NEAR) & (np.round(parts) >= 1.0)
        if not near.any():
            raise InputError(
                f"`time` must have equal steps, got {len(known)} of {known.min():.6g} to "
                f"{known.max():.6g} s: declare `dt`"
            )
        found = float(np.mean(known[near] / np.round(parts[near])))
        declared = float(f"{found:.12g}")  # 0.1, where stamps are 0, 0.1, 0.2, 0.30000000000000004
    _refuse_irregular(runs, declared, slack, dt is None)
    return Stamps(declared, slack)


def _refuse_disorder(run: Run) -> None:
    """Refuse times that do not increase, and say why they may not."""
    times = run.times
    if times is None:
        return
    with np.errstate(over="ignore"):
        steps = np.diff(times)
    if np.isinf(steps).any():
        raise InputError(f"`time` must have finite steps, got {steps.max():g} {run.where(0)}")
    if (steps > 0.0).all():
        return
    k, same = int(np.argmax(steps <= 0.0)) + 1, int((steps == 0.0).sum())
    rows = f"{run.rows_of(k - 1, k)}, at {times[k]:.6g} s"
    if (steps < 0.0).any():
        k = int(np.argmin(steps >= 0.0)) + 1
        # two clocks in one log crowd: sorted, some of their rows are at most half a step apart
        ordered, few = np.diff(np.sort(times)), (steps < 0.0).mean() < FEW
        mixed = ordered.min() > 0.5 * float(np.median(steps[steps > 0.0] if few else ordered))
        begins = " or another run begins" if run.label is None else ""
        why = f"goes back by {-steps[k - 1]:.6g} s behind {run.rows_of(k - 1)}: " + (
            "its rows are out of order, sort them by time"
            if mixed
            else f"the clock was set back{begins}: cut the log there"
            + (", or give `by` for its runs" if begins else "")
            + "; sorted, rows of two times would be mixed"
        )
    elif same > max(1, ROUNDED * len(steps)):
        why = (
            f"{same} of {len(steps)} stamps equal the one before, the first in {rows}: they are "
            "rounded; write them with all digits, or, if no row is lost, leave `time` out and "
            "declare `dt`"
        )
    else:
        why = (
            f"one stamp is there twice, in {rows}: delete the row that is a copy; if none is, "
            "leave `time` out and declare `dt`"
        )
    raise InputError(f"`time` must increase within a run, but {why}")


def _refuse_alternating(run: Run) -> None:
    """Refuse steps that alternate, as where the rows of two logs are merged.

    Steps of one and two, say, are what a lost row leaves, unless every second row repeats a column.
    """
    if run.times is None or len(run.times) < ENOUGH:
        return
    steps = np.diff(run.times)
    pair = np.sort([np.median(steps[::2]), np.median(steps[1::2])])
    middle = float(pair[0] / 2 + pair[1] / 2)
    same = np.abs(steps[2:] - steps[:-2]) <= CLOSE * middle
    if pair[1] - pair[0] <= 2 * NEAR * middle or same.mean() < ALTERNATING:
        return
    ratio = pair[1] / pair[0]
    columns = np.hstack([run.x, run.u])
    repeats = columns[1:] == columns[:-1]
    filled = np.abs(repeats[::2].mean(axis=0) - repeats[1::2].mean(axis=0)) >= ALTERNATING
    if abs(ratio - np.round(ratio)) > CLOSE * ratio or filled.any():
        raise InputError(
            f"`time` has steps that alternate in {run.name}, {pair[0]:.6g} and {pair[1]:.6g} s: "
            "the rows of two logs, merged? Bring them to one clock first, as pandas.merge_asof does"
        )


def _refuse_irregular(runs: Sequence[Run], dt: float | None, tolerance: float, found: bool) -> None:
    """Refuse a run whose rows are not mostly one step apart, and stamps that are too far off."""
    off = steps = 0
    worst, example = 0.0, ""
    for run in runs:
        if run.times is None or dt is None or len(run.times) < 2:
            continue
        own = np.diff(run.times)
        with np.errstate(over="ignore", invalid="ignore"):
            q = own / dt
            away = np.abs(q - np.maximum(np.round(q), 1.0))
        if 2 * int((np.round(q) == 1.0).sum()) < len(q):
            median = float(np.median(own))
            unit = next((unit for unit, k in _UNITS.items() if abs(median / dt - k) < 0.1 * k), "")
            raise InputError(
                f"`time` must have steps of {dt:.6g} s in every run, but most of {run.name} are "
                f"others, of {median:.6g} s in the median"
                + ("" if found else ": `dt` is declared")
                + (f"; if they are in {unit}, name that, as t [{unit}]" if unit else "")
            )
        off, steps = off + int((away > tolerance).sum()), steps + len(q)
        if away.max() > worst:
            k = int(np.argmax(away))
            worst, example = float(away[k]), f"{own[k]:.6g} s after the row {run.where(k)}"
    if off > IRREGULAR * steps:
        raise InputError(
            f"`time` must have equal steps of {dt:.6g} s, but {off} of {steps} are off by more "
            f"than {100 * tolerance:g} % of one, the worst {example}"
            + (
                f": if stamps jitter and the sampling does not, declare dt={dt:.3g}"
                if found and tolerance < NEAR
                else ": sampling at irregular times has no discrete-time model"
            )
        )
