"""The budgets of code lines per room: what counts as a line, and what a table refuses."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def loaded(path):
    """A program of the repository beside the package, as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


lines = loaded(ROOT / "tools" / "lines.py")

PYTHON = '''"""A module.

With a second line.
"""

# a comment
x = 1  # counts


def f():
    """One line."""
    return """no docstring,
two lines"""
'''
RUST = """//! docs
use a::b;

/// doc
fn f() -> u8 {
    // comment
    1
}

#[cfg(test)]
mod tests {
    #[test]
    fn g() {}
}
"""


def test_rooms_are_counted_in_both_languages(tmp_path):
    for path, text in {
        "python/stochens_rs/__init__.py": PYTHON,
        "python/stochens_rs/limits/cost.py": PYTHON,
        "rust/limits/rows.rs": RUST,
        "rust/limits/tests/oracle.rs": RUST,
        "tests/python/test_x.py": PYTHON,
        "paper/x.py": PYTHON,
        "paper/tests/test_x.py": PYTHON,
    }.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    assert lines.counted(tmp_path) == {
        "core": (1, 4),
        "core/limits": (1, 4),
        "package": (2, 8),
        "package/*.py": (1, 4),
        "package/limits": (1, 4),
        "paper": (1, 4),
        "tests/core": (0, 10),
        "tests/paper": (1, 4),
        "tests/python": (1, 4),
    }


@pytest.mark.parametrize(
    ("row", "found", "message"),
    [
        ("limits | 2 | 10 | 10", (2, 10), None),
        ("limits | 2 | 10 | 10", (2, 11), "limits has 11 code lines, its budget is 10: remove 1"),
        ("limits | 2 | 10 | 10", (3, 9), "limits has 3 files, its budget is 2"),
        ("limits | 2 | 12 | 10", (2, 12), "limits was raised from 10 to 12: say why"),
        ("limits | 2 | 12 | 10\nsoft rates | limits", (2, 12), None),
        ("other | 2 | 10 | 10", (2, 10), "limits has 10 code lines and no budget"),
    ],
)
def test_a_room_stays_within_its_budget(row, found, message):
    wrong = lines.faults({"limits": found}, lines.read_table(f"# head\n{row}\n"))
    assert (not wrong) if message is None else wrong[0].startswith(message)


def test_budgets_are_lowered_never_raised():
    table = lines.read_table(
        "limits | 3 | 12 | 10\nfleet | 1 | 5 | 5\ngone | 1 | 1 | 1\nsoft rates | limits"
    )
    new = lines.lowered({"limits": (2, 9), "fleet": (2, 7)}, table)
    assert new == {"limits": lines.Budget(2, 9, 9), "fleet": lines.Budget(1, 5, 5)}
    assert lines.read_table(lines.written(new)) == new


def test_a_raise_has_its_reason_behind_the_old_ones():
    table = lines.read_table("limits | 3 | 12 | 10\nfleet | 1 | 5 | 5\nrates | limits\n")
    new = lines.raised({"limits": (3, 15), "fleet": (1, 5), "loops": (1, 7)}, table, "sums")
    assert lines.read_table(lines.written(new)) == new
    assert new["limits"] == (3, 15, 10, ("rates", "sums"))
    assert new["fleet"] == table["fleet"]
    assert new["loops"] == (1, 7, 7, ("sums",))
