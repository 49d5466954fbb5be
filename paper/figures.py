"""How a panel looks: axes, curves, legend, and several panels in one figure.

Nothing but quantiles is computed here. matplotlib is an optional dependency and is imported inside
the functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .common import Floats
from .curves import Curve, Panel
from .methods import STYLES, Style
from .style import INK, PALE, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# The exact root mean square error, and the same over the replicates.
EXACT: dict[str, Any] = {"color": INK, "linewidth": 1.0, "linestyle": (0, (2, 2))}
MEASURED: dict[str, Any] = {"color": INK, "linestyle": "", "marker": "+", "ms": 5, "mew": 0.9}


def panel(shown: Panel, sizes: NDArray[np.int64], *, ax: Axes | None = None) -> Axes:
    """Draw one panel; without `ax` on a figure of its own, with a legend."""
    own = None
    if ax is None:
        own = new_figure(5.6, 5.0, header=0.0, footer=1.15)
        ax = own.add_subplot()
    floor = prepare(ax, shown, sizes)
    for curve in shown.curves:
        draw(ax, curve, sizes, shown.zero_level, floor)
    if own is not None:
        legend(own, [shown], columns=2)
    return ax


def figure(panels: Sequence[Panel], sizes: NDArray[np.int64], title: str, ran: str) -> Figure:
    """Draw panels side by side under one title, with what was `ran`, and over one legend."""
    result = new_figure(5.0 * len(panels), 5.0, header=0.62, footer=0.55)
    for position, one in enumerate(panels, start=1):
        ax = panel(one, sizes, ax=result.add_subplot(1, len(panels), position))
        look: dict[str, Any] = {"fontsize": 10.5, "color": INK, "pad": 7, "parse_math": False}
        ax.set_title(f"({one.name[1:]}) {one.quantity}", loc="left", **look)
    heading(result, title, ran)
    legend(result, panels)
    return result


def prepare(ax: Axes, shown: Panel, sizes: NDArray[np.int64]) -> float:
    """Scales, limits, labels and the strip for zeros; returns the height at which zero is drawn."""
    values = np.concatenate([_drawn(curve) for curve in shown.curves])
    visible = values[values > shown.zero_level]
    lowest, highest = (visible.min(), visible.max()) if visible.size else (0.1, 1.0)
    bottom, top = 10 ** (np.log10(lowest) - 0.1), 10 ** (np.log10(highest) + 0.12)
    floor = 0.0
    ax.set_xscale("log")
    ax.set_yscale("log")
    if visible.size < values.size:
        edge = 10 ** np.floor(np.log10(lowest))
        height = (top / edge) ** 0.13  # the strip takes about an eighth of the axis
        bottom, floor = edge / height, edge / height**0.62
        _strip(ax, bottom, edge, f"{shown.zero_label} (≤ {_number(shown.zero_level)})")
        ticks = _ticks(edge, top)
        ax.set_yticks([floor, *ticks], ["0", *map(_number, ticks)])
    else:
        ticks = _ticks(bottom, top)
        ax.set_yticks(ticks, [_number(tick) for tick in ticks])
    last = float(sizes[-1])
    decades = [float(d) for d in _ticks(sizes[0], last, spread=0) if not d < last < 1.4 * d]
    across = [*decades, *([] if last in decades else [last])]
    ax.set_xticks(across, [f"{tick:,.0f}".replace(",", "\u2009") for tick in across])
    ax.minorticks_off()
    ax.set_xlim(sizes[0] / 1.08, sizes[-1] * 1.08)
    ax.set_ylim(bottom, top)
    ax.set_xlabel("number of samples N of each entity", fontsize=9.5, color=INK)
    ax.set_ylabel(f"relative error  {shown.symbol}", fontsize=9.5, color=INK)
    ax.grid(True, which="major", color="#e4e4e4", linewidth=0.7)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8.5, colors=INK, width=0.7)
    for side, spine in ax.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_linewidth(0.7)
        spine.set_color("#888888")
    return floor


def _strip(ax: Axes, bottom: float, edge: float, text: str) -> None:
    """The shaded strip below the logarithmic part, for errors that are zero."""
    ax.axhspan(bottom, edge, facecolor="#f1f1ee", edgecolor="none", zorder=0)
    ax.axhline(edge, color="#b5b5ae", linewidth=0.8, zorder=0.5)
    place: dict[str, Any] = {"transform": ax.transAxes, "va": "bottom"}
    ax.text(0.02, 0.012, text, fontdict={"fontsize": 7.5, "color": PALE}, **place)


def _drawn(curve: Curve) -> Floats:
    """All heights at which this curve draws something."""
    exact = [] if curve.exact_rms is None else [curve.exact_rms, curve.rms]
    return np.ravel([*curve.band, curve.median, curve.single, *exact])


def draw(ax: Axes, curve: Curve, sizes: NDArray[np.int64], zero_level: float, floor: float) -> None:
    """Band, single run, median and, where theory gives it, the exact root mean square."""
    style = STYLES[curve.look]

    def shown(values: Floats) -> Floats:
        return np.where(values > zero_level, values, floor)

    low, high = curve.band
    band: dict[str, Any] = {"color": style.color, "alpha": 0.11, "linewidth": 0, "zorder": 1}
    ax.fill_between(sizes, shown(low), shown(high), **band)
    ax.plot(sizes, shown(curve.single), color=style.color, linewidth=0.7, alpha=0.6, zorder=2)
    ax.plot(sizes, shown(curve.median), label=style.label, zorder=3, **_line(style))
    if curve.exact_rms is not None:
        ax.plot(sizes, curve.exact_rms, zorder=4, **EXACT)
        ax.plot(sizes, shown(curve.rms), zorder=4, **MEASURED)


def heading(result: Figure, title: str, ran: str) -> None:
    """Title and, in smaller type, what was run."""
    height = result.get_figheight()
    for inches, text, size, color, weight in (
        (0.10, title, 13, INK, "bold"),
        (0.40, ran, 9.5, PALE, "normal"),
    ):
        result.text(
            0.09 / result.get_figwidth(),
            1 - inches / height,
            text,
            fontsize=size,
            color=color,
            weight=weight,
            va="top",
            parse_math=False,
        )


def legend(result: Figure, shown: Sequence[Panel], *, columns: int | None = None) -> None:
    """One legend below all panels: a row of methods, then what the other marks mean."""
    handles = marks(shown)
    columns = columns or len({curve.look for one in shown for curve in one.curves})
    result.legend(
        handles=_by_rows(handles, columns),
        loc="lower left",
        bbox_to_anchor=(0.02 / result.get_figwidth(), 0.0),
        ncols=columns,
        fontsize=8.5,
        frameon=False,
        labelcolor=INK,
        handlelength=3.0,
        columnspacing=1.5,
    )


def marks(shown: Sequence[Panel]) -> list[Any]:
    """What a legend explains, with labels: the methods present, then the other marks."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    curves = [curve for one in shown for curve in one.curves]
    present = {curve.look for curve in curves}
    handles: list[Any] = [
        Line2D([], [], label=style.label, **_line(style))
        for key, style in STYLES.items()
        if key in present
    ]
    if any(curve.exact_rms is not None for curve in curves):
        handles += [
            Line2D([], [], label="exact rms of uniform", **EXACT),
            Line2D([], [], label="rms of its replicates", **MEASURED),
        ]
    return [
        *handles,
        Patch(facecolor=PALE, alpha=0.25, label="10-90 % of replicates"),
        Line2D([], [], color=PALE, linewidth=0.7, label="one single run"),
    ]


def _line(style: Style) -> dict[str, Any]:
    """How the median of one method is drawn."""
    return {
        "color": style.color,
        "linestyle": style.line,
        "linewidth": 1.9,
        "marker": style.marker,
        "markersize": 4.6,
        "markerfacecolor": "white",
        "markeredgewidth": 1.1,
    }


def _by_rows(handles: list[Any], columns: int) -> list[Any]:
    """Reorder, because a legend is filled column by column, so that it reads row by row."""
    return [handle for column in range(columns) for handle in handles[column::columns]]


def _ticks(low: float, high: float, *, spread: float = 1.8) -> Floats:
    """At most seven powers of ten in [low, high]; 2 and 5 too on less than `spread` decades."""
    first, last = int(np.ceil(np.log10(low) - 1e-9)), int(np.floor(np.log10(high) + 1e-9))
    if np.log10(high / low) < spread:
        ticks = np.outer([10.0**k for k in range(first - 1, last + 1)], [1, 2, 5]).ravel()
        return ticks[(ticks >= low) & (ticks <= high)]
    step = max(1, -(-(last - first + 1) // 7))
    return np.array([10.0**k for k in range(first, last + 1, step)])


def _number(value: float) -> str:
    """0.001 ... 1000 as they are, other powers of ten as such."""
    exponent = int(np.floor(np.log10(value) + 1e-9))
    if -3 <= exponent <= 3:
        return f"{value:g}"
    digit = f"{value / 10.0**exponent:.2g}"
    return f"$10^{{{exponent}}}$" if digit == "1" else rf"${digit} \cdot 10^{{{exponent}}}$"
