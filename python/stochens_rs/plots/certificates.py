"""What data say: radii of a certificate, regions of coefficients, residuals."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.numbers import ROUNDING
from .._base.types import Floats
from .panels import panel_grid
from .style import (
    SMALL,
    TITLE,
    Palette,
    add_grid,
    add_key,
    add_labels,
    axes_or_new,
    literal,
    look_of,
    number_text,
    root_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from numpy.typing import NDArray


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
    panels = [("", bars, title)]
    if components is not None:
        each = {f"x[{i}]": float(one) for i, one in enumerate(components)}
        panels.append(("", each, "distance of each state from xf"))
    figure, axes = panel_grid(len(panels) + (tube is not None), figure)
    for ax, (_, values, name) in zip(axes, panels, strict=False):
        _bars(ax, values, name)
    if tube is not None:
        ax, steps = axes[-1], np.arange(len(tube))
        look, finite = look_of(ax), np.isfinite(tube)
        ax.fill_between(
            steps[finite], tube[finite], color=look.color(0), alpha=look.fill, linewidth=0
        )
        ax.plot(steps[finite], tube[finite], "o-", color=look.color(0), linewidth=1.6, markersize=3)
        more = "" if finite.all() else f", infinite from step {int(np.argmin(finite))}"
        add_labels(ax, f"step k{more}", "radius of the tube")
        ax.set_xlim(0, len(tube) - 1)
        ax.set_ylim(bottom=0.0)
        add_grid(ax)
    figure.suptitle(says, fontsize=SMALL + 1, color=look_of(axes[0]).ink, x=0.01, ha="left")
    return root_of(figure)


def _bars(ax: Axes, values: dict[str, float], name: str) -> None:
    """A bar for each of the numbers, the first one on top."""
    look, shown = look_of(ax), list(values.items())[:_BARS]
    at = np.arange(len(shown))
    sizes = np.array([size if np.isfinite(size) else 0.0 for _, size in shown])
    sizes[sizes < ROUNDING * sizes.max(initial=0.0)] = 0.0  # beside the others
    ax.barh(at, sizes, height=0.6, color=look.color(0))
    for k, (_, size) in enumerate(shown):
        text = f" {number_text(float(f'{sizes[k]:.3g}'))}" if np.isfinite(size) else " infinite"
        ax.text(sizes[k], k, text, va="center", fontsize=SMALL, color=look.ink)
    ax.set_yticks(at, [literal(one) for one, _ in shown])
    ax.invert_yaxis()
    ax.margins(x=0.25)
    ax.set_xlim(left=0.0)
    more = f" (the first {_BARS} of {len(values)})" if len(values) > _BARS else ""
    add_labels(ax, f"{name}{more}", "")
    add_grid(ax)
    ax.grid(visible=False, axis="y")


_ID = "stochens-region"


def draw_region(
    centre: Floats, corners: Floats, label: str, across: str, up: str, ax: Axes | None
) -> Axes:
    """Draw a polygon (k, 2) and its `centre`, in the next colour of those in `ax`."""
    ax = axes_or_new(ax)
    from matplotlib.patches import Polygon

    look = look_of(ax)
    before = sum(one.get_gid() == _ID for one in ax.patches)
    color = look.color(before)
    face = "none" if before else (color, look.fill / 1.5)  # the colours of two would mix
    edge = Polygon(corners, facecolor=face, edgecolor=color, linewidth=1.6, gid=_ID)
    edge.set_label(literal(label))
    ax.add_patch(edge)
    ax.plot(*centre, "+", color=color, markersize=8, markeredgewidth=1.6, linestyle="")
    add_labels(ax, across, up)
    add_grid(ax)
    ax.autoscale_view()
    if ax.get_legend_handles_labels()[0]:  # matplotlib leaves out empty labels
        add_key(ax, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return ax


LAGS = 10
DOTS = 2000  # more hide each other
LISTED = 6  # most states that are drawn


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
    scale = np.sqrt(np.mean(residuals**2, axis=0))
    e = residuals / np.where(scale > 0.0, scale, 1.0)
    shown = e[:, :LISTED]
    figure, panels = panel_grid(4, figure)
    look = look_of(panels[0])
    places = np.unique(np.linspace(0, len(e) - 1, min(len(e), DOTS)).astype(int))
    for ax, (draw, title, tests) in zip(
        panels,
        (
            (_over_time, "Over the pairs", ("change",)),
            (_lags, "Correlation in time", ("correlation in time", "correlation at lag 1")),
            (_quantiles, "Tails", ("tails",)),
            (_leverages, "Size against leverage", ("heteroscedasticity",)),
        ),
        strict=True,
    ):
        draw(ax, shown, np.mean(e**2, axis=1), leverages, places)
        add_grid(ax)
        known = [] if p_values is None else [f"{p_values[test]:.2g}" for test in tests]
        said = f"   p = {', '.join(known)}" if known else ""
        ax.set_title(title + said, loc="left", fontsize=TITLE, color=look.ink, pad=7)
    handles = [_dot(look.color(i), literal(name)) for i, name in enumerate(names[:LISTED])]
    figure.legend(
        handles=handles, loc="outside upper left", ncols=LISTED, frameon=False, fontsize=SMALL,
        labelcolor=look.ink,
    )  # fmt: skip
    return root_of(figure)


def _over_time(ax: Axes, e: Floats, _: Floats, __: Floats, places: NDArray[np.int64]) -> None:
    look = look_of(ax)
    for i in range(e.shape[1]):
        ax.plot(places, e[places, i], **_dots(look, i, len(places)))
    ax.axhline(0.0, color=look.pale, linewidth=0.8)
    add_labels(ax, "pair", "residual / deviation")


def _lags(ax: Axes, e: Floats, _: Floats, __: Floats, ___: NDArray[np.int64]) -> None:
    look = look_of(ax)
    N, n = e.shape
    lags = np.arange(1, min(LAGS, N - 1) + 1)
    limit = NormalDist().inv_cdf(0.975) / np.sqrt(N)
    ax.axhspan(-limit, limit, color=look.pale, alpha=look.fill, linewidth=0)
    ax.axhline(0.0, color=look.pale, linewidth=0.8)
    for i in range(n):
        r = [float(e[lag:, i] @ e[:-lag, i]) / float(e[:, i] @ e[:, i] or 1.0) for lag in lags]
        at = lags + 0.5 * ((i + 0.5) / n - 0.5)
        color = look.color(i)
        ax.vlines(at, 0.0, r, color=color, linewidth=1.2)
        ax.plot(at, r, "o", color=color, markersize=3)
    ax.set_xticks(lags)
    add_labels(ax, "lag [steps]   (band: 95 % of white noise)", "correlation")


def _quantiles(ax: Axes, e: Floats, _: Floats, __: Floats, places: NDArray[np.int64]) -> None:
    look = look_of(ax)
    normal = NormalDist()
    x = np.array([normal.inv_cdf((k + 0.5) / len(e)) for k in places])
    for i in range(e.shape[1]):
        ax.plot(x, np.sort(e[:, i])[places], **_dots(look, i, 0))
    ax.plot(x[[0, -1]], x[[0, -1]], color=look.ink, linewidth=0.9)
    add_labels(ax, "Gaussian quantile", "quantile of the residuals")


def _leverages(
    ax: Axes, _: Floats, squares: Floats, leverages: Floats, places: NDArray[np.int64]
) -> None:
    look = look_of(ax)
    ax.plot(
        leverages[places],
        np.sqrt(squares[places]),
        **{**_dots(look, 0, len(places)), "color": look.pale},
    )
    order = np.argsort(leverages, kind="stable")
    parts = [part for part in np.array_split(order, 10) if len(part) > 4]
    if len(parts) > 2:
        means = [[np.mean(leverages[p]), np.sqrt(np.mean(squares[p]))] for p in parts]
        ax.plot(
            *np.array(means).T, "o-", color=look.ink, linewidth=1.4, markersize=4,
            label="rms in tenths of the data",
        )  # fmt: skip
        add_key(ax, loc="upper right")
    ax.set_ylim(0.0, 1.2 * ax.get_ylim()[1])  # the legend stands above the dots
    ax.locator_params(axis="x", nbins=5)  # its numbers are long
    add_labels(ax, "leverage of x and u", "size / deviation")


def _dots(look: Palette, i: int, count: int) -> dict[str, Any]:
    return {
        "color": look.color(i),
        "linestyle": "",
        "marker": ".",
        "markersize": 4,
        "alpha": 0.8 if count < 300 else 0.5,
    }


def _dot(color: str, name: str) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=color, linestyle="", marker="o", markersize=5, label=name)
