"""Labels at the ends of lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .style import SMALL, look_of, readable, root_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST = 6  # lines that are labelled at their ends; more need a legend
_ID = "stochens-end"
_GAP = 1.25 * SMALL  # points from line to line of text


def label_ends(ax: Axes, ends: Sequence[tuple[float, float, str, str]]) -> bool:
    """Write texts beside the ends (x, y, text, color) of lines, apart from each other.

    Returns False, and writes nothing, if there are too many, an end is not finite, or the layout
    of the figure makes no room for them: then a legend has to do it.
    """
    root = root_of(ax)
    room = ax.get_window_extent().height * 72.0 / root.dpi
    there: list[Any] = [text for text in ax.texts if text.get_gid() == _ID]
    count = len(there) + len(ends)
    finite = all(math.isfinite(x) and math.isfinite(y) for x, y, *_ in ends)
    if not (finite and 0 < count <= min(MOST, room / _GAP)) or root.get_layout_engine() is None:
        return False
    look = look_of(ax)
    for x, y, text, color in ends:
        there.append(
            ax.annotate(
                text, (x, y), (5.0, 0.0), textcoords="offset points", va="center", gid=_ID,
                fontsize=SMALL, color=readable(color, look), annotation_clip=False,
            )
        )  # fmt: skip
    ax.get_ylim()  # matplotlib sets the range when it is asked for
    ax.autoscale_view()
    points: list[Any] = [ax.transData.transform(text.xy) for text in there]
    at = [float(point[1]) * 72.0 / root.dpi for point in points]
    for text, was, now in zip(there, at, _apart(at, _GAP), strict=True):
        text.set_position((5.0, now - was))
    return True


def _apart(at: Sequence[float], gap: float) -> list[float]:
    """The nearest places in the same order that are `gap` apart: means of blocks that collide."""
    order = sorted(range(len(at)), key=lambda i: at[i])
    blocks: list[list[float]] = []  # sum of the places without their gaps, number
    for k, i in enumerate(order):
        blocks.append([at[i] - k * gap, 1.0])
        while len(blocks) > 1 and blocks[-2][0] / blocks[-2][1] > blocks[-1][0] / blocks[-1][1]:
            total, number = blocks.pop()
            blocks[-1] = [blocks[-1][0] + total, blocks[-1][1] + number]
    level = [total / number for total, number in blocks for _ in range(int(number))]
    found = [0.0] * len(at)
    for k, i in enumerate(order):
        found[i] = level[k] + k * gap
    return found
