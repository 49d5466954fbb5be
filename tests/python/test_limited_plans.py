"""Plans within limits: estimates and models, errors, realizations, sizes."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from limit_plans import WAYS, check, draw_case, exactly, within
from limit_problems import draw_box, draw_map, weight
from twin import limited_control as lc
from twin import limited_problems as lp

# -- estimates and models --------------------------------------------------------------------------


def test_estimates_are_controlled_as_their_values(gen):
    A, B = 0.5 * gen.normal(size=(3, 3)), gen.normal(size=(3, 2))
    x0, xf = gen.normal(size=(2, 3))
    drawn, start = se.sample(A, 200, rng=1), se.sample_counts(x0, 200, rng=2)
    goal = se.fuse(se.sample(xf, 200, rng=3))
    plan = se.control((drawn, B), start, goal, steps=4, limits=(-0.3, 0.2))
    same = se.control((drawn.mean(), B), start.estimate, goal.estimate, steps=4, limits=(-0.3, 0.2))
    assert plan.u.tobytes() == same.u.tobytes()
    free = se.control((drawn, B), start, goal, steps=4)
    assert plan.reachability == free.reachability  # what no input reaches, however large
    assert np.all((plan.u >= -0.3) & (plan.u <= 0.2))


def test_a_model_with_an_offset(gen):
    A, B, c = np.array([[0.9, 0.2], [0.0, 0.8]]), np.array([[0.0], [1.0]]), np.array([0.3, -0.2])
    x, u = gen.normal(size=(60, 2)), gen.normal(size=(60, 1))
    noise = 0.01 * gen.normal(size=(60, 2))
    data = se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + c + noise)
    model = se.identify(data, intercept=True, noise=se.Noise(design="independent"))
    x0, xf, K = np.array([1.0, 2.0]), np.array([0.5, 0.0]), 5
    plan = se.control(model, x0, xf, steps=K, limits=(-0.4, 0.1), cost=se.Cost(Q=1.0, R=0.1))
    drift, at = [], np.zeros(2)
    for _ in range(K):
        at = model.A @ at + model.c
        drift.append(at)
    wanted = xf - np.array(drift)
    p = lp.several_steps(model.A, model.B, x0, wanted, K, Q=1.0, R=0.1, low=-0.4, high=0.1)
    check(plan, p)
    states = [x0]
    for inputs in plan.u:
        states.append(model.A @ states[-1] + model.B @ inputs + model.c)
    np.testing.assert_allclose(plan.predicted_states, states, rtol=1e-12)


# -- the plan --------------------------------------------------------------------------------------


def test_the_error_is_the_distance_from_the_limited_best(gen):
    for i in range(30):
        A, B, x0, K, low, high, weights = draw_case(gen, i, steps=(1, 2, 4))
        xf, other = gen.normal(size=len(A)), A + 0.1 * gen.normal(size=A.shape)
        drawn = se.control((other, B), x0, xf, steps=K, **within(limits=(low, high), **weights))
        error = drawn.error((A, B), x0, xf)
        p = lp.several_steps(A, B, x0, xf, K, low=low, high=high, **weights)
        best, n = lc.solve(p), len(A)
        wrong = drawn.u.ravel() - best.u
        last = p.G[-n:]
        size = 1e-6 * (1.0 + np.linalg.norm(wrong))
        np.testing.assert_allclose(error.control, np.linalg.norm(wrong), atol=size)
        assert abs(error.control - np.linalg.norm(wrong)) <= error.control_rounding + size
        np.testing.assert_allclose(error.state, np.linalg.norm(last @ wrong), atol=size)
        np.testing.assert_allclose(
            error.objective, lp.objective(p, drawn.u.ravel()) - best.objective, atol=1e-8, rtol=1e-6
        )
        off = np.linalg.norm(drawn.states((A, B), x0)[-1] - xf)
        assert off <= error.state + error.residual + 1e-9
    assert "objective" in error._repr_html_()


@pytest.mark.parametrize("R", ["auto", 0.0])
def test_an_input_without_effect_leaves_no_state_to_round(R):
    still = se.System([[0.5, 0.1], [0.0, 0.5]], [[0.0], [0.0]])
    plan = se.control(
        still, [1.0, 1.0], [0.0, 0.0], steps=3, limits=(-1.0, 1.0), cost=se.Cost(Q=[1, 0], R=R)
    )
    error = plan.error(still, [1.0, 1.0], [0.0, 0.0])
    assert (error.state, error.state_rounding, error.control) == (0.0, 0.0, 0.0)


# -- one control per realization -------------------------------------------------------------------


def test_realization_controls_are_those_of_each_target(gen):
    for i in range(30):
        n, m, N = int(gen.integers(1, 5)), int(gen.integers(1, 10)), 10
        A, B = gen.normal(size=(n, n)), draw_map(gen, ("plain", "sparse")[i % 2], n, m)
        x0, xf = gen.normal(size=(2, n))
        drawn, start = se.sample(A, N, rng=i), se.sample(x0, N, rng=i + 100)
        low, high = draw_box(gen, WAYS[i % 5], m, 1.0)
        Q, R = (weight(gen, n) if i % 3 else None), (0.1 if i % 2 else weight(gen, m) + np.eye(m))
        out = np.empty((N, m))
        found = se.realization_controls(
            (drawn, B), start, xf, out=out, limits=(low, high), cost=se.Cost(Q=Q, R=R)
        )
        assert found is out
        for s, (a, x) in enumerate(zip(drawn.dense(), start.dense(), strict=True)):
            p = lp.one_step(B, xf - a @ x, Q=Q, R=R, low=low, high=high)
            J, best = lp.objective(p, out[s]), lc.solve(p).objective
            assert np.all((out[s] >= low) & (out[s] <= high))
            assert best + 1e-8 * (1.0 + lp.objective(p, 0.0 * out[s])) >= J


def test_weights_alone_are_ridge_regression(gen):
    A, B, x0, xf = gen.normal(size=(3, 3)), gen.normal(size=(3, 2)), *gen.normal(size=(2, 3))
    drawn = se.sample(A, 20, rng=1)
    u = se.realization_controls((drawn, B), x0, xf, cost=se.Cost(R=0.5))
    b = xf - drawn.dense() @ x0
    np.testing.assert_allclose(u, np.linalg.solve(B.T @ B + 0.5 * np.eye(2), B.T @ b.T).T)
    plan = se.control((A, B), x0, xf, cost=se.Cost(R=0.5))
    np.testing.assert_allclose(plan.u[0], np.linalg.solve(B.T @ B + 0.5 * np.eye(2),
                                                          B.T @ (xf - A @ x0)))  # fmt: skip


# -- sampling --------------------------------------------------------------------------------------


def test_sizes_hold_within_limits():
    """500 plans, in `make test` 150, of the size that is found: at most delta are too far."""
    system = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0, 0.0], [0.5, 1.0]])
    x0, xf, limits = [1.0, 2.0], [0.5, 0.0], (-0.7, 0.5)
    found = se.required_samples(system, x0, xf, 0.3, relative=False, rng=1)
    off = [
        se.steer(system, x0, xf, found.simulated_size, limits=limits, rng=i).error(system, x0, xf)
        for i in range(sets(500, 150))
    ]
    active = np.mean([error.residual > 0.1 for error in off])
    assert active == 1.0  # the limits keep the best control from the target
    far = np.mean([error.state > 0.3 for error in off])
    assert far <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / len(off))


# -- order and units -------------------------------------------------------------------------------


def test_order_and_units_do_not_matter(gen):
    for i in range(60):
        A, B, x0, K, low, high, weights = draw_case(gen, i, steps=(1, 3))
        n, m = B.shape
        xf, R = gen.normal(size=n), gen.uniform(0.1, 1.0, size=m)
        more = weights | {"R": R}
        u = se.control((A, B), x0, xf, steps=K, **within(limits=(low, high), **more)).u
        order = gen.permutation(m)
        permuted = se.control(
            (A, B[:, order]),
            x0,
            xf,
            steps=K,
            **within(limits=(low[..., order], high[..., order]), **more | {"R": R[order]}),
        )
        np.testing.assert_allclose(permuted.u, u[:, order], atol=1e-7 * (1 + np.abs(u).max()))
        units = 2.0 ** gen.integers(-4, 5, size=m)
        scaled = se.control(
            (A, B / units),
            x0,
            xf,
            steps=K,
            **within(limits=(low * units, high * units), **more | {"R": R / units**2}),
        )
        np.testing.assert_allclose(scaled.u / units, u, atol=1e-7 * (1 + np.abs(u).max()))
        larger = se.control(
            (A, B), 4.0 * x0, 4.0 * xf, steps=K, **within(limits=(4.0 * low, 4.0 * high), **more)
        )
        np.testing.assert_allclose(larger.u / 4.0, u, atol=1e-7 * (1 + np.abs(u).max()))


def test_paired_realizations_give_the_control_of_their_average(gen):
    A, B = 0.5 * gen.normal(size=(3, 3)), gen.normal(size=(3, 2))
    x0, xf = gen.normal(size=(2, 3))
    drawn, start = se.sample(A, 30, rng=1), se.sample(x0, 30, rng=2)
    limits = (-0.2, 0.2)
    plan = se.control((drawn, B), start, xf, fusion="diagonal", limits=limits, cost=se.Cost(R=0.1))
    free = np.mean([a @ x for a, x in zip(drawn.dense(), start.dense(), strict=True)], axis=0)
    p = lp.one_step(B, xf - free, R=0.1, low=-0.2, high=0.2)
    check(plan, p)
    exactly(plan.predicted_states[1], free + B @ plan.u[0])
    each = se.realization_controls((drawn, B), start, xf, limits=limits, cost=se.Cost(R=0.1))
    assert np.linalg.norm(each.mean(axis=0) - plan.u[0]) > 1e-3  # the average is another control
