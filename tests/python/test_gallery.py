"""Every example of the gallery runs, prints no warning, and draws a figure."""

from __future__ import annotations

import ast
import re
import runpy
import time
import warnings
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")

GALLERY = Path(__file__).resolve().parents[2] / "docs" / "gallery"
EXAMPLES = sorted(GALLERY.glob("plot_*.py"))


@pytest.fixture
def pyplot(monkeypatch):
    """Pyplot that opens no window, as it was before afterwards."""
    import matplotlib

    monkeypatch.setenv("MPLBACKEND", "agg")
    with matplotlib.rc_context():
        matplotlib.use("agg")
        import matplotlib.pyplot as plt

        plt.close("all")
        monkeypatch.setattr(plt, "show", lambda: None)
        yield plt
        plt.close("all")


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_draws_a_figure_without_warnings(path, pyplot, record_property, capsys):
    begin = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        runpy.run_path(str(path), run_name="__main__")
    record_property("seconds", round(time.perf_counter() - begin, 2))
    figures = [pyplot.figure(number) for number in pyplot.get_fignums()]
    assert figures, "no figure"
    assert all(ax.has_data() for figure in figures for ax in figure.axes)
    assert "warning" not in capsys.readouterr().err.lower()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_asks_a_question_and_uses_public_names_only(path):
    tree = ast.parse(path.read_text("utf-8"))
    title, line = (ast.get_docstring(tree) or "").splitlines()[:2]
    assert title.endswith("?"), "the title is a question"
    assert line == "=" * len(title)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert not (node.module or "").startswith("stochens_rs")
        if isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_")


THEORY = GALLERY.parent / "theory"


@pytest.mark.parametrize("path", sorted(THEORY.glob("[a-z]*.md")), ids=lambda path: path.stem)
def test_formulas_are_written_as_mathml_is_made_of_them(path):
    """Arguments have braces, and no subscript is on an accent: it would go below the letter."""
    text = path.read_text("utf-8")
    assert re.findall(r"\\(?:frac|binom|hat|bar)(?!\{).*", text) == []
    assert re.findall(r"\\(?:hat|bar)\{.\}_.*", text) == []
    assert re.findall(r"^\|.*\\\|.*", text, re.M) == [], (
        "in a table this is one stroke: use \\lVert"
    )
