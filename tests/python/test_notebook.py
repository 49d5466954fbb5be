"""A notebook shows every figure and record exactly once."""

from __future__ import annotations

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")
pytest.importorskip("matplotlib")

START = """
import numpy as np, stochens_rs as se
import tempfile
system = se.System([[0.9, 0.2], [-0.1, 0.8]], [[1.0, 0.0], [0.5, 1.0]], dt=0.1)
x0, xf = [1.0, 2.0], [0.0, 0.0]
way = se.simulate(system, x0, np.zeros((20, 2)))
spread = se.simulate_ensemble(system, x0, np.zeros((20, 2)), 50, rng=1)
stream = se.Stream(system, x0, xf, rng=1)
stream.step(100)
plan = se.steer(system, x0, xf, 100, rng=1)
"""

# What a cell says, and how many pictures it shall show.
CELLS = [
    ("way.plot()", 1),
    ("ax = way.plot()", 1),
    ("ax = way.plot()\nax.set_title('changed later')\n1 + 1", 1),
    ("way.plot(); way.plot()", 2),
    ("spread.plot()", 1),
    ("stream.trace.plot()", 1),
    ("files = se.plots.save(spread.plot(), tempfile.mkdtemp() + '/spread')", 1),
    ("import matplotlib.pyplot as plt\nfig, ax = plt.subplots()\nway.plot(ax=ax)", 1),
    ("ax = plt.figure().add_subplot()\nspread.plot(ax=ax);", 1),
    ("assert plt.get_fignums() == []", 0),
]


RECORDS = ["way", "spread", "stream", "stream.trace", "plan", "plan.bound()"]
TEXTS = [*(text for text, _ in CELLS), *RECORDS]


@pytest.fixture(scope="module")
def outputs():
    """Outputs of every cell of a notebook that starts without pyplot, as a user's does."""
    cells = [nbformat.v4.new_code_cell(text) for text in (START, *TEXTS)]
    notebook = nbformat.v4.new_notebook(cells=cells)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("MPLBACKEND", raising=False)  # the kernel sets it to its own
        nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    return {cell.source: cell.outputs for cell in notebook.cells}


def pictures(cell):
    return [one for one in cell if "image/png" in one.get("data", {})]


@pytest.mark.parametrize(("text", "wanted"), CELLS)
def test_every_figure_is_shown_once(text, wanted, outputs):
    assert len(pictures(outputs[text])) == wanted
    assert not [one for one in outputs[text] if one.output_type == "stream"]


@pytest.mark.parametrize("name", RECORDS)
def test_records_are_shown_as_tables(name, outputs):
    (shown,) = outputs[name]
    assert "<table" in shown["data"]["text/html"] or name == "stream.trace"
    assert "<b>" in shown["data"]["text/html"]
    assert "text/plain" in shown["data"]


def test_nothing_is_printed_on_import(outputs):
    assert outputs[START] == []
