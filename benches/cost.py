"""Cost of each kernel over n and over N, and the speed-up from a second thread."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import stochens_rs as se

DOCS = Path(__file__).resolve().parent.parent / "docs"


@dataclass(frozen=True)
class Costs:
    """Seconds per unit over n, total seconds over N, and time ratios of one to two threads."""

    against_n: dict[str, list[tuple[int, float]]]
    against_size: dict[str, list[tuple[int, float]]]
    two_threads: dict[str, tuple[float, float, float]]

    def to_dict(self) -> dict[str, Any]:
        """As plain lists."""
        return asdict(self)


def median(work: Callable[[], object], repeats: int = 3) -> float:
    """Median seconds of a few calls, after a first one that is not counted."""
    work()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def run() -> Costs:
    """Measure and draw."""
    costs = Costs(_against_n(), _against_size(), _two_threads())
    for name, points in {**costs.against_n, **costs.against_size}.items():
        print(f"cost of {name}: " + ", ".join(f"{k}: {s:.2e}" for k, s in points), flush=True)
    for name, (middle, low, high) in costs.two_threads.items():
        print(f"two threads, {name}: {middle:.2f}x ({low:.2f} .. {high:.2f})", flush=True)
    draw(costs, DOCS / "images" / "cost.png")
    return costs


def _against_n() -> dict[str, list[tuple[int, float]]]:
    gen = np.random.default_rng(0)
    points: dict[str, list[tuple[int, float]]] = {
        "a draw": [],
        "a realization of a matrix": [],
        "an SLSE step of a matrix": [],
        "a step of a stream": [],
    }
    for n in (10, 100, 1000, 10_000, 100_000, 1_000_000):
        w, size = gen.standard_normal(n), 1 << 22
        points["a draw"].append((n, median(lambda w=w, k=size: se.sample(w, k, rng=1)) / size))
    for n in (10, 30, 100, 300, 1000):
        A, size = gen.standard_normal((n, n)), 2_000_000 // n
        ensemble = se.sample(A, size, rng=1)
        points["a realization of a matrix"].append(
            (n, median(lambda A=A, k=size: se.sample(A, k, rng=1)) / size)
        )
        points["an SLSE step of a matrix"].append(
            (n, median(lambda A=A, e=ensemble: se.fuse(e, "slse", target=A)) / size)
        )
        B = gen.standard_normal((n, max(1, n // 2)))
        stream = se.Stream((A, B), gen.standard_normal(n), gen.standard_normal(n), rng=1)
        points["a step of a stream"].append((n, median(lambda s=stream, k=size: s.step(k)) / size))
    return points


def _against_size() -> dict[str, list[tuple[int, float]]]:
    A = np.random.default_rng(0).standard_normal((30, 30))
    points: dict[str, list[tuple[int, float]]] = {
        "sampling": [],
        "the mean": [],
        "SLSE": [],
        "ALSE": [],
        "counts only": [],
    }
    for size in (100, 1000, 10_000, 100_000, 1_000_000):
        ensemble = se.sample(A, size, rng=1)
        works: dict[str, Callable[[], object]] = {
            "sampling": lambda k=size: se.sample(A, k, rng=1),
            "the mean": lambda e=ensemble: se.fuse(e),
            "SLSE": lambda e=ensemble: se.fuse(e, "slse", target=A),
            "ALSE": lambda e=ensemble: se.fuse(e, "alse", target=A),
            "counts only": lambda k=size: se.sample_counts(A, k, rng=1),
        }
        for name, work in works.items():
            points[name].append((size, median(work)))
    for size in (10**9, 10**12):
        points["counts only"].append((size, median(lambda k=size: se.sample_counts(A, k, rng=1))))
    return points


def _two_threads() -> dict[str, tuple[float, float, float]]:
    gen = np.random.default_rng(0)
    w, A = gen.standard_normal(100), gen.standard_normal((100, 100))
    system = se.System(A / 10.0, gen.standard_normal((100, 10)))
    size = 1_000_000  # 80 MB of controls
    x0, xf, EA = se.sample(w, size, rng=1), se.sample(w, size, rng=2), se.sample(A, size, rng=3)
    out = np.zeros((size, 10))
    works: dict[str, Callable[[], object]] = {
        "sampling a vector": lambda: se.sample(w, 1 << 24, rng=1),
        "sampling a matrix": lambda: se.sample(A, 100_000, rng=1),
        "batched controls": lambda: se.realization_controls((EA, system.B), x0, xf, out=out),
        "simulated runs": lambda: se.simulate_ensemble(system, w, np.ones((10, 10)), 20_000, rng=1),
        "ALSE, 100x100, N = 1e5": lambda: se.fuse(EA.prefix(100_000), "alse", target=A),
    }
    found = {}
    for name, work in works.items():
        ratios = []
        for _ in range(5):
            se.set_num_threads(1)
            one = median(work, 1)
            se.set_num_threads(2)
            ratios.append(one / median(work, 1))
        se.set_num_threads(1)
        found[name] = statistics.median(ratios), min(ratios), max(ratios)
    return found


def draw(costs: Costs, path: Path) -> None:
    """Two panels: time per unit over n, total time over N."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    colours = ["#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7"]
    markers = ["o", "s", "^", "D", "v"]
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 3.9), layout="constrained")
    panels = (
        (axes[0], costs.against_n, "n", "seconds per unit"),
        (axes[1], costs.against_size, "realizations N", "total seconds (30 x 30 matrix)"),
    )
    for axis, curves, xlabel, ylabel in panels:
        for (name, points), colour, marker in zip(curves.items(), colours, markers, strict=False):
            x, y = zip(*points, strict=True)
            axis.loglog(x, y, color=colour, marker=marker, ms=5, lw=1.6, label=name)
        axis.set_xlabel(xlabel)
        axis.set_ylabel(ylabel)
        axis.grid(True, which="major", color="0.92")
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(frameon=False, fontsize=9)
    axes[0].set_title("Cost against dimension, one thread", loc="left", fontsize=10.5)
    axes[1].set_title("Cost against realizations, one thread", loc="left", fontsize=10.5)
    figure.savefig(path, dpi=150)
    plt.close(figure)
