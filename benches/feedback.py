"""Certified feedback: gains against Petersen's inequality, and what promised limits cost a call.

A gain that stabilises all systems of a region exists exactly if Q > 0 and Y = K Q solve

    [Q - rho^2 S, 0, A Q + B Y; 0, I, W [Q; Y]; ., ., Q] > 0    (Petersen; Bisoffi et al. 2022),

which Clarabel decides on regions that are 0.9 and 1.1 times the largest one; both verdicts must
agree. The sheet of margins is measured beside the disk margins of the centre alone, and `regulate`
with a gain beside the same plans without one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import clarabel
import control
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

import stochens_rs as se
from stochens_rs import _core

Floats = NDArray[np.float64]
Line = tuple[str, str, Callable[[], object], float, Callable[[], object], float]
MADE = 1e-7  # what is left of the inequality, in units of the largest Q that is allowed


class Case:
    """A region around a random centre."""

    def __init__(self, n: int, m: int, seed: int) -> None:
        gen = np.random.default_rng(seed)
        A, self.n, self.m = gen.standard_normal((n, n)), n, m
        A *= 1.05 / np.abs(np.linalg.eigvals(A)).max()
        self.C = np.hstack([A, gen.standard_normal((n, m))])
        Z = gen.standard_normal((4 * (n + m), n + m))
        self.W = np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(Z.T @ Z)))
        self.S = np.eye(n)
        self.rho = 1e-3 * _core.widest_gain(self.region(1e-3))[2]

    def region(self, rho: float) -> _core.Region:
        d, rows = self.n + self.m, np.arange(self.n)
        root = np.ascontiguousarray(np.linalg.inv(self.W).T)
        none = np.zeros((d, 0))
        part = _core.RegionPart(rows, np.arange(d), self.W, root, none, 1.0, self.S, rho**2)
        return _core.Region(np.ascontiguousarray(self.C), self.m, (part,), None, False)

    def ours(self, rho: float) -> bool:
        region = self.region(rho)
        K, _, most = _core.widest_gain(region)
        return most > 1.0 and _core.Feedback(region, K).status == "certified"

    def petersen(self, rho: float) -> Callable[[], bool]:
        """The inequality as a problem of Clarabel: the largest t with M(Q, Y) >= t I, tr Q <= n."""
        n, m, d = self.n, self.m, self.n + self.m
        size = 2 * n + d

        def whole(Q: Floats, Y: Floats, one: float) -> Floats:
            M = np.zeros((size, size))
            M[:n, :n] = Q - one * rho**2 * self.S
            M[n : n + d, n : n + d] = one * np.eye(d)
            M[n + d :, n + d :] = Q
            M[: n + d, n + d :] = np.vstack([self.C, self.W]) @ np.vstack([Q, Y])
            M[n + d :, : n + d] = M[: n + d, n + d :].T
            return M

        above = np.triu_indices(size)
        order = np.lexsort((above[0], above[1]))  # columns of the upper triangle

        def svec(M: Floats) -> Floats:
            scaled = np.where(np.eye(size) > 0, M, np.sqrt(2.0) * M)
            return scaled[above][order]

        columns, traces = [], []
        for i in range(n):
            for j in range(i, n):
                Q = np.zeros((n, n))
                Q[i, j] = Q[j, i] = 1.0
                columns.append(svec(whole(Q, np.zeros((m, n)), 0.0)))
                traces.append(float(i == j))
        for k in range(m * n):
            Y = np.zeros(m * n)
            Y[k] = 1.0
            columns.append(svec(whole(np.zeros((n, n)), Y.reshape(m, n), 0.0)))
            traces.append(0.0)
        # the unit of Q is a variable too: the inequality is homogeneous with it
        columns.append(svec(whole(np.zeros((n, n)), np.zeros((m, n)), 1.0)))
        columns.append(svec(-np.eye(size)))
        traces += [1.0, 0.0]
        A = sparse.csc_matrix(np.vstack([traces, -np.array(columns).T]))
        b = np.concatenate([[float(n)], np.zeros(len(columns[0]))])
        q = np.zeros(A.shape[1])
        q[-1] = -1.0
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        cones = [clarabel.NonnegativeConeT(1), clarabel.PSDTriangleConeT(size)]
        P = sparse.csc_matrix((len(q), len(q)))

        def solve() -> bool:
            found = clarabel.DefaultSolver(P, q, A, b, cones, settings).solve()
            return bool(found.x[-1] > MADE)

        return solve


def agree(case: Case) -> None:
    """Both verdicts on both sides of the largest region."""
    for share in (0.9, 1.1):
        verdicts = case.ours(share * case.rho), case.petersen(share * case.rho)()
        assert verdicts == (share < 1.0,) * 2, (case.n, share, verdicts)


def feedback() -> Iterator[Line]:
    for seed in range(40):
        agree(Case(2 + seed % 4, 1 + seed % 2, 100 + seed))
    for n, m in ((4, 1), (10, 3), (20, 5)):
        case = Case(n, m, n)
        agree(case)
        yield (
            f"a certified gain for a region, n={n} m={m}",
            "Clarabel, Petersen's inequality",
            lambda case=case: case.ours(0.9 * case.rho),
            1,
            case.petersen(0.9 * case.rho),
            1,
        )
    yield from margins()
    yield from promised()


def margins() -> Iterator[Line]:
    """The whole sheet, beside the disk margins of the centre alone on a grid of frequencies."""
    for n in (4, 20, 100):
        case, omega = Case(n, 1, n), np.geomspace(1e-3, np.pi, 200)
        region = case.region(0.3 * case.rho)
        K = _core.widest_gain(region)[0]
        loop = _core.Feedback(region, K)
        assert loop.status == "certified"
        L = control.ss(case.C[:, :n], case.C[:, n:], -K, 0, 1.0)
        yield (
            f"margins of all systems of a region, n={n} m=1",
            "python-control, of the centre",
            lambda loop=loop: loop.margins(),
            1,
            lambda L=L, omega=omega: control.disk_margins(L, omega, skew=0.0),
            1,
        )


def promised() -> Iterator[Line]:
    """100 calls of the rig with 30 runs of data; the ratio is plain by promised."""
    A = np.array(
        [
            [1, -0.0099, 0.1, -0.0003],
            [0, 1.0594, 0, 0.102],
            [0, -0.2, 1, -0.0099],
            [0, 1.2, 0, 1.06],
        ]
    )
    B, gen = np.array([[0.005], [-0.005], [0.1003], [-0.102]]), np.random.default_rng(1)
    x = gen.standard_normal((300, 4)) * [0.2, 0.05, 0.2, 0.1]
    u = gen.standard_normal((300, 1))
    y = x @ A.T + u @ B.T + 0.0005 * gen.standard_normal((300, 4))
    model = se.identify(se.Trajectories.from_pairs(x, u, y), noise=0.0005, checks=False)
    cost, noise = se.Cost(Q=[1, 10, 0.1, 1], R=0.01), 0.0005 * gen.standard_normal((100, 4))
    gain = se.gain(model, [1, 10, 0.1, 1], 0.01)
    plain = se.regulate(model, 20, limits=(-1, 1), cost=cost)
    kept = se.regulate(model, 20, limits=(-1, 1), cost=cost, keep=se.Keep(gain, 100, 0.9))

    def ride(loop: se.Regulator) -> None:
        state = np.array([0.05, 0.02, 0.0, 0.0])
        for w in noise:
            state = A @ state + B @ loop(state) + w

    ride(kept)  # the first call sets up what is kept back
    yield (
        "a call that plans, limits promised, K=20",
        "without",
        lambda: ride(kept),
        100,
        lambda: ride(plain),
        100,
    )
