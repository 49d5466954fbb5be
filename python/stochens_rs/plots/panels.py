"""Panels over time: states with a tube, runs, inputs within their limits, calls of a loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .._base import validation
from .._base.types import Axes, Figure, Floats, NDArray, SubFigure, most_changing
from . import style

if TYPE_CHECKING:
    from matplotlib.artist import Artist


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


def panel_grid(
    count: int, figure: Figure | SubFigure | None, columns: int | None = None
) -> tuple[Figure | SubFigure, list[Axes]]:
    """`count` panels in `figure`, or in a new one; a legend gets its room above them."""
    style.require_matplotlib()
    from matplotlib.figure import FigureBase

    columns = columns or min(count, 2 if count in (2, 4) else 3)
    rows = -(-count // columns)
    if figure is None:
        figure = style.new_figure(1.2 + 3.4 * columns, 0.9 + 2.3 * rows)
    root = style.root_of(validation.instance("figure", figure, FigureBase))
    if root.get_layout_engine() is None:
        root.set_layout_engine("constrained")
    return figure, [figure.add_subplot(rows, columns, i + 1) for i in range(count)]


def time_panels(
    figure: Figure | SubFigure | None, n: int, m: int, *, more: int = 0, changing: bool = False
) -> tuple[Figure | SubFigure, list[Axes], list[Axes], list[Axes]]:
    """Panels for n states, for m inputs, and `more`; what has none is said below all panels."""
    states, inputs = min(n, PANELS), min(m, PANELS)
    figure, panels = panel_grid(states + inputs + more, figure)
    counts = {"states": n, "inputs": m}
    omitted = [f"{PANELS} of {count} {what}" for what, count in counts.items() if count > PANELS]
    if omitted:
        words = f"the first {' and the first '.join(omitted)}"
        if changing:
            words = f"the {' and the '.join(omitted)} that change most"
        ink = style.look_of(panels[0]).ink
        figure.supxlabel(words, fontsize=style.SMALL, color=ink, x=0.01, ha="left")
    return figure, panels[:states], panels[states : states + inputs], panels[states + inputs :]


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
    style.add_labels(ax, clock(dt), style.literal(name))


def clock(dt: float | None) -> str:
    """The name of the axis of times."""
    return "step k" if dt is None else "time [s]"


def draw_limits(
    ax: Axes, times: NDArray[Any], limits: tuple[Floats, Floats], shown: tuple[float, float, float]
) -> tuple[float, float]:
    """Draw what is between two limits as a grey band; return the range that has to be seen.

    `shown` is the `extent` of the curves: limits that are farther away leave the panel. With one
    time more than limits they are steps.
    """
    least, most, far = shown
    look = style.look_of(ax)
    floor, top = least, most
    stepped = len(times) > len(limits[0])
    band, line = ("post", "steps-post") if stepped else (None, "default")
    low, high = (side[np.isfinite(side)] for side in limits)
    if low.size:
        floor = min(floor, max(least - far, float(low.min())))
    if high.size:
        top = max(top, min(most + far, float(high.max())))
    if low.size or high.size:
        pad = far + (top - floor)  # beyond the panel where there is no limit
        sides = [np.append(side, side[-1]) if stepped else side for side in limits]
        below, above = (np.clip(side, floor - pad, top + pad) for side in sides)
        style.add_band(ax, times, below, above, look.pale, step=band, label="limits")
        for side in sides:
            if np.isfinite(side).any():
                edge: Any = {"color": look.pale, "linewidth": 0.8, "zorder": 1.5}
                ax.plot(times, side, drawstyle=line, **edge)
    return floor, top


def draw_inputs(
    panels: Sequence[Axes], given: Inputs, places: Sequence[int], dt: float | None
) -> None:
    """Draw the inputs at `places` as steps: limits a grey band, thick where it is at one of them.

    Also thick, in another colour, where it is at its rate.
    """
    u = given.u
    times = np.arange(len(u) + 1) * (1.0 if dt is None else dt)
    at_limit = (u <= given.low) | (u >= given.high)
    at_rate = np.zeros_like(at_limit) if given.at_rate is None else given.at_rate
    for i, ax in zip(places, panels, strict=True):
        look, limits = style.look_of(ax), (given.low[:, i], given.high[:, i])
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
            mark: Any = {"color": look.ink, "markerfacecolor": look.face, "markersize": 4.5}
            ax.plot(middle[given.held], u[given.held, i], "o", label="held", **mark)
        frame(ax, floor, top, SEEN * (top - floor) or 1.0, dt, given.names[i])


def add_legend(figure: Figure | SubFigure, panels: Sequence[Axes]) -> None:
    """Say above all panels what is drawn in any of them."""
    found: dict[str, Artist] = {}
    for ax in panels:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    wide = max(1, int(figure.bbox.width / style.root_of(figure).dpi / _ENTRY))
    above: dict[str, Any] = {"loc": "outside upper left", "ncols": wide, "labels": list(found)}
    style.add_key(figure, handles=list(found.values()), fontsize=style.TEXT - 0.5, **above)


RUNS = 20  # most runs that are drawn one by one


def draw_tube(
    predicted: Floats,
    tube: tuple[Floats, str] | None,
    names: Sequence[str],
    *,
    measured: Floats | None = None,
    target: Floats | None = None,
    reference: Floats | None = None,
    limits: tuple[Floats, Floats] | None = None,
    inputs: Inputs | None = None,
    dt: float | None = None,
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw each state of `predicted` (K + 1, n) in its panel over time, and then each input.

    Of many those that change most.

    With the `tube`, radii (K + 1,) or (K + 1, n) around it and what the legend says of them; with
    what was `measured` (K + 1, n), or several of them (R, K + 1, n), many as a band, the `target`
    (n,) at the end, a `reference` (K, n) and `limits` (K, n) of x(1) .. x(K). A tube (K + 1,)
    bounds the distance in the 2-norm, hence each state.
    """
    runs = np.zeros((0, *predicted.shape)) if measured is None else measured
    runs = runs[None] if runs.ndim == 2 else runs
    times = np.arange(len(predicted)) * (1.0 if dt is None else dt)
    m = 0 if inputs is None else inputs.u.shape[1]
    figure, panels, others, _ = time_panels(figure, predicted.shape[1], m, changing=True)
    for i, ax in zip(most_changing(predicted, PANELS), panels, strict=True):
        shown = [predicted[:, i], runs[:, :, i].ravel()]
        shown += [np.atleast_1d(one[..., i]) for one in (target, reference) if one is not None]
        floor, top, reach = extent(np.concatenate(shown))
        look = style.look_of(ax)
        if limits is not None:
            sides = limits[0][:, i], limits[1][:, i]
            floor, top = draw_limits(ax, times[1:], sides, (floor, top, reach))
        if tube is not None:  # a wider one leaves the panel
            radii, says = tube
            radius = np.minimum(radii if radii.ndim == 1 else radii[:, i], 10.0 * reach)
            low, high = predicted[:, i] - radius, predicted[:, i] + radius
            floor, top = max(floor - reach, low.min()), min(top + reach, high.max())
            style.add_band(ax, times, low, high, look.color(0), label=says)
        if reference is not None:
            asked: Any = {"color": look.ink, "linewidth": 1, "label": "reference"}
            ax.plot(times[1:], reference[:, i], "--", **asked)
        ax.plot(times, predicted[:, i], color=look.color(0), linewidth=1.6, label="predicted")
        if len(runs) > RUNS:
            low, middle, high = np.quantile(runs[:, :, i], [0.05, 0.5, 0.95], axis=0)
            style.add_band(ax, times, low, high, look.color(1), label=f"90 % of {len(runs)} runs")
            ax.plot(times, middle, "--", color=look.color(1), linewidth=1.2, label="their median")
        size, opaque = (5, 1.0) if len(runs) == 1 else (4, 0.7)
        for run in runs if len(runs) <= RUNS else ():
            dots: Any = {"color": look.color(1), "markersize": size, "alpha": opaque}
            ax.plot(times, run[:, i], ".", label="measured", **dots)
        if target is not None:
            style.add_target(ax, times[-1], target[i], clip_on=False)
        frame(ax, floor, top, reach, dt, names[i])
    if inputs is not None:
        draw_inputs(others, inputs, most_changing(inputs.u, PANELS), dt)
    add_legend(figure, [*panels, *others])
    return style.root_of(figure)


def draw_runs(
    states: Sequence[Floats],
    inputs: Sequence[Floats],
    names: tuple[Sequence[str], Sequence[str]],
    dt: float | None,
    figure: Figure | SubFigure | None,
) -> Figure:
    """Draw the states (T + 1, n) and inputs (T, m) of each run; lines break where they are nan."""
    figure, *panels, _ = time_panels(figure, len(names[0]), len(names[1]))
    opaque = max(0.15, len(states) ** -0.4)  # where many lines cross they add up
    held = [np.vstack([u, u[-1:]]) for u in inputs]  # an input holds until the next step
    styles = ("default", 0), ("steps-post", 2)
    for axes, runs, own, (drawstyle, k) in zip(panels, (states, held), names, styles, strict=True):
        for i, ax in enumerate(axes):
            line: Any = {"color": style.look_of(ax).color(k), "linewidth": 1.0, "alpha": opaque}
            for run in runs:
                times = np.arange(len(run)) * (1.0 if dt is None else dt)
                ax.plot(times, run[:, i], drawstyle=drawstyle, **line)
            frame(ax, *extent(np.concatenate([run[:, i] for run in runs])), dt, own[i])
    return style.root_of(figure)


def draw_calls(
    states: Floats,
    names: Sequence[str],
    inputs: Inputs,
    seconds: Floats,
    *,
    target: Floats,
    predicted: Floats | None = None,
    dt: float | None = None,
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw each state (T, n), nan where it was not known, each input, and the time of each call.

    `target` (n,) or (T, n) is where the states should go, nan where one is free; what was
    `predicted` (T, n) is drawn where a state was not known.
    """
    style.require_matplotlib()
    from matplotlib.ticker import LogLocator

    times = np.arange(len(states)) * (1.0 if dt is None else dt)
    size = states.shape[1], inputs.u.shape[1]
    figure, panels, others, (last,) = time_panels(figure, *size, more=1)
    look, target = style.look_of(last), np.broadcast_to(target, states.shape)
    line: Any = {"color": look.color(0), "linewidth": 1.2, "markersize": 4, "label": "measured"}
    dots: Any = {"color": look.color(1), "markerfacecolor": look.face, "markersize": 4.5}
    wanted: Any = {"color": look.ink, "linewidth": 1, "zorder": 3}
    for i, ax in enumerate(panels):
        instead = np.full(len(states), np.nan)
        if predicted is not None:
            instead = np.where(np.isnan(states[:, i]), predicted[:, i], np.nan)
        low, high, far = extent(np.concatenate([states[:, i], target[:, i], instead]))
        if np.isfinite(target[:, i]).any():
            ax.plot(times, target[:, i], "--", label="target", **wanted)
        ax.plot(times, states[:, i], ".-", **line)
        if np.isfinite(instead).any():
            ax.plot(times, instead, "o", label="predicted, not read", **dots)
        frame(ax, low, high, far, dt, names[i])
    draw_inputs(others, inputs, range(len(others)), dt)
    last.plot(times, 1e6 * seconds, ".", color=look.color(5), markersize=4)
    last.set_yscale("log")
    last.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    last.minorticks_off()
    style.add_labels(last, clock(dt), "time of a call [µs]")
    add_legend(figure, [*panels, *others])
    return style.root_of(figure)
