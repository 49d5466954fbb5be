"""The figure of a trace. Used by `Trace.plot` alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..studies.figures import INK, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..streams.records import Trace


def draw_trace(trace: Trace, ax: Axes | None) -> Axes:
    """Error and certificate over the steps."""
    if ax is None:
        ax = new_figure(5.6, 4.2, header=0.0, footer=0.0).add_subplot()
    ax.set_xscale("log")
    ax.set_yscale("log")
    curves = (  # where they agree, the dashes of the certificate show both
        (trace.errors, "error", "#0072B2", "-"),
        (trace.certificates, "certificate", "#D55E00", "--"),
    )
    for values, label, color, line in curves:
        shown = (trace.steps > 0) & (values > 0.0)  # nan is not
        if shown.any():
            ax.plot(trace.steps[shown], values[shown], line, color=color, label=label, lw=1.6)
    ax.set_xlabel("step", color=INK)
    ax.set_ylabel(r"$\|B(v - v^*)\|$", color=INK)
    ax.grid(True, which="major", color="#e4e4e4", linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(frameon=False)
    return ax
