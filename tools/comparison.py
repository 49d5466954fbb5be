"""The cells of the table of features, read from `comparison.txt`, and how each is checked.

A line is ``package = verdict | check | note``. A check is names that the sources of the package
have; regular expressions of which none matches a name there, but for names that were looked at and
mean something else; or ``run``, a computation here, where names do not tell.
"""

from __future__ import annotations

import ast
import importlib
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

TITLES = {"stochens_rs": "stochens_rs", "control": "python-control", "nutpie": "nutpie"}
TITLES |= {"cvxpy": "CVXPY"}
PACKAGES = tuple(TITLES)  # names on the index and of the modules
# Packages for one of the jobs: their modules, never imported, as one of them starts Julia.
NEAR = {"stochens_rs": "stochens_rs", "lmpc": "lmpc (LinearMPC)", "ampyc": "AMPyC"}
NEAR |= {"ctrlsys": "ctrlsys (SLICOT)", "direct_data_driven_mpc": "direct-data-driven-mpc"}
NEAR |= {"mapie": "MAPIE"}
VERDICTS = ("yes", "partly", "no", "-")


@dataclass(frozen=True)
class Cell:
    """What a cell says, and how that is checked."""

    row: str
    package: str
    verdict: str
    has: tuple[str, ...] = ()  # names that must be there
    lacks: tuple[str, ...] = ()  # regular expressions
    but: tuple[str, ...] = ()  # names that match them and mean something else
    note: str = ""

    def check(self) -> None:
        """Raise if the cell is wrong for the installed version."""
        if not self.has and not self.lacks:
            RUN[self.row](self.package)
            return
        known = names(self.package)
        assert set(self.has) <= known, f"{self.package} lacks {sorted(set(self.has) - known)}"
        found = {name for name in known for one in self.lacks if re.search(one, name, re.I)}
        assert found == set(self.but), f"{self.package} has {sorted(found ^ set(self.but))}"


def read_cells(text: str) -> tuple[dict[str, dict[str, str]], dict[tuple[str, str], Cell]]:
    """The rows of each group with their labels, and the cells by row and package."""
    groups: dict[str, dict[str, str]] = {}
    cells: dict[tuple[str, str], Cell] = {}
    row, rows = "", dict[str, str]()
    for line in re.sub(r"\n    +", " ", text).splitlines():
        if line.startswith("# "):
            rows = groups.setdefault(line[2:], {})
        elif line.startswith("  "):
            package, _, rest = line.strip().partition(" = ")
            verdict, check, *note = rest.split(" | ")
            parts = [part.split() for part in check.split("; ")]
            told: dict[str, Any] = {word: tuple(rest) for word, *rest in parts if word != "run"}
            if note:
                told["note"] = note[0]
            if verdict not in VERDICTS or (verdict == "partly" and not note):
                raise ValueError(f"{package}, {row}: {verdict}")
            cells[row, package] = Cell(row, package, verdict, **told)
        elif line:
            row, _, label = line.partition(": ")
            rows[row] = label
    return groups, cells


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
    for compiled in ("_core", "_lib", "_slicot"):
        if any(Path(str(find_spec(module).origin)).parent.glob(f"{compiled}.*")):
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
    version = importlib.import_module(package).__version__
    python = f"{sys.version_info[0]}.{sys.version_info[1]}"
    linux = ("manylinux_2_17_x86_64", "--platform", "manylinux_2_28_x86_64")
    for system in (("win_amd64",), linux, ("macosx_11_0_arm64",), ("macosx_11_0_x86_64",)):
        asked = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--no-deps"]
        asked += ["--ignore-installed", "--only-binary", ":all:", "--platform", *system]
        asked += ["--python-version", python, "--target", "nowhere", f"{package}=={version}"]
        if subprocess.run(asked, capture_output=True, check=False).returncode:
            return False
    return True


# -- computations, where names do not tell ----------------------------------------------------

A, B = np.array([[1.0, 0.1], [0.0, 0.95]]), np.array([[0.0], [0.1]])
SHUFFLED = {"speed": 0.0, "position": 1.0}


def made(package: str, **names: Any) -> Any:
    """A cart as a system of a package, a problem of CVXPY, or a model of nutpie."""
    module = importlib.import_module(package)
    if package == "stochens_rs":
        return module.System(A, B, dt=0.1, **names)
    if package == "control":
        return module.ss(A, B, np.eye(2), 0, 0.1, **names)
    if package == "cvxpy":
        x = module.Variable(2, name="state")
        return module.Problem(module.Minimize(module.sum_squares(A @ x - B[:, 0])))
    from nutpie.compiled_pyfunc import from_pyfunc

    kind, shape = [np.dtype("float64")], [(2,)]
    return from_pyfunc(2, lambda: lambda t: (-t @ t / 2, -t), lambda *_: dict, kind, shape, ["t"])


def refuses(function: Callable[[], object], *errors: type[Exception]) -> bool:
    """Whether a call raises one of these."""
    try:
        function()
    except errors:
        return True
    return False


def _sparse(package: str) -> None:
    from scipy.sparse import csr_matrix

    make = importlib.import_module(package)
    dense = (B, np.eye(2), 0, 0.1) if package == "control" else (B,)
    kind = make.ss if package == "control" else make.System
    assert refuses(lambda: kind(csr_matrix(A), *dense), TypeError, ValueError)


def _draws(package: str) -> None:
    drawn, module = [], importlib.import_module(package)
    for threads in (1, 2):
        if package == "control":
            np.random.seed(1)  # noqa: NPY002
            drawn.append(module.white_noise(np.arange(0.0, 1.0, 0.1), np.eye(1), dt=0.1))
        else:
            module.set_num_threads(threads)
            drawn.append(module.sample(A, 5000, rng=1).mean())
    assert np.array_equal(*drawn)


def _pickle(package: str) -> None:
    one, wrong = made(package), (AttributeError, TypeError, pickle.PicklingError)
    if package == "stochens_rs":
        assert pickle.loads(pickle.dumps(one)) == one
    elif package == "cvxpy":
        assert abs(pickle.loads(pickle.dumps(one)).solve() - one.solve()) < 1e-6
    assert refuses(lambda: pickle.dumps(one), *wrong) == (package != "stochens_rs")


def _matched(package: str) -> None:
    import pandas as pd

    module, table = importlib.import_module(package), pd.Series(SHUFFLED)
    if package == "cvxpy":
        assert list(module.Constant(table).value) == [0.0, 1.0]
    elif package == "control":
        order = list(SHUFFLED)
        assert np.array_equal(module.ss(pd.DataFrame(A, order, order[::-1]), B, A, 0, 1).A, A)
    else:
        cart = made(package, states=["position", "speed"])
        u = [module.control(cart, x0, [0, 0], steps=3).u for x0 in (table, [1.0, 0.0])]
        assert np.array_equal(*u)
        other = table.rename({"speed": "v"})
        assert refuses(lambda: module.control(cart, other, [0, 0]), module.exceptions.InputError)


def _types(package: str) -> None:
    least = {"stochens_rs": 0.95, "control": 0.0, "nutpie": 0.1, "cvxpy": 0.1}[package]
    assert is_typed(package) == (package in ("stochens_rs", "cvxpy"))
    assert least <= annotated(package) < {"stochens_rs": 1.01, "control": 0.1}.get(package, 0.95)


def _shell(package: str) -> None:
    if package == "stochens_rs":
        assert "identify" in importlib.import_module("stochens_rs.cli").cli.commands
    else:
        assert not metadata.distribution(package).entry_points.select(group="console_scripts")


def _wheels(package: str) -> None:
    """Asks the package index."""
    assert has_wheels(package) == (package != "stochens_rs")
    assert has_wheels("cvxpy")  # the index answers


def _abi(package: str) -> None:
    if package == "stochens_rs":
        file = Path(importlib.import_module("stochens_rs._core").__file__ or "")
        assert ".abi3." in file.name or file.suffix == ".pyd"
        return
    tags = metadata.distribution(package).read_text("WHEEL") or ""
    assert ("py3-none-any" in tags) == (package == "control")
    assert "abi3" not in tags


RUN = {"sparse": _sparse, "draws": _draws, "pickle": _pickle, "matched": _matched}
RUN |= {"types": _types, "shell": _shell, "wheels": _wheels, "abi": _abi}
GROUPS, CELLS = read_cells((Path(__file__).with_suffix(".txt")).read_text(encoding="utf-8"))
NEAR_GROUPS, NEAR_CELLS = read_cells(
    Path(__file__).with_name("neighbours.txt").read_text(encoding="utf-8")
)
ROWS = {key: label for group in GROUPS.values() for key, label in group.items()}
