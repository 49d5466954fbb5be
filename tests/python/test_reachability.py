"""Reachability: exact, and of every realization; the two counterexamples."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.theory import controllability_matrix, gramian
from stochens_rs.theory import exact as dynamics
from stochens_rs.theory.exact import best_control

# -- the exact system ------------------------------------------------------------------------------


def best(system, x0, xf, steps=1):
    A, B, x0, xf = (np.asarray(values, dtype=float) for values in (*system, x0, xf))
    return best_control(A, B, x0, xf, steps)


def reach(system, x0, xf, steps=1):
    return best(system, x0, xf, steps).reachability()


def test_one_step_is_what_a_plan_says(gen):
    for n, m in ((4, 2), (3, 3), (2, 5), (1, 1)):
        A, B = gen.normal(size=(n, n)), gen.normal(size=(n, m))
        x0, xf = gen.normal(size=(2, n))
        found, plan = reach((A, B), x0, xf), se.control((A, B), x0, xf).reachability
        assert (found.rank, found.reachable) == (plan.rank, plan.reachable)
        assert found.residual == pytest.approx(plan.residual, rel=1e-9, abs=1e-12)
        assert found.relative == pytest.approx(plan.relative, rel=1e-9, abs=1e-12)
        assert found.condition == pytest.approx(plan.condition, rel=1e-9)
        reached = reach((A, B), x0, A @ x0 + B @ gen.normal(size=m))
        assert reached.reachable
        assert reached.residual < 1e-12


def test_several_steps(gen):
    n, m, K = 5, 2, 4
    A, B = gen.normal(size=(n, n)), gen.normal(size=(n, m))
    x0, xf = gen.normal(size=(2, n))
    C = controllability_matrix((A, B), K)
    blocks = [np.linalg.matrix_power(A, k) @ B for k in range(K)]
    np.testing.assert_allclose(C, np.hstack(blocks), rtol=1e-12)
    W = gramian((A, B), K)
    np.testing.assert_allclose(W, sum(b @ b.T for b in blocks), rtol=1e-10)
    for steps in (1, 2, K):
        control = best((A, B), x0, xf, steps)
        found, controls = control.reachability(), control.u.reshape(steps, m)
        x = x0
        for u in controls:
            x = A @ x + B @ u
        assert np.linalg.norm(x - xf) == pytest.approx(found.residual, abs=1e-10)
        assert found.reachable == (steps > 2)  # 2 m < n <= 3 m
        assert found.rank == min(n, steps * m)
        assert control.factors.B.shape == (n, steps * m)
    moved = xf - np.linalg.matrix_power(A, K) @ x0
    energy = float((controls**2).sum())
    assert energy == pytest.approx(moved @ np.linalg.pinv(W) @ moved, rel=1e-8)
    # what is reachable after three steps stays so: the rank does not fall
    ranks = [reach((A, B), x0, xf, k).rank for k in range(1, 7)]
    assert ranks == sorted(ranks)


def test_uncontrollable_and_empty_problems():
    A, B = np.diag([0.5, 2.0]), [[1.0], [0.0]]
    for steps in (1, 2, 5):
        found = reach((A, B), [0.0, 1.0], [3.0, 0.0], steps)
        assert (found.rank, found.reachable) == (1, False)
        assert found.residual == pytest.approx(2.0**steps)
    unmoved = best((A, [[0.0], [0.0]]), [1.0, 1.0], [0.5, 2.0])
    nothing = unmoved.reachability()
    assert (nothing.rank, nothing.reachable, nothing.condition) == (0, True, np.inf)
    assert not unmoved.u.any()
    tiny = reach((A, np.array(B) * 1e-200), [0.0, 0.0], [1e-170, 0.0])
    assert tiny.reachable
    assert tiny.rank == 1


# -- counterexamples -------------------------------------------------------------------------------


def test_more_steps_need_not_reach_what_fewer_do():
    system = [[0.5]], [[0.0]]
    assert reach(system, [1.0], [0.5], 1).reachable
    assert not reach(system, [1.0], [0.5], 2).reachable


# -- input -----------------------------------------------------------------------------------------


def peak(call):
    """The most bytes that NumPy and Python hold at once during a call."""
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(("n", "m"), [(3, 1), (20, 1), (10, 10)])
def test_the_memory_check_covers_a_control_over_many_steps(n, m, monkeypatch):
    needed = []
    monkeypatch.setattr(dynamics.running, "need", lambda _, count: needed.append(count))
    K = dynamics.checked_steps(1000, n, m)
    B, x = np.eye(n, m) + 0.1, np.ones(n)
    assert peak(lambda: best_control(0.99 * np.eye(n), B, x, 0.0 * x, K)) < needed[0]
