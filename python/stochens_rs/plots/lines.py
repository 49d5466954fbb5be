"""Lines in one panel, labelled at their ends: states, tracking, errors of streams, misses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.types import Axes, Floats, NDArray, most_changing
from . import style
from .panels import clock, extent

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.lines import Line2D


MOST = 6  # lines that are labelled at their ends; more need a legend
_ID = "stochens-end"
_GAP = 1.25 * style.SMALL  # points from line to line of text


def label_ends(ax: Axes, lines: Sequence[Line2D]) -> bool:
    """Write the labels of lines beside their last points in sight, apart from each other.

    They follow when the range of an axis changes. Returns False, and writes nothing, if there are
    too many, or the layout of the figure makes no room for them: then a legend has to do it.
    """
    root = style.root_of(ax)
    room = ax.get_window_extent().height * 72.0 / root.dpi
    count = len(lines) + sum(text.get_gid() == _ID for text in ax.texts)
    finite = all(np.isfinite(line.get_xydata()[-1]).all() for line in lines)  # type: ignore[index]
    if not (finite and 0 < count <= min(MOST, room / _GAP)) or root.get_layout_engine() is None:
        return False
    look = style.look_of(ax)
    pairs = []
    for line in lines:
        color = style.readable(str(line.get_color()), look)
        text = ax.annotate(
            str(line.get_label()), (0.0, 0.0), (5.0, 0.0), textcoords="offset points",
            va="center", gid=_ID, fontsize=style.SMALL, color=color, annotation_clip=False,
        )  # fmt: skip
        pairs.append((text, np.asarray(line.get_xydata(), dtype=np.float64)))

    def move(_: object = None) -> None:
        low, high = np.sort(np.stack([ax.get_xlim(), ax.get_ylim()]), axis=1).T
        for text, points in pairs:
            seen = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
            text.set_visible(bool(seen.size))
            if seen.size:
                text.xy = float(points[seen[-1], 0]), float(points[seen[-1], 1])
        _spread(ax)

    move()
    ax.callbacks.connect("xlim_changed", move)
    ax.callbacks.connect("ylim_changed", move)
    return True


def _spread(ax: Axes) -> None:
    """Move the labels up and down, so that none covers another one."""
    texts: list[Any] = [t for t in ax.texts if t.get_gid() == _ID and t.get_visible()]
    points: list[Any] = [ax.transData.transform(text.xy) for text in texts]
    at = [float(point[1]) * 72.0 / style.root_of(ax).dpi for point in points]
    for text, was, now in zip(texts, at, _apart(at, _GAP), strict=True):
        text.set_position((5.0, now - was))


def _apart(at: Sequence[float], gap: float) -> list[float]:
    """The nearest places in the same order that are `gap` apart: means of blocks that collide."""
    order = sorted(range(len(at)), key=lambda i: at[i])
    blocks: list[list[float]] = []  # sum of the places without their gaps, number
    for k, i in enumerate(order):
        blocks.append([at[i] - k * gap, 1.0])
        while len(blocks) > 1 and blocks[-2][0] / blocks[-2][1] > blocks[-1][0] / blocks[-1][1]:
            total, number = blocks.pop()
            blocks[-1] = [blocks[-1][0] + total, blocks[-1][1] + number]
    level = [total / number for total, number in blocks for _ in range(int(number))]
    found = [0.0] * len(at)
    for k, i in enumerate(order):
        found[i] = level[k] + k * gap
    return found


DASHES = ("-", "--", "-.", ":")  # more than seven states repeat the colours with other dashes
LISTED = 10  # most states in the legend; a longer one hides the figure
RINGS = 8  # edges of discs that are drawn
ARROWS = 3  # on the way of a phase portrait


def draw_states(
    times: Floats,
    states: Floats,
    error: Floats | None,
    *,
    timed: bool,
    ax: Axes | None,
    band: str = "± 2 standard errors",
    names: Sequence[str] | None = None,
    up: str = "state",
) -> Axes:
    """Draw `states` (K + 1, n) over `times`, and twice `error` around them, named `band`.

    `names` of the states, with units, stand at the curves; x_0, x_1, ... without them. Of many
    states those that change most have names, colours and bands, the others are thin.
    """
    ax = style.axes_or_new(ax)
    from matplotlib.patches import Patch

    look = style.look_of(ax)
    lines: list[Line2D] = []
    handles: list[Artist] = []
    n = states.shape[1]
    named = list(range(n)) if n <= LISTED else most_changing(states, MOST)
    others = sorted(set(range(n)) - set(named))
    if others:
        label = f"{len(others)} that change less"
        drawn = ax.plot(times, states[:, others], color=look.pale, linewidth=0.8, label=label)
        handles.append(drawn[0])
    for k, i in enumerate(named):
        color = look.color(k)
        dash = DASHES[k // len(look.colors) % len(DASHES)]
        label = f"$x_{{{i}}}$"
        if names is not None and names[i] != f"x[{i}]":
            label = style.literal(names[i])
        lines += ax.plot(times, states[:, i], dash, color=color, linewidth=1.6, label=label)
        if error is not None:
            low, high = states[:, i] - 2 * error[:, i], states[:, i] + 2 * error[:, i]
            style.add_band(ax, times, low, high, color)
    style.add_labels(ax, "time [s]" if timed else "step k", up)
    if not (len(times) > 1 and label_ends(ax, lines)):
        handles += lines
    if error is not None:
        handles.append(Patch(color=look.ink, alpha=look.fill, linewidth=0, label=band))
    if handles:
        style.add_key(ax, handles=handles)
    return ax


def draw_phase(
    curves: Sequence[tuple[Floats, str | None]],
    names: tuple[str, str],
    *,
    radii: Floats | None = None,
    says: str = "",
    runs: Floats | None = None,
    target: Floats | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw ways (K + 1, 2) with their labels; a ring at the start, a dot at the end, arrows.

    `radii` (K + 1,) of discs around the states of the first, which `says` what they are; `runs`
    (R, K + 1, 2) are dots, the `target` (2,) a cross.
    """
    ax = style.axes_or_new(ax)
    from matplotlib.patches import Circle, Patch

    look = style.look_of(ax)
    handles: list[Artist] = []
    if radii is not None:  # opaque, so that where they overlap they look as one tube
        pale, edge = (style.blend(look.color(0), look.face, share) for share in (0.8, 0.45))
        for k in np.flatnonzero(np.isfinite(radii)).tolist():
            disc: Any = curves[0][0][k].tolist(), float(radii[k])
            ax.add_patch(Circle(*disc, facecolor=pale, linewidth=0, zorder=0.4))
            if k % -(-len(radii) // RINGS) == 0:
                ax.add_patch(Circle(*disc, fill=False, color=edge, lw=0.7, zorder=0.45))
        handles.append(Patch(facecolor=pale, label=says))
    for k, (way, label) in enumerate(curves):
        own: dict[str, Any] = {"color": look.color(k)}
        line = ax.plot(*way.T, linewidth=1.6, label=label, **own)
        ax.plot(*way[0], "o", markerfacecolor=look.face, markersize=6, zorder=3, **own)
        ax.plot(*way[-1], "o", markersize=6, zorder=3, **own)
        for part in range(1, ARROWS + 1):
            place = part * (len(way) - 1) // (ARROWS + 1)
            if (way[place] != way[place + 1]).any() if place + 1 < len(way) else False:
                ax.annotate(
                    "", way[place + 1], way[place],
                    arrowprops={"arrowstyle": "-|>", "mutation_scale": 16, "lw": 0, **own},
                )  # fmt: skip
        handles += line if label else []
    for k, run in enumerate(() if runs is None else runs):
        dots = ax.plot(*run.T, ".", color=look.color(1), markersize=4, alpha=0.8, label="measured")
        handles += dots if k == 0 else []
    if target is not None:
        handles += style.add_target(ax, *target)
    style.add_labels(ax, *map(style.literal, names))
    seen = [*(way for way, _ in curves), *(() if runs is None else runs)]
    _near(ax, np.concatenate([*seen, *([] if target is None else [target[None]])]))
    if handles:
        style.add_key(ax, handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return ax


def _near(ax: Axes, points: Floats) -> None:
    """Keep discs from making the curves small: what is farther than a few ranges leaves."""
    seen = []
    for k, drawn in enumerate((ax.dataLim.intervalx, ax.dataLim.intervaly)):
        least, most, far = extent(points[:, k])
        pad = 0.05 * (most - least) + 1e-9
        low, high = max(float(drawn[0]), least - far), min(float(drawn[1]), most + far)
        seen.append((min(least - pad, low), max(most + pad, high)))
    ax.set_xlim(*seen[0])
    ax.set_ylim(*seen[1])


def draw_tracking(distance: Floats, residuals: Floats, *, averaged: bool, ax: Axes | None) -> Axes:
    """Draw the distance (K + 1,) from a reference and the distance out of reach in a step (K,).

    `averaged`: the distance is the root mean square over several runs.
    """
    ax = style.axes_or_new(ax)
    look = style.look_of(ax)
    steps = range(len(distance))
    name = "distance (rms)" if averaged else "distance"
    lines = [
        *ax.plot(steps, distance, color=look.color(0), linewidth=1.6, label=name),
        *ax.plot(steps[1:], residuals, "--", color=look.ink, linewidth=1, label="out of reach"),
    ]
    style.add_labels(ax, "step k", "distance from the reference")
    ax.set_ylim(bottom=0.0)
    if not label_ends(ax, lines):
        style.add_key(ax, handles=lines)
    return ax


def draw_trace(
    steps: NDArray[np.int64], errors: Floats, certificates: Floats, ax: Axes | None
) -> Axes:
    """Draw errors and certificates over the steps on logarithmic axes, without zeros."""
    ax = style.axes_or_new(ax)
    ax.set_xscale("log")
    ax.set_yscale("log")
    look = style.look_of(ax)
    curves = (  # dashed, so that both are visible where they agree
        (errors, "error", look.color(0), "-"),
        (certificates, "certificate", look.color(1), "--"),
    )
    lines = []
    for values, label, color, line in curves:
        shown = (steps > 0) & (values > 0.0)  # False for nan
        if shown.any():
            lines += ax.plot(steps[shown], values[shown], line, color=color, label=label, lw=1.6)
    style.add_labels(ax, "step", r"$\|B(v - v^*)\|$")
    if lines and not label_ends(ax, lines):
        style.add_key(ax)
    return ax


def draw_evidence(evidence: Floats, threshold: float, *, dt: float | None, ax: Axes | None) -> Axes:
    """Draw the evidence of an alarm over its calls (T,), and the threshold."""
    ax = style.axes_or_new(ax)
    look, shown = style.look_of(ax), np.maximum(evidence, 1e-2)
    times = np.arange(1, len(evidence) + 1) * (1.0 if dt is None else dt)
    ax.plot(times, shown, color=look.color(0), linewidth=1.2, label="evidence")
    ax.axhline(threshold, color=look.ink, linestyle="--", linewidth=1, label="alarm")
    rung = shown >= threshold
    ax.plot(times[rung], shown[rung], "o", color=look.color(1), markersize=5)
    ax.set_yscale("log")
    ax.set_ylim(1e-2, 1e2 * threshold)
    style.add_labels(ax, clock(dt), "evidence of a change")
    style.add_key(ax)
    return ax


def draw_misses(
    misses: NDArray[np.float64],
    threshold: float,
    support: NDArray[np.bool_],
    removed: NDArray[np.bool_],
    *,
    named: str,
    fresh: NDArray[np.float64] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw misses (N,) from the least to the largest, and a line at the `threshold`, `named`.

    `support` and `removed` mark units; `fresh` are the misses of other units.
    """
    ax = style.axes_or_new(ax)
    look = style.look_of(ax)
    for units, k, kind in ((fresh, 1, "fresh units"), (misses, 0, "units of the design")):
        if units is not None:
            share, label = (np.arange(len(units)) + 0.5) / len(units), style.number_text(len(units))
            curve: Any = {"color": look.color(k), "linewidth": 1.4, "label": f"{label} {kind}"}
            ax.plot(share, np.sort(units), **curve)
    order = np.argsort(misses, kind="stable")
    marks = ((support, "o", look.color(0), "support"), (removed, "x", look.ink, "left out"))
    for chosen, marker, color, label in marks:
        if chosen.any():
            at = chosen[order]
            mark: Any = {"linestyle": "none", "fillstyle": "none", "markersize": 6, "label": label}
            ax.plot(share[at], misses[order][at], marker=marker, color=color, **mark)
    ax.axhline(threshold, color=look.ink, linestyle="--", linewidth=1, label=named)
    style.add_labels(ax, "share of the units", "miss")
    ax.set_ylim(bottom=0.0)
    style.add_key(ax, loc="best")
    return ax
