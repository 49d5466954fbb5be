"""Layers: the folders of package and core have an order, and each imports only lower ones."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import stochens_rs

# Lowest first. Rooms in one row do not know each other; "" is the face, `stochens_rs/__init__.py`.
LAYERS = (
    ("exceptions",),
    ("_base",),
    ("export",),
    ("plots",),
    ("rng", "system"),
    ("data",),
    ("cases", "theory"),
    ("ensembles",),
    ("identification",),
    ("certificates",),
    ("feedback",),
    ("fusion",),
    ("limits",),
    ("validation",),
    ("fleet",),
    ("controls",),
    ("loops",),
    ("simulation", "streams"),
    ("studies",),
    ("",),
    ("cli",),
    ("__main__",),
)
HEIGHT = {room: height for height, rooms in enumerate(LAYERS) for room in rooms}
APART = "reference"  # knows nothing of the package; only the command line knows it
COMPILED = "_core"


class Package:
    """The modules of a package by their dotted names, from the sources of its files."""

    def __init__(self, sources: dict[str, str]) -> None:
        self.trees: dict[str, ast.Module] = {}
        self.folders = {""}
        for path, source in sources.items():
            parts = path.removesuffix(".py").split("/")
            if parts[-1] == "__init__":
                self.folders.add(".".join(parts[:-1]))
                parts = parts[:-1]
            self.trees[".".join(parts)] = ast.parse(source)
        self.found = {module: list(self.imports_of(module)) for module in self.trees}

    def imports_of(self, module: str) -> Iterator[tuple[int, str, bool]]:
        """Line, imported module of the package, and whether that is inside a function.

        `if TYPE_CHECKING` makes no difference: who needs a name knows where it is from.
        """
        here = module.split(".") if module else []
        package = here if module in self.folders else here[:-1]
        for node, inside in walk(self.trees[module], inside=False):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    if alias.name.partition(".")[0] == "stochens_rs":
                        yield node.lineno, alias.name.partition(".")[2], inside
            elif isinstance(node, ast.ImportFrom):
                base = (node.module or "").split(".") if node.module else []
                if node.level:
                    base = package[: len(package) - node.level + 1] + base
                elif base[:1] == ["stochens_rs"]:
                    base = base[1:]
                else:
                    continue
                for alias in node.names:
                    longer = ".".join([*base, alias.name])
                    if longer.split(".")[0] == COMPILED:
                        continue
                    yield node.lineno, longer if longer in self.trees else ".".join(base), inside

    def needs(self, module: str) -> set[str]:
        """The modules that this one imports, with their parent packages."""
        around = set(packages_of(module))
        found = set()
        for _, target, _ in self.found[module]:
            found |= {target, *packages_of(target)} - around - {module}
        return found


def packages_of(module: str) -> list[str]:
    parts = module.split(".") if module else []
    return [".".join(parts[:k]) for k in range(len(parts))]


def walk(node: ast.AST, *, inside: bool) -> Iterator[tuple[ast.AST, bool]]:
    """All nodes below, and whether they are in the body of a function."""
    left = [(node, inside)]
    while left:
        node, inside = left.pop()
        for child in ast.iter_child_nodes(node):
            yield child, inside
            function = isinstance(child, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
            left.append((child, inside or function))


def order_faults(package: Package) -> Iterator[str]:
    """Imports of a higher folder, of one of equal rank, or of `reference`."""
    for module in package.trees:
        room = module.partition(".")[0]
        if room != APART and room not in HEIGHT:
            yield f"{module}: give the room {room!r} a place in LAYERS"
            continue
        for line, target, _ in package.found[module]:
            other = target.partition(".")[0]
            if other == room:
                continue
            if other == APART and room == "cli":
                continue
            if APART in (room, other) or HEIGHT.get(other, len(LAYERS)) >= HEIGHT[room]:
                yield f"{module}:{line}: must not import {target or 'the package itself'}"


def circles(package: Package) -> list[str]:
    """Modules that import themselves, directly or indirectly."""
    return in_circles({module: package.needs(module) for module in package.trees})


def in_circles(needs: dict[str, set[str]]) -> list[str]:
    def all_needed(module: str) -> set[str]:
        seen: set[str] = set()
        left = [module]
        while left:
            new = needs.get(left.pop(), set()) - seen
            seen |= new
            left += new
        return seen

    return [f"{module}: is in a circle" for module in needs if module in all_needed(module)]


def hidden_faults(package: Package) -> Iterator[str]:
    """Imports of the package in places that the first two checks do not see."""
    for module, tree in package.trees.items():
        for line, target, inside in package.found[module]:
            if inside:
                yield f"{module}:{line}: imports {target} inside a function"
        for node in ast.walk(tree):
            if isinstance(node, (ast.Name, ast.Attribute)):
                name = node.id if isinstance(node, ast.Name) else node.attr
                # the face imports its rooms at their first use; `validation` compares with the face
                if module in ("", "reference.validation"):
                    continue
                if name in ("import_module", "__import__"):
                    yield f"{module}:{node.lineno}: imports by the name of a module"


def attached_faults(package: Package) -> Iterator[str]:
    """``object.__setattr__`` on another object than `self`."""
    for module, tree in package.trees.items():
        own = {
            call
            for kind in ast.walk(tree)
            if isinstance(kind, ast.ClassDef)
            for method in kind.body
            if isinstance(method, ast.FunctionDef) and method.args.args
            for call in ast.walk(method)
            if isinstance(call, ast.Call)
            and call.args
            and isinstance(call.args[0], ast.Name)
            and call.args[0].id == method.args.args[0].arg == "self"
        }
        for node, _ in walk(tree, inside=False):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "object.__setattr__":
                if node not in own:
                    yield f"{module}:{node.lineno}: sets an attribute from outside"
            elif (
                isinstance(node, ast.Attribute)
                and node.attr == "__setattr__"
                and ast.unparse(node.value) != "object"
            ):
                yield f"{module}:{node.lineno}: sets an attribute in a hidden way"


CHECKS = {
    "order": order_faults,
    "circles": circles,
    "hidden": hidden_faults,
    "attached": attached_faults,
}


@pytest.fixture(scope="module")
def ours() -> Package:
    root = Path(stochens_rs.__file__).parent
    found = {p.relative_to(root).as_posix(): p.read_text("utf-8") for p in root.rglob("*.py")}
    assert len(found) > 100
    return Package(found)


@pytest.mark.parametrize("check", CHECKS)
def test_the_house_stands(check: str, ours: Package) -> None:
    assert list(CHECKS[check](ours)) == []


def test_the_graph_is_seen(ours: Package) -> None:
    """The reader of imports finds the known ones, of every kind."""
    needs = ours.needs("controls.plan")
    assert {"system", "theory.exact", "theory", "fusion.provenance", "_base.types"} <= needs
    assert "controls" not in needs  # runs before it in any case
    assert all(len(ours.needs(room)) > 1 for room in ("controls", "theory", ""))


# What each check must see, in a package of two files; what it must let pass is the package.
FAULTS = [
    ("order", {"_base/validation.py": "from ..controls import plan", "controls/plan.py": ""}),
    ("order", {"fusion/fits.py": "from ..streams.records import Trace", "streams/records.py": ""}),
    ("order", {"controls/plan.py": "from .. import sample", "__init__.py": ""}),
    ("order", {"reference/fusing.py": "from ..rng import Key", "rng.py": ""}),
    ("order", {"studies/x.py": "from ..reference import control", "reference/__init__.py": ""}),
    ("order", {"attic/x.py": ""}),
    (
        "order",
        {
            "theory/x.py": "from typing import TYPE_CHECKING\n"
            "if TYPE_CHECKING:\n    from ..ensembles.law import Law",
            "ensembles/law.py": "",
        },
    ),
    ("order", {"plots/x.py": "import stochens_rs.studies", "studies/__init__.py": ""}),
    ("circles", {"theory/a.py": "from .b import x", "theory/b.py": "from . import a"}),
    (
        "circles",
        {
            "theory/a/__init__.py": "from .x import y",
            "theory/a/x.py": "from ..b import z",
            "theory/b.py": "from .a.free import w",  # runs a/__init__.py first
            "theory/a/free.py": "",
        },
    ),
    ("hidden", {"cli/x.py": "def f():\n    from ..rng import Key", "rng.py": ""}),
    ("hidden", {"cli/x.py": "def f():\n    import stochens_rs.rng", "rng.py": ""}),
    ("hidden", {"cli/x.py": "import importlib\nimportlib.import_module('stochens_rs.rng')"}),
    ("attached", {"rng.py": "def f(plan):\n    object.__setattr__(plan, 'basis', 1)"}),
    ("attached", {"rng.py": "class A:\n def f(self, b):\n  object.__setattr__(b, 'c', 1)"}),
    ("attached", {"rng.py": "def f(self):\n    object.__setattr__(self, 'basis', 1)"}),
    ("attached", {"rng.py": "def f(plan):\n    super(Plan, plan).__setattr__('basis', 1)"}),
]


@pytest.mark.parametrize(("check", "sources"), FAULTS)
def test_every_fault_is_seen(check: str, sources: dict[str, str]) -> None:
    assert len(list(CHECKS[check](Package(sources)))) >= 1
    others = [name for name in CHECKS if name != check and list(CHECKS[name](Package(sources)))]
    assert others == []  # one fault each


# -- the core ----------------------------------------------------------------------------------

# Lowest first, as LAYERS: the files and folders of `rust/`. Its root, `lib.rs`, only names them.
CORE = (
    ("compensated", "fault", "named", "pod", "scaled", "simd", "vector"),
    ("error", "nontemporal"),
    ("memory", "parallel", "stream"),
    ("matrix", "sample", "storage"),
    ("fuse",),
    ("control",),
    ("identify", "streaming", "table", "tails"),
    ("simulate", "window"),
    ("region",),
    ("certificate", "watch"),
    ("feedback",),
    ("limits",),
    ("fleet",),
    ("python",),
)
CORE_HEIGHT = {room: height for height, rooms in enumerate(CORE) for room in rooms}


class Core:
    """The modules of a crate by their paths (`fuse::slse`), from the sources of its files."""

    def __init__(self, sources: dict[str, str]) -> None:
        self.uses: dict[str, list[list[str]]] = {}
        for path, source in sources.items():
            module = path.removesuffix(".rs").removesuffix("lib").removesuffix("/mod")
            text = re.split(r"#\[cfg\(test\)\]\n.*mod tests \{", re.sub("//.*", "", source))[0]
            text = re.sub(r"#\[cfg\(test\)\]\n *use [^;]+;", "", text)
            uses = {name for use in re.findall(r"\buse ([^;]+);", text) for name in spread(use)}
            uses |= set(re.findall(r"\b(?:crate|super)(?:::\w+)+", text))
            self.uses[module.replace("/", "::")] = [name.split("::") for name in sorted(uses)]
        # the names that a module hands on, and where it has them from
        self.handed = {f"{m}::{use[-1]}": (m, use) for m, uses in self.uses.items() for use in uses}

    def target(self, here: str, use: list[str]) -> str:
        """The module that `use` in `here` refers to, through re-exports."""
        at = "" if use[0] == "crate" else here
        for part in use:
            inner = f"{at}::{part}".removeprefix("::")
            if part == "super":
                at = at.rpartition("::")[0]
            elif inner in self.uses:
                at = inner
            elif part not in ("crate", "self"):
                handed = None if at == here else self.handed.get(f"{at}::{part}")
                return self.target(*handed) if handed else at
        return at

    def needs(self, module: str) -> set[str]:
        """The modules that `module` uses, its parents and children too."""
        return {self.target(module, use) for use in self.uses[module]} - {module}


def spread(use: str) -> list[str]:
    """`a::{b, c::{d, e}}` as `a::b`, `a::c::d` and `a::c::e`."""
    use = re.sub(r"\bas \w+|\s", "", use)
    while inner := re.search(r"([\w:]*)\{([^{}]*)\}", use):
        flat = ",".join(inner[1] + name for name in inner[2].split(",") if name)
        use = use[: inner.start()] + flat + use[inner.end() :]
    return [name.removesuffix("::self") for name in use.split(",")]


def core_faults(core: Core) -> Iterator[str]:
    """Uses of a higher folder or of one of equal rank, and circles of files."""
    needs = {module: core.needs(module) - {""} for module in core.uses if module}
    yield from in_circles(needs)
    for module, targets in needs.items():
        room = module.partition("::")[0]
        if room not in CORE_HEIGHT:
            yield f"{module}: give the room {room!r} a place in CORE"
            continue
        for other in {target.partition("::")[0] for target in targets} - {room}:
            if CORE_HEIGHT.get(other, len(CORE)) >= CORE_HEIGHT[room]:
                yield f"{module}: must not use {other}"


def test_the_core_stands() -> None:
    root = Path(__file__).parents[2] / "rust"
    files = {p.relative_to(root): p.read_text("utf-8") for p in root.rglob("*.rs")}
    code = {p: text for p, text in files.items() if "tests" not in p.with_suffix("").parts}
    core = Core({p.as_posix(): text for p, text in code.items()})
    needed = core.needs("streaming::estimator")
    assert {"vector", "fuse", "fuse::slse_run", "sample::law"} <= needed
    assert "error" in needed  # `crate::Error` and `crate::error::Error`
    assert list(core_faults(core)) == []


CORE_FAULTS = [
    {"fuse/slse.rs": "use crate::streaming::Stream;", "streaming/mod.rs": ""},
    {"fuse/slse.rs": "fn f() { crate::python::run(); }", "python/mod.rs": ""},
    {"sample/law.rs": "use crate::{Stop, fuse::{Dense, distance}};", "fuse/mod.rs": ""},
    {"error.rs": "use crate::{Stop};", "lib.rs": "pub use parallel::Stop;", "parallel.rs": ""},
    {"attic.rs": ""},
    {"fuse/a.rs": "use super::b::x;", "fuse/b.rs": "use super::{a::{y, z}, c};"},
    {"fuse/mod.rs": "mod a;\nuse a::x;\npub fn y() {}", "fuse/a.rs": "use super::y;"},
    {
        "fuse/mod.rs": "mod a;\npub use a::x;",
        "fuse/a.rs": "use super::b::y;",
        "fuse/b.rs": "use super::x;",
    },
]


@pytest.mark.parametrize("sources", CORE_FAULTS)
def test_every_fault_of_a_core_is_seen(sources: dict[str, str]) -> None:
    assert len(list(core_faults(Core(sources)))) >= 1


def test_a_public_name_of_the_core_is_there_once() -> None:
    """What rustdoc lists: the names that public modules define or hand on."""
    root = Path(__file__).parents[2] / "rust"
    found: dict[str, list[str]] = {}
    modules = re.findall(r"^pub mod (\w+);", (root / "lib.rs").read_text(), re.M)
    for module in (*modules, "limits/horizon"):
        text = (root / module / "mod.rs").read_text()
        names = re.findall(r"^pub (?:struct|enum|trait|fn|type|const) (\w+)", text, re.M)
        for used in re.findall(r"^pub use ([^;]+);", text, re.M):
            inner = used.partition("{")[2].rstrip("} \n,") or used.rsplit("::", 1)[-1]
            names += [name.split(" as ")[-1].strip() for name in inner.split(",")]
        for name in names:
            found.setdefault(name, []).append(module)
    assert len(found) > 200
    assert {name: where for name, where in found.items() if len(where) > 1} == {}


def test_the_page_for_contributors_names_every_room_and_only_files_that_exist() -> None:
    root = Path(__file__).parents[2]
    text = (root / "CONTRIBUTING.md").read_text("utf-8")
    spans = re.findall(r"`([^`\n]+)`", re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S))
    words = {word for span in spans for word in span.split()}
    named = {
        word for word in words if re.fullmatch(r"[\w./-]+(/|\.(py|rs|rst|md|toml|txt|yml))", word)
    }
    house = root / "python" / "stochens_rs"
    missing = [
        n for n in named if not any((at / n).exists() for at in (root, house, root / "rust"))
    ]
    assert missing == []
    face = {"": "__init__.py", APART: f"{APART}/"}
    rooms = [
        *(room for row in LAYERS for room in row),
        APART,
        *(room for row in CORE for room in row),
    ]
    ways = {room: {face.get(room, f"{room}/"), f"{room}.py", f"{room}.rs"} for room in rooms}
    assert [room for room in rooms if not ways[room] & named] == []


BENCHES = sorted((Path(__file__).parents[2] / "benches").glob("*.py"))


@pytest.mark.parametrize("path", BENCHES, ids=lambda path: path.stem)
def test_a_bench_imports_what_is_there(path: Path) -> None:
    """Of the package and of the twins: no test runs a bench."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in (
            "stochens_rs",
            "twin",
        ):
            home = importlib.import_module(node.module)
            for one in node.names:
                if not hasattr(home, one.name):
                    importlib.import_module(f"{node.module}.{one.name}")
