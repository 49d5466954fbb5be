"""The report in a browser: at the width of a desk and of a phone, dark, and printed."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import os
import re
import shutil
from itertools import pairwise
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

import paper
from paper.report.page import COLUMNS, render
from test_lines import loaded

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
if CHROMIUM is None:
    pytest.skip("there is no chromium or google-chrome", allow_module_level=True)

VIEWS = {
    "desk": (1280, False),
    "phone, dark": (390, True),
    **({"desk, dark": (1280, True), "phone": (390, False)} if os.environ.get("SOAK") else {}),
}

# Each returns what is wrong on the page, as a list: empty on a good page.
WIDER_THAN_THE_PAGE = """[...document.querySelectorAll('body *')].filter(one =>
    one.getBoundingClientRect().right > document.documentElement.clientWidth + 1 &&
    !one.closest('.wide, svg')).map(one => one.outerHTML.slice(0, 80))"""
# A word may end a line at a hyphen or slash, or where the page allows it (<wbr>).
BROKEN_WORDS = r"""(() => {
  const found = [], range = document.createRange();
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const text = texts.currentNode;
    for (const word of text.data.matchAll(/[^\s\-−–\/]+/g)) {
      range.setStart(text, word.index); range.setEnd(text, word.index + word[0].length);
      if (new Set([...range.getClientRects()].map(one => Math.round(one.top))).size > 1)
        found.push(word[0]);
    }
  }
  return found;
})()"""
# Letters in a drawing: the height of glyphs as drawn, in pixels, for tick labels at least.
SMALL_LETTERS = """[...document.querySelectorAll('[role=img] svg')].filter(svg =>
    svg.getBoundingClientRect().width / svg.viewBox.baseVal.width * 8.5 < 9)
    .map(svg => svg.getBoundingClientRect().width)"""
# Contrast of every text, and of every line and letter of a drawing, with what is behind it.
POOR_CONTRAST = r"""(() => {
  const numbers = color => (color.match(/[\d.]+/g) || []).map(Number);
  const light = color => {
    const [r, g, b] = numbers(color).map(v => v / 255)
      .map(v => v <= .03928 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4);
    return .2126 * r + .7152 * g + .0722 * b;
  };
  const contrast = (a, b) => {
    const [x, y] = [light(a), light(b)];
    return (Math.max(x, y) + .05) / (Math.min(x, y) + .05);
  };
  const behind = one => {
    for (; one; one = one.parentElement) {
      const color = numbers(getComputedStyle(one).backgroundColor);
      if (color.length === 3 || color[3] === 1) return getComputedStyle(one).backgroundColor;
    }
    return 'rgb(255, 255, 255)';
  };
  const found = [];
  for (const one of document.querySelectorAll('body *')) {
    const style = getComputedStyle(one);
    if (!one.closest('svg')) {
      if ([...one.childNodes].some(node => node.nodeType === 3 && node.data.trim()) &&
          contrast(style.color, behind(one)) < 4.5)
        found.push([one.tagName, style.color, behind(one), one.textContent.slice(0, 30)]);
    } else if (one.tagName === 'use' && one.closest('[role=img]')) {
      // letters and markers: filled, or with an outline
      const paints = [style.fill, style.stroke].filter(paint => paint.startsWith('rgb'));
      if (!paints.some(paint => contrast(paint, behind(one)) >= 2))
        found.push(['letter', style.fill, style.stroke, behind(one)]);
    }
  }
  return found.slice(0, 10);
})()"""

EMPTIED = "document.querySelectorAll('[role=img] svg *').forEach(one => one.remove())"


@pytest.fixture(scope="module")
def report(claimed, experiments, tmp_path_factory):
    directory = tmp_path_factory.mktemp("report")
    with pytest.MonkeyPatch.context() as patch:  # the page has its drawings within
        patch.setattr("paper.report.page.save_figures", lambda *_: [])
        return paper.write_report(experiments, directory, claims=claimed[0])[-1]


@pytest.fixture(scope="module")
def page():
    one = loaded(Path(__file__).parents[2] / "tools" / "check_site.py").Browser(CHROMIUM)
    yield one
    one.close()


@pytest.fixture(params=VIEWS.values(), ids=VIEWS)
def seen(request, page, report):
    width, dark = request.param
    page.open(report.as_uri(), width=width, dark=dark)
    return page


def mutant(report, tmp_path, *changes):
    """The address of the page with some of its text replaced."""
    text = report.read_text("utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "mutant.html"
    path.write_text(text, "utf-8")
    return path.as_uri()


def test_nothing_is_loaded_or_reported(seen, report):
    asked = {one["request"]["url"] for one in seen.reported("Network.requestWillBeSent")}
    assert asked == {report.as_uri()}
    assert seen.reported("Log.entryAdded", "Runtime.consoleAPICalled") == []


def test_nothing_is_wider_than_the_page(seen):
    assert seen.value(
        "document.documentElement.scrollWidth <= document.documentElement.clientWidth"
    )
    assert seen.value(WIDER_THAN_THE_PAGE) == []


def test_no_word_is_broken(seen):
    assert seen.value(BROKEN_WORDS) == []


def test_letters_in_figures_can_be_read(seen):
    assert seen.value(SMALL_LETTERS) == []


def test_contrast(seen):
    assert seen.value(POOR_CONTRAST) == []


def test_panels_are_beside_each_other_at_a_desk_and_stacked_on_a_phone(page, report):
    tops = """[...document.querySelectorAll('.panels')].map(one =>
        new Set([...one.children].map(panel => panel.getBoundingClientRect().top)).size)"""
    page.open(report.as_uri(), width=1280)
    assert page.value(tops) == [1, 1, 1, 1]
    page.open(report.as_uri(), width=390)
    assert page.value(tops) == [2, 2, 2, 2]
    assert page.value("Math.min(...[...document.querySelectorAll('[role=img] svg')].map(one => "
                    "one.getBoundingClientRect().width))") > 340  # fmt: skip


def test_what_scrolls_says_so(page, report):
    scrolling = """[...document.querySelectorAll('.wide')].map(one => [
        one.scrollWidth > one.clientWidth, one.tabIndex,
        getComputedStyle(one).backgroundImage.split('gradient').length - 1])"""
    hint = "getComputedStyle(document.querySelector('.hint')).display"
    page.open(report.as_uri(), width=390)
    assert page.value(scrolling) == [[True, 0, 4]] * 2
    assert page.value(hint) == "block"
    page.open(report.as_uri(), width=1280)
    assert page.value(scrolling) == [[False, 0, 4]] * 2
    assert page.value(hint) == "none"


def test_dark_is_dark(page, report):
    color = "getComputedStyle(document.body).backgroundColor"
    line = """getComputedStyle(document.querySelector(
        '[role=img] [style*="stroke: var(--blue)"]')).stroke"""
    looks = []
    for dark in (False, True):
        page.open(report.as_uri(), dark=dark)
        looks.append((page.value(color), page.value(line)))
    assert looks[0] == ("rgb(255, 255, 255)", "rgb(0, 114, 178)")
    assert sum(map(int, re.findall(r"\d+", looks[1][0]))) < 120
    assert looks[1][1] != looks[0][1]


def test_headings_landmarks_and_names(page, report):
    page.open(report.as_uri())
    levels = page.value(
        "[...document.querySelectorAll('h1,h2,h3,h4')].map(one => Number(one.tagName[1]))"
    )
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert page.value("document.querySelectorAll('main').length") == 1
    tree = page.call("Accessibility.getFullAXTree")["nodes"]
    named = [
        (node["role"]["value"], node["name"]["value"])
        for node in tree
        if not node["ignored"] and "role" in node and "name" in node
    ]
    images = [name for role, name in named if role == "image"]
    assert len(images) == 8  # three figures of two panels, and one of the statements
    assert all(re.search(r"\d.* N = \d+", name) for name in images)
    assert {"Contents", "Statements"} <= {name for role, name in named if role == "navigation"}
    assert [name for role, name in named if role == "columnheader"] == [
        "relative error", *COLUMNS.values(), "exact rms", "z"
    ]  # fmt: skip
    assert sum(role == "rowheader" for role, _ in named) >= 33
    assert any(role.startswith("MathML") or role == "math" for role, _ in named)


@pytest.mark.parametrize(("width", "dark"), list(VIEWS.values())[1:], ids=list(VIEWS)[1:])
def test_axe_finds_nothing(page, report, width, dark):
    page.open(report.as_uri(), width=width, dark=dark)
    assert axe(page) == []


def axe(page):
    """The rules of axe-core that the page breaks."""
    found = importlib.util.find_spec("axe_core_python")
    if found is None:
        pytest.skip("axe-core-python is not installed")
    page.value(Path(found.origin).with_name("axe.min.js").read_text("utf-8") + ";0")
    said = page.value("axe.run(document, {resultTypes: ['violations']}).then(r => JSON.stringify("
                    "r.violations.map(v => [v.id, v.nodes.length, v.nodes[0].html])))")  # fmt: skip
    return json.loads(said)


def test_print_keeps_together_what_belongs_together(page, report, tmp_path):
    pypdf = pytest.importorskip("pypdf")
    pages = printed(pypdf, page, report.as_uri(), tmp_path)
    assert faults_in_print(pages) == []
    assert sum("exact rms z" in text for text in pages) >= 2  # the table has a break


def printed(pypdf, page, address, tmp_path):
    """The text of each printed page, of drawings nothing but their place: they are read slowly."""
    page.open(address, dark=True)
    page.value(EMPTIED)
    page.pdf(tmp_path / "report.pdf")
    reader = pypdf.PdfReader(tmp_path / "report.pdf")
    return [" ".join(one.extract_text().split()) for one in reader.pages]


def faults_in_print(pages):
    """Table rows on a page without the heads; captions on another page than their figure."""
    heads = " ".join([*COLUMNS.values(), "exact rms z"])
    faults = [
        f"no heads on page {k}"
        for k, text in enumerate(pages, start=1)
        if re.search(r"SLSE, safeguarded (\d\.?\d* ){4}", text) and heads not in text
    ]
    for title, caption in (
        ("Figure 1: ", "Relative error of the estimates (a)"),
        ("Figure 2: ", "Relative error (a) of the computed control"),
        ("Figure 3: ", "Relative error (a) of the computed x(1)"),
        ("What the lemmas say, and what happens", "(a) The error of the state"),
    ):
        if not any(title in text and caption in text for text in pages):
            faults.append(f"{title} is parted from its caption")
    ends = r"(Figures|Errors after all samples|What agrees with the paper|What was run|" \
           r"What cannot agree, and why|To repeat it|statement by statement|: (holds|false)|" \
           r"holds with a correction)$"  # fmt: skip
    contents = next(k for k, text in enumerate(pages) if "Contribution vi: false" in text)
    faults += [
        f"a heading ends page {k + 1}"
        for k, text in enumerate(pages)
        if re.search(ends, text) and k != contents
    ]
    return faults


# What each check would miss if it could not fail.
MUTANTS = {
    "a fixed width": (("main>", 'main style="display:block;width:1400px">'), WIDER_THAN_THE_PAGE),
    "words broken anywhere": ((".lead {", "p { word-break: break-all } .lead {"), BROKEN_WORDS),
    "panels never stacked": (("repeat(auto-fit, minmax(min(24rem, 100%), 1fr))", "1fr 1fr"),
                             SMALL_LETTERS),
    "pale words": (("--ink: #222222", "--ink: #bbbbbb"), POOR_CONTRAST),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_checks_find_what_is_wrong(page, report, tmp_path, name):
    change, script = MUTANTS[name]
    page.open(mutant(report, tmp_path, change), width=390)
    assert page.value(script) != []


def test_axe_finds_what_is_wrong(page, report, tmp_path):
    changes = ('<html lang="en">', "<html>"), ('role="img" aria-label="', 'role="img" data-x="')
    page.open(mutant(report, tmp_path, *changes))
    page.value(EMPTIED)
    assert {"html-has-lang", "role-img-alt"} <= {one[0] for one in axe(page)}


def test_print_without_rules_is_found(page, report, tmp_path):
    pypdf = pytest.importorskip("pypdf")
    address = mutant(
        report, tmp_path, ("@media print", "@media none"), ("<thead>", "<tbody>"),
        ("</thead>", "</tbody>"),
    )  # fmt: skip
    faults = faults_in_print(printed(pypdf, page, address, tmp_path))
    assert any(one.startswith("no heads") for one in faults)
    assert any("parted" in one or "heading" in one for one in faults)


def test_a_long_hostile_name_does_not_widen_the_page(page, experiments, tmp_path):
    name = "<script>document.title = 'gone'</script> \u202e\u05d0\u05d1 " + "longname" * 20
    settings = {**experiments[0].settings, "system": name}
    hostile = dataclasses.replace(experiments[0], title=name, settings=settings)
    path = tmp_path / "report.html"
    path.write_text(render("report.html.j2", [hostile], title="A report", claims=None), "utf-8")
    page.open(path.as_uri(), width=390)
    assert page.value("document.title") != "gone"
    assert page.value("document.documentElement.scrollWidth") == 390
    assert name in " ".join(page.value("document.querySelector('figcaption').textContent").split())
