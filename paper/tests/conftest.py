"""The seed of tests, and which of them are slow."""

from __future__ import annotations

import numpy as np
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


@pytest.fixture
def seed(request: pytest.FixtureRequest) -> int:
    """Seed of this run: a test that takes it must pass for every seed."""
    return int(request.config.getoption("--seed", 42))


@pytest.fixture
def gen(seed: int) -> np.random.Generator:
    """Source of test data; new for every test, so their order does not matter."""
    return np.random.default_rng(seed)
