"""Table of features of this package and its neighbours: every cell is checked.

`python tools/compare_features.py [--write docs/compare.md]` in an environment with control, nutpie,
cvxpy, scipy, pandas and xarray, and with this package. Asks the package index which wheels there
are. Exit code 1 if a cell is wrong for the installed versions; the page is then not written.
"""

from __future__ import annotations

import argparse
import platform
import re
import statistics
import subprocess
import sys
import warnings
from collections.abc import Iterable
from datetime import date
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from comparison import CELLS, GROUPS, NEAR, NEAR_CELLS, NEAR_GROUPS, PACKAGES, TITLES, Cell
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
MEASURED = (
    "packages in all, with itself",
    "size of all of them [MB]",
    "CPU time of its import [s]",
)
WORDS = """\
Each cell is checked by a search of all names in the sources of the package or, where names do not
tell, by a small computation whose result is known. "No" only says that a package does not offer
this; often it was never meant to. A dash: it draws nothing at random. "Partly" has a
[note](#notes), whose number stands beside it, and so have some others. Sizes are those of the
installed files; times are medians of nine fresh processes, less that of Python itself. The program
that writes this page stops where a cell is wrong:

```sh
python -m venv compare
compare/bin/pip install control nutpie cvxpy packaging pandas xarray .
compare/bin/pip install --no-deps lmpc ampyc ctrlsys direct-data-driven-mpc mapie
compare/bin/python tools/compare_features.py --write docs/compare.md
```
"""
BETTER = """\
Take the neighbour where its job is yours:

- **lmpc**: the C code must keep limits of states, or inputs are on or off.
- **AMPyC**: schemes of robust, stochastic and nonlinear MPC are studied side by side.
- **ctrlsys**: the routines of SLICOT are what you build on: matrix equations, H-infinity design.
- **direct-data-driven-mpc**: no model is wanted, or the plant is not linear.
- **MAPIE**: a regression or classifier of your own needs intervals for its predictions."""
TABLES = ((NEAR, NEAR_GROUPS, NEAR_CELLS), (TITLES, GROUPS, CELLS))


def main() -> int:
    """Check all cells, measure, and print or write the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--write", type=Path, metavar="PAGE")
    page_path = parser.parse_args().write
    warnings.simplefilter("ignore")
    wrong = [line for line in map(fault, [*CELLS.values(), *NEAR_CELLS.values()]) if line]
    for line in wrong:
        print(line, file=sys.stderr)
    if wrong:
        return 1
    page = text(versions(), measured())
    if page_path:
        page_path.write_text(page, encoding="utf-8")
    print(page)
    return 0


def fault(cell: Cell) -> str:
    """Return what is wrong with a cell, or nothing."""
    try:
        cell.check()
    except Exception as error:  # whatever a package raises is a fault of the cell
        return f"{cell.package}, {cell.row}: {type(error).__name__}: {error}"
    return ""


# -- the page ------------------------------------------------------------------------------------


def text(head: str, numbers: list[str]) -> str:
    """Return the page: head, tables, measured numbers, notes."""
    notes = notes_in_order()
    parts = ["# Features side by side", head, WORDS.rstrip()]
    for titles, groups, cells in TABLES:
        for title, rows in groups.items():
            body = [
                line(label, [cells[row, one] for one in titles], notes)
                for row, label in rows.items()
            ]
            parts += [f"## {title}", "\n".join([*heading(titles), *body])]
            parts += [BETTER] if titles is NEAR else []
    parts += ["## Size", "\n".join([*heading(TITLES), *numbers])]
    parts += ["## Notes", "\n".join(f"{n}. {note}" for n, note in enumerate(notes, 1))]
    return "\n\n".join(parts) + "\n"


def heading(titles: dict[str, str]) -> list[str]:
    """Return the head of a table."""
    return ["| | " + " | ".join(titles.values()) + " |", "|---|" + "---|" * len(titles)]


def line(label: str, cells: list[Cell], notes: list[str]) -> str:
    """Return a row of a table as declared."""
    said = [
        f"{one.verdict} ({notes.index(one.note) + 1})" if one.note else one.verdict for one in cells
    ]
    return f"| {label} | " + " | ".join(said) + " |"


def notes_in_order() -> list[str]:
    """Return all notes, each once, as they are met in the tables."""
    cells = (
        cells[row, one]
        for titles, groups, cells in TABLES
        for rows in groups.values()
        for row in rows
        for one in titles
    )
    return list(dict.fromkeys(cell.note for cell in cells if cell.note))


def versions() -> str:
    """Return the line with the versions that were run."""
    found = [f"{TITLES[package]} {version(package)}" for package in PACKAGES]
    found += [f"{NEAR[one]} {metadata.version(one)}" for one in NEAR if one not in TITLES]
    python = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    return f"{', '.join(found)}; {python}; {date.today().isoformat()}.\n"[:-1]


def version(package: str) -> str:
    """Return the version of an installed package, or of the package in this checkout."""
    return str(__import__(package).__version__)


# -- sizes ---------------------------------------------------------------------------------------


def measured() -> list[str]:
    """Return the rows of the numbers that are measured."""
    columns = []
    for package in PACKAGES:
        needed = sorted(closure(package))
        size = sum(map(installed_size, needed)) / 1e6
        seconds = statistics.median(import_time(package) for _ in range(9))
        columns.append((str(len(needed)), f"{size:.0f}", f"{seconds:.2f}"))
    rows = zip(*columns, strict=True)
    return [f"| {label} | {' | '.join(row)} |" for label, row in zip(MEASURED, rows, strict=True)]


def requirements(package: str) -> Iterable[Requirement]:
    """Return what an installed package requires."""
    try:
        lines = metadata.requires(package) or []
    except metadata.PackageNotFoundError:  # this package, on the path only
        block = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
        block = block.partition("\ndependencies = [")[2].partition("]")[0]
        lines = re.findall(r'"(.+?)"', block)
    return map(Requirement, lines)


def closure(package: str) -> set[str]:
    """Return a package and all that is installed with it."""
    found, new = set(), {(package, "")}
    while new:
        name, extra = new.pop()
        found.add((name, extra))
        for need in requirements(name):
            if need.marker is None or need.marker.evaluate({"extra": extra}):
                new |= {(need.name.lower(), one) for one in ("", *need.extras)} - found
    return {re.sub(r"[-_.]+", "-", name) for name, _ in found}


def installed_size(package: str) -> int:
    """Return the bytes of a package's files, without compiled Python."""
    try:
        files = [Path(str(one.locate())) for one in metadata.files(package) or []]
    except metadata.PackageNotFoundError:
        files = list(Path(find_spec(package.replace("-", "_")).origin).parent.rglob("*"))
    return sum(p.stat().st_size for p in files if p.is_file() and p.suffix != ".pyc")


def import_time(module: str) -> float:
    """Return the CPU seconds that a fresh process needs to import a module."""
    code = f"import time, {module}; print(time.process_time())"
    asked = [sys.executable, "-W", "ignore", "-c"]
    bare = "import time; print(time.process_time())"
    return run([*asked, code]) - run([*asked, bare])


def run(command: list[str]) -> float:
    """Return the number that a process prints."""
    return float(subprocess.run(command, capture_output=True, check=True, text=True).stdout)


if __name__ == "__main__":
    sys.exit(main())
