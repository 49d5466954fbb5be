"""Labels at the ends of lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .style import SMALL, look_of, readable, root_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

MOST = 6  # lines that are labelled at their ends; more need a legend
_ID = "stochens-end"
_GAP = 1.25 * SMALL  # points from line to line of text


def label_ends(ax: Axes, lines: Sequence[Line2D]) -> bool:
    """Write the labels of lines beside their last points in sight, apart from each other.

    They follow when the range of an axis changes. Returns False, and writes nothing, if there are
    too many, or the layout of the figure makes no room for them: then a legend has to do it.
    """
    root = root_of(ax)
    room = ax.get_window_extent().height * 72.0 / root.dpi
    count = len(lines) + sum(text.get_gid() == _ID for text in ax.texts)
    finite = all(np.isfinite(line.get_xydata()[-1]).all() for line in lines)  # type: ignore[index]
    if not (finite and 0 < count <= min(MOST, room / _GAP)) or root.get_layout_engine() is None:
        return False
    look = look_of(ax)
    pairs = []
    for line in lines:
        color = readable(str(line.get_color()), look)
        text = ax.annotate(
            str(line.get_label()), (0.0, 0.0), (5.0, 0.0), textcoords="offset points",
            va="center", gid=_ID, fontsize=SMALL, color=color, annotation_clip=False,
        )  # fmt: skip
        pairs.append((text, np.asarray(line.get_xydata(), dtype=np.float64)))

    def move(_: object = None) -> None:
        low, high = np.sort(np.stack([ax.get_xlim(), ax.get_ylim()]), axis=1).T
        for text, points in pairs:
            seen = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
            text.set_visible(bool(seen.size))
            if seen.size:
                text.xy = float(points[seen[-1], 0]), float(points[seen[-1], 1])
        _spread(ax)

    move()
    ax.callbacks.connect("xlim_changed", move)
    ax.callbacks.connect("ylim_changed", move)
    return True


def _spread(ax: Axes) -> None:
    """Move the labels up and down, so that none covers another one."""
    texts: list[Any] = [t for t in ax.texts if t.get_gid() == _ID and t.get_visible()]
    points: list[Any] = [ax.transData.transform(text.xy) for text in texts]
    at = [float(point[1]) * 72.0 / root_of(ax).dpi for point in points]
    for text, was, now in zip(texts, at, _apart(at, _GAP), strict=True):
        text.set_position((5.0, now - was))


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
