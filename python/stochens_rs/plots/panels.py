"""One panel for each state or input over time; inputs as steps within their limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .style import COLORS, INK, PALE, add_grid, add_labels, literal, new_figure

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

PANELS = 12  # most states, and most inputs, that are drawn
BAND: dict[str, Any] = {"color": PALE, "alpha": 0.16, "linewidth": 0, "label": "limits"}
WIDE = 30.0  # ranges of an input up to which all of its limits are seen
SEEN = 3.0  # how far tubes and limits may go beyond the curves, in ranges of these


class Inputs(NamedTuple):
    """Inputs `u` (K, m) with their names and limits (K, m), which may be infinite.

    `held` (K,) are those that were held without a state.
    """

    u: Floats
    names: Sequence[str]
    low: Floats
    high: Floats
    held: NDArray[np.bool_] | None = None


def panel_grid(count: int) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels and room for a legend above them."""
    columns = min(count, 2 if count in (2, 4) else 3)
    rows = -(-count // columns)
    figure = new_figure(1.2 + 3.4 * columns, 0.9 + 2.3 * rows, header=0.4, footer=0.0)
    return figure, [figure.add_subplot(rows, columns, i + 1) for i in range(count)]


def extent(values: Floats) -> tuple[float, float, float]:
    """Least and largest of the finite values, and a length beside which others are far away."""
    finite = values[np.isfinite(values)]
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
            ax.fill_between(times, below, above, step="post", **BAND)
        else:
            ax.fill_between(times, below, above, **BAND)
    return floor, top


def draw_inputs(panels: Sequence[Axes], given: Inputs, dt: float | None) -> None:
    """Draw each input as steps: its limits a grey band, thick where it is at one of them."""
    u = given.u
    times = np.arange(len(u) + 1) * (1.0 if dt is None else dt)
    at_limit = (u <= given.low) | (u >= given.high)
    for i, ax in enumerate(panels):
        limits = given.low[:, i], given.high[:, i]
        ends = np.concatenate([side[np.isfinite(side)] for side in limits])
        least, most, far = extent(u[:, i])
        if ends.size and (np.ptp(ends) <= WIDE * (most - least) or most == least):
            far = max(far, float(np.abs(ends - least).max()))
        floor, top = draw_limits(ax, times, limits, (least, most, far))
        ax.stairs(u[:, i], times, baseline=None, color=COLORS[2], linewidth=1.4, label="input")
        if at_limit[:, i].any():
            thick = np.where(at_limit[:, i], u[:, i], np.nan)
            ax.stairs(
                thick, times, baseline=None, color=COLORS[2], linewidth=4.0, label="at its limit"
            )
        if given.held is not None and given.held.any():
            middle = (times[:-1] + times[1:]) / 2.0
            ax.plot(
                middle[given.held], u[given.held, i], "o", color=INK, markerfacecolor="white",
                markersize=4.5, label="held",
            )  # fmt: skip
        frame(ax, floor, top, SEEN * (top - floor) or 1.0, dt, given.names[i])


def add_legend(figure: Figure) -> None:
    """Say above all panels what is drawn in any of them."""
    found: dict[str, Artist] = {}
    for ax in figure.axes:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(
        list(found.values()), list(found), loc="upper left", ncols=max(4, len(found)),
        frameon=False, fontsize=9, labelcolor=INK,
    )  # fmt: skip
