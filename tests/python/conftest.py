"""Shared by all tests: no window opens, no test uses the global random state."""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

import numpy as np
import pytest

import stochens_rs as se

# A job that a shell has put into the background ignores Ctrl-C, which tests send.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# What is compiled is kept: for this process, and for the many that tests start.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# Before anything imports matplotlib, and for subprocesses too.
os.environ["MPLBACKEND"] = "Agg"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--seed", type=int, default=42, help="seed of the `seed` and `gen` fixtures (default 42)"
    )


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Tests of a file run in one process, which makes once what they share; so do all of paper/."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return "paper" if file.startswith("paper/") else file

    config.option.loadscopereorder = False  # in the order of pytest_collection_modifyitems
    return ByFile(config, log)


def pytest_report_header(config: pytest.Config) -> str:
    return f"test seed: {config.getoption('--seed')}"


# What `make quick` leaves out: coverage studies, hostile input, pictures, pages.
SLOW = ("coverage", "hostile", "hidden_systems", "pictures", "gallery", "notebook", "scenario",
        "interrupt", "durable")  # fmt: skip


# Files that take long without being slow tests.
LONG = ("paper", "docs", "keep", "margins", "sharper", "fused", "export", "loops", "propagation",
        "points", "alarm")  # fmt: skip


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        if any(word in item.path.stem for word in SLOW):
            item.add_marker("slow")
        if "coverage" in item.path.stem:
            # data are drawn by thousands: tests of logs warn of about one set in 200 by chance
            quiet = "ignore::stochens_rs.exceptions.DataWarning"
            item.add_marker(pytest.mark.filterwarnings(quiet))
    if hasattr(config, "workerinput"):  # the long ones first, so that all processes end together
        words = (*LONG, *SLOW)
        items.sort(key=lambda item: not any(word in item.nodeid.split("::")[0] for word in words))


@pytest.fixture
def seed(request: pytest.FixtureRequest) -> int:
    """Seed of this run: a test that takes it must pass for every seed."""
    return int(request.config.getoption("--seed"))


@pytest.fixture
def gen(seed: int) -> np.random.Generator:
    """Source of test data; new for every test, so their order does not matter."""
    return np.random.default_rng(seed)


@pytest.fixture(autouse=True, scope="module")
def _global_random_state_is_left_alone():
    """The package may neither use nor change NumPy's global generator."""
    before = np.random.get_state(legacy=False)  # noqa: NPY002
    yield
    after = np.random.get_state(legacy=False)  # noqa: NPY002
    assert before["state"]["pos"] == after["state"]["pos"]
    assert np.array_equal(before["state"]["key"], after["state"]["key"])


@pytest.fixture(autouse=True)
def _the_number_of_threads_is_left_alone():
    """A test that sets the number of threads sets it for itself."""
    yield
    se.set_num_threads(None)


@pytest.fixture
def noise_by_formula(monkeypatch: pytest.MonkeyPatch) -> None:
    """No test of the log refuses: for noise that follows a formula, or counts of regions alone."""
    monkeypatch.setattr("stochens_rs.identification.checks.FAULT", -1.0)
