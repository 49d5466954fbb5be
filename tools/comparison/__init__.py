"""What is compared, and how a cell of the table is declared and checked.

Each cell is declared with its verdict, and has a check that fails where the verdict is wrong. The
declarations need none of the compared packages; the checks import them.
"""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

# Name of the package on the index, and the module that is imported.
PACKAGES = {"stochens_rs": "stochens_rs", "control": "control", "nutpie": "nutpie"}
PACKAGES |= {"cvxpy": "cvxpy"}
TITLES = {"stochens_rs": "stochens_rs", "control": "python-control", "nutpie": "nutpie"}
TITLES |= {"cvxpy": "CVXPY"}

GROUPS = {
    "From data to a model": {
        "model": "model (A, B) from measured states and inputs",
        "region": "region that contains the true model with a chosen probability",
        "posterior": "draws from any density (Bayesian posterior)",
        "fused": "several candidate models weighed by measured data",
        "update": "model updated with every measured pair",
        "stop": "stop rule while data come in, valid at every look",
        "filter": "states estimated from outputs (Kalman filter, smoother)",
    },
    "Control": {
        "limits": "control over K steps within limits",
        "feedback": "feedback that plans anew at every state (MPC)",
        "log": "time and status of every call of that feedback",
        "gap": "distance from the least cost, recomputed from the data of the problem",
        "tube": "error bar for the states of all K steps of a plan",
        "fleet": "one command for many units, and the risk of a fresh one",
        "gains": "feedback gains: LQR, pole placement",
        "robust": "H2 and H-infinity design",
        "convex": "any convex cost and constraint",
        "integers": "inputs that are on or off",
    },
    "Systems": {
        "discrete": "from continuous to discrete time",
        "continuous": "simulation in continuous time",
        "transfer": "outputs and transfer functions",
        "frequency": "frequency response, root locus, margins",
        "nonlinear": "simulation of nonlinear systems",
        "random": "simulation of many runs of a random system",
        "sparse": "sparse matrices",
    },
    "Repeating and keeping": {
        "draws": "same draws with any number of workers",
        "studies": "repeated experiments on an executor or Dask",
        "killed": "a killed run continues with the same bits",
        "partial": "progress, and what is done after an interruption",
        "pickle": "objects can be pickled",
    },
    "Data in and out": {
        "names": "names of states and inputs in results",
        "matched": "labelled tables matched by name, or refused",
        "units": "units",
        "tables": "results as pandas or xarray",
        "types": "type hints that a type checker reads",
        "shell": "command line",
        "wheels": "wheels for Linux, macOS and Windows on the package index",
        "abi": "one wheel for all Python versions",
    },
}
ROWS = {key: label for group in GROUPS.values() for key, label in group.items()}
VERDICTS = ("yes", "partly", "no", "-")


@dataclass(frozen=True)
class Cell:
    """One cell: what it says, a note in plain words, and a check that raises if it is wrong."""

    verdict: str
    note: str
    check: Callable[[], object]


CELLS: dict[tuple[str, str], Cell] = {}


def cell(package: str, row: str, verdict: str, note: str = "") -> Callable[..., object]:
    """Declare a cell by its check."""

    def declare(check: Callable[[], object]) -> Callable[[], object]:
        if (row, package) in CELLS or row not in ROWS or verdict not in VERDICTS:
            raise ValueError(f"{package}, {row}: {verdict}")
        if verdict == "partly" and not note:
            raise ValueError(f"{package}, {row}: a note is missing")
        CELLS[row, package] = Cell(verdict, note, check)
        return check

    return declare


def no(package: str, row: str, pattern: str, but: Iterable[str] = (), verdict: str = "no") -> None:
    """Declare an absence: of all names in the package, only those of `but` match the pattern.

    `but` are names that were looked at and mean something else. A name that a later version adds
    makes the check fail, so that somebody looks.
    """

    def check() -> None:
        found = {name for name in names(PACKAGES[package]) if re.search(pattern, name, re.I)}
        assert found == set(but), f"{package} has {sorted(found ^ set(but))}"

    cell(package, row, verdict)(check)


def sources(module: str) -> list[Path]:
    """Python files of an installed package, without its tests."""
    spec = find_spec(module)
    assert spec is not None, f"{module} is not installed"
    assert spec.origin is not None
    root = Path(spec.origin).parent
    return [p for p in root.rglob("*.py") if "tests" not in p.relative_to(root).parts]


@cache
def definitions(module: str) -> list[ast.FunctionDef | ast.ClassDef]:
    """Functions and classes of a package that do not begin with an underscore."""
    found = []
    for path in sources(module):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        kinds = (ast.FunctionDef, ast.ClassDef)
        found += [node for node in ast.walk(tree) if isinstance(node, kinds)]
    return [node for node in found if node.name[0] != "_"]


@cache
def names(module: str) -> set[str]:
    """Names of functions, methods, classes and their arguments, as written in the sources."""
    found = set()
    for node in definitions(module):
        found.add(node.name)
        if isinstance(node, ast.FunctionDef):
            found |= {arg.arg for arg in arguments(node)}
    for compiled in ("_core", "_lib"):
        if find_spec(f"{module}.{compiled}"):
            found |= set(dir(importlib.import_module(f"{module}.{compiled}")))
    assert len(found) > 50, f"{module}: only {len(found)} names"
    return found


def arguments(node: ast.FunctionDef) -> list[ast.arg]:
    """Return the arguments of a function but `self` and `cls`."""
    all_of_them = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
    return [arg for arg in all_of_them if arg.arg not in ("self", "cls")]


def annotated(module: str) -> float:
    """Share of functions with a type for each argument and the result."""
    functions = [node for node in definitions(module) if isinstance(node, ast.FunctionDef)]
    full = [f for f in functions if f.returns and all(a.annotation for a in arguments(f))]
    return len(full) / len(functions)


def is_typed(module: str) -> bool:
    """Whether the package says that its types are for others."""
    return (sources(module)[0].parents[0] / "py.typed").exists() or any(
        (path.parent / "py.typed").exists()
        for path in sources(module)
        if path.name == "__init__.py"
    )


def has_wheels(package: str) -> bool:
    """Whether the index has wheels of this version for Windows, two macOS and Linux (asks pip)."""
    version = importlib.import_module(PACKAGES[package]).__version__
    python = f"{sys.version_info[0]}.{sys.version_info[1]}"
    linux = ("manylinux_2_17_x86_64", "--platform", "manylinux_2_28_x86_64")
    for system in (("win_amd64",), linux, ("macosx_11_0_arm64",), ("macosx_11_0_x86_64",)):
        asked = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--no-deps"]
        asked += ["--ignore-installed", "--only-binary", ":all:", "--platform", *system]
        asked += ["--python-version", python, "--target", "nowhere", f"{package}=={version}"]
        if subprocess.run(asked, capture_output=True, check=False).returncode:
            return False
    return True
