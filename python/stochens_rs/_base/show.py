"""What a notebook shows of a record: its repr as a title, a small table, a line drawing.

Colours come from the page, so that a dark one stays readable; what is drawn has the middle tones of
Okabe and Ito's palette. No scripts, no style sheets: nothing outside the fragment changes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from html import escape

import numpy as np

from .types import Floats, NDArray, most_changing

Rows = Iterable[tuple[str, object]]

_COLORS = ("#3b8fd4", "#e0701a", "#1fa37a", "#c78a00", "#b56b99", "#888888")
_WIDTH, _HEIGHT, _POINTS = 240, 56, 120
_TABLE = "border:0;border-collapse:collapse;margin:3px 0;font-variant-numeric:tabular-nums"
_CELL = "border:0;padding:1px 14px 1px 0;vertical-align:top;text-align:{}"


def card(shown: object, rows: Rows, below: str = "") -> str:
    """Title line, one row per fact that is known, warnings, names, and what comes below."""
    labels = getattr(shown, "labels", None)
    warnings = (("warning", one) for one in getattr(shown, "warnings", ()))
    title = type(shown).__name__
    said = repr(shown)
    about = said[len(title) + 1 : -1].strip(" :") if said.startswith("<") else ""
    label, cell = _CELL.format("left") + ";font-weight:normal;opacity:.75", _CELL.format("left")
    body = "".join(
        f'<tr><th style="{label}">{escape(what)}</th>'
        f'<td style="{cell};overflow-wrap:anywhere">{escape(text(value))}</td></tr>'
        for what, value in (*rows, *warnings, *(labels.rows() if labels else ()))
        if value is not None
    )
    table = f'<table style="{_TABLE}"><tbody>{body}</tbody></table>' if body else ""
    return (
        '<div style="max-width:44em;overflow-x:auto;line-height:1.4">'
        f'<div><b>{escape(title)}</b> <span style="opacity:.75">{escape(about)}</span></div>'
        f"{table}{below}</div>"
    )


def largest(inputs: Floats) -> tuple[str, object]:
    """The row for the size of a control."""
    return "largest |u|", float(np.abs(inputs).max()) if inputs.size else None


def number_of(count: int, what: str = "step") -> str:
    """``1 step``, ``2 runs``."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def listed(names: Sequence[str]) -> str:
    """``a, b and c``; of more than four names the first three."""
    some = [*names[:3], f"{len(names) - 3} others"] if len(names) > 4 else list(names)
    return f"{', '.join(some[:-1])} and {some[-1]}" if len(some) > 1 else some[0]


def two(value: float) -> str:
    """Two digits, without an exponent where there are not many zeros."""
    return f"{float(f'{value:.2g}'):g}"


def warned(warnings: Sequence[str]) -> str:
    """``, 2 warnings``; nothing without."""
    return f", {number_of(len(warnings), 'warning')}" if warnings else ""


def careful(warnings: Sequence[str]) -> str:
    """``; careful: ...``, the first warning, and how many more; nothing without."""
    more = f" (and {len(warnings) - 1} more)" if len(warnings) > 1 else ""
    return f"; careful: {warnings[0]}{more}" if warnings else ""


def counts(seen: dict[str, int]) -> str:
    """How many realizations of each entity."""
    return ", ".join(f"{grouped(count)} of {name}" for name, count in seen.items())


def grouped(count: int) -> str:
    """Thousands apart."""
    return f"{count:,}".replace(",", "\u2009")


def at_most(value: float, digits: int = 3) -> str:
    """An upper bound as text, rounded up."""
    return _rounded(value, digits, ROUND_CEILING)


def margin(value: float) -> str:
    """A lower bound with all of its three digits: 1.00 says more than 1."""
    return f"{float(_rounded(value, 3, ROUND_FLOOR)):#.3g}".rstrip(".")


def _rounded(value: float, digits: int, rounding: str) -> str:
    if not np.isfinite(value):
        return f"{value:.3g}"
    # the shortest decimals of a double: 0.1 is 0.1
    decimals = Context(prec=digits, rounding=rounding).create_decimal(repr(float(value)))
    return f"{float(decimals):.{digits}g}"


def within(value: float, bound: float) -> str:
    """``1.060 ± 0.013``: the value rounded to the second digit of the bound, which covers that."""
    place = 1 - int(np.floor(np.log10(bound))) if 0.0 < bound < np.inf else -1
    if not 0 <= place <= 10:
        shown = f"{value:.4g}"
        return f"{shown} ± {at_most(bound + abs(value - float(shown)), 2)}"
    shown = f"{round(value, place) + 0.0:.{place}f}"  # + 0.0: without the sign of -0
    return f"{shown} ± {float(at_most(bound + abs(value - float(shown)), 2)):.{place}f}"


def percent(*deltas: float) -> str:
    """``1 - sum(deltas)`` in percent, rounded down to six digits."""
    left = 100 * (1 - sum(Decimal(repr(float(delta))) for delta in deltas))
    return f"{_rounded(float(left), 6, ROUND_FLOOR)} %"


def vector(values: Floats, names: Sequence[str] = ()) -> str:
    """At most six entries; with names those that are not nan."""
    if names:
        pairs = zip(names, values, strict=True)
        return ", ".join(f"{name} = {value:.4g}" for name, value in pairs if not np.isnan(value))
    some = ", ".join(f"{value:.4g}" for value in values[:6])
    return f"({some}{', …' if len(values) > 6 else ''})"


def text(value: object) -> str:
    """A cell: nothing for None, four digits for a number."""
    if value is None:
        return ""
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def note(about: str) -> str:
    """A small line below a table or a drawing."""
    return f'<div style="opacity:.75;font-size:.9em">{escape(about)}</div>'


def grid(head: Sequence[str], body: Sequence[Sequence[str]]) -> str:
    """A table with a column of names and columns of numbers."""

    def row(tag: str, cells: Sequence[str]) -> str:
        sides = ["left", *["right"] * (len(cells) - 1)]
        return "".join(
            f'<{tag} style="{_CELL.format(side)};white-space:nowrap">{escape(cell)}</{tag}>'
            for side, cell in zip(sides, cells, strict=True)
        )

    written = "".join(f"<tr>{row('td', cells)}</tr>" for cells in body)
    return (
        f'<table style="{_TABLE}">'
        f"<thead><tr>{row('th', head)}</tr></thead><tbody>{written}</tbody></table>"
    )


def states(times: Floats | NDArray[np.int64], values: Floats, about: str) -> str:
    """A curve for each of the states (K + 1, n), at most six: those that change most."""
    if values.shape[1] <= len(_COLORS):
        return lines(times, list(values.T), about)
    most = list(values.T[most_changing(values, len(_COLORS))])
    return lines(times, most, f"{about}, the {len(most)} that change most")


def errors(steps: NDArray[np.int64], values: Floats) -> str:
    """A curve of errors over the steps of a stream."""
    late = steps > 0
    return lines(steps[late], [values[late]], "error over the steps, log", log=True)


def lines(
    x: Floats | NDArray[np.int64], curves: Sequence[Floats], about: str, *, log: bool = False
) -> str:
    """Curves over a common axis as a small drawing; "" if there is nothing finite to draw."""
    across, heights = np.asarray(x, dtype=np.float64), np.array(curves, dtype=np.float64)
    if log:
        with np.errstate(divide="ignore", invalid="ignore"):
            across, heights = np.log(across), np.log(heights)
    finite = heights[np.isfinite(heights)]
    if len(across) < 2 or not finite.size:
        return ""
    low, high = float(finite.min()), float(finite.max())
    values = (np.exp(low), np.exp(high)) if log else (low, high)
    # halves, because the difference of two floats can overflow
    span = (high / 2 - low / 2) or 1.0
    span_across = (across[-1] / 2 - across[0] / 2) or 1.0
    right = (across / 2 - across[0] / 2) / span_across * _WIDTH
    down = _HEIGHT - (heights / 2 - low / 2) / span * _HEIGHT
    chosen = np.unique(np.linspace(0, len(across) - 1, _POINTS).astype(int))
    drawn = "".join(
        f'<polyline fill="none" stroke="{color}" stroke-width="1.5" points="'
        + " ".join(f"{right[k]:.1f},{row[k]:.1f}" for k in chosen if np.isfinite(row[k]))
        + '"/>'
        for color, row in zip(_COLORS, down, strict=False)
    )
    said = f"{about}, from {values[0]:.3g} to {values[1]:.3g}"
    return (
        f'<svg viewBox="-2 -2 {_WIDTH + 4} {_HEIGHT + 4}" width="{_WIDTH + 4}" '
        f'height="{_HEIGHT + 4}" role="img" style="display:block;max-width:100%">'
        f"<title>{escape(said)}</title>{drawn}</svg>"
        f"{note(said)}"
    )
