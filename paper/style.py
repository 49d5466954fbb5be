"""Colours and new figures; matplotlib is imported inside the functions."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The palette of Okabe and Ito (2008), distinct for all colour vision.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#222222")
INK = "#222222"
PALE = "#6b6b6b"
GRID = "#e4e4e4"


def new_figure(width: float, height: float, *, header: float, footer: float) -> Figure:
    """A figure for files; sizes in inches, `header` and `footer` are kept free."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    free = (0, footer / height, 1, 1 - (header + footer) / height)
    layout = ConstrainedLayoutEngine(w_pad=0.09, h_pad=0.06, wspace=0.05, rect=free)
    made = Figure(figsize=(width, height), layout=layout, facecolor="white")
    FigureCanvasAgg(made)
    return made


def add_grid(ax: Axes) -> None:
    """Draw a pale grid behind the data, no frame at the top and the right."""
    ax.grid(True, which="major", color=GRID, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["bottom", "left"]].set(color=PALE, linewidth=0.7)
