"""One panel for each state or input over time; inputs as steps within their limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._base import validation
from .._base.types import Floats
from .style import (
    SMALL,
    TEXT,
    add_grid,
    add_labels,
    literal,
    look_of,
    new_figure,
    require_matplotlib,
    root_of,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from numpy.typing import NDArray


PANELS = 12  # most states, and most inputs, that are drawn
_ENTRY = 1.3  # inches for an entry of the legend
WIDE = 30.0  # ranges of an input up to which all of its limits are seen
DRAWN = 1e300  # beyond this the ends of an axis overflow
SEEN = 3.0  # how far tubes and limits may go beyond the curves, in ranges of these


class Inputs(NamedTuple):
    """Inputs `u` (K, m) with their names and limits (K, m), which may be infinite.

    `held` (K,) are those that were held without a state, `at_rate` (K, m) those whose change from
    the one before is as large as it may be.
    """

    u: Floats
    names: Sequence[str]
    low: Floats
    high: Floats
    held: NDArray[np.bool_] | None = None
    at_rate: NDArray[np.bool_] | None = None

    def some(self, places: list[int]) -> Inputs:
        """These of the inputs."""
        u, low, high = self.u[:, places], self.low[:, places], self.high[:, places]
        at_rate = None if self.at_rate is None else self.at_rate[:, places]
        return Inputs(u, [self.names[i] for i in places], low, high, self.held, at_rate)


def panel_grid(
    count: int, figure: Figure | SubFigure | None, columns: int | None = None
) -> tuple[Figure | SubFigure, list[Axes]]:
    """`count` panels in `figure`, or in a new one; a legend gets its room above them."""
    require_matplotlib()
    from matplotlib.figure import FigureBase

    columns = columns or min(count, 2 if count in (2, 4) else 3)
    rows = -(-count // columns)
    if figure is None:
        size = 1.2 + 3.4 * columns, 0.9 + 2.3 * rows
        figure = new_figure(*size, header=0.0, footer=0.0, face=None)
    elif root_of(validation.instance("figure", figure, FigureBase)).get_layout_engine() is None:
        root_of(figure).set_layout_engine("constrained")
    return figure, [figure.add_subplot(rows, columns, i + 1) for i in range(count)]


def tell_omitted(
    figure: Figure | SubFigure, counts: dict[str, int], *, changing: bool = False
) -> None:
    """Say below the panels that some states or inputs have none; which ones have."""
    more = [f"{PANELS} of {count} {what}" for what, count in counts.items() if count > PANELS]
    if more:
        words = f"the first {' and the first '.join(more)}"
        if changing:
            words = f"the {' and the '.join(more)} that change most"
        ink = look_of(figure.axes[0]).ink
        figure.supxlabel(words, fontsize=SMALL, color=ink, x=0.01, ha="left")


def extent(values: Floats) -> tuple[float, float, float]:
    """Least and largest of the finite values, and a length beside which others are far away."""
    finite = np.clip(values[np.isfinite(values)], -DRAWN, DRAWN)
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    far = SEEN * max(high - low, 1e-12 + 1e-6 * max(abs(low), abs(high)))
    return low, high, far


def frame(ax: Axes, low: float, high: float, far: float, dt: float | None, name: str) -> None:
    """Set the range of a panel and name its axes."""
    pad = 0.04 * (high - low) + 0.01 * far
    ax.set_ylim(low - pad, high + pad)
    add_labels(ax, "step k" if dt is None else "time [s]", literal(name))
    add_grid(ax)


def draw_limits(
    ax: Axes, times: NDArray[Any], limits: tuple[Floats, Floats], shown: tuple[float, float, float]
) -> tuple[float, float]:
    """Draw what is between two limits as a grey band; return the range that has to be seen.

    `shown` is the `extent` of the curves: limits that are farther away leave the panel. With one
    time more than limits they are steps.
    """
    least, most, far = shown
    look = look_of(ax)
    band: Any = {"color": look.pale, "alpha": look.fill, "linewidth": 0, "label": "limits"}
    edge: Any = {"color": look.pale, "linewidth": 0.8}
    floor, top = least, most
    low, high = (side[np.isfinite(side)] for side in limits)
    if low.size:
        floor = min(floor, max(least - far, float(low.min())))
    if high.size:
        top = max(top, min(most + far, float(high.max())))
    if low.size or high.size:
        pad = far + (top - floor)  # beyond the panel where there is no limit
        below, above = (np.clip(side, floor - pad, top + pad) for side in limits)
        if len(times) > len(below):
            below, above = np.append(below, below[-1]), np.append(above, above[-1])
            ax.fill_between(times, below, above, step="post", **band)
        else:
            ax.fill_between(times, below, above, **band)
        for side in limits:
            if np.isfinite(side).any():
                drawn = np.append(side, side[-1]) if len(times) > len(side) else side
                how = "steps-post" if len(times) > len(side) else "default"
                ax.plot(times, drawn, drawstyle=how, zorder=1.5, **edge)
    return floor, top


def draw_inputs(panels: Sequence[Axes], given: Inputs, dt: float | None) -> None:
    """Draw each input as steps: its limits a grey band, thick where it is at one of them.

    Also thick, in another colour, where it is at its rate.
    """
    u = given.u
    times = np.arange(len(u) + 1) * (1.0 if dt is None else dt)
    at_limit = (u <= given.low) | (u >= given.high)
    at_rate = np.zeros_like(at_limit) if given.at_rate is None else given.at_rate
    for i, ax in enumerate(panels):
        look, limits = look_of(ax), (given.low[:, i], given.high[:, i])
        ends = np.concatenate([side[np.isfinite(side)] for side in limits])
        least, most, far = extent(u[:, i])
        if ends.size and (np.ptp(ends) <= WIDE * (most - least) or most == least):
            far = max(far, float(np.abs(ends - least).max()))
        floor, top = draw_limits(ax, times, limits, (least, most, far))
        ax.stairs(u[:, i], times, baseline=None, color=look.color(2), linewidth=1.4, label="input")
        for where, color, label in (
            (at_rate & ~at_limit, look.color(1), "at its rate"),
            (at_limit, look.color(2), "at its limit"),
        ):
            if where[:, i].any():
                thick = np.where(where[:, i], u[:, i], np.nan)
                ax.stairs(thick, times, baseline=None, color=color, linewidth=4.0, label=label)
        if given.held is not None and given.held.any():
            middle = (times[:-1] + times[1:]) / 2.0
            ax.plot(
                middle[given.held], u[given.held, i], "o", color=look.ink, label="held",
                markerfacecolor=look.face, markersize=4.5,
            )  # fmt: skip
        frame(ax, floor, top, SEEN * (top - floor) or 1.0, dt, given.names[i])


def add_legend(figure: Figure | SubFigure, panels: Sequence[Axes]) -> None:
    """Say above all panels what is drawn in any of them."""
    found: dict[str, Artist] = {}
    for ax in panels:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    wide = figure.bbox.width / root_of(figure).dpi
    figure.legend(
        list(found.values()), list(found), loc="outside upper left", frameon=False,
        ncols=max(1, int(wide / _ENTRY)), fontsize=TEXT - 0.5, labelcolor=look_of(panels[0]).ink,
    )  # fmt: skip
