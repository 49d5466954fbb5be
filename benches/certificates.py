"""Certificates of plans from data against the actual errors, as a markdown table.

Random systems of 4 states and 2 inputs (spectral radius 0.9), N independent pairs with noise of
standard deviation 0.1, x0, xf ~ N(0, I), the smallest control of the model to xf. Medians of
``tube[-1] / ||x(K) - xh(K)||``; by regression over all K steps at once the same from N runs of K
steps. Failures are those of both.

    python benches/certificates.py [RUNS]
"""

from __future__ import annotations

import sys
import time

import numpy as np

import stochens_rs as se

N, M, SIGMA = 4, 2, 0.1


def system(gen: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    A = gen.standard_normal((N, N))
    return 0.9 * A / np.abs(np.linalg.eigvals(A)).max(), gen.standard_normal((N, M))


def pairs(gen: np.random.Generator, A: np.ndarray, B: np.ndarray, size: int, K: int) -> se.Model:
    """One-step pairs, or for K > 1 the ends of runs of K steps in open loop."""
    start = x = gen.standard_normal((size, N))
    u = gen.standard_normal((size, K, M))
    for k in range(K):
        x = x @ A.T + u[:, k] @ B.T + SIGMA * gen.standard_normal((size, N))
    data = se.Trajectories.from_pairs(start, u.reshape(size, -1), x)
    return se.identify(data, noise=se.Noise(design="independent"), checks=False)


def row(K: int, size: int, runs: int, noise: bool) -> list[float]:
    gen = np.random.default_rng([K, size])
    ratios, radii, direct, failed = [], [], [], 0
    for _ in range(runs):
        A, B = system(gen)
        x0, xf = gen.standard_normal(N), gen.standard_normal(N)
        plan = se.control(pairs(gen, A, B, size, 1), x0, xf, steps=K)
        x = x0
        for u in plan.u:
            x = A @ x + B @ u + (SIGMA * gen.standard_normal(N) if noise else 0.0)
        found = plan.bound(noise=noise)
        radii.append(found.state)
        ratios.append(found.state / np.linalg.norm(x - plan.predicted_states[-1]))
        failed += ratios[-1] < 1.0
        if K > 1 and size >= K * M + 2 * N and not noise:
            model, inputs = pairs(gen, A, B, size, K), plan.u.ravel()
            off = x - model.A @ x0 - model.B @ inputs
            direct.append(model.region().bound(x0, inputs) / np.linalg.norm(off))
            failed += direct[-1] < 1.0
    return [float(np.median(v)) if v else np.nan for v in (ratios, radii, direct)] + [failed]


def speed(n: int = 10, m: int = 5, K: int = 6) -> float:
    gen = np.random.default_rng(0)
    A = 0.5 * gen.standard_normal((n, n)) / np.sqrt(n)
    z = gen.standard_normal((1000, n + m))
    y = z @ np.hstack([A, gen.standard_normal((n, m))]).T + gen.standard_normal((1000, n))
    data = se.Trajectories.from_pairs(z[:, :n], z[:, n:], y)
    model = se.identify(data, noise=se.Noise(design="independent"), checks=False)
    plan = se.control(model, gen.standard_normal(n), np.zeros(n), steps=K)
    plan.bound()  # the quantile of these sizes is kept
    times = []
    for _ in range(50):
        start = time.perf_counter()
        plan.bound()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def page(runs: int = 100) -> list[str]:
    """Return the section of docs/benchmarks.md."""
    lines = [
        "### How tight the certificates of plans are",
        "",
        f"Random systems of 4 states and 2 inputs, N pairs with noise of {SIGMA}, {runs} runs a "
        "row: `Plan.bound` over the actual distance of the last state, median, without and with "
        "noise to come; *all at once*: by regression over K steps, from N runs; failures of the "
        "runs without and with noise at delta = 0.05.",
        "",
        "| K | N | ratio | with noise | all at once | failures |",
        "|---:|---:|---:|---:|---:|---:|",
    ]
    for K in (1, 2, 4, 6, 10):
        for size in (60, 200):
            (plain, _, direct, failed), (noisy, *_, missed) = (
                row(K, size, runs, noise) for noise in (False, True)
            )
            cells = f"{plain:.1f}", f"{noisy:.1f}", "" if np.isnan(direct) else f"{direct:.1f}"
            lines.append(f"| {K} | {size} | {' | '.join(cells)} | {failed:.0f}, {missed:.0f} |")
    return [*lines, ""]


if __name__ == "__main__":
    print("\n".join(page(int(sys.argv[1]) if len(sys.argv) > 1 else 300)))
    print(f"One certificate, K = 6, n = 10, m = 5: {speed():.2f} ms")
