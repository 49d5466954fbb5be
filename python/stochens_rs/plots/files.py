"""Save figures as PNG and SVG."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from .._base import validation
from ..exceptions import InputError, InputTypeError
from .style import require_matplotlib, root_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

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
        raise InputTypeError(
            f"`drawn` must be a figure or axes of matplotlib, got {validation.show(drawn)}"
        )
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
    """
    require_matplotlib()
    at = Path(directory)
    return [path for name, one in figures.items() for path in save(one, at / name, dpi=dpi)]
