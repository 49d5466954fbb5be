"""Figure of medians and bands over replicates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._base.types import Floats
from .ends import label_ends
from .style import add_grid, add_key, add_labels, axes_or_new, look_of, number_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_DECADES = 1.0  # positive values over more than this have a logarithmic axis
_MARKERS = "os^vDPX"
_TICKS = 6  # most values on a logarithmic axis that have a tick each


class Line(NamedTuple):
    """One line of a figure, with its band."""

    label: str | None
    low: Floats
    middle: Floats
    high: Floats
    look: dict[str, Any]  # how matplotlib is to draw it, if not as the others


def draw_bands(
    across: Sequence[Any], lines: Sequence[Line], x: str, y: str, band: str, ax: Axes | None
) -> Axes:
    """Draw each line over `across`: numbers, or texts, which are set side by side.

    The legend says what the `band` is.
    """
    ax = axes_or_new(ax)
    from matplotlib.patches import Patch

    theme = look_of(ax)
    handles: list[Any] = []
    numbers = all(isinstance(one, (int, float)) and not isinstance(one, bool) for one in across)
    at = np.asarray(across if numbers else range(len(across)), dtype=np.float64)
    order = np.argsort(at)
    for k, line in enumerate(lines):
        own = {"color": theme.color(k), "marker": _MARKERS[k % len(_MARKERS)]}
        look = own | line.look
        look["color"] = theme.like(look["color"])
        handles += ax.plot(at[order], line.middle[order], label=line.label, lw=1.6, ms=4, **look)
        ax.fill_between(
            at[order],
            line.low[order],
            line.high[order],
            color=look["color"],
            alpha=theme.fill,
            linewidth=0,
        )
    if numbers and _wide(at):
        ax.set_xscale("log")
    if lines and _wide(np.concatenate([part for line in lines for part in line[1:4]])):
        ax.set_yscale("log")
    if not numbers:
        ax.set_xticks(at, [str(one) for one in across])
        ax.margins(x=0.15)
    elif len(at) <= _TICKS and _wide(at):
        ax.set_xticks(at, [number_text(one) for one in at])
        ax.minorticks_off()
    add_labels(ax, x, y)
    add_grid(ax)
    named = [line for line in handles if not line.get_label().startswith("_")]
    if len(at) > 1 and numbers and label_ends(ax, named):
        named = []
    grey = Patch(color=theme.ink, alpha=theme.fill, linewidth=0, label=band)
    add_key(ax, handles=[*named, grey] if band else named)
    return ax


def _wide(values: Floats) -> bool:
    """Whether finite values are positive and spread over more than a decade."""
    seen = values[np.isfinite(values)]
    return bool(seen.size and seen.min() > 0 and np.log10(seen.max() / seen.min()) > _DECADES)
