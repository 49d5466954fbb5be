"""Which tests of the paper are slow, and what they share."""

from __future__ import annotations

import pytest

SLOW = ("experiments", "claims", "program", "report_page")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.parent.parent.name == "paper" and any(s in item.path.stem for s in SLOW):
            item.add_marker("slow")


@pytest.fixture(scope="session")
def claimed():
    """All verdicts, and what their progress was."""
    import paper  # needs matplotlib, without which its tests are skipped

    seen: list[tuple[int, int | None]] = []
    return paper.claims(quick=True, progress=lambda *counts: seen.append(counts)), seen
