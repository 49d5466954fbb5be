"""The clock of a log, and its pairs: rows that follow on each other, of which some may be lost.

A row k is on the grid of its run at a whole number of steps. A pair is kept if its two rows are one
step apart, both states are there, and so is its input. This looks at what is missing and at the
stamps, never at what was read, so that rows may be lost by chance.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from .._base import running, validation
from ..exceptions import DataWarning, InputError
from .pieces import Pieces
from .units import LATEST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .._base.types import Floats
    from .table import Run

OnGap: TypeAlias = Literal["split", "raise"]
ON_GAP: tuple[OnGap, ...] = get_args(OnGap)
NEAR = 0.25  # of a step: how far a stamp may be off if `dt` is declared
CLOSE = 0.05  # the same if it is not
IRREGULAR = 0.1  # share of stamps further off from which on a log has no sampling time
ROUNDED = 0.02  # share of equal stamps from which on they are rounded, and no row is there twice
_UNITS = {"ms": 1e3, "us": 1e6, "ns": 1e9, "min": 1 / 60, "h": 1 / 3600}
FEW = 0.1  # share of steps backwards up to which most others are one step of the clock
ENOUGH = 10  # rows of which it is said that their steps alternate
ALTERNATING = 0.8  # share of steps as long as the last but one, where those between are not
PAUSE = 2**30  # steps that a gap counts at most
MANY = 0.01  # share of rows lost for their stamps of which a warning speaks
ENDS = 8  # readings at the end of a sensor's range, at the least
CLUMP = 5  # times as many as at the next value; 2.4 for a sine that is read in whole units


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


class Pairs(NamedTuple):
    """The rows (x, u, x_next) of all pairs, their runs and pieces, and the time of a step [s]."""

    rows: Floats
    pieces: Pieces
    dt: float | None


def joined(
    runs: Sequence[Run],
    names: Sequence[Any],
    dt: object,
    tolerance: object,
    delay: object,
    on_gap: object,
) -> Pairs:
    """The pairs of all runs; `names` are those of the states and then the inputs."""
    back = validation.size("delay", delay, minimum=-1)
    split = validation.choice("on_gap", on_gap, ON_GAP) == "split"
    stamps = checked_stamps(runs, dt, tolerance)
    rows, pieces = [], []
    entries = len(names) + runs[0].x.shape[1]  # of (x, u, x_next)
    running.need("the pairs", 2 * 8 * entries * sum(len(run.x) for run in runs))
    for run in runs:
        own, acting, lost = _kept(run, names, stamps, back, split)
        rows.append(np.hstack([run.x[own], run.u[acting], run.x[own + 1]]))
        pieces.append(lost)
    if dt is None and tolerance is None and stamps.dt is not None:
        wide = Stamps(float(f"{stamps.dt:.3g}"), NEAR)
        less = sum(int(_kept(run, names, wide, back, split)[2].lost.sum()) for run in runs)
        saved = sum(int(lost.lost.sum()) for lost in pieces) - less
        if saved > MANY * sum(len(run.x) for run in runs):
            said = f"{saved} rows dropped because the stamps jitter; declare dt={wide.dt:g}"
            warnings.warn(DataWarning(said), stacklevel=4)
    every = np.vstack(rows)
    _refuse_useless(every[:, : len(names)], names, entries - len(names))
    warn_of_ends([(run.x, run.u) for run in runs], names, stacklevel=4)
    return Pairs(every, Pieces.joined(pieces), stamps.dt)


def _kept(
    run: Run, names: Sequence[Any], stamps: Stamps, delay: int, split: bool
) -> tuple[NDArray[np.intp], NDArray[np.intp], Pieces]:
    """The rows k of the pairs x(k), u(k - delay), x(k + 1), those of their inputs, and the pieces.

    Lost are rows that the stamps skip, rows off the grid, and rows with a cell missing.
    """
    there, given = (np.logical_and.reduce(np.isfinite(one), axis=1) for one in (run.x, run.u))
    at, absent = np.arange(len(run.x)), 0
    if run.times is not None and stamps.dt is not None:
        with np.errstate(over="ignore"):
            q = np.diff(run.times) / stamps.dt
        whole = np.minimum(np.round(q), PAUSE).astype(np.int64)
        # where rows are not a whole number of steps apart, no input reaches over
        odd = (np.abs(q - whole) > stamps.tolerance) | (whole < 1)
        absent = int(np.maximum(whole - 1, odd).sum())
        at = np.concatenate(
            [[0], np.cumsum(np.where(odd, np.maximum(whole, 2) + abs(delay), whole))]
        )
    acting = np.minimum(np.searchsorted(at, at - delay), len(at) - 1)
    known = (at[acting] == at - delay) & given[acting]
    pair = there[:-1] & there[1:] & known[:-1] & (np.diff(at) == 1)
    if not split:
        _refuse_gaps(run, at, names)
    kept = np.flatnonzero(pair)
    if not len(kept):
        _refuse_empty(run, names)
        raise InputError(
            f"{run.name} has no two complete rows that are one step apart"
            + ("" if stamps.dt is None else f", {stamps.dt:.6g} s")
            + (f", with an input {delay} steps before them" if delay > 0 else "")
            + ": leave this run out, if its rows were lost by chance"
        )
    given[-1 if delay >= 0 else 0] = True  # acts behind the last state, or before the first one
    lost = absent + int((~there | ~given).sum())
    steps = np.diff(at[kept]) - 1
    behind = np.flatnonzero(steps) + 1
    gaps = np.column_stack([behind, steps[behind - 1]])
    count = np.array([len(kept)]), np.array([lost])
    return kept, acting[kept], Pieces(count[0], gaps, count[1])


def _refuse_gaps(run: Run, at: NDArray[np.int64], names: Sequence[Any]) -> None:
    """Refuse the first gap of a run, where none is to divide it."""
    divides = ": on_gap='split' leaves such rows out and divides the run"
    far = np.diff(at) != 1
    if far.any():
        k = int(np.argmax(far))
        raise InputError(
            f"`time` has a gap of {at[k + 1] - at[k]} steps behind the row {run.where(k)}{divides}"
        )
    missing = np.isnan(np.hstack([run.x, run.u]))
    missing[-1, run.x.shape[1] :] = False  # the last input acts behind the last state
    if missing.any():
        row, column = np.unravel_index(int(np.argmax(missing)), missing.shape)
        raise InputError(f"`{names[int(column)]!s:.40}` is missing {run.where(int(row))}{divides}")


def _refuse_empty(run: Run, names: Sequence[Any]) -> None:
    """Refuse columns without a number, and rows of which none is complete."""
    there = np.isfinite(np.hstack([run.x, run.u]))
    n = run.x.shape[1]
    if not there.any(axis=0).all():
        k = int(np.argmin(there.any(axis=0)))
        cure = "leave this input out" if k >= n else "pass what was measured as outputs="
        raise InputError(f"`{names[k]!s:.40}` has no number in {run.name}: {cure}")
    if len(there) > 2 and not there.all(axis=1).any():
        raise InputError(
            f"{run.name} has no complete row, as where the rows of two logs are merged: bring them "
            "to one clock first, as pandas.merge_asof does"
        )


def _refuse_useless(z: Floats, names: Sequence[Any], n: int) -> None:
    """Refuse columns that never change, and two that are proportional, where there are pairs."""
    if len(z) <= z.shape[1] + 1:
        return
    said: dict[bytes, Any] = {}
    for k, (name, column) in enumerate(zip(names, z.T, strict=True)):
        top = column[np.argmax(np.abs(column))]
        if (column == column[0]).all():
            raise InputError(
                f"`{name!s:.40}` is constant ({top:.6g}) in all rows"
                + (
                    ": leave it out; an offset is intercept=True of identify"
                    if k < n
                    else " and says nothing of B: excite it, as by the rows before a step; or, for "
                    "states, pass arrays to Trajectories, and B to identify as known_B="
                )
            )
        shape = (np.round(column / top, 9) + 0.0).tobytes()
        if shape in said:
            raise InputError(
                f"`{said[shape]!s:.40}` and `{name!s:.40}` are proportional in all rows: leave one "
                "out"
            )
        said[shape] = name


def warn_of_ends(
    runs: Sequence[tuple[Floats, Floats]], names: Sequence[Any], stacklevel: int
) -> None:
    """Warn of readings (T + 1, n) that are often the largest or least, and seldom the next value.

    It is the end of the range of a sensor, or a stop; or the plant rests there, which does no harm,
    as in the rows of a run before its first change.
    """
    read = np.concatenate([x[max(1, _first_change(x, u)) :] for x, u in runs])
    found = []
    for name, column in zip(names, read.T, strict=False):
        own = column[np.isfinite(column)]
        if max((own == end).sum() for end in (own.max(initial=0.0), own.min(initial=0.0))) < ENDS:
            continue
        values, counts = np.unique(own, return_counts=True)
        for end, next_one in ((0, 1), (-1, -2)):
            if len(values) < ENDS or counts[end] < max(ENDS, CLUMP * counts[next_one]):
                continue
            found.append(
                f"`{name!s:.40}` reads {values[end]:.6g}, its {'largest' if end else 'least'} "
                f"value, in {counts[end]} rows"
            )
    if found:
        more = f" ({len(found) - 1} more so)" if len(found) > 1 else ""
        said = (
            f"{found[0]}{more}: no harm if the plant rests there; at the end of a sensor's range, "
            "or at a stop, it is no linear system. Neither leave these rows out nor cut runs "
            "before them: that chooses pairs by their outcomes"
        )
        warnings.warn(DataWarning(said), stacklevel=stacklevel)


def _first_change(x: Floats, u: Floats) -> int:
    """The first row that differs from the first one, in x or in the input before it."""
    other = (x[1:] != x[0]).any(axis=1)
    other |= (u[: len(other)] != u[0]).any(axis=1)
    return int(np.argmax(other)) + 1 if other.any() else len(x)
