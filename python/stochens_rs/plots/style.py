"""Colours, and new figures with or without pyplot.

In a notebook, or if pyplot is loaded with a backend that opens windows, new figures belong to
pyplot, which shows and closes them. Elsewhere no global state of matplotlib changes. matplotlib is
an optional dependency and is imported inside the functions.
"""

from __future__ import annotations

import sys
from functools import partial
from typing import TYPE_CHECKING, Any

from .._base.extras import extra
from .._base.progress import in_ipython

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The palette of Okabe and Ito (2008), distinct for all colour vision.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#222222")
INK = "#222222"
PALE = "#6b6b6b"
GRID = "#e4e4e4"
_SIZE = (5.6, 4.2)  # inches: width and height of a figure with one panel


def require_matplotlib() -> None:
    """Raise an ImportError that names the extra if matplotlib is missing."""
    with extra("figures need matplotlib"):
        import matplotlib  # noqa: F401


# Backends that write files: pyplot would keep the figures open without showing them.
_FILES = ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")


def new_figure(
    width: float, height: float, *, header: float, footer: float, shown: bool = True
) -> Figure:
    """Return a new figure; sizes in inches, `header` and `footer` are kept free.

    If pyplot shows figures, in a notebook or on a screen, the figure belongs to pyplot, unless
    `shown` is False.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    free = (0, footer / height, 1, 1 - (header + footer) / height)
    look: dict[str, Any] = {
        "figsize": (width, height),
        "layout": ConstrainedLayoutEngine(w_pad=0.09, h_pad=0.06, wspace=0.05, rect=free),
        "facecolor": "white",
    }
    if shown and _pyplot_shows():
        import matplotlib.pyplot as plt

        seen: Any = plt.figure(**look)
        seen._repr_mimebundle_ = partial(_close, seen)
        return seen  # type: ignore[no-any-return]
    made = Figure(**look)
    FigureCanvasAgg(made)
    return made


def axes_or_new(ax: Axes | None, width: float = _SIZE[0]) -> Axes:
    """Return `ax`, or axes on a new figure."""
    require_matplotlib()
    return new_figure(width, _SIZE[1], header=0.0, footer=0.0).add_subplot() if ax is None else ax


def add_grid(ax: Axes) -> None:
    """Draw a pale grid behind the data, and no frame at the top and the right."""
    ax.grid(True, which="major", color=GRID, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def add_labels(ax: Axes, across: str, up: str) -> None:
    """Name the axes, with units."""
    ax.set_xlabel(across, fontsize=9.5, color=INK)
    ax.set_ylabel(up, fontsize=9.5, color=INK)
    ax.tick_params(labelsize=8.5, colors=INK, width=0.7)


def literal(name: str) -> str:
    """A user's name as text on one line: no mathematics, and not hidden from legends."""
    line = " ".join(name.split())
    short = line if len(line) <= 40 else f"{line[:39]}…"
    return f"{' ' if short.startswith('_') else ''}{short}".replace("$", r"\$")


def _pyplot_shows() -> bool:
    """Whether the user is in IPython or has loaded pyplot, and its backend shows figures."""
    if not in_ipython() and "matplotlib.pyplot" not in sys.modules:
        return False
    import matplotlib

    return matplotlib.get_backend().lower() not in _FILES


def _close(figure: Figure, include: object = None, exclude: object = None) -> None:
    """Close a figure when IPython displays it, so that pyplot does not show it again."""
    import matplotlib.pyplot as plt

    plt.close(figure)
