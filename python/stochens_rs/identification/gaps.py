"""Pairs of a log with lost rows and jittering stamps: which rows follow on each other.

A row k is on the grid of its run at a whole number of steps. A pair is kept if its two rows are one
step apart, both states are there, and so is its input. This looks at what is missing and at the
stamps, never at what was read, so that rows may be lost by chance.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from .._base import memory, validation
from ..exceptions import DataWarning, InputError
from .pieces import Pieces

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from .._base.types import Floats
    from .tables import Run

OnGap: TypeAlias = Literal["split", "raise"]
ON_GAP: tuple[OnGap, ...] = get_args(OnGap)
PAUSE = 2**30  # steps that a gap counts at most
NEAR = 0.25  # of a step: how far a stamp may be off if `dt` is declared
CLOSE = 0.05  # the same if it is not
MANY = 0.01  # share of rows lost for their stamps of which a warning speaks
IRREGULAR = 0.1  # share of stamps further off from which on a log has no sampling time
ENDS = 8  # readings at the end of a sensor's range, at the least
CLUMP = 5  # times as many as at the next value; 2.4 for a sine that is read in whole units


class Stamps(NamedTuple):
    """The time between two rows [s], and by what part of it a stamp may be off."""

    dt: float | None
    tolerance: float


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
    stamps = _stamps(runs, dt, tolerance)
    rows, pieces = [], []
    entries = len(names) + runs[0].x.shape[1]  # of (x, u, x_next)
    memory.need("the pairs", 2 * 8 * entries * sum(len(run.x) for run in runs))
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
    _refuse_useless(every[:, : len(names)], names)
    _refuse_clipped(runs, every, names[: entries - len(names)])
    return Pairs(every, Pieces.joined(pieces), stamps.dt)


def _stamps(runs: Sequence[Run], dt: object, tolerance: object) -> Stamps:
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


def _refuse_disorder(run: Run) -> None:
    """Refuse times that do not increase."""
    if run.times is None:
        return
    with np.errstate(over="ignore"):
        steps = np.diff(run.times)
    if np.isinf(steps).any():
        raise InputError(f"`time` must have finite steps, got {steps.max():g} {run.where(0)}")
    back = steps <= 0.0
    if back.any():
        raise InputError(
            f"`time` must increase within a run, but does not {run.where(int(np.argmax(back)) + 1)}"
            ": sort it"
            + ("" if run.label is not None else ", or, if there are several runs, give `by`")
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
            raise InputError(
                f"`time` must have steps of {dt:.6g} s in every run, but most of {run.name} are "
                f"others, of {float(np.median(own)):.6g} s in the median"
                + ("" if found else ": `dt` is declared")
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


def _refuse_useless(z: Floats, names: Sequence[Any]) -> None:
    """Refuse columns that never change, and two that are proportional, where there are pairs."""
    if len(z) <= z.shape[1] + 1:
        return
    said: dict[bytes, Any] = {}
    for name, column in zip(names, z.T, strict=True):
        top = column[np.argmax(np.abs(column))]
        if (column == column[0]).all():
            raise InputError(
                f"`{name!s:.40}` is constant ({top:.6g}) in all rows: leave it out; an offset is "
                "intercept=True of identify"
            )
        shape = (np.round(column / top, 9) + 0.0).tobytes()
        if shape in said:
            raise InputError(
                f"`{said[shape]!s:.40}` and `{name!s:.40}` are proportional in all rows: leave one "
                "out"
            )
        said[shape] = name


def _refuse_clipped(runs: Sequence[Run], rows: Floats, names: Sequence[Any]) -> None:
    """Refuse pairs with a reading at the end of the range of its sensor.

    It shows where the largest or least reading of all is frequent and the next one is not. Leaving
    these rows out would choose pairs by their outcomes.
    """
    for i, name in enumerate(names):
        read = np.concatenate([run.x[1:, i] for run in runs])
        values, counts = np.unique(read[np.isfinite(read)], return_counts=True)
        for end, next_one in ((0, 1), (-1, -2)):
            if len(values) < ENDS or counts[end] < max(ENDS, CLUMP * counts[next_one]):
                continue
            if (rows[:, [i, i - len(names)]] == values[end]).any():
                raise InputError(
                    f"`{name!s:.40}` reads {values[end]:.6g}, its "
                    f"{'largest' if end else 'least'} value, in {counts[end]} rows: the end of the "
                    "sensor's range, or a stop, and no linear system. Neither leave these rows out "
                    "nor cut runs before them: that chooses pairs by their outcomes"
                )
