"""The bounds for controls over limits: each on random problems of unlike kinds, and what fails.

`ratio` is the error over its bound: at most 1 to rounding, and near 1 somewhere, so the bounds are
not loose by a factor. A solver's own error D is a certified number near 1e-12 and left out.
"""

from __future__ import annotations

import numpy as np
import pytest

from coverage_study import sets
from limit_problems import weight
from twin import certified_control as cc
from twin import limit_bounds as lb
from twin import limited_control as lc
from twin import limited_problems as lp
from twin import regions as rg
from twin import triangle as tr

ONCE = 1.0 + 1e-9


class Ratios(dict):
    """The largest ratio of each name."""

    def see(self, name, error, bound):
        assert error <= bound * ONCE + 1e-13, (name, error, bound)
        if bound > 1e-9:
            self[name] = max(self.get(name, 0.0), error / bound)


# -- the map is uncertain --------------------------------------------------------------------------


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


# -- soft limits of the state ----------------------------------------------------------------------


def soft_best(G, c, xf, C, h, rho, more):
    """The best u with y = c + G u and the penalty, and the problem without it."""
    p = lp.one_step(G, xf - c, **more)
    s = lc.solve(lp.softened(p, C @ G, h - C @ c, rho))
    return p, s.u[: G.shape[1]], s.distance


# -- what fails ------------------------------------------------------------------------------------


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
