"""One command for a fleet against one conic problem of all units, and its moments against NumPy.

Medians, one thread. The monolithic problem goes to Clarabel through its own Python package, built
outside the timed part; its answer is clipped into the limits, and both values are recomputed. The
gap of ours is that of the dual, recomputed in the core from all units.

    OPENBLAS_NUM_THREADS=1 python benches/fleet.py
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import clarabel
import numpy as np
from scipy import linalg, sparse

import stochens_rs as se
from stochens_rs.fleet import FleetPlan
from stochens_rs.theory import scenario

Work = Callable[[], object]
Line = tuple[str, str, Work, float, Work, float]


def median(work: Callable[[], object], count: int = 7) -> float:
    """Milliseconds."""
    times = []
    for _ in range(count):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def population(gen: np.random.Generator, N: int, n: int, m: int) -> se.SystemEnsemble:
    """Units around a system whose modes have the size 0.95."""
    A = gen.standard_normal((n, n))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    B = gen.standard_normal((n, m))
    As = A + 0.05 * gen.standard_normal((N, n, n)) / np.sqrt(n)
    return se.SystemEnsemble(As, B + 0.1 * gen.standard_normal((N, n, m)))


def maps(units: se.SystemEnsemble, x0: np.ndarray, K: int) -> tuple[np.ndarray, np.ndarray]:
    """G (N, n, K m) and b (N, n) for the target 0, batched over the units."""
    A, X = units.A, units.B
    blocks, state = [], np.broadcast_to(x0, (len(A), len(x0)))[:, :, None]
    for _ in range(K):
        blocks.append(X)
        X, state = A @ X, A @ state
    return np.concatenate(blocks[::-1], axis=2), -state[:, :, 0]


def monolithic(G: np.ndarray, b: np.ndarray, limit: float) -> Callable[[], np.ndarray]:
    """One problem with a cone for each unit."""
    N, n, d = G.shape
    one, blocks, ends = np.eye(d), [], []
    for g, t in zip(G, b, strict=True):
        blocks.append(np.block([[np.zeros((1, d)), -np.ones((1, 1))], [-g, np.zeros((n, 1))]]))
        ends += [0.0, *(-t)]
    sides = np.hstack([np.vstack([one, -one]), np.zeros((2 * d, 1))])
    A = sparse.csc_matrix(np.vstack([sides, *blocks]))
    right = np.concatenate([np.full(2 * d, limit), ends])
    cones = [clarabel.NonnegativeConeT(2 * d)] + [clarabel.SecondOrderConeT(n + 1)] * N
    cost = np.concatenate([np.zeros(d), [1.0]])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    none = sparse.csc_matrix((d + 1, d + 1))

    def solve() -> np.ndarray:
        found = clarabel.DefaultSolver(none, cost, A, right, cones, settings).solve()
        return np.clip(np.array(found.x[:d]), -limit, limit)

    return solve


def networks(gen: np.random.Generator, N: int, machines: int, dt: float) -> se.SystemEnsemble:
    """Angles and speeds of machines on lines that differ by 5 percent from unit to unit."""
    lines = 0.1 * gen.standard_normal((machines, machines))
    lines = lines @ lines.T
    lines = np.diag(lines.sum(axis=1) + 1.0) - 0.1 * lines
    mass, damping = gen.uniform(2.0, 6.0, machines), gen.uniform(0.5, 2.0, machines)
    none, one = np.zeros((machines, machines)), np.eye(machines)
    units = []
    for _ in range(N):
        spread = 1.0 + 0.05 * gen.standard_normal((machines, machines))
        pull = -lines * (spread + spread.T) / 2 / mass[:, None]
        rates = np.block([[none, one, none], [pull, -np.diag(damping / mass), np.diag(1.0 / mass)]])
        step = linalg.expm(dt * np.vstack([rates, np.zeros((machines, 3 * machines))]))
        units.append((step[: 2 * machines, : 2 * machines], step[: 2 * machines, 2 * machines :]))
    return se.SystemEnsemble.from_systems(units)


def large() -> None:
    """150 networks of 54 machines over 20 steps: 1080 inputs."""
    gen = np.random.default_rng(0)
    units, x0 = networks(gen, 150, 54, 0.1), 0.5 * gen.standard_normal(108)
    asked = {
        "inputs": se.Limits(u=(-5.0, 5.0)),
        "inputs, rates, states": se.Limits(
            u=(-5.0, 5.0), rate=1.0, previous=0.0, x=(-2.5, 2.5), soft=False
        ),
    }
    print("largest miss, n = 108, m K = 1080, N = 150 [s]")
    for name, limits in asked.items():
        start = time.process_time()
        plan = se.control_fleet(units, x0, np.zeros(108), 20, limits=limits, risk="worst")
        print(f"  limits of {name}: {time.process_time() - start:.1f}, gap {plan.gap:.0e}, {plan}")


def problems(limits: tuple[float, ...]) -> Iterator[tuple[int, float, Work, Work, float]]:
    """Units, limit, ours, Clarabel's, and its largest miss."""
    gen, n, m, K = np.random.default_rng(1), 4, 2, 10
    for N in (300, 3000):
        units, x0 = population(gen, N, n, m), 3.0 * gen.standard_normal(n)
        G, b = maps(units, x0, K)
        for limit in limits:
            solve = monolithic(G, b, limit)

            def ours(units=units, x0=x0, limit=limit) -> FleetPlan:
                ends = x0, np.zeros(n)
                return se.control_fleet(units, *ends, K, limits=(-limit, limit), risk="worst")

            yield N, limit, ours, solve, float(np.linalg.norm(G @ solve() - b, axis=1).max())


def fleets() -> Iterator[Line]:
    for N, _, ours, theirs, value in problems((0.5,)):
        assert ours().value < value * (1.0 + 1e-6)
        yield f"least largest miss of {N} units", "Clarabel, one problem", ours, 1, theirs, 1


def main() -> None:
    se.set_num_threads(1)
    large()
    print("largest miss, n = 4, m K = 20 [ms]")
    for N, limit, work, solve, value in problems((10.0, 0.5, 0.2)):
        plan, ours, peer = work(), median(work), median(solve, 3)
        print(
            f"  N={N:5d} limit {limit:4}: {ours:7.2f}, Clarabel {peer:7.1f}, "
            f"{peer / ours:5.1f}x, gap {plan.gap:.0e}, "
            f"value / Clarabel's - 1 = {plan.value / value - 1:+.0e}"
        )
    print("risk numbers [us]")
    for name, call in (
        ("a_priori", lambda: scenario.a_priori(3000, 21, 1e-6)),
        ("judged", lambda: scenario.judged(3000, 5, 1e-6)),
        ("compression", lambda: scenario.compression(3000, 15, 1e-6)),
        ("relaxed", lambda: scenario.relaxed(3000, 171, 1e-6)),
        ("discarding", lambda: scenario.discarding(3000, 150, 21, 1e-6)),
        ("hold_out", lambda: scenario.hold_out(3000, 30, 1e-6)),
        ("required_scenarios", lambda: scenario.required_scenarios(0.01, 21, 1e-6)),
    ):
        print(f"  {name}: {1e3 * median(call, 201):.1f}")


if __name__ == "__main__":
    main()
