"""What data say: radii of a certificate, regions of coefficients, residuals, margins of a loop."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import Any

import numpy as np

from .._base.types import ROUNDING, Axes, Figure, Floats, SubFigure
from . import style
from .panels import panel_grid

_BARS = 12  # most bars of a panel that are drawn


def draw_radii(
    title: str,
    bars: dict[str, float],
    tube: Floats | None,
    components: Floats | None,
    says: str,
    figure: Figure | SubFigure | None,
) -> Figure:
    """Draw the named numbers, the `tube` (K + 1,) and the `components` (n,), each in a panel.

    What is infinite has no bar, and says so. `says` stands above all panels.
    """
    panels = {title: bars}
    if components is not None:
        each = {f"x[{i}]": float(one) for i, one in enumerate(components)}
        panels["distance of each state from xf"] = each
    figure, axes = panel_grid(len(panels) + (tube is not None), figure)
    for ax, (name, values) in zip(axes, panels.items(), strict=False):
        _bars(ax, values, name)
    look = style.look_of(axes[0])
    if tube is not None:
        ax, finite = axes[-1], np.isfinite(tube)
        steps, radii, color = np.flatnonzero(finite), tube[finite], look.color(0)
        style.add_band(ax, steps, radii, 0.0, color)
        ax.plot(steps, radii, "o-", color=color, linewidth=1.6, markersize=3)
        more = "" if finite.all() else f", infinite from step {int(np.argmin(finite))}"
        style.add_labels(ax, f"step k{more}", "radius of the tube")
        ax.set_xlim(0, len(tube) - 1)
        ax.set_ylim(bottom=0.0)
    figure.suptitle(says, fontsize=style.SMALL + 1, color=look.ink, x=0.01, ha="left")
    return style.root_of(figure)


def _bars(ax: Axes, values: dict[str, float], name: str) -> None:
    """A bar for each of the numbers, the first one on top."""
    look, shown = style.look_of(ax), dict(list(values.items())[:_BARS])
    sizes = np.array([size if np.isfinite(size) else 0.0 for size in shown.values()])
    sizes[sizes < ROUNDING * sizes.max(initial=0.0)] = 0.0  # beside the others
    ax.barh(range(len(shown)), sizes, height=0.6, color=look.color(0))
    for k, size in enumerate(shown.values()):
        number = style.number_text(float(f"{sizes[k]:.3g}"))
        text = f" {number}" if np.isfinite(size) else " infinite"
        ax.text(sizes[k], k, text, va="center", fontsize=style.SMALL, color=look.ink)
    ax.set_yticks(range(len(shown)), map(style.literal, shown))
    ax.invert_yaxis()
    ax.margins(x=0.25)
    ax.set_xlim(left=0.0)
    more = f" (the first {_BARS} of {len(values)})" if len(values) > _BARS else ""
    style.add_labels(ax, f"{name}{more}", "")
    ax.grid(visible=False, axis="y")


_ID = "stochens-region"


def draw_region(
    centre: Floats, corners: Floats, label: str, across: str, up: str, ax: Axes | None
) -> Axes:
    """Draw a polygon (k, 2) and its `centre`, in the next colour of those in `ax`."""
    ax = style.axes_or_new(ax)
    from matplotlib.patches import Polygon

    look = style.look_of(ax)
    before = sum(one.get_gid() == _ID for one in ax.patches)
    color = look.color(before)
    face = "none" if before else (color, look.fill / 1.5)  # the colours of two would mix
    edge = Polygon(corners, facecolor=face, edgecolor=color, linewidth=1.6, gid=_ID)
    edge.set_label(style.literal(label))
    ax.add_patch(edge)
    ax.plot(*centre, "+", color=color, markersize=8, markeredgewidth=1.6, linestyle="")
    style.add_labels(ax, across, up)
    ax.autoscale_view()
    if ax.get_legend_handles_labels()[0]:  # matplotlib leaves out empty labels
        style.add_key(ax, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return ax


LAGS = 10
DOTS = 2000  # more hide each other
LISTED = 6  # most states that are drawn
TESTS = {  # whose p-values stand above the panels, by the titles of these
    "Over the pairs": ("change",),
    "Correlation in time": ("correlation in time", "correlation at lag 1"),
    "Tails": ("tails",),
    "Size against leverage": ("heteroscedasticity",),
}


def draw_residuals(
    residuals: Floats,
    leverages: Floats,
    names: Sequence[str],
    p_values: dict[str, float] | None,
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw residuals (N, n) in units of their deviations: time, lags, quantiles, leverages.

    `p_values` by the names of the tests, which go into the titles.
    """
    from matplotlib.lines import Line2D

    figure, panels = panel_grid(len(TESTS), figure)
    over_time, correlation, tails, against = panels
    look, normal = style.look_of(over_time), NormalDist()
    scale = np.sqrt(np.mean(residuals**2, axis=0))
    e = residuals / np.where(scale > 0.0, scale, 1.0)
    sizes, e = np.sqrt(np.mean(e**2, axis=1)), e[:, :LISTED]
    N, n = e.shape
    places = np.unique(np.linspace(0, N - 1, min(N, DOTS)).astype(int))
    dots: dict[str, Any] = {"linestyle": "", "marker": ".", "markersize": 4}
    opaque = 0.8 if len(places) < 300 else 0.5

    lags = np.arange(1, min(LAGS, N - 1) + 1)
    limit = normal.inv_cdf(0.975) / np.sqrt(N)
    correlation.axhspan(-limit, limit, color=look.pale, alpha=look.fill, linewidth=0)
    correlation.axhline(0.0, color=look.pale, linewidth=0.8)
    quantiles = np.array([normal.inv_cdf((k + 0.5) / N) for k in places])
    for i, one in enumerate(e.T):
        color = look.color(i)
        over_time.plot(places, one[places], color=color, alpha=opaque, **dots)
        tails.plot(quantiles, np.sort(one)[places], color=color, alpha=0.8, **dots)
        r = [float(one[lag:] @ one[:-lag]) / float(one @ one or 1.0) for lag in lags]
        at = lags + 0.5 * ((i + 0.5) / n - 0.5)
        correlation.vlines(at, 0.0, r, color=color, linewidth=1.2)
        correlation.plot(at, r, "o", color=color, markersize=3)
    over_time.axhline(0.0, color=look.pale, linewidth=0.8)
    style.add_labels(over_time, "pair", "residual / deviation")
    correlation.set_xticks(lags)
    style.add_labels(correlation, "lag [steps]   (band: 95 % of white noise)", "correlation")
    tails.plot(quantiles[[0, -1]], quantiles[[0, -1]], color=look.ink, linewidth=0.9)
    style.add_labels(tails, "Gaussian quantile", "quantile of the residuals")

    against.plot(leverages[places], sizes[places], color=look.pale, alpha=opaque, **dots)
    order = np.argsort(leverages, kind="stable")
    parts = [part for part in np.array_split(order, 10) if len(part) > 4]
    if len(parts) > 2:
        means = [[np.mean(leverages[p]), np.sqrt(np.mean(sizes[p] ** 2))] for p in parts]
        tenths: dict[str, Any] = {"markersize": 4, "label": "rms in tenths of the data"}
        against.plot(*np.array(means).T, "o-", color=look.ink, linewidth=1.4, **tenths)
        style.add_key(against, loc="upper right")
    against.set_ylim(0.0, 1.2 * against.get_ylim()[1])  # the legend stands above the dots
    against.locator_params(axis="x", nbins=5)  # its numbers are long
    style.add_labels(against, "leverage of x and u", "size / deviation")

    for ax, (title, tests) in zip(panels, TESTS.items(), strict=True):
        values = "" if p_values is None else ", ".join(f"{p_values[one]:.2g}" for one in tests)
        text = f"{title}   p = {values}" if values else title
        ax.set_title(text, loc="left", fontsize=style.TITLE, color=look.ink, pad=7)
    dots |= {"marker": "o", "markersize": 5}
    handles = [
        Line2D([], [], color=look.color(i), label=style.literal(name), **dots)
        for i, name in enumerate(names[:LISTED])
    ]
    style.add_key(figure, handles=handles, loc="outside upper left", ncols=LISTED)
    return style.root_of(figure)


_FAR = 3.0  # largest factor that is drawn


def draw_margins(
    certified: Floats,
    nominal: Floats,
    inputs: Sequence[str],
    says: str,
    figure: Figure | SubFigure | None,
) -> Figure:
    """Draw gains, phase and disk of each input from tables (m, 4), those of the model dashed."""
    figure, axes = panel_grid(len(inputs), figure)
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    for ax, name, *both in zip(axes, inputs, certified, nominal, strict=False):
        look = style.look_of(ax)
        ax.plot(np.cos(turn), np.sin(turn), color=look.pale, linewidth=0.7)
        for (low, high, phase, alpha), dashed in zip(both, (False, True), strict=True):
            radius = 0.5 * min(float(alpha), 1.9)
            delta = radius * np.exp(1j * turn)
            disk = (1.0 + delta) / (1.0 - delta)
            far = min(float(high), _FAR)
            arc = np.exp(1j * np.deg2rad(np.linspace(-phase, phase, 60)))
            color, label = (look.ink, "of the model") if dashed else (look.color(0), says)
            how: dict[str, Any] = {"color": color, "linestyle": "--" if dashed else "-"}
            if not dashed:
                ax.fill(disk.real, disk.imag, color=color, alpha=look.fill, linewidth=0)
            ax.plot(disk.real, disk.imag, linewidth=1.0, **how)
            width = 1.0 if dashed else 2.4
            ax.plot([low, far], [0.0, 0.0], linewidth=width, label=label, **how)
            ax.plot(arc.real, arc.imag, linewidth=width, **how)
        ax.plot([1.0], [0.0], "o", color=look.ink, markersize=3)
        ax.set(xlim=(-0.2, _FAR), ylim=(-1.3, 1.3), aspect="equal")
        style.add_labels(ax, f"factor of {style.literal(name)}, real part", "imaginary part")
    style.add_key(axes[0], loc="lower right")
    return style.root_of(figure)
