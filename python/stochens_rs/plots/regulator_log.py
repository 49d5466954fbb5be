"""Figure of a feedback that runs: its states, its inputs within their limits, its time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .._base.types import Floats
from .panels import PANELS, Inputs, add_legend, draw_inputs, extent, frame, panel_grid, tell_omitted
from .style import add_grid, add_labels, look_of, require_matplotlib, root_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


def draw_calls(
    states: Floats,
    names: Sequence[str],
    inputs: Inputs,
    target: Floats,
    seconds: Floats,
    *,
    dt: float | None = None,
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw each state (T, n), nan where it was not known, each input, and the time of each call.

    `target` (n,) is where the states should go.
    """
    require_matplotlib()
    from matplotlib.ticker import LogLocator

    n, m = (min(count, PANELS) for count in (states.shape[1], inputs.u.shape[1]))
    times = np.arange(len(states)) * (1.0 if dt is None else dt)
    figure, panels = panel_grid(n + m + 1, figure)
    tell_omitted(figure, {"states": states.shape[1], "inputs": inputs.u.shape[1]})
    look = look_of(panels[0])
    for i, ax in enumerate(panels[:n]):
        low, high, far = extent(np.append(states[:, i], target[i]))
        ax.axhline(target[i], color=look.ink, linestyle="--", linewidth=1, label="target")
        ax.plot(
            times,
            states[:, i],
            ".-",
            color=look.color(0),
            linewidth=1.2,
            markersize=4,
            label="state",
        )
        frame(ax, low, high, far, dt, names[i])
    draw_inputs(panels[n : n + m], inputs, dt)
    last = panels[-1]
    last.plot(times, 1e6 * seconds, ".", color=look.color(5), markersize=4)
    last.set_yscale("log")
    last.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    last.minorticks_off()
    add_labels(last, "step k" if dt is None else "time [s]", "time of a call [µs]")
    add_grid(last)
    add_legend(figure, panels)
    return root_of(figure)
