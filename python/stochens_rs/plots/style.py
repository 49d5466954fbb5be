"""What all figures have in common: their colours, how they are made, who shows them.

Axes are either given or made on a figure of their own. In a notebook, and where pyplot has been
loaded with a backend that opens windows, that figure is one of pyplot's, which shows and closes
it; elsewhere no global state of matplotlib is touched. matplotlib is an extra: it is imported
inside the functions.
"""

from __future__ import annotations

import sys
from functools import partial
from typing import TYPE_CHECKING, Any

from .._base.extras import extra
from .._base.progress import in_ipython

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = "#222222"
PALE = "#6b6b6b"


def require_matplotlib() -> None:
    """Raise an ImportError that names the extra if matplotlib is missing."""
    with extra("figures need matplotlib"):
        import matplotlib  # noqa: F401


# Backends that write files; pyplot would keep their figures and show them to nobody.
_FILES = ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")


def new_figure(
    width: float, height: float, *, header: float, footer: float, shown: bool = True
) -> Figure:
    """A figure; sizes in inches, `header` and `footer` are kept free.

    Where pyplot shows figures, in a notebook or on a screen, it gets to know this one, unless
    `shown` is False. Elsewhere it does not: nobody would close it.
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


def _pyplot_shows() -> bool:
    """Whether the user is in IPython or has loaded pyplot, and its backend shows figures."""
    if not in_ipython() and "matplotlib.pyplot" not in sys.modules:
        return False
    import matplotlib

    return matplotlib.get_backend().lower() not in _FILES


def _close(figure: Figure, include: object = None, exclude: object = None) -> None:
    """What IPython calls before it displays a figure: pyplot shall not show it once more."""
    import matplotlib.pyplot as plt

    plt.close(figure)
