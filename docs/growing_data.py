"""Figure of certificates and true errors over the number of experiments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stochens_rs._base.types import Floats
from stochens_rs.plots.style import (
    add_key,
    add_labels,
    look_of,
    new_figure,
    number_text,
    root_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray


MARKERS = "osD^vP"


def draw_certificates(
    sizes: NDArray[np.int64],
    curves: dict[str, tuple[Floats, Floats | None]],
    *,
    across: str = "experiments N",
    up: str = "distance from the target",
    tol: float | None = None,
    kinds: tuple[str, str] = ("certificate", "true error"),
    ax: Axes | None = None,
) -> Axes:
    """Draw for each label the certificates and, dashed, the true errors over `sizes`.

    An infinite certificate is an open marker at the upper edge. `tol` is a horizontal line. `kinds`
    says what a solid and a dashed line are.
    """
    ax = new_figure(7.8, 4.2).add_subplot() if ax is None else ax
    from matplotlib.lines import Line2D
    from matplotlib.transforms import offset_copy

    ax.set_xscale("log")
    ax.set_yscale("log")
    theme = look_of(ax)
    handles: list[Any] = []
    edge = ax.get_xaxis_transform()
    endless = [label for label, (one, _) in curves.items() if not np.isfinite(one).all()]
    for k, (label, (certificate, error)) in enumerate(curves.items()):
        color, marker = theme.color(k), MARKERS[k % len(MARKERS)]
        finite = np.isfinite(certificate)
        look: dict[str, Any] = {"color": color, "marker": marker, "markersize": 5}
        ax.plot(sizes[finite], certificate[finite], linewidth=1.6, **look)
        beside = endless.index(label) - (len(endless) - 1) / 2 if label in endless else 0.0
        aside = offset_copy(edge, root_of(ax), 8.0 * beside, units="points")
        at_edge = ax.plot(
            sizes[~finite], np.full((~finite).sum(), 0.985), linestyle="", clip_on=False,
            markerfacecolor=theme.face, transform=aside, **look,
        )  # fmt: skip
        at_edge[0].set_in_layout(False)  # matplotlib would leave room for it far away
        if error is not None:
            ax.plot(sizes, error, "--", linewidth=1.0, **{**look, "markersize": 2.5})
        handles.append(Line2D([], [], linewidth=1.6, label=label, **look))
    if tol is not None:
        line = ax.axhline(tol, color=theme.pale, linewidth=0.9)
        line.set_label(f"tolerance {number_text(tol)}")
    grey: dict[str, Any] = {"color": theme.ink}
    handles.append(Line2D([], [], label=kinds[0], **grey))
    if any(error is not None for _, error in curves.values()):
        handles.append(Line2D([], [], linestyle="--", linewidth=1.0, label=kinds[1], **grey))
    if endless:
        open_: dict[str, Any] = {"linestyle": "", "marker": "o", "markerfacecolor": theme.face}
        handles.append(Line2D([], [], label="at the upper edge: infinite", **open_, **grey))
    if tol is not None:
        handles.append(line)
    ax.set_xticks(sizes, [number_text(size) for size in sizes])
    ax.minorticks_off()
    add_labels(ax, across, up)
    add_key(ax, handles=handles, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return ax
