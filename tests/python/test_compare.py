"""The page that compares features is what its declarations say, and our own column is true."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "compare.md"
if not PAGE.exists():
    pytest.skip("not run from a checkout", allow_module_level=True)
for needed in ("control", "packaging", "pandas", "scipy", "xarray"):
    pytest.importorskip(needed)

sys.path.insert(0, str(ROOT / "tools"))
comparison = importlib.import_module("comparison")
tool = importlib.import_module("compare_features")
sys.path.remove(str(ROOT / "tools"))

OWN = [row for row, package in comparison.CELLS if package == "stochens_rs"]


def test_every_cell_is_declared():
    assert set(comparison.CELLS) == {(r, p) for r in comparison.ROWS for p in comparison.PACKAGES}


def test_the_page_is_what_is_declared():
    page = PAGE.read_text(encoding="utf-8")
    head = page.splitlines()[2]
    sizes = page.partition("## Size")[2].partition("## Notes")[0].strip().splitlines()[2:]
    assert page == tool.text(head, sizes)
    assert [row.split(" | ")[0].removeprefix("| ") for row in sizes] == list(tool.MEASURED)


def test_the_head_names_versions_and_date():
    head = PAGE.read_text(encoding="utf-8").splitlines()[2]
    assert head.startswith("stochens_rs ")
    for title in comparison.TITLES.values():
        assert re.search(rf"{title} \d+\.\d+", head)
    assert re.search(r"\d{4}-\d\d-\d\d\.$", head)


# "wheels" asks the package index.
@pytest.mark.parametrize("row", [row for row in OWN if row != "wheels"])
def test_own_cell(row):
    comparison.CELLS[row, "stochens_rs"].check()


def test_wrong_cells_are_seen(monkeypatch):
    def cell(line):
        _, cells = comparison.read_cells(f"# Group\n\nmodel: label\n  stochens_rs = {line}\n")
        return cells["model", "stochens_rs"]

    with pytest.raises(AssertionError, match=r"stochens_rs has .*identify"):
        cell("no | lacks ident").check()
    with pytest.raises(AssertionError, match=r"stochens_rs lacks .*'kalman_filter'"):
        cell("yes | has identify kalman_filter").check()
    cell("no | lacks ^identify$; but identify").check()
    for wrong in ("partly | has identify", "perhaps | has identify"):
        with pytest.raises(ValueError, match="stochens_rs, model"):
            cell(wrong)
    monkeypatch.setattr(comparison, "annotated", lambda _: 0.5)
    with pytest.raises(AssertionError):
        comparison.CELLS["types", "stochens_rs"].check()
