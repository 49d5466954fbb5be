"""How states over time look: one line per state, a band where the line is an estimate."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .style import INK, new_figure, require_matplotlib

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

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
    require_matplotlib()
    if ax is None:
        ax = new_figure(5.6, 4.2, header=0.0, footer=0.0).add_subplot()
    for i in range(states.shape[1]):
        color = COLORS[i % len(COLORS)]
        dash = DASHES[i // len(COLORS) % len(DASHES)]
        label = f"$x_{{{i}}}$" if states.shape[1] <= LISTED else None
        ax.plot(times, states[:, i], color=color, linestyle=dash, linewidth=1.4, label=label)
        if error is not None:
            low, high = states[:, i] - 2 * error[:, i], states[:, i] + 2 * error[:, i]
            ax.fill_between(times, low, high, color=color, alpha=0.15, linewidth=0)
    ax.set_xlabel("time [s]" if timed else "step k", fontsize=9.5, color=INK)
    ax.set_ylabel("state", fontsize=9.5, color=INK)
    ax.grid(True, color="#e4e4e4", linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=8.5, colors=INK, width=0.7)
    if states.shape[1] <= LISTED:
        ax.legend(fontsize=8.5, frameon=False, labelcolor=INK)
    return ax
