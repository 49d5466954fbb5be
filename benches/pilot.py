"""Certificates of plans by a pilot: python benches/pilot.py [sets] [part ...].

At delta = .05, medians over data sets of seeds of its own, in brackets how often a certificate
failed:

rig       N runs of 10 steps, a plan of 10 steps, without and with a pilot and a reference
families  other systems, over the 95 % quantile of the true miss of least squares of all runs
design    runs designed after the pilot over runs of white noise, clipped at the same limits
older     new runs with those of an older plant as pilot
time      from data to certificate, n = 10, m = 5, 1 000 pairs, 20 steps; the same in plain NumPy
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Iterable
from pathlib import Path

import numpy as np

import stochens_rs as se

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "python"))
from rig import plant as cart_pole

from pilot_sets import FAMILIES, Plant, led, measured, rig, split, steered
from twin import pilot as twin

DELTA = 0.05


def taken(plant: Plant, count: int, gen: np.random.Generator) -> se.Trajectories:
    """Runs with white inputs."""
    rows, _ = measured(plant, count, gen)
    (n, m), L = plant.B.shape, plant.length
    each = rows.reshape(count, L, 2 * n + m)
    states = [np.vstack([run[:, :n], run[-1:, n + m :]]) for run in each]
    return se.Trajectories(states, [run[:, n : n + m] for run in each])


def executed(plant: Plant, u: np.ndarray, gen: np.random.Generator) -> se.Trajectories:
    """Runs with these inputs (runs, L, m)."""
    n, states = len(plant.A), []
    for inputs in u:
        noise = plant.sigma * gen.standard_normal((len(inputs), n))
        start = plant.starts * gen.standard_normal(n)
        states.append(led(np.hstack([plant.A, plant.B]), start, inputs, noise))
    return se.Trajectories(states, list(u))


def certified(plant: Plant, data: se.Trajectories, **options: object) -> tuple[float, bool, float]:
    """The certificate, whether it failed, and the miss."""
    plan = se.control(
        se.identify(data, checks=False, **options), plant.x0, plant.xf, steps=plant.steps
    )
    end = se.simulate((plant.A, plant.B), plant.x0, plan.u).states[-1]
    bound, miss = plan.bound(DELTA).target, float(np.linalg.norm(end - plant.xf))
    return bound, miss > bound, miss


def said(found: Iterable[tuple[float, bool, float]], unit: float = 1.0) -> str:
    """The median certificate, and how many failed."""
    bounds, failed, _ = zip(*found, strict=True)
    return f"{np.median(bounds) / unit:.3g} ({sum(failed)})"


def near(plant: Plant, pilot: object = 0.1, *, known: bool = True) -> dict[str, object]:
    """The arguments for a plan near its reference."""
    noise = plant.sigma if known else se.Noise(covariance="scalar")
    task = plant.x0, plant.xf, plant.steps
    return {"noise": noise, "pilot": se.Pilot(pilot, reference=task)}


def compared(plant: Plant, sizes: tuple[int, ...], sets: int, share: float) -> None:
    """Certificates over the 95 % quantile of the miss."""
    ways = {
        "any design": {"noise": plant.sigma},
        "pilot": {"noise": plant.sigma, "pilot": share},
        "pilot, reference": near(plant, share),
        "the same, sigma unknown": near(plant, share, known=False),
    }
    for N in sizes:
        all_data = [taken(plant, N, np.random.default_rng([s, N, 7701])) for s in range(sets)]
        found = {
            name: [certified(plant, data, **options) for data in all_data]
            for name, options in ways.items()
        }
        q = float(np.quantile([miss for *_, miss in found["any design"]], 0.95))
        each = ", ".join(f"{name} {said(one, q)}" for name, one in found.items())
        print(f"  N={N}, {sets} sets, 95 % of misses below {q:.4g}; over it: {each}", flush=True)


def on_rig(sets: int) -> None:
    compared(rig(), (10, 20, 50, 100, 400), sets, 0.1)


def on_families(sets: int) -> None:
    for name, plant in FAMILIES.items():
        print(f" {name}")
        compared(plant, (20, 100), sets, 0.15)


def designed(sets: int) -> None:
    """The batch that `design` chooses after the pilot."""
    own = {"rig": rig(), **{name: FAMILIES[name] for name in ("n2 stable", "n6")}}
    for name, plant in own.items():
        for N in (20, 50, 100):
            found: list[list[tuple[float, bool, float]]] = [[], []]
            for seed in range(sets):
                gen = np.random.default_rng([seed, N, 7702])
                shape = plant.length, plant.B.shape[1]
                first = max(2, round(0.1 * N), -(-2 * sum(plant.B.shape) // plant.length))
                white = np.clip(gen.standard_normal((N, *shape)), -1.0, 1.0)
                before = executed(plant, white[:first], gen)
                model = se.identify(before, noise=plant.sigma, checks=False)
                plan = se.control(model, plant.x0, plant.xf, steps=plant.steps)
                best = se.design(plan, N - first, limits=(-1.0, 1.0), steps=plant.length).inputs
                for u, to in zip((white[first:], best), found, strict=True):
                    to.append(certified(plant, executed(plant, u, gen), **near(plant, model)))
            ratio = np.median([b for b, *_ in found[1]]) / np.median([b for b, *_ in found[0]])
            print(
                f"  {name}, N={N}: {ratio:.2f}, {said(found[0])} and {said(found[1])}", flush=True
            )


def with_older(sets: int) -> None:
    """The older plant as pilot, by how far it is from the newer one."""
    own = rig()
    for N in (3, 5, 10, 20, 50):
        found: dict[str, list[tuple[float, bool, float]]] = {}
        for seed in range(sets):
            gen = np.random.default_rng([seed, N, 7703])
            data = taken(own, N, gen)
            ways = {"any design": {"noise": own.sigma}}
            if N > 3:
                ways["own pilot"] = near(own)
            for apart in (0.01, 0.05):
                A, B = cart_pole(1.0, 0.2 * (1.0 + apart), 1.0 + apart)
                old = taken(own._replace(A=A, B=B), 100, gen)
                pilot = se.identify(old, noise=own.sigma, checks=False)
                ways[f"an older one, {apart:.0%}"] = near(own, pilot)
            for name, options in ways.items():
                found.setdefault(name, []).append(certified(own, data, **options))
        each = ", ".join(f"{name} {said(one)}" for name, one in found.items())
        print(f"  rig, N={N}, {sets} sets: {each}", flush=True)


def by_twin(plant: Plant, rows: np.ndarray) -> float:
    """The certificate in plain NumPy, from the pilot on; its `b_j` and their quantiles too."""
    (n, m), K, L = plant.B.shape, plant.steps, plant.length
    H0, main = split(rows, plant)
    lengths = np.full(len(main) // L, L)
    zeta = twin.simulated(H0, main[::L, :n], lengths, main[:, n : n + m], None)
    found = twin.estimate(zeta, main[:, : n + m], main[:, n + m :])
    plans = [(H, steered(H, plant.x0, plant.xf, K)) for H in (found.H, H0)]
    z, z0 = (np.hstack([led(H, plant.x0, u)[:-1], u]) for H, u in plans)
    radii = np.sqrt(n) + np.sqrt(n + m) + 3.0, np.sqrt(n * (n + m)) + 3.0
    problem = twin.Problem(found, H0, plant.sigma * np.eye(n), *radii, z, z0)
    s, value = problem.best(K, 0.8 * DELTA)
    return value + problem.rest(problem.better_rest(K, 0.08 * DELTA / (K - 1), s))


def timed(count: int) -> None:
    """Milliseconds of one thread, the least of `count`; of a few for the formulas in NumPy."""
    se.set_num_threads(1)
    own = FAMILIES["n10"]._replace(steps=20)
    gen = np.random.default_rng(7705)
    rows, _ = measured(own, 100, gen)
    data = taken(own, 100, np.random.default_rng(7705))
    model = se.identify(data, checks=False, **near(own))
    plan = se.control(model, own.x0, own.xf, steps=own.steps)
    parts = {
        "identify": lambda: se.identify(data, checks=False, **near(own)),
        "control": lambda: se.control(model, own.x0, own.xf, steps=own.steps),
        "bound": lambda: plan.bound(DELTA),
        "all in NumPy": lambda: by_twin(own, rows),
    }
    found = {}
    for name, one in parts.items():
        one()  # quantiles of these sizes are kept
        each = []
        for _ in range(count if name != "all in NumPy" else 3):
            start = time.thread_time()
            one()
            each.append(time.thread_time() - start)
        found[name] = 1e3 * min(each)
    *ours, numpy = found.values()
    print("  " + ", ".join(f"{name} {ms:.2f} ms" for name, ms in found.items()))
    print(f"  in all {sum(ours):.2f} ms, 1 / {numpy / sum(ours):.1f} of NumPy")


PARTS = {
    "rig": on_rig,
    "families": on_families,
    "design": designed,
    "older": with_older,
    "time": timed,
}

if __name__ == "__main__":
    warnings.simplefilter("ignore", se.exceptions.DataWarning)
    sets, *names = sys.argv[1:] or ["100"]
    for name in names or PARTS:
        print(name)
        PARTS[name](int(sets))
