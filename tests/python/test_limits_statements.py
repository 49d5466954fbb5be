"""The bounds for controls over limits: each on random problems of unlike kinds, and what fails.

`ratio` is the error over its bound: at most 1 to rounding, and near 1 somewhere, so the bounds are
not loose by a factor. A solver's own error D is a certified number near 1e-12 and left out.
"""

from __future__ import annotations

import numpy as np
import pytest

from coverage_study import sets
from limit_problems import draw_map, draw_steps, draws, feasible, weight
from twin import certified_control as cc
from twin import limit_bounds as lb
from twin import limited_control as lc
from twin import limited_problems as lp
from twin import regions as rg
from twin import triangle as tr
from twin.laws import scipy

ONCE = 1.0 + 1e-9


class Ratios(dict):
    """The largest ratio of each name."""

    def see(self, name, error, bound):
        assert error <= bound * ONCE + 1e-13, (name, error, bound)
        if bound > 1e-9:
            self[name] = max(self.get(name, 0.0), error / bound)


# -- the map is exact ------------------------------------------------------------------------------


def test_a_moved_target():
    """1000 problems. State by ||db||_Q and by its projection, input by half of that, in ||.||_H."""
    gen, seen = np.random.default_rng(1), Ratios()
    for i, p in enumerate(draws(gen, sets(1000, 200))):
        best = lc.solve(p)
        db = 10.0 ** gen.uniform(-2, 1) * gen.normal(size=len(p.b))
        if i % 3 == 0:  # along the range of the map, where the bound is sharp
            db = p.G @ gen.normal(size=len(p.low)) * 0.1
        other = lc.solve(p._replace(b=p.b + db))
        du, D = best.u - other.u, best.distance + other.distance
        if max(D, 1e-7 * lp.norm(p.b, p.Q)) > 1e-3 * lp.norm(db, p.Q):
            continue  # nothing moves: rounding
        state, size = lp.norm(p.G @ du, p.Q), lp.norm(du, p.R)
        whole, part = lp.norm(db, p.Q), lb.projected(p, db)
        assert state**2 + size**2 <= -(p.G @ du) @ p.Q @ db + 1e-9 * whole**2 + 10.0 * D * whole
        seen.see("state", state, lb.moved_target(part, D).state)
        seen.see("distance", lp.norm(du, p.H), lb.moved_target(part, D).distance)
        seen.see("input", size, lb.moved_target(part, D).input)
        seen.see("whole", state, lb.moved_target(whole, D).state)
    assert all(0.99 < ratio <= ONCE for ratio in seen.values()), seen


def test_a_moved_target_without_weight_of_inputs():
    """200 problems of any rank, R = 0: the state bound, and the input's where it is finite."""
    gen, seen, kinds = np.random.default_rng(2), Ratios(), {"full": 0, "inside": 0, "none": 0}
    for p in draws(gen, 200):
        d = min(len(p.low), 3)
        p = p._replace(G=p.G[:, :d], E=np.zeros((0, d)), t=np.zeros(0), low=p.low[:d],
                       high=p.high[:d], C=np.zeros((0, d)))  # fmt: skip
        if np.linalg.norm(p.G) == 0.0 or np.linalg.cond(p.G) > 1e3 > np.linalg.cond(p.G, -2):
            continue
        p = p._replace(Q=np.eye(len(p.b)))
        db = 10.0 ** gen.uniform(-2, 0) * gen.normal(size=len(p.b))
        u, v = lc.by_enumeration(p), lc.by_enumeration(p._replace(b=p.b + db))
        delta = lb.projected(p, db)
        seen.see("state", lp.norm(p.G @ (u - v), p.Q), delta * (1 + 1e-9) + 1e-10)
        bound = lb.input_without_weight(p, u, delta)
        full = np.linalg.matrix_rank(p.G) == d
        kinds["full" if full else "inside" if np.isfinite(bound) else "none"] += 1
        if np.isfinite(bound):
            seen.see("input", float(np.linalg.norm(u - v)), bound * (1 + 1e-9) + 1e-9)
    assert min(kinds.values()) >= 5, kinds
    assert all(0.99 < ratio <= ONCE for ratio in seen.values()), seen


def test_several_steps_with_moved_start_and_reference():
    """500 problems of 2 to 4 steps, with rate limits and penalties on changes."""
    gen, seen = np.random.default_rng(3), Ratios()
    for i in range(sets(500, 150)):
        A, B, x0, K, more = draw_steps(gen, i)
        n = len(A)
        r, dr, dx0 = (
            gen.normal(size=(K, n)),
            0.3 * gen.normal(size=(K, n)),
            0.3 * gen.normal(size=n),
        )
        if i % 3 == 0:
            dr = 0.0 * dr
        p, q = (lp.several_steps(A, B, *data, K, **more) for data in ((x0, r), (x0 + dx0, r + dr)))
        u, v = lc.solve(p), lc.solve(q)
        du, D = u.u - v.u, u.distance + v.distance
        Q = np.zeros((n, n)) if more["Q"] is None else more["Q"]
        weights = [*[Q] * (K - 1), more["Qf"]]
        delta = lb.start_and_reference(A, weights, dx0, dr)
        np.testing.assert_allclose(delta, lp.norm(p.b - q.b, p.Q), rtol=1e-9, atol=1e-12)
        sizes = np.linalg.norm(dr, axis=1)
        radii = lb.start_and_reference_radii(A, weights, float(np.linalg.norm(dx0)), sizes)
        seen.see("radii", delta, radii)
        seen.see("state", lp.norm(p.G @ du, p.Q), lb.moved_target(delta, D).state + 1e-8 * delta)
        seen.see("input", lp.norm(du, p.R), lb.moved_target(delta, D).input + 1e-8 * delta)
    assert all(0.9 < ratio <= ONCE for ratio in seen.values()), seen


def test_bounds_in_the_two_norm_need_a_definite_weight():
    assert lb.in_two_norm(3.0, np.diag([4.0, 9.0])) == 1.5
    assert lb.in_two_norm(3.0, np.diag([4.0, 0.0])) == np.inf


# -- the map is uncertain --------------------------------------------------------------------------


def test_one_input_with_a_wrong_gain_by_hand():
    true, model = lp.one_step([[1.0]], [1.0], R=1), lp.one_step([[2.0]], [1.0], R=1)
    u, best = lc.solve(model).u, lc.solve(true).u
    np.testing.assert_allclose([u[0], best[0]], [0.4, 0.5])
    alpha, c = lb.map_error(true, model, u)
    gamma = lb.in_inverse(c, true.R)
    np.testing.assert_allclose([alpha, gamma], [0.4, 0.2])
    np.testing.assert_allclose(lp.norm(u - best, true.H), np.sqrt(2) / 10)
    assert np.sqrt(2) / 10 <= lb.uncertain_map(alpha, gamma).distance < 0.4 + 0.2


def moved_map(gen, p, index):
    """A true map near the map of `p`: in all entries, along one column, or hardly."""
    dG = 10.0 ** gen.uniform(-3, 0) * gen.normal(size=p.G.shape)
    if index % 3 == 0:
        dG *= gen.random(dG.shape) < 0.3
    db = 10.0 ** gen.uniform(-3, 0) * gen.normal(size=len(p.b)) * (index % 2)
    return p._replace(G=p.G + dG, b=p.b + db)


def test_an_uncertain_map():
    """1000 problems, in `make test` 150, at the best point and at any other, with its gap."""
    gen, seen = np.random.default_rng(4), Ratios()
    for i, model in enumerate(draws(gen, sets(1000, 150))):
        if not np.all(np.isfinite([model.low, model.high])):
            model = model._replace(low=np.maximum(model.low, -9), high=np.minimum(model.high, 9))
        true, estimated = moved_map(gen, model, i), lc.solve(model)
        best = lc.solve(true)
        u = estimated.u if i % 2 else feasible(gen, model, estimated.u, 10.0 ** gen.uniform(-3, 0))
        gap = max(lc.frank_wolfe_gap(model, u), 0.0)
        alpha, c = lb.map_error(true, model, u)
        found = lb.uncertain_map(alpha, lb.in_inverse(c, true.R), gap)
        du, slack = u - best.u, best.distance + 1e-9 * (alpha + np.sqrt(gap))
        D = lp.norm(du, true.H)
        seen.see("state", lp.norm(true.G @ du, true.Q), found.state + slack)
        seen.see("input", lp.norm(du, true.R), found.input + slack)
        seen.see("distance", D, found.distance + slack)
        seen.see("value", lp.objective(true, u) - best.objective,
                 found.value + 1e-12 * lp.objective(true, 0.0 * u))  # fmt: skip
        if i % 2:
            crude = lb.uncertain_map_best(alpha, lb.in_inverse(c, true.R))
            seen.see("crude", D, crude + slack)
            assert found.distance <= crude + slack + np.sqrt(gap)
        radius = np.linalg.norm(lp.root(true.Q) @ (true.G - model.G), 2)
        small = lb.uncertain_map_small_weight(model, alpha, float(np.linalg.norm(c)), radius, gap)
        if np.isfinite(small):
            seen.see("small weight", D, small + slack)
        # the regret form, at the best estimated point against any other feasible point
        other = feasible(gen, model, u)
        away = lb.map_error(true, model, estimated.u)[0], lb.map_error(true, model, other)[0]
        N = lb.root_value(true, estimated.u)
        size = 1e-9 * lb.root_value(true, 0.0 * u)
        seen.see("achieved", N, lb.root_value(model, estimated.u) + away[0] + size)
        seen.see("regret", N, lb.root_value(true, other) + sum(away) + size)
    assert all(0.9 < ratio <= ONCE for ratio in seen.values()), seen


def test_without_a_moved_map_it_is_the_bound_for_a_moved_target():
    found = lb.uncertain_map(0.7, 0.0)
    assert found[:3] == lb.moved_target(0.7)[:3] == (0.7, 0.35, 0.7)


def region_of(gen, n, m):
    data = tr.triangle(gen.normal(size=(30, n + m)), gen.normal(size=(30, n)))
    region = rg.full(data, 0.05)
    H = gen.normal(size=(n, n + m)) * np.sqrt(1.0 / (n + m))
    fitted = region.fitted._replace(H=H)
    return region._replace(fitted=fitted, factor=region.factor * 10.0 ** gen.uniform(-4, 0))


def member(gen, region):
    """A Theta on the border of the region: ||S^(-1/2) (Theta - C) V^(1/2)||_2^2 = f."""
    n, d = region.fitted.H.shape
    U, _, Vt = np.linalg.svd(gen.normal(size=(n, d)), full_matrices=False)
    size = np.ones(n) if gen.random() < 0.5 else np.eye(n)[0]
    Gamma = np.sqrt(region.factor) * (U * size) @ Vt
    return region.fitted.H + np.linalg.cholesky(region.S) @ Gamma @ region.fitted.white


def test_one_step_of_a_region():
    """500 members of regions: alpha and gamma hold and are attained, and so do the bounds of u."""
    gen, seen = np.random.default_rng(5), Ratios()
    for i in range(sets(500, 150)):
        n, m = int(gen.integers(1, 4)), int(gen.integers(1, 3))
        region = region_of(gen, n, m)
        if i % 2:
            S = weight(gen, n)
            region = region._replace(S=S / np.linalg.norm(S, 2))
        Theta, Q, R = member(gen, region), weight(gen, n), 10.0 ** gen.uniform(-2, 1) * np.eye(m)
        H, x0, xf = region.fitted.H, gen.normal(size=n), gen.normal(size=n)
        far = gen.random(2) * 0.3 * (i % 2)
        dx0, dxf = (
            r * x / np.linalg.norm(x) for r, x in zip(far, gen.normal(size=(2, n)), strict=True)
        )
        limits = {"Q": Q, "R": R, "low": -0.5, "high": 0.5}
        model = lp.one_step(H[:, n:], xf - H[:, :n] @ x0, **limits)
        true = lp.one_step(Theta[:, n:], xf + dxf - Theta[:, :n] @ (x0 + dx0), **limits)
        u, best = lc.solve(model), lc.solve(true)
        alpha, c = lb.map_error(true, model, u.u)
        bounds = lb.region_step(region, x0, u.u, xf, Q=Q, R=R, rho0=far[0], rhof=far[1])
        seen.see("alpha", alpha, bounds[0])
        seen.see("gamma", lb.in_inverse(c, R), bounds[1])
        found = lb.uncertain_map(*bounds, max(u.gap, 0.0))
        seen.see("state", lp.norm(true.G @ (u.u - best.u), Q), found.state + best.distance)
        seen.see("input", lp.norm(u.u - best.u, R), found.input + best.distance)
        seen.see("value", lp.objective(true, u.u) - best.objective, found.value + 1e-12)
        # the member that attains them
        root = np.linalg.cholesky(region.S) * np.sqrt(region.factor)
        z = region.fitted.white @ np.concatenate([x0, u.u])
        left = np.linalg.svd(lp.root(Q) @ root)[2][0]
        worst = root @ np.outer(left, z / np.linalg.norm(z)) @ region.fitted.white
        exact = lb.region_step(region, x0, u.u, xf, Q=Q, R=R)
        attained = lp.norm(worst @ np.concatenate([x0, u.u]), Q)
        np.testing.assert_allclose(attained, exact[0], rtol=1e-8)
        r = Q @ (model.G @ u.u - model.b)
        top = np.linalg.svd(np.linalg.solve(lp.root(R), region.fitted.white[:, n:].T))[2][0]
        away = root.T @ r
        worst = root @ np.outer(away / np.linalg.norm(away), top) @ region.fitted.white
        attained = lb.in_inverse(worst[:, n:].T @ r, R)
        np.testing.assert_allclose(attained, exact[1], rtol=1e-8)
    assert max(seen["alpha"], seen["gamma"]) > 0.95
    assert all(0.3 < ratio <= ONCE for ratio in seen.values()), seen


def test_several_steps_of_a_region():
    """300 members: the costates bound c; the bounds hold for the true system's best inputs."""
    gen, seen = np.random.default_rng(6), Ratios()
    for _ in range(sets(300, 60)):
        n, m, K = int(gen.integers(1, 4)), int(gen.integers(1, 3)), int(gen.integers(1, 5))
        region = region_of(gen, n, m)
        region = region._replace(factor=region.factor * 0.1)
        H, Theta, r = region.fitted.H, member(gen, region), gen.normal(size=(K, n))
        x0, Q, R = gen.normal(size=n), weight(gen, n), 10.0 ** gen.uniform(-2, 1) * np.eye(m)
        more = {"Q": Q, "R": R, "low": -0.5, "high": 0.5}
        model = lp.several_steps(H[:, :n], H[:, n:], x0, r, K, **more)
        true = lp.several_steps(Theta[:, :n], Theta[:, n:], x0, r, K, **more)
        u, best = lc.solve(model), lc.solve(true)
        spectral = np.sqrt(region.factor)
        inputs = u.u.reshape(K, m)
        steps = cc.several_steps(region.fitted, x0, inputs, spectral=spectral, S=region.S)
        bounds = lb.region_steps(region, steps.radii[1:], steps.states[1:] - r, [Q] * K, R)
        alpha, c = lb.map_error(true, model, u.u)
        seen.see("alpha", alpha, bounds[0])
        seen.see("gamma", lb.in_inverse(c, true.R), bounds[1])
        found = lb.uncertain_map(*bounds, max(u.gap, 0.0))
        seen.see("state", lp.norm(true.G @ (u.u - best.u), true.Q), found.state + best.distance)
        seen.see("input", lp.norm(u.u - best.u, true.R), found.input + best.distance)
        seen.see("value", lp.objective(true, u.u) - best.objective, found.value + 1e-12)
        if K == 1:
            np.testing.assert_allclose(
                bounds[1], lb.region_step(region, x0, u.u, r[0], Q=Q, R=R)[1], rtol=1e-9
            )
    assert seen["alpha"] > 0.9
    assert seen["gamma"] > 0.9
    assert all(0.2 < ratio <= ONCE for ratio in seen.values()), seen


def scalar_region(A, B, a, b):
    """The region |Theta - (A, B)| in an ellipse of half axes a and b."""
    white = np.diag([a, b])
    fitted = tr.Fitted(np.array([[A, B]]), np.eye(1), 9, 2, white, np.linalg.inv(white),
                       np.zeros((2, 0)), 1.0)  # fmt: skip
    return rg.Region(fitted, 1.0, np.eye(1), 0.05, "by hand")


def test_costates_of_one_state_by_hand():
    """Where all the error is in A, the bound of c is attained; with both, their product counts."""
    one = [np.eye(1)] * 3
    region = scalar_region(2.0, 1.0, 0.5, 1e-9)
    gamma = lb.region_steps(region, np.zeros(3), [[1.0], [1.0], [1.0]], one, np.eye(1))[1]
    p, q = [7.0, 3.0, 1.0], [1 + 2.5 * 3.5, 3.5, 1.0]  # costates for A = 2 and for A = 2.5
    np.testing.assert_allclose(gamma, np.linalg.norm(np.subtract(q, p)), rtol=1e-6)
    region = scalar_region(0.0, 0.0, 3.0, 1.0)
    gamma = lb.region_steps(region, np.zeros(2), [[0.0], [1.0]], one[:2], np.eye(1))[1]
    A, B = 3.0 / np.sqrt(2), 1.0 / np.sqrt(2)  # on the border; c = (B A, B)
    assert 1.0 < np.hypot(B * A, B) <= gamma
    np.testing.assert_allclose(gamma, np.hypot(3.0, 1.0))


def test_directions_that_the_data_do_not_show_have_no_bound():
    Z = np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [1.0, 0.0]])  # the input was never used
    region = rg.full(tr.triangle(Z, np.array([[1.0], [2.1], [2.9], [1.05]])), 0.05)
    assert lb.region_step(region, [1.0], [0.5], [0.0], R=1.0) == (np.inf, np.inf)
    assert lb.region_step(region, [1.0], [0.0], [0.0], R=1.0)[0] < np.inf


# -- soft limits of the state ----------------------------------------------------------------------


def soft_problem(gen, i):
    n, d = int(gen.integers(1, 5)), int(gen.integers(1, 4))
    Q, rho = weight(gen, n) + 1e-3 * np.eye(n), 10.0 ** gen.uniform(-1, 3)
    C = gen.normal(size=(int(gen.integers(1, 4)), n))
    if i % 4 == 0:
        C = np.eye(n)[:1]
    G = draw_map(gen, ("plain", "sparse", "zero columns")[i % 3], n, d)
    more = {"Q": Q, "R": 10.0 ** gen.uniform(-4, 1), "low": -1.0, "high": 1.0}
    return G, Q, C, 0.3 * gen.normal(size=len(C)), rho, more


def soft_best(G, c, xf, C, h, rho, more):
    """The best u with y = c + G u and the penalty, and the problem without it."""
    p = lp.one_step(G, xf - c, **more)
    s = lc.solve(lp.softened(p, C @ G, h - C @ c, rho))
    return p, s.u[: G.shape[1]], s.distance


def test_soft_limits_with_a_moved_start():
    """700 problems, most of them beyond their soft limits."""
    gen, seen, used = np.random.default_rng(7), Ratios(), 0
    count = sets(700, 150)
    for i in range(count):
        G, Q, C, h, rho, more = soft_problem(gen, i)
        n = len(Q)
        c, xf, dc, dxf = gen.normal(size=(4, n)) * np.array([[1.0], [1.0], [0.3], [0.3]])
        dxf *= i % 2
        if i % 5 == 0:
            dc = 0.1 * G @ gen.normal(size=G.shape[1])
        p, u, D = soft_best(G, c, xf, C, h, rho, more)
        _, v, E = soft_best(G, c + dc, xf + dxf, C, h, rho, more)
        used += bool(np.any(C @ (c + G @ u) > h + 1e-6))
        delta = lb.soft_change(dc, dxf, Q, C, rho)
        assert delta <= lb.soft_price(Q, C, rho) * lp.norm(dc, Q) * ONCE + lp.norm(dxf, Q)
        bound, tiny = lb.moved_target(delta, D + E), 1e-7 * delta
        seen.see("state", lp.norm(G @ (u - v), Q), bound.state + tiny)
        seen.see("input", lp.norm(u - v, p.R), bound.input + tiny)
    assert used > 0.55 * count
    assert all(0.9 < ratio <= ONCE for ratio in seen.values()), seen


def test_soft_limits_with_an_uncertain_map():
    """800 problems: distance and value, the gap that of the penalized estimated problem."""
    gen, seen = np.random.default_rng(8), Ratios()
    for i in range(sets(800, 150)):
        G, Q, C, h, rho, more = soft_problem(gen, i)
        if i % 5 == 0:
            Q = more["Q"] = weight(gen, len(Q), max(1, len(Q) // 2))  # singular
        c, xf, dc = gen.normal(size=(3, len(Q)))
        dG = 10.0 ** gen.uniform(-3, 0) * gen.normal(size=G.shape)
        dc *= 10.0 ** gen.uniform(-3, -1) * (i % 2)
        p, u, _ = soft_best(G, c, xf, C, h, rho, more)
        if i % 3 == 0:
            u = feasible(gen, p, u, 0.1)
        true, best, D = soft_best(G + dG, c + dc, xf, C, h, rho, more)
        y, model = c + dc + (G + dG) @ u, c + G @ u
        g = lp.gradient(p, u) + 2.0 * rho * G.T @ C.T @ np.maximum(0.0, C @ model - h)
        gap = max(lc.box_gap(g, u, p.low, p.high), 0.0)
        alpha, moved = lb.soft_map_error(y, model, dG, xf, Q, C, h, rho)
        found = lb.uncertain_map(alpha, lb.in_inverse(moved, p.R), gap)
        du, slack = u - best, D + 1e-8 * alpha
        seen.see("state", lp.norm(true.G @ du, Q), found.state + slack)
        seen.see("input", lp.norm(du, p.R), found.input + slack)
        seen.see("distance", lp.norm(du, true.H), found.distance + slack)

        def value(v, moved_start=c + dc, gains=G + dG, target=xf, rows=(Q, C, h, rho), R=p.R):
            x = moved_start + gains @ v
            over = np.maximum(0.0, rows[1] @ x - rows[2])
            return lp.norm(x - target, rows[0]) ** 2 + lp.norm(v, R) ** 2 + rows[3] * over @ over

        seen.see("value", value(u) - value(best), found.value + 1e-9 * value(0.0 * u))
    assert all(0.95 < ratio <= ONCE for ratio in seen.values()), seen


def test_tightened_limits_hold_in_the_whole_ball(gen):
    C, h, radii = gen.normal(size=(3, 2)), np.ones(3), np.array([0.1, 0.5])
    tight = lb.tightened(C, h, radii)
    for k, r in enumerate(radii):
        for i in range(3):
            x = C[i] / (C[i] @ C[i]) * tight[k, i]  # on the tightened limit
            worst = x + r * C[i] / np.linalg.norm(C[i])
            np.testing.assert_allclose(C[i] @ worst, h[i])


# -- what fails ------------------------------------------------------------------------------------


@pytest.mark.parametrize("d", [0.5, 0.1, 0.01])
def test_without_weight_the_least_norm_control_may_move_fast(d):
    """B = [1, d], |u| <= 1: the second input runs with 1 / d; neither 1/2 nor ||B^+|| bounds it."""
    b = np.array([1.0 + d**2 + 0.4 * (d - d**2), 1.0 + d**2 + 0.6 * (d - d**2)])
    p = lp.one_step([[1.0, d]], b[:1], low=-1, high=1)
    u, v = (lc.by_enumeration(p._replace(b=np.array([x]))) for x in b)
    np.testing.assert_allclose([u[0], v[0]], 1.0)
    np.testing.assert_allclose((v - u)[1] / (b[1] - b[0]), 1.0 / d, rtol=1e-9)
    assert lb.input_without_weight(p, u, b[1] - b[0]) == np.inf


def test_no_active_limit_is_not_enough():
    """B = [1, 0.1]: no limit is active at b = 1, and at b = 1.1 the control is far away."""
    p = lp.one_step([[1.0, 0.1]], [1.0], low=-1, high=1)
    u, v = lc.by_enumeration(p), lc.by_enumeration(p._replace(b=np.array([1.1])))
    assert np.all(np.abs(u) < 1.0)
    np.testing.assert_allclose(np.linalg.norm(u - v), 0.9010, atol=1e-4)
    inverse = np.linalg.norm(np.linalg.pinv(p.G), 2)
    assert np.linalg.norm(u - v) > 9 * inverse * 0.1
    assert lb.input_without_weight(p, u, 0.1) == np.inf
    np.testing.assert_allclose(lb.input_without_weight(p, u, 0.005), inverse * 0.005)


@pytest.mark.parametrize("N", [16, 64, 256])
def test_the_oblique_cone_has_no_continuous_choice(N):
    """conv of a circle at height 1 and (1, 0, 0): a step of 2 pi / N along the circle lifts u by 1.

    With N points of the circle it is a polytope; the constant grows with N, in the limit u jumps.
    """
    angles = 2.0 * np.pi * np.arange(N) / N
    points = np.column_stack([np.cos(angles), np.sin(angles), np.ones(N)])
    points = np.vstack([points, [1.0, 0.0, 0.0]])

    def height(b):  # the least norm among all u with these two coordinates: the lowest
        rows = np.vstack([points[:, :2].T, np.ones(N + 1)])
        found = scipy().optimize.linprog(points[:, 2], A_eq=rows, b_eq=[*b, 1.0], bounds=(0, None))
        return found.fun

    jump = height(points[1, :2]) - height(points[0, :2])
    np.testing.assert_allclose(jump, 1.0, atol=1e-6)
    assert jump / np.linalg.norm(points[1, :2] - points[0, :2]) > 0.9 * N / (2.0 * np.pi)


@pytest.mark.parametrize("eps", [0.1, 0.001])
def test_hard_state_limits_have_no_bound_and_soft_ones_do(eps):
    """B = (1, eps), x_2 <= 0: a start moved by 1e-3 moves the state by that over eps."""
    B, xf, C, h, rho = (
        np.array([[1.0], [eps]]),
        np.array([1e4, 0.0]),
        np.array([[0.0, 1.0]]),
        0.0,
        100.0,
    )
    dx0 = np.array([0.0, 1e-3])

    def hard(x0):
        p = lp.one_step(B, xf - x0)
        return lc.solve(lp.with_rows(p, C @ B, h - C @ x0)).u

    ratio = np.linalg.norm(B @ (hard(dx0) - hard(0.0 * dx0))) / 1e-3
    np.testing.assert_allclose(ratio, np.hypot(1.0, eps) / eps, rtol=1e-6)
    _, u, _ = soft_best(B, dx0, xf, C, np.zeros(1), rho, {})
    _, v, _ = soft_best(B, 0.0 * dx0, xf, C, np.zeros(1), rho, {})
    soft = np.linalg.norm(B @ (u - v)) / 1e-3
    assert soft <= lb.soft_price(np.eye(2), C, rho) * (1 + 1e-6)
    # the plain norm of dx0 would be too little where the penalty acts
    if eps == 0.1:
        assert soft > 1.0


def test_averages_of_clipped_controls_are_biased(gen):
    b = np.array([0.0, 4.0])
    each = [lc.solve(lp.one_step([[1.0]], [x], low=-1, high=1)).u[0] for x in b]
    mean = lc.solve(lp.one_step([[1.0]], [b.mean()], low=-1, high=1)).u[0]
    assert np.mean(each) == 0.5
    assert mean == 1.0
    # without limits both are the same; with them more realizations do not help
    draws_of_b = 2.0 + 2.0 * gen.normal(size=100_000)
    assert abs(np.mean(np.clip(draws_of_b, -1, 1)) - np.clip(draws_of_b.mean(), -1, 1)) > 0.3


def test_an_uncertain_map_needs_both_terms_and_a_weight():
    """G = (e, 0), G^ = (e, d), b = (0, 1): the state errs by e / d times alpha without the rest."""
    e, d = 1e-2, 1e-5
    true, model = (lp.one_step(G, [0.0, 1.0], R=1e-12) for G in ([[e], [0.0]], [[e], [d]]))
    u, best = lc.solve(model).u, lc.solve(true).u
    alpha, c = lb.map_error(true, model, u)
    state = np.linalg.norm(true.G @ (u - best))
    assert state > 500 * alpha
    assert state <= lb.uncertain_map(alpha, lb.in_inverse(c, true.R)).state
    small = lb.uncertain_map_small_weight(model, alpha, float(np.linalg.norm(c)), d)
    assert state <= small * ONCE
    # and as the weight goes to 0 its term grows without limit
    gammas = [lb.in_inverse(c, np.array([[R]])) for R in (1e-4, 1e-8, 1e-12)]
    np.testing.assert_allclose(np.array(gammas[1:]) / gammas[:-1], 100.0)


def test_inputs_that_are_whole_numbers_jump():
    """U = {-1, 0, 1} is not convex: b from 0.49 to 0.51 moves the state by 1."""
    choices = np.array([-1.0, 0.0, 1.0])
    u, v = (choices[np.argmin((choices - b) ** 2)] for b in (0.49, 0.51))
    assert abs(u - v) > 10 * lb.moved_target(0.02).state


def test_a_solver_error_does_not_just_add_up_when_the_map_is_uncertain():
    """D of the estimated problem is in another norm: a true gain of 100 makes it 100 times larger.

    G^ = 0 and R tiny: u~ is nearly best for the model (gap 4 R), but 100 away for the true map.
    """
    model, true = (lp.one_step([[g]], [0.0], R=1e-6, low=-1, high=1) for g in (0.0, 100.0))
    u = np.array([1.0])
    alpha, c = lb.map_error(true, model, u)
    gap = lc.frank_wolfe_gap(model, u)
    D = lc.gap_distance(gap)
    state = np.linalg.norm(true.G @ (u - lc.solve(true).u))
    assert D <= 2e-3
    assert state <= lb.uncertain_map(alpha, lb.in_inverse(c, true.R), gap).state
    exact = lb.map_error(true, model, lc.solve(model).u)[0]
    assert state > exact + D  # the bound at the exact point plus D is wrong
