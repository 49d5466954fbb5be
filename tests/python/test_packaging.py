"""The package: metadata, licences, and a README without relative links."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import stochens_rs
from test_lines import loaded

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def stage():
    return loaded(ROOT / "tools" / "stage.py")


def test_both_manifests_say_the_same():
    tomllib = pytest.importorskip("tomllib")  # Python 3.11
    crate = tomllib.loads((ROOT / "Cargo.toml").read_text("utf-8"))["package"]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    for field in ("version", "description", "license", "keywords"):
        assert crate[field] == project[field], field
    assert crate["authors"] == [author["name"] for author in project["authors"]]
    assert f"Copyright (c) 2026 {crate['authors'][0]}\n" in (ROOT / "LICENSE").read_text("utf-8")
    assert project["license-files"] == ["LICENSE", "THIRD-PARTY-LICENSES"]


def test_every_place_states_the_same_version():
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    version = re.search(r'^version = "(.*)"$', text, re.M)[1]
    assert stochens_rs.__version__ == version
    places = {
        "Cargo.toml": r'^version = "(.*)"$',
        "Cargo.lock": r'^name = "stochens"\nversion = "(.*)"$',
        "CITATION.cff": r"^version: (.*)$",
        "packaging/recipe.yaml": r'^  version: "(.*)"$',
        "docs/index.md": r"^  version = \{(.*)\},$",
        "CHANGELOG.md": r"^## \[(.*?)\]",
    }
    for name, pattern in places.items():
        found = re.search(pattern, (ROOT / name).read_text("utf-8"), re.M)
        assert found, name
        assert found[1] == version, name


def test_the_crate_is_its_sources_and_examples():
    tomllib = pytest.importorskip("tomllib")
    crate = tomllib.loads((ROOT / "Cargo.toml").read_text("utf-8"))
    for pattern in crate["package"]["include"]:
        assert list(ROOT.glob(pattern.lstrip("/"))), pattern
    assert not re.search("fuzz|benches|docs|github|tests", " ".join(crate["package"]["include"]))
    assert (ROOT / crate["package"]["readme"]).exists()
    assert crate["lib"]["bench"] is False  # else its options are not those of criterion
    assert "crate-type" not in crate["lib"]  # users of the crate link no cdylib


def test_all_is_every_extra_of_users():
    tomllib = pytest.importorskip("tomllib")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = set(project["optional-dependencies"]) - {"all", "dev", "paper", "bench", "docs"}
    (every,) = project["optional-dependencies"]["all"]
    name, _, named = every.rstrip("]").partition("[")
    assert name == project["name"]
    assert set(named.split(",")) == extras


def test_conda_recipe_asks_for_the_same():
    tomllib = pytest.importorskip("tomllib")
    manifest = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    project = manifest["project"]
    recipe = (ROOT / "packaging" / "recipe.yaml").read_text("utf-8")
    assert f'version: "{project["version"]}"' in recipe
    run = re.search(r"\n  run:\n((?:    - .*\n)+)", recipe)[1]
    asked = [line.removeprefix("- ") for line in map(str.strip, run.splitlines())]
    assert asked == ["python", *(re.sub("(?=>=)", " ", one) for one in project["dependencies"])]
    (needed,) = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["build-system"][
        "requires"
    ]
    assert recipe.count(f"- {re.sub('(?=>=)', ' ', needed)}\n") == 2


def test_importing_the_package_imports_nothing_that_takes_long():
    code = (
        "import sys, stochens_rs as se; se.control, se.identify\n"
        "assert se.plots.save_figures and 'stochens_rs.reference' not in sys.modules\n"
        "assert se.reference.fusing.alse_dense\n"
        "print(*{name.split('.')[0] for name in sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    imported = set(done.stdout.split())
    assert {"stochens_rs", "numpy"} <= imported
    slow = {"click", "dask", "distributed", "h5netcdf", "h5py", "IPython", "jinja2", "loky"}
    slow |= {"matplotlib", "pandas", "pyarrow", "scipy", "tqdm", "xarray"}
    slow |= {"asyncio", "http", "multiprocessing", "sqlite3", "unittest", "xml"}  # of Python's own
    assert imported & slow == set()


def test_third_party_licenses_are_those_of_the_linked_crates():
    tool = ROOT / "tools" / "third_party_licenses.py"
    ended = subprocess.run([sys.executable, tool, "--check"], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


def test_packed_readme_has_no_relative_links(stage):
    text = "a [b](https://example.org/c) d [e](#f) g [h](i/j.md) k ![l](m.png) n"
    alone = "a [b](https://example.org/c) d [e](#f) g h k  n"
    assert stage.standalone(text) == alone
    absolute = text.replace("i/j.md", "https://example.org/i/j.md")
    absolute = absolute.replace("m.png", "https://example.org/m.png")
    assert stage.standalone(text, "https://example.org/") == absolute

    readme = (ROOT / "README.md").read_text("utf-8")
    linked = re.findall(r"\]\(((?!https?:|#)[^)]*)\)", readme)
    assert "docs/images/first-control.png" in linked
    assert [path for path in linked if not (ROOT / path.partition("#")[0]).is_file()] == []
    assert not re.search(r"\]\((?!https?:|#)", stage.standalone(readme))


def test_staged_files_are_sources_only(stage, tmp_path):
    stage.stage(tmp_path / "stage")
    staged = {path.relative_to(tmp_path / "stage") for path in (tmp_path / "stage").rglob("*")}
    assert Path("python/stochens_rs/py.typed") in staged
    assert Path("rust/lib.rs") in staged
    assert not [path for path in staged if "paper" in path.parts]
    assert not [path for path in staged if path.suffix in (".so", ".pyc")]
    assert "![" not in (tmp_path / "stage" / "README.md").read_text("utf-8")


def test_the_packed_project_names_the_repository_where_it_is_known(stage):
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    assert stage.with_urls(text) == text
    known = stage.with_urls(text, "https://example.org/one/raw/HEAD/")
    urls = '[project.urls]\nRepository = "https://example.org/one"\n'
    assert urls + 'Changelog = "https://example.org/one/raw/HEAD/CHANGELOG.md"\n' in known


def test_a_zip_file_is_refused_with_the_reason(tmp_path):
    app = tmp_path / "app.zip"
    with zipfile.ZipFile(app, "w") as packed:
        for path in (ROOT / "python" / "stochens_rs").rglob("*.py"):
            packed.write(path, path.relative_to(ROOT / "python"))
    run = subprocess.run(
        [sys.executable, "-c", "import stochens_rs"],
        env={**os.environ, "PYTHONPATH": str(app)}, capture_output=True, text=True, cwd=tmp_path,
    )  # fmt: skip
    assert "does not load from a zip file" in run.stderr
