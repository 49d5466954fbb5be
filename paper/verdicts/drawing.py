"""The two figures of the checked claims: tail bounds, and SLSE against uniform weights."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..methods import STYLES
from ..style import COLORS, INK, PALE, add_grid, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .comparison import Comparison
    from .tails import Tails

_OURS, _PAPER = COLORS[:2]


def draw_claims(tails: Tails, compared: Comparison) -> Figure:
    """Both panels side by side."""
    made = new_figure(10.0, 4.5, header=0.42, footer=0.0)
    left, right = made.subplots(1, 2)
    draw_tails(left, tails)
    draw_comparison(right, compared)
    made.text(0.012, 0.985, "What the lemmas say, and what happens", size=13, va="top", color=INK)
    return made


def draw_tails(ax: Axes, tails: Tails) -> None:
    """The error that few runs exceed, a bound that holds, and that of Lemma 4.2."""
    percent = f"{100 * (1 - tails.delta):g} %"
    ax.loglog(tails.sizes, tails.ours, "-", color=_OURS, lw=2, label=f"{tails.bound} bound (holds)")
    ax.loglog(tails.sizes, tails.empirical, "o", color=INK, ms=5, label=f"{percent} of the runs")
    ax.loglog(
        tails.sizes, tails.printed, "--", color=_PAPER, lw=2, label="Lemma 4.2 with ‖A‖, C = n"
    )
    ax.fill_between(tails.sizes, tails.printed, tails.empirical, color=_PAPER, alpha=0.10, lw=0)
    ax.set_title(f"Tail bounds: Hadamard system, n = {tails.n}", loc="left", size=10.5, color=INK)
    ax.set_xlabel("realizations N")
    ax.set_ylabel(f"state error not exceeded in {percent}")
    _finish(ax)


def draw_comparison(ax: Axes, compared: Comparison) -> None:
    """Mean squares of SLSE and of uniform weights, and how often SLSE is worse."""
    sizes = compared.sizes
    uniform, slse = STYLES["uniform", "product"], STYLES["slse", "product"]
    ax.loglog(sizes, compared.bound, "-", color=uniform.color, lw=2, label="V / N, the bound")
    ax.loglog(
        sizes,
        compared.uniform.mean(axis=0),
        "+",
        color=uniform.color,
        ms=6,
        label="uniform, mean square",
    )
    ax.loglog(sizes, compared.mean_square, "-", color=slse.color, lw=2, label="SLSE, mean square")
    floor = ax.get_ylim()[0]
    ax.set_ylim(floor / 30, None)
    ax.set_title("SLSE against uniform weights", loc="left", size=10.5, color=INK)
    ax.set_xlabel("realizations N")
    ax.set_ylabel("squared error")
    share = ax.twinx()
    gaps = np.diff(sizes, prepend=0, append=2 * sizes[-1])
    width = np.minimum(0.12 * sizes, 0.8 * np.minimum(gaps[:-1], gaps[1:]))
    share.bar(sizes, 100 * compared.worse, width=width, color=PALE, alpha=0.55, lw=0, zorder=0)
    top = max(1.0, 100 * float(compared.worse.max()))
    share.set_ylim(0, 5 * top)
    share.set_yticks([0, round(top)])
    share.set_ylabel("runs in which SLSE is worse (bars, %)", size=8.5, color=PALE)
    share.spines["top"].set_visible(False)
    _finish(ax)


def _finish(ax: Axes) -> None:
    add_grid(ax)
    ax.legend(frameon=False, fontsize=9, loc="upper right")
