"""The inequalities behind the bounds of controls within limits, through the package; what fails.

`ratio` is the error over its bound: at most 1 to rounding in every problem.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from limit_plans import within
from limit_problems import draw_box, draw_map, draw_steps, weight
from stochens_rs import _core
from stochens_rs.certificates.of_model import ModelBasis
from stochens_rs.controls import bounds as limit_bound
from stochens_rs.controls.bounds import FIRM
from stochens_rs.exceptions import InputError
from stochens_rs.limits import problem as limited_errors
from stochens_rs.limits.problem import Horizon, Limited, checked_task
from stochens_rs.theory.exact import states
from test_bounds_coverage import exceeded_too_often, systems
from test_limit_bounds import Planned, drawn, errors_of, measured, onto
from twin import limit_bounds as lb
from twin import limited_control as lc
from twin import limited_problems as lp

ONCE = 1.0 + 1e-9


class Ratios(dict):
    """The largest ratio of each name."""

    def see(self, name, error, bound):
        assert error <= bound * ONCE + 1e-13, (name, error, bound)
        if 1e-9 < bound < np.inf:
            self[name] = max(self.get(name, 0.0), error / bound)


def steps_problem(gen, i):
    """A, B, x0, task: 1 to 4 steps, kinds and limits of all ways, R of any size."""
    A, B, x0, K, more = draw_steps(gen, i)
    K = 1 if i % 3 == 0 else K
    n, m = B.shape
    if i % 7 == 0:
        B = draw_map(gen, "plain", n, m)
    low, high = draw_box(
        gen, ("loose", "half", "tight", "one-sided", "fixed inputs")[i % 5], m, 1.0
    )
    Q = more["Q"] if K > 1 else None
    task = checked_task(
        n,
        m,
        K,
        gen.normal(size=n),
        limits=(low, high),
        cost=se.Cost(Q=Q, Qf=more["Qf"], R=more["R"]),
    )
    return A, B, x0, task


def value(task, A, B, x0, u):
    return Horizon(task, A, B).objective(x0, u)


def curvature(task):
    """The weight of the last state, with that of its soft limits."""
    if task.soft is None or task.state_low is None:
        return task.terminal
    limited = np.isfinite(task.state_low[-1]) | np.isfinite(task.state_high[-1])
    return task.terminal + task.soft * np.diag(limited.astype(float))


def test_a_moved_target():
    """600 problems, in `make test` 120: T1 with the projection and controls of the package."""
    gen, seen = np.random.default_rng(1), Ratios()
    for i in range(sets(600, 120)):
        A, B, x0, task = steps_problem(gen, i)
        K, n = task.steps, len(A)
        dx0, dr = 0.3 * gen.normal(size=n), 0.3 * gen.normal(size=n) * (i % 2)
        exact = Horizon(task, A, B)
        other = Horizon(replace(task, reference=task.reference + dr), A, B)
        best, moved = exact.solve(x0), other.solve(x0 + dx0)
        M, start, _ = exact.core.weighted()
        goal = np.vstack([*[exact.core.roots()[0]] * (K - 1), exact.core.roots()[1]])
        d = float(np.linalg.norm(onto(M) @ (goal @ dr - start @ dx0)))
        D, du = best.distance + moved.distance, (best.u - moved.u).ravel()
        if 1e-3 * d < D:
            continue  # nothing moves: rounding
        R = task.R[0, 0]
        seen.see("state", float(np.linalg.norm(M @ du)), d + D)
        seen.see("input", float(np.sqrt(R) * np.linalg.norm(du)), d / 2 + D)
        seen.see("control", float(np.linalg.norm(du)), (d + D) / np.sqrt(exact.core.least()))
        J, J_best = (value(other.task, A, B, x0 + dx0, u) for u in (best.u, moved.u))
        seen.see("excess", J - J_best, d**2 + best.gap + moved.gap + 1e-12 * J)
    assert all(0.9 < ratio <= ONCE for ratio in seen.values()), seen


def test_inexact_controls():
    """500 controls off the best, in `make test` 120: the distance by the gap (T3)."""
    gen, seen = np.random.default_rng(2), Ratios()
    for i in range(sets(500, 120)):
        A, B, x0, task = steps_problem(gen, i)
        exact = Horizon(task, A, B)
        best = exact.solve(x0)
        size = 10.0 ** gen.uniform(-3, 0)
        u = np.clip(best.u + size * gen.normal(size=best.u.shape), task.low, task.high)
        J = exact.objective(x0, u)
        gap, rest = exact.core.optimality(states(A, B, x0, u)[1:], u, 0.0)
        M, du = exact.core.weighted()[0], (u - best.u).ravel()
        D2 = float(np.sum((M @ du) ** 2) + task.R[0, 0] * np.sum(du**2))
        if rest == 0.0:
            seen.see("gap", 2 * D2, gap + 1e-9 * J)
            seen.see("value", J - best.objective, gap + 1e-12 * J)
    assert seen["gap"] > 0.5


def perturbed(gen, A, B, x0):
    """A true system near (A, B, x0), and the region that has nothing else."""
    size = 10.0 ** gen.uniform(-4, -0.5)
    dA, dB = size * gen.normal(size=A.shape), size * gen.normal(size=B.shape)
    truth = _core.Region(np.hstack([A + dA, B + dB]), B.shape[1], (), None, False)
    return A + dA, B + dB, x0 + size * gen.normal(size=len(x0)), truth


def test_an_uncertain_map():
    """700 problems, in `make test` 150, R from 1e-12 to 10, at the best control and off it."""
    gen, seen, finite, count = np.random.default_rng(3), Ratios(), 0, sets(700, 150)
    for i in range(count):
        A, B, x0, task = steps_problem(gen, i)
        if i % 4 == 1:
            task = replace(task, R=10.0 ** gen.uniform(-12, -6) * np.eye(B.shape[1]))
        true_A, true_B, start, model = perturbed(gen, A, B, x0)
        estimated = Horizon(task, A, B).solve(x0)
        exact = Horizon(task, true_A, true_B)
        best = exact.solve(start)
        u = estimated.u
        if i % 2:
            u = np.clip(
                u + 10.0 ** gen.uniform(-4, -1) * gen.normal(size=u.shape), task.low, task.high
            )
        x, xh = states(true_A, true_B, start, u)[1:], states(A, B, x0, u)[1:]
        W = np.stack([*[task.stage] * (len(u) - 1), task.terminal])
        alpha = float(np.sqrt(np.einsum("ki,kij,kj->", x - xh, W, x - xh)))
        found = Horizon(task, A, B).core.apart(model, xh, u, alpha, 0.0)
        M, du = exact.core.weighted()[0], (u - best.u).ravel()
        p, q = float(np.linalg.norm(M @ du)), float(np.sqrt(task.R[0, 0]) * np.linalg.norm(du))
        J = value(task, true_A, true_B, start, u)
        slack = best.distance + 1e-9 * alpha
        seen.see("state", p, found.state + slack)
        seen.see("weighted", q, found.weighted + slack)
        seen.see("distance", float(np.hypot(p, q)), found.distance + slack)
        seen.see(
            "control", float(np.linalg.norm(du)), found.control + slack / np.sqrt(task.R[0, 0])
        )
        seen.see("excess", J - best.objective, found.excess + best.gap + 1e-11 * J)
        finite += np.isfinite(found.control)
    assert finite > 0.92 * count
    assert all(0.3 < ratio <= ONCE for ratio in seen.values()), seen


def soft_best(A, B, x0, task):
    """The twin's best control with soft limits of the state, one step."""
    p = lp.one_step(
        B, task.reference[0] - A @ x0, Q=task.terminal, R=task.R, low=task.low[0], high=task.high[0]
    )
    n, c = len(A), A @ x0
    C = np.vstack([np.eye(n), -np.eye(n)])
    h = np.concatenate([task.state_high[0], -task.state_low[0]])
    keep = np.isfinite(h)
    s = lc.solve(lp.softened(p, C[keep] @ B, h[keep] - C[keep] @ c, task.soft))
    return s.u[None, : B.shape[1]], s.distance


def test_soft_limits_of_the_state():
    """500 problems, in `make test` 60: a moved start and target (T5), and an uncertain map."""
    gen, seen, used, count = np.random.default_rng(4), Ratios(), 0, sets(500, 60)
    for i in range(count):
        n, m = int(gen.integers(1, 4)), int(gen.integers(1, 3))
        A, B = (
            gen.normal(size=(n, n)),
            draw_map(gen, ("plain", "sparse", "zero columns")[i % 3], n, m),
        )
        x0, xf, dx0, dxf = gen.normal(size=(4, n)) * np.array(
            [[1.0], [1.0], [0.2], [0.2 * (i % 2)]]
        )
        high = np.where(gen.random(n) < 0.7, 0.3 * gen.normal(size=n), np.inf)
        task = checked_task(
            n,
            m,
            1,
            xf,
            limits=se.Limits(u=(-1, 1), x=(None, high), soft=10.0 ** gen.uniform(-1, 2)),
            cost=se.Cost(Q=weight(gen, n) + 1e-3 * np.eye(n), R=10.0 ** gen.uniform(-3, 1)),
        )
        u, D = soft_best(A, B, x0, task)
        used += bool(np.any(A @ x0 + B @ u[0] > high + 1e-6))
        other = replace(task, reference=task.reference + dxf)
        v, E = soft_best(A, B, x0 + dx0, other)
        Q, W = task.terminal, curvature(task)
        d = lp.norm(A @ dx0, W) + lp.norm(dxf, Q)
        du, slack = (u - v)[0], D + E + 1e-7 * d
        seen.see("moved state", lp.norm(B @ du, Q), d + slack)
        seen.see("moved input", lp.norm(du, task.R), d / 2 + slack)
        # the map
        true_A, true_B, start, model = perturbed(gen, A, B, x0)
        best, E = soft_best(true_A, true_B, start, task)
        x, xh = states(true_A, true_B, start, u)[1:], states(A, B, x0, u)[1:]
        alpha = lp.norm((x - xh)[0], W)
        found = Horizon(task, A, B).core.apart(model, xh, u, alpha, 0.0)
        du, slack = (u - best)[0], E + D + 1e-7 * d
        J, J_best = (value(task, true_A, true_B, start, w) for w in (u, best))
        seen.see("state", lp.norm(true_B @ du, Q), found.state + slack)
        seen.see("input", lp.norm(du, task.R), found.weighted + slack)
        seen.see("excess", J - J_best, found.excess + 1e-9 * J)
    assert used > 0.4 * count
    assert all(0.3 < ratio <= ONCE for ratio in seen.values()), seen


def test_limits_of_rates_have_a_gap_from_the_value():
    """300 problems, in `make test` 120: <J'(w), w - v> for every v within limits and rates."""
    gen, tight = np.random.default_rng(5), 0.0
    for i in range(sets(300, 120)):
        A, B, x0, K, more = draw_steps(gen, 2 * i + 1)
        n, m = B.shape
        limits = {"low": -1.0, "high": 1.0, "rate": more["rate"], "previous": np.zeros(m)}
        task = checked_task(
            n,
            m,
            K,
            np.zeros(n),
            limits=se.Limits(u=(-1, 1), rate=more["rate"], previous=np.zeros(m)),
            cost=se.Cost(Qf=more["Qf"], R=more["R"]),
        )
        p = lp.several_steps(A, B, x0, np.zeros((K, n)), K, Qf=more["Qf"], R=more["R"], **limits)
        best = lc.solve(p)
        other = lc.solve(p._replace(b=p.b + gen.normal(size=len(p.b)))).u
        size = 10.0 ** gen.uniform(-3, 0)
        u = (1 - size) * best.u + size * other  # within all limits
        slope = p.G.T @ p.Q @ (p.G @ u - p.b) + p.R @ u
        gap = lp.objective(p, u) - best.objective + 1e-12 * best.objective
        one = u.reshape(K, m)
        found, rest = Horizon(task, A, B).core.optimality(states(A, B, x0, one)[1:], one, gap)
        towards = 2.0 * slope @ (u - best.u)
        assert rest == 0.0
        assert towards <= found * ONCE + 1e-9 * lp.objective(p, 0 * u)
        tight = max(tight, towards / found if found else 0.0)
    assert tight > 0.1


# -- what the package says where there is no bound -------------------------------------------------


def one_row(B, b, **more):
    """x(1) = x0 + B u, x0 drawn: a sample of x0 = -b, so that b is its law's."""
    n = len(B)
    x0 = se.sample(-np.asarray(b, dtype=float), 5000, rng=1)
    return Planned(np.eye(n), np.asarray(B, dtype=float), x0, np.zeros(n), **more)


def test_without_weight_of_inputs_the_reason_is_said():
    """A singleton law with one entry is certain; so x0 has two, of which B reaches one."""
    B = [[1.0, 0.1], [0.0, 0.0]]
    found = one_row(B, [1.0, 1.0], limits=(-1, 1), R=0.0).bound()
    assert found.control == np.inf
    assert found["control"].method == "none"
    assert "more than one control" in found["control"].reason
    assert found.state < 0.1
    # well inside the limits the control of least norm is bounded, active or not with a weight
    planned = one_row(B, [1.0, 1.0], limits=(-9, 9), R=0.0)
    inside = planned.bound()
    off = np.linalg.norm(planned.limited.u[0] - np.linalg.pinv(B) @ -planned.predicted[0])
    np.testing.assert_allclose(inside.control, off + inside.state / np.hypot(1, 0.1), rtol=1e-6)
    weighted = one_row(B, [1.0, 1.0], limits=(-1, 1), R=1.0).bound()
    np.testing.assert_allclose(weighted.control, weighted.state / 2, rtol=1e-4)
    full = one_row([[0.5], [0.0]], [1.0, 1.0], limits=(-1, 1), R=0.0).bound()
    np.testing.assert_allclose(full.control, full.state / 0.5, rtol=1e-6)
    assert full["control"].reason is None


def test_hard_limits_of_the_state_have_no_bound():
    for K in (1, 2):
        planned, _ = drawn("nonnegative", 20, K, limits=(-1, 1))
        task = checked_task(
            6,
            2,
            K,
            planned.basis.xf.estimate,
            limits=se.Limits(u=(-1, 1), x=(None, 5.0), soft=False),
        )
        planned.limited = replace(planned.limited, task=task)
        found = planned.bound()
        assert (found.state, found.control, found.excess) == (np.inf,) * 3
        assert "hard limits of the states" in found["state"].reason


def test_a_known_error_is_the_error():
    A, B, x0, xf = systems()["nonnegative"]
    fit = se.fuse(se.sample(A, 300, rng=1), "alse", target=A)
    for K, more in ((1, {}), (3, {"Q": 1.0})):
        planned = Planned(fit, B, x0, xf, K, limits=(-0.1, 0.1), R=0.1, **more)
        found = planned.bound()
        exact = Horizon(planned.task, A, B)
        best = exact.solve(x0)
        M = exact.core.weighted()[0]
        error = np.linalg.norm(M @ (planned.limited.u - best.u).ravel())
        np.testing.assert_allclose(found.state, error, atol=1e-7)
        np.testing.assert_allclose(
            found.control, np.linalg.norm(planned.limited.u - best.u), atol=1e-6
        )
        assert found.kind == "certain"
        assert "targets of the fits" in found.assumption
        assert found["state"].method == "exact error"
        J = [value(exact.task, A, B, x0, u) for u in (planned.limited.u, best.u)]
        assert J[0] - J[1] <= found.excess <= J[0] - J[1] + 1e-9


@pytest.mark.parametrize("K", [1, 3])
def test_too_small_a_probability_to_simulate_takes_a_formula(K):
    delta = 1e-7
    for more in ({"R": 1.0}, {"R": "auto"}):
        planned, system = drawn("nonnegative", 10**6, K, limits=(-0.5, 0.5), Q=1.0, **more)
        found, usual = planned.bound(delta), planned.bound(0.1)
        assert found["state"].method == (FIRM if K == 1 else "uncertain map")
        assert usual.state < found.state
        if more["R"] == 1.0:
            assert found.state < 100 * usual.state
            gen = np.random.default_rng(1)
            state, control, excess = errors_of(gen, system, planned.task, 10**6, K, 50)
            assert state.max() < found.state
            assert control.max() < found.control
            assert excess.max() < found.excess


def test_half_of_the_bounds_is_exceeded_too_often():
    for K in (1, 3):
        planned, system = drawn("random walk", 30, K, limits=(-0.5, 0.5), Q=1.0, R=1e-3)
        found = planned.bound(0.1)
        state, control, excess = errors_of(
            np.random.default_rng(2), system, planned.task, 30, K, 200
        )
        assert exceeded_too_often(state, found.state / 2, 0.1)
        if K > 1:
            assert exceeded_too_often(control, found.control / 2, 0.1)
            assert exceeded_too_often(excess, found.excess / 4, 0.1)


def test_the_drawn_excess_has_the_slope_at_the_best_control(monkeypatch):
    """``J(u) - J(v) = <J'(v), u - v> + ||u - v||_H^2``; means within 5 standard errors (1e-6)."""
    seen, radii = [], limit_bound.radii

    def keeping(errors, delta, key):
        seen.append((errors, key))
        return radii(errors, delta, key)

    monkeypatch.setattr(limit_bound, "radii", keeping)
    planned, system = drawn("Gaussian", 10, 3, limits=(-0.05, 0.05), Q=1.0, R=0.1)
    planned.bound(0.1)
    errors, key = seen[0]
    state, control, excess = errors.draw(4000, key).T
    curved = state**2 + 0.1 * control**2
    assert np.all(excess >= curved * (1 - 1e-9))
    theirs = errors_of(np.random.default_rng(3), system, planned.task, 10, 3, 300)[2]
    spread = np.hypot(theirs.std() / np.sqrt(300), excess.std() / np.sqrt(4000))
    assert abs(excess.mean() - theirs.mean()) < 5 * spread
    assert theirs.mean() - curved.mean() > 10 * spread  # without the slope it would be noticed


def test_an_uncertain_map_is_not_a_moved_target():
    """Several steps with A drawn, bounded as if the map were exact: exceeded too often."""
    A, B = np.array([[0.0, 2.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    law = np.array([[0.1, 2.0], [0.1, 0.1]]) + 0.0 * A
    x0, xf = np.array([1.0, 1.0]), np.array([3.0, 0.0])
    some = se.sample(law, 30, rng=1)
    planned = Planned(some, B, x0, xf, 2, limits=(-2.0, 2.0), R=0.1)
    exact = Horizon(replace(planned.task, R=planned.limited.R), law, B)
    errors = limit_bound.plan_errors(planned.basis, 2, "product")
    wrong = limited_errors.MovedTarget(errors, exact).draw(2000, se.rng.as_key(1))[:, 0]
    right = limited_errors.LimitedErrors(errors, exact, planned.limited, False).draw(
        2000, se.rng.as_key(1)
    )[:, 0]
    assert exceeded_too_often(right, np.quantile(wrong, 0.9), 0.1)


# -- limits of the state that a true system keeps --------------------------------------------------


def test_tightened_limits_are_those_of_the_twin(gen):
    n, K = 2, 3
    task = checked_task(n, 1, K, np.zeros(n), limits=se.Limits(x=(-1.0, [2.0, np.inf]), soft=False))
    radii = np.array([0.0, 0.1, 0.2, 0.3])
    same = np.broadcast_to(radii[:, None], (K + 1, n))
    tight = limit_bound.tightened(task, same)
    C, h = np.vstack([np.eye(n), -np.eye(n)]), np.array([2.0, np.inf, 1.0, 1.0])
    wanted = lb.tightened(C, h, radii[1:])
    np.testing.assert_allclose(tight.state_high, wanted[:, :2])
    np.testing.assert_allclose(-tight.state_low, wanted[:, 2:])
    at = np.zeros((K + 1, n))
    assert limit_bound.lacking(task, at, same) == 0.0
    at[3, 0] = 1.9
    np.testing.assert_allclose(limit_bound.lacking(task, at, same), 0.2)


def test_a_control_that_cannot_keep_the_limits_says_by_how_much(gen):
    """Limits that the tube keeps; and limits nearer to each other than the tube is wide."""
    A, B = np.array([[0.9, 0.2], [0.0, 0.8]]), np.array([[0.0], [1.0]])
    model = measured(gen, A, B, 60, 0.1)
    x0, xf = np.array([1.0, 1.0]), np.zeros(2)
    basis = ModelBasis(model, x0, xf)
    for band, status in (((-1.0, 10.0), "optimal"), ((0.5, 0.51), "infeasible")):
        task = checked_task(
            2, 1, 2, xf, limits=se.Limits(u=(-1, 1), x=band, soft=False), cost=se.Cost(R=1.0)
        )
        plain = Horizon(replace(task, state_low=None, state_high=None), model.A, model.B).solve(x0)
        first: Limited = replace(plain, task=task)
        found, bound = limit_bound.within_state_limits(basis, first, 0.1)
        assert found.status == status
        at = states(model.A, model.B, x0, found.u)
        np.testing.assert_allclose(
            found.missing, limit_bound.lacking(task, at, bound["bands"].radius)
        )
        assert found.task is task
        if status == "optimal":
            truth = states(A, B, x0, found.u)
            assert truth.max() <= band[1]
        else:
            assert found.missing > 0.1


def test_a_time_limit_ends_the_search_for_limits_that_the_tube_keeps(gen):
    A, B = np.array([[0.9, 0.2], [0.0, 0.8]]), np.array([[0.0], [1.0]])
    model = measured(gen, A, B, 60, 0.1)
    x0, xf = np.array([1.0, 1.0]), np.zeros(2)
    basis = ModelBasis(model, x0, xf)
    # without a margin the first state is at its limit
    task = checked_task(
        2,
        1,
        2,
        np.ones(2),
        limits=se.Limits(u=(-1, 1), x=(-1.0, 0.98), soft=False),
        cost=se.Cost(R=1e-3),
    )
    first = Horizon(task, model.A, model.B).solve(x0)
    found, bound = limit_bound.within_state_limits(basis, first, 0.1, 0.0)
    assert found.status == "user_limit"
    assert np.array_equal(found.u, first.u)
    at = states(model.A, model.B, x0, found.u)
    assert found.missing == limit_bound.lacking(task, at, bound["bands"].radius) > 0.0
    for limit in (None, 60.0):
        done, _ = limit_bound.within_state_limits(basis, first, 0.1, limit)
        assert done.status != "user_limit"
        assert done.missing < found.missing
    more = {"limits": (-1, 1), "state_limits": (-1.0, 0.98), "soft": False}
    plan = se.control(model, x0, xf, steps=2, time_limit=1e-9, **within(**more))
    assert plan.status == "user_limit"
    assert plan.limited.missing > 0.0


# -- through the face ------------------------------------------------------------------------------


def test_plans_bound_their_controls_within_limits(gen):
    A, B, x0, xf = systems()["nonnegative"]
    start = se.sample(x0, 100, rng=1)
    for fusion in ("product", "diagonal"):
        some = se.sample(A, 100, rng=2), B
        plan = se.control(some, start, se.sample(xf, 100, rng=3), fusion=fusion, limits=(-0.1, 0.1))
        found = plan.bound(0.1)
        assert found["state"].method == FIRM
        free = se.control(some, start, se.sample(xf, 100, rng=3), fusion=fusion).bound(0.1)
        np.testing.assert_allclose(found.state, free.state, rtol=1e-6)
        assert plan.error(se.System(A, B), x0, xf).state <= found.state
        if fusion == "diagonal":
            with pytest.raises(InputError, match="paired realizations"):
                plan.bound(1e-9)
    reference = np.tile(xf, (3, 1))
    plan = se.control(
        some, start, None, steps=2, limits=(-0.1, 0.1), cost=se.Cost(reference=reference, R=0.1)
    )
    found = plan.bound(0.1)
    assert found["state"].method == "simulated"
    assert found["target"].distance_from == "the reference"
    assert "simulated" in found._repr_html_()
    assert plan.error(se.System(A, B), x0, None).state <= found.state
    wide = se.control(
        some, start, xf, steps=2, limits=(-0.1, 0.1), cost=se.Cost(Q=2.0, R=0.1)
    ).bound(0.1)
    assert {wide[name].distance_from for name in ("target", "state")} == {
        "xf, in the norm of Q",
        "where the best control within the limits leads, in the norm of Q",
    }
    model = measured(gen, A, B, 100, 0.01)
    plan = se.control(model, x0, xf, steps=2, limits=(-0.1, 0.1), cost=se.Cost(R=0.1))
    found = plan.bound(0.1)
    error = plan.error(se.System(A, B), x0, xf)
    assert error.state <= found["states"].radius
    assert error.control <= found.control
    assert found.excess < 1.0
