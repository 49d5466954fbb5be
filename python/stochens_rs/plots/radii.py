"""Figure of a certificate: bars of its parts or radii, its tube over the steps, its components."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._base.numbers import ROUNDING
from .panels import panel_grid
from .style import SMALL, add_grid, add_labels, literal, look_of, number_text, root_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

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
