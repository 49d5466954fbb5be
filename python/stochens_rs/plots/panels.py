"""Panels over time: states with a tube, runs, inputs within their limits, calls of a loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._base import validation
from .._base.numbers import most_changing
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
        figure = new_figure(*size)
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


RUNS = 20  # most runs that are drawn one by one


def draw_tube(
    predicted: Floats,
    tube: Floats | None,
    names: Sequence[str],
    *,
    measured: Floats | None = None,
    target: Floats | None = None,
    reference: Floats | None = None,
    limits: tuple[Floats, Floats] | None = None,
    inputs: Inputs | None = None,
    dt: float | None = None,
    says: str = "",
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw each state of `predicted` (K + 1, n) in its panel over time, and then each input.

    Of many those that change most.

    With the `tube` (K + 1,) or (K + 1, n) around it, of which the legend `says` what it is; with
    what was `measured` (K + 1, n), or several of them (R, K + 1, n), many as a band, the `target`
    (n,) at the end, a `reference` (K, n) and `limits` (K, n) of x(1) .. x(K). A tube (K + 1,)
    bounds the distance in the 2-norm, hence each state.
    """
    counts = {"states": predicted.shape[1], "inputs": 0 if inputs is None else inputs.u.shape[1]}
    at = most_changing(predicted, PANELS)
    n, m = len(at), min(counts["inputs"], PANELS)
    runs = np.zeros((0, *predicted.shape)) if measured is None else measured
    runs = runs[None] if runs.ndim == 2 else runs
    times = np.arange(len(predicted)) * (1.0 if dt is None else dt)
    figure, panels = panel_grid(n + m, figure)
    tell_omitted(figure, counts, changing=True)
    for i, ax in zip(at, panels[:n], strict=True):
        shown = np.concatenate([predicted[:, i], runs[:, :, i].ravel()])
        shown = shown if target is None else np.append(shown, target[i])
        shown = shown if reference is None else np.append(shown, reference[:, i])
        floor, top, reach = extent(shown)
        look = look_of(ax)
        if limits is not None:
            sides = limits[0][:, i], limits[1][:, i]
            floor, top = draw_limits(ax, times[1:], sides, (floor, top, reach))
        if tube is not None:  # a wider one leaves the panel
            radius = np.minimum(tube if tube.ndim == 1 else tube[:, i], 10.0 * reach)
            low, high = predicted[:, i] - radius, predicted[:, i] + radius
            floor, top = max(floor - reach, low.min()), min(top + reach, high.max())
            ax.fill_between(
                times, low, high, color=look.color(0), alpha=look.fill, linewidth=0, label=says
            )
        if reference is not None:
            ax.plot(
                times[1:], reference[:, i], "--", color=look.ink, linewidth=1, label="reference"
            )
        ax.plot(times, predicted[:, i], color=look.color(0), linewidth=1.6, label="predicted")
        if len(runs) > RUNS:
            low, middle, high = np.quantile(runs[:, :, i], [0.05, 0.5, 0.95], axis=0)
            band: Any = {"color": look.color(1), "alpha": look.fill, "linewidth": 0}
            ax.fill_between(times, low, high, **band, label=f"90 % of {len(runs)} runs")
            ax.plot(times, middle, "--", color=look.color(1), linewidth=1.2, label="their median")
        for k, run in enumerate(runs if len(runs) <= RUNS else ()):
            ax.plot(
                times, run[:, i], ".", color=look.color(1), markersize=5 if len(runs) == 1 else 4,
                alpha=1.0 if len(runs) == 1 else 0.7, label="measured" if k == 0 else None,
            )  # fmt: skip
        if target is not None:
            ax.plot(
                times[-1],
                target[i],
                "x",
                color=look.ink,
                markersize=8,
                mew=1.8,
                clip_on=False,
                label="target",
            )
        frame(ax, floor, top, reach, dt, names[i])
    if inputs is not None:
        draw_inputs(panels[n:], inputs.some(most_changing(inputs.u, PANELS)), dt)
    add_legend(figure, panels)
    return root_of(figure)


def draw_runs(
    states: Sequence[Floats],
    inputs: Sequence[Floats],
    names: tuple[Sequence[str], Sequence[str]],
    dt: float | None,
    figure: Figure | SubFigure | None,
) -> Figure:
    """Draw the states (T + 1, n) and inputs (T, m) of each run; lines break where they are nan."""
    counts = {"states": len(names[0]), "inputs": len(names[1])}
    n, m = (min(count, PANELS) for count in counts.values())
    figure, panels = panel_grid(n + m, figure)
    tell_omitted(figure, counts)
    step = 1.0 if dt is None else dt
    opaque = max(0.15, len(states) ** -0.4)  # where many lines cross they add up
    for k, ax in enumerate(panels):
        state = k < n
        i = k if state else k - n
        curves = [one[:, i] for one in (states if state else inputs)]
        for curve in curves:
            # an input holds until the next step
            held = curve if state else np.append(curve, curve[-1])
            ax.plot(
                np.arange(len(held)) * step, held, color=look_of(ax).color(0 if state else 2),
                drawstyle="default" if state else "steps-post", linewidth=1.0, alpha=opaque,
            )  # fmt: skip
        frame(ax, *extent(np.concatenate(curves)), dt, names[0 if state else 1][i])
    return root_of(figure)


def draw_calls(
    states: Floats,
    names: Sequence[str],
    inputs: Inputs,
    target: Floats,
    seconds: Floats,
    *,
    dt: float | None = None,
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw each state (T, n), nan where it was not known, each input, and the time of each call.

    `target` (n,) is where the states should go.
    """
    require_matplotlib()
    from matplotlib.ticker import LogLocator

    n, m = (min(count, PANELS) for count in (states.shape[1], inputs.u.shape[1]))
    times = np.arange(len(states)) * (1.0 if dt is None else dt)
    figure, panels = panel_grid(n + m + 1, figure)
    tell_omitted(figure, {"states": states.shape[1], "inputs": inputs.u.shape[1]})
    look = look_of(panels[0])
    for i, ax in enumerate(panels[:n]):
        low, high, far = extent(np.append(states[:, i], target[i]))
        ax.axhline(target[i], color=look.ink, linestyle="--", linewidth=1, label="target")
        ax.plot(
            times,
            states[:, i],
            ".-",
            color=look.color(0),
            linewidth=1.2,
            markersize=4,
            label="state",
        )
        frame(ax, low, high, far, dt, names[i])
    draw_inputs(panels[n : n + m], inputs, dt)
    last = panels[-1]
    last.plot(times, 1e6 * seconds, ".", color=look.color(5), markersize=4)
    last.set_yscale("log")
    last.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    last.minorticks_off()
    add_labels(last, "step k" if dt is None else "time [s]", "time of a call [µs]")
    add_grid(last)
    add_legend(figure, panels)
    return root_of(figure)
