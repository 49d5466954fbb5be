"""The documentation is complete, its examples run, and it agrees with the code."""

from __future__ import annotations

import dataclasses
import doctest
import importlib
import inspect
import pkgutil
import re
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import stochens_rs

ROOT = Path(__file__).resolve().parents[2]
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
SECTIONS = ["Parameters", "Attributes", "Returns", "Yields", "Raises", "Warns"]
SECTIONS += ["Notes", "References", "Examples"]


def modules():
    found = ["stochens_rs"]
    for entry in pkgutil.walk_packages(stochens_rs.__path__, "stochens_rs."):
        last = entry.name.rpartition(".")[2]
        if last not in ("_core", "__main__"):  # compiled; a program
            found.append(entry.name)
    return found


def public_objects():
    """Name and object of every public function, class, and method of a public class."""
    found = {}
    for name in modules():
        parts = name.split(".")
        # The NumPy twin is documented by its formulas; its arguments are those of the package.
        if "reference" in parts or any(part.startswith("_") for part in parts):
            continue
        module = importlib.import_module(name)
        for item in getattr(module, "__all__", ()):
            obj = getattr(module, item)
            if not getattr(obj, "__module__", "").startswith("stochens_rs"):
                continue
            found[f"{obj.__module__}.{item}"] = obj
            if inspect.isclass(obj):
                for attribute, member in vars(obj).items():
                    if not attribute.startswith("_") and is_ours(member):
                        found[f"{obj.__module__}.{item}.{attribute}"] = member
    return {name: obj for name, obj in found.items() if callable(unwrap(obj)) or is_ours(obj)}


def is_ours(member):
    return isinstance(member, (property, classmethod, staticmethod)) or inspect.isfunction(member)


def unwrap(obj):
    return getattr(obj, "__func__", obj)


PUBLIC = public_objects()


def test_every_public_object_has_a_docstring():
    firsts = {
        name: (inspect.getdoc(unwrap(obj)) or "").split("\n")[0] for name, obj in PUBLIC.items()
    }
    assert [name for name, line in firsts.items() if not line.strip() or len(line) > 100] == []


CALLABLES = [name for name, obj in PUBLIC.items() if not isinstance(obj, property)]


def test_every_parameter_is_documented():
    for name in CALLABLES:
        check_parameters(name, unwrap(PUBLIC[name]))


def check_parameters(name, obj):
    if inspect.isclass(obj) and issubclass(obj, BaseException) and "__init__" not in vars(obj):
        return
    wanted = [] if name.endswith(".main") or is_made_by_the_package(obj) else parameters(obj)
    found = sections(inspect.getdoc(obj) or "")
    documented = [*names(found.get("Parameters", "")), *names(found.get("Attributes", ""))]
    missing = [p for p in wanted if p not in documented]
    assert not missing, f"{name} does not document {missing}"
    known = {p.lstrip("*") for p in parameters(obj)}
    unknown = [p for p in names(found.get("Parameters", "")) if p not in known]
    assert not unknown, f"{name} documents {unknown}, which it does not take"


def parameters(obj):
    try:
        signature = inspect.signature(obj)
    except ValueError:  # a class whose constructor is compiled
        return []
    return [p for p in signature.parameters if p not in ("self", "cls")]


def is_made_by_the_package(obj):
    """Whether `obj` is a class that users do not construct; its fields must be described."""
    home = obj.__module__.rpartition(".")[2]
    return inspect.isclass(obj) and home == "ensemble"


def sections(text):
    """Split a numpydoc docstring into its sections."""
    found, lines = {}, text.splitlines()
    heads = [
        i
        for i in range(len(lines) - 1)
        if lines[i] in SECTIONS and re.fullmatch(r"-{3,}", lines[i + 1])
    ]
    for head, end in zip(heads, [*heads, len(lines)][1:], strict=True):
        assert len(lines[head]) == len(lines[head + 1]), f"underline of {lines[head]!r}"
        assert lines[head] not in found, f"{lines[head]!r} appears twice"
        found[lines[head]] = "\n".join(lines[head + 2 : end])
    return found


def names(section):
    """Names before the colon of each entry: ``a, b : float`` gives a and b."""
    found = []
    for line in section.splitlines():
        if line and not line[0].isspace():
            found += [word.strip().lstrip("*") for word in line.partition(" :")[0].split(",")]
    return found


def lacking(obj):
    """The sections that a function or method needs and has not: see CONTRIBUTING.md."""
    found = sections(inspect.getdoc(obj) or "")
    needed = {"Examples"}
    if inspect.signature(obj).return_annotation not in (None, "None"):
        needed.add("Returns")
    if parameters(obj):
        needed.add("Raises")
    if "Yields" in found:
        needed.discard("Returns")
    return " ".join(sorted(needed - set(found)))


def test_every_function_says_what_it_returns_and_raises_and_has_an_example():
    functions = {
        name.removeprefix("stochens_rs."): unwrap(PUBLIC[name])
        for name in CALLABLES
        if not inspect.isclass(PUBLIC[name]) and not name.endswith(".main")
    }
    assert len(functions) > 100
    found = {name: lack for name, obj in functions.items() if (lack := lacking(obj))}
    assert not found, "write these sections"


def test_a_method_without_sections_is_seen():
    def bare(self, x: float) -> float:
        """Give it back."""

    def full(self) -> None:
        """Do it.

        Examples
        --------
        >>> 1
        1
        """

    assert lacking(bare) == "Examples Raises Returns"
    assert lacking(full) == ""


def test_the_section_parser_sees_faults():
    text = "Sum.\n\nParameters\n----------\na, b : float\n    Two.\n*args\n    More.\n\n"
    text += "Returns\n-------\nint\n    It."
    assert names(sections(text)["Parameters"]) == ["a", "b", "args"]
    assert set(sections(text)) == {"Parameters", "Returns"}
    with pytest.raises(AssertionError, match="underline"):
        sections("Sum.\n\nParameters\n-----\na : int")


# -- examples ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", modules())
def test_docstring_examples(name):
    module = importlib.import_module(name)
    said = []
    runner = doctest.DocTestRunner(optionflags=OPTIONS)
    for test in doctest.DocTestFinder().find(module, name):
        runner.run(test, out=said.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(said)


MARKDOWN = [
    path.relative_to(ROOT).as_posix()
    for pattern in ("README.md", "CONTRIBUTING.md", "docs/*.md", "docs/theory/*.md")
    for path in sorted(ROOT.glob(pattern))
]
# What pages need of the extras `dev`.
NEEDED = "control distributed h5netcdf matplotlib pandas pypower safetensors scipy xarray"


def blocks(path):
    text = (ROOT / path).read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


# test_recipes.py follows those of CONTRIBUTING.md
RUN = [path for path in MARKDOWN if path != "CONTRIBUTING.md" and blocks(path)]


@pytest.mark.parametrize("path", RUN)
def test_code_blocks_run_and_print_what_they_say(path, tmp_path, monkeypatch, capsys):
    """Each ``print(...)  # text`` prints exactly the text."""
    for package in NEEDED.split():
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(ROOT / "docs")  # pages read its data
    namespace = {"__name__": "__main__"}
    for block in blocks(path):
        exec(compile(block, f"{path}:block", "exec"), namespace)
        expected = re.findall(r"^print\(.*\)\s+# (.*)$", block, re.MULTILINE)
        printed = capsys.readouterr().out.splitlines()
        assert printed == expected


def test_the_page_for_contributors_names_the_program_of_every_picture():
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8") if MARKDOWN else pytest.skip("no checkout")
    rule = re.search(r"^- A picture of `docs/images/`.*?(?=^- )", text, re.M | re.S)[0]
    programs = re.findall(r"`((?:docs|benches)/[\w/-]+\.\w+)`", rule)
    sources = {name: (ROOT / name).read_text("utf-8") for name in programs}
    pictures = {path.name for path in (ROOT / "docs" / "images").iterdir()}
    drawn = {name: set(re.findall(r"([\w-]+\.png)\b", source)) for name, source in sources.items()}
    assert pictures - set().union(*drawn.values()) == set(), "name its program in CONTRIBUTING.md"
    assert {name for name, found in drawn.items() if not found & pictures} == set()


# -- names that texts use ------------------------------------------------------------------------

# The name that an inline code begins with.
DOTTED = re.compile(r"`~?([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+)")
ROOTS = {}
for room in [stochens_rs, *(getattr(stochens_rs, name) for name in stochens_rs.__all__)]:
    if inspect.ismodule(room) and room.__name__.startswith("stochens_rs"):
        for item in [*getattr(room, "__all__", ()), *vars(stochens_rs)]:
            obj = getattr(room, item, None)
            if inspect.ismodule(obj) or inspect.isclass(obj):
                ROOTS.setdefault(item, []).append(obj)
for name in ("data", "system", "validation"):  # in texts what the user has, and `_base.validation`
    ROOTS.pop(name, None)


def missing_names(text):
    """Dotted names of the package in inline code that do not exist."""
    found = []
    for name in DOTTED.findall(text):
        parts = re.sub(r"^(stochens_rs|se)\.", "", name).split(".")
        whole = len(parts) < name.count(".") + 1  # it begins with the package
        heads = [stochens_rs] if whole else ROOTS.get(parts[0], [])
        rest = parts if whole else parts[1:]
        if heads and rest[-1] not in ("py", "pyi", "md") and not any(leads(h, rest) for h in heads):
            found.append(name)
    return found


def leads(obj, parts):
    for part in parts:
        if inspect.isclass(obj) and dataclasses.is_dataclass(obj):
            fields = [field.name for field in dataclasses.fields(obj)]
            if part in fields:
                return True
        if not hasattr(obj, part):
            return False
        obj = getattr(obj, part)
    return True


def texts():
    """Texts of the project with their names; of the changelog, what is there today."""
    for path in Path(stochens_rs.__file__).parent.rglob("*.py"):
        yield str(path), path.read_text(encoding="utf-8")
    for name in MARKDOWN:
        yield name, (ROOT / name).read_text(encoding="utf-8")
    log = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8") if MARKDOWN else ""
    yield "CHANGELOG.md", log.partition("### Removed")[0]


def test_the_names_in_texts_exist():
    assert {name: found for name, text in texts() if (found := missing_names(text))} == {}


def test_the_search_for_names_sees_faults():
    good = "`se.Plan.bound`, ``theory.moments.control_rms(...)``, `Plan.u`, `control.StateSpace`"
    assert missing_names(good + ", :mod:`~stochens_rs.theory.moments`, `A.loc`, `plots.py`") == []
    bad = ["se.PlanBound", "Plan.control_steps", "theory.multistep", "stochens_rs.cases.ieee15"]
    assert missing_names(", ".join(f"`{name}`" for name in bad)) == bad


def script(name, monkeypatch):
    """A program of docs/ as a module."""
    pytest.importorskip("matplotlib")
    if not (ROOT / "docs" / f"{name}.py").exists():
        pytest.skip("not run from a checkout")
    monkeypatch.syspath_prepend(ROOT / "docs")
    monkeypatch.delitem(sys.modules, name, raising=False)
    return importlib.import_module(name)


def test_first_example_script_draws(tmp_path, monkeypatch):
    module = script("first_example", monkeypatch)
    monkeypatch.setattr(module, "SIZE", 200)
    monkeypatch.setattr(module.sys, "argv", ["first_example.py", str(tmp_path / "a" / "b.png")])
    module.main()
    assert (tmp_path / "a" / "b.png").stat().st_size > 10_000
    # per unit of 100 MVA: the smallest machine is rated 25 MVA
    assert 0.0 < np.abs(module.EXACT).max() < 0.25


def test_rig_script_compares_and_draws(tmp_path, monkeypatch, capsys):
    module = script("rig", monkeypatch)
    monkeypatch.setattr(module, "SIZES", (20, 50))
    monkeypatch.setattr(module, "which_number", partial(module.which_number, sets=5))
    monkeypatch.setattr(sys, "argv", ["rig.py", "--seeds", "1", "--images", str(tmp_path / "a")])
    module.main()
    printed = capsys.readouterr().out
    assert printed.count("N = 20 | N = 50 | region failed") == 6  # three laws, exact and read
    rows = [line for line in printed.splitlines() if line.startswith("| last pairs, Gaussian")]
    assert [" * |" in row for row in rows] == [False, True, True]
    certificate, error = rows[0].split(" | ")[2].split(" / ")
    assert 0.0 < 2 * float(error) < float(certificate) < 1.0
    assert {path.name for path in (tmp_path / "a").iterdir()} == {
        "certificates.png",
        "first-control.png",
        "limits-loop.png",
        "limits-plan.png",
        "margins.png",
        "residuals.png",
        "tube.png",
        "which-number.png",
    }
