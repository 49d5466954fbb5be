"""Figure of predicted states with a certified tube around them, of measured ones, and inputs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base.numbers import most_changing
from .._base.types import Floats
from .panels import (
    PANELS,
    Inputs,
    add_legend,
    draw_inputs,
    draw_limits,
    extent,
    frame,
    panel_grid,
    tell_omitted,
)
from .style import look_of, root_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

RUNS = 20  # most runs that are drawn one by one


def draw_tube(
    predicted: Floats,
    tube: Floats | None,
    names: Sequence[str],
    *,
    measured: Floats | None = None,
    target: Floats | None = None,
    reference: Floats | None = None,
    limits: tuple[Floats, Floats] | None = None,
    inputs: Inputs | None = None,
    dt: float | None = None,
    says: str = "",
    figure: Figure | SubFigure | None = None,
) -> Figure:
    """Draw each state of `predicted` (K + 1, n) in its panel over time, and then each input.

    Of many those that change most.

    With the `tube` (K + 1,) or (K + 1, n) around it, of which the legend `says` what it is; with
    what was `measured` (K + 1, n), or several of them (R, K + 1, n), many as a band, the `target`
    (n,) at the end, a `reference` (K, n) and `limits` (K, n) of x(1) .. x(K). A tube (K + 1,)
    bounds the distance in the 2-norm, hence each state.
    """
    counts = {"states": predicted.shape[1], "inputs": 0 if inputs is None else inputs.u.shape[1]}
    at = most_changing(predicted, PANELS)
    n, m = len(at), min(counts["inputs"], PANELS)
    runs = np.zeros((0, *predicted.shape)) if measured is None else measured
    runs = runs[None] if runs.ndim == 2 else runs
    times = np.arange(len(predicted)) * (1.0 if dt is None else dt)
    figure, panels = panel_grid(n + m, figure)
    tell_omitted(figure, counts, changing=True)
    for i, ax in zip(at, panels[:n], strict=True):
        shown = np.concatenate([predicted[:, i], runs[:, :, i].ravel()])
        shown = shown if target is None else np.append(shown, target[i])
        shown = shown if reference is None else np.append(shown, reference[:, i])
        floor, top, reach = extent(shown)
        look = look_of(ax)
        if limits is not None:
            sides = limits[0][:, i], limits[1][:, i]
            floor, top = draw_limits(ax, times[1:], sides, (floor, top, reach))
        if tube is not None:  # a wider one leaves the panel
            radius = np.minimum(tube if tube.ndim == 1 else tube[:, i], 10.0 * reach)
            low, high = predicted[:, i] - radius, predicted[:, i] + radius
            floor, top = max(floor - reach, low.min()), min(top + reach, high.max())
            ax.fill_between(
                times, low, high, color=look.color(0), alpha=look.fill, linewidth=0, label=says
            )
        if reference is not None:
            ax.plot(
                times[1:], reference[:, i], "--", color=look.ink, linewidth=1, label="reference"
            )
        ax.plot(times, predicted[:, i], color=look.color(0), linewidth=1.6, label="predicted")
        if len(runs) > RUNS:
            low, middle, high = np.quantile(runs[:, :, i], [0.05, 0.5, 0.95], axis=0)
            band: Any = {"color": look.color(1), "alpha": look.fill, "linewidth": 0}
            ax.fill_between(times, low, high, **band, label=f"90 % of {len(runs)} runs")
            ax.plot(times, middle, "--", color=look.color(1), linewidth=1.2, label="their median")
        for k, run in enumerate(runs if len(runs) <= RUNS else ()):
            ax.plot(
                times, run[:, i], ".", color=look.color(1), markersize=5 if len(runs) == 1 else 4,
                alpha=1.0 if len(runs) == 1 else 0.7, label="measured" if k == 0 else None,
            )  # fmt: skip
        if target is not None:
            ax.plot(
                times[-1],
                target[i],
                "x",
                color=look.ink,
                markersize=8,
                mew=1.8,
                clip_on=False,
                label="target",
            )
        frame(ax, floor, top, reach, dt, names[i])
    if inputs is not None:
        draw_inputs(panels[n:], inputs.some(most_changing(inputs.u, PANELS)), dt)
    add_legend(figure, panels)
    return root_of(figure)
