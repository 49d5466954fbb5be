"""The recipes of CONTRIBUTING.md lead where they say."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from shutil import copytree, ignore_patterns
from typing import get_args

import pytest

import stochens_rs as se
from stochens_rs.fusion.fusing import Method
from stochens_rs.reference import fusing

ROOT = Path(__file__).resolve().parents[2]
if not (ROOT / "CONTRIBUTING.md").exists():
    pytest.skip("not run from a checkout", allow_module_level=True)


def recipe(title: str) -> str:
    """The text of a recipe, up to the next one."""
    page = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    found = re.search(rf"\*\*{title}\*\* (.*?)(?=\n\*\*|\n## )", page, re.S)
    assert found, title
    return found[1]


def block(text: str) -> str:
    """The one block of code in a recipe."""
    (code,) = re.findall(r"^```python\n(.*?)^```$", text, re.M | re.S)
    return str(code)


def inserted(path: Path, pattern: str, text: str) -> None:
    """Insert a text behind the one place that `pattern` describes."""
    source = path.read_text("utf-8")
    (place,) = re.finditer(pattern, source, re.M | re.S)
    path.write_text(source[: place.end()] + text + source[place.end() :], "utf-8")


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package, whose compiled module is a link."""
    ours = Path(se.__file__).parent
    copy = copytree(ours, tmp_path / "stochens_rs", ignore=ignore_patterns("_core.*"))
    for compiled in ours.glob("_core.*"):
        (copy / compiled.name).symlink_to(compiled)
    return Path(copy)


def run(package: Path, program: str) -> subprocess.CompletedProcess[str]:
    """What a program says that imports the copy."""
    start = "import sys; sys.path.insert(0, '.')\nimport stochens_rs as se\n"
    command = [sys.executable, "-B", "-c", start + program]
    return subprocess.run(command, capture_output=True, text=True, cwd=package.parent, check=False)


CASE = """
import doctest
system = se.cases.NAME()
found = doctest.testmod(sys.modules[se.cases.NAME.__module__])
print(found.attempted, found.failed, system.n, "NAME" in se.cases.__all__)
"""


@pytest.mark.parametrize("wrong", ["", "n=1 m=1"])
def test_a_case(package: Path, wrong: str) -> None:
    text = recipe("A case")
    code = block(text).replace(wrong or "\0", "n=2 m=1")
    file = package / code.partition("\n")[0].removeprefix("# ")
    file.write_text(code, "utf-8")
    names, name = package / "cases" / "__init__.py", file.stem
    assert "imports and `__all__` of `cases/__init__.py`" in text
    inserted(names, r"^from \.swing_models [^\n]*\n", f"from .{name} import {name}\n")
    inserted(names, r"^__all__ = \[\n", f'    "{name}",\n')
    done = run(package, CASE.replace("NAME", name))
    assert done.stdout.splitlines()[-1:] == [f"2 {int(bool(wrong))} 1 True"], done.stderr
    assert "   cases.ieee14\n" in (ROOT / "docs" / "api" / "cases.rst").read_text("utf-8")


COLUMN = """
from dataclasses import replace
import numpy as np
path = se.simulate(([[0.5]], [[1.0]]), [0.0], [[1.0], [0.0]])
full = replace(path, NAME=np.arange(3.0))
full.save("path.state")
kept = se.Trajectory.load("path.state")
print(path.NAME, kept == full, kept == path, full.to_xarray()["NAME"].values)
replace(path, NAME=np.arange(2.0))
"""


@pytest.mark.skipif(not find_spec("xarray"), reason="needs xarray")
@pytest.mark.parametrize("wrong", ["", "step+1"])
def test_a_column_of_a_table(package: Path, wrong: str) -> None:
    text = recipe("A column of a table")
    code = block(text).replace(wrong or "\0", "step")
    place = re.search(r"in `(\S+)`, below `(\w+)` of `(\w+)`", text)
    assert place
    inserted(package / place[1], rf"^class {place[3]}\(.*?^    {place[2]}: [^\n]*\n", code)
    name = code.partition(":")[0].strip()
    done = run(package, COLUMN.replace("NAME", name))
    works = done.stdout == "None True False [0. 1. 2.]\n" and f"ShapeError: `{name}`" in done.stderr
    assert works == (not wrong), done


def test_a_fusion_method() -> None:
    """Each named file has what the step names, and all know the same methods."""
    text = recipe("A fusion method")
    named = "reference/fusing.py rust/fuse/ rust/fuse/mod.rs rust/fuse/method.rs fusion/fusing.py"
    assert all(f"`{name}`" in text for name in named.split())
    source = (ROOT / "rust" / "fuse" / "method.rs").read_text("utf-8")
    assert {"enum Fusion", "fn fuse"} <= set(re.findall(r"pub (enum Fusion|fn fuse)\b", source))
    names = re.findall(r'\("([\w-]+)", Self::', source)
    assert names == list(get_args(Method)) == list(fusing.METHODS)
    assert all(f'"{name}"' in str(se.fuse.__doc__) for name in names)
    modules = (ROOT / "rust" / "fuse" / "mod.rs").read_text("utf-8")
    assert all(f"mod {file.stem};" in modules for file in (ROOT / "rust" / "fuse").glob("[!m]*.rs"))
    assert "fusing.METHODS" in (ROOT / "tests/python/test_against_reference.py").read_text("utf-8")
