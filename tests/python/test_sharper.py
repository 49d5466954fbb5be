"""Tubes of followed plans and the law of fits with feedback: oracles, proofs by draws, coverage."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from coverage_study import sets
from twin import sharper as twin


class LoopT:
    """A loop of two states under a gain, and a plan of four steps."""

    def __init__(self):
        model = np.array([[0.9, 0.2, 0.0], [-0.1, 0.8, 1.0]])
        K = np.array([[0.1, -0.5]])
        V = np.array([[115.0, 41.0, -11.0], [41.0, 103.0, -11.0], [-11.0, -11.0, 99.0]])
        W = np.linalg.cholesky(np.linalg.inv(V)).T
        self.A = model[:, :2] + model[:, 2:] @ K
        self.D = np.linalg.cholesky(np.array([[0.45, 0.04], [0.04, 0.06]]))
        self.E = W @ np.vstack([np.eye(2), K])
        x, c = np.array([1.0, -1.0]), []
        for u in (0.5, 0.0, -0.5, 0.25):
            c.append(W @ np.append(x, u))
            x = model @ np.append(x, u)
        self.plan = twin.Followed(self.A, self.D, self.E, np.array(c))


# -- oracles ---------------------------------------------------------------------------------------


def test_oracles_of_the_tube():
    one = LoopT()
    first, second = (twin.X(one.plan, h, 4) for h in np.eye(2))
    assert np.linalg.norm(first, "nuc") == pytest.approx(0.265341654564, abs=6e-13)
    assert np.linalg.norm(second, "nuc") == pytest.approx(0.036915785092, abs=6e-13)
    assert np.linalg.norm(first) == pytest.approx(0.263764508116, abs=6e-13)
    gains = {
        1.0: [0.066662197173, 0.104298214920, 0.140120407001],
        1.1: [0.060601997430, 0.091218905386, 0.118415409597],
        0.9: [0.074069107971, 0.121397785325, 0.170281336065],
    }
    for t, expected in gains.items():
        assert [twin.gain(one.plan, t, k) for k in (2, 3, 4)] == pytest.approx(expected, abs=6e-13)
    M = twin.gram(twin.maps(one.plan), 1.0, 4)
    assert np.trace(M) == pytest.approx(9.189118165747e-4, abs=6e-17)
    assert np.linalg.eigvalsh(M)[-1] == pytest.approx(8.570636065488e-4, abs=6e-17)
    assert twin.reach(one.plan, np.eye(2)[0], 1.0, 4) == pytest.approx(1.183906115366, abs=6e-13)


def test_oracles_of_the_noise():
    one = LoopT()
    Y = twin.lemma2(one.A, one.D, one.E, 0.01 * np.eye(2), 1.0, 4, kappa=1.0)[4]
    nominal = twin.lemma2(one.A, one.D, one.E, 0.01 * np.eye(2), 1e-30, 4, kappa=1.0)[4]
    assert np.diag(Y) == pytest.approx([0.037842950852, 0.011283804515], abs=6e-13)
    assert np.diag(nominal) == pytest.approx([0.031498970000, 0.010988290000], abs=6e-13)


def test_oracles_of_one_member():
    one, G = LoopT(), np.array([[0.3, -0.2, 0.5], [0.1, 0.4, -0.6]])
    e, e1, e2 = twin.orders(one.plan, G)
    assert e[4] == pytest.approx([0.102491151127, -0.004875231990], abs=6e-13)
    assert e1[4] == pytest.approx([0.097873458304, -0.005231550543], abs=6e-13)
    assert e2[4, 0] == pytest.approx(0.004514007997, abs=6e-13)
    Q = twin.second_order(one.plan, twin.maps(one.plan), np.eye(2)[0], 4)
    g = G.T.ravel()
    assert g @ Q @ g == pytest.approx(0.004514007997, abs=6e-13)
    sizes = np.trace(Q), np.linalg.norm(Q), np.linalg.norm(Q, 2)
    assert sizes == pytest.approx((0.025238462770, 0.028662230711, 0.028237422790), abs=6e-13)


def test_oracles_of_spent_instruments():
    t = np.arange(10)
    x = np.column_stack([((3 * t**2 + t) % 7 - 3) / 6, ((5 * t + 2) % 9 - 4) / 8])
    q = twin.spend(x, 1, eps=0.0, M=np.eye(2))
    left = np.eye(2) - q[:8].T @ q[:8]
    off = -0.194813829787
    assert left == pytest.approx(
        np.array([[0.351359338061, off], [off, 0.244514627660]]), abs=6e-13
    )
    assert q[8] == pytest.approx([0.105024220991, 0.305380390237], abs=6e-13)
    assert q[9] == pytest.approx([-0.583377451627, 0.388918301085], abs=6e-13)
    S = np.array([[1.020302588931, 0.098103284212], [0.413766121202, 0.777426258712]])
    T = np.array([[1.032962329812, -0.130349336527], [-0.549768948199, 1.355670878833]])
    assert x.T @ q == pytest.approx(S, abs=6e-13)
    assert np.linalg.inv(x.T @ q) == pytest.approx(T, abs=6e-13)


def test_oracles_of_one_quantile():
    assert twin.one_quantile(1.0, 1.0, 0.05) == pytest.approx(2.803097163, abs=6e-10)
    assert twin.one_quantile(0.5, 1.0, 0.01) == pytest.approx(2.879864873, abs=6e-10)


# -- sec. 3 by draws: no member leaves the tube ----------------------------------------------------


def random_plan(gen, trial):
    """A loop in which rho g_t is anything, stable or not, of any sizes; a plan; its radii."""
    n, q, r, K = (int(gen.integers(1, most + 1)) for most in (4, 4, 5, 8))
    A = gen.standard_normal((n, n))
    A *= (gen.uniform(1.0, 1.3) if trial % 3 == 0 else gen.uniform(0.2, 0.98)) / radius_of(A)
    plan = twin.Followed(
        A,
        gen.standard_normal((n, q)),
        gen.standard_normal((r, n)),
        gen.standard_normal((K, r)) * gen.uniform(0.2, 1.0, (K, 1)),
    )
    size = max(twin.gain(plan, max(radius_of(A), 0.3), K), 1e-3)
    rho = gen.uniform(0.05, 0.9) / size
    phi = np.inf if trial % 2 else rho * gen.uniform(1.0, np.sqrt(min(q, r)) + 1e-9)
    return plan, rho, phi


def radius_of(A):
    return np.abs(np.linalg.eigvals(A)).max()


def members(gen, plan, rows, rho, phi, count):
    """G on the edge: any, and those that move a row most in first order."""
    q, r = plan.D.shape[1], len(plan.E)
    drawn = list(gen.standard_normal((count, q, r)))
    for h in rows:
        for k in {1, len(plan.c) // 2 + 1, len(plan.c)}:
            X = twin.X(plan, h, k)
            U, _, Vt = np.linalg.svd(X, full_matrices=False)
            drawn += [U @ Vt, -(U @ Vt), X, -X]
    sizes = [max(np.linalg.norm(G, 2) / rho, np.linalg.norm(G) / phi) for G in drawn]
    return [G / size for G, size in zip(drawn, sizes, strict=True) if size > 0.0]


def test_no_member_leaves_the_tube():
    gen, nearest, finite = np.random.default_rng(1), 0.0, 0
    for trial in range(sets(1000, 150)):
        plan, rho, phi = random_plan(gen, trial)
        rows = np.vstack([np.eye(len(plan.A))[0], gen.standard_normal(len(plan.A))])
        ts = [share * max(radius_of(plan.A), 0.2) for share in (0.8, 1.0, 1.1, 1.25)]
        tube = twin.tube(*plan, rows, rho, phi, ts=ts)
        whole = tube.first + tube.rest
        finite += np.isfinite(whole[-1]).all()
        for G in members(gen, plan, rows, rho, phi, 12):
            e, e1, _ = twin.orders(plan, G)
            first, moved = (np.abs(one[1:] @ rows.T) for one in (e1, e))
            assert (first <= tube.first + 1e-13).all()
            assert (np.abs((e - e1)[1:] @ rows.T) <= tube.rest + 1e-13).all()
            assert (moved <= whole + 1e-13).all()
            if len(plan.c) > 1:
                nearest = max(nearest, (moved / whole)[1:].max())
    assert finite > 0.7 * trial
    assert nearest > 0.9  # some member comes near: no bound is smaller for nothing


def test_first_and_second_order_of_members():
    gen = np.random.default_rng(2)
    for trial in range(30):
        plan, rho, phi = random_plan(gen, trial)
        h, k, T = gen.standard_normal(len(plan.A)), len(plan.c), twin.maps(plan)
        for G in members(gen, plan, [h], rho, phi, 3):
            _, e1, e2 = twin.orders(plan, G)
            g, size = G.T.ravel(), np.linalg.norm(h) + np.abs(e2[k]).sum()
            assert h @ e1[k] == pytest.approx((G * twin.X(plan, h, k)).sum(), abs=1e-10 * size)
            Q = twin.second_order(plan, T, h, k)
            assert h @ e2[k] == pytest.approx(g @ Q @ g, abs=1e-10 * size)
            stacked = twin.toeplitz(plan, 1.0, k).reshape(k, len(plan.E), k, -1)
            by_maps = np.einsum("jrq,q->jr", T, g)
            by_operator = np.einsum("jriq,qs,is->jr", stacked, G, plan.c)
            assert by_operator == pytest.approx(by_maps, abs=1e-10 * size)
            assert by_maps == pytest.approx(e1[:k] @ plan.E.T, abs=1e-10 * size)


def test_no_covariance_above_that_of_the_lemma():
    gen, least, nearest = np.random.default_rng(3), np.inf, 0.0
    for trial in range(sets(400, 80)):
        plan, rho, _ = random_plan(gen, trial)
        A, D, E, c = plan
        root = gen.standard_normal((len(A), 1 + trial % len(A)))
        RR = root @ root.T
        kappa = float(gen.choice(twin.KAPPAS)) if trial % 2 else float(10 ** gen.uniform(-3, 2))
        Y = twin.lemma2(A, D, E, RR, rho, len(c), kappa)
        for G in members(gen, plan, np.eye(len(A)), rho, np.inf, 8):
            own = A + D @ G @ E
            true = np.zeros_like(A)
            for before, after in pairwise(Y):
                room = np.linalg.eigvalsh(after - own @ before @ own.T - RR)[0]
                least = min(least, room / np.trace(after))
                true = own @ true @ own.T + RR
            nearest = max(nearest, (np.diag(true) / np.diag(Y[-1])).max() * (len(c) > 2))
    assert least > -1e-13
    assert nearest > 0.7
