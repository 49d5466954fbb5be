"""The figures of the page: one drawing per panel, in the colours of the page, and what is seen.

The drawings are inline SVG, because only then can the page give them its colours (light, dark,
print) and put them side by side or below each other.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..figures import marks
from ..methods import STYLES
from ..style import new_figure
from ..verdicts.drawing import draw_comparison, draw_tails
from .formulas import percent

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from ..curves import Panel
    from ..experiment import Experiment
    from ..verdicts.records import Claims

_SIZE = (4.2, 3.7)  # inches of a panel: its letters can be read on a phone
# The colours of the figures by their names in style.css, where dark pages have others.
_VARIABLES = {
    "#222222": "ink",
    "#000000": "ink",
    "#6b6b6b": "pale",
    "#888888": "spine",
    "#b5b5ae": "edge",
    "#e4e4e4": "grid",
    "#f1f1ee": "strip",
    "#ffffff": "paper",
    "#0072b2": "blue",
    "#56b4e9": "sky",
    "#d55e00": "red",
    "#009e73": "green",
    "#e69f00": "orange",
}


class Drawing(NamedTuple):
    """One panel of a figure on the page."""

    title: str
    seen: str  # in words, for those who cannot see it
    svg: Markup


class Mark(NamedTuple):
    """One row of a legend."""

    label: str
    svg: Markup


def figure(experiment: Experiment, number: str) -> tuple[list[Drawing], list[Mark]]:
    """The panels of one figure of the paper, and their legend."""
    chosen = [panel for panel in experiment.panels if panel.figure == number]

    def drawn(panel: Panel) -> Drawing:
        svg = _panel(
            f"{experiment.name}-{panel.name}", lambda ax: experiment.plot_panel(panel.name, ax=ax)
        )
        return Drawing(f"({panel.name[1:]}) {panel.quantity}", seen(panel, experiment.sizes), svg)

    return [drawn(panel) for panel in chosen], _legend(marks(chosen), f"figure-{number}")


def claims_figure(claims: Claims) -> list[tuple[Drawing, list[Mark]]]:
    """The two panels of the figure of the statements, each with its legend."""
    tails, compared = claims.tails, claims.comparison
    made = []
    for name, title, words, draw in (
        ("tails", "(a) tail bounds", tails.seen, lambda ax: draw_tails(ax, tails)),
        ("slse", "(b) SLSE and uniform", compared.seen, lambda ax: draw_comparison(ax, compared)),
    ):
        handles: list[Any] = []

        def drawn(
            ax: Axes, draw: Callable[[Axes], None] = draw, handles: list[Any] = handles
        ) -> None:
            draw(ax)
            ax.set_title("", loc="left")
            handles += ax.get_legend_handles_labels()[0]
            ax.get_legend().remove()  # type: ignore[union-attr]

        svg = _panel(f"claims-{name}", drawn)
        made.append((Drawing(title, words, svg), _legend(handles, f"claims-{name}")))
    return made


def seen(panel: Panel, sizes: NDArray[np.int64]) -> str:
    """What a panel shows, in words: where each median starts and ends."""
    said = []
    for curve in panel.curves:
        first, last = float(curve.median[0]), float(curve.median[-1])
        zero = curve.median <= panel.zero_level
        name = STYLES[curve.look].label
        if zero[-1]:
            since = int(sizes[-1 if zero.all() else np.flatnonzero(~zero)[-1] + 1])
            said.append(f"{name} is at {panel.zero_label} from N = {since} on")
            continue
        way = "falls" if last < 0.95 * first else "rises" if last > 1.05 * first else "stays"
        said.append(f"{name} {way} from {percent(first)} to {percent(last)}")
    return (
        f"Median relative error of the {panel.quantity} from N = {sizes[0]} to N = {sizes[-1]}, on "
        f"logarithmic axes: {'; '.join(said)}."
    )


def _panel(name: str, draw: Callable[[Axes], object]) -> Markup:
    made = new_figure(*_SIZE, header=0.0, footer=0.0)
    draw(made.add_subplot())
    return _inline(made, name)


def _legend(handles: Sequence[Any], name: str) -> list[Mark]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Rectangle

    rows = []
    for k, handle in enumerate(handles):
        made = new_figure(0.46, 0.17, header=0.0, footer=0.0)
        shape: Any = (
            Line2D([0.04, 0.5, 0.96], [0.5] * 3, markevery=[1])
            if isinstance(handle, Line2D)
            else Rectangle((0.04, 0.2), 0.92, 0.6)
        )
        shape.update_from(handle)
        shape.set(transform=made.transSubfigure, clip_on=False)
        made.add_artist(shape)
        rows.append(Mark(handle.get_label(), _inline(made, f"{name}-mark-{k}")))
    return rows


def _inline(made: Figure, name: str) -> Markup:
    """A figure as an element of the page: its colours, and no names that occur elsewhere."""
    import matplotlib
    from markupsafe import Markup

    file = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "path"}):
        made.savefig(file, format="svg", transparent=True, metadata={"Date": None})
    svg = file.getvalue()
    svg = svg[svg.index("<svg") :]
    for dropped in (r"<!--.*?-->", r"<metadata>.*?</metadata>", r"<style.*?</style>"):
        svg = re.sub(dropped, "", svg, flags=re.S)
    used = set(re.findall(r'(?:href="#|url\(#)([^")]+)', svg))
    svg = re.sub(
        r' id="([^"]*)"',
        lambda found: f' id="{name}-{found[1]}"' if found[1] in used else "",
        svg,
    )
    svg = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", svg.replace("xlink:href", "href"))
    svg = re.sub(r"(?<=: )#[0-9a-f]{6}", _colour, svg)
    box = re.search(r'viewBox="[^"]*"', svg)
    assert box is not None
    body = svg[svg.index(">") + 1 :]
    return Markup(
        f'<svg {box[0]} aria-hidden="true" focusable="false">{re.sub(chr(10) + " *", " ", body)}'
    )


def _colour(found: re.Match[str]) -> str:
    name = _VARIABLES.get(found[0])
    return found[0] if name is None else f"var(--{name})"
