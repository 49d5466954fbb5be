"""Figure of residuals: what each test of them looks at."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.types import Floats
from .panels import panel_grid
from .style import SMALL, TITLE, Palette, add_grid, add_key, add_labels, literal, look_of, root_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from numpy.typing import NDArray


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
