"""Figure of the errors of a stream over its steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .style import COLORS, INK, add_grid, axes_or_new

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


def draw_trace(
    steps: NDArray[np.int64], errors: Floats, certificates: Floats, ax: Axes | None
) -> Axes:
    """Draw errors and certificates over the steps on logarithmic axes, without zeros."""
    ax = axes_or_new(ax)
    ax.set_xscale("log")
    ax.set_yscale("log")
    curves = (  # dashed, so that both are visible where they agree
        (errors, "error", COLORS[0], "-"),
        (certificates, "certificate", COLORS[1], "--"),
    )
    for values, label, color, line in curves:
        shown = (steps > 0) & (values > 0.0)  # False for nan
        if shown.any():
            ax.plot(steps[shown], values[shown], line, color=color, label=label, lw=1.6)
    ax.set_xlabel("step", color=INK)
    ax.set_ylabel(r"$\|B(v - v^*)\|$", color=INK)
    add_grid(ax)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(frameon=False)
    return ax
