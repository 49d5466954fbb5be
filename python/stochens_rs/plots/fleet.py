"""Figures of the misses of many units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .states import finish
from .style import add_key, axes_or_new, look_of, number_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray


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
    ax = axes_or_new(ax)
    look = look_of(ax)
    handles = []
    if fresh is not None:
        share = (np.arange(len(fresh)) + 0.5) / len(fresh)
        label = f"{number_text(len(fresh))} fresh units"
        handles += ax.plot(share, np.sort(fresh), color=look.color(1), linewidth=1.4, label=label)
    order = np.argsort(misses, kind="stable")
    share, sorted_ = (np.arange(len(misses)) + 0.5) / len(misses), misses[order]
    label = f"{number_text(len(misses))} units of the design"
    handles += ax.plot(share, sorted_, color=look.color(0), linewidth=1.4, label=label)
    marks = ((support, "o", look.color(0), "support"), (removed, "x", look.ink, "left out"))
    for chosen, marker, color, label in marks:
        if chosen.any():
            at = chosen[order]
            handles += ax.plot(
                share[at],
                sorted_[at],
                marker=marker,
                linestyle="none",
                color=color,
                fillstyle="none",
                markersize=6,
                label=label,
            )
    line = ax.axhline(threshold, color=look.ink, linestyle="--", linewidth=1, label=named)
    finish(ax, "share of the units", "miss")
    ax.set_ylim(bottom=0.0)
    add_key(ax, handles=[*handles, line], loc="center left")
    return ax
