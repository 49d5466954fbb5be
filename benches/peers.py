"""One table of speed ratios against NumPy, Numba and CVXPY: same work, same run, one thread.

Every line gives the median over repeated pairs (ours, then theirs) and the smallest and largest
ratio. Ratios can be compared between machines, times cannot.

    python benches/peers.py [name ...] [--write]

Ours is given in seconds per unit of work (a draw, a step, a control, a run, a problem). With
--write the table goes to docs/benchmarks.md and docs/data/benchmarks.json, where groups that were
not measured stay. Ratios more than 1.5
times below the committed ones are always reported.

The group "alse" has its own table (`alse.py`), because the gap of each solver matters as well; the
group "tightness" compares bounds with quantiles (`tightness.py`).
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import alse
import cost
import feedback
import fleet
import identification
import limits
import numpy as np
import study
import table
import tightness
from table import Row

import stochens_rs as se
from stochens_rs import reference
from twin import streaming

Work = Callable[[], object]
# what, peer, ours and its share of the work, theirs and its share
Line = tuple[str, str, Work, float, Work, float]


def timed(work: Work) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def pairs(ours: Work, theirs: Work, budget: float = 4.0) -> tuple[list[float], list[float]]:
    """Seconds of alternating calls, as many as the budget allows: at least 1, at most 15."""
    ours(), theirs()  # the first calls include allocation and compilation
    mine, peer = [], []
    start = time.perf_counter()
    while len(mine) < 15 and (not mine or time.perf_counter() - start < budget):
        mine.append(timed(ours))
        peer.append(timed(theirs))
    return mine, peer


def sampling() -> Iterator[Line]:
    """Table and 2^24 draws, so that building a table of a million entries does not dominate."""
    gen = np.random.default_rng(0)
    size = 1 << 24
    for n in (10, 100, 1000, 1_000_000):
        w = gen.standard_normal(n)
        p = np.abs(w) / np.abs(w).sum()
        if n <= 1000:
            same_on_two_threads(w, 1_000_000)
        yield (
            f"sample a vector, n={n}",
            "Generator.choice",
            lambda w=w: se.sample(w, size, rng=1),
            size,
            lambda n=n, p=p: gen.choice(n, size, p=p),
            size,
        )
    A = gen.standard_normal((100, 100))
    P = np.abs(A) / np.abs(A).sum(axis=0)
    same_on_two_threads(A, 100_000)
    yield (
        "sample a matrix, 100x100",
        "Generator.choice per column",
        lambda: se.sample(A, 10_000, rng=1),
        10_000,
        lambda: np.stack([gen.choice(100, 10_000, p=P[:, j]) for j in range(100)], axis=1),
        10_000,
    )


def same_on_two_threads(target: np.ndarray, size: int) -> None:
    one = se.sample(target, size, rng=1).indices
    se.set_num_threads(2)
    try:
        assert np.array_equal(se.sample(target, size, rng=1).indices, one), "threads change draws"
    finally:
        se.set_num_threads(1)


def closed_form() -> Iterator[Line]:
    w = np.random.default_rng(0).standard_normal(100)
    ensemble = se.sample(w, 100_000, rng=1)
    indices, atoms = ensemble.indices, ensemble.atoms
    yield (
        "ALSE of a vector, n=100, N=1e5",
        "NumPy, same formula",
        lambda: se.fuse(ensemble, "alse", target=w),
        1,
        lambda: reference.fusing.alse_singleton(indices, atoms, w),
        1,
    )


def alse_path() -> Iterator[Line]:
    """Warm starts: all prefixes in one call against one call each."""
    A = np.random.default_rng(1).standard_normal((30, 30))
    ensemble = se.sample(A, 10_000, rng=1)
    sizes = np.unique(np.geomspace(100, 10_000, 20).astype(int))
    prefixes = [ensemble.prefix(int(k)) for k in sizes]
    yield (
        f"ALSE of {sizes.size} prefixes up to N=1e4, 30x30",
        "ours, each from cold",
        lambda: se.fuse_path(ensemble, sizes, "alse", target=A),
        1,
        lambda: [se.fuse(prefix, "alse", target=A) for prefix in prefixes],
        1,
    )


def slse() -> Iterator[Line]:
    for n, size in ((10, 100_000), (100, 20_000), (500, 10_000)):
        A = np.random.default_rng(0).standard_normal((n, n))
        ensemble = se.sample(A, size, rng=1)
        few = 300 if n < 500 else 20
        dense = ensemble.prefix(few).dense()
        yield (
            f"SLSE of a matrix, {n}x{n}",
            "NumPy twin, dense",
            lambda e=ensemble, A=A: se.fuse(e, "slse", target=A),
            ensemble.size,
            lambda d=dense, A=A: reference.fusing.slse(d, A),
            few,
        )
        jitted = numba_slse()
        if jitted is not None:
            atoms = np.ascontiguousarray(ensemble.atoms)
            for width in (
                np.int64,
                ensemble.indices.dtype,
            ):  # NumPy's index type; the narrow type of the ensemble
                indices = np.ascontiguousarray(ensemble.indices, dtype=width)
                ours = se.fuse(ensemble, "slse", target=A).error
                theirs = jitted(indices, atoms, A)
                assert abs(ours - theirs) <= 1e-6 * np.linalg.norm(A), "not the same work"
                yield (
                    f"SLSE of a matrix, {n}x{n}",
                    f"Numba, O(n), {np.dtype(width).name}",
                    lambda e=ensemble, A=A: se.fuse(e, "slse", target=A),
                    ensemble.size,
                    lambda run=jitted, i=indices, a=atoms, A=A: run(i, a, A),
                    ensemble.size,
                )


def numba_slse() -> Callable[..., float] | None:
    """SLSE with the same O(n) update and a refresh every 256 steps, compiled by Numba."""
    try:
        import numba
    except ImportError:
        return None

    @numba.njit(fastmath=False)
    def run(indices: np.ndarray, atoms: np.ndarray, A: np.ndarray) -> float:
        size, lines = indices.shape
        F = np.zeros_like(A)
        c, fa, ff, _aa, ee = 1.0, 0.0, 0.0, np.sum(A * A), 0.0
        for j in range(lines):
            ee += np.max(np.abs(atoms[:, j])) ** 2
        for s in range(size):
            fe, ae = 0.0, 0.0
            for j in range(lines):
                r = indices[s, j]
                fe += F[r, j] * atoms[r, j]
                ae += A[r, j] * atoms[r, j]
            fe *= c
            if s == 0:
                t = 1.0
            else:
                den = ff - 2 * fe + ee
                t = min(max((ae - fa - fe + ff) / den, 0.0), 1.0) if den > 0 else 0.0
            u = 1.0 - t
            ff = u * u * ff + 2 * u * t * fe + t * t * ee
            fa = u * fa + t * ae
            if u == 0.0:
                F[:] = 0.0
                c = 1.0
            else:
                c *= u
            for j in range(lines):
                r = indices[s, j]
                F[r, j] += t / c * atoms[r, j]
            if s % 256 == 255:
                F *= c
                c = 1.0
                ff = np.sum(F * F)
                fa = np.sum(F * A)
        return np.sqrt(np.sum((c * F - A) ** 2))

    return run


def stream() -> Iterator[Line]:
    """Steps of the sequential algorithm; the trace and the refreshes are in ours only."""
    for n, steps, few in ((10, 1_000_000, 3000), (100, 200_000, 1000), (1000, 10_000, 30)):
        gen = np.random.default_rng(0)
        A = gen.standard_normal((n, n)) / np.sqrt(n)
        B = gen.standard_normal((n, n // 2))
        x0, xf = gen.standard_normal(n), gen.standard_normal(n)
        key = se.Key(bytes(32))
        keys = [bytes(key.child(name)) for name in ("x0", "xf", "A", "slots")]
        ours = se.Stream((A, B), x0, xf, rng=key)
        if n <= 100:
            # the twin draws first, in a small part of its time
            yield (
                f"stream, n={n}, m={n // 2}",
                "NumPy twin",
                lambda s=ours, k=steps: s.step(k),
                steps,
                lambda a=(B, x0, xf, A), k=few, q=keys: streaming.stream(*a, keys=q, steps=k),
                few,
            )
        jitted = numba_stream()
        if jitted is None:
            continue
        tables = [alias_arrays(w) for w in (x0, xf, A)]
        flat = [array for table in tables for array in table]
        if n == 10:
            z = xf - A @ x0
            off = jitted(A, x0, xf, *flat, steps, 1) - z
            assert np.linalg.norm(off) < 1e-2 * np.linalg.norm(z), "not the same work"
        yield (
            f"stream, n={n}, m={n // 2}",
            "Numba, same O(n) step",
            lambda s=ours, k=steps: s.step(k),
            steps,
            lambda run=jitted, a=(A, x0, xf, *flat), k=steps: run(*a, k, 1),
            steps,
        )


def alias_arrays(target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Thresholds and aliases of every column, (columns, cells)."""
    columns = np.atleast_2d(target.T) if target.ndim > 1 else target[None, :]
    made = [reference.streams.alias_table(column) for column in columns]
    thresholds = np.array([table.threshold for table in made], dtype=np.float64) / 2.0**32
    return thresholds, np.array([table.alias for table in made], dtype=np.int32)


def numba_stream() -> Callable[..., np.ndarray] | None:
    """The same O(n) step with lazily scaled estimates and alias tables, compiled by Numba."""
    try:
        import numba
    except ImportError:
        return None

    @numba.njit(fastmath=False)
    def vector_step(
        F: np.ndarray,
        g: float,
        w: np.ndarray,
        table: np.ndarray,
        alias: np.ndarray,
        ff: float,
        fa: float,
    ) -> tuple[float, int, float, float, float]:
        i = np.random.randint(len(table))  # noqa: NPY002 (Numba's own generator)
        if np.random.random() >= table[i]:  # noqa: NPY002
            i = alias[i]
        e = g * np.sign(w[i])
        fe, ae = F[i] * e, w[i] * e
        den = ff - 2.0 * fe + e * e
        t = min(max((ae - fa - fe + ff) / den, 0.0), 1.0) if den > 0.0 else 0.0
        if t > 0.0:
            u = 1.0 - t
            for k in range(len(F)):
                F[k] *= u
            F[i] += t * e
            ff, fa = u * u * ff + 2.0 * u * t * fe + t * t * e * e, u * fa + t * ae
        return t, i, e, ff, fa

    @numba.njit(fastmath=False)
    def run(
        A: np.ndarray,
        x0: np.ndarray,
        xf: np.ndarray,
        t0: np.ndarray,
        a0: np.ndarray,
        tf: np.ndarray,
        af: np.ndarray,
        tA: np.ndarray,
        aA: np.ndarray,
        steps: int,
        seed: int,
    ) -> np.ndarray:
        np.random.seed(seed)  # noqa: NPY002 (Numba's own generator)
        n = len(x0)
        gA = np.array([np.sum(np.abs(A[:, j])) for j in range(n)])
        AT = np.ascontiguousarray(A.T)
        g0, gf = np.sum(np.abs(x0)), np.sum(np.abs(xf))
        eeA = np.sum(gA * gA)
        F0, Ff, FA, y = np.zeros(n), np.zeros(n), np.zeros((n, n)), np.zeros(n)
        R = np.empty(n, np.int64)
        i0 = np.argmax(np.abs(x0))
        F0[i0] = g0 * np.sign(x0[i0])
        jf = np.argmax(np.abs(xf))
        Ff[jf] = gf * np.sign(xf[jf])
        for j in range(n):
            r = np.argmax(np.abs(AT[j]))
            FA[j, r] = gA[j] * np.sign(AT[j, r])
            y[r] += FA[j, r] * F0[j]
        c = 1.0
        ff0, fa0, fff, faf = np.sum(F0 * F0), np.sum(F0 * x0), np.sum(Ff * Ff), np.sum(Ff * xf)
        ffA, faA = np.sum(FA * FA), np.sum(FA * AT)
        cellsA = tA.shape[1]
        for s in range(steps):
            slot = np.random.randint(3)  # noqa: NPY002
            if slot == 0:
                t, i, e, ff0, fa0 = vector_step(F0, g0, x0, t0[0], a0[0], ff0, fa0)
                if t > 0.0:
                    d = t * e * c
                    for k in range(n):
                        y[k] = (1.0 - t) * y[k] + d * FA[i, k]
            elif slot == 1:
                t, i, e, fff, faf = vector_step(Ff, gf, xf, tf[0], af[0], fff, faf)
            else:
                fe, ae = 0.0, 0.0
                for j in range(n):
                    i = np.random.randint(cellsA)  # noqa: NPY002
                    if np.random.random() >= tA[j, i]:  # noqa: NPY002
                        i = aA[j, i]
                    R[j] = i
                    e = gA[j] * np.sign(AT[j, i])
                    fe += FA[j, i] * e
                    ae += AT[j, i] * e
                fe *= c
                den = ffA - 2.0 * fe + eeA
                t = min(max((ae - faA - fe + ffA) / den, 0.0), 1.0) if den > 0.0 else 0.0
                if t > 0.0:
                    u = 1.0 - t
                    ffA = u * u * ffA + 2.0 * u * t * fe + t * t * eeA
                    faA = u * faA + t * ae
                    c *= u
                    for k in range(n):
                        y[k] *= u
                    for j in range(n):
                        e = t * gA[j] * np.sign(AT[j, R[j]])
                        FA[j, R[j]] += e / c
                        y[R[j]] += e * F0[j]
            if s % (16 * n) == 16 * n - 1:
                FA *= c
                c = 1.0
                ffA, faA = np.sum(FA * FA), np.sum(FA * AT)
                ff0, fa0 = np.sum(F0 * F0), np.sum(F0 * x0)
                fff, faf = np.sum(Ff * Ff), np.sum(Ff * xf)
        return Ff - y

    return run


def controls() -> Iterator[Line]:
    """Into memory that was used before; `fresh`: into a new array each time.

    The peers compute the pseudoinverse of B as well, except `out.fill`.
    """
    gen = np.random.default_rng(0)
    for n, m, size in (
        (10, 2, 4_000_000),
        (10, 8, 2_000_000),
        (100, 10, 2_000_000),
        (100, 100, 400_000),
    ):
        A, B = gen.standard_normal((n, n)), gen.standard_normal((n, m))
        x0 = se.sample(gen.standard_normal(n), size, rng=1)
        xf = se.sample(gen.standard_normal(n), size, rng=2)
        EA = se.sample(A, size, rng=3)
        # of NumPy's index type and the narrow type, the one that is faster for NumPy
        i0, iF, iA = x0.indices.astype(np.intp), xf.indices.astype(np.intp), EA.indices
        out, theirs, y = np.zeros((size, m)), np.zeros((size, m)), gen.standard_normal((size, n))

        def fancy(i0=i0, iF=iF, iA=iA, x0=x0, xf=xf, EA=EA, B=B) -> np.ndarray:
            PT = np.ascontiguousarray(np.linalg.pinv(B).T)
            column = i0[:, 0]
            row = np.take_along_axis(iA, i0, axis=1)[:, 0]
            scale = EA.atoms[row, column] * x0.atoms[column]
            return xf.atoms[iF[:, 0], None] * PT[iF[:, 0]] - scale[:, None] * PT[row]

        def fresh(B=B, x0=x0, xf=xf, EA=EA) -> np.ndarray:
            return se.realization_controls((EA, B), x0, xf)

        def ours(B=B, x0=x0, xf=xf, EA=EA, out=out) -> np.ndarray:
            return se.realization_controls((EA, B), x0, xf, out=out)

        def product(y=y, B=B, theirs=theirs) -> np.ndarray:
            return np.matmul(y, np.ascontiguousarray(np.linalg.pinv(B).T), out=theirs)

        assert np.allclose(fancy(), ours())
        what = f"controls, n={n} m={m}"
        yield what, "NumPy fancy indexing", ours, size, fancy, size
        yield f"{what}, fresh", "NumPy fancy indexing", fresh, size, fancy, size
        yield what, "NumPy GEMM, out=", ours, size, product, size
        # share of the store bandwidth; above one for stores past the caches
        yield what, "store bandwidth, out.fill", ours, size, lambda out=theirs: out.fill(1.0), size
    for n, m in ((10, 5), (30, 10), (100, 20), (300, 30)):
        size = 8_000_000 // (n * n)
        B = gen.standard_normal((n, m))
        samples = [gen.standard_normal((size, *shape)) for shape in ((n,), (n,), (n, n))]
        x0, xf, EA = (se.Ensemble.from_samples(values) for values in samples)
        out, result = np.zeros((size, m)), np.zeros((size, m))

        def ours(B=B, x0=x0, xf=xf, EA=EA, out=out) -> np.ndarray:
            return se.realization_controls((EA, B), x0, xf, out=out)

        def batched(samples=samples, B=B, out=result) -> np.ndarray:
            x0, xf, A = samples
            PT = np.linalg.pinv(B).T
            return np.matmul(xf - np.matmul(A, x0[:, :, None])[:, :, 0], PT, out=out)

        assert np.allclose(batched(), ours())
        yield f"controls, dense, n={n} m={m}", "NumPy matmul, all of it", ours, size, batched, size


def slse_replicates() -> Iterator[Line]:
    """Independent ensembles on two threads against one."""
    A = np.random.default_rng(0).standard_normal((30, 30))
    ensembles = [se.sample(A, 5_000, rng=seed) for seed in range(16)]

    def work(threads: int) -> list[float]:
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(lambda e: se.fuse(e, "slse", target=A).error, ensembles))

    assert work(1) == work(2)
    yield (
        "SLSE of 16 replicates, 2 threads",
        "ours, 1 thread",
        lambda: work(2),
        1,
        lambda: work(1),
        1,
    )


def simulate() -> Iterator[Line]:
    """1e5 runs of 10 steps, n = 100; the peers do fewer runs, each of them the same work."""
    gen = np.random.default_rng(0)
    n, K, size = 100, 10, 100_000
    twin_runs, single, few = 96, 3, 2_000
    A = gen.standard_normal((n, n))
    A /= np.abs(np.linalg.eigvals(A)).max()
    x0 = gen.standard_normal(n)
    cases = (("m=10", 10, 1.0), ("m=100", 100, 1.0), ("no input", 1, 0.0))
    for name, m, strength in cases:
        B, u = gen.standard_normal((n, m)), strength * gen.standard_normal((K, m))

        def ours(B=B, u=u) -> np.ndarray:
            return se.simulate_ensemble((A, B), x0, u, size, rng=1).mean

        yield (
            f"simulate, n=100 {name}, K=10",
            "NumPy twin, 32 runs at a time",
            ours,
            size,
            lambda B=B, u=u: reference.simulation.simulate_runs(
                A, B, x0, u, twin_runs, key=bytes(32)
            ),
            twin_runs,
        )
        yield (
            f"simulate, n=100 {name}, K=10",
            "NumPy, run by run",
            ours,
            size,
            lambda B=B, u=u: run_by_run(A, B, u, x0, single, gen),
            single,
        )
        yield (
            f"simulate, n=100 {name}, K=10",
            "NumPy, all runs at once",
            ours,
            size,
            lambda B=B, u=u: runs_at_once(A, B, u, x0, few, gen),
            few,
        )
    yield from track()


def track() -> Iterator[Line]:
    """A closed loop, 50 runs of 100 steps; the peer does one run, with NumPy's multinomial."""
    system, gen = se.cases.ieee39(), np.random.default_rng(0)
    u, x0 = 0.1 * gen.standard_normal((100, system.m)), 0.1 * gen.standard_normal(system.n)
    r = reference.simulation.simulate(system.A, system.B, x0, u)

    def estimate(target: np.ndarray, key: bytes) -> np.ndarray:
        return reference.simulation.average(target, 10_000, gen)

    yield (
        f"track, n={system.n} m={system.m}, K=100",
        "NumPy twin, run by run",
        lambda: se.track(system, r, 10_000, rng=1, runs=50),
        50,
        lambda: reference.simulation.track(system.A, system.B, r, x0, estimate, key=bytes(32)),
        1,
    )


def run_by_run(A, B, u, x0, size, gen) -> np.ndarray:
    """By the definition: a realization of A and B for every run and step."""

    def realization(M: np.ndarray) -> np.ndarray:
        g, E = np.abs(M).sum(axis=0), np.zeros_like(M)
        for j in range(M.shape[1]):
            i = gen.choice(len(M), p=np.abs(M[:, j]) / g[j])
            E[i, j] = g[j] * np.sign(M[i, j])
        return E

    states = np.empty((size, len(u) + 1, len(x0)))
    for s in range(size):
        states[s, 0] = realization(x0[:, None])[:, 0]
        for k, u_k in enumerate(u):
            states[s, k + 1] = realization(A) @ states[s, k] + realization(B) @ u_k
    return states.mean(axis=0)


def runs_at_once(A, B, u, x0, size, gen) -> np.ndarray:
    """All runs as one array: a `choice` and a scatter for every step and column that can matter."""
    rows = np.arange(size)

    def add(M: np.ndarray, values: np.ndarray, out: np.ndarray) -> None:
        g = np.abs(M).sum(axis=0)
        for j in np.flatnonzero(np.any(values, axis=0)):
            i = gen.choice(len(M), size, p=np.abs(M[:, j]) / g[j])
            out[rows, i] += values[:, j] * (g[j] * np.sign(M[i, j]))

    x = np.zeros((size, len(x0)))
    add(x0[:, None], np.ones((size, 1)), x)
    means = [x.mean(axis=0)]
    for u_k in u:
        after = np.zeros_like(x)
        add(A, x, after)
        add(B, np.broadcast_to(u_k, (size, len(u_k))), after)
        x = after
        means.append(x.mean(axis=0))
    return np.array(means)


def reproduce() -> Iterator[Line]:
    """A part of the experiments: all four methods, both entities, 5 sizes, 1 replicate."""
    try:
        import cvxpy as cp
    except ImportError:
        return
    cases = {
        "power": (se.cases.ieee14().A, (10, 30, 100, 300, 1000)),
        "tracking": (se.cases.random_system(100, 80, rng=1).A, (100, 200)),
    }
    for name, (A, sizes) in cases.items():
        x0 = np.random.default_rng(2).standard_normal(A.shape[0])

        def ours(A=A, x0=x0, sizes=sizes) -> None:
            for target in (x0, A):
                ensemble = se.sample(target, sizes[-1], rng=3)
                for method in ("uniform", "alse", "slse", "slse-safeguarded"):
                    se.fuse_path(ensemble, sizes, method, target=target)

        def theirs(A=A, x0=x0, sizes=sizes) -> None:
            gen = np.random.default_rng(3)
            for target in (x0, A):
                matrix = target.reshape(len(target), -1)
                g = np.abs(matrix).sum(axis=0)
                N = sizes[-1]
                E = np.zeros((N, *matrix.shape))
                for j in range(matrix.shape[1]):
                    r = gen.choice(len(matrix), N, p=np.abs(matrix[:, j]) / g[j])
                    E[np.arange(N), r, j] = g[j] * np.sign(matrix[r, j])
                for k in sizes:
                    np.linalg.norm(E[:k].mean(axis=0) - matrix)
                    S = E[:k].reshape(k, -1).T
                    w = cp.Variable(k, nonneg=True)
                    objective = cp.Minimize(cp.sum_squares(S @ w - matrix.ravel()))
                    cp.Problem(objective, [cp.sum(w) == 1]).solve(solver=cp.CLARABEL)
                reference.fusing.slse(E, matrix)
                reference.fusing.slse_safeguarded(E, matrix)

        yield (
            f"{name}: all methods, N up to {sizes[-1]} ({len(sizes)} sizes)",
            "NumPy + CVXPY (Clarabel)",
            ours,
            1,
            theirs,
            1,
        )


GROUPS = {
    f.__name__: f
    for f in (
        *(sampling, closed_form, alse_path, slse, slse_replicates, stream),
        *(controls, simulate, reproduce, limits.limits, identification.identification),
        *(identification.certificates, feedback.feedback, fleet.fleets, study.studies),
    )
}


def measure(group: str) -> list[Row]:
    """Run one group and print it."""
    rows = []
    for what, peer, ours, share, theirs, their_share in GROUPS[group]():
        mine, others = pairs(ours, theirs, 20.0 if group == "sampling" else 4.0)
        ratios = [(b / their_share) / (a / share) for a, b in zip(mine, others, strict=True)]
        row = Row(
            group=group,
            what=what,
            peer=peer,
            seconds=statistics.median(mine) / share,
            ratio=statistics.median(ratios),
            low=min(ratios),
            high=max(ratios),
            pairs=len(ratios),
            processor=table.machine()["processor"],
        )
        rows.append(row)
        print(
            f"{what:<48} {peer:<28} {row.seconds:>9.2e}s {row.ratio:>8.2f}x"
            f"   ({row.low:.2f} .. {row.high:.2f})",
            flush=True,
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = [*GROUPS, "cost", "alse", "tightness"]
    parser.add_argument("group", nargs="*", help=f"of {', '.join(names)}; all by default")
    parser.add_argument("--full", action="store_true", help="alse: every peer at every size")
    parser.add_argument("--write", action="store_true", help="write docs/benchmarks.md")
    arguments = parser.parse_args()
    chosen = arguments.group or names
    unknown = sorted(set(chosen) - set(names))
    if unknown:
        sys.exit(f"unknown group {unknown[0]!r}: choose from {', '.join(names)}")
    se.set_num_threads(1)
    before = table.committed()
    slower: list[str] = []
    print(f"{'work':<48} {'peer':<28} {'ours':>10} {'ratio':>9}   (min .. max)")
    for group in chosen:
        rows = measure(group) if group in GROUPS else []
        costs = cost.run() if group == "cost" else None
        if group == "alse":
            alse.run(arguments.full)
        if group == "tightness":
            tightness.run()
        slower += table.regressions(rows, before)
        if arguments.write:  # after each, so that a failure loses nothing that was measured
            table.write(rows, costs)
    for line in slower:
        print(f"SLOWER THAN THE COMMITTED TABLE: {line}")


if __name__ == "__main__":
    main()
