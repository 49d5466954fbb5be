"""Figure of predicted states with a certified tube around them, and of measured ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .style import COLORS, INK, add_grid, add_labels, new_figure, require_matplotlib

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

PANELS = 12  # most states that are drawn
SEEN = 3.0  # how far a tube may go beyond the states, in ranges of these


def draw_tube(
    predicted: Floats,
    tube: Floats | None,
    names: Sequence[str],
    *,
    measured: Floats | None = None,
    target: Floats | None = None,
    dt: float | None = None,
    says: str = "",
) -> Figure:
    """Draw each state of `predicted` (K + 1, n) in its panel over time.

    With the `tube` (K + 1,) around it, of which the legend `says` what it is; with what was
    `measured` (K + 1, n), or several of them (R, K + 1, n), and the `target` (n,) at the end. The
    tube bounds the distance in the 2-norm, hence each state.
    """
    require_matplotlib()
    n = min(predicted.shape[1], PANELS)
    runs = np.zeros((0, *predicted.shape)) if measured is None else measured
    runs = runs[None] if runs.ndim == 2 else runs
    times = np.arange(len(predicted)) * (1.0 if dt is None else dt)
    columns = min(n, 2 if n in (2, 4) else 3)
    rows = -(-n // columns)
    figure = new_figure(1.2 + 3.4 * columns, 0.9 + 2.3 * rows, header=0.4, footer=0.0)
    for i in range(n):
        ax = figure.add_subplot(rows, columns, i + 1)
        shown = np.concatenate([predicted[:, i], runs[:, :, i].ravel()])
        shown = shown if target is None else np.append(shown, target[i])
        reach = SEEN * max(float(np.ptp(shown)), 1e-12 + 1e-6 * float(np.abs(shown).max()))
        floor, top = float(shown.min()), float(shown.max())
        if tube is not None:  # a wider one leaves the panel
            radius = np.minimum(tube, 10.0 * reach)
            low, high = predicted[:, i] - radius, predicted[:, i] + radius
            floor, top = max(floor - reach, low.min()), min(top + reach, high.max())
            ax.fill_between(times, low, high, color=COLORS[0], alpha=0.16, linewidth=0, label=says)
        ax.plot(times, predicted[:, i], color=COLORS[0], linewidth=1.6, label="predicted")
        for k, run in enumerate(runs):
            ax.plot(
                times, run[:, i], ".", color=COLORS[1], markersize=5 if len(runs) == 1 else 3,
                alpha=1.0 if len(runs) == 1 else 0.5, label="measured" if k == 0 else None,
            )  # fmt: skip
        if target is not None:
            ax.plot(times[-1], target[i], "x", color=INK, markersize=8, mew=1.8, label="target")
        pad = 0.04 * (top - floor) + 0.01 * reach
        ax.set_ylim(floor - pad, top + pad)
        add_labels(ax, "step k" if dt is None else "time [s]", names[i])
        add_grid(ax)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="upper left", ncols=4, frameon=False, fontsize=9, labelcolor=INK
    )
    return figure
