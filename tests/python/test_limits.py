"""Controls within limits: known answers, the plain twin, errors, the plan and its records."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import stochens_rs as se
from limit_problems import draw_box, draw_map, weight
from stochens_rs import _core
from stochens_rs.controls.limited import LONG, Horizon
from stochens_rs.exceptions import InputError, InputTypeError, ShapeError
from stochens_rs.reference import limited_control as lc
from stochens_rs.reference import limited_problems as lp
from stochens_rs.theory.exact import best_control, factors
from test_hostile import NEVER, PERHAPS

ONE = [[1.0]], [[1.0]]  # x(k+1) = x(k) + u(k)
TWO = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]])  # the double integrator
INPUTS = np.zeros((2, 2)), np.array([[1.0, 1.0], [0.0, 1.0]])  # x(1) = B u


def exactly(a, b):
    np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


# -- known answers ---------------------------------------------------------------------------------


def test_one_input_by_hand():
    exactly(se.control(ONE, [0.0], [3.0], R=1.0).u, [[1.5]])
    plan = se.control(ONE, [0.0], [3.0], R=1.0, limits=(-1.0, 1.0))
    exactly([plan.u[0, 0], plan.objective, plan.multipliers[0, 0], plan.missed], [1, 5, 2, 0.5])
    assert (plan.active.tolist(), plan.limits_active, plan.status) == ([[1]], True, "optimal")
    assert 0.0 <= plan.gap <= 1e-15
    other = se.control(ONE, [0.0], [1.0], R=1.0, limits=(-1.0, 1.0))
    exactly(other.u, [[0.5]])
    assert (other.missed, other.limits_active) == (0.0, False)
    # ||B (u - u')||_Q^2 + ||u - u'||_R^2 <= <B (u - u'), b - b'>_Q
    moved = plan.u - other.u
    assert 2.0 * np.sum(moved**2) <= moved[0, 0] * 2.0


def test_two_inputs_without_weight_by_hand():
    free = se.control(INPUTS, [0.0, 0.0], [2.0, 0.0])
    exactly(free.u, [[2.0, 0.0]])
    plan = se.control(INPUTS, [0.0, 0.0], [2.0, 0.0], limits=(-1.0, 1.0), R=0.0)
    exactly(plan.u, [[1.0, 0.5]])
    exactly([plan.objective, *plan.multipliers[0]], [0.5, 1.0, 0.0])


def test_two_steps_of_the_double_integrator_by_hand():
    ends = [1.0, 0.0], [0.0, 0.0]
    exactly(se.control(TWO, *ends, steps=2).u.ravel(), [-1.0, 1.0])
    plan = se.control(TWO, *ends, steps=2, limits=(-0.5, 0.5), R=0.0)
    exactly([*plan.u.ravel(), plan.objective, plan.missed], [-0.5, 0.5, 0.25, 0.25])
    exactly(plan.predicted_states, [[1.0, 0.0], [1.0, -0.5], [0.5, 0.0]])


def test_two_steps_with_a_limit_on_changes_by_hand():
    plan = se.control(TWO, [1.0, 0.0], [0.0, 0.0], steps=2, limits=(-0.5, 0.5), rate=0.5,
                      previous=[0.0], R=0.0)  # fmt: skip
    np.testing.assert_allclose([*plan.u.ravel(), plan.objective], [-0.4, 0.1, 0.45], atol=1e-8)
    assert plan.status == "optimal"


def test_state_limits_that_cannot_be_kept_by_hand():
    plan = se.control(ONE, [3.0], [0.0], limits=(-1.0, 1.0), state_limits=(None, 1.0), soft=False)
    assert plan.status == "infeasible"
    np.testing.assert_allclose([plan.limited.missing, plan.u[0, 0]], [1.0, -1.0], atol=1e-8)


def test_regulating_step_by_step_by_hand():
    x, inputs, multipliers = np.array([5.0]), [], []
    for _ in range(6):
        plan = se.control(ONE, x, [0.0], limits=(-1.0, 1.0), Q=1.0, R=1.0)
        inputs.append(plan.u[0, 0])
        multipliers.append(plan.multipliers[0, 0])
        x = plan.predicted_states[-1]
    exactly(inputs, [-1.0, -1.0, -1.0, -1.0, -0.5, -0.25])
    exactly(multipliers, [6.0, 4.0, 2.0, 0.0, 0.0, 0.0])


def test_wide_limits_change_nothing(gen):
    for i in range(40):
        n, m, K = gen.integers(1, 5), gen.integers(1, 4), int(gen.integers(1, 6))
        system = gen.normal(size=(n, n)) / np.sqrt(n), gen.normal(size=(n, m))
        x0, xf = gen.normal(size=(2, n))
        free = se.control(system, x0, xf, steps=K)
        if m * K > n or free.reachability.condition > 1e3:
            continue  # R = 0 has more than one best control; or rounding is more than 1e-12
        plan = se.control(system, x0, xf, steps=K, limits=(-1e6, 1e6), R=0.0)
        np.testing.assert_allclose(plan.u, free.u, rtol=1e-12, atol=1e-12, err_msg=str(i))
        assert not plan.limits_active
        assert plan.error(system, x0, xf).state <= 1e-12


def test_without_limits_no_bit_changes():
    A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0], [0.5]])
    x0, xf = np.array([1.0, 2.0]), np.array([0.5, 0.0])
    drawn, start = se.sample(A, 50, rng=1), se.sample(x0, 50, rng=2)
    for K in (1, 3, 7):
        old = best_control(A, B, x0, xf, K)
        plan = se.control((A, B), x0, xf, steps=K)
        assert plan.u.tobytes() == old.u.tobytes()
        fused = se.control((drawn, B), start, xf, steps=K)
        old = best_control(drawn.mean(), B, start.mean(), xf, K)
        assert fused.u.tobytes() == old.u.tobytes()
        for made in (plan, fused):
            assert made.limited is None
            assert made.active is made.gap is made.objective is made.missed is None
            assert made.status == "completed"
    inverse, out = factors(B).inverse, np.empty((50, 1))
    needed = xf, drawn._core_realizations()
    _core.realization_controls(out, False, inverse, start._core_realizations(), *needed, False, 1)
    assert se.realization_controls((drawn, B), start, xf).tobytes() == out.tobytes()


# -- against the plain twin ------------------------------------------------------------------------

WAYS = ("half", "tight", "one-sided", "fixed inputs", "loose")


def draw_case(gen, i, steps=(1, 2, 3, 5, 20)):
    """A system, and the arguments of `control` and of the twin."""
    n, m, K = int(gen.integers(1, 5)), int(gen.integers(1, 4)), steps[i % len(steps)]
    A = gen.normal(size=(n, n))
    A *= gen.uniform(0.5, 1.05) / max(1e-3, np.max(np.abs(np.linalg.eigvals(A))))
    B = draw_map(gen, ("plain", "sparse", "zero columns", "ill-conditioned")[i % 4], n, m)
    low, high = draw_box(gen, WAYS[i % 5], K * m if i % 2 else m, 1.0)
    if i % 2:
        low, high = low.reshape(K, m), high.reshape(K, m)
    weights = {
        "Q": None if i % 3 == 0 else weight(gen, n) if i % 3 == 1 else gen.uniform(0, 2, size=n),
        "Qf": weight(gen, n) + 0.1 * np.eye(n) if i % 4 else None,
        "R": np.diag(gen.uniform(0.5, 2, m)) + 0.3 if i % 2 else 10.0 ** gen.uniform(-3, 0),
    }
    return A, B, 3.0 * gen.normal(size=n), K, low, high, weights


def check(plan, p, tolerance=1e-8):
    """The plan is as good as the twin's answer, and what it says of itself is true."""
    best, size = lc.solve(p), np.sqrt(lp.objective(p, np.zeros(len(p.low)))) + 1e-6
    u, shape = plan.u.ravel(), plan.u.shape
    assert plan.status == "optimal"
    assert np.all(u >= p.low)
    assert np.all(u <= p.high)
    assert lp.norm(u - best.u, p.H) <= tolerance * size
    assert lp.norm(u - best.u, p.H) <= plan.limited.distance + best.distance + 1e-13 * size
    J = lp.objective(p, u)
    np.testing.assert_allclose(plan.objective, J, rtol=1e-9, atol=1e-12 * size**2)
    assert best.objective >= J - plan.gap - 1e-12 * size**2
    np.testing.assert_allclose(plan.missed, best.missed, rtol=1e-6, atol=1e-9 * size**2)
    assert np.array_equal(plan.limits_active, plan.active.any())
    fixed = p.low == p.high
    side = np.where(u >= p.high, 1, np.where(u <= p.low, -1, 0))
    assert np.array_equal(plan.active.ravel()[~fixed], side[~fixed])
    assert plan.multipliers.shape == plan.active.shape == shape
    return best


def test_boxes_equal_the_twin(gen):
    """250 problems of up to 60 inputs, with limits per input, and per input and step."""
    for i in range(250):
        A, B, x0, K, low, high, weights = draw_case(gen, i)
        xf = gen.normal(size=len(A))
        plan = se.control((A, B), x0, xf, steps=K, limits=(low, high), **weights)
        p = lp.several_steps(A, B, x0, xf, K, low=low, high=high, **weights)
        best = check(plan, p)
        size = 1e-6 * (1.0 + np.max(np.abs(best.multipliers)))
        np.testing.assert_allclose(
            plan.multipliers.ravel(), np.abs(best.multipliers), atol=size, err_msg=str(i)
        )


def test_references_equal_the_twin(gen):
    for i in range(60):
        A, B, x0, K, low, high, weights = draw_case(gen, i)
        reference = gen.normal(size=(K + 1, len(A)))
        plan = se.control((A, B), x0, steps=K, limits=(low, high), reference=reference, **weights)
        p = lp.several_steps(A, B, x0, reference[1:], K, low=low, high=high, **weights)
        check(plan, p)
        error = plan.error((A, B), x0)
        assert error.control <= 1e-6 * (1.0 + np.linalg.norm(plan.u))
        assert plan.limited.task.follows


def test_long_horizons_equal_condensed_ones(gen):
    """250 and more inputs go by a recursion: the same problem in blocks of fewer inputs."""
    for K, n, m, way in ((260, 2, 1, "half"), (150, 3, 2, "tight"), (100, 2, 3, "one-sided")):
        A = 0.98 * np.linalg.qr(gen.normal(size=(n, n)))[0]
        B, x0, xf = gen.normal(size=(n, m)), 5.0 * gen.normal(size=n), np.zeros(n)
        low, high = draw_box(gen, way, m, 0.3)
        more = {"Q": 1.0, "R": 0.1}
        plan = se.control((A, B), x0, xf, steps=K, limits=(low, high), **more)
        assert plan.limited.task.steps * m >= LONG
        p = lp.several_steps(A, B, x0, xf, K, low=low, high=high, **more)
        u = plan.u.ravel()
        assert plan.status == "optimal"
        assert plan.limits_active
        assert np.all((u >= p.low) & (u <= p.high))
        if way != "one-sided":
            assert lc.frank_wolfe_gap(p, u) <= 1e-9 * lp.objective(p, 0.0 * u)
        short = Horizon(plan.limited.task, A, B)
        M, state, target = short.weighted()
        dense = _core.box_control(M, target - state @ x0, short.cost(), p.low, p.high, None, None)
        assert lp.norm(dense.control - u, p.H) <= plan.limited.distance + dense.distance + 1e-9
        np.testing.assert_allclose(plan.objective, dense.objective, rtol=1e-9)


def test_soft_state_limits_equal_the_twin(gen):
    """100 problems, also with limits of some states, one side of them or one step only."""
    beyond = 0
    for i in range(100):
        A, B, x0, K, low, high, weights = draw_case(gen, i, steps=(1, 2, 3, 5))
        n, soft = len(A), 10.0 ** gen.uniform(-1, 3)
        xf, (below, above) = gen.normal(size=n), draw_box(gen, WAYS[i % 5], K * n, 1.0)
        below, above = below.reshape(K, n), above.reshape(K, n)
        plan = se.control((A, B), x0, xf, steps=K, limits=(low, high), soft=soft,
                          state_limits=(below, above), **weights)  # fmt: skip
        p = lp.several_steps(A, B, x0, xf, K, low=low, high=high, **weights)
        each = [lp.state_rows(A, B, x0, K, side * np.eye(n), side * limit)
                for side, limit in ((1.0, above), (-1.0, below))]  # fmt: skip
        C, c = (np.concatenate(parts) for parts in zip(*each, strict=True))
        C, c = C[np.isfinite(c)], c[np.isfinite(c)]
        u = plan.u.ravel()

        def total(u, p=p, C=C, c=c, soft=soft):
            return lp.objective(p, u) + soft * np.sum(np.maximum(0.0, C @ u - c) ** 2)

        size = total(0.0 * u) + 1e-6
        best = lc.solve(lp.softened(p, C, c, soft)).u[: len(u)]
        assert plan.status == "optimal"
        np.testing.assert_allclose(plan.objective, total(u), rtol=1e-9, atol=1e-12 * size)
        assert total(best) >= plan.objective - plan.gap - 1e-12 * size
        assert lp.norm(u - best, p.H) <= plan.limited.distance + 1e-6 * np.sqrt(size)
        free = lc.solve(p._replace(low=0 * u - np.inf, high=0 * u + np.inf)).objective
        np.testing.assert_allclose(plan.missed, plan.objective - free, atol=1e-8 * size)
        beyond += bool(np.any(C @ u - c > 1e-3))
    assert beyond > 30


def test_soft_limits_that_are_kept_cost_nothing():
    free = se.control(TWO, [1.0, 0.0], [0.0, 0.0], steps=3, R=1.0)
    plan = se.control(TWO, [1.0, 0.0], [0.0, 0.0], steps=3, R=1.0, state_limits=(-9.0, 9.0))
    np.testing.assert_allclose(plan.u, free.u, atol=1e-9)
    assert plan.missed <= 1e-12
    far = se.control(TWO, [1e6, 0.0], [1e6, 0.0], steps=3, R=1.0, state_limits=(None, [1e6 - 1, 1]))
    assert abs(far.predicted_states[-1, 0] - 1e6 + 1) < 0.1  # the weight is 1000 times that of xf


def test_rates_equal_the_twin(gen):
    """100 problems with limits on changes; some also with hard limits of states."""
    held, infeasible = 0, 0
    for i in range(100):
        A, B, x0, K, low, high, weights = draw_case(gen, i, steps=(2, 3, 5))
        n, m = B.shape
        xf, rate = gen.normal(size=n), gen.uniform(0.1, 1.0, size=m)
        previous = np.clip(np.zeros(m), np.atleast_2d(low)[0], np.atleast_2d(high)[0])
        low, high = (
            np.broadcast_to(low, (K, m)).min(axis=0),
            np.broadcast_to(high, (K, m)).max(axis=0),
        )
        more = {"rate": rate, "previous": previous, **weights}
        room = {"state_limits": (-2.0, 2.0), "soft": False} if i % 4 == 3 else {}
        plan = se.control((A, B), x0, xf, steps=K, limits=(low, high), **more, **room)
        p = lp.several_steps(A, B, x0, xf, K, low=low, high=high, **more)
        if room:
            C = np.vstack([np.eye(n), -np.eye(n)])
            rows = lp.state_rows(A, B, x0, K, C, 2.0 * np.ones(2 * n))
            missing = lc.missing(p, *rows).amount
            np.testing.assert_allclose(plan.limited.missing, missing, atol=1e-6 * (1 + missing))
            if missing > 1e-6:
                assert plan.status == "infeasible"
                infeasible += 1
                continue
            p = lp.with_rows(p, *rows)
        best, u = lc.solve(p), plan.u.ravel()
        size = np.sqrt(lp.objective(p, 0.0 * u)) + 1e-3
        assert plan.status == "optimal"
        assert np.all((u >= p.low) & (u <= p.high))
        assert np.all(p.C @ u <= p.c + 1e-7 * size)
        assert lp.norm(u - best.u, p.H) <= plan.limited.distance + 1e-6 * size
        np.testing.assert_allclose(plan.objective, best.objective, atol=1e-7 * size**2)
        np.testing.assert_allclose(plan.missed, best.missed, atol=1e-6 * size**2)
        held += bool(np.any(best.rows > 1e-6))
    assert held > 30
    assert infeasible > 3


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


def test_paired_realizations_give_the_control_of_their_average(gen):
    A, B = 0.5 * gen.normal(size=(3, 3)), gen.normal(size=(3, 2))
    x0, xf = gen.normal(size=(2, 3))
    drawn, start = se.sample(A, 30, rng=1), se.sample(x0, 30, rng=2)
    limits = (-0.2, 0.2)
    plan = se.control((drawn, B), start, xf, fusion="diagonal", limits=limits, R=0.1)
    free = np.mean([a @ x for a, x in zip(drawn.dense(), start.dense(), strict=True)], axis=0)
    p = lp.one_step(B, xf - free, R=0.1, low=-0.2, high=0.2)
    check(plan, p)
    exactly(plan.predicted_states[1], free + B @ plan.u[0])
    each = se.realization_controls((drawn, B), start, xf, limits=limits, R=0.1)
    assert np.linalg.norm(each.mean(axis=0) - plan.u[0]) > 1e-3  # the average is another control


def test_a_model_with_an_offset(gen):
    A, B, c = np.array([[0.9, 0.2], [0.0, 0.8]]), np.array([[0.0], [1.0]]), np.array([0.3, -0.2])
    x, u = gen.normal(size=(60, 2)), gen.normal(size=(60, 1))
    noise = 0.01 * gen.normal(size=(60, 2))
    data = se.Trajectories.from_pairs(x, u, x @ A.T + u @ B.T + c + noise)
    model = se.identify(data, intercept=True, design="independent")
    x0, xf, K = np.array([1.0, 2.0]), np.array([0.5, 0.0]), 5
    plan = se.control(model, x0, xf, steps=K, limits=(-0.4, 0.1), Q=1.0, R=0.1)
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
    with pytest.raises(InputError, match="`robust` must be False with limits"):
        se.control(model, x0, xf, robust=True, limits=(-1.0, 1.0))


# -- the plan --------------------------------------------------------------------------------------


def test_the_error_is_the_distance_from_the_limited_best(gen):
    for i in range(30):
        A, B, x0, K, low, high, weights = draw_case(gen, i, steps=(1, 2, 4))
        xf, other = gen.normal(size=len(A)), A + 0.1 * gen.normal(size=A.shape)
        drawn = se.control((other, B), x0, xf, steps=K, limits=(low, high), **weights)
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


def test_the_error_is_within_the_bound_of_a_moved_target(gen):
    """500 draws: ||B (u - u')||_Q <= ||b - b'||_Q, and half of it for the inputs in R."""
    largest = [0.0, 0.0]
    for i in range(500):
        n, m = int(gen.integers(1, 5)), int(gen.integers(1, 4))
        B, Q, R = draw_map(gen, "plain", n, m), weight(gen, n) + 0.01 * np.eye(n), 0.3
        low, high = draw_box(gen, WAYS[i % 5], m, 1.0)
        xf = 2.0 * gen.normal(size=n)
        moved = xf + 10.0 ** gen.uniform(-2, 1) * gen.normal(size=n)
        plans = [
            se.control((0.0 * Q, B), 0.0 * xf, y, limits=(low, high), Q=Q, R=R) for y in (xf, moved)
        ]
        du, delta = plans[0].u[0] - plans[1].u[0], lp.norm(xf - moved, Q)
        largest[0] = max(largest[0], lp.norm(B @ du, Q) / delta)
        largest[1] = max(largest[1], 2.0 * np.sqrt(R) * np.linalg.norm(du) / delta)
    assert 0.5 < max(largest) <= 1.0 + 1e-9


def test_the_plan_says_what_its_limits_cost():
    plan = se.control(TWO, [1.0, 0.0], [0.0, 0.0], steps=2, limits=(-0.5, 0.5), R=0.0)
    for text in (repr(plan), plan._repr_html_()):
        assert "optimal" in text
        assert "0.25 of it for the limits" in text
        assert "of 2 inputs at a limit" in text
    free = se.control(TWO, [1.0, 0.0], [0.0, 0.0], steps=2, R=1.0)
    assert "none of 2 inputs at a limit" in repr(free)
    assert "limits" not in repr(se.control(TWO, [1.0, 0.0], [0.0, 0.0], steps=2))
    again = pickle.loads(pickle.dumps(plan))
    assert again.u.tobytes() == plan.u.tobytes()
    assert again.multipliers.tobytes() == plan.multipliers.tobytes()
    with pytest.raises(InputError, match="no covariance is known within limits"):
        plan.covariance()


def test_a_time_limit_gives_a_control_within_the_limits(gen):
    A, B = np.linalg.qr(gen.normal(size=(30, 30)))[0], gen.normal(size=(30, 8))
    x0, K = 10.0 * gen.normal(size=30), 25
    more = {"limits": (-0.2, 0.3), "Q": 1.0, "R": 1e-4}
    plan = se.control((A, B), x0, np.zeros(30), steps=K, time_limit=1e-9, **more)
    assert plan.status == "user_limit"
    assert np.all((plan.u >= -0.2) & (plan.u <= 0.3))
    done = se.control((A, B), x0, np.zeros(30), steps=K, time_limit=60.0, **more)
    assert done.status == "optimal"
    assert plan.gap >= plan.objective - done.objective - 1e-9 * done.objective


# -- one control per realization -------------------------------------------------------------------


def test_realization_controls_are_those_of_each_target(gen):
    for i in range(30):
        n, m, N = int(gen.integers(1, 5)), int(gen.integers(1, 10)), 40
        A, B = gen.normal(size=(n, n)), draw_map(gen, ("plain", "sparse")[i % 2], n, m)
        x0, xf = gen.normal(size=(2, n))
        drawn, start = se.sample(A, N, rng=i), se.sample(x0, N, rng=i + 100)
        low, high = draw_box(gen, WAYS[i % 5], m, 1.0)
        Q, R = (weight(gen, n) if i % 3 else None), (0.1 if i % 2 else weight(gen, m) + np.eye(m))
        out = np.empty((N, m))
        found = se.realization_controls(
            (drawn, B), start, xf, limits=(low, high), Q=Q, R=R, out=out
        )
        assert found is out
        for s, (a, x) in enumerate(zip(drawn.dense(), start.dense(), strict=True)):
            p = lp.one_step(B, xf - a @ x, Q=Q, R=R, low=low, high=high)
            J, best = lp.objective(p, out[s]), lc.solve(p).objective
            assert np.all((out[s] >= low) & (out[s] <= high))
            assert best + 1e-8 * (1.0 + lp.objective(p, 0.0 * out[s])) >= J


def test_a_gap_above_its_tolerance_is_solved_again(gen, monkeypatch):
    A, B, (x0, xf) = gen.normal(size=(3, 3)), gen.normal(size=(3, 2)), gen.normal(size=(2, 3))
    drawn, more = se.sample(A, 20, rng=1), {"limits": (-0.1, 0.2), "R": 0.1}
    right = se.realization_controls((drawn, B), x0, xf, **more)
    batch = _core.box_batch

    def wrong(*given):
        u, gaps = batch(*given)
        u[::3], gaps[::3] = 0.05, 1.0
        gaps[1] = np.nan
        return u, gaps

    monkeypatch.setattr(_core, "box_batch", wrong)
    again = se.realization_controls((drawn, B), x0, xf, **more)
    np.testing.assert_allclose(again, right, atol=1e-9)


def test_weights_alone_are_ridge_regression(gen):
    A, B, x0, xf = gen.normal(size=(3, 3)), gen.normal(size=(3, 2)), *gen.normal(size=(2, 3))
    drawn = se.sample(A, 20, rng=1)
    u = se.realization_controls((drawn, B), x0, xf, R=0.5)
    b = xf - drawn.dense() @ x0
    np.testing.assert_allclose(u, np.linalg.solve(B.T @ B + 0.5 * np.eye(2), B.T @ b.T).T)
    plan = se.control((A, B), x0, xf, R=0.5)
    np.testing.assert_allclose(plan.u[0], np.linalg.solve(B.T @ B + 0.5 * np.eye(2),
                                                          B.T @ (xf - A @ x0)))  # fmt: skip


# -- sampling --------------------------------------------------------------------------------------


def test_steer_within_limits():
    plan = se.steer(TWO, [1.0, 0.0], [0.0, 0.0], 10**5, steps=4, limits=(-0.2, 0.2), rng=1)
    assert np.max(np.abs(plan.u)) <= 0.2
    assert plan.limits_active
    assert plan.error(TWO, [1.0, 0.0], [0.0, 0.0]).state < 0.1


def test_sizes_hold_within_limits():
    """500 plans of the size that the simulation finds, within limits: at most delta are too far."""
    system = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0, 0.0], [0.5, 1.0]])
    x0, xf, limits = [1.0, 2.0], [0.5, 0.0], (-0.7, 0.5)
    found = se.required_samples(system, x0, xf, 0.3, relative=False, limits=limits, rng=1, runs=100)
    free = se.required_samples(system, x0, xf, 0.3, relative=False, rng=1, runs=100)
    assert found.size == free.size
    for text in (str(found), found._repr_html_()):
        assert "errors are those without limits" in text
    assert "without limits" not in str(free)
    off = [
        se.steer(system, x0, xf, found.simulated_size, limits=limits, rng=i).error(system, x0, xf)
        for i in range(500)
    ]
    active = np.mean([error.residual > 0.1 for error in off])
    assert active == 1.0  # the limits keep the best control from the target
    assert np.mean([error.state > 0.3 for error in off]) <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 500)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"steps": 2, "relative": False}, "`limits` must be None with steps=2"),
        ({"relative": False, "quantity": "control"}, "`limits` must be None with quantity='con"),
        ({}, "`relative` must be False with `limits`"),
    ],
)
def test_sizes_that_are_not_known_are_refused(more, message):
    with pytest.raises(InputError, match=message):
        se.required_samples(TWO, [1.0, 0.0], [0.0, 0.0], 0.1, limits=(-1.0, 1.0), **more)


# -- order and units -------------------------------------------------------------------------------


def test_order_and_units_do_not_matter(gen):
    for i in range(60):
        A, B, x0, K, low, high, weights = draw_case(gen, i, steps=(1, 3))
        n, m = B.shape
        xf, R = gen.normal(size=n), gen.uniform(0.1, 1.0, size=m)
        more = weights | {"R": R}
        u = se.control((A, B), x0, xf, steps=K, limits=(low, high), **more).u
        order = gen.permutation(m)
        permuted = se.control((A, B[:, order]), x0, xf, steps=K,
                              limits=(low[..., order], high[..., order]),
                              **(more | {"R": R[order]}))  # fmt: skip
        np.testing.assert_allclose(permuted.u, u[:, order], atol=1e-7 * (1 + np.abs(u).max()))
        units = 2.0 ** gen.integers(-4, 5, size=m)
        scaled = se.control((A, B / units), x0, xf, steps=K, limits=(low * units, high * units),
                            **(more | {"R": R / units**2}))  # fmt: skip
        np.testing.assert_allclose(scaled.u / units, u, atol=1e-7 * (1 + np.abs(u).max()))
        larger = se.control((A, B), 4.0 * x0, 4.0 * xf, steps=K, limits=(4.0 * low, 4.0 * high),
                            **more)  # fmt: skip
        np.testing.assert_allclose(larger.u / 4.0, u, atol=1e-7 * (1 + np.abs(u).max()))


# -- messages --------------------------------------------------------------------------------------

BAD = [
    ({"limits": (1.0, -1.0)}, InputError, r"`limits` must have low <= high, got 1 > -1"),
    ({"limits": 1.0}, InputTypeError, "`limits` must be a list"),
    ({"limits": (1.0, 2.0, 3.0)}, InputError, "`limits` must be a pair"),
    ({"limits": (np.zeros(3), None)}, ShapeError, r"`limits\[0\]` must be a number or have shape"),
    ({"limits": (np.nan, 1.0)}, InputError, r"`limits\[0\]` must not be nan"),
    ({"limits": (np.inf, None)}, InputError, "`limits` must leave room"),
    ({"Q": -1.0}, InputError, "`Q` must be >= 0"),
    ({"Q": np.diag([1.0, -2.0])}, InputError, "`Q` must be positive semidefinite, its least eige"),
    ({"Q": [[1.0, 1.0], [0.0, 1.0]]}, InputError, "`Q` must be symmetric"),
    ({"Q": 0.0}, InputError, "`Q` and `Qf` must not both be 0"),
    ({"R": "automatic"}, InputTypeError, "`R` must be a number"),
    ({"R": [-1.0]}, InputError, "`R` must have entries >= 0"),
    ({"rate": 0.1}, InputError, "`previous` must be given with `rate`"),
    ({"previous": [0.0]}, InputError, "`previous` must be left out without limits"),
    (
        {"limits": (0.0, 1.0), "previous": [0.0]},
        InputError,
        "`previous` must be left out without `r",
    ),
    ({"rate": 0.0, "previous": [0.0]}, InputError, "`rate` must be > 0"),
    ({"rate": 0.1, "previous": [0.0], "limits": (1.0, 2.0)}, InputError, "input 0 is 0.9 too far"),
    ({"soft": 1.0}, InputError, "`soft` must be left out without limits"),
    ({"soft": 1.0, "R": 1.0}, InputError, "`soft` must be left out without `state_limits`"),
    ({"time_limit": 1.0}, InputError, "`time_limit` must be left out without limits"),
    ({"limits": (0.0, 1.0), "time_limit": 0.0}, InputError, "`time_limit` must be > 0"),
    ({"reference": np.zeros((3, 2))}, InputError, "`xf` must be None with `reference`"),
]


@pytest.mark.parametrize(("more", "kind", "message"), BAD)
def test_messages_name_what_is_wrong(more, kind, message):
    with pytest.raises(kind, match=message):
        se.control(TWO, [1.0, 0.0], [0.0, 0.0], steps=2, **more)


def test_messages_about_references_and_targets():
    with pytest.raises(InputError, match="`reference` must have shape"):
        se.control(TWO, [1.0, 0.0], steps=2, reference=np.zeros((2, 2)))
    with pytest.raises(InputError, match="`xf`"):
        se.control(TWO, [1.0, 0.0], steps=2, limits=(-1.0, 1.0))
    followed = se.control(TWO, [1.0, 0.0], steps=2, reference=np.zeros((3, 2)))
    with pytest.raises(InputError, match="`xf` must be None: this plan has a reference"):
        followed.error(TWO, [1.0, 0.0], [0.0, 0.0])
    with pytest.raises(InputError, match="`xf` must be given: this plan has no reference"):
        se.control(TWO, [1.0, 0.0], [0.0, 0.0], R=1.0).error(TWO, [1.0, 0.0])


WITH = {"limits": (-1.0, 1.0), "Q": 1.0, "Qf": [1.0, 2.0], "R": 0.1, "time_limit": 10.0}
WITH |= {"state_limits": (None, 0.5), "soft": 10.0, "rate": 1.0, "previous": [0.0]}


@pytest.mark.parametrize("name", WITH)
def test_whatever_is_given_with_the_others(name):
    """Nothing but an exception of the package, or a control within its limits."""
    passed = 0
    for what, value in (NEVER | PERHAPS).items():
        try:
            plan = se.control(TWO, [1.0, 0.0], [0.0, 0.0], steps=3, **(WITH | {name: value}))
        except se.exceptions.StochensError:
            continue
        passed += 1
        assert np.all(plan.u >= plan.limited.task.low), what
        assert np.all(plan.u <= plan.limited.task.high), what
        assert plan.gap >= 0.0, what
        assert "inputs at a limit" in repr(plan)
        assert "inputs at a limit" in plan._repr_html_()
    assert passed
