"""How states over time look: one line per state, a band where the line is an estimate."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ._drawing import INK, new_figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

__all__ = ["draw_states", "draw_tracking"]

# Okabe and Ito's palette, distinct for any colour vision; more states repeat it with other dashes.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#222222")
DASHES = ("-", "--", "-.", ":")
LISTED = 10  # a longer legend hides the figure


def draw_states(
    times: NDArray[np.float64],
    states: NDArray[np.float64],
    error: NDArray[np.float64] | None,
    *,
    timed: bool,
    ax: Axes | None,
) -> Axes:
    """Draw `states` (K + 1, n) over `times`, and twice `error` around them."""
    from .plots import require_matplotlib

    require_matplotlib()
    from matplotlib.patches import Patch

    if ax is None:
        ax = new_figure(5.6, 4.2, header=0.0, footer=0.0).add_subplot()
    handles: list[Artist] = []
    for i in range(states.shape[1]):
        color = COLORS[i % len(COLORS)]
        dash = DASHES[i // len(COLORS) % len(DASHES)]
        handles += ax.plot(
            times, states[:, i], color=color, linestyle=dash, linewidth=1.4, label=f"$x_{{{i}}}$"
        )
        if error is not None:
            low, high = states[:, i] - 2 * error[:, i], states[:, i] + 2 * error[:, i]
            ax.fill_between(times, low, high, color=color, alpha=0.15, linewidth=0)
    if states.shape[1] > LISTED:
        handles = []
    if error is not None:
        handles.append(Patch(color=INK, alpha=0.15, linewidth=0, label="± 2 standard errors"))
    _finish(ax, "time [s]" if timed else "step k", "state", handles)
    return ax


def draw_tracking(
    distance: NDArray[np.float64], residuals: NDArray[np.float64], *, ax: Axes | None
) -> Axes:
    """Draw the distance (K + 1,) from a reference, and what no control can do in a step (K,)."""
    from .plots import require_matplotlib

    require_matplotlib()
    if ax is None:
        ax = new_figure(5.6, 4.2, header=0.0, footer=0.0).add_subplot()
    steps = range(len(distance))
    handles = [
        *ax.plot(steps, distance, color=COLORS[0], linewidth=1.4, label="distance (rms)"),
        *ax.plot(steps[1:], residuals, "--", color=INK, linewidth=1, label="out of reach"),
    ]
    _finish(ax, "step k", "distance from the reference", handles)
    return ax


def _finish(ax: Axes, across: str, up: str, handles: Sequence[Artist]) -> None:
    ax.set_xlabel(across, fontsize=9.5, color=INK)
    ax.set_ylabel(up, fontsize=9.5, color=INK)
    ax.grid(True, color="#e4e4e4", linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=8.5, colors=INK, width=0.7)
    if handles:
        ax.legend(handles=handles, fontsize=8.5, frameon=False, labelcolor=INK)
