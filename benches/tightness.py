"""Ratios of bounds to the quantiles they bound, for the formulas and for simulation.

Radius over empirical quantile at delta, the quantile from 40 000 errors with their own key;
median and maximum over five systems and delta = 0.05, 0.01. The formulas: the smallest one of
`theory.drawn_bound`; for systematic samples and for K steps the triangle inequality with the error
of every estimate. `required_samples`: its size over the size at which the quantile meets the error,
and seconds for a call.

    python benches/tightness.py
"""

from __future__ import annotations

import json
import math
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import stochens_rs as se
from stochens_rs.theory.drawn_bounds import Bounded, drawn_bound

DATA = Path(__file__).resolve().parents[1] / "docs" / "data" / "tightness.json"
DELTAS = (0.05, 0.01)
SIZES = (100, 10_000, 1_000_000)
STEPS = 4
Floats = np.ndarray
Problem = tuple[Floats, Floats, Floats, Floats]


def systems() -> dict[str, Problem]:
    """``A, B, x0, xf`` of five different systems."""
    gen = np.random.default_rng(0)
    found = {}
    for name, case in (("ieee14", se.cases.ieee14()), ("ieee39", se.cases.ieee39())):
        found[name] = case.A, case.B, 0.1 * gen.standard_normal(case.n), np.zeros(case.n)
    A = gen.standard_normal((6, 6))
    found["Gaussian"] = A, gen.standard_normal((6, 3)), *gen.standard_normal((2, 6))
    sparse = A * (gen.random((6, 6)) < 0.4)
    found["sparse"] = sparse, gen.standard_normal((6, 3)), *gen.standard_normal((2, 6))
    walk = np.abs(A) / np.abs(A).sum(axis=0)
    found["random walk"] = walk, np.eye(6)[:, :4], np.full(6, 1 / 6), np.eye(6)[0]
    return {name: tuple(np.array(part) for part in problem) for name, problem in found.items()}


def formula(quantity: str, data: tuple[Floats, ...], N: int, delta: float, **options: str) -> float:
    of = Bounded(quantity, data, **options)
    return of.least(of.sizes(N), delta)[0]


def sum_of_errors(problem: Problem, N: int, delta: float) -> float:
    """Triangle inequality for one step with systematic samples, whose errors are bounded surely."""
    A, B, x0, xf = problem
    e0, ef, eA = (
        formula(quantity, (w,), N, delta, scheme="systematic")
        for quantity, w in (("vector", x0), ("vector", xf), ("matrix", A))
    )
    reached = np.linalg.norm(B @ np.linalg.pinv(B) @ A, 2)
    return float(ef + reached * e0 + eA * (np.linalg.norm(x0) + e0))


def along_trajectory(problem: Problem, N: int, delta: float) -> float:
    """``ef + ||A^K|| e0 + eA sum_k ||A^{K-1-k}|| ||x(k)||`` along the exact trajectory."""
    A, B, x0, xf = problem
    u = se.control((A, B), x0, xf, steps=STEPS)
    norms = [np.linalg.norm(np.linalg.matrix_power(A, k), 2) for k in range(STEPS + 1)]
    along = sum(norms[STEPS - 1 - k] * np.linalg.norm(u.predicted_states[k]) for k in range(STEPS))
    e0, ef = (formula("vector", (w,), N, delta / 3) for w in (x0, xf))
    return ef + norms[STEPS] * e0 + formula("matrix", (A,), N, delta / 3) * along


def quantities(problem: Problem) -> Iterator[tuple[str, tuple[object, ...], dict, object]]:
    """Quantity, what it is and its options, and the formula for N and delta."""
    A, B, x0, xf = problem
    data = (A, B), x0, xf

    def of(quantity: str, *some: Floats, **options: str) -> object:
        return lambda N, delta: formula(quantity, some, N, delta, **options)

    yield "vector", ("vector", x0), {}, of("vector", x0)
    frobenius = {"norm": "Frobenius"}
    yield "matrix, Frobenius", ("matrix", A), frobenius, of("matrix", A, **frobenius)
    for fusion in ("product", "diagonal"):
        for quantity in ("state", "control"):
            how = {"fusion": fusion}
            yield f"{quantity}, {fusion}", (quantity, *data), how, of(quantity, *data, **how)
    how = {"scheme": "systematic"}
    yield "state, systematic", ("state", *data), how, lambda N, d: sum_of_errors(problem, N, d)
    how = {"steps": STEPS}
    along = f"state, {STEPS} steps"
    yield along, ("state", *data), how, lambda N, d: along_trajectory(problem, N, d)


def measure() -> list[dict[str, object]]:
    found: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for name, problem in systems().items():
        for quantity, what, how, other in quantities(problem):
            law = Bounded(what[0], what[1:], **how)
            for N in SIZES:
                drawn = law.law(law.sizes(N)).draw(40_000, se.rng.as_key(7))[:, law.which]
                for delta in DELTAS:
                    quantile = float(np.quantile(drawn, 1.0 - delta))
                    if quantile < 1e-9:  # rounding only
                        continue
                    simulated, _ = drawn_bound(*what, size=N, delta=delta, **how)
                    ratios = other(N, delta) / quantile, simulated / quantile
                    found.setdefault((quantity, N), []).append(ratios)
        print(name, flush=True)
    rows = []
    for (quantity, N), ratios in found.items():
        before, after = zip(*ratios, strict=True)
        rows.append(
            {
                "quantity": quantity,
                "N": N,
                "formula": (statistics.median(before), max(before)),
                "simulated": (statistics.median(after), max(after)),
            }
        )
    return rows


def sizes() -> list[dict[str, object]]:
    rows = []
    for name, (A, B, x0, xf) in systems().items():
        for options in ({}, {"fusion": "diagonal"}, {"steps": STEPS}):
            seconds = []
            # absolute, since the state reached may be the origin: a tenth of the distance moved
            error = 0.1 * float(np.linalg.norm(xf - A @ x0))
            for _ in range(3):
                start = time.perf_counter()
                plan = se.required_samples((A, B), x0, xf, error, relative=False, rng=1, **options)
                seconds.append(time.perf_counter() - start)
            of = Bounded("state", ((A, B), x0, xf), **options)

            def quantile(N: int, of: Bounded = of) -> float:
                drawn = of.law((N,) * 3).draw(20_000, se.rng.as_key(8))
                return float(np.quantile(drawn[:, 0], 0.95))

            low, high = 1, plan.size
            while high / low > 1.005 and high - low > 1:
                middle = max(math.isqrt(low * high), low + 1)
                low, high = (low, middle) if quantile(middle) <= plan.error else (middle, high)
            others = [row.size for row in plan.rows if row.name != "simulated" and row.size]
            rows.append(
                {
                    "system": name,
                    "what": ", ".join(f"{k} {v}" for k, v in options.items()) or "product",
                    "needed": high,
                    "simulated": plan.size / high,
                    "formula": min(others) / high if others else None,
                    "seconds": statistics.median(seconds),
                }
            )
        print(name, "sizes", flush=True)
    return rows


def page() -> list[str]:
    """Return the section of docs/benchmarks.md."""
    if not DATA.exists():
        return []
    data = json.loads(DATA.read_text())
    lines = [
        "## How tight the bounds are",
        "",
        "Radius over empirical quantile, median and, in brackets, maximum over five systems (IEEE "
        "14 and 39 buses, Gaussian, sparse, random walk) at delta = 0.05 and 0.01. *Formula*: the "
        "smallest formula of `theory.drawn_bound`, for systematic samples and several steps the "
        "sum of the errors of the estimates. *Simulated*: `theory.drawn_bound`.",
        "",
        "| error of | N | formula | simulated |",
        "|---|---:|---:|---:|",
    ]
    for row in data["radii"]:
        cells = [f"{row[k][0]:.3g} ({row[k][1]:.3g})" for k in ("formula", "simulated")]
        lines.append(f"| {row['quantity']} | {row['N']:,} | {cells[0]} | **{cells[1]}** |")
    lines += [
        "",
        "`required_samples` for an error of a tenth of ||xf - A x0||, delta = 0.05: its size "
        "divided by the sufficient one, at which the quantile of 20 000 errors meets the error.",
        "",
        "| system | fusion | enough | formula | simulated | one call |",
        "|---|---|---:|---:|---:|---:|",
    ]
    for row in data["sizes"]:
        other = "" if row["formula"] is None else f"{row['formula']:.3g}"
        lines.append(
            f"| {row['system']} | {row['what']} | {row['needed']:,} | {other} | "
            f"**{row['simulated']:.3g}** | {row['seconds']:.2f} s |"
        )
    return [*lines, ""]


def run() -> None:
    DATA.write_text(json.dumps({"radii": measure(), "sizes": sizes()}, indent=1) + "\n")


if __name__ == "__main__":
    run()
    print("\n".join(page()))
