"""Closed-loop tracking: runs against an exact recursion, stability from both sides.

Statistics with fixed seeds; each check states its number of runs R and its rate of false alarms.
"""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import reference as twin
from stochens_rs.exceptions import NonFiniteError

A2 = np.array([[1.0, -2.0], [0.5, 3.0]])
B1 = np.array([[1.0], [-0.5]])
I2 = np.eye(2)


def covariance(w):
    """Cv(w), of one realization."""
    return np.abs(w).sum() * np.diag(np.abs(w)) - np.outer(w, w)


def excess(A, d):
    """T_A(d) = sum_j d_j Cv(a_j)."""
    return sum(x * covariance(a) for x, a in zip(d, A.T, strict=True))


def tracking_squares(A, r, size):
    """E ||e(k)||^2 for B = I: ``e(k+1) = -(A_hat_k - A) x(k)``, A_hat_k of `size` realizations."""
    found, each = [0.0], 0.0 * r[0]
    for now in r[:-1]:
        second = excess(A, each + now**2) / size
        each = np.diag(second)
        found.append(each.sum())
    return np.array(found)


def test_the_threshold_from_both_sides():
    """Below rho(Phi) the mean square diverges, above it stays bounded: in theory and in runs.

    R = 3000 runs of 8 steps, N = 3 below and N = 11 above; the last mean square is compared with
    the exact one within 6 standard errors (heavy tails below the threshold).
    """
    A = np.array([[1.0, -1.5, 0.5], [1.5, 0.5, 1.0], [-0.5, 1.0, 1.5]])
    g = np.abs(A).sum(axis=0)
    threshold = np.abs(np.linalg.eigvals(np.abs(A) * (g - np.abs(A)))).max()
    assert 5.0 < threshold < 6.0
    r = np.ones((9, 3))
    for size, grows in ((3, True), (11, False)):
        exact = tracking_squares(A, r, size)
        assert (exact[-1] > 20.0 * exact[1]) == grows
        run = se.track((A, np.eye(3)), r, size, rng=13, runs=3000)
        squares = run.errors[:, -1] ** 2
        deviation = squares.std() / np.sqrt(len(squares))
        assert abs(squares.mean() - exact[-1]) < 6.0 * deviation
        assert (run.mean_square[-1] > 10.0 * run.mean_square[1]) == grows
    far = np.ones((4001, 3))
    late = tracking_squares(A, far, int(threshold) + 1)
    assert late[-1] == pytest.approx(late[-2], rel=1e-6)
    late = tracking_squares(A, far[:400], int(threshold) - 1)
    assert late[-1] > 1e3 * late[200]


# -- the record ----------------------------------------------------------------------------------

SYSTEM = se.System(0.5 * A2, B1)
REFERENCE = np.array([[1.0, -0.5], [0.5, 2.0], [-1.0, 1.0], [0.0, 0.25]])


def test_the_estimates_are_those_of_the_named_streams():
    run = se.track(SYSTEM, REFERENCE, se.StepEstimate(50, sample_states=True), rng=1, runs=2)
    step = run.key.child("replicate-1").child("step-2")
    A, x, r = (
        se.sample_counts(target, 50, rng=step.child(name)).estimate
        for target, name in (
            (SYSTEM.A, "A"), (run.states[1, 2], "state"), (REFERENCE[3], "target"),
        )
    )  # fmt: skip
    expected = np.linalg.pinv(SYSTEM.B) @ (r - A @ x)
    np.testing.assert_allclose(run.inputs[1, 2], expected, rtol=1e-12)


@pytest.mark.parametrize("method", ["uniform", "alse", "slse", "slse-safeguarded"])
@pytest.mark.parametrize("feedback", [True, False])
@pytest.mark.parametrize("sampled", [True, False])
@pytest.mark.parametrize("m", [6, 3])
def test_runs_are_those_of_the_twin(method, feedback, sampled, m):
    """The loop in NumPy, with the estimates of `sample_counts` and `fuse`."""
    system, start = se.cases.random_system(6, m, rng=m), np.arange(6.0)
    r = np.random.default_rng(m).standard_normal((6, 6))

    def estimate(target, key):
        if method == "uniform":
            return se.sample_counts(target, 40, rng=se.Key(key)).estimate
        return se.fuse(se.sample(target, 40, rng=se.Key(key)), method, target=target).estimate

    flags = {"feedback": feedback, "sample_states": sampled}
    run = se.track(system, r, se.StepEstimate(40, method, **flags), x0=start, rng=1, runs=3)
    for i in range(3):
        key = twin.streams.child(bytes(run.key), f"replicate-{i}")
        states, inputs = twin.simulation.track(
            system.A, system.B, r, start, estimate, key=key, **flags
        )
        scale = np.abs(states).max()
        np.testing.assert_allclose(run.states[i], states, rtol=0, atol=1e-13 * scale)
        np.testing.assert_allclose(run.inputs[i], inputs, rtol=0, atol=1e-12 * np.abs(inputs).max())


def test_threads_change_nothing_and_the_first_run_that_overflows_is_reported():
    def run(threads, *args, **kwargs):
        se.set_num_threads(threads)
        try:
            return se.track(*args, rng=1, runs=5, **kwargs)
        finally:
            se.set_num_threads(before)

    before = se.get_num_threads()
    one, three = (
        run(k, SYSTEM, REFERENCE, se.StepEstimate(50, sample_states=True)) for k in (1, 3)
    )
    np.testing.assert_array_equal(one.states, three.states)
    steps = set()
    for threads in (1, 2, 3):
        with pytest.raises(NonFiniteError, match="overflows at step") as told:
            run(threads, ([[0.0, 9.0], [6.0, 3.0]], I2), np.ones((900, 2)), 1)
        steps.add(str(told.value))
    assert len(steps) == 1


def test_a_feasible_reference_is_recognised_to_rounding():
    gen = np.random.default_rng(14)
    A, B = gen.standard_normal((6, 6)), gen.standard_normal((6, 2))
    for u in (np.zeros((8, 2)), gen.standard_normal((8, 2))):
        r = se.simulate((A, B), np.ones(6), u).states
        assert se.track((A, B), r, 10**15, rng=1).feasible
        r[3] *= 1.0 + 1e-6
        run = se.track((A, B), r, 10**15, rng=1)
        assert not run.feasible
        assert (run.residuals > 1e-8).sum() == 2  # the steps to and from r(3)
    assert se.track(SYSTEM, np.zeros((3, 2)), 5, rng=1).feasible
