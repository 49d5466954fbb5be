"""Least squares over limits in plain NumPy: known answers, two solvers, certificates, fleets."""

from __future__ import annotations

import numpy as np
import pytest

from coverage_study import sets
from limit_problems import draw_steps, draws, feasible
from stochens_rs.reference import pinv
from twin import limited_control as lc
from twin import limited_problems as lp
from twin import populations as pop
from twin.receding import regulate

A, B = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]])  # the double integrator
ONE = np.ones((1, 1))


def exactly(a, b):
    np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


# -- known answers ---------------------------------------------------------------------------------


def test_one_input_by_hand():
    exactly(lc.solve(lp.one_step(ONE, [3.0], R=1)).u, [1.5])
    s = lc.solve(lp.one_step(ONE, [3.0], R=1, low=-1, high=1))
    exactly([*s.u, s.objective, *s.multipliers, s.missed], [1.0, 5.0, 2.0, 0.5])
    assert s.active.tolist() == [1]
    assert s.gap == s.distance == 0.0
    other = lc.solve(lp.one_step(ONE, [1.0], R=1, low=-1, high=1))
    exactly(other.u, [0.5])


def test_two_inputs_without_weight_by_hand():
    p = lp.one_step([[1, 1], [0, 1]], [2.0, 0.0], low=-1, high=1)
    s = lc.solve(p)
    exactly(s.u, [1.0, 0.5])
    exactly(lp.gradient(p, s.u), [-1.0, 0.0])
    exactly(s.objective, 0.5)
    exactly(lc.by_enumeration(p), [1.0, 0.5])
    exactly(lc.solve(p._replace(low=-np.inf * np.ones(2), high=np.inf * np.ones(2))).u, [2.0, 0.0])


def test_two_steps_of_the_double_integrator_by_hand():
    def steps(**limits):
        return lp.several_steps(A, B, [1, 0], [0, 0], 2, **limits)

    exactly(lc.solve(steps()).u, [-1.0, 1.0])
    s = lc.solve(steps(low=-0.5, high=0.5))
    exactly([*s.u, s.objective], [-0.5, 0.5, 0.25])
    s = lc.solve(steps(low=-0.5, high=0.5, rate=0.5))
    exactly([*s.u, s.objective], [-0.4, 0.1, 9 / 20])
    exactly(s.rows, [0.0, 0.6, 0.0, 0.0])  # u_1 - u_0 <= 1/2 holds it back
    # a reference at the intermediate step, a wanted input and a penalty on changes
    s = lc.solve(lp.several_steps(ONE, ONE, [0.0], [[1.0], [1.0]], 2, Q=1, R=1, wanted=1.0, S=1))
    exactly(s.u, np.linalg.solve([[5.0, 0.0], [0.0, 3.0]], [3.0, 2.0]))


def test_states_that_cannot_keep_their_limits():
    p = lp.several_steps(ONE, ONE, [3.0], [0.0], 1, low=-1, high=1)
    rows = lp.state_rows(ONE, ONE, [3.0], 1, ONE, [1.0])
    found = lc.missing(p, *rows)
    exactly([found.amount, *found.rows, *found.u], [1.0, 1.0, -1.0])
    with pytest.raises(ValueError, match="missing"):
        lc.solve(lp.with_rows(p, *rows))
    enough = lp.with_rows(p, rows[0], rows[1] + found.amount)
    exactly(lc.solve(enough).u, [-1.0])
    assert lc.missing(p, rows[0], rows[1] + 3.0).amount == 0.0


def test_regulating_by_hand():
    run = regulate(ONE, ONE, [5.0], [0.0], 1, 6, Q=1, R=1, low=-1, high=1)
    exactly(run.inputs[:, 0], [-1, -1, -1, -1, -0.5, -0.25])
    # the fourth input is at its limit, which costs nothing: active by value, multiplier 0
    assert [int(s.active[0]) for s in run.solutions] == [-1, -1, -1, -1, 0, 0]
    exactly([s.multipliers[0] for s in run.solutions], [-6, -4, -2, 0, 0, 0])
    exactly(run.states[:, 0], [5, 4, 3, 2, 1, 0.5, 0.25])
    # a rate limit counts from the input applied last
    run = regulate(ONE, ONE, [5.0], [0.0], 1, 3, R=1, low=-1, high=1, rate=0.4)
    exactly(run.inputs[:, 0], [-0.4, -0.8, -1.0])


def test_regulating_another_system_than_the_model():
    F, X = np.array([[1.1, 0.2], [0.0, 0.9]]), np.array([[0.1], [1.0]])
    limits = {"Q": 1.0, "R": 0.1, "low": -0.7, "high": 0.7, "rate": 0.5}
    run = regulate(A, B, [1.0, -0.5], [0.0, 0.0], 3, 8, true=(F, X), **limits)
    np.testing.assert_allclose(run.states[1:], run.states[:-1] @ F.T + run.inputs @ X.T)
    changes = np.diff(np.vstack([[0.0], run.inputs]), axis=0)
    assert np.max(np.abs(run.inputs)) <= 0.7
    assert np.max(np.abs(changes)) <= 0.5 + 1e-12
    again = lp.several_steps(A, B, run.states[5], [0.0, 0.0], 3, previous=run.inputs[4], **limits)
    exactly(lc.solve(again).u[:1], run.inputs[5])


def test_wide_limits_change_nothing(gen):
    for d in range(1, 5):
        G, b = gen.normal(size=(5, d)), gen.normal(size=5)
        u = pinv(G) @ b
        np.testing.assert_allclose(
            lc.solve(lp.one_step(G, b, low=-1e3, high=1e3)).u, u, rtol=1e-12, atol=1e-12
        )


# -- the stacked problem ---------------------------------------------------------------------------


def test_the_stacked_problem_is_the_sum_over_steps(gen):
    for i in range(40):
        F, X, x0, K, more = draw_steps(gen, i)
        n, m = X.shape
        wanted, r = gen.normal(size=m), gen.normal(size=(K, n))
        p = lp.several_steps(F, X, x0, r, K, wanted=wanted, **more)
        u, x = gen.normal(size=(K, m)), x0
        last, J = np.broadcast_to(more.get("previous", 0.0), m), 0.0
        for k in range(K):
            x = F @ x + X @ u[k]
            stage = np.zeros((n, n)) if more["Q"] is None else more["Q"]
            J += lp.norm(x - r[k], more["Qf"] if k == K - 1 else stage) ** 2
            J += more["R"] * np.sum((u[k] - wanted) ** 2)
            J += more.get("S", 0.0) * np.sum((u[k] - last) ** 2)
            last = u[k]
        np.testing.assert_allclose(lp.objective(p, u.ravel()), J, rtol=1e-11)
        C, c = lp.state_rows(F, X, x0, K, np.eye(n), np.ones(n))
        np.testing.assert_allclose((c - C @ u.ravel())[-n:], 1.0 - x, rtol=1e-9, atol=1e-10)
        if "rate" in more:
            changes = np.diff(np.vstack([more["previous"], u]), axis=0)
            inside = np.all(np.abs(changes) <= more["rate"])
            assert inside == np.all(p.C @ u.ravel() <= p.c)


def test_gradient_and_expansion(gen):
    for p in draws(gen, 60):
        u, v = gen.normal(size=(2, len(p.low)))
        J = lp.objective(p, u) + lp.gradient(p, u) @ (v - u) + lp.norm(v - u, p.H) ** 2
        np.testing.assert_allclose(lp.objective(p, v), J, rtol=1e-9)


# -- solvers ---------------------------------------------------------------------------------------


def test_least_distance_equals_enumeration(gen):
    """300 boxes of unlike kinds: the objective, the gap, and the signs of the multipliers."""
    for p in draws(gen, 300):
        s, u = lc.solve(p), lc.by_enumeration(p)
        zero = lp.objective(p, np.clip(np.zeros(len(u)), p.low, p.high))
        assert abs(s.objective - lp.objective(p, u)) <= 1e-12 * zero
        assert -1e-13 * zero <= s.gap <= 1e-8 * zero
        assert lp.norm(s.u - u, p.H) <= 1e-6 * np.sqrt(zero)
        assert np.all(s.u >= p.low)
        assert np.all(s.u <= p.high)
        free = p.low < p.high
        assert np.all((s.multipliers * s.active)[free] >= -1e-9 * np.sqrt(zero))
        assert s.missed >= -1e-10 * zero


def test_rows_and_rates_equal_an_interior_point(gen):
    """60 problems of several steps against Clarabel, with the multipliers as the certificate."""
    pytest.importorskip("clarabel")
    for i in range(60):
        F, X, x0, K, more = draw_steps(gen, i)
        p = lp.several_steps(F, X, x0, np.zeros(len(F)), K, **more)
        s = lc.solve(p)
        size = np.sqrt(lp.objective(p, np.zeros(len(s.u)))) + 1e-3
        assert s.distance <= 1e-6 * size
        assert np.all(p.C @ s.u <= p.c + 1e-12)
        other = lc.by_clarabel(p)  # to its own tolerances, also those of the limits
        assert lp.norm(other - s.u, p.H) <= 1e-3 * size
        assert abs(lp.objective(p, other) - s.objective) <= 1e-7 * size**2
        if len(p.c) and np.all(np.isfinite(p.low)):
            assert abs(lc.frank_wolfe_gap(p, s.u)) <= 1e-6 * size**2


@pytest.mark.parametrize("way", ["half", "all"])
def test_ill_conditioned_maps_are_solved_and_certified(gen, way):
    """50 maps of condition 1e6 with 20 inputs and R = 0, where H has 1e12.

    Rounding u itself moves the gradient by eps ||u||, which the gap multiplies by the limits: the
    gap of the exact u, rounded, is no smaller than the second term.
    """
    for _ in range(50):
        U, V = (np.linalg.qr(gen.normal(size=(20, 20)))[0] for _ in range(2))
        G, b = (U * np.geomspace(1.0, 1e-6, 20)) @ V, gen.normal(size=20)
        free = np.linalg.solve(G, b)
        limit = np.median(np.abs(free)) * (1.0 if way == "half" else 1e-3)
        s = lc.solve(lp.one_step(G, b, low=-limit, high=limit))
        assert s.gap <= 1e-9 * (b @ b) + 100 * np.finfo(float).eps * limit**2 * 20
        assert s.distance <= 1e-4 * np.linalg.norm(b)
        assert lp.objective(lp.one_step(G, b), s.u) <= b @ b


def test_rank_deficient_maps_need_the_enumeration():
    p = lp.one_step([[1.0, 0.1]], [1.0], low=-1, high=1)
    with pytest.raises(ValueError, match="singular"):
        lc.solve(p)
    exactly(lc.by_enumeration(p), np.array([1.0, 0.1]) / 1.01)
    # with one weight that goes to 0 the best u goes to the one of minimum norm
    small = lc.solve(lp.one_step([[1.0, 0.1]], [1.05], R=1e-9, low=-1, high=1)).u
    np.testing.assert_allclose(small, lc.by_enumeration(p._replace(b=np.array([1.05]))), atol=1e-6)


def test_order_and_units_of_the_inputs_do_not_matter(gen):
    for p in draws(gen, 60):
        u, d = lc.solve(p).u, len(p.low)
        order, factor = gen.permutation(d), 2.0 ** gen.integers(-8, 8, size=d)
        q = p._replace(G=p.G[:, order], E=p.E[:, order], C=p.C[:, order], low=p.low[order],
                       high=p.high[order])  # fmt: skip
        M = lp.residual_form(p)[0]
        close = 1e-9 * (1.0 + np.abs(u)) * np.linalg.cond(M / np.linalg.norm(M, axis=0))
        assert np.all(np.abs(lc.solve(q).u - u[order]) <= close[order])
        q = p._replace(G=p.G / factor, E=p.E / factor, low=p.low * factor, high=p.high * factor)
        assert np.all(np.abs(lc.solve(q).u / factor - u) <= close)
        q = p._replace(b=4.0 * p.b, low=4.0 * p.low, high=4.0 * p.high)
        assert np.all(np.abs(lc.solve(q).u / 4.0 - u) <= close)


def test_soft_rows_are_the_quadratic_penalty(gen):
    for p in draws(gen, 60):
        d, rho = len(p.low), 10.0 ** gen.uniform(-1, 3)
        C, c = gen.normal(size=(2, d)), 0.1 * gen.normal(size=2)
        u = lc.solve(lp.softened(p, C, c, rho)).u[:d]
        over = np.maximum(0.0, C @ u - c)
        g = lp.gradient(p, u) + 2.0 * rho * C.T @ over
        zero = lp.objective(p, 0.0 * u) + rho * np.sum(np.maximum(0.0, -c) ** 2) + 1e-6
        gap = lc.box_gap(g, u, p.low, p.high)
        if np.all(np.isfinite([p.low, p.high])):
            assert gap <= 1e-9 * zero
        inside = (u > p.low) & (u < p.high)
        assert np.all(np.abs(g[inside]) <= 1e-7 * (1.0 + rho) * np.sqrt(zero))


# -- certificates ----------------------------------------------------------------------------------


def test_distances_from_the_best_of_any_feasible_point(gen):
    """600 problems, feasible points from far to near: both certificates hold, and are reached."""
    largest = {"gap": 0.0, "multipliers": 0.0, "duality": 0.0}
    for p in draws(gen, 600):
        best = lc.solve(p)
        u = feasible(gen, p, best.u, 10.0 ** gen.uniform(-3, 1))
        D = lp.norm(u - best.u, p.H)
        J, scale = lp.objective(p, u), lp.objective(p, 0.0 * u)
        if 1e-4 * np.sqrt(scale) >= D:
            continue
        assert (J - best.objective) * (1.0 + 1e-9) + 1e-12 * scale >= D**2
        largest["duality"] = max(largest["duality"], D**2 / (J - best.objective))
        gap = lc.frank_wolfe_gap(p, u)
        largest["gap"] = max(largest["gap"], D / lc.gap_distance(gap) if gap > 0 else np.inf)
        w = np.maximum(lc.row_multipliers(p, best) * gen.uniform(0.5, 1.5), 0.0)
        for multipliers in (w, 0.0 * w, w + gen.random(len(w))):
            ratio = D / lc.multiplier_distance(p, u, multipliers)
            largest["multipliers"] = max(largest["multipliers"], ratio)
    assert 0.9 < largest["gap"] <= 1.0 + 1e-9
    assert 0.9999 < largest["multipliers"] <= 1.0 + 1e-9
    assert largest["duality"] > 0.9999


def test_without_limits_the_certificate_is_the_distance(gen):
    for _ in range(50):
        p = lp.one_step(gen.normal(size=(4, 3)), gen.normal(size=4), R=0.1)
        u = gen.normal(size=3)
        exactly(lc.multiplier_distance(p, u, []), lp.norm(u - lc.solve(p).u, p.H))
        # ||e||_{H^-1} <= 2 ||y||_Q if e = 2 G' Q y, also with R = 0
        y = gen.normal(size=4)
        assert lc.dual_norm(p, 2.0 * p.G.T @ y) <= 2.0 * np.linalg.norm(y)
        assert lc.dual_norm(p, y[:3]) <= np.sqrt(y[:3] @ y[:3] / 0.1)


def test_both_certificates_are_attained():
    """The best u is exactly at its limit without being held there: D = 1 at u = 0, both ways."""
    p, u = lp.one_step(ONE, [1.0], low=-1, high=1), np.array([0.0])
    exactly(lc.gap_distance(lc.frank_wolfe_gap(p, u)), 1.0)
    exactly(lc.multiplier_distance(p, u, [2.0, 0.0]), 1.0)
    exactly(lp.norm(u - lc.solve(p).u, p.H), 1.0)


def test_open_limits_need_multipliers():
    p = lp.one_step(ONE, [3.0], R=1, low=-np.inf, high=1)
    assert lc.frank_wolfe_gap(p, np.array([1.5 - 1e-9]) * 0.5) < np.inf  # towards the finite side
    open_up = p._replace(high=np.array([np.inf]), low=np.array([0.0]))
    assert lc.frank_wolfe_gap(open_up, np.array([1.0])) == np.inf
    exactly(lc.multiplier_distance(open_up, np.array([1.0]), [0.0]), np.sqrt(2) * 0.5)
    flat = lp.one_step([[1.0, 0.0]], [1.0])
    assert lc.dual_norm(flat, [0.0, 1.0]) == np.inf
    exactly(lc.dual_norm(flat, [2.0, 0.0]), 2.0)


def test_forward_clip(gen):
    """300 times: what it returns keeps all limits, it refuses only where a program finds nothing,
    and one pass without the look ahead would fail."""
    refused, needed = 0, 0
    for i in range(300):
        K, m = 5, 2
        middle = gen.normal(size=(K, m)).cumsum(axis=0)
        width = gen.uniform(0.1, 1.0, size=(K, m))
        low, high, rate = middle - width, middle + width, gen.uniform(0.5, 2.0, size=m)
        previous, u = gen.normal(size=m), 3.0 * gen.normal(size=(K, m))
        p = lp.several_steps(np.eye(2), np.eye(2), np.zeros(2), np.zeros(2), K, R=1,
                             low=low, high=high, rate=rate, previous=previous)  # fmt: skip
        short = lc.missing(p._replace(C=p.C[:0], c=p.c[:0]), p.C, p.c).amount
        try:
            v = lc.forward_clip(u, low, high, rate, previous)
        except ValueError:
            refused += 1
            assert short > 1e-12, i
            continue
        assert short <= 1e-12
        assert np.all(v >= low)
        assert np.all(v <= high)
        assert np.all(np.abs(np.diff(np.vstack([previous, v]), axis=0)) <= rate * (1 + 1e-12))
        np.testing.assert_allclose(lc.forward_clip(v, low, high, rate, previous), v, atol=1e-14)
        plain = [previous]
        for k in range(K):
            plain.append(np.clip(u[k], np.maximum(low[k], plain[-1] - rate),
                                 np.minimum(high[k], plain[-1] + rate)))  # fmt: skip
        needed += bool(np.any(np.abs(np.diff(plain, axis=0)) > rate * (1 + 1e-12)))
    assert refused > 50
    assert needed > 5


# -- populations -----------------------------------------------------------------------------------


def units(*gains):
    return [pop.unit([[a]], [1.0]) for a in gains]


def test_two_units_by_hand():
    pytest.importorskip("clarabel")
    s = pop.average(units(1, 2))
    exactly([*s.u, s.objective], [3 / 5, 1 / 10])
    w = pop.worst(units(1, 2))
    np.testing.assert_allclose([*w.u, w.value, w.lower_bound], [2 / 3, 1 / 3, 1 / 3], atol=1e-9)
    assert pop.support(units(1, 2), pop.worst) == [0, 1]
    limited = pop.worst(units(1, 2), -0.5, 0.5)
    np.testing.assert_allclose([*limited.u, limited.value], [0.5, 0.5], atol=1e-9)
    assert pop.support(units(1, 2), lambda v: pop.worst(v, -0.5, 0.5)) == [0]
    s = pop.average(units(0, 2))
    exactly([*s.u, s.objective], [0.5, 0.5])
    mean_squares = [np.mean(pop.misses(units(0, 2), np.array([u])) ** 2) for u in (1.0, 0.25)]
    exactly(mean_squares, [1.0, 5 / 8])  # the fused unit, the average of the units' controls


def test_copies_support_once():
    """Of copies one remains; asked one at a time against all, none would be needed."""
    pytest.importorskip("clarabel")
    fleet = units(1, 2, 1, 2, 1.5, 2)
    found = pop.support(fleet, pop.worst)
    assert sorted(fleet[i][0][0, 0] for i in found) == [1.0, 2.0]
    target = pop.worst(fleet)
    alone = [pop.same(pop.worst(fleet[:i] + fleet[i + 1 :]), target, 1e-6) for i in range(6)]
    assert all(alone)


def test_a_unit_on_top_that_no_input_moves():
    """Its multiplier is the only one, and yet it does not fix u: the support is larger."""
    pytest.importorskip("clarabel")
    dead = [pop.unit([[0.0]], [2.0], R=0.05)]
    w = pop.worst(dead + units(1, 2))
    assert w.shares[0] > 0.99
    fleet = [pop.unit([[a]], [b]) for a, b in ((0.0, 2.0), (1.0, 2.2), (1.0, -2.2))]
    w = pop.worst(fleet)
    np.testing.assert_allclose(w.value, 2.2, atol=1e-8)
    assert pop.support(fleet, pop.worst) == [1, 2]


def test_fleets_are_certified_over_all_units(gen):
    pytest.importorskip("clarabel")
    for i in range(sets(30, 6)):
        N, n, d = 20, 3, int(gen.integers(1, 4))
        fleet = [pop.unit(gen.normal(size=(n, d)) + np.eye(n, d), gen.normal(size=n), R=0.01)
                 for _ in range(N)]  # fmt: skip
        low, high = ((-0.3, 0.3), (-np.inf, np.inf), (0.0, np.inf))[i % 3]
        w = pop.worst(fleet, low, high)
        assert 0.0 <= w.value - w.lower_bound <= 1e-7 * w.value
        kept = pop.support(fleet, lambda v, a=low, b=high: pop.worst(v, a, b))
        assert 1 <= len(kept) <= d + 1
        for _ in range(20):  # nothing else is better
            u = np.clip(w.u + 0.1 * gen.normal(size=d), low, high)
            assert np.max(pop.misses(fleet, u)) >= w.lower_bound
        assert (
            pop.average(fleet, low, high).objective <= np.mean(pop.misses(fleet, w.u) ** 2) + 1e-12
        )


def test_the_mean_is_the_problem_of_the_mean_gram_matrix(gen):
    maps, targets, Q = gen.normal(size=(7, 3, 2)), gen.normal(size=(7, 3)), np.diag([1.0, 2, 3])
    s = pop.average([pop.unit(G, b, Q=Q, R=0.1) for G, b in zip(maps, targets, strict=True)])
    H = np.mean([G.T @ Q @ G for G in maps], axis=0) + 0.1 * np.eye(2)
    f = np.mean([G.T @ Q @ b for G, b in zip(maps, targets, strict=True)], axis=0)
    exactly(s.u, np.linalg.solve(H, f))


def test_discarding_lowers_the_value():
    pytest.importorskip("clarabel")
    gone, w = pop.discarded(units(1, 2, 1.5, 8), 1, pop.worst)
    assert gone == [3]
    np.testing.assert_allclose(w.value, 1 / 3, atol=1e-8)
    assert pop.misses(units(8), w.u)[0] > w.value
