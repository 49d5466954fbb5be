"""Figure of medians and bands over replicates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .style import COLORS, INK, add_grid, add_labels, axes_or_new

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_DECADES = 1.0  # positive values over more than this have a logarithmic axis
_MARKERS = "os^vDPX"


class Line(NamedTuple):
    """One line of a figure, with its band."""

    label: str | None
    low: Floats
    middle: Floats
    high: Floats
    look: dict[str, Any]  # how matplotlib is to draw it, if not as the others


def draw_bands(
    across: Sequence[Any], lines: Sequence[Line], x: str, y: str, title: str, ax: Axes | None
) -> Axes:
    """Draw each line over `across`: numbers, or texts, which are set side by side."""
    ax = axes_or_new(ax)
    numbers = all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in across)
    at = np.asarray(across if numbers else range(len(across)), dtype=np.float64)
    order = np.argsort(at)
    for k, line in enumerate(lines):
        own = {"color": COLORS[k % len(COLORS)], "marker": _MARKERS[k % len(_MARKERS)]}
        look = own | line.look
        ax.plot(at[order], line.middle[order], label=line.label, lw=1.6, ms=4, **look)
        ax.fill_between(
            at[order],
            line.low[order],
            line.high[order],
            color=look["color"],
            alpha=0.15,
            linewidth=0,
        )
    if numbers and _wide(at):
        ax.set_xscale("log")
    if lines and _wide(np.concatenate([part for line in lines for part in line[1:4]])):
        ax.set_yscale("log")
    if not numbers:
        ax.set_xticks(at, [str(one) for one in across])
    add_labels(ax, x, y)
    add_grid(ax)
    if title:
        ax.set_title(title, loc="left", fontsize=9.5, color=INK)
    if any(line.label is not None for line in lines):
        ax.legend(fontsize=8.5, frameon=False, labelcolor=INK)
    return ax


def _wide(values: Floats) -> bool:
    """Whether finite values are positive and spread over more than a decade."""
    seen = values[np.isfinite(values)]
    return bool(seen.size and seen.min() > 0 and np.log10(seen.max() / seen.min()) > _DECADES)
