"""The figures: everything is labelled, zeros are visible, no global state changes."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("matplotlib")

import matplotlib
import matplotlib.image
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from paper import Curve, Experiment, Panel
from paper.figures import _number, _ticks
from paper.methods import STYLES
from stochens_rs import plots
from stochens_rs.exceptions import InputError


def made(*, zeros=False, name="power"):
    """A small finished experiment with known curves; with `zeros`, ALSE ends at 0 exactly."""
    sizes = np.array([1, 10, 100, 1000])
    curves = []
    for (method, fusion), rate in zip(STYLES, np.linspace(0.4, 1.2, len(STYLES)), strict=True):
        errors = np.array([0.8, 1.0, 1.3])[:, None] * sizes**-rate
        if zeros and method == "alse":
            errors[:, 2] = [0.0, 1e-16, 0.2]
            errors[:, 3] = 0.0
        exact = 1.05 * sizes**-rate if method == "uniform" else None
        spread = 0.3 * sizes ** (-2 * rate) if method == "uniform" else None
        curves.append(Curve(method, fusion, errors, exact, spread))
    panels = tuple(
        Panel(f"1{letter}", "1", what, "$e$", 1.0, 1e-13, "zero to rounding", tuple(curves))
        for letter, what in (("a", "initial state"), ("b", "system matrix"))
    )
    settings = {"system": "made up", "n": 2, "m": 1, "samples": 1000}
    return Experiment(name, "A title", "0" * 64, settings, sizes, panels, {}, 0.0)


def test_given_axes_are_used_and_no_style_is_changed():
    ax, before = Figure().add_subplot(), dict(matplotlib.rcParams)
    assert made().plot_panel("1a", ax=ax) is ax
    assert len(ax.lines) > 0
    made().plot()
    assert dict(matplotlib.rcParams) == before


def test_everything_is_labelled():
    figure = made().plot_figure("1")
    assert len(figure.axes) == 2
    for ax, title in zip(figure.axes, ("(a) initial state", "(b) system matrix"), strict=True):
        assert ax.get_title(loc="left") == title
        assert "samples" in ax.get_xlabel()
        assert "relative error" in ax.get_ylabel()
        assert ax.get_xscale() == ax.get_yscale() == "log"
    words = " ".join(text.get_text() for text in figure.texts)
    for word in ("Figure 1", "n = 2", "m = 1", "N ≤ 1000", "3 replicates"):
        assert word in words
    (legend,) = figure.legends
    labels = {text.get_text() for text in legend.get_texts()}
    assert {style.label for style in STYLES.values()} <= labels
    assert {"exact rms of uniform", "10-90 % of replicates", "one single run"} <= labels


def test_curves_hold_the_medians_and_the_exact_values():
    experiment = made()
    ax = experiment.plot_panel("1a")
    by_label = {line.get_label(): line for line in ax.lines}
    panel = experiment.panel("1a")
    for curve in panel.curves:
        line = by_label[STYLES[curve.method, curve.fusion].label]
        assert np.array_equal(line.get_xdata(), experiment.sizes)
        assert np.array_equal(line.get_ydata(), curve.median)
    drawn = [line.get_ydata() for line in ax.lines]
    exact = panel.curve("uniform", "product").exact_rms
    assert any(np.array_equal(y, exact) for y in drawn)
    low, high = ax.get_ylim()
    assert low < min(np.min(y) for y in drawn)
    assert high > max(np.max(y) for y in drawn)


def test_zero_is_drawn_inside_the_axes_and_labelled():
    ax = made(zeros=True).plot_panel("1a")
    alse = next(line for line in ax.lines if line.get_label() == "ALSE")
    y = np.asarray(alse.get_ydata())
    low, _ = ax.get_ylim()
    assert np.all(np.isfinite(y))
    assert y[-1] == y[-2] > low > 0
    smallest = made().panel("1a").curve("slse-safeguarded").errors.min()
    assert y[-1] < smallest
    labels = [label.get_text() for label in ax.get_yticklabels()]
    assert labels.count("0") == 1
    assert any("zero to rounding" in text.get_text() for text in ax.texts)
    without = made().plot_panel("1a")
    assert "0" not in [label.get_text() for label in without.get_yticklabels()]
    assert len(without.texts) == 0


def test_an_experiment_with_nothing_but_zeros_can_be_drawn():
    sizes = np.array([1, 2])
    panel = Panel(
        "1a", "1", "x", "$e$", 1.0, 1e-13, "zero", (Curve("alse", None, np.zeros((2, 2))),)
    )
    experiment = Experiment(
        "power",
        "t",
        "0" * 64,
        {"system": "c", "n": 1, "m": 1, "samples": 2},
        sizes,
        (panel,),
        {},
        0.0,
    )
    figure = experiment.plot_figure("1")
    figure.canvas.draw()
    assert np.all(np.isfinite(figure.axes[0].get_ylim()))


def test_styles_differ_without_colour():
    assert len({(str(s.line), s.marker) for s in STYLES.values()}) == len(STYLES)
    assert len({s.marker for s in STYLES.values()}) == len(STYLES)
    assert len({to_rgb(s.color) for s in STYLES.values()}) == len(STYLES)


def test_saved_figures_are_not_blank_and_do_not_change(tmp_path):
    (tmp_path / "again").mkdir()
    paths = plots.save_figures(made(zeros=True).plot(), tmp_path)
    again = plots.save_figures(made(zeros=True).plot(), tmp_path / "again")
    assert [p.name for p in paths] == ["power-figure-1.png", "power-figure-1.svg"]
    for one, two in zip(paths, again, strict=True):
        assert one.read_bytes() == two.read_bytes()
    image = matplotlib.image.imread(paths[0])
    assert image.shape[1] >= 1500  # 10 inches at no less than 150 dpi
    assert np.mean(image[..., :3].min(axis=2) < 0.9) > 0.02  # enough ink
    # Nothing is cut off: the outermost pixels are background.
    edges = [image[0], image[-1], image[:, 0], image[:, -1]]
    assert all(np.all(edge[..., :3] == 1.0) for edge in edges)
    svg = paths[1].read_text(encoding="utf-8")
    assert "<dc:date>" not in svg
    assert svg.count("<path") > 50


def test_unknown_names():
    with pytest.raises(InputError, match="9z"):
        made().plot_panel("9z")
    with pytest.raises(KeyError, match="figure"):
        made().plot_figure("7")


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.05, 30.0, [0.1, 1.0, 10.0]),
        (0.4, 9.0, [0.5, 1.0, 2.0, 5.0]),
        (1e-12, 1.0, [1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2, 1.0]),
    ],
)
def test_ticks(low, high, expected):
    assert _ticks(low, high).tolist() == pytest.approx(expected)


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.0, "1"), (0.01, "0.01"), (0.5, "0.5"), (1000.0, "1000"), (1e-6, "$10^{-6}$")],
)
def test_tick_labels(value, text):
    assert _number(value) == text
