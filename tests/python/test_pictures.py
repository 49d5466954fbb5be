"""The plots look as they did when somebody looked at them, up to fonts and small moves.

The measure counts the pixels that have no pixel of their colour within a few pixels in the other
picture. Other fonts and versions of matplotlib move things; a line, band, text or legend that is
missing, and colours that are swapped, leave many pixels alone. Each test picture shows that: every
artist in it is taken away once, and every such picture is told apart.
"""

from __future__ import annotations

import itertools
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib")

import matplotlib
from matplotlib.artist import Artist
from matplotlib.collections import Collection
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

import _pictures as pictures
import stochens_rs as se
from coverage_study import sets
from stochens_rs.plots.style import COLORS, DARK, LIGHT, contrast, look_of, number_text


@cache
def drawn(name: str) -> tuple[Figure, np.ndarray]:
    """The figure, whose layout is settled, and its picture."""
    figure = pictures.drawn(name)
    picture = pictures.pixels(figure)
    figure.set_layout_engine("none")
    return figure, picture


@pytest.mark.parametrize("name", pictures.NAMES)
def test_a_plot_looks_as_it_did_and_its_texts_can_be_read(name: str) -> None:
    """Texts stand out from the background, lie within the figure and cover no other."""
    figure, picture = drawn(name)
    found = pictures.difference(picture, pictures.kept(name))
    assert found <= pictures.SLACK, pictures.advice(name, found)
    face = to_rgb(figure.get_facecolor())
    for text in figure.findobj(matplotlib.text.Text):
        if text.get_text().strip() and text.get_visible():
            assert contrast(text.get_color(), face) >= 4.4, text.get_text()
    boxes = [
        (text.get_window_extent().padded(-1), text.get_text())
        for ax in figure.axes
        for text in [
            *ax.texts, ax.xaxis.label, ax.yaxis.label, ax.title, ax._left_title,
            *ax.get_xticklabels(), *ax.get_yticklabels(),
        ]
        if text.get_text().strip() and inside(text, ax)
    ]  # fmt: skip
    for (one, first), (two, second) in itertools.combinations(boxes, 2):
        assert not one.overlaps(two), (first, second)
        assert figure.bbox.count_contains([one.p0, one.p1]) == 2, first


@pytest.mark.parametrize("name", [*pictures.AXES, *pictures.FIGURES])
def test_whatever_is_taken_away_is_missed(name: str) -> None:
    """Each part, in `make test` every twelfth."""
    figure, whole = drawn(name)
    assert pictures.difference(pictures.pixels(figure), whole) == 0
    missed = []
    for group in parts(figure)[:: sets(1, 12)]:
        for artist in group:
            artist.set_visible(False)
        picture = pictures.pixels(figure)
        for artist in group:
            artist.set_visible(True)
        if np.abs(picture - whole).max() > 0.03:  # not hidden, or beyond the axes
            missed.append((pictures.difference(picture, whole), str(group[0])))
    assert missed
    assert [found for found in missed if found[0] <= 1] == []


@pytest.mark.parametrize("name", ["trajectory", "trace", "region", "plan"])
def test_swapped_colours_are_seen(name: str) -> None:
    figure, whole = drawn.__wrapped__(name)
    blue, red = COLORS[:2]
    other = {blue: red, red: blue, "#009e73": COLORS[3]}
    for artist in figure.findobj(lambda one: isinstance(one, (Line2D, Patch, Collection))):
        for read, write in (("get_color", "set_color"), ("get_edgecolor", "set_edgecolor")):
            if hasattr(artist, read):
                color = np.ravel(getattr(artist, read)())
                text = (
                    color[0] if color.dtype.kind == "U" else to_hex(color[:3]) if color.size else ""
                )
                swapped = {key.lower(): value for key, value in other.items()}.get(text.lower())
                if swapped:
                    getattr(artist, write)(swapped)
    assert pictures.difference(pictures.pixels(figure), whole) > 1


def test_moves_of_two_pixels_are_no_difference() -> None:
    whole = pictures.kept("plan")
    for shift in ((0, 2), (-2, 0), (1, -2)):
        assert pictures.difference(np.roll(whole, shift, axis=(0, 1)), whole) <= 1


def test_a_picture_that_differs_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    other = pictures.kept("trace")
    with monkeypatch.context() as patch:
        patch.setattr(pictures, "kept", lambda _: other)
        with pytest.raises(
            AssertionError, match=r"look at (.+)/plan.png beside .*copy it"
        ) as found:
            test_a_plot_looks_as_it_did_and_its_texts_can_be_read("plan")
    folder = re.search("look at (.+?)/plan.png", str(found.value))[1]  # type: ignore[index]
    assert Path(folder, "plan.png").stat().st_size > 1000
    with pytest.raises(AssertionError, match="'none' has no reference: ``python tests"):
        pictures.kept("none")


def test_pictures_are_small() -> None:
    sizes = {path.stem: path.stat().st_size for path in pictures.REFERENCES.glob("*.png")}
    assert set(sizes) == set(pictures.NAMES)
    assert max(sizes.values()) < 15_000
    assert sum(sizes.values()) < 400_000


def parts(figure: Figure) -> list[list[Artist]]:
    """All that says something; curves of one colour and kind together, as the dots of two runs."""
    found: dict[object, list[Artist]] = {}
    for one in figure.legends:
        found[one] = [one]
    for ax in figure.axes:
        for one in [*ax.lines, *ax.collections, *ax.patches]:
            if isinstance(one, Line2D):
                kind: object = one.get_color(), one.get_marker(), one.get_linestyle()
            else:
                kind = tuple(np.ravel(one.get_facecolor())), type(one), one.get_linewidth()
            found.setdefault((ax, str(kind)), []).append(one)
        texts = [text for text in [*ax.texts, ax.xaxis.label, ax.yaxis.label] if text.get_text()]
        for one in [*texts, *([ax.get_legend()] if ax.get_legend() else [])]:
            found[one] = [one]
    return list(found.values())


# -- colours ---------------------------------------------------------------------------------------

# Machado, Oliveira and Fernandes, IEEE Trans. Visualization and Computer Graphics 15(6), 2009:
# full protanopia and deuteranopia, for linear RGB.
SEEN_BY = {
    "all": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
}
TO_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


def lab(color: str, eye: str) -> np.ndarray:
    """CIELAB of a colour as this eye sees it; 2.3 is a just noticeable difference."""
    rgb = np.array(to_rgb(color))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = TO_XYZ @ np.clip(SEEN_BY[eye] @ linear, 0, 1) / [0.95047, 1.0, 1.08883]
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def nearest(colors: tuple[str, ...], eye: str) -> float:
    pairs = itertools.combinations([lab(color, eye) for color in colors], 2)
    return min(float(np.linalg.norm(one - two)) for one, two in pairs)


@pytest.mark.parametrize("eye", SEEN_BY)
def test_colours_differ_for_every_eye(eye: str) -> None:
    for look in (LIGHT, DARK):
        assert nearest(look.colors, eye) > 17.0
    red_and_green = nearest(("#b05a3c", "#7f7a28"), eye)
    assert (red_and_green > 17.0) == (eye != "deuteranopia")  # what this test would find


def test_colours_stand_out_from_the_background() -> None:
    for look, least in ((LIGHT, 2.2), (DARK, 6.0)):
        assert min(contrast(color, look.face) for color in look.colors) > least
        assert min(contrast(color, look.face) for color in look.colors[:3]) > 3.0
        assert contrast(look.ink, look.face) > 15.0
        assert contrast(look.pale, look.face) > 5.0
    assert contrast("#ffffff", "#000000") == pytest.approx(21.0)


def inside(text: matplotlib.text.Text, ax: matplotlib.axes.Axes) -> bool:
    """Not a label of a tick beyond the range, which is not drawn."""
    low, high = sorted(ax.get_xlim())
    down, up = sorted(ax.get_ylim())
    x, y = text.get_position()
    if text in ax.get_xticklabels():
        return low <= x <= high
    if text in ax.get_yticklabels():
        return down <= y <= up
    return True


def test_the_background_decides() -> None:
    ax = Figure(facecolor="black").add_subplot()
    assert look_of(ax) is LIGHT  # the axes are white
    ax.set_facecolor("none")
    assert look_of(ax) is DARK
    clear = Figure(facecolor="none").add_subplot(facecolor="none")
    assert look_of(clear) is LIGHT
    with matplotlib.rc_context({"text.color": "white"}):
        assert look_of(clear) is DARK
    part = Figure(facecolor="black").subfigures(1, 2)[0]
    assert look_of(part) is DARK
    with matplotlib.style.context("dark_background"):
        assert look_of(se.simulate(([[0.5]], [[1.0]]), [0.0], [[1.0]]).plot()) is DARK


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (0.25, "0.25"), (-2.0, "\u22122"), (0.1 + 0.2, "0.3"), (1000, "1000"),
        (10_000, "10\u2009000"), (1e-4, "0.0001"), (1e6, "$10^{6}$"),
        (-3e-7, r"$-3 \cdot 10^{-7}$"),
    ],
)  # fmt: skip
def test_numbers_on_axes(value: float, text: str) -> None:
    assert number_text(value) == text
