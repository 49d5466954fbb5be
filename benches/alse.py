"""ALSE of matrices against general solvers: seconds and the gap each reaches, on identical data.

Gaussian ``n x n`` matrices sampled by columns, seed 1, one thread. The gap is recomputed here, in
NumPy, from the realizations and the weights of each solver (clipped and scaled to the simplex), and
divided by ``||A||^2``. Each peer gets its fastest form:

- Clarabel (its Python interface, no modelling layer), linear solver "faer": variables ``(w, y)``,
  ``min |y|^2`` subject to ``S w - y = A``, sparse;
- OSQP (eps 1e-9): the same;
- PIQP: dense, on the Gram matrix ``S^T S``, computed outside the timed part;
- CVXPY: ``sum_squares(S w - a)`` as a user writes it, with its default solver.

Problems that take a peer minutes are left out unless ``--full`` is given. Writes the table to
``docs/data/alse.json`` and the figure to ``docs/images/alse-time.png``.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import stochens_rs as se

Floats = NDArray[np.float64]
Solver = Callable[["Problem"], tuple[float, Floats]]

DOCS = Path(__file__).resolve().parent.parent / "docs"
WITH_PEERS = (
    *((10, 500), (30, 300), (30, 900), (30, 1800), (30, 3000)),
    *((100, 1000), (100, 3000), (100, 10_000)),
)
ALONE = ((30, 10_000), (100, 30_000), (100, 100_000), (100, 1_000_000), (300, 10_000))
# most realizations at n = 100 without --full: more take minutes
PATIENCE = {"Clarabel": 10_000, "OSQP": 3000, "PIQP": 3000, "CVXPY": 3000}


class Problem:
    """One instance, in the forms for the peers (prepared outside the timed part)."""

    def __init__(self, n: int, size: int) -> None:
        self.n, self.size = n, size
        self.A = np.random.default_rng(1).standard_normal((n, n))
        self.ensemble = se.sample(self.A, size, rng=1)

    def samples(self) -> tuple[NDArray[np.int64], Floats]:
        """Rows in the flat matrix, (N, n), and values, (N, n), of the nonzeros."""
        rows = self.ensemble.indices.astype(np.int64) * self.n + np.arange(self.n)
        return rows, self.ensemble.atoms.ravel()[rows]

    def sparse(self):
        """``S`` (n^2, N), one column per realization."""
        from scipy import sparse

        rows, values = self.samples()
        start = np.arange(0, rows.size + 1, self.n)
        return sparse.csc_array((values.ravel(), rows.ravel(), start), (self.n**2, self.size))

    def relative_gap(self, weights: Floats) -> float:
        """``(f'(w) w - min f'(w)) / ||A||^2``, from the indices."""
        w = np.maximum(np.nan_to_num(weights), 0.0)
        w = w / w.sum() if w.sum() > 0 else np.full(self.size, 1.0 / self.size)
        a, step = self.A.ravel(), max(1, 4_000_000 // self.n)
        image, slope = np.zeros(self.n**2), np.empty(self.size)
        rows = self.ensemble.indices
        column, atoms = np.arange(self.n), self.ensemble.atoms.ravel()
        parts = [slice(k, k + step) for k in range(0, self.size, step)]
        for part in parts:
            flat = rows[part].astype(np.int64) * self.n + column
            image += np.bincount(
                flat.ravel(), (atoms[flat] * w[part, None]).ravel(), minlength=self.n**2
            )
        r = image - a
        for part in parts:
            flat = rows[part].astype(np.int64) * self.n + column
            slope[part] = 2.0 * (atoms * r)[flat].sum(axis=1)
        return float((slope @ w - slope.min()) / (a @ a))


def ours(p: Problem) -> tuple[float, Floats]:
    start = time.perf_counter()
    fit = se.fuse(p.ensemble, "alse", target=p.A)
    return time.perf_counter() - start, fit.weights


def clarabel(p: Problem) -> tuple[float, Floats]:
    import clarabel as solver
    from scipy import sparse

    S, d, N = p.sparse(), p.n**2, p.size
    P = sparse.block_diag([sparse.csc_array((N, N)), sparse.eye_array(d)], format="csc")
    rows = sparse.block_array(
        [
            [S, -sparse.eye_array(d)],
            [np.ones((1, N)), None],
            [-sparse.eye_array(N), None],
        ],
        format="csc",
    )
    right = np.concatenate([p.A.ravel(), [1.0], np.zeros(N)])
    cones = [solver.ZeroConeT(d + 1), solver.NonnegativeConeT(N)]
    settings = solver.DefaultSettings()
    settings.verbose = False
    settings.direct_solve_method = "faer"
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    start = time.perf_counter()
    made = solver.DefaultSolver(P, np.zeros(N + d), rows, right, cones, settings)
    solution = made.solve()
    return time.perf_counter() - start, np.asarray(solution.x[:N])


def osqp(p: Problem) -> tuple[float, Floats]:
    import osqp as solver
    from scipy import sparse

    S, d, N = p.sparse(), p.n**2, p.size
    P = sparse.block_diag([sparse.csc_array((N, N)), sparse.eye_array(d)], format="csc")
    rows = sparse.block_array(
        [[S, -sparse.eye_array(d)], [np.ones((1, N)), None], [sparse.eye_array(N), None]],
        format="csc",
    )
    low = np.concatenate([p.A.ravel(), [1.0], np.zeros(N)])
    high = np.concatenate([p.A.ravel(), [1.0], np.full(N, np.inf)])
    start = time.perf_counter()
    made = solver.OSQP()
    made.setup(
        sparse.csc_matrix(P),
        np.zeros(N + d),
        sparse.csc_matrix(rows),
        low,
        high,
        verbose=False,
        eps_abs=1e-9,
        eps_rel=1e-9,
        max_iter=200_000,
    )
    solution = made.solve()
    return time.perf_counter() - start, np.asarray(solution.x[:N])


def piqp(p: Problem) -> tuple[float, Floats]:
    import piqp as solver

    S = p.sparse()
    gram = np.ascontiguousarray((S.T @ S).toarray())
    linear = -np.asarray(S.T @ p.A.ravel())
    N = p.size
    start = time.perf_counter()
    made = solver.DenseSolver()
    made.settings.eps_abs = made.settings.eps_rel = 1e-10
    made.setup(gram, linear, np.ones((1, N)), np.ones(1), x_l=np.zeros(N))
    made.solve()
    return time.perf_counter() - start, np.asarray(made.result.x)


def cvxpy(p: Problem) -> tuple[float, Floats]:
    import cvxpy as cp

    S = p.sparse()
    start = time.perf_counter()
    w = cp.Variable(p.size, nonneg=True)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(S @ w - p.A.ravel())), [cp.sum(w) == 1])
    problem.solve()
    seconds = time.perf_counter() - start
    return seconds, np.zeros(p.size) if w.value is None else np.asarray(w.value)


PEERS: dict[str, Solver] = {"Clarabel": clarabel, "OSQP": osqp, "PIQP": piqp, "CVXPY": cvxpy}


def measure(full: bool) -> list[dict[str, object]]:
    """One row per instance and solver: median of up to 5 runs of ours, one run of the others."""
    table: list[dict[str, object]] = []
    print(f"{'n':>4} {'N':>8}  {'solver':<10} {'seconds':>10} {'gap/|A|^2':>10} {'ratio':>8}")
    for n, size in (*WITH_PEERS, *ALONE):
        p = Problem(n, size)
        ours(p)
        runs = [ours(p) for _ in range(5)]
        mine = statistics.median(seconds for seconds, _ in runs)
        add(table, p, "ours", mine, runs[0][1], None)
        if (n, size) in ALONE:
            continue
        for name, solver in PEERS.items():
            if not full and n >= 100 and size > PATIENCE[name]:
                continue
            if name == "PIQP" and size > 3000:
                continue  # a dense Gram matrix of 800 MB and an hour
            try:
                seconds, weights = solver(p)
            except ImportError:
                print(f"{n:>4} {size:>8}  {name:<10} is not installed")
                continue
            add(table, p, name, seconds, weights, seconds / mine)
    return table


def add(
    table: list[dict[str, object]],
    p: Problem,
    solver: str,
    seconds: float,
    weights: Floats,
    ratio: float | None,
) -> None:
    gap = p.relative_gap(weights)
    table.append({"n": p.n, "N": p.size, "solver": solver, "seconds": seconds, "gap": gap})
    tail = "" if ratio is None else f"{ratio:>7.1f}x"
    print(f"{p.n:>4} {p.size:>8}  {solver:<10} {seconds:>10.2e} {gap:>10.1e} {tail:>8}", flush=True)


def draw(table: list[dict[str, object]], path: Path) -> None:
    """Time against N, one panel per n, one line per solver."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    colours = {
        "ours": "#0072B2",
        "Clarabel": "#D55E00",
        "PIQP": "#009E73",
        "OSQP": "#CC79A7",
        "CVXPY": "#7F7F7F",
    }
    markers = {"ours": "o", "Clarabel": "s", "PIQP": "^", "OSQP": "v", "CVXPY": "D"}
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.8), sharey=True, layout="constrained")
    for axis, n in zip(axes, (30, 100), strict=True):
        for solver, colour in colours.items():
            rows = sorted(
                (r["N"], r["seconds"], r["gap"])
                for r in table
                if r["n"] == n and r["solver"] == solver
            )
            if not rows:
                continue
            sizes, seconds, _ = zip(*rows, strict=True)
            label = "stochens_rs" if solver == "ours" else solver
            width = 2.2 if solver == "ours" else 1.2
            axis.loglog(sizes, seconds, color=colour, lw=width, label=label, zorder=3)
            for N, s, gap in rows:
                face = colour if gap <= 1e-9 else "white"
                # CVXPY calls one of the others: both must be visible where the times agree.
                size, level = (9.0, 3.5) if solver == "CVXPY" else (5.5, 4.0)
                axis.plot(N, s, markers[solver], color=colour, mfc=face, ms=size, zorder=level)
        axis.set_title(f"matrices {n} x {n}", loc="left")
        axis.set_xlabel("realizations N")
        axis.grid(True, which="major", color="0.9")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel("seconds, one thread")
    axes[0].legend(frameon=False, loc="upper left")
    figure.suptitle(
        "ALSE: time to the certified optimum (hollow: gap above 1e-9 of $\\|A\\|^2$)",
        x=0.01,
        ha="left",
    )
    figure.savefig(path, dpi=160)
    plt.close(figure)


def run(full: bool = False) -> None:
    """Measure, print, and write the table and the figure to docs/."""
    se.set_num_threads(1)
    table = measure(full)
    data = DOCS / "data"
    data.mkdir(exist_ok=True)
    (data / "alse.json").write_text(json.dumps(table, indent=1) + "\n")
    draw(table, DOCS / "images" / "alse-time.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="every peer at every size: hours")
    run(parser.parse_args().full)
