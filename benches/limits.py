"""Controls within limits against solvers of quadratic programs: same run, one thread.

Times include each solver's Python interface. The gap of every answer is recomputed here from
``M``, ``y`` and the clipped answer, divided by ``J(0)``: the smaller of the Frank-Wolfe gap and
of the dual residual in the norm of ``H^-1``, each an upper bound of ``J(u) - min J``. In single,
all start from ``M``, ``y`` and ``R``: NumPy computes ``H = M'M + R`` and ``f = -M'y`` for the
peers inside the timed part.

- DAQP: bounds only, warm where the problem is a sequence; PIQP dense (sparse for K = 200); OSQP
  (1e-6, polished); Clarabel; SciPy's ``lsq_linear`` (bvls).

    python benches/limits.py [single] [ill] [batch] [regulator] [horizon]

`limits` is the short form for `peers.py`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from stochens_rs import _core as core
from stochens_rs.limits.problem import Task

Floats = NDArray[np.float64]
WEIGHT = 0.1  # of the inputs, where the states have 1
Solve = Callable[[], Floats]
Line = tuple[str, str, Callable[[], object], float, Callable[[], object], float]


def problem(gen: np.random.Generator, d: int, condition: float) -> tuple[Floats, Floats]:
    """``M`` (d, d) with singular values from 1 to 1/condition, ``y`` (d,)."""
    U, V = (np.linalg.qr(gen.standard_normal((d, d)))[0] for _ in range(2))
    return np.ascontiguousarray(U * np.geomspace(1, 1 / condition, d) @ V), gen.standard_normal(d)


def limit_of(M: Floats, y: Floats, share: str) -> float:
    size = np.abs(np.linalg.solve(M, y))
    return float({"half": np.median(size), "all": 1e-3 * size.min(), "none": 2 * size.max()}[share])


def gap(M: Floats, y: Floats, r: Floats, low: Floats, high: Floats, u: Floats) -> float:
    """Upper bound of ``(J(u) - min J) / J(0)``; in extended precision where the machine has it."""
    wide = np.longdouble
    u = np.clip(np.nan_to_num(u), low, high).astype(wide)
    g = M.T.astype(wide) @ (M.astype(wide) @ u - y) + r * u
    with np.errstate(invalid="ignore"):
        frank_wolfe = 2 * np.where(g > 0, g * (u - low), np.where(g < 0, g * (u - high), 0)).sum()
    at_limit = ((u <= low) & (g >= 0)) | ((u >= high) & (g <= 0))
    e = np.where(at_limit, 0, g).astype(float)
    R = np.linalg.qr(np.vstack([M, np.diag(np.sqrt(r))]), mode="r")
    dual = np.sum(np.linalg.solve(R.T, e) ** 2)
    return float(min(frank_wolfe, dual) / (y @ y))


def median(work: Callable[[], object], seconds: float = 0.3, least: int = 5) -> float:
    work()
    times: list[float] = []
    begin = time.perf_counter()
    while len(times) < least or (time.perf_counter() - begin < seconds and len(times) < 2000):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def hessian(M: Floats, y: Floats, r: Floats) -> tuple[Floats, Floats]:
    H = M.T @ M
    H.flat[:: len(r) + 1] += r
    return H, -(M.T @ y)


def peers(low: Floats, high: Floats) -> dict[str, Callable[[Floats, Floats], Floats]]:
    """Solvers of ``u' H u / 2 + f' u`` within limits."""
    import clarabel
    import daqp
    import osqp
    import piqp
    from scipy import sparse

    d = len(low)
    none, sense = np.zeros((0, d)), np.zeros(d, dtype=np.int32)
    eye = sparse.eye(d, format="csc")
    rows = sparse.vstack([eye, -eye], format="csc")
    right = np.concatenate([high, -low])

    def by_daqp(H: Floats, f: Floats) -> Floats:
        return daqp.solve(H, f, none, high, low, sense)[0]

    def by_piqp(H: Floats, f: Floats) -> Floats:
        solver = piqp.DenseSolver()
        solver.setup(H, f, x_l=low, x_u=high)
        solver.solve()
        return solver.result.x

    def by_osqp(H: Floats, f: Floats) -> Floats:
        upper, solver = sparse.csc_matrix(np.triu(H)), osqp.OSQP()
        solver.setup(
            upper, f, eye, low, high, verbose=False, polishing=True, eps_abs=1e-6, eps_rel=1e-6
        )
        return solver.solve().x

    def by_clarabel(H: Floats, f: Floats) -> Floats:
        upper, settings = sparse.csc_matrix(np.triu(H)), clarabel.DefaultSettings()
        settings.verbose, settings.max_threads = False, 1
        cones = [clarabel.NonnegativeConeT(2 * d)]
        return np.asarray(clarabel.DefaultSolver(upper, f, rows, right, cones, settings).solve().x)

    found = {"DAQP": by_daqp, "PIQP": by_piqp}
    return found | ({"OSQP": by_osqp, "Clarabel": by_clarabel} if d <= 200 else {})


def single() -> None:
    gen = np.random.default_rng(0)
    print("single, cold: us (worst relative gap of 5 draws); ratios are times over ours")
    for share in ("half", "all", "none"):
        for d in (5, 20, 50, 100, 200, 500):
            draws = [problem(gen, d, 1e2) for _ in range(5 if d < 500 else 2)]
            r, lines = np.zeros(d), []
            for M, y in draws:
                limit = limit_of(M, y, share)
                low, high = np.full(d, -limit), np.full(d, limit)
                lines.append(
                    {
                        name: (median(work, 0.05), gap(M, y, r, low, high, work()))
                        for name, work in solvers(M, y, r, low, high).items()
                    }
                )
            parts = []
            for name in lines[0]:
                own = np.median([line["ours"][0] for line in lines])
                seconds = np.median([line[name][0] for line in lines])
                worst = max(line[name][1] for line in lines)
                parts.append(f"{name} {1e6 * seconds:.1f} ({worst:.0e}) {seconds / own:.1f}x")
            print(f"LS {share:<5} d={d:<4}", "; ".join(parts), flush=True)


def solvers(M: Floats, y: Floats, r: Floats, low: Floats, high: Floats) -> dict[str, Solve]:
    from scipy import optimize

    found: dict[str, Solve] = {
        "ours": lambda: core.box_control(M, y, r, low, high, None, None).control
    }
    for name, solve in peers(low, high).items():
        found[name] = lambda solve=solve: solve(*hessian(M, y, r))
    if len(low) <= 50:
        found["bvls"] = lambda: optimize.lsq_linear(M, y, (low, high), method="bvls").x
    return found


def ill() -> None:
    import daqp

    print("500 draws a line: worst gap / J(0), ours; share of DAQP above 1e-4 with exit flag 1")
    gen = np.random.default_rng(1)
    for condition in (1e1, 1e3, 1e6):
        for d in (5, 20):
            worst, bad, times = 0.0, 0, []
            for _ in range(500):
                M, y = problem(gen, d, condition)
                limit = limit_of(M, y, "half")
                r, low, high = np.zeros(d), np.full(d, -limit), np.full(d, limit)
                start = time.perf_counter()
                found = core.box_control(M, y, r, low, high, None, None)
                times.append(time.perf_counter() - start)
                worst = max(worst, gap(M, y, r, low, high, found.control))
                none, sense = np.zeros((0, d)), np.zeros(d, dtype=np.int32)
                u, _, flag, _ = daqp.solve(M.T @ M, -(M.T @ y), none, high, low, sense)
                bad += flag == 1 and gap(M, y, r, low, high, u) > 1e-4
            print(
                f"cond {condition:.0e} d={d}: ours {worst:.0e}, "
                f"{1e6 * np.median(times):.1f} us; DAQP {bad / 5:.1f} %",
                flush=True,
            )


def limits() -> Iterator[Line]:
    """Single problems, batches, a loop and long horizons against the fastest peers of each kind."""
    gen = np.random.default_rng(0)
    for d in (5, 20, 100):
        M, y = problem(gen, d, 1e2)
        limit = limit_of(M, y, "half")
        low, high = np.full(d, -limit), np.full(d, limit)
        found = solvers(M, y, np.zeros(d), low, high)
        for name in ("DAQP", "PIQP", "OSQP", "Clarabel"):
            assert gap(M, y, np.zeros(d), low, high, found["ours"]()) < 1e-9
            work = (repeated(found[one], 2000 // d) for one in ("ours", name))
            yield f"least squares within limits, d={d}", name, *both(work, 2000 // d)
    for m, size in ((2, 1_000_000), (5, 1_000_000), (20, 50_000)):
        ours, _, theirs = batches(gen, m, size)
        assert np.allclose(ours()[:2000], theirs(), atol=1e-6)
        yield f"a batch within limits, m={m}", "DAQP, one by one", ours, size, theirs, 2000
    loops, A, B = receding(0.3)
    noise = 0.3 * np.random.default_rng(3).standard_normal((300, len(A)))

    def ride(name: str) -> None:
        x = 2 * np.ones(len(A))
        for w in noise:
            x = A @ x + B @ loops[name](x)[: B.shape[1]] + w

    for name in ("DAQP warm", "PIQP"):
        work = (lambda name=name: ride(name) for name in ("ours", name))
        yield "a call of a loop, n=10 m=5 K=20", name, *both(work, 300)
    for K in (50, 200):
        every = long(K)[0]
        ours, theirs = every.pop(next(iter(every))), every["PIQP sparse"]
        yield f"a horizon of {K} steps, n=10 m=5", "PIQP sparse", ours, 1, theirs, 1


def repeated(work: Solve, times: int) -> Callable[[], None]:
    def run() -> None:
        for _ in range(times):
            work()

    return run


def both(work: Iterator[Callable[[], object]], share: float) -> tuple[object, float, object, float]:
    ours, theirs = work
    return ours, share, theirs, share


def batches(gen: np.random.Generator, m: int, size: int) -> tuple[Solve, Solve, Solve]:
    """Ours, ours with gaps, and DAQP for the first 2000; half of the limits are reached."""
    import daqp

    M = gen.standard_normal((m, m)) / np.sqrt(m) + np.eye(m)
    y, r = gen.standard_normal((size, m)), np.zeros(m)
    limit = np.median(np.abs(np.linalg.solve(M, y[:2000].T)))
    low, high = np.full(m, -limit), np.full(m, limit)
    H, F = M.T @ M, -(y[:2000] @ M)
    none, sense = np.zeros((0, m)), np.zeros(m, dtype=np.int32)
    return (
        lambda: core.box_batch(M, y, r, low, high, False, 1)[0],
        lambda: core.box_batch(M, y, r, low, high, True, 1)[0],
        lambda: np.array([daqp.solve(H, f, none, high, low, sense)[0] for f in F]),
    )


def batch() -> None:
    print("batches: ns per problem, one thread, half of the limits reached")
    gen = np.random.default_rng(2)
    for m in (1, 2, 3, 4, 5, 8, 20):
        size = 1_000_000 if m <= 5 else 50_000
        ours, certified, theirs = batches(gen, m, size)
        own = median(ours, 0.5, 3) / size
        gaps = median(certified, 0.3, 3) / size
        peer = median(theirs, 0.3, 3) / 2000
        worst = np.abs(ours()[:2000] - theirs()).max()
        print(
            f"m={m}: {1e9 * own:.0f} ({1e-6 / own:.1f} M/s), with gaps {1e9 * gaps:.0f}, "
            f"DAQP {1e9 * peer:.0f}, "
            f"ratio {peer / own:.0f}x, difference {worst:.0e}",
            flush=True,
        )


def plant(gen: np.random.Generator, n: int, m: int, radius: float) -> tuple[Floats, Floats]:
    A = gen.standard_normal((n, n))
    return A * (radius / np.abs(np.linalg.eigvals(A)).max()), gen.standard_normal((n, m))


def condense(A: Floats, B: Floats, K: int) -> tuple[Floats, Floats]:
    """``G`` (nK, mK) and the powers of ``A`` (nK, n)."""
    n, m = B.shape
    powers = [np.eye(n)]
    for _ in range(K):
        powers.append(A @ powers[-1])
    G = np.zeros((n * K, m * K))
    for k in range(K):
        for j in range(k + 1):
            G[n * k : n * (k + 1), m * j : m * (j + 1)] = powers[k - j] @ B
    return G, np.vstack(powers[1:])


Loops = dict[str, Callable[[Floats], Floats]]


def receding(limit: float, n: int = 10, m: int = 5, K: int = 20) -> tuple[Loops, Floats, Floats]:
    """Plans from a state by solver, warm where it can be; A and B of the plant."""
    import daqp
    import osqp
    import piqp
    from scipy import sparse

    A, B = plant(np.random.default_rng(3), n, m, 1.02)
    G, powers = condense(A, B, K)
    d = m * K
    H, F = G.T @ G + WEIGHT * np.eye(d), G.T @ powers
    low, high = np.full(d, -limit), np.full(d, limit)
    solver = core.Loop(A, B, None, task(A, B, K, WEIGHT, limit))
    model = daqp.Model()
    model.setup(H, np.zeros(d), np.zeros((0, d)), high, low, np.zeros(d, dtype=np.int32))
    warm, dense = osqp.OSQP(), piqp.DenseSolver()
    upper, eye = sparse.csc_matrix(np.triu(H)), sparse.eye(d, format="csc")
    warm.setup(upper, np.zeros(d), eye, low, high, verbose=False, eps_abs=1e-4, eps_rel=1e-4)
    dense.setup(H, np.zeros(d), x_l=low, x_u=high)

    def by_daqp(x: Floats) -> Floats:
        model.update(f=F @ x)
        return model.solve()[0]

    def by_osqp(x: Floats) -> Floats:
        warm.update(q=F @ x)
        return warm.solve().x

    def by_piqp(x: Floats) -> Floats:
        dense.update(c=F @ x)
        dense.solve()
        return dense.result.x

    def ours(x: Floats) -> Floats:
        return solver.solve(x, None).control

    return {"ours": ours, "DAQP warm": by_daqp, "OSQP 1e-4": by_osqp, "PIQP": by_piqp}, A, B


def regulator() -> None:
    steps = 300
    print(f"receding horizon, n=10 m=5 K=20, {steps} steps, disturbed: us median, p99, worst gap")
    for limit in (0.3, 100.0):
        loops, A, B = receding(limit)
        (n, m), (G, powers) = B.shape, condense(A, B, 20)
        R, high = np.full(m * 20, WEIGHT), np.full(m * 20, limit)
        noise = 0.3 * np.random.default_rng(4).standard_normal((steps, n))
        times: dict[str, list[float]] = {name: [] for name in loops}
        worst = dict.fromkeys(loops, 0.0)
        for repeat in range(3):
            x = 2 * np.ones(n)
            for w in noise:
                plans = {}
                for name, solve in loops.items():
                    start = time.perf_counter()
                    plans[name] = solve(x)
                    times[name].append(time.perf_counter() - start)
                    if repeat == 0:
                        found = gap(G, -powers @ x, R, -high, high, plans[name])
                        worst[name] = max(worst[name], found)
                x = A @ x + B @ plans["ours"][:m] + w
        for name, seconds in times.items():
            ms = 1e6 * np.array(seconds)
            ratio = np.median(ms) / np.median(1e6 * np.array(times["ours"]))
            print(
                f"  |u| <= {limit}: {name:<10} {np.median(ms):.1f}, {np.quantile(ms, 0.99):.1f}, "
                f"{worst[name]:.0e}, {ratio:.2f}x",
                flush=True,
            )


def task(A: Floats, B: Floats, K: int, r: float, limit: float) -> Task:
    """Least ``sum ||x||^2 + r ||u||^2`` over K steps."""
    (n, m), eye = B.shape, np.eye(len(A))
    high = np.full((K, m), limit)
    return Task(
        low=-high, high=high, stage=eye, terminal=eye, reference=np.zeros((K, n)), R=r * np.eye(m)
    )


def long(K: int, n: int = 10, m: int = 5) -> tuple[dict[str, Solve], Callable[[Floats], float]]:
    """Solvers of one long horizon, ours first, and the gap of an answer."""
    import daqp
    import piqp
    from scipy import sparse

    gen = np.random.default_rng(4)
    A, B = plant(gen, n, m, 0.98)
    x0, d = 3 * gen.standard_normal(n), m * K
    low, high = np.full(d, -0.3), np.full(d, 0.3)
    G, powers = condense(A, B, K)
    y, R = -powers @ x0, np.full(d, WEIGHT)
    H, f = hessian(G, y, R)
    none, sense = np.zeros((0, d)), np.zeros(d, dtype=np.int32)
    loop = core.Loop(A, B, None, task(A, B, K, WEIGHT, 0.3))

    def cold() -> Floats:
        loop.resume(None)
        return loop.solve(x0, None).control

    # states as variables: x(k+1) - A x(k) - B u(k) = 0
    P = sparse.block_diag([WEIGHT * sparse.eye(d), sparse.eye(n * K)], format="csc")
    shift = sparse.kron(sparse.eye(K, k=-1), A)
    equal = sparse.hstack([-sparse.kron(sparse.eye(K), B), sparse.eye(n * K) - shift], format="csc")
    right = np.concatenate([A @ x0, np.zeros(n * (K - 1))])
    xl = np.concatenate([low, np.full(n * K, -1e30)])

    def by_piqp() -> Floats:
        solver = piqp.SparseSolver()
        solver.setup(P, np.zeros(P.shape[0]), equal, right, x_l=xl, x_u=-xl)
        solver.solve()
        return solver.result.x[:d]

    solvers: dict[str, Solve] = {
        "condensed" if loop.condensed else "Riccati": cold,
        "dense": lambda: core.box_control(G, y, R, low, high, None, None).control,
        "PIQP sparse": by_piqp,
        "DAQP": lambda: daqp.solve(H, f, none, high, low, sense)[0],
    }
    return solvers, lambda u: gap(G, y, R, low, high, u)


def horizon() -> None:
    print("long horizons, n=10 m=5, |u| <= 0.3: ms; peers without condensing")
    for K in (20, 50, 100, 200):
        solvers, gap_of = long(K)
        own, parts = 0.0, []
        for name, work in solvers.items():
            seconds = median(work, 0.3, 3)
            own = own or seconds
            found = gap_of(work()) if K <= 100 else float("nan")
            parts.append(f"{name} {1e3 * seconds:.2f} ({found:.0e}) {seconds / own:.1f}x")
        print(f"K={K}:", "; ".join(parts), flush=True)


GROUPS = {f.__name__: f for f in (single, ill, batch, regulator, horizon)}

if __name__ == "__main__":
    for name in sys.argv[1:] or GROUPS:
        GROUPS[name]()
