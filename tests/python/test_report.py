"""The report: self-contained, well-formed, with the given numbers."""

from __future__ import annotations

import base64
import dataclasses
import json
import subprocess
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

from stochens_rs import paper
from stochens_rs.paper import power, tracking
from stochens_rs.paper.report.page import COLUMNS, number, percent, render
from stochens_rs.studies import Experiment

VOID = {"meta", "img", "br", "hr", "link", "input"}


@pytest.fixture(scope="module")
def experiments():
    return [
        power(rng=3, replicates=4, samples=60),
        tracking(rng=3, replicates=2, samples=30, n=10, m=8),
    ]


@pytest.fixture(scope="module")
def written(experiments, tmp_path_factory):
    directory = tmp_path_factory.mktemp("report") / "new" / "folder"
    return directory, paper.write_report(experiments, directory)


class Page(HTMLParser):
    """Collects what a browser would load, the text, and unclosed elements."""

    def __init__(self, text):
        super().__init__()
        self.loads, self.open, self.faults, self.words, self.images = [], [], [], [], []
        self.feed(text)
        self.close()
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.loads += [attributes[k] for k in ("src", "href", "srcset", "data") if k in attributes]
        if tag == "img":
            self.images.append(attributes)
        if tag in {"script", "iframe", "object", "link"}:
            self.faults.append(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.faults.append(f"/{tag}")

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "title"):
            self.words.append(data)


@pytest.fixture(scope="module")
def page(written):
    return Page((written[0] / "report.html").read_text(encoding="utf-8"))


def test_files(written):
    directory, paths = written
    assert paths[-1] == directory / "report.html"
    assert {p.name for p in paths} == {
        "results.json",
        "report.html",
        *(f"power-figure-{k}.{kind}" for k in (1, 2) for kind in ("png", "svg")),
        *(f"tracking-figure-3.{kind}" for kind in ("png", "svg")),
    }
    assert {p.name for p in directory.iterdir()} == {p.name for p in paths}  # no leftovers


def test_nothing_is_loaded_from_elsewhere(written, page):
    assert page.loads
    assert all(load.startswith("data:image/svg+xml;base64,") for load in page.loads)
    source = (written[0] / "report.html").read_text(encoding="utf-8")
    assert "url(" not in source
    assert "@import" not in source
    assert "http://" not in source
    assert "https://" not in source


def test_page_is_well_formed(page):
    assert page.faults == []
    assert page.open == []


def test_figures_are_inlined_with_descriptions(written, page):
    assert len(page.images) == 3
    for image, number_ in zip(page.images, (1, 2, 3), strict=True):
        assert f"Figure {number_}" in image["alt"]
        name = f"{'tracking' if number_ == 3 else 'power'}-figure-{number_}.svg"
        data = base64.b64decode(image["src"].partition(",")[2])
        assert data == (written[0] / name).read_bytes()


def test_results_hold_everything(written, experiments):
    data = json.loads((written[0] / "results.json").read_text(encoding="utf-8"))
    assert data["versions"]["numpy"] == np.__version__
    again = [Experiment.from_dict(one) for one in data["experiments"]]
    for one, other in zip(again, experiments, strict=True):
        assert one.key == other.key
        assert one.settings == other.settings
        assert [c.errors.tolist() for p in one.panels for c in p.curves] == [
            c.errors.tolist() for p in other.panels for c in p.curves
        ]


def test_text_quotes_the_results(page, experiments):
    first, second = experiments
    for experiment in experiments:
        assert experiment.key in page.text
        assert experiment.title in page.text
    for row in paper.final_errors(experiments):
        assert number(row["median"]) in page.text
    assert percent(first.facts["reachability"]["relative"]) in page.text
    needed = second.facts["samples_for_ten_percent"]["product"]
    assert f"{needed:,}".replace(",", "\u2009") in page.text
    for word in ("Lemma 4.4", "Lemma 4.5", "Algorithm 1", "Section 5.2"):
        assert word in page.text


def test_rounding_is_no_figure():
    experiment = power(rng=1, replicates=2, samples=400)
    rows = paper.final_errors([experiment])
    assert [(row["panel"], row["method"]) for row in rows if row["zero"]] == [("1a", "alse")]
    table = render("errors.html.j2", [experiment])
    assert table.count('<td class="n" colspan="4">zero to rounding</td>') == 1
    assert "e-1" not in table


def test_a_column_of_the_table_is_shown(experiments, monkeypatch):
    monkeypatch.setitem(COLUMNS, "replicates", "runs")
    table = render("errors.html.j2", experiments[:1])
    assert '<th class="n">runs</th><th class="n">exact rms</th>' in table
    assert table.count('<td class="n">4</td>') == len(paper.final_errors(experiments[:1]))


def test_the_time_of_a_short_run(experiments):
    quick = dataclasses.replace(experiments[0], seconds=0.04)
    assert "<td>&lt; 0.1 s</td>" in render("settings.html.j2", [], experiment=quick)


def test_words_are_not_broken(written):
    source = (written[0] / "report.html").read_text(encoding="utf-8")
    assert "break-all" not in source
    assert "h1, h2, h3, table, figcaption" in source  # one typeface for heads and cells


def test_sentences_change_with_the_numbers(experiments):
    data = experiments[0].to_dict()
    swapped = json.loads(json.dumps(data))
    for panel in swapped["panels"]:
        by_method = {c["method"]: c for c in panel["curves"]}
        uniform, alse = by_method["uniform"], by_method["alse"]
        uniform["errors"], alse["errors"] = alse["errors"], uniform["errors"]
    swapped["facts"]["zero_from"]["1a"] = 17
    swapped["facts"]["theory"]["largest_abs_z"] = 9.5
    swapped["facts"]["stopping_rule"]["median_stop"] = None
    before = render("agreements.html.j2", experiments[:1])
    after = render("agreements.html.j2", [Experiment.from_dict(swapped)])
    assert "is not reproduced" not in before
    assert after.count("is not reproduced") == 2
    assert "from N = 17 on" in after
    assert "deviate from" in after
    text = render("deviations.html.j2", [Experiment.from_dict(swapped)], claims=None)
    assert "no run met such a sample" in text.partition("Algorithm 1: the stopping rule")[2]


def test_hostile_names_are_escaped(experiments, tmp_path):
    hostile = "<script>alert('1')</script> & \"x\""
    panels = tuple(dataclasses.replace(p, quantity=hostile) for p in experiments[0].panels)
    settings = {**experiments[0].settings, "system": hostile}
    one = dataclasses.replace(experiments[0], title=hostile, settings=settings, panels=panels)
    claim = paper.Claim(hostile, hostile, "false", hostile, ())
    found = paper.claims(quick=True)
    claims = dataclasses.replace(found, rows=(claim, *found.rows))
    text = paper.write_report([one], tmp_path, claims=claims)[-1].read_text(encoding="utf-8")
    page = Page(text)
    assert page.faults == []
    assert hostile in page.text
    assert f"Figure 1: {hostile}" in [image["alt"] for image in page.images]
    assert text.count("<script>") == 0
    assert all(row.says in page.text for row in claims.rows)


@pytest.mark.parametrize("missing", ["matplotlib", "jinja2"])
def test_what_is_missing_is_named_before_anything_runs(missing, tmp_path):
    code = (
        f"import sys; sys.modules['{missing}'] = None\n"
        "from stochens_rs.cli import main\n"
        f"sys.argv[1:] = ['reproduce', '--out', {str(tmp_path / 'new')!r}]\nsys.exit(main())\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode != 0
    assert f"need {missing}" in run.stderr.lower()
    assert "stochens_rs[plot]" in run.stderr
    assert not (tmp_path / "new").exists()


def test_one_experiment_is_enough(experiments, tmp_path):
    paths = paper.write_report(experiments[1:], tmp_path, title="<b> & co")
    text = paths[-1].read_text(encoding="utf-8")
    assert Page(text).faults == []
    assert "<h1>&lt;b&gt; &amp; co</h1>" in text
    assert "Lemma 4.4" not in text
    with pytest.raises(ValueError, match="at least one"):
        paper.write_report([], tmp_path)


def test_code_to_repeat_gives_the_same_numbers(page, experiments, tmp_path):
    import stochens_rs as se

    source = page.text[page.text.index("import stochens_rs as se") :]
    source = source[: source.index("The same key gives")]
    calls = [f"se.paper.{part}" for part in source.split("se.paper.")[1:]]
    for call, experiment in zip(calls, experiments, strict=True):
        again = eval(call, {"se": se})
        for a, b in zip(again.panels, experiment.panels, strict=True):
            assert np.array_equal(a.curves[-1].errors, b.curves[-1].errors)


def test_final_errors_are_the_last_column(experiments):
    rows = paper.final_errors(experiments)
    assert len(rows) == 4 + 4 + 5 + 5 + 3 * 5
    row = next(r for r in rows if (r["panel"], r["method"]) == ("2a", "uniform (diagonal)"))
    curve = experiments[0].panel("2a").curve("uniform", "diagonal")
    assert row["median"] == np.median(curve.errors[:, -1])
    assert row["exact_rms"] == curve.exact_rms[-1]
    assert row["z"] == curve.z[-1]
    assert all((r["z"] is None) == (not r["method"].startswith("uniform")) for r in rows)


def test_save_writes_one_experiment(experiments, tmp_path):
    paths = experiments[0].save(tmp_path / "a" / "b")
    assert paths[0].name == "power.json"
    assert all(p.stat().st_size > 5000 for p in paths)
    data = json.loads(paths[0].read_text(encoding="utf-8"))
    assert Experiment.from_dict(data).key == experiments[0].key


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.0, "0 %"), (1.0, "100 %"), (1e-5, "less than 0.01 %"), (0.0312, "3.1 %"), (0.28, "28 %")],
)
def test_percent(share, text):
    assert percent(share) == text
