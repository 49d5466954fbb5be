"""Figure of residuals: what each test of them looks at."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from .style import COLORS, INK, PALE, add_grid, add_labels, literal, new_figure, require_matplotlib

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

LAGS = 10
DOTS = 2000  # more hide each other
LISTED = 6  # most states that are drawn


def draw_residuals(
    residuals: Floats,
    leverages: Floats,
    names: Sequence[str],
    p_values: dict[str, float] | None,
) -> Figure:
    """Draw residuals (N, n) in units of their deviations: time, lags, quantiles, leverages.

    `p_values` by the names of the tests, which go into the titles.
    """
    require_matplotlib()
    scale = np.sqrt(np.mean(residuals**2, axis=0))
    e = residuals / np.where(scale > 0.0, scale, 1.0)
    shown = e[:, :LISTED]
    figure = new_figure(9.2, 6.4, header=0.45, footer=0.0)
    places = np.unique(np.linspace(0, len(e) - 1, min(len(e), DOTS)).astype(int))
    for number, (draw, title, tests) in enumerate(
        (
            (_over_time, "Over the pairs", ("change",)),
            (_lags, "Correlation in time", ("correlation in time", "correlation at lag 1")),
            (_quantiles, "Tails", ("tails",)),
            (_leverages, "Size against leverage", ("heteroscedasticity",)),
        ),
        start=1,
    ):
        ax = figure.add_subplot(2, 2, number)
        draw(ax, shown, np.mean(e**2, axis=1), leverages, places)
        add_grid(ax)
        known = [] if p_values is None else [f"{p_values[test]:.2g}" for test in tests]
        said = f"   p = {', '.join(known)}" if known else ""
        ax.set_title(title + said, loc="left", fontsize=10.5, color=INK, pad=7)
    handles = [_dot(COLORS[i], literal(name)) for i, name in enumerate(names[:LISTED])]
    figure.legend(
        handles=handles, loc="upper left", ncols=LISTED, frameon=False, fontsize=9, labelcolor=INK
    )
    return figure


def _over_time(ax: Axes, e: Floats, _: Floats, __: Floats, places: NDArray[np.int64]) -> None:
    for i in range(e.shape[1]):
        ax.plot(places, e[places, i], **_dots(i, len(places)))
    ax.axhline(0.0, color=PALE, linewidth=0.8)
    add_labels(ax, "pair", "residual / deviation")


def _lags(ax: Axes, e: Floats, _: Floats, __: Floats, ___: NDArray[np.int64]) -> None:
    N, n = e.shape
    lags = np.arange(1, min(LAGS, N - 1) + 1)
    limit = NormalDist().inv_cdf(0.975) / np.sqrt(N)
    ax.axhspan(-limit, limit, color=PALE, alpha=0.16, linewidth=0)
    ax.axhline(0.0, color=PALE, linewidth=0.8)
    for i in range(n):
        r = [float(e[lag:, i] @ e[:-lag, i]) / float(e[:, i] @ e[:, i] or 1.0) for lag in lags]
        at = lags + 0.5 * ((i + 0.5) / n - 0.5)
        color = COLORS[i % len(COLORS)]
        ax.vlines(at, 0.0, r, color=color, linewidth=1.2)
        ax.plot(at, r, "o", color=color, markersize=3)
    ax.text(
        0.99, 0.02, "band: 95 % of white noise", transform=ax.transAxes, ha="right",
        fontsize=8, color=PALE,
    )  # fmt: skip
    ax.set_xticks(lags)
    add_labels(ax, "lag [steps]", "correlation")


def _quantiles(ax: Axes, e: Floats, _: Floats, __: Floats, places: NDArray[np.int64]) -> None:
    normal = NormalDist()
    x = np.array([normal.inv_cdf((k + 0.5) / len(e)) for k in places])
    for i in range(e.shape[1]):
        ax.plot(x, np.sort(e[:, i])[places], **_dots(i, 0))
    ax.plot(x[[0, -1]], x[[0, -1]], color=INK, linewidth=0.9)
    add_labels(ax, "Gaussian quantile", "quantile of the residuals")


def _leverages(
    ax: Axes, _: Floats, squares: Floats, leverages: Floats, places: NDArray[np.int64]
) -> None:
    ax.plot(leverages[places], np.sqrt(squares[places]), **{**_dots(0, len(places)), "color": PALE})
    order = np.argsort(leverages, kind="stable")
    parts = [part for part in np.array_split(order, 10) if len(part) > 4]
    if len(parts) > 2:
        means = [[np.mean(leverages[p]), np.sqrt(np.mean(squares[p]))] for p in parts]
        ax.plot(
            *np.array(means).T, "o-", color=INK, linewidth=1.4, markersize=4,
            label="rms in tenths of the data",
        )  # fmt: skip
        ax.legend(frameon=False, fontsize=8.5, labelcolor=INK)
    ax.set_ylim(bottom=0.0)
    add_labels(ax, "leverage of x and u", "size / deviation")


def _dots(i: int, count: int) -> dict[str, Any]:
    return {
        "color": COLORS[i % len(COLORS)],
        "linestyle": "",
        "marker": ".",
        "markersize": 4,
        "alpha": 0.8 if count < 300 else 0.5,
    }


def _dot(color: str, name: str) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=color, linestyle="", marker="o", markersize=5, label=name)
