"""Figure of regions in the plane of two coefficients."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .._base.types import Floats
from .style import add_grid, add_key, add_labels, axes_or_new, literal, look_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_ID = "stochens-region"


def draw_region(
    centre: Floats, corners: Floats, label: str, across: str, up: str, ax: Axes | None
) -> Axes:
    """Draw a polygon (k, 2) and its `centre`, in the next colour of those in `ax`."""
    ax = axes_or_new(ax)
    from matplotlib.patches import Polygon

    look = look_of(ax)
    before = sum(one.get_gid() == _ID for one in ax.patches)
    color = look.color(before)
    face = "none" if before else (color, look.fill / 1.5)  # the colours of two would mix
    edge = Polygon(corners, facecolor=face, edgecolor=color, linewidth=1.6, gid=_ID)
    edge.set_label(literal(label))
    ax.add_patch(edge)
    ax.plot(*centre, "+", color=color, markersize=8, markeredgewidth=1.6, linestyle="")
    add_labels(ax, across, up)
    add_grid(ax)
    ax.autoscale_view()
    if ax.get_legend_handles_labels()[0]:  # matplotlib leaves out empty labels
        add_key(ax, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return ax
