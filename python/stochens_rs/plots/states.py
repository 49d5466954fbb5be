"""Figures of states over time, and of two states against each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.numbers import most_changing
from .._base.types import Floats
from .ends import MOST, label_ends
from .panels import extent
from .style import add_grid, add_key, add_labels, axes_or_new, blend, literal, look_of

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D


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
    ax = axes_or_new(ax)
    from matplotlib.patches import Patch

    look = look_of(ax)
    lines: list[Line2D] = []
    handles: list[Artist] = []
    n = states.shape[1]
    named = list(range(n)) if n <= LISTED else most_changing(states, MOST)
    others: list[Line2D] = []
    for i in sorted(set(range(n)) - set(named)):
        others += ax.plot(times, states[:, i], color=look.pale, linewidth=0.8)
    if others:
        others[0].set_label(f"{len(others)} that change less")
        handles.append(others[0])
    for k, i in enumerate(named):
        color = look.color(k)
        dash = DASHES[k // len(look.colors) % len(DASHES)]
        label = f"$x_{{{i}}}$" if names is None or names[i] == f"x[{i}]" else literal(names[i])
        lines += ax.plot(
            times, states[:, i], color=color, linestyle=dash, linewidth=1.6, label=label
        )
        if error is not None:
            low, high = states[:, i] - 2 * error[:, i], states[:, i] + 2 * error[:, i]
            ax.fill_between(times, low, high, color=color, alpha=look.fill, linewidth=0)
    finish(ax, "time [s]" if timed else "step k", up)
    if not (len(times) > 1 and label_ends(ax, lines)):
        handles += lines
    if error is not None:
        handles.append(Patch(color=look.ink, alpha=look.fill, linewidth=0, label=band))
    if handles:
        add_key(ax, handles=handles)
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
    ax = axes_or_new(ax)
    from matplotlib.patches import Circle, Patch

    look = look_of(ax)
    handles: list[Artist] = []
    if radii is not None:  # opaque, so that where they overlap they look as one tube
        pale = blend(look.color(0), look.face, 0.8)
        for point, radius in zip(curves[0][0], radii, strict=True):
            if np.isfinite(radius):
                at = float(point[0]), float(point[1])
                ax.add_patch(Circle(at, float(radius), facecolor=pale, linewidth=0, zorder=0.4))
        for point, radius in [*zip(curves[0][0], radii, strict=True)][:: -(-len(radii) // RINGS)]:
            if np.isfinite(radius):
                at = float(point[0]), float(point[1])
                edge = blend(look.color(0), look.face, 0.45)
                ax.add_patch(Circle(at, float(radius), fill=False, color=edge, lw=0.7, zorder=0.45))
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
        handles += ax.plot(
            *target, "x", color=look.ink, markersize=8, mew=1.8, linestyle="", label="target"
        )
    add_labels(ax, *(literal(name) for name in names))
    add_grid(ax)
    seen = [*(way for way, _ in curves), *(() if runs is None else runs)]
    _near(ax, np.concatenate([*seen, *([] if target is None else [target[None]])]))
    if handles:
        add_key(ax, handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.0))
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
    ax = axes_or_new(ax)
    look = look_of(ax)
    steps = range(len(distance))
    name = "distance (rms)" if averaged else "distance"
    lines = [
        *ax.plot(steps, distance, color=look.color(0), linewidth=1.6, label=name),
        *ax.plot(steps[1:], residuals, "--", color=look.ink, linewidth=1, label="out of reach"),
    ]
    finish(ax, "step k", "distance from the reference")
    ax.set_ylim(bottom=0.0)
    if not label_ends(ax, lines):
        add_key(ax, handles=lines)
    return ax


def finish(ax: Axes, across: str, up: str) -> None:
    """Label the axes and draw the grid."""
    add_labels(ax, across, up)
    add_grid(ax)
