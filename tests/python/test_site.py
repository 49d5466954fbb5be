"""The sources of the site agree with each other and with the package; nothing is built here."""

from __future__ import annotations

import ast
import inspect
import json
import re
import shutil
import sys
from pathlib import Path

import pytest

import stochens_rs as se
from test_lines import loaded
from test_public_names import ROOMS, TOP

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
if not (DOCS / "conf.py").exists():
    pytest.skip("not run from a checkout", allow_module_level=True)


PAGES = loaded(DOCS / "_site" / "pages.py")
# Pages that a build writes: by sphinx-gallery, and by docs/theory/_claims.py.
MADE = {"examples/index", "theory/claims"}
NOTEBOOKS = loaded(DOCS / "_site" / "notebooks.py")
CHECK = loaded(ROOT / "tools" / "check_site.py")


# -- API ---------------------------------------------------------------------------------------


def listed():
    """Names in the lists of the API pages, in their order."""
    found = []
    for page in sorted((DOCS / "api").glob("*.rst")):
        text = page.read_text("utf-8")
        assert len(re.findall(r"^\.\. currentmodule::", text, re.M)) == (page.stem != "index")
        for block in re.findall(r"^\.\. autosummary::\n((?:   .*\n|\n)*)", text, re.M):
            found += re.findall(r"^   ([A-Za-z_][\w.]*)$", block, re.M)
    return found


def resolved(name):
    obj = se
    for part in name.split("."):
        obj = getattr(obj, part)
    return obj


def public():
    """Every public object, with the names that it has."""
    found = {}
    queue = [(se, "")] + [(getattr(se, room), f"{room}.") for room in sorted(ROOMS)]
    queue += [(se.ensembles, "ensembles."), (se.simulation, "simulation.")]
    while queue:
        room, prefix = queue.pop()
        for item in room.__all__:
            obj = getattr(room, item)
            if inspect.ismodule(obj) and obj is not se.reference:
                queue.append((obj, f"{prefix}{item}."))
            elif item != "__version__":
                found.setdefault(id(obj), set()).add(f"{prefix}{item}")
    return found


def test_the_api_lists_every_public_name_once():
    entries, wanted = listed(), public()
    assert len(entries) == len(set(entries))
    seen = [id(resolved(name)) for name in entries]
    assert [entries[k] for k, one in enumerate(seen) if seen.index(one) != k] == []
    assert {min(names) for one, names in wanted.items() if one not in seen} == set()
    assert [n for n in entries if n not in wanted.get(id(resolved(n)), ())] == []
    short = set(TOP.split())  # what users write
    assert [n for n in entries if n not in short and wanted[id(resolved(n))] & short] == []
    assert {f"{room}.{name}" for room in ROOMS for name in ROOMS[room].split()} <= set(entries)


def test_no_two_pages_of_the_api_differ_by_case_only():
    conf = (DOCS / "conf.py").read_text("utf-8")
    renamed = ast.literal_eval(re.search(r"^CLASSES = (\(.*?\))$", conf, re.M | re.S)[1])
    files = [name + "-class" * (name in renamed) for name in listed()]
    assert set(renamed) <= set(listed())
    assert len({file.lower() for file in files}) == len(files)


# -- pages -------------------------------------------------------------------------------------


def toctrees():
    """Each page of the sources with the pages that it lists."""
    found = {}
    for page in [*DOCS.glob("*.md"), *DOCS.glob("theory/*.md"), *DOCS.glob("api/*.rst")]:
        text, entries = page.read_text("utf-8"), []
        for block in re.findall(r"^```\{toctree\}\n(.*?)^```$", text, re.M | re.S):
            entries += [line for line in block.splitlines() if line and line[0] != ":"]
        for block in re.findall(r"^\.\. toctree::\n((?:   .*\n|\n)*)", text, re.M):
            entries += re.findall(r"^   ([\w/-]+)$", block, re.M)
        names = [re.sub(r"^.*<(.*)>$", r"\1", entry.strip()) for entry in entries]
        folder = page.relative_to(DOCS).parent
        found[(folder / page.stem).as_posix()] = [(folder / name).as_posix() for name in names]
    return found


def test_every_page_is_in_one_list_of_contents():
    trees = toctrees()
    entries = [name for names in trees.values() for name in names]
    assert sorted(entries) == sorted(set(entries))
    assert set(entries) - MADE == set(trees) - MADE - {"index"}


def test_pages_read_as_on_a_code_host():
    """Includes find their text, and relative links lead to a page or a file."""
    for page in [*DOCS.glob("*.md"), *DOCS.glob("theory/*.md")]:
        text = PAGES.expanded(page.read_text("utf-8"), page)
        assert "{include}" not in text
        plain = re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)
        assert plain.count("\n# ") + plain.startswith("# ") == 1, page.name
        for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", plain):
            if "://" not in target and not re.search(r"^/examples/|^(/theory/)?claims.md$", target):
                path = DOCS / target[1:] if target.startswith("/") else page.parent / target
                assert path.exists() or DOCS.joinpath(target).exists(), (page.name, target)


def test_links_lead_to_the_page_that_shows_a_file():
    text = "[a](../README.md#limits) [b](logs.md) [c](../LICENSE) [d](https://e.f) [g](no.md)"
    wanted = text.replace("../README.md", "/index.md").replace("logs.md", "/logs.md")
    assert PAGES.with_links(text, DOCS / "fleet.md") == wanted
    included = PAGES.with_links("[x](docs/fleet.md) ![y](docs/images/tube.png)", ROOT / "README.md")
    assert included == "[x](/fleet.md) ![y](/images/tube.png)"
    with pytest.raises(ValueError, match="does not contain the text start-after"):
        PAGES.expanded(
            '```{include} ../README.md\n:start-after: "no such text"\n```', DOCS / "x.md"
        )


# -- notebooks ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["close-the-loop", "several-models", "fleet", "readings"])
def test_notebooks_have_the_code_and_pictures_of_their_page(name):
    page = DOCS / f"{name}.md"
    made = json.loads(json.dumps(NOTEBOOKS.notebook(page)))
    nbformat = pytest.importorskip("nbformat")
    nbformat.validate(made)
    code = [cell["source"] for cell in made["cells"] if cell["cell_type"] == "code"]
    text = page.read_text("utf-8")
    assert (
        "\n".join(code) + "\n"
        == "\n".join(
            block.strip("\n") for block in re.findall(r"^```python\n(.*?)^```$", text, re.M | re.S)
        )
        + "\n"
    )
    words = "".join(cell["source"] for cell in made["cells"] if cell["cell_type"] == "markdown")
    pictures = re.findall(r"\(attachment:([^)]*)\)", words)
    attached = [a for cell in made["cells"] for a in cell.get("attachments", ())]
    assert pictures == attached == [Path(p).name for p in re.findall(r"\((images/[^)]*)\)", text)]
    assert "](" not in re.sub(r"\]\((attachment:|https:)", "", words)


# -- the check of the built site ---------------------------------------------------------------

GOOD = """<html><head><link rel="canonical" href="https://a.b/c">
<link rel="stylesheet" href="s.css">
</head><body><h1 id="top">a</h1><a href="#top">b</a><a href="https://a.b">c</a>
<a href="sub/two.html#x">d</a><img src="data:,"><script src="s.js"></script></body></html>"""
BAD = {
    '<a href="none.html">': "links to none.html, which does not exist",
    '<a href="sub/two.html#y">': "links to sub/two.html#y, which has no such anchor",
    '<a href="#bottom">': "links to #bottom, which has no such anchor",
    '<img src="none.png">': "loads none.png, which does not exist",
    '<script src="https://a.b/c.js"></script>': "loads https://a.b/c.js",
    '<link rel="stylesheet" href="//a.b/c.css">': "loads //a.b/c.css",
    '<link rel="preconnect" href="https://a.b">': "loads https://a.b",
    '<p style="background: url(https://a.b/c.png)">': "loads url(https://a.b/c.png)",
    '<img srcset="s.png 1x, https://a.b/d.png 2x">': "loads https://a.b/d.png",
    "<style>@import 'https://a.b/c.css';</style>": "loads @import 'https://",
    "<script>fetch('https://a.b')</script>": "loads fetch('https://",
}


@pytest.fixture
def site(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "two.html").write_text('<p id="x"><a href="../index.html#top">e</a></p>')
    (tmp_path / "index.html").write_text(GOOD)
    (tmp_path / "s.css").write_text("p { background: url(s.png) }")
    (tmp_path / "s.js").write_text("const home = 'https://a.b/';")
    (tmp_path / "s.png").write_bytes(b"")
    return tmp_path


def test_the_check_passes_a_good_site(site):
    assert list(CHECK.faults(site)) == []


@pytest.mark.parametrize("html", BAD)
def test_the_check_sees_what_is_wrong(site, html):
    (site / "index.html").write_text(GOOD.replace("</body>", f"{html}</body>"))
    assert list(CHECK.faults(site)) == [f"index.html {BAD[html]}"]


def test_the_check_looks_into_styles_and_scripts(site):
    (site / "s.css").write_text("@font-face { src: url('https://a.b/f.woff2') }")
    (site / "s.js").write_text("import('https://a.b/m.js')")
    found = list(CHECK.faults(site))
    assert [text.split()[0] for text in found] == ["s.css", "s.js"]


def test_the_check_has_an_exit_code(site, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["check_site.py", str(site)])
    assert CHECK.main() == 0
    (site / "s.css").unlink()
    assert CHECK.main() == 1
    assert "s.css, which does not exist" in capsys.readouterr().out


WRONG = {
    "<script>console.error('no')</script>": "says no",
    "<script>throw new Error('bad')</script>": "raises Error: bad",
    '<img src="none.png">': "could not load a Image",
    '<div style="width: 1300px">a</div>': "is wider than 1280 px: div.",
    '<div style="width: 500px" class="b">a</div>': "is wider than 390 px: div.b",
    '<img src="http://127.0.0.1:9/a.png">': "requests http://127.0.0.1:9/a.png",
}


def test_a_browser_sees_what_is_wrong(tmp_path):
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("needs Chromium")
    view = '<meta name="viewport" content="width=device-width">'
    for k, html in enumerate(WRONG):
        (tmp_path / f"{k}.html").write_text(f"{view}<p>a</p>{html}")
    (tmp_path / "cut.html").write_text(f'{view}<pre style="overflow-x: auto">{"a" * 400}</pre>')
    boxed = '<div style="overflow-x: auto"><p style="width: 2000px">a</p></div>'
    (tmp_path / "good.html").write_text(f'{view}{boxed}<a href="http://127.0.0.1:9/">b</a>')
    listed = '<ul id="search-results"><li><a href="sample.html">b</a></li></ul>'
    (tmp_path / "search.html").write_text(listed)
    browser = CHECK.Browser(program)
    try:
        found = list(CHECK.seen(browser, tmp_path))
        CHECK.take_pictures(browser, tmp_path, tmp_path / "pictures", ["good"])
    finally:
        browser.close()
    for k, text in enumerate(WRONG.values()):
        assert any(line.startswith(f"{k}.html {text}") for line in found), (text, found)
    assert found[-1] == "the search for identify finds ['sample']"
    assert f"cut.html cuts at 1280 px: {'a' * 40}" in found
    assert not any(line.startswith(("good", "search.html")) for line in found)
    assert len(list((tmp_path / "pictures").glob("*.png"))) == 4
