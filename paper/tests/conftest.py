"""Which tests of the paper are slow, and what they share."""

from __future__ import annotations

import pytest

SLOW = ("experiments", "claims", "program", "report_page")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.parent.parent.name == "paper" and any(s in item.path.stem for s in SLOW):
            item.add_marker("slow")


@pytest.fixture(scope="session")
def experiments():
    """Small ones of both kinds."""
    import paper  # needs matplotlib, without which its tests are skipped

    power = paper.power(rng=3, replicates=4, samples=60)
    return [power, paper.tracking(rng=3, replicates=2, samples=30, n=10, m=8)]


@pytest.fixture(scope="session")
def claimed():
    """All verdicts, and what their progress was."""
    import paper

    seen: list[tuple[int, int | None]] = []
    return paper.claims(quick=True, progress=lambda *counts: seen.append(counts)), seen
