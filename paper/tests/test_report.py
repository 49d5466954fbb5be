"""The report: self-contained, well-formed, with the given numbers."""

from __future__ import annotations

import dataclasses
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

from markupsafe import escape

import paper
from paper import Experiment, power
from paper.report.formulas import number, percent, readable
from paper.report.page import COLUMNS, render

VOID = {"meta", "img", "br", "wbr", "hr", "link", "input"}
PAPER = "https://arxiv.org/abs/2304.11755"


@pytest.fixture(scope="module")
def written(experiments, tmp_path_factory):
    directory = tmp_path_factory.mktemp("report") / "new" / "folder"
    return directory, paper.write_report(experiments, directory)


class Page(HTMLParser):
    """Collects what a browser would load, the text, and unclosed elements."""

    def __init__(self, text):
        super().__init__()
        self.loads, self.open, self.faults, self.words, self.images = [], [], [], [], []
        self.links, self.ids = [], []
        self.feed(text)
        self.close()
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.loads += [attributes[k] for k in ("src", "srcset", "data") if k in attributes]
        self.links += [attributes["href"]] if "href" in attributes else []
        self.ids += [attributes["id"]] if "id" in attributes else []
        if attributes.get("role") == "img":
            self.images.append(attributes["aria-label"])
        if tag in {"script", "iframe", "object", "link"}:
            self.faults.append(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

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
    source = (written[0] / "report.html").read_text(encoding="utf-8")
    assert page.loads == []
    assert "@import" not in source
    assert set(re.findall(r"url\((.)", source)) == {"#"}
    assert set(re.findall(r"https?://[^\"]*", source)) - {PAPER} <= {
        "http://www.w3.org/2000/svg",
        "http://www.w3.org/1999/xlink",
    }
    assert len(source) < 1_000_000


def test_links_lead_to_something(page):
    assert PAPER in page.links
    assert len(page.ids) == len(set(page.ids))
    within = {link[1:] for link in page.links if link != PAPER}
    assert within <= set(page.ids)
    assert {"figures", "errors", "agreements", "deviations", "settings", "repeat"} <= within


def test_page_is_well_formed(page):
    assert page.faults == []
    assert page.open == []


def test_figures_say_what_is_seen(page, experiments):
    shown = [(one, p) for one in experiments for p in one.panels if p.figure]
    assert len(page.images) == len(shown)
    for said, (experiment, panel) in zip(page.images, shown, strict=True):
        assert panel.quantity in said
        assert f"N = {experiment.sizes[0]} to N = {experiment.sizes[-1]}" in said
        for curve in panel.curves:
            if curve.median[-1] > panel.zero_level:
                assert f"to {percent(curve.median[-1])}" in said
    assert len(set(page.images)) == len(shown)


def test_drawings_have_the_colours_of_the_page(written):
    source = (written[0] / "report.html").read_text(encoding="utf-8")
    style, _, body = source.partition("</style>")
    assert re.findall(r"#[0-9a-f]{6}\b", body) == []
    used = set(re.findall(r"var\(--([a-z]+)\)", source))
    light, dark = re.findall(r":root \{([^}]*--paper[^}]*)\}", style)
    for given in (light, dark):
        assert used - {"soft", "box", "shade"} <= set(re.findall(r"--([a-z]+):", given))


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
        assert experiment.key in page.text.replace(" ", "")
        assert experiment.title in page.text
    for row in paper.final_errors(experiments):
        assert number(row["median"]) in page.text or "e-" in number(row["median"])
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
    assert '<th scope="col" class="n">runs</th><th scope="col" class="n">exact rms</th>' in table
    assert table.count('<td class="n">4</td>') == len(paper.final_errors(experiments[:1]))


def test_the_time_of_a_short_run(experiments):
    quick = dataclasses.replace(experiments[0], seconds=0.04)
    assert "<dd>&lt; 0.1 s</dd>" in render("settings.html.j2", [quick])


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
    assert "from N&nbsp;=&nbsp;17 on" in after
    assert "deviate from" in after
    text = render("deviations.html.j2", [Experiment.from_dict(swapped)], claims=None)
    assert "no run met such a sample" in text.partition("Algorithm 1: the stopping rule")[2]


def test_hostile_names_are_escaped(experiments, claimed):
    hostile = "<script>alert('1')</script> & \"x\" $\\frac{ \u202e\u05d0\u05d1"
    panels = tuple(dataclasses.replace(p, quantity=hostile) for p in experiments[0].panels)
    settings = {**experiments[0].settings, "system": hostile}
    one = dataclasses.replace(experiments[0], title=hostile, settings=settings, panels=panels)
    claim = paper.Claim(hostile, hostile, "false", hostile, ())
    found = claimed[0]
    claims = dataclasses.replace(found, rows=(claim, *found.rows))
    text = render("report.html.j2", [one], title="A report", claims=claims)
    page = Page(text)
    assert page.faults == []
    assert hostile in page.text
    assert all(hostile in said for said in page.images[:-2])
    assert text.count("<script") == 0
    assert text.count(f"<bdi>{escape(hostile)}</bdi>") >= 5  # its direction stays its own
    assert all(readable(row.says) in text for row in claims.rows)
    assert page.images[-2:] == [claims.tails.seen, claims.comparison.seen]


def test_one_experiment_is_enough(experiments, tmp_path):
    paths = paper.write_report(experiments[1:], tmp_path, title="<b> & co")
    text = paths[-1].read_text(encoding="utf-8")
    assert Page(text).faults == []
    assert "<h1>&lt;b&gt; &amp; co</h1>" in text
    assert "(ALSE, uniform weights) in a random system" in " ".join(text.split())
    assert "Lemma 4.4" not in text
    with pytest.raises(ValueError, match="at least one"):
        paper.write_report([], tmp_path)


def test_code_to_repeat_gives_the_same_numbers(page, experiments, tmp_path):
    import stochens_rs as se

    source = page.text[page.text.index("import paper") :]
    source = source[: source.index("The same key gives")]
    calls = [f"paper.{part}" for part in source.split("paper.")[1:]]
    for call, experiment in zip(calls, experiments, strict=True):
        again = eval(call, {"se": se, "paper": paper})
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


def test_none_is_said_once(experiments):
    data = experiments[0].to_dict()
    for panel in ("1a", "1b"):
        data["facts"]["ordering"][panel]["safeguarded_above_uniform"] = 0.0
        data["facts"]["ordering"][panel]["alse_above_slse"] = 0.0
    text = render("deviations.html.j2", [Experiment.from_dict(data)], claims=None)
    assert "0 %" not in text.replace("10 %", "").replace("100", "")
    assert text.count("in none of these pairs") == 2
    data["facts"]["ordering"]["1b"]["alse_above_slse"] = 0.25
    text = render("deviations.html.j2", [Experiment.from_dict(data)], claims=None)
    assert "in none of these pairs for" in text
    assert "25\u00a0%" in text


def test_methods_have_one_name(page):
    assert not re.search(r"\b(alse|slse)\b", page.text.partition("import stochens_rs")[0])


def test_what_was_found_is_said_first(page, experiments):
    said = page.text[: page.text.index("Figures")]
    power_, tracking_ = experiments
    for panel in (power_.panel("1b"), power_.panel("2b"), tracking_.panel("3a")):
        for method in ("alse", "uniform"):
            assert percent(panel.curve(method).median[-1]) in said
