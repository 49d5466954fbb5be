"""Figure of the errors of a stream over its steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .._base.types import Floats
from .ends import label_ends
from .states import finish
from .style import add_key, axes_or_new, look_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray


def draw_trace(
    steps: NDArray[np.int64], errors: Floats, certificates: Floats, ax: Axes | None
) -> Axes:
    """Draw errors and certificates over the steps on logarithmic axes, without zeros."""
    ax = axes_or_new(ax)
    ax.set_xscale("log")
    ax.set_yscale("log")
    look = look_of(ax)
    curves = (  # dashed, so that both are visible where they agree
        (errors, "error", look.color(0), "-"),
        (certificates, "certificate", look.color(1), "--"),
    )
    lines = []
    for values, label, color, line in curves:
        shown = (steps > 0) & (values > 0.0)  # False for nan
        if shown.any():
            lines += ax.plot(steps[shown], values[shown], line, color=color, label=label, lw=1.6)
    finish(ax, "step", r"$\|B(v - v^*)\|$")
    if lines and not label_ends(ax, lines):
        add_key(ax)
    return ax
