"""The clock of a log, and its pairs: rows that follow on each other, of which some may be lost.

A row k is on the grid of its run at a whole number of steps. A pair is kept if its two rows are one
step apart, both states are there, and so is its input. This looks at what is missing and at the
stamps, never at what was read, so that rows may be lost by chance. Gaps divide runs into pieces; a
piece is no run of its own: the noise before a gap is in the states behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from .._base import running, validation
from .._base.types import Floats, NDArray
from .._core import Pieces
from ..exceptions import InputError
from .table import LATEST, Run

OnGap: TypeAlias = Literal["split", "raise"]
NEAR = 0.25  # of a step: how far a stamp may be off if `dt` is declared
CLOSE = 0.05  # the same if it is not
IRREGULAR = 0.1  # share of stamps further off from which on a log has no sampling time
ROUNDED = 0.02  # share of equal stamps from which on they are rounded, and no row is there twice
_UNITS = {"ms": 1e3, "us": 1e6, "ns": 1e9, "min": 1 / 60, "h": 1 / 3600}
FEW = 0.1  # share of steps backwards, or of copies, up to which most rows are in their places
ENOUGH = 10  # rows of which it is said that their steps alternate
ALTERNATING = 0.8  # share of steps as long as the last but one, where those between are not
SELDOM = 0.6  # a column in fewer rows than this is logged at another rate
PAUSE = 2**30  # steps that a gap counts at most
MANY = 0.01  # share of rows lost for their stamps of which a warning speaks
ENDS = 8  # readings at the end of a sensor's range, at the least
CLUMP = 5  # times as many as at the next value; 2.4 for a sine that is read in whole units


def _step(runs: Sequence[Run], dt: float | None) -> float | None:
    """The time between two rows, which the stamps must keep.

    If it is not declared: the mean of ``step / round(step / median)`` over the steps that are near
    a multiple of their median; the median alone is wrong where stamps are rounded.
    """
    each = [_steps(run) for run in runs]
    for run, own in zip(runs, each, strict=True):
        _refuse_alternating(run, own)
        if (run.times[:1] > LATEST).any():
            raise InputError(
                f"`time` must be in seconds, but {run.name} begins at {run.times[0]:.6g}: if that "
                "is in another unit, write it behind the name of the column, as t [ns]"
            )
    declared, steps = dt, np.concatenate(each)
    if dt is None and len(steps):
        parts = steps / np.median(steps)
        near = (np.abs(parts - np.round(parts)) <= NEAR) & (np.round(parts) >= 1.0)
        if not near.any():
            raise InputError(
                f"`time` must have equal steps, got {len(steps)} of {steps.min():.6g} to "
                f"{steps.max():.6g} s: declare `dt`"
            )
        found = float(np.mean(steps[near] / np.round(parts[near])))
        declared = float(f"{found:.12g}")  # 0.1, where stamps are 0, 0.1, 0.2, 0.30000000000000004
    if declared is not None:
        _refuse_irregular(runs, each, declared, dt is None)
    return declared


def _without_copies(runs: Sequence[Run]) -> list[Run]:
    """The runs without rows that repeat the one before, stamp and all cells; it warns of them.

    Where many stamps are equal they are rounded, and rows of equal readings are no copies.
    """
    found, first, total = [], "", 0
    for run in runs:
        twice = run.times[1:] == run.times[:-1]
        same = (run.z[1:] == run.z[:-1]) | (np.isnan(run.z[1:]) & np.isnan(run.z[:-1]))
        copies = np.flatnonzero(twice & same.all(axis=1)) + 1
        others = twice.sum() - len(copies)
        if 0 < len(copies) <= max(1, FEW * len(twice)) and others <= max(1, ROUNDED * len(twice)):
            first, total = first or run.rows_of(copies[0] - 1, copies[0]), total + len(copies)
            own = np.delete(np.arange(len(run.times)), copies)
            run = run._replace(z=run.z[own], times=run.times[own], rows=run.rows[own])
        found.append(run)
    if total:
        be = "1 row was" if total == 1 else f"{total} rows were"
        running.warn(f"{be} left out, copies of the row before: {first}" + ", ..." * (total > 1))
    return found


def _steps(run: Run) -> Floats:
    """The steps between the stamps of a run; refuses times that do not increase, and says why."""
    times = run.times
    with np.errstate(over="ignore"):
        steps = np.diff(times)
    if np.isinf(steps).any():
        raise InputError(f"`time` must have finite steps, got {steps.max():g} {run.where(0)}")
    if (steps > 0.0).all():
        return steps
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
            f"one stamp is there twice, in {rows}, with other cells: delete the row that is wrong; "
            "if none is, leave `time` out and declare `dt`"
        )
    raise InputError(f"`time` must increase within a run, but {why}")


def _refuse_alternating(run: Run, steps: Floats) -> None:
    """Refuse steps that alternate, as where the rows of two logs are merged.

    Steps of one and two, say, are what a lost row leaves, unless every second row repeats a column.
    """
    if len(run.times) < ENOUGH:
        return
    pair = np.sort([np.median(steps[::2]), np.median(steps[1::2])])
    middle = float(pair[0] / 2 + pair[1] / 2)
    same = np.abs(steps[2:] - steps[:-2]) <= CLOSE * middle
    if pair[1] - pair[0] <= 2 * NEAR * middle or same.mean() < ALTERNATING:
        return
    ratio = pair[1] / pair[0]
    repeats = run.z[1:] == run.z[:-1]
    filled = np.abs(repeats[::2].mean(axis=0) - repeats[1::2].mean(axis=0)) >= ALTERNATING
    if abs(ratio - np.round(ratio)) > CLOSE * ratio or filled.any():
        raise InputError(
            f"`time` has steps that alternate in {run.name}, {pair[0]:.6g} and {pair[1]:.6g} s: "
            "the rows of two logs, merged? Bring them to one clock first, as pandas.merge_asof does"
        )


def _refuse_irregular(runs: Sequence[Run], steps: Sequence[Floats], dt: float, found: bool) -> None:
    """Refuse a run whose rows are not mostly one step apart, and stamps that are too far off."""
    off, slack = [], CLOSE if found else NEAR
    worst, example = 0.0, ""
    for run, own in zip(runs, steps, strict=True):
        if not len(own):
            continue
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
        off.append(away > slack)
        if away.max() > worst:
            k = int(np.argmax(away))
            worst, example = float(away[k]), f"{own[k]:.6g} s after the row {run.where(k)}"
    every = np.concatenate(off) if off else np.zeros(0)
    if every.sum() > IRREGULAR * len(every):
        cure = f"if stamps jitter and the sampling does not, declare dt={dt:.3g}"
        raise InputError(
            f"`time` must have equal steps of {dt:.6g} s, but {every.sum()} of {len(every)} are "
            f"off by more than {100 * slack:g} % of one, the worst {example}: "
            + (cure if found else "sampling at irregular times has no discrete-time model")
        )


def pairs_of(
    runs: Sequence[Run], names: Sequence[Any], dt: object, delay: object, on_gap: object
) -> tuple[Floats, Pieces, float | None]:
    """The rows (x, u, x_next) of all pairs, their runs and pieces, and the time of a step [s].

    `names` are those of the states and then the inputs.
    """
    back = validation.size("delay", delay, minimum=-1)
    split = validation.choice("on_gap", on_gap, get_args(OnGap)) == "split"
    step = None if dt is None else validation.positive("dt", dt)
    if len(runs[0].times):
        runs = _without_copies(runs)
        step = _step(runs, step)
    n = runs[0].n
    readings = sum(len(run.z) for run in runs)
    running.need("the pairs", 2 * 8 * (len(names) + n) * readings)

    def kept(dt: float | None, slack: float) -> list[tuple[NDArray[np.intp], ...]]:
        return [_kept(run, names, (dt, slack), back, split) for run in runs]

    places = kept(step, CLOSE if dt is None else NEAR)
    rows = [
        np.hstack([run.z[own, :n], run.z[acting, n:], run.z[own + 1, :n]])
        for run, (own, acting, *_) in zip(runs, places, strict=True)
    ]
    pieces = [Pieces(*parts) for _, _, *parts in places]
    layout = Pieces.joined(pieces)
    lost = int(layout.lost.sum())
    if dt is None and step is not None and lost > MANY * readings:
        wide = float(f"{step:.3g}")
        saved = lost - sum(int(parts[-1][0]) for parts in kept(wide, NEAR))
        if saved > MANY * readings:
            text = f"{saved} rows dropped because the stamps jitter; declare dt={wide:g}"
            running.warn(text)
    every = np.vstack(rows)
    _refuse_useless(every[:, : len(names)], names, n)
    warn_of_ends([(run.z[:, :n], run.z[:, n:]) for run in runs], names)
    return every, layout, step


def _kept(
    run: Run, names: Sequence[Any], clock: tuple[float | None, float], delay: int, split: bool
) -> tuple[NDArray[np.intp], ...]:
    """The rows k of the pairs x(k), u(k - delay), x(k + 1), those of their inputs, and the pieces.

    Lost are rows that the stamps skip, rows off the grid, and rows with a cell missing.
    """
    dt, slack = clock
    finite = np.isfinite(run.z)
    there = np.logical_and.reduce(finite[:, : run.n], axis=1)
    given = np.logical_and.reduce(finite[:, run.n :], axis=1)
    at, absent = np.arange(len(run.z)), 0
    if len(run.times) and dt is not None:
        with np.errstate(over="ignore"):
            q = np.diff(run.times) / dt
        whole = np.minimum(np.round(q), PAUSE).astype(np.int64)
        # where rows are not a whole number of steps apart, no input reaches over
        odd = (np.abs(q - whole) > slack) | (whole < 1)
        absent = int(np.maximum(whole - 1, odd).sum())
        steps = np.where(odd, np.maximum(whole, 2) + abs(delay), whole)
        at = np.concatenate([[0], np.cumsum(steps)])
    acting = np.minimum(np.searchsorted(at, at - delay), len(at) - 1)
    known = (at[acting] == at - delay) & given[acting]
    if not split:
        _refuse_gaps(run, at, names)
    kept = np.flatnonzero(there[:-1] & there[1:] & known[:-1] & (np.diff(at) == 1))
    if not len(kept):
        _refuse_empty(run, names)
        shares = finite.mean(axis=0)
        rare = int(np.argmin(shares))
        cure = "leave this run out, if its rows were lost by chance"
        if shares[rare] < SELDOM:  # as a camera that is slower than an encoder
            cure = (
                f"{names[rare]} is in {shares[rare]:.0%} of its rows alone, and a model needs all "
                "columns in each step: log them at one rate, with inputs that are held as long"
            )
        raise InputError(
            f"{run.name} has no two complete rows that are one step apart"
            + ("" if dt is None else f", {dt:.6g} s")
            + (f", with an input {delay} steps before them" if delay > 0 else "")
            + f": {cure}"
        )
    given[-1 if delay >= 0 else 0] = True  # acts behind the last state, or before the first one
    lost = absent + int((~there | ~given).sum())
    steps = np.diff(at[kept]) - 1
    behind = np.flatnonzero(steps)
    gaps = np.ravel(np.column_stack([behind + 1, steps[behind]]))
    return kept, acting[kept], np.array([len(kept)]), gaps, np.array([lost])


def _refuse_gaps(run: Run, at: NDArray[np.int64], names: Sequence[Any]) -> None:
    """Refuse the first gap of a run, where none is to divide it."""
    divides = ": on_gap='split' leaves such rows out and divides the run"
    far = np.diff(at) != 1
    if far.any():
        k = int(np.argmax(far))
        raise InputError(
            f"`time` has a gap of {at[k + 1] - at[k]} steps behind the row {run.where(k)}{divides}"
        )
    missing = np.isnan(run.z)
    missing[-1, run.n :] = False  # the last input acts behind the last state
    if missing.any():
        row, column = map(int, np.argwhere(missing)[0])
        raise InputError(f"`{names[column]!s:.40}` is missing {run.where(row)}{divides}")


def _refuse_empty(run: Run, names: Sequence[Any]) -> None:
    """Refuse columns without a number, and rows of which none is complete."""
    there = np.isfinite(run.z)
    if not there.any(axis=0).all():
        k = int(np.argmin(there.any(axis=0)))
        cure = "leave this input out" if k >= run.n else "pass what was measured as outputs="
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
    shapes: dict[bytes, Any] = {}
    for k, (name, column) in enumerate(zip(names, z.T, strict=True)):
        top = column[np.argmax(np.abs(column))]
        if (column == column[0]).all():
            cure = "leave it out; an offset is intercept=True of identify"
            if k >= n:
                cure = (
                    "it says nothing of B: excite it, as by the rows before a step; or, for "
                    "states, pass arrays to Trajectories, and B to identify as known=(None, B)"
                )
            raise InputError(f"`{name!s:.40}` is constant ({top:.6g}) in all rows: {cure}")
        twin = shapes.setdefault((np.round(column / top, 9) + 0.0).tobytes(), name)
        if twin is not name:
            raise InputError(
                f"`{twin!s:.40}` and `{name!s:.40}` are proportional in all rows: leave one out"
            )


def warn_of_ends(runs: Sequence[tuple[Floats, Floats]], names: Sequence[Any]) -> None:
    """Warn of readings (T + 1, n) that are often the largest or least, and seldom the next value.

    It is the end of the range of a sensor, or a stop; or the plant rests there, which does no harm,
    as in the rows of a run before its first change.
    """
    found, read = [], np.concatenate([x[_first_change(x, u) :] for x, u in runs])
    for name, column in zip(names, read.T, strict=False):
        own = column[np.isfinite(column)]
        if max((own == end).sum() for end in (own.max(initial=0.0), own.min(initial=0.0))) < ENDS:
            continue
        values, counts = np.unique(own, return_counts=True)
        for end, next_one, word in ((0, 1, "least"), (-1, -2, "largest")):
            if len(values) >= ENDS and counts[end] >= max(ENDS, CLUMP * counts[next_one]):
                found.append(
                    f"`{name!s:.40}` reads {values[end]:.6g}, its {word} value, "
                    f"in {counts[end]} rows"
                )
    if found:
        more = f" ({len(found) - 1} more so)" if len(found) > 1 else ""
        text = (
            f"{found[0]}{more}: no harm if the plant rests there; at the end of a sensor's range, "
            "or at a stop, it is no linear system. Neither leave these rows out nor cut runs "
            "before them: that chooses pairs by their outcomes"
        )
        running.warn(text)


def _first_change(x: Floats, u: Floats) -> int:
    """The first row that differs from the first one, in x or in the input before it."""
    other = (x[1:] != x[0]).any(axis=1)
    other |= (u[: len(other)] != u[0]).any(axis=1)
    return int(np.argmax(other)) + 1 if other.any() else len(x)
