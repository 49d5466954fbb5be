"""The complex plane of factors of an input: which are certified."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .._base.types import Figure, Floats, SubFigure
from . import style
from .panels import panel_grid

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
