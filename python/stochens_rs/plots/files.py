"""Save figures to files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from .style import require_matplotlib

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 200  # sharp at the width of a printed page
SUFFIXES = ("png", "svg")


def save_figures(
    figures: dict[str, Figure], directory: str | os.PathLike[str], *, dpi: int = DPI
) -> list[Path]:
    """Write each figure as ``<name>.png`` and ``<name>.svg``, and return the paths.

    Parameters
    ----------
    figures : dict of str to matplotlib Figure
        By file name, as `Experiment.plot` returns them.
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
