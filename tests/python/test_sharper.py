"""Tubes of followed plans and the law of fits with feedback: oracles, proofs by draws, coverage."""

from __future__ import annotations

import functools
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.stats import chi2, norm

import hidden_systems
from coverage_study import LEVELS, at_most, exactly, sets
from stochens_rs import _core
from twin import outputs
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
    for trial in range(sets(1000, 90)):
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


def test_the_largest_first_order_of_a_memoryless_loop():
    """E e1 are the columns of G one after the other: their length is the Frobenius norm."""
    one, c = np.eye(2), np.vstack([np.eye(2), np.zeros((1, 2))])
    plan = twin.Followed(0.0 * one, one, one, c)
    for phi, most in ((np.inf, np.sqrt(2.0)), (1.2, 1.2)):
        assert twin.beta(plan, twin.maps(plan), 1.0, phi, 1.0, 3) == pytest.approx(most)
    _, e1, _ = twin.orders(plan, one)
    assert twin.length(e1[:3], 1.0) == pytest.approx(np.sqrt(2.0))


def test_no_covariance_above_that_of_the_lemma():
    gen, least, nearest = np.random.default_rng(3), np.inf, 0.0
    for trial in range(sets(400, 60)):
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


# -- sec. 2: the law of spent instruments ----------------------------------------------------------


def unit_root(w, dither):
    """x+ = x + w and an intercept."""
    x = np.zeros(len(w))
    for t in range(w.shape[1]):
        yield np.column_stack([x, np.ones(len(x))])
        x = x + w[:, t, 0]


def relay(w, dither):
    """A pole of 1.3 under a relay and a clipped gain."""
    x = np.zeros(len(w))
    for t in range(w.shape[1]):
        u = np.clip(-1.2 * x - 0.5 * np.sign(x), -4.0, 4.0)
        yield np.column_stack([x, u])
        x = 1.3 * x + u + w[:, t, 0]


def own_lags(w, dither):
    """A window of two readings and an input that is fed back, with an intercept."""
    y, before = np.zeros((2, len(w)))
    for t in range(w.shape[1]):
        u = np.clip(-0.6 * y + 0.2 * before, -2.0, 2.0) + 0.3 * dither[:, t]
        yield np.column_stack([y, before, u, np.ones(len(y))])
        y, before = 1.2 * y - 0.4 * before + u + w[:, t, 0], y


def switched_off(w, dither):
    """The input is off for good as soon as the noise has summed up to 2."""
    x, total = np.zeros((2, len(w)))
    on = np.ones(len(w), bool)
    for t in range(w.shape[1]):
        on &= np.abs(total) < 2.0
        u = on * dither[:, t]
        yield np.column_stack([x, u])
        x, total = 0.9 * x + u + w[:, t, 0], total + w[:, t, 0]


def double_integrator(w, dither):
    """It is excited where the last noise was large."""
    x, last = np.zeros((len(w), 2)), np.zeros(len(w))
    for t in range(w.shape[1]):
        u = -0.2 * x[:, 0] - 0.7 * x[:, 1] + 2.0 * (np.abs(last) > 0.7) * dither[:, t]
        yield np.column_stack([x, u])
        last = w[:, t, 1]
        x = np.column_stack([x[:, 0] + x[:, 1], x[:, 1] + u]) + w[:, t]


def oscillation(w, dither):
    """A growing oscillation that a bounded feedback damps."""
    A = 1.02 * np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    x = np.zeros((len(w), 2))
    for t in range(w.shape[1]):
        u = -np.tanh(x[:, 0] - 0.5 * x[:, 1])
        yield np.column_stack([x, u])
        x = x @ A.T + u[:, None] * np.array([0.5, -0.3]) + w[:, t]


# design, outputs, pairs before, pairs
DESIGNS = {
    "unit root": (unit_root, 1, 12, 30),
    "relay": (relay, 1, 12, 30),
    "own lags": (own_lags, 1, 15, 30),
    "switched off": (switched_off, 1, 12, 30),
    "double integrator": (double_integrator, 2, 15, 30),
    "oscillation": (oscillation, 2, 15, 30),
    "five pairs": (double_integrator, 2, 15, 5),
}


def drawn(name, count, longer=0):
    """Regressors and noise of so many sets, (sets, N1 + N, ..), and N1."""
    design, n, N1, N = DESIGNS[name]
    N += longer
    gen = np.random.default_rng([4, list(DESIGNS).index(name)])
    w, dither = gen.standard_normal((count, N1 + N, n)), gen.standard_normal((count, N1 + N))
    return np.stack(list(design(w, dither)), axis=1), w, N1


def pairs(name, count):
    """Regressors in coordinates of the first part, the noise after it, and N1."""
    z, w, N1 = drawn(name, count)
    return np.array([one[N1:] @ twin.whitening(one[:N1]).T for one in z]), w[:, N1:], N1


def exceeding(Gamma):
    """How often ``||Gamma||_F^2`` and an entry are above their quantiles, at each level."""
    sizes, entries = (Gamma**2).sum(axis=(1, 2)), np.abs(Gamma[:, 0, 0])
    return np.array(
        [
            [(sizes > chi2.isf(p, Gamma[0].size)).sum(), (entries > norm.isf(p / 2)).sum()]
            for p in LEVELS
        ]
    )


def as_stated(counts, runs):
    """Whether all counts are those of exact levels; a false alarm of 1e-5 each."""
    for count, level in zip(counts, LEVELS, strict=True):
        exactly(count, runs, level)


@pytest.mark.parametrize("name", DESIGNS)
def test_the_law_is_exact_whatever_the_design(name):
    x, w, N1 = pairs(name, sets(4000, 400))
    q = np.array([twin.spend(one, N1, blocks=8) for one in x])
    assert np.abs(np.einsum("stj,stk->sjk", q, q) - np.eye(x.shape[2])).max() <= 1e-10
    as_stated(exceeding(np.einsum("sti,stj->sij", w, q)), len(x))


def test_a_row_is_spent_before_the_next_is_seen():
    gen = np.random.default_rng(5)
    for name in DESIGNS:
        x, _, N1 = pairs(name, 1)
        q = twin.spend(x[0], N1)
        for t in {0, len(q) // 3, len(q) - x.shape[2] - 1, len(q) - 2}:
            other = x[0].copy()
            other[t + 1 :] = gen.standard_normal(other[t + 1 :].shape) * 10.0 ** gen.uniform(-3, 3)
            changed = twin.spend(other, N1)
            assert (changed[: t + 1] == q[: t + 1]).all()
            # the last is fixed but for its sign
            assert t == len(q) - 2 or not (changed[t + 1 :] == q[t + 1 :]).all()
            assert np.abs(changed.T @ changed - np.eye(x.shape[2])).max() <= 1e-10


def test_an_input_that_stops_is_spent_too():
    """The last rows may all be 0: a fixed unit vector takes their place."""
    x = np.random.default_rng(6).standard_normal((30, 3))
    x[20:] = 0.0
    q = twin.spend(x, 10)
    assert np.isfinite(q).all()
    assert np.abs(q.T @ q - np.eye(3)).max() <= 1e-10


def test_instruments_that_look_ahead_must_fail():
    """Normalised by all pairs, or scaled by the noise to come: then the law is another one."""
    x, w, N1 = pairs("unit root", 400)
    after_all = [one @ np.linalg.inv(twin.root_of(one.T @ one)) for one in x]
    scaled = [twin.spend(one * (0.2 + v), N1, blocks=8) for one, v in zip(x, w, strict=True)]
    for q in (after_all, scaled):
        assert np.abs(q[0].T @ q[0] - np.eye(2)).max() <= 1e-10
        with pytest.raises(AssertionError):
            as_stated(exceeding(np.einsum("sti,stj->sij", w, np.array(q))), len(x))


def test_what_the_fit_errs_by():
    """``H - Theta = Sigma^(1/2) Gamma T``, in units of all sizes."""
    z, w, N1 = drawn("double integrator", 1)
    gen, units = np.random.default_rng(7), np.array([1e-3, 1.0, 1e4])
    z, w = z[0] * units, w[0]
    Theta, root = gen.standard_normal((2, 3)) / units, np.array([[2.0, 0.0], [0.5, 0.1]])
    y = z @ Theta.T + w @ root.T
    fit = twin.estimate(z[:N1], z[N1:], y[N1:])
    Gamma = w[N1:].T @ fit.q
    assert (fit.H - Theta) * units == pytest.approx(root @ Gamma @ fit.T * units, abs=1e-10)


@pytest.mark.parametrize("level", LEVELS)
def test_the_bound_of_an_unknown_covariance(level):
    """Half of the level for the radius, half for the least root of the noise."""
    z, w, N1 = drawn("oscillation", sets(2000, 60), longer=50)
    n, d, N = w.shape[2], z.shape[2], w.shape[1] - N1
    rho = np.sqrt(_core.wishart_quantile(n, d, level / 2, 1))
    a, root = _core.smallest_quantile(n, N, level / 2, 1), np.array([[1.0, 0.0], [0.9, 0.2]])
    false = finite = 0
    for one, noise in zip(z, w @ root.T, strict=True):
        fit = twin.estimate(one[:N1], one[N1:], noise[N1:], blocks=8)
        bound = twin.covariance_bound(fit, rho, a)
        finite += np.isfinite(bound).all()
        false += np.isfinite(bound).all() and np.linalg.eigvalsh(bound - root @ root.T)[0] < 0.0
    at_most(false, len(z), level)
    assert finite > 0.5 * len(z)


def test_the_share_of_the_covariance_and_what_is_false():
    gen = np.random.default_rng(8)

    def left(s, b, beta):
        return s + (np.sqrt(beta * s) + b) ** 2

    for _ in range(200):
        b, beta = gen.uniform(0.1, 10.0), 10 ** gen.uniform(-3, 1)
        a = b**2 * gen.uniform(1.0, 4.0)
        assert left(twin.share_of_S(a, b, beta), b, beta) == pytest.approx(a, rel=1e-10)
    assert twin.share_of_S(100.0, 8.0, 0.9) == pytest.approx(3.66, abs=2e-3)
    # without a > b^2 the formula claims s > 0, though every s' > 0 is consistent with a
    a, b, beta = 30.0, 6.0, 2.0
    claimed = ((np.sqrt((1 + beta) * a - b**2) - np.sqrt(beta) * b) / (1 + beta)) ** 2
    assert claimed > 0.1
    assert left(claimed / 10.0, b, beta) > a
    assert twin.share_of_S(a, b, beta) == 0.0
    # the iteration from s = a leaves the root
    s, seen = 100.0, []
    for _ in range(40):
        s = 100.0 - (np.sqrt(0.9 * max(s, 0.0)) + 8.0) ** 2
        seen.append(s)
    assert not any(s == pytest.approx(3.66, abs=0.5) for s in seen)


# -- sec. 4: coverage near a reference, logs with feedback -----------------------------------------

STEPS = 6
TASK = np.array([0.6, -0.3, 0.0, 0.2, -0.2, 0.0])  # what the plan adds to the gain, per step


class Log(NamedTuple):
    """Pairs in their order, and the main regressors as a model replays them, where it can."""

    z: np.ndarray
    y: np.ndarray
    replayed: Callable[[np.ndarray], np.ndarray] | None = None


class Family:
    """A true system, how it is logged under feedback, and the start of the plan."""

    def __init__(self, Theta, root, x0, log, *, lags=None, N1=60, N=180):
        self.Theta, self.root, self.x0, self.log = Theta, root, np.array(x0), log
        self.lags, self.N1, self.N = lags, N1, N

    def structure(self, Theta):
        """``[A B]``, J of ``z = J (x, u)``, and G of ``x+ = .. + G w``."""
        n, d = Theta.shape
        if self.lags:
            return outputs.lag_system(Theta, self.lags, d // self.lags - n)
        return Theta, np.eye(d), np.eye(n)

    def followed(self, Theta, T, root):
        """The plan of the task by a model and how it is followed, the gain, and the way."""
        AB, J, G = self.structure(Theta)
        n = len(AB)
        A, B = np.ascontiguousarray(AB[:, :n]), AB[:, n:].copy()
        K = _core.feedback_gain(A, B, np.eye(n), 0.3 * np.eye(B.shape[1]))[0]
        x, way = self.x0, []
        for add in TASK:
            way.append(np.append(x, K @ x + add))
            x = AB @ way[-1]
        way, E = np.array(way), T @ J @ np.vstack([np.eye(n), K])
        return twin.Followed(A + B @ K, G @ root, E, way @ J.T @ T.T), K, way


def of_states(A, B, sigma, dither, x0, *, clip=np.inf, run=None, spread=0.0, weight=0.3):
    """Logs of states under a clipped gain and dither: one run, or runs of so many steps."""
    A, B = np.atleast_2d(A).astype(float), np.atleast_2d(B).astype(float)
    (n, m), Theta = B.shape, np.hstack([A, B])
    gain = _core.feedback_gain(A, B, np.eye(n), weight * np.eye(m))[0]

    def simulated(model, starts, v, w):
        z, y, x = [], [], starts[0]
        for t in range(len(w)):
            x = starts[t] if run and t % run == 0 else x
            z.append(np.append(x, np.clip(gain @ x, -clip, clip) + v[t]))
            x = model @ z[-1] + w[t]
            y.append(x)
        return np.array(z), np.array(y)

    def log(gen, N1, N):
        starts, v = spread * gen.standard_normal((N, n)), dither * gen.standard_normal((N, m))
        w = sigma * gen.standard_normal((N, n))
        again = None
        if run:  # starts and dither are independent of the noise

            def again(H0):
                return simulated(H0, starts[N1:], v[N1:], 0.0 * w[N1:])[0]

        return Log(*simulated(Theta, starts, v, w), again)

    return Family(Theta, sigma * np.eye(n), x0, log)


def of_readings():
    """Two lags with a pole of 1.1, logged under proportional and integral feedback."""
    Theta = np.array([[1.5, -0.44, 1.0, 0.3]])  # (y, y before, u, u before)

    def log(gen, N1, N):
        y, u, total = [0.0, 0.0], [0.0, 0.0], 0.0
        for _ in range(N + 1):
            total = np.clip(total + y[-1], -20.0, 20.0)
            before = Theta[0] @ [y[-1], y[-2], 0.0, u[-1]]
            u.append(float(-0.5 * before - 0.02 * total + gen.standard_normal()))
            now = [y[-1], y[-2], u[-1], u[-2]]
            y.append(float(Theta[0] @ now) + 0.1 * gen.standard_normal())
        z, after = outputs.lag_rows(np.array(y)[1:, None], np.array(u)[2:, None], 2)
        return Log(z[-N:], after[-N:])

    return Family(Theta, np.array([[0.1]]), [0.5, 0.4, 0.1], log, lags=2)


def six_states():
    gen = np.random.default_rng(9)
    A, B = gen.standard_normal((6, 6)), gen.standard_normal((6, 2))
    return of_states(A * 0.95 / radius_of(A), B, 0.1, 2.0, gen.standard_normal(6))


def cart_pole():
    A, B = np.split(hidden_systems.RIG, [4], axis=1)
    return of_states(A, B, 5e-4, 1.0, [0.1, 0.05, 0, 0], weight=0.01, run=10, spread=0.05)


UNSTABLE = np.array([[1.2, 0.3], [0.0, 0.7]]), np.array([[0.3], [1.0]])
FAMILIES = {
    "unit root": lambda: of_states(1.0, 0.5, 0.1, 1.0, [1.0]),
    "unstable": lambda: of_states(*UNSTABLE, 0.1, 1.0, [1.0, -0.5]),
    "clipped runs": lambda: of_states(
        *UNSTABLE, 0.1, 1.0, [1.0, -0.5], clip=1.0, run=10, spread=0.5
    ),
    "clipped": lambda: of_states(1.15, 1.0, 0.2, 1.0, [1.0], clip=2.0),
    "cart-pole": cart_pole,
    "six states": six_states,
    "readings": of_readings,
}


@functools.lru_cache
def radii(n, d, delta):
    """Spectral and Frobenius radius in one event."""
    spectral = np.sqrt(_core.wishart_quantile(n, d, delta / 2, 1))
    return spectral, float(np.sqrt(chi2.isf(delta / 2, n * d)))


def certificate(family, gen, delta, traces=None):
    """Bounds of the model part and of all with noise, and what a run then does of both."""
    N1, (n, d) = family.N1, family.Theta.shape
    log = family.log(gen, N1, N1 + family.N)
    first, z, y = log.z[:N1], log.z[N1:], log.y[N1:]
    fit = twin.estimate(first, z, y, blocks=12)
    H0 = np.linalg.lstsq(first, log.y[:N1], rcond=None)[0].T
    T0 = twin.replayed(first, log.replayed(H0)) if log.replayed else fit.T0
    spectral, frobenius = radii(n, d, 0.10 * delta)
    root, share = family.root, 0.40
    if family.lags:  # of which the covariance is not known
        a = _core.smallest_quantile(n, len(z), 0.05 * delta, 1)
        root, share = np.linalg.cholesky(twin.covariance_bound(fit, spectral, a)), 0.35
    plan, K, way = family.followed(fit.H, fit.T, root)
    reference, _, _ = family.followed(H0, T0, root)
    rows = np.eye(len(plan.A))[: 1 if family.lags else None]
    ts = [max(radius_of(reference.A), 0.5), 0.9, 1.05]
    at = twin.Levels(spectral, frobenius, share * delta, 0.10 * delta)
    one, rest = twin.near(plan, reference, rows, at, ts, known=not family.lags, traces=traces)
    deviations = twin.deviations(plan, rows, spectral, plan.D @ plan.D.T)
    noise = twin.quantile_of(rest.size, 0.40 * delta) * deviations
    AB, _, G = family.structure(family.Theta)
    own, wrong = AB[:, : len(AB)] + AB[:, len(AB) :] @ K, (AB - family.structure(fit.H)[0]) @ way.T
    e = np.zeros((2, STEPS + 1, len(AB)))
    for k in range(STEPS):
        e[:, k + 1] = e[:, k] @ own.T + wrong[:, k]
        e[1, k + 1] += G @ family.root @ gen.standard_normal(n)
    return one + rest, one + rest + noise, *np.abs(e[:, 1:] @ rows.T)


def failures_near(family, seeds, delta):
    """How often the model part leaves its bound, and how often a noisy run leaves the whole."""
    found = [certificate(family, np.random.default_rng(seed), delta) for seed in seeds]
    return np.sum([[(e > model).any(), (x > whole).any()] for model, whole, e, x in found], axis=0)


@pytest.mark.parametrize("level", LEVELS)
def test_no_more_runs_leave_than_stated(level):
    """Model parts at their share of the level, noisy runs at the level: per family, and of all."""
    count, total = sets(200, 6), np.zeros(2)
    of_model = level * (0.10 + 0.10 + 0.40 + 0.05)
    for index, make in enumerate(FAMILIES.values()):
        family = make()
        failed = failures_near(family, [[10, index, seed] for seed in range(count)], level)
        at_most(failed[0], count, of_model)
        at_most(failed[1], count, level)
        total += failed
    at_most(total[0], count * len(FAMILIES), of_model)
    at_most(total[1], count * len(FAMILIES), level)


def test_certificates_near_a_reference_are_small():
    """At 5 %, medians over the worst of many runs: no more than 2.5 times as large."""
    for name, most in (("unit root", 2.5), ("clipped runs", 2.5), ("cart-pole", 2.5)):
        family = FAMILIES[name]()
        found = [certificate(family, np.random.default_rng([11, k]), 0.05) for k in range(10)]
        model, _, e, _ = (np.array(one) for one in zip(*found, strict=True))
        assert (np.median(model, axis=0) / e.max(axis=0)).mean() < most


# -- sec. 4 by draws: on the events the algebra leaves no room -------------------------------------


def near_plans(gen, trial):
    """A plan, and a reference a little off."""
    while True:
        plan, rho, _ = random_plan(gen, trial)
        if len(plan.c) > 1:
            break
    size = 10 ** gen.uniform(-3, -0.5)
    reference = twin.Followed(*(one * (1 + size * gen.standard_normal(one.shape)) for one in plan))
    return plan, reference, rho


def events_hold(reference, rows, at, ts, G):
    """Whether G is in all the events of Theorem 3, Sigma known."""
    K, T0, g = len(reference.c), twin.maps(reference), G.T.ravel()
    x = np.log(4 * K * len(rows) / at.others)
    fine = np.linalg.norm(G, 2) <= at.spectral and np.linalg.norm(G) <= at.frobenius
    for t in ts:
        f = twin.length(np.einsum("jrq,q->jr", T0, g), t)
        fine &= f <= twin.chaos(twin.gram(T0, t, K), np.log(2 * len(ts) / at.others))
    for k in range(1, K + 1):
        for h in rows:
            X0, Q0 = twin.X(reference, h, k), twin.second_order(reference, T0, h, k)
            wide = 2 * np.sqrt(x) * np.linalg.norm(Q0) + 2 * x * np.linalg.norm(Q0, 2)
            z = twin.quantile_at(k, K, len(rows), at.first)
            fine &= abs((G * X0).sum()) <= z * np.linalg.norm(X0)
            fine &= abs(g @ Q0 @ g) <= abs(np.trace(Q0)) + wide
    return fine


def test_on_the_events_no_plan_leaves():
    gen, held, nearest = np.random.default_rng(12), 0, 0.0
    for trial in range(sets(400, 10)):
        plan, reference, rho = near_plans(gen, trial)
        q, r = plan.D.shape[1], len(plan.E)
        spectral, frobenius = radii(q, r, 0.1)
        plan, reference = (one._replace(D=one.D * rho / spectral) for one in (plan, reference))
        rows = np.vstack([np.eye(len(plan.A))[0], gen.standard_normal(len(plan.A))])
        at = twin.Levels(spectral, frobenius, 0.3, 0.3)
        ts = [share * max(radius_of(plan.A), 0.3) for share in (0.9, 1.1, 1.3)]
        whole = np.add(*twin.near(plan, reference, rows, at, ts, known=True))
        by_traces = twin.near(plan, reference, rows, at, ts, known=True, traces=True)
        assert (np.add(*by_traces) >= whole).all()
        for G in gen.standard_normal((20, q, r)):
            if events_hold(reference, rows, at, ts, G):
                held += 1
                moved = np.abs(twin.orders(plan, G)[0][1:] @ rows.T)
                assert (moved <= whole).all()
                nearest = max(nearest, (moved / whole).max())
    assert held > 10 * trial
    assert nearest > 0.8


def test_all_orders_of_a_scalar_loop_are_there():
    """G on the edge with one sign; the plan is its own reference, or the reference is silent."""
    scalar = np.ones((1, 1))
    plan = twin.Followed(0.5 * scalar, scalar, scalar, np.array([[1.0], [0.5], [0.2], [0.1]]))
    at = twin.Levels(0.3, 0.3, 1e-6, 1e-6)
    e, e1, e2 = twin.orders(plan, 0.3 * scalar)
    for reference in (plan, plan._replace(c=0.0 * plan.c)):
        first, rest = twin.near(plan, reference, scalar, at, [0.7, 1.0], known=True)
        assert first == pytest.approx(e1[1:])
        assert (first + rest >= e[1:]).all()
        assert (rest[2:] > e2[3:] * 1.02).all()


def test_quadratic_forms_of_normal_vectors():
    """The chance of leaving is at most that of Laurent and Massart, for indefinite forms too."""
    gen, x = np.random.default_rng(13), np.log(1000.0)
    g = gen.standard_normal((20_000, 6))
    for trial in range(12):
        M = gen.standard_normal((6, 1 + trial % 6))
        S = M @ M.T
        outside = np.sqrt(np.einsum("si,ij,sj->s", g, S, g)) > twin.chaos(S, x)
        assert outside.mean() <= np.exp(-x)
        Q = gen.standard_normal((6, 6))
        Q = Q + Q.T if trial else np.diag([1.0, -1.0, 0, 0, 0, 0])
        off = np.einsum("si,ij,sj->s", g, Q, g) - np.trace(Q)
        limit = 2 * np.sqrt(x) * np.linalg.norm(Q) + 2 * x * np.linalg.eigvalsh(Q)[-1]
        assert (off > limit).mean() <= np.exp(-x)


def test_traces_with_a_bound_of_the_covariance():
    """`tr Q0` with the bound may be smaller than the true one; the largest trace is not."""
    gen, naive = np.random.default_rng(14), 0
    Q0 = np.diag([1.0, -1.0])
    assert twin.largest_trace(Q0, 2) == 1.0  # Sigma = diag(1, .01): .99
    for _ in range(300):
        q, r = int(gen.integers(1, 4)), int(gen.integers(1, 4))
        Q = gen.standard_normal((q * r, q * r))
        Q = Q + Q.T
        turn = np.linalg.qr(gen.standard_normal((q, q)))[0]
        half = np.kron(np.eye(r), (turn * gen.uniform(0.0, 1.0, q)) @ turn.T)  # of the columns of G
        true = abs(np.trace(half @ Q @ half))
        naive += true > abs(np.trace(Q))
        assert true <= twin.largest_trace(Q, q) * (1 + 1e-12)
    assert naive > 20


# -- sec. 5: one quantile for the fit and the noise to come ----------------------------------------


@pytest.mark.parametrize(
    ("f", "v0", "delta"), [(1.0, 1.0, 0.05), (0.5, 1.0, 0.01), (2.0, 0.1, 0.2)]
)
def test_one_quantile_covers_any_smaller_variance(f, v0, delta):
    """Also one that is 0 where the fit is outside already, which is the worst; it is used up."""
    q = twin.one_quantile(f, v0, delta)
    F = np.linspace(-q, q, 20_001)
    leaves = norm.sf((q - F) / np.sqrt(v0)) + norm.sf((q + F) / np.sqrt(v0))
    worst = trapezoid(leaves * norm.pdf(F, scale=f), F) + 2 * norm.sf(q / f)
    assert 0.6 * delta < worst <= delta
    assert 2 * norm.sf(q / np.hypot(f, np.sqrt(v0))) <= worst
