"""Figures of finished experiments: results in, matplotlib objects out.

Nothing is computed here beyond quantiles. Axes are either given or made on a figure of their own.
In a notebook, and where pyplot has been loaded with a backend that opens windows, that figure is
one of pyplot's, which shows and closes it; elsewhere no global state of matplotlib is touched.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from ..studies.figures import INK, draw, heading, legend, new_figure, prepare

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..paper.experiments import Experiment
    from ..paper.verdicts.check import Claims

__all__ = [
    "claims",
    "figure",
    "figures",
    "panel",
    "require_matplotlib",
    "save_figures",
]

DPI = 200
SUFFIXES = ("png", "svg")


def require_matplotlib() -> None:
    """Raise an ImportError that names the extra if matplotlib is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise ImportError(
            "figures need matplotlib: install the extra with `pip install 'stochens_rs[plot]'`"
        ) from error


def panel(experiment: Experiment, name: str, *, ax: Axes | None = None) -> Axes:
    """Draw one panel: median and 10-90 % band of every method, one single run, and the exact
    values.

    Parameters
    ----------
    experiment : Experiment
    name : str
        Which panel ("1a", "2b", ...).
    ax : matplotlib Axes, optional
        Where to draw. Default: new axes on a figure of their own (``ax.figure``), with a legend.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    ImportError
        matplotlib is not installed.
    InputError, InputTypeError
        There is no such panel.

    Notes
    -----
    Both axes are logarithmic. Errors that cannot be told from zero (``panel.zero_level``) have no
    place on a logarithmic axis; they are drawn in a shaded strip below it, on the tick labelled
    0.
    """
    require_matplotlib()
    shown = experiment.panel(name)
    own = None
    if ax is None:
        own = new_figure(5.6, 5.0, header=0.0, footer=1.15)
        ax = own.add_subplot()
    floor = prepare(ax, shown, experiment.sizes)
    for curve in shown.curves:
        draw(ax, curve, experiment.sizes, shown.zero_level, floor)
    if own is not None:
        legend(own, [shown], columns=2)
    return ax


def figure(experiment: Experiment, number: str, *, shown: bool = True) -> Figure:
    """One figure of the paper, its panels side by side under one title and over one legend.

    Parameters
    ----------
    experiment : Experiment
    number : str
        "1" or "2" (power), "3" (tracking).
    shown : bool, default True
        Whether pyplot shows the figure where it can, as in a notebook; False: for files only.

    Returns
    -------
    matplotlib Figure

    Raises
    ------
    ImportError
        matplotlib is not installed.
    KeyError
        The experiment has no such figure.
    """
    require_matplotlib()
    chosen = [p for p in experiment.panels if p.figure == number]
    if not chosen:
        raise KeyError(f"experiment {experiment.name!r} has no figure {number!r}")
    result = new_figure(5.0 * len(chosen), 5.0, header=0.62, footer=0.55, shown=shown)
    for position, one in enumerate(chosen, start=1):
        ax = panel(experiment, one.name, ax=result.add_subplot(1, len(chosen), position))
        ax.set_title(
            f"({one.name[1:]}) {one.quantity}", loc="left", fontsize=10.5, color=INK, pad=7
        )
    heading(result, experiment, number)
    legend(result, chosen)
    return result


def figures(experiment: Experiment, *, shown: bool = True) -> dict[str, Figure]:
    """Every figure of an experiment, by file name: "power-figure-1", ...

    Parameters
    ----------
    experiment : Experiment
    shown : bool, default True
        As in :func:`figure`.

    Returns
    -------
    dict of str to matplotlib Figure
    """
    numbers = dict.fromkeys(p.figure for p in experiment.panels if p.figure is not None)
    return {f"{experiment.name}-figure-{k}": figure(experiment, k, shown=shown) for k in numbers}


def save_figures(
    figures: dict[str, Figure], directory: str | os.PathLike[str], *, dpi: int = DPI
) -> list[Path]:
    """Write each figure as ``<name>.png`` and ``<name>.svg``; returns the paths.

    Parameters
    ----------
    figures : dict of str to matplotlib Figure
        By file name, as :func:`figures` returns them.
    directory : path
        Must exist.
    dpi : int, default 200
        Pixels per inch of the PNG.

    Notes
    -----
    The files carry no date and no random identifiers: the same figure gives the same bytes.
    """
    require_matplotlib()
    import matplotlib

    paths = []
    for name, one in figures.items():
        for suffix in SUFFIXES:
            path = Path(directory) / f"{name}.{suffix}"
            metadata = {"Date": None} if suffix == "svg" else {"Software": None}
            with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):
                one.savefig(path, dpi=dpi, metadata=metadata, facecolor="white")
            paths.append(path)
    return paths


def claims(found: Claims, *, shown: bool = True) -> Figure:
    """Draw the tail bounds, and SLSE against uniform weights.

    Parameters
    ----------
    found : Claims
        What `stochens_rs.claims` returns.
    shown : bool, default True
        As in :func:`figure`.

    Returns
    -------
    matplotlib Figure

    Raises
    ------
    ImportError
        matplotlib is not installed.
    """
    require_matplotlib()
    from ..paper.verdicts.drawing import draw_claims

    return draw_claims(found, shown)
