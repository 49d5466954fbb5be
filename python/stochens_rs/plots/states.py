"""Figures of states over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .style import COLORS, INK, add_grid, add_labels, axes_or_new, literal

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

DASHES = ("-", "--", "-.", ":")  # more than seven states repeat the colours with other dashes
LISTED = 10  # most states in the legend; a longer one hides the figure


def draw_states(
    times: NDArray[np.float64],
    states: NDArray[np.float64],
    error: NDArray[np.float64] | None,
    *,
    timed: bool,
    ax: Axes | None,
    band: str = "± 2 standard errors",
    names: Sequence[str] | None = None,
) -> Axes:
    """Draw `states` (K + 1, n) over `times`, and twice `error` around them, named `band`.

    `names` of the states, with units, go into the legend; x_0, x_1, ... without them.
    """
    ax = axes_or_new(ax)
    from matplotlib.patches import Patch

    handles: list[Artist] = []
    for i in range(states.shape[1]):
        color = COLORS[i % len(COLORS)]
        dash = DASHES[i // len(COLORS) % len(DASHES)]
        label = f"$x_{{{i}}}$" if names is None or names[i] == f"x[{i}]" else literal(names[i])
        handles += ax.plot(
            times, states[:, i], color=color, linestyle=dash, linewidth=1.4, label=label
        )
        if error is not None:
            low, high = states[:, i] - 2 * error[:, i], states[:, i] + 2 * error[:, i]
            ax.fill_between(times, low, high, color=color, alpha=0.15, linewidth=0)
    if states.shape[1] > LISTED:
        handles = []
    if error is not None:
        handles.append(Patch(color=INK, alpha=0.15, linewidth=0, label=band))
    finish(ax, "time [s]" if timed else "step k", "state", handles)
    return ax


def draw_tracking(
    distance: NDArray[np.float64], residuals: NDArray[np.float64], *, ax: Axes | None
) -> Axes:
    """Draw the distance (K + 1,) from a reference and the distance out of reach in a step (K,)."""
    ax = axes_or_new(ax)
    steps = range(len(distance))
    handles = [
        *ax.plot(steps, distance, color=COLORS[0], linewidth=1.4, label="distance (rms)"),
        *ax.plot(steps[1:], residuals, "--", color=INK, linewidth=1, label="out of reach"),
    ]
    finish(ax, "step k", "distance from the reference", handles)
    return ax


def finish(ax: Axes, across: str, up: str, handles: Sequence[Artist]) -> None:
    """Label the axes; a legend if there are handles."""
    add_labels(ax, across, up)
    add_grid(ax)
    if handles:
        ax.legend(handles=handles, fontsize=8.5, frameon=False, labelcolor=INK)
