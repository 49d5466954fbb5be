"""Figure of measured runs, one over another: a panel for each state and input."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .._base.types import Floats
from .panels import PANELS, extent, frame, panel_grid, tell_omitted
from .style import look_of, root_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure


def draw_runs(
    states: Sequence[Floats],
    inputs: Sequence[Floats],
    names: tuple[Sequence[str], Sequence[str]],
    dt: float | None,
    figure: Figure | SubFigure | None,
) -> Figure:
    """Draw the states (T + 1, n) and inputs (T, m) of each run; lines break where they are nan."""
    counts = {"states": len(names[0]), "inputs": len(names[1])}
    n, m = (min(count, PANELS) for count in counts.values())
    figure, panels = panel_grid(n + m, figure)
    tell_omitted(figure, counts)
    step = 1.0 if dt is None else dt
    opaque = max(0.15, len(states) ** -0.4)  # where many lines cross they add up
    for k, ax in enumerate(panels):
        state = k < n
        i = k if state else k - n
        curves = [one[:, i] for one in (states if state else inputs)]
        for curve in curves:
            # an input holds until the next step
            held = curve if state else np.append(curve, curve[-1])
            ax.plot(
                np.arange(len(held)) * step, held, color=look_of(ax).color(0 if state else 2),
                drawstyle="default" if state else "steps-post", linewidth=1.0, alpha=opaque,
            )  # fmt: skip
        frame(ax, *extent(np.concatenate(curves)), dt, names[0 if state else 1][i])
    return root_of(figure)
