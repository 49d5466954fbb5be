"""Figure of certificates and true errors over the number of experiments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .style import COLORS, INK, PALE, add_grid, add_labels, axes_or_new

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MARKERS = "osD^vP"


def draw_certificates(
    sizes: NDArray[np.int64],
    curves: dict[str, tuple[Floats, Floats | None]],
    *,
    across: str = "experiments N",
    up: str = "distance from the target",
    tol: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw for each label the certificates and, dashed, the true errors over `sizes`.

    An infinite certificate is an open marker at the upper edge. `tol` is a horizontal line.
    """
    ax = axes_or_new(ax, width=7.8)
    from matplotlib.lines import Line2D

    ax.set_xscale("log")
    ax.set_yscale("log")
    handles: list[Any] = []
    edge = ax.get_xaxis_transform()
    for k, (label, (certificate, error)) in enumerate(curves.items()):
        color, marker = COLORS[k % len(COLORS)], MARKERS[k % len(MARKERS)]
        finite = np.isfinite(certificate)
        look: dict[str, Any] = {"color": color, "marker": marker, "markersize": 5}
        ax.plot(sizes[finite], certificate[finite], linewidth=1.6, **look)
        spread = sizes[~finite] * 1.06 ** (k - len(curves) / 2)
        ax.plot(
            spread, np.full(len(spread), 0.985), linestyle="", markerfacecolor="white",
            transform=edge, clip_on=False, **look,
        )  # fmt: skip
        if error is not None:
            ax.plot(sizes, error, "--", linewidth=1.0, **{**look, "markersize": 2.5})
        handles.append(Line2D([], [], linewidth=1.6, label=label, **look))
    if tol is not None:
        ax.axhline(tol, color=PALE, linewidth=0.9)
    grey: dict[str, Any] = {"color": INK}
    handles.append(Line2D([], [], label="certificate", **grey))
    if any(error is not None for _, error in curves.values()):
        handles.append(Line2D([], [], linestyle="--", linewidth=1.0, label="true error", **grey))
    if any(not np.isfinite(one).all() for one, _ in curves.values()):
        open_: dict[str, Any] = {"linestyle": "", "marker": "o", "markerfacecolor": "white"}
        handles.append(Line2D([], [], label="at the upper edge: infinite", **open_, **grey))
    ax.set_xticks(sizes, [f"{size:g}" for size in sizes])
    ax.minorticks_off()
    add_labels(ax, across, up)
    add_grid(ax)
    ax.legend(
        handles=handles, frameon=False, fontsize=8.5, labelcolor=INK, loc="center left",
        bbox_to_anchor=(1.01, 0.5),
    )  # fmt: skip
    return ax
