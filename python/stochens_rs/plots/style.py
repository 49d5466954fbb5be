"""Colours for light and dark backgrounds, texts of numbers, new figures and their files.

A figure follows matplotlib's own settings (``plt.style.use("dark_background")``) and the axes it is
given: on a dark face the ink is light. In a notebook, while sphinx-gallery runs, or if pyplot is
loaded with a backend that opens windows, new figures belong to pyplot, which shows and closes them.
Elsewhere no global state of matplotlib changes. matplotlib is an optional dependency and is
imported inside the functions.
"""

from __future__ import annotations

import os
import sys
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from .._base import validation
from .._base.running import in_ipython
from .._base.tables import extra
from .._base.types import Axes, Figure, SubFigure
from ..exceptions import InputError, InputTypeError

# The palette of Okabe and Ito (2008), distinct for all colour vision.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#222222")
SMALL, TEXT, TITLE = 8.5, 9.5, 10.5  # points: ticks and notes, names of axes, titles


class Palette(NamedTuple):
    """What is drawn on one kind of background."""

    ink: str
    pale: str
    grid: str
    face: str  # inside open markers
    fill: float  # opacity of bands
    colors: tuple[str, ...]

    def color(self, k: int) -> str:
        """The colour of the k-th line."""
        return self.colors[k % len(self.colors)]


LIGHT = Palette("#222222", "#6b6b6b", "#e4e4e4", "#ffffff", 0.18, COLORS)
# The same hues, lighter, in the same order.
DARK = Palette(
    "#f2f2f2", "#a8a8a8", "#3d3d3d", "#111111", 0.3,
    ("#3E9BDB", "#F07A3A", "#12B886", "#F7C948", "#A5DCFF", "#E08FC0", "#f2f2f2"),
)  # fmt: skip


def require_matplotlib() -> None:
    """Raise an ImportError that names the extra if matplotlib is missing."""
    with extra("figures need matplotlib"):
        import matplotlib  # noqa: F401


def look_of(where: Axes | Figure | SubFigure) -> Palette:
    """`DARK` where the face is dark, or is transparent and matplotlib writes in a light colour."""
    from matplotlib import rcParams

    seen, rest = 0.0, 1.0
    for one in _outwards(where):
        light, alpha = _light(one.get_facecolor())
        seen, rest = seen + rest * alpha * light, rest * (1.0 - alpha)
    paper = 1.0 - round(_light(rcParams["text.color"])[0])
    return DARK if seen + rest * paper < 0.5 else LIGHT


def root_of(where: Any) -> Figure:
    """The figure that holds axes or a subfigure."""
    found: Figure = _outwards(where)[-1]
    return found


def _outwards(where: Any) -> list[Any]:
    """Axes, subfigure, figure."""
    found = [where]
    while (around := getattr(found[-1], "figure", None)) not in (None, found[-1]):
        found.append(around)
    return found


def _light(color: Any) -> tuple[float, float]:
    """Luma of a colour in 0 .. 1, and its opacity."""
    from matplotlib.colors import to_rgba

    red, green, blue, alpha = to_rgba(color)
    return 0.299 * red + 0.587 * green + 0.114 * blue, alpha


# Backends that write files: pyplot would keep the figures open without showing them.
_FILES = ("agg", "cairo", "pdf", "pgf", "ps", "svg", "template")


def new_figure(width: float, height: float) -> Figure:
    """Return a new figure, sizes in inches, with the background of matplotlib's settings.

    If pyplot shows figures, in a notebook or on a screen, the figure belongs to pyplot.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    layout = ConstrainedLayoutEngine(w_pad=0.09, h_pad=0.06, wspace=0.05)
    look: dict[str, Any] = {"figsize": (width, height), "layout": layout, "facecolor": None}
    if _pyplot_shows():
        import matplotlib.pyplot as plt

        seen: Any = plt.figure(**look)
        seen._repr_mimebundle_ = partial(_close, seen)
        return seen  # type: ignore[no-any-return]
    made = Figure(**look)
    FigureCanvasAgg(made)
    return made


def axes_or_new(ax: Axes | None) -> Axes:
    """Return `ax`, or axes on a new figure."""
    require_matplotlib()
    from matplotlib.axes import Axes

    if ax is not None:
        return validation.instance("ax", ax, Axes)
    return new_figure(5.6, 4.2).add_subplot()


def add_labels(ax: Axes, across: str, up: str) -> None:
    """Name the axes, with units; a pale grid behind the data, and no frame above and right."""
    from matplotlib.ticker import FixedFormatter, FuncFormatter, StrMethodFormatter

    look = look_of(ax)
    ax.set_xlabel(across, fontsize=TEXT, color=look.ink)
    ax.set_ylabel(up, fontsize=TEXT, color=look.ink)
    ax.tick_params(which="both", labelsize=SMALL, colors=look.ink, width=0.7)
    ax.grid(True, which="major", color=look.grid, linewidth=0.7)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["bottom", "left"]].set(color=look.pale, linewidth=0.7)
    for axis in (ax.xaxis, ax.yaxis):
        chosen = FixedFormatter, FuncFormatter, StrMethodFormatter
        if isinstance(axis.get_major_formatter(), chosen):
            continue
        axis.set_major_formatter(number_text)
        if axis.get_scale() == "log":
            axis.set_minor_formatter(partial(_between, axis))


def add_band(ax: Axes, times: Any, low: Any, high: Any, color: str, **how: Any) -> None:
    """A pale band between two curves, or up to a number."""
    ax.fill_between(times, low, high, color=color, alpha=look_of(ax).fill, linewidth=0, **how)


def add_target(ax: Axes, across: float, up: float, **how: Any) -> list[Any]:
    """A cross where states should go."""
    marker: dict[str, Any] = {"marker": "x", "markersize": 8, "mew": 1.8, "linestyle": ""}
    return ax.plot(across, up, color=look_of(ax).ink, label="target", **marker, **how)


def add_key(where: Axes | Figure | SubFigure, **how: Any) -> None:
    """A legend in the ink of axes or of a figure."""
    where.legend(**{"fontsize": SMALL, "frameon": False, "labelcolor": look_of(where).ink, **how})


def number_text(value: float, place: object = None) -> str:
    """0.001, 0.25, 10 000, and powers of ten beyond."""
    size = abs(value)
    if size != 0.0 and not 9.99e-5 < size < 1e6:
        digits, power = f"{value:.3e}".split("e")
        digits, power = digits.rstrip("0").rstrip("."), f"10^{{{int(power)}}}"
        sign = "-" if value < 0 else ""
        return f"${sign}{power}$" if digits in ("1", "-1") else rf"${digits} \cdot {power}$"
    text = f"{value:,.10g}".replace(",", "" if size < 1e4 else "\u2009")
    return text.replace("-", "\u2212")


def _between(axis: Any, value: float, place: object = None) -> str:
    """2 and 5 times powers of ten, on a logarithmic axis of less than 1.5 decades."""
    low, high = sorted(axis.get_view_interval())
    short = low > 0.0 and high < 10.0**1.5 * low
    return number_text(value) if short and f"{value:.0e}"[0] in "25" else ""


def readable(color: str, look: Palette) -> str:
    """`color`, mixed with ink until text in it has the contrast 4.5 of WCAG on the face."""
    mixed = (blend(color, look.ink, share / 10) for share in range(11))
    return next((one for one in mixed if contrast(one, look.face) >= 4.5), look.ink)


def blend(color: str, other: str, share: float) -> str:
    """`color`, with a share of the other."""
    from matplotlib.colors import to_hex, to_rgb

    pairs = zip(to_rgb(color), to_rgb(other), strict=True)
    red, green, blue = ((1.0 - share) * one + share * two for one, two in pairs)
    return str(to_hex((red, green, blue)))


def contrast(one: Any, other: Any) -> float:
    """The contrast of two colours as WCAG 2.2 defines it, 1 to 21."""
    from matplotlib.colors import to_rgb

    def luminance(color: Any) -> float:
        linear = [
            c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(color)
        ]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def literal(name: str) -> str:
    """A user's name as text on one line: no mathematics, and not hidden from legends."""
    line = " ".join(name.split())
    short = line if len(line) <= 40 else f"{line[:39]}…"
    return f"{' ' if short.startswith('_') else ''}{short}".replace("$", r"\$")


def _pyplot_shows() -> bool:
    """Whether the user is in IPython or has loaded pyplot, and its backend shows figures."""
    if not in_ipython() and "matplotlib.pyplot" not in sys.modules:
        return False
    if "sphinx_gallery.gen_rst" in sys.modules:  # it collects the figures of pyplot
        return True
    import matplotlib

    return matplotlib.get_backend().lower() not in _FILES


def _close(figure: Figure, include: object = None, exclude: object = None) -> None:
    """Close a figure when IPython displays it, so that pyplot does not show it again."""
    import matplotlib.pyplot as plt

    plt.close(figure)


DPI = 200  # sharp at the width of a printed page
SUFFIXES = ("png", "svg")


def save(
    drawn: Figure | SubFigure | Axes, path: str | os.PathLike[str], *, dpi: int = DPI
) -> list[Path]:
    """Write a figure as ``<path>.png`` and ``<path>.svg``, and return both paths.

    Parameters
    ----------
    drawn : matplotlib Figure or Axes
        What a `plot` method returned; of axes their whole figure.
    path : path
        Without an ending; with ``.png`` or ``.svg`` the same two files. Its directory must exist.
    dpi : int, default 200
        Pixels per inch of the PNG.

    Returns
    -------
    list of Path

    Raises
    ------
    InputError, InputTypeError
        If `drawn` is not a figure or axes, or `path` has no name.
    ImportError
        If matplotlib is not installed.

    Notes
    -----
    The files carry no date and no random identifiers: the same figure gives the same bytes. The
    background is that of the figure.

    Examples
    --------
    >>> import tempfile, stochens_rs as se
    >>> path = se.simulate(([[0.5]], [[1.0]]), [0.0], [[1.0], [0.0]])
    >>> with tempfile.TemporaryDirectory() as there:
    ...     [one.name for one in se.plots.save(path.plot(), f"{there}/path")]
    ['path.png', 'path.svg']
    """
    require_matplotlib()
    import matplotlib
    from matplotlib.artist import Artist

    if not isinstance(drawn, Artist) or not hasattr(root_of(drawn), "savefig"):
        raise InputTypeError(f"`drawn` must be a figure or axes, got {validation.show(drawn)}")
    to = Path(path)
    if not to.name:
        raise InputError(f"`path` must name a file, got {validation.show(str(path))}")
    name = to.stem if to.suffix.lower().removeprefix(".") in SUFFIXES else to.name
    paths = [to.with_name(f"{name}.{suffix}") for suffix in SUFFIXES]
    for one in paths:
        metadata = {"Date": None} if one.suffix == ".svg" else {"Software": None}
        with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):
            root_of(drawn).savefig(one, dpi=dpi, metadata=metadata, facecolor="auto")
    return paths


def save_figures(
    figures: dict[str, Figure], directory: str | os.PathLike[str], *, dpi: int = DPI
) -> list[Path]:
    """Write each figure by `save` as ``<name>.png`` and ``<name>.svg``, and return the paths.

    Parameters
    ----------
    figures : dict of str to matplotlib Figure
        By file name.
    directory : path
        Must exist.
    dpi : int, default 200
        Pixels per inch of the PNG.

    Returns
    -------
    list of Path
        Of each figure the PNG, then the SVG.

    Raises
    ------
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import stochens_rs as se, tempfile
    >>> figure = se.simulate(([[0.5]], [[1.0]]), [0.0], [[1.0]]).plot().figure
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [path.name for path in se.plots.save_figures({"run": figure}, folder)]
    ['run.png', 'run.svg']
    """
    to = Path(directory)
    return [path for name, one in figures.items() for path in save(one, to / name, dpi=dpi)]
