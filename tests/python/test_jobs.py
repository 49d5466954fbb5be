"""Four jobs from the data to the end, as a user does them, with budgets of lines that they execute.

A budget counts the different lines of the package that a second call executes: it may only fall.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

import stochens_rs as se

ROOT = str(Path(se.__file__).parent)
A, B, SIGMA = np.array([[1.0, 0.1], [0.0, 0.9]]), np.array([[0.0], [0.1]]), 0.01
STEPS = 10


def lines_executed(job: Callable[[], object]) -> int:
    """How many different lines of the package a call executes."""
    lines = set()

    def local(frame: FrameType, event: str, _: Any) -> Any:
        if event == "line":
            lines.add((frame.f_code.co_filename, frame.f_lineno))
        return local

    def called(frame: FrameType, event: str, _: Any) -> Any:
        return local if frame.f_code.co_filename.startswith(ROOT) else None

    before = sys.gettrace()
    sys.settrace(called)
    try:
        job()
    finally:
        sys.settrace(before)
    return len(lines)


def logs(runs: int, steps: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """States and inputs of runs of a cart with friction."""
    rng = np.random.default_rng(1)
    states, inputs = [], []
    for _ in range(runs):
        x, u = [rng.normal(size=2)], rng.normal(size=(steps, 1))
        for force in u:
            x.append(A @ x[-1] + B @ force + SIGMA * rng.normal(size=2))
        states.append(np.array(x))
        inputs.append(u)
    return states, inputs


def bound_job(_: Path) -> Callable[[], se.Certificate]:
    """Runs, a model, a control, and how far from the target it may end."""
    data = se.Trajectories(*logs(60, 5))

    def job() -> se.Certificate:
        plan = se.control(se.identify(data), [1.0, 0.0], [0.0, 0.0], steps=STEPS)
        return plan.bound(0.05)

    assert 0.0 < job().target < 0.5
    return job


def files_job(folder: Path) -> Callable[[], se.Certificate]:
    """A CSV file of runs, a control within limits, and its bound."""
    path, rows = folder / "runs.csv", ["run,t,pos,vel,force"]
    for run, (x, u) in enumerate(zip(*logs(60, 5), strict=True)):
        forces = [*(f"{one:.17g}" for one in u[:, 0]), ""]
        for k, ((pos, vel), force) in enumerate(zip(x, forces, strict=True)):
            rows.append(f"{run},{k / 10:.1f},{pos:.17g},{vel:.17g},{force}")
    path.write_text("\n".join(rows) + "\n")

    def job() -> se.Certificate:
        data = se.Trajectories.from_csv(
            path, states=["pos", "vel"], inputs=["force"], by="run", time="t"
        )
        cost = se.Cost(Q=1.0, R=0.1)
        plan = se.control(se.identify(data), [1, 0], [0, 0], steps=STEPS, limits=(-5, 5), cost=cost)
        assert np.abs(plan.u).max() <= 5.0
        return plan.bound(0.05)

    assert np.isfinite(job().target)
    return job


def readings_job(_: Path) -> Callable[[], list[float]]:
    """Logs of positions, a loop within limits, and calls until its window is full."""
    rng = np.random.default_rng(2)
    states, inputs = logs(20, 60)
    readings = [x[:, :1] + 0.001 * rng.normal(size=(len(x), 1)) for x in states]
    data = se.Trajectories(readings, inputs, outputs=True)

    def job() -> list[float]:
        cost = se.Cost(Q=1.0, R=0.1)
        loop = se.regulate(se.identify(data), 8, cost=cost, limits=(-1, 1), offset_free=False)
        return [float(loop(y)[0]) for y in readings[0][:20]]

    u = np.array(job())
    assert np.abs(u).max() <= 1.0
    assert np.abs(u[15:]).max() > 0.0
    return job


def realizations_job(_: Path) -> Callable[[], se.Certificate]:
    """Drawn realizations, their fusion, one control, and its bound."""
    system, x0 = se.System(A, B), np.array([1.0, -0.5])

    def job() -> se.Certificate:
        return se.steer(system, x0, np.zeros(2), STEPS, rng=1).bound(0.05)

    assert np.isfinite(job().target)
    return job


@pytest.mark.parametrize(
    ("make", "budget"),
    [(bound_job, 488), (files_job, 969), (readings_job, 747), (realizations_job, 507)],
)
def test_a_job_ends_well_within_its_budget_of_lines(
    make: Callable[[Path], Callable[[], object]], budget: int, tmp_path: Path
) -> None:
    count = lines_executed(make(tmp_path))
    assert 0.9 * budget < count <= budget, "a budget follows what it counts: lower it"
