"""How the errors of a stream over its steps look."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .style import INK, new_figure, require_matplotlib

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


def draw_trace(
    steps: NDArray[np.int64], errors: Floats, certificates: Floats, ax: Axes | None
) -> Axes:
    """Draw errors and certificates over the steps; a logarithmic axis has no place for zeros."""
    require_matplotlib()
    if ax is None:
        ax = new_figure(5.6, 4.2, header=0.0, footer=0.0).add_subplot()
    ax.set_xscale("log")
    ax.set_yscale("log")
    curves = (  # where they agree, the dashes of the certificate show both
        (errors, "error", "#0072B2", "-"),
        (certificates, "certificate", "#D55E00", "--"),
    )
    for values, label, color, line in curves:
        shown = (steps > 0) & (values > 0.0)  # nan is not
        if shown.any():
            ax.plot(steps[shown], values[shown], line, color=color, label=label, lw=1.6)
    ax.set_xlabel("step", color=INK)
    ax.set_ylabel(r"$\|B(v - v^*)\|$", color=INK)
    ax.grid(True, which="major", color="#e4e4e4", linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(frameon=False)
    return ax
