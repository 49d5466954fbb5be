"""Controls over several steps: the defining equations, bounds, the limit for large N."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from stochens_rs.theory import drawn_bound, moments


def case(n, m, seed):
    """A Gaussian system of spectral radius 1 with a start and a target."""
    gen = np.random.default_rng(1000 + seed)
    return se.cases.random_system(n, m, rng=seed), gen.standard_normal(n), gen.standard_normal(n)


def power(A, k):
    return np.linalg.matrix_power(A, k)


def roll(A, B, u, x):
    states = [np.asarray(x, dtype=float)]
    for u_k in u:
        states.append(A @ states[-1] + B @ u_k)
    return np.array(states)


def plug_in(A, B, x0, xf, K):
    """C_K^+ (xf - A^K x0), written out; controls in the order of time."""
    C = np.hstack([power(A, K - 1 - k) @ B for k in range(K)])
    return (np.linalg.pinv(C) @ (xf - power(A, K) @ x0)).reshape(K, -1)


def vector_radius(w, size, delta):
    return drawn_bound("vector", w, size=size, delta=delta)[0]


# -- the control ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "m", "K"), [(2, 1, 2), (6, 2, 4), (5, 1, 5), (4, 6, 1), (3, 1, 9)])
def test_the_exact_system_gets_to_its_target(n, m, K):
    system, x0, xf = case(n, m, n)
    plan = se.control(system, x0, xf, steps=K)
    assert plan.u.shape == (K, m)
    assert plan.steps == K
    assert plan.predicted_states.shape == (K + 1, n)
    np.testing.assert_allclose(plan.u, plug_in(system.A, system.B, x0, xf, K), rtol=1e-9)
    np.testing.assert_allclose(
        plan.predicted_states, roll(system.A, system.B, plan.u, x0), rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(plan.predicted_states[-1], xf, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(plan.states(system, x0), plan.predicted_states)
    assert plan.reachability.reachable
    assert plan.reachability.rank == n
    assert plan.error(system, x0, xf).control <= 1e-12
    # The minimum norm: u is orthogonal to every change that leads to the same state.
    C = np.hstack([power(system.A, K - 1 - k) @ system.B for k in range(K)])
    free = np.eye(K * m) - np.linalg.pinv(C) @ C
    np.testing.assert_allclose(free @ plan.u.ravel(), 0.0, atol=1e-9)


def test_a_square_problem_warns():
    system, x0, xf = case(4, 2, 3)
    warned = se.steer(system, x0, xf, 100, steps=2, rng=1).info["warnings"]
    assert len(warned) == 1
    assert "as many inputs as states" in warned[0]
    assert se.steer(system, x0, xf, 100, steps=3, rng=1).info["warnings"] == ()
    assert se.control(system, x0, xf, steps=2).info["warnings"] == ()  # nothing random


# -- bounds --------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["iid", "systematic"])
@pytest.mark.parametrize("axis", ["columns", "rows"])
def test_the_bound_from_the_law(scheme, axis):
    """200 seeds, in `make test` 80, at delta = 0.2: a fifth fails, and 4 standard errors more.

    Mutants: half the radius; the formula for rare failures that forgets the error of A.
    """
    system, x0, xf = case(4, 2, 6)
    failures = {"state": 0, "control": 0, "half": 0, "rare": 0, "target": 0}
    count = sets(200, 80)
    allowed = 0.2 * count + 4.0 * np.sqrt(0.16 * count)
    for seed in range(count):
        key = se.rng.as_key(seed)
        drawn = [
            se.sample(w, 200, rng=key.child(str(i)), scheme=scheme, axis=axis)
            for i, w in enumerate((x0, xf, system.A))
        ]
        plan = se.control((drawn[2], system.B), *drawn[:2], steps=3)
        if seed == 0:
            bound = plan.bound(0.2)
            assert bound["state"].method == "simulated"
        error = plan.error(system, x0, xf)
        failures["state"] += error.state > bound.state
        failures["control"] += error.control > bound.control
        failures["half"] += error.state > bound.state / 2.0
        distance = np.linalg.norm(plan.states(system, x0)[-1] - xf)
        failures["target"] += distance > bound.target
        # the formula depends on the predicted states
        rare = plan.bound(1e-9)
        assert rare["state"].method == "sum of errors"
        failures["rare"] += error.state > rare.state or error.control > rare.control
    assert max(failures[name] for name in ("state", "control", "target")) <= allowed
    assert failures["half"] > allowed
    assert failures["rare"] == 0


def test_the_formula_for_rare_failures():
    system, x0, xf = case(3, 1, 15)
    drawn = [se.sample(w, 500, rng=i) for i, w in enumerate((x0, xf, system.A))]
    plan = se.control((drawn[2], system.B), *drawn[:2], steps=4)
    share = 1e-9 / 3  # a third of delta for each entity
    norms = [np.linalg.norm(power(system.A, k), 2) for k in range(5)]
    along = sum(norms[3 - k] * np.linalg.norm(plan.predicted_states[k]) for k in range(4))
    e0, ef = vector_radius(x0, 500, share), vector_radius(xf, 500, share)
    eA = drawn_bound("matrix", system.A, size=500, delta=share, norm="spectral")[0]
    model = np.linalg.norm(plan.predicted_states[-1] - drawn[1].mean())
    expected = ef + norms[4] * e0 + eA * along + model
    assert plan.bound(1e-9).state == pytest.approx(expected, rel=1e-9)


def test_what_is_exact_takes_no_part_of_delta():
    system, x0, xf = case(4, 2, 7)
    plan = se.control(system, x0, se.sample(xf, 400, rng=1), steps=4)
    assert plan.bound(1e-9).state == pytest.approx(vector_radius(xf, 400, 1e-9), rel=1e-9)
    exact = se.control(system, x0, xf, steps=4).bound(0.05)
    assert exact.kind == "certain"
    assert 0.0 < max(exact.state, exact.control) < 1e-9  # what rounding may make of it


# -- the limit for large N -----------------------------------------------------------------------


def test_the_leading_order_is_a_derivative():
    # sum over the atoms of p * (derivative of x(K) in the direction of the atom)^2, by differences
    system, x0, xf = case(3, 2, 14)
    A, B, K, h = system.A, system.B, 3, 1e-5

    def end(start, goal, matrix):
        return roll(A, B, plug_in(matrix, B, start, goal, K), x0)[-1]

    for axis in ("columns", "rows"):
        expected = np.zeros((3, 3))
        for entity, w in enumerate((x0, xf, A)):
            for line in range(1 if w.ndim == 1 else 3):
                pick = slice(None) if w.ndim == 1 else (
                    (slice(None), line) if axis == "columns" else (line, slice(None))
                )  # fmt: skip
                values = w[pick]
                g = np.abs(values).sum()
                for i in range(3):
                    atom = g * np.sign(values[i]) * np.eye(3)[i] - values
                    ends = []
                    for sign in (1.0, -1.0):
                        moved = [x0.copy(), xf.copy(), A.copy()]
                        moved[entity][pick] += sign * h * atom
                        ends.append(end(*moved))
                    slope = (ends[0] - ends[1]) / (2.0 * h)
                    expected += abs(values[i]) / g * np.outer(slope, slope)
        found = moments.final_state_covariance((A, B), x0, xf, K, axis=axis)
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())
        np.testing.assert_allclose(
            moments.final_state_covariance((A, B), x0, xf, K, 50, axis=axis), found / 50
        )
        drawn = [se.sample(w, 50, rng=i, axis=axis) for i, w in enumerate((x0, xf, A))]
        plan = se.control((drawn[2], B), *drawn[:2], steps=K)
        np.testing.assert_allclose(plan.covariance(), found / 50, rtol=1e-12)


# -- input ---------------------------------------------------------------------------------------
