"""The fusion methods that experiments compare: one table of their order, names and looks."""

from __future__ import annotations

from typing import NamedTuple

from .common import Fusion, Method


class Style(NamedTuple):
    """How one method is named, described and drawn everywhere."""

    label: str
    meaning: str
    color: str
    line: str | tuple[int, tuple[float, ...]]
    marker: str


# Colours from the palette of Okabe and Ito (2008); markers and line styles differ as well, so that
# curves can be told apart in print and with any colour vision.
STYLES: dict[tuple[Method, Fusion], Style] = {
    ("uniform", "diagonal"): Style(
        "uniform, diagonal fusion",
        "the mean of the controls of paired realizations",
        "#56B4E9",
        (0, (5, 1.6)),
        "s",
    ),
    ("uniform", "product"): Style("uniform", "equal weights", "#0072B2", "-", "o"),
    ("slse", "product"): Style(
        "SLSE", "one line search per sample", "#E69F00", (0, (7, 1.5, 1.5, 1.5)), "^"
    ),
    ("slse-safeguarded", "product"): Style(
        "SLSE, safeguarded",
        "each followed by a line search towards the plain mean",
        "#009E73",
        (0, (1.5, 1)),
        "v",
    ),
    ("alse", "product"): Style(
        "ALSE", "the weights on the simplex with the least squared error", "#D55E00", "-", "D"
    ),
}
METHODS = tuple(method for method, fusion in STYLES if fusion == "product")
