"""Count the code lines of every room, and hold them to the budgets in ``lines.txt``.

A code line is one that is no docstring, no comment and not blank; tests inside a Rust file count
as tests. Budgets only fall: ``python tools/lines.py --lower`` writes those of rooms that shrank.
A budget above the least one that a room had is a raise, and must have a reason below the table:
``python tools/lines.py --raise "why"`` writes those of rooms that grew.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections import Counter
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "tools" / "lines.txt"
HEAD = "# room | files | code lines | least code lines so far\n"
RAISES = "\n# why budgets were raised: reason | rooms\n"


class Budget(NamedTuple):
    """How many files and code lines a room may have, and the least lines it was ever held to."""

    files: int
    lines: int
    least: int
    reasons: tuple[str, ...] = ()


def python_lines(text: str) -> int:
    """Code lines of a Python source."""
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            text_of = first.value if isinstance(first, ast.Expr) else None
            if isinstance(text_of, ast.Constant) and isinstance(text_of.value, str):
                documented.update(range(text_of.lineno, (text_of.end_lineno or 0) + 1))
    rows = ((i, row.strip()) for i, row in enumerate(text.splitlines(), 1))
    return sum(bool(row) and not row.startswith("#") and i not in documented for i, row in rows)


def rust_lines(text: str) -> tuple[int, int]:
    """Code lines of a Rust source, and those of the tests at its end."""
    code, _, tests = text.partition("\n#[cfg(test)]\nmod tests {")
    found = []
    for part in (code, tests):
        rows = (row.strip() for row in part.splitlines())
        found.append(sum(bool(row) and not row.startswith("//") for row in rows))
    return found[0], found[1]


def counted(root: Path = ROOT) -> dict[str, tuple[int, int]]:
    """Files and code lines of each room; sums of the package and of the core come first."""
    files: Counter[str] = Counter()
    lines: Counter[str] = Counter()

    def add(rooms: tuple[str, ...], count: int) -> None:
        for room in rooms:
            files[room] += 1
            lines[room] += count

    package = root / "python" / "stochens_rs"
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package).parts
        room = parts[0] if len(parts) > 1 else "*.py"
        add(("package", f"package/{room}"), python_lines(path.read_text(encoding="utf-8")))
    for path in sorted((root / "rust").rglob("*.rs")):
        parts = path.relative_to(root / "rust").parts
        room = parts[0] if len(parts) > 1 else "*.rs"
        code, tests = rust_lines(path.read_text(encoding="utf-8"))
        if "tests" in (*parts[:-1], path.stem):
            code, tests = 0, code + tests
        if code:
            add(("core", f"core/{room}"), code)
        lines["tests/core"] += tests
    for path in sorted((root / "tests" / "python").rglob("*.py")):
        add(("tests/python",), python_lines(path.read_text(encoding="utf-8")))
    for path in sorted((root / "paper").rglob("*.py")):
        room = "tests/paper" if "tests" in path.relative_to(root).parts else "paper"
        add((room,), python_lines(path.read_text(encoding="utf-8")))
    return {room: (files[room], lines[room]) for room in sorted(lines)}


def read_table(text: str) -> dict[str, Budget]:
    """The budgets of a table: lines ``room | files | lines | least``, then ``reason | rooms``."""
    table: dict[str, Budget] = {}
    for row in text.splitlines():
        if not row.strip() or row.startswith("#"):
            continue
        name, *cells = (cell.strip() for cell in row.split("|"))
        if len(cells) == 3:
            table[name] = Budget(*map(int, cells))
        else:
            for room in cells[0].split(", "):
                table[room] = table[room]._replace(reasons=(*table[room].reasons, name))
    return table


def written(table: dict[str, Budget]) -> str:
    """The table as text."""
    wide = max(map(len, table))
    rooms = sorted(table)
    rows = [
        f"{r:{wide}} | {table[r].files:4d} | {table[r].lines:6d} | {table[r].least:6d}"
        for r in rooms
    ]
    reasons = dict.fromkeys(reason for r in rooms for reason in table[r].reasons)
    raises = [
        f"{why} | {', '.join(r for r in rooms if why in table[r].reasons)}" for why in reasons
    ]
    return (
        "\n".join([HEAD + "\n".join(rows), *([RAISES + "\n".join(raises)] if raises else [])])
        + "\n"
    )


def faults(found: dict[str, tuple[int, int]], table: dict[str, Budget]) -> list[str]:
    """What is above its budget, has none, or was raised without a reason."""
    wrong = []
    for room, (files, lines) in found.items():
        if room not in table:
            wrong.append(f"{room} has {lines} code lines and no budget: write its line")
            continue
        allowed = table[room]
        counts = (("files", files, allowed.files), ("code lines", lines, allowed.lines))
        for what, now, most in counts:
            if now > most:
                wrong.append(
                    f"{room} has {now} {what}, its budget is {most}: remove {now - most}, or raise "
                    "the budget and write the reason below the table"
                )
    for room, budget in table.items():
        if room not in found:
            wrong.append(f"{room} is gone: remove its line")
        if budget.lines > budget.least and not budget.reasons:
            wrong.append(f"{room} was raised from {budget.least} to {budget.lines}: say why")
    return wrong


def lowered(found: dict[str, tuple[int, int]], table: dict[str, Budget]) -> dict[str, Budget]:
    """The table with the budgets of rooms that shrank, and without those of rooms that are gone."""
    new = {}
    for room, (files, lines) in found.items():
        old = table.get(room, Budget(files, lines, lines))
        count = min(lines, old.lines)
        reasons = old.reasons if count > old.least else ()
        new[room] = Budget(min(files, old.files), count, min(count, old.least), reasons)
    return new


def raised(
    found: dict[str, tuple[int, int]], table: dict[str, Budget], why: str
) -> dict[str, Budget]:
    """The table with the budgets of rooms that grew, each with the reason behind its old ones."""
    new = dict(table)
    for room, (files, lines) in found.items():
        old = table.get(room, Budget(0, 0, lines))
        if files > old.files or lines > old.lines:
            reasons = tuple(dict.fromkeys((*old.reasons, why)))
            new[room] = Budget(max(files, old.files), max(lines, old.lines), old.least, reasons)
    return new


def main() -> int:
    """Print the counts; 1 where a room is above its budget."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lower", action="store_true", help="write the budgets of smaller rooms")
    parser.add_argument("--raise", dest="why", help="write the budgets of larger rooms, and why")
    given = parser.parse_args()
    found = counted()
    table = read_table(TABLE.read_text(encoding="utf-8")) if TABLE.exists() else {}
    if given.why:
        table = raised(found, table, given.why)
    if given.lower:
        table = lowered(found, table)
    if given.why or given.lower:
        TABLE.write_text(written(table), encoding="utf-8")
    for room, (files, lines) in found.items():
        allowed = table[room].lines if room in table else 0
        print(f"{room:28} {files:4d} files {lines:6d} code lines of {allowed:6d}")
    wrong = faults(found, table)
    print("\n".join(wrong), file=sys.stderr)
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
