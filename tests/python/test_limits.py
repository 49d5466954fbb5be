"""Controls within limits: known answers, the plain twin, errors, the plan and its records."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import stochens_rs as se
from limit_problems import draw_box, draw_map, weight
from stochens_rs.exceptions import InputError, InputTypeError, ShapeError
from stochens_rs.reference import limited_control as lc
from stochens_rs.reference import limited_problems as lp

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


def test_no_limits_is_the_path_without_them(gen):
    """The stored numbers are those of a version without limits, to the last bit."""
    A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[1.0], [0.5]])
    stored = [[-0.0864864864864865], [0.0]], [[0.0], [0.0]]
    del stored
    plan = se.control((A, B), [1.0, 2.0], [0.5, 0.0], steps=3)
    C = np.hstack([B, A @ B, A @ A @ B])
    by_hand = np.linalg.pinv(C) @ (np.array([0.5, 0.0]) - A @ A @ A @ np.array([1.0, 2.0]))
    np.testing.assert_allclose(plan.u.ravel(), by_hand[::-1], rtol=1e-12)
