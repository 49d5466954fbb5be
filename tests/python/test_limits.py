"""Controls within limits: known answers, and the plain twin."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from limit_plans import at_a_limit, check, draw_case, exactly, within
from limit_problems import draw_box
from stochens_rs import _core
from stochens_rs.ensembles.ensemble import core_of
from stochens_rs.limits.problem import Horizon
from stochens_rs.theory.exact import best_control, factors
from twin import limited_control as lc
from twin import limited_problems as lp

ONE = [[1.0]], [[1.0]]  # x(k+1) = x(k) + u(k)
TWO = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]])  # the double integrator
INPUTS = np.zeros((2, 2)), np.array([[1.0, 1.0], [0.0, 1.0]])  # x(1) = B u


# -- known answers ---------------------------------------------------------------------------------


def test_one_input_by_hand():
    exactly(se.control(ONE, [0.0], [3.0], cost=se.Cost(R=1.0)).u, [[1.5]])
    plan = se.control(ONE, [0.0], [3.0], limits=(-1.0, 1.0), cost=se.Cost(R=1.0))
    exactly(
        [plan.u[0, 0], plan.limited.objective, plan.limited.multipliers[0, 0], plan.limited.missed],
        [1, 5, 2, 0.5],
    )
    assert (plan.limited.active.tolist(), at_a_limit(plan), plan.status) == ([[1]], True, "optimal")
    assert 0.0 <= plan.limited.gap <= 1e-15
    other = se.control(ONE, [0.0], [1.0], limits=(-1.0, 1.0), cost=se.Cost(R=1.0))
    exactly(other.u, [[0.5]])
    assert (other.limited.missed, at_a_limit(other)) == (0.0, False)
    # ||B (u - u')||_Q^2 + ||u - u'||_R^2 <= <B (u - u'), b - b'>_Q
    moved = plan.u - other.u
    assert 2.0 * np.sum(moved**2) <= moved[0, 0] * 2.0


def test_two_inputs_without_weight_by_hand():
    free = se.control(INPUTS, [0.0, 0.0], [2.0, 0.0])
    exactly(free.u, [[2.0, 0.0]])
    plan = se.control(INPUTS, [0.0, 0.0], [2.0, 0.0], limits=(-1.0, 1.0), cost=se.Cost(R=0.0))
    exactly(plan.u, [[1.0, 0.5]])
    exactly([plan.limited.objective, *plan.limited.multipliers[0]], [0.5, 1.0, 0.0])


def test_two_steps_of_the_double_integrator_by_hand():
    ends = [1.0, 0.0], [0.0, 0.0]
    exactly(se.control(TWO, *ends, steps=2).u.ravel(), [-1.0, 1.0])
    plan = se.control(TWO, *ends, steps=2, limits=(-0.5, 0.5), cost=se.Cost(R=0.0))
    exactly([*plan.u.ravel(), plan.limited.objective, plan.limited.missed], [-0.5, 0.5, 0.25, 0.25])
    exactly(plan.predicted_states, [[1.0, 0.0], [1.0, -0.5], [0.5, 0.0]])


def test_two_steps_with_a_limit_on_changes_by_hand():
    plan = se.control(
        TWO,
        [1.0, 0.0],
        [0.0, 0.0],
        steps=2,
        limits=se.Limits(u=(-0.5, 0.5), rate=0.5, previous=[0.0]),
        cost=se.Cost(R=0.0),
    )
    np.testing.assert_allclose(
        [*plan.u.ravel(), plan.limited.objective], [-0.4, 0.1, 0.45], atol=1e-8
    )
    assert plan.status == "optimal"


def test_state_limits_that_cannot_be_kept_by_hand():
    plan = se.control(ONE, [3.0], [0.0], limits=se.Limits(u=(-1.0, 1.0), x=(None, 1.0), soft=False))
    assert plan.status == "infeasible"
    np.testing.assert_allclose([plan.limited.missing, plan.u[0, 0]], [1.0, -1.0], atol=1e-8)


def test_regulating_step_by_step_by_hand():
    x, inputs, multipliers = np.array([5.0]), [], []
    for _ in range(6):
        plan = se.control(ONE, x, [0.0], limits=(-1.0, 1.0), cost=se.Cost(Q=1.0, R=1.0))
        inputs.append(plan.u[0, 0])
        multipliers.append(plan.limited.multipliers[0, 0])
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
        plan = se.control(system, x0, xf, steps=K, limits=(-1e6, 1e6), cost=se.Cost(R=0.0))
        np.testing.assert_allclose(plan.u, free.u, rtol=1e-12, atol=1e-12, err_msg=str(i))
        assert not at_a_limit(plan)
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
            assert made.status == "completed"
    inverse, out = factors(B).inverse, np.empty((50, 1))
    needed = xf, core_of(drawn)
    _core.realization_controls(out, False, inverse, core_of(start), *needed, False, 1)
    assert se.realization_controls((drawn, B), start, xf).tobytes() == out.tobytes()


# -- against the plain twin ------------------------------------------------------------------------


def test_boxes_equal_the_twin(gen):
    """250 problems, in `make test` 90, of up to 60 inputs, with limits per input and step."""
    for i in range(sets(250, 90)):
        A, B, x0, K, low, high, weights = draw_case(gen, i)
        xf = gen.normal(size=len(A))
        plan = se.control((A, B), x0, xf, steps=K, **within(limits=(low, high), **weights))
        p = lp.several_steps(A, B, x0, xf, K, low=low, high=high, **weights)
        best = check(plan, p)
        size = 1e-6 * (1.0 + np.max(np.abs(best.multipliers)))
        np.testing.assert_allclose(
            plan.limited.multipliers.ravel(), np.abs(best.multipliers), atol=size, err_msg=str(i)
        )


def test_long_horizons_equal_condensed_ones(gen):
    """250 and more inputs go by a recursion: the same problem in blocks of fewer inputs."""
    for K, n, m, way in ((260, 2, 1, "half"), (150, 3, 2, "tight"), (100, 2, 3, "one-sided")):
        A = 0.98 * np.linalg.qr(gen.normal(size=(n, n)))[0]
        B, x0, xf = gen.normal(size=(n, m)), 5.0 * gen.normal(size=n), np.zeros(n)
        low, high = draw_box(gen, way, m, 0.3)
        more = {"Q": 1.0, "R": 0.1}
        plan = se.control((A, B), x0, xf, steps=K, **within(limits=(low, high), **more))
        assert plan.limited.task.steps * m >= 250
        p = lp.several_steps(A, B, x0, xf, K, low=low, high=high, **more)
        u = plan.u.ravel()
        assert plan.status == "optimal"
        assert at_a_limit(plan)
        assert np.all((u >= p.low) & (u <= p.high))
        if way != "one-sided":
            assert lc.frank_wolfe_gap(p, u) <= 1e-9 * lp.objective(p, 0.0 * u)
        short = Horizon(plan.limited.task, A, B)
        M, state, target = short.core.weighted()
        y, R = target - state @ x0, np.tile(np.diag(short.core.r), K)
        dense = _core.box_control(M, y, R, p.low, p.high, None, None)
        assert lp.norm(dense.control - u, p.H) <= plan.limited.distance + dense.distance + 1e-9
        np.testing.assert_allclose(plan.limited.objective, dense.objective, rtol=1e-9)


def test_soft_limits_that_are_kept_cost_nothing():
    free = se.control(TWO, [1.0, 0.0], [0.0, 0.0], steps=3, cost=se.Cost(R=1.0))
    plan = se.control(
        TWO, [1.0, 0.0], [0.0, 0.0], steps=3, limits=se.Limits(x=(-9.0, 9.0)), cost=se.Cost(R=1.0)
    )
    np.testing.assert_allclose(plan.u, free.u, atol=1e-9)
    assert plan.limited.missed <= 1e-12
    far = se.control(
        TWO,
        [1e6, 0.0],
        [1e6, 0.0],
        steps=3,
        limits=se.Limits(x=(None, [1e6 - 1, 1])),
        cost=se.Cost(R=1.0),
    )
    assert abs(far.predicted_states[-1, 0] - 1e6 + 1) < 0.1  # the weight is 1000 times that of xf


def test_one_number_is_the_previous_input_of_all():
    more = {"limits": (-1.0, 1.0), "rate": 0.4}
    for given in (0.2, [0.2, 0.2]):
        plan = se.control(INPUTS, [1.0, 0.0], [3.0, 3.0], **within(**more, previous=given))
        assert np.array_equal(plan.limited.task.previous, [0.2, 0.2])
        np.testing.assert_allclose(plan.u[0], 0.6, atol=1e-9)
        loop = se.regulate(INPUTS, 1, [3.0, 3.0], **within(**more, previous=given))
        np.testing.assert_allclose(loop([1.0, 0.0]), 0.6, atol=1e-9)


EVERY = {
    "u": (se.Limits(u=(-1.0, 1.0)), se.Limits(u=(-0.2, 0.2))),
    "rate": (se.Limits(rate=1.0, previous=0.0), se.Limits(rate=0.1, previous=0.0)),
    "previous": (se.Limits(rate=0.1, previous=0.0), se.Limits(rate=0.1, previous=0.5)),
    "x": (se.Limits(u=(-1.0, 1.0)), se.Limits(u=(-1.0, 1.0), x=(0.6, 2.0))),
    "forecast": (se.Limits(forecast={"u[0]": 0.1}), se.Limits(forecast={"u[0]": 0.2})),
    "soft": (se.Limits(x=(0.6, 2.0), soft=1e-3), se.Limits(x=(0.6, 2.0), soft=1e3)),
}


@pytest.mark.parametrize("name", [one.name for one in fields(se.Limits)])
def test_every_field_of_limits_changes_a_plan(name):
    plans = [se.control(ONE, [1.0], [0.0], steps=3, limits=one) for one in EVERY[name]]
    assert np.abs(plans[0].u - plans[1].u).max() > 0.01
