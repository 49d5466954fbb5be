"""One table of speed ratios against NumPy, Numba and CVXPY: same work, same run, one thread.

Every line gives the median over repeated pairs (ours, then theirs) and the smallest and largest
ratio seen. Ratios travel between machines, times do not.

    python benches/peers.py [name ...]

The group "alse" has a table of its own (`alse.py`): there the gap a solver reaches counts as well.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import alse
import numpy as np

import stochens_rs as se
from stochens_rs import reference

Work = Callable[[], object]
# what, peer, ours and its share of the work, theirs and its share
Line = tuple[str, str, Work, float, Work, float]


def timed(work: Work) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def pairs(ours: Work, theirs: Work, budget: float = 4.0) -> tuple[list[float], list[float]]:
    """Seconds of alternating calls, as many as the budget allows: at least 1, at most 7."""
    ours(), theirs()  # first calls pay for memory and compilation
    mine, peer = [], []
    start = time.perf_counter()
    while len(mine) < 7 and (not mine or time.perf_counter() - start < budget):
        mine.append(timed(ours))
        peer.append(timed(theirs))
    return mine, peer


def sampling() -> Iterator[Line]:
    gen = np.random.default_rng(0)
    size = 1_000_000
    for n in (10, 100, 1000):
        w = gen.standard_normal(n)
        p = np.abs(w) / np.abs(w).sum()
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
    yield (
        "sample a matrix, 100x100",
        "Generator.choice per column",
        lambda: se.sample(A, 10_000, rng=1),
        10_000,
        lambda: np.stack([gen.choice(100, 10_000, p=P[:, j]) for j in range(100)], axis=1),
        10_000,
    )


def closed_form() -> Iterator[Line]:
    w = np.random.default_rng(0).standard_normal(100)
    ensemble = se.sample(w, 100_000, rng=1)
    indices, atoms = ensemble.indices, ensemble.atoms
    yield (
        "ALSE of a vector, n=100, N=1e5",
        "NumPy, same formula",
        lambda: se.fuse(ensemble, "alse", target=w),
        1,
        lambda: reference.alse_singleton(indices, atoms, w),
        1,
    )


def alse_path() -> Iterator[Line]:
    """Warm starts: the whole grid against the same prefixes solved one by one."""
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
            lambda d=dense, A=A: reference.slse(d, A),
            few,
        )
        jitted = numba_slse()
        if jitted is not None:
            atoms = np.ascontiguousarray(ensemble.atoms)
            for width in (
                np.int64,
                ensemble.indices.dtype,
            ):  # what NumPy indexes with; what we have
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


def controls() -> Iterator[Line]:
    """Into memory that was used before, where nothing is said; `fresh` is a new array each time."""
    gen = np.random.default_rng(0)
    for n, m, size in (
        (10, 2, 2_000_000),
        (10, 8, 500_000),
        (100, 10, 200_000),
        (100, 100, 50_000),
    ):
        A, B = gen.standard_normal((n, n)), gen.standard_normal((n, m))
        x0 = se.sample(gen.standard_normal(n), size, rng=1)
        xf = se.sample(gen.standard_normal(n), size, rng=2)
        EA = se.sample(A, size, rng=3)
        i0, iF, iA = (e.indices.astype(np.intp) for e in (x0, xf, EA))
        PT = np.ascontiguousarray(np.linalg.pinv(B).T)
        out, theirs, y = np.zeros((size, m)), np.zeros((size, m)), gen.standard_normal((size, n))

        def fancy(i0=i0, iF=iF, iA=iA, x0=x0, xf=xf, EA=EA, PT=PT) -> np.ndarray:
            column = i0[:, 0]
            row = np.take_along_axis(iA, i0, axis=1)[:, 0]
            scale = EA.atoms[row, column] * x0.atoms[column]
            return xf.atoms[iF[:, 0], None] * PT[iF[:, 0]] - scale[:, None] * PT[row]

        def fresh(B=B, x0=x0, xf=xf, EA=EA) -> np.ndarray:
            return se.realization_controls(B, x0, xf, EA)

        def ours(B=B, x0=x0, xf=xf, EA=EA, out=out) -> np.ndarray:
            return se.realization_controls(B, x0, xf, EA, out=out)

        def product(y=y, PT=PT, theirs=theirs) -> np.ndarray:
            return np.matmul(y, PT, out=theirs)

        assert np.allclose(fancy(), ours())
        what = f"controls, n={n} m={m}"
        yield what, "NumPy fancy indexing", ours, size, fancy, size
        yield f"{what}, fresh", "NumPy fancy indexing", fresh, size, fancy, size
        yield what, "NumPy GEMM, out=", ours, size, product, size
        # a ratio below one: the share of the bandwidth of stores that is reached
        yield what, "store bandwidth, out.fill", ours, size, lambda out=theirs: out.fill(1.0), size
    for n, m in ((10, 5), (30, 10), (100, 20), (300, 30)):
        size = 8_000_000 // (n * n)
        B = gen.standard_normal((n, m))
        samples = [gen.standard_normal((size, *shape)) for shape in ((n,), (n,), (n, n))]
        x0, xf, EA = (se.Ensemble.from_samples(values) for values in samples)
        P, out, result = np.linalg.pinv(B), np.zeros((size, m)), np.zeros((size, m))

        def ours(B=B, x0=x0, xf=xf, EA=EA, out=out) -> np.ndarray:
            return se.realization_controls(B, x0, xf, EA, out=out)

        def batched(samples=samples, P=P, out=result) -> np.ndarray:
            x0, xf, A = samples
            return np.matmul(xf - np.matmul(A, x0[:, :, None])[:, :, 0], P.T, out=out)

        assert np.allclose(batched(), ours())
        yield f"controls, dense, n={n} m={m}", "NumPy matmul, all of it", ours, size, batched, size


def slse_replicates() -> Iterator[Line]:
    """Threads over ensembles, the unit of work of an experiment: two threads against one."""
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


def reproduce() -> Iterator[Line]:
    """A stated subset of the experiments: all four methods, both entities, 5 sizes, 1 replicate."""
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
                reference.slse(E, matrix)
                reference.slse_safeguarded(E, matrix)

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
    for f in (sampling, closed_form, alse_path, slse, slse_replicates, controls, reproduce)
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = [*GROUPS, "alse"]
    parser.add_argument("group", nargs="*", help=f"of {', '.join(names)}; all by default")
    parser.add_argument("--full", action="store_true", help="alse: every peer at every size")
    arguments = parser.parse_args()
    chosen = arguments.group or names
    unknown = sorted(set(chosen) - set(names))
    if unknown:
        sys.exit(f"unknown group {unknown[0]!r}: choose from {', '.join(names)}")
    se.set_num_threads(1)
    print(f"{'work':<48} {'peer':<28} {'ours':>10} {'theirs':>10} {'ratio':>8}   (min .. max)")
    for group in chosen:
        if group == "alse":
            alse.run(arguments.full)
            continue
        for what, peer, ours, share, theirs, their_share in GROUPS[group]():
            mine, others = pairs(ours, theirs)
            ratios = [(b / their_share) / (a / share) for a, b in zip(mine, others, strict=True)]
            print(
                f"{what:<48} {peer:<28} {statistics.median(mine):>9.2e}s "
                f"{statistics.median(others):>9.2e}s {statistics.median(ratios):>7.2f}x"
                f"   ({min(ratios):.2f} .. {max(ratios):.2f})",
                flush=True,
            )


if __name__ == "__main__":
    main()
