"""How long a call of a loop takes: median, 99.9 % and the longest of many, the process on one core.

    python benches/latency.py [calls]

The core alone (`_solver.solve`) and the whole call from Python, at n = 10, m = 5, K = 20, in closed
loop with noise that keeps inputs at their limits; "cold" are first calls of loops begun anew. An
operating system that does other work makes the longest calls longer: the load is printed.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import stochens_rs as se

Floats = NDArray[np.float64]
LIMITS = {
    "inputs": se.Limits(u=(-0.5, 0.5)),
    "rates": se.Limits(u=(-0.5, 0.5), rate=0.15, previous=0.0),
    "soft states": se.Limits(u=(-0.5, 0.5), x=(-2.0, 2.0)),
    "rates and soft states": se.Limits(u=(-0.5, 0.5), x=(-2.0, 2.0), rate=0.15, previous=0.0),
}


def plant(n: int = 10, m: int = 5) -> tuple[Floats, Floats]:
    """A random system whose largest eigenvalue is 1."""
    rng = np.random.default_rng(3)
    A, B = rng.standard_normal((n, n)), rng.standard_normal((n, m))
    return A / np.abs(np.linalg.eigvals(A)).max(), B


def spent(call: Callable[[Floats], Floats], calls: int, size: float = 0.3) -> Floats:
    """Seconds of each call in closed loop."""
    A, B = plant()
    rng, x, took = np.random.default_rng(5), np.ones(len(A)), np.empty(calls)
    for k in range(calls):
        start = time.perf_counter_ns()
        u = call(x)
        took[k] = time.perf_counter_ns() - start
        x = A @ x + B @ u + size * rng.standard_normal(len(x))
    return 1e-9 * took


def core(loop: se.Regulator, *, cold: bool = False) -> Callable[[Floats], Floats]:
    """The plan alone; `cold`: without the active limits of the call before."""
    solver, m, rated = loop._solver, loop.m, loop._task.rate is not None

    def call(x: Floats) -> Floats:
        if cold:
            solver.resume(None)
        u = solver.solve(x, None).control[:m]
        if rated:
            solver.follow(u)
        return u

    return call


def main() -> None:
    """Print the table."""
    calls = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    print(f"{calls} calls each, load {os.getloadavg()[0]:.1f} of {os.cpu_count()} cores\n")
    print("| limits | what | p50 [us] | p99.9 [us] | longest [us] | bound [us] |")
    print("|---|---|---:|---:|---:|---:|")
    for name, limits in LIMITS.items():
        loop = se.regulate(plant(), 20, limits=limits, cost=se.Cost(Q=1.0, R=0.1))
        bound = 1e6 * loop.worst_time().seconds
        for what, call, count in (
            ("core", core(loop), calls),
            ("core, cold", core(loop, cold=True), calls // 10),
            ("whole call", loop, calls),
        ):
            took = 1e6 * spent(call, count)
            low, high = np.quantile(took, [0.5, 0.999])
            end = f"{bound:.0f}" if what == "core" else ""
            print(f"| {name} | {what} | {low:.1f} | {high:.1f} | {took.max():.0f} | {end} |")


if __name__ == "__main__":
    main()
