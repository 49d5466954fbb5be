"""Trajectories: exact, in random runs, and as a mean field.

The core is compared with the NumPy twin bit for bit, and with an independent oracle: the exact
distribution of a small system, enumerated atom by atom, and the recursion of its covariance, which
the enumeration confirms. Statistical tests have fixed keys and state their false-alarm rates; each
is shown a mutant that it must catch.
"""

from __future__ import annotations

import hashlib
import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

import stochens_rs as se
from coverage_study import sets
from stochens_rs import reference as twin

Array = NDArray[np.float64]


def integers(seed: int, *shape: int) -> Array:
    return np.random.default_rng(seed).integers(-3, 4, size=shape).astype(float)


# -- the exact trajectory ------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "m", "K"), [(1, 1, 4), (4, 2, 7), (3, 5, 3), (10, 1, 25)])
def test_recursion_equals_the_product_formula(
    n: int, m: int, K: int, gen: np.random.Generator
) -> None:
    A, B = gen.standard_normal((n, n)) / np.sqrt(n), gen.standard_normal((n, m))
    u, x0 = gen.standard_normal((K, m)), gen.standard_normal(n)
    states = se.simulate((A, B), x0, u).states
    power = np.linalg.matrix_power
    for k in range(K + 1):
        formula = power(A, k) @ x0 + sum(
            (power(A, k - 1 - i) @ B @ u[i] for i in range(k)), np.zeros(n)
        )
        assert_allclose(states[k], formula, rtol=0, atol=1e-12 * max(1.0, np.abs(formula).max()))
    assert_allclose(
        states, twin.simulation.simulate(A, B, x0, u), rtol=0, atol=1e-12 * np.abs(states).max()
    )


def test_no_steps() -> None:
    none = np.zeros((0, 2))
    path = se.simulate((np.eye(3), np.ones((3, 2))), [1.0, -2.0, 0.0], none)
    assert path.states.tolist() == [[1.0, -2.0, 0.0]]
    assert path.inputs.shape == (0, 2)
    for averaging in ("runs", "mean-field"):
        found = se.simulate_ensemble(
            (np.eye(3), np.ones((3, 2))), [1.0, -2.0, 0.0], none, 50, averaging=averaging, rng=1
        )
        assert found.mean.shape == (1, 3)
        assert np.abs(found.mean).sum() == pytest.approx(3.0)  # 1-norm of x0: every sample has it


# -- the twin, bit for bit -----------------------------------------------------------------------

SYSTEMS = {
    # n, m, K, and what is zero
    "plain": (5, 3, 6, ""),
    "scalar": (1, 1, 5, ""),
    "more inputs than states": (2, 5, 4, ""),
    "zero columns": (5, 3, 6, "columns"),
    "first inputs zero": (5, 3, 6, "inputs"),
    "all inputs zero": (5, 3, 6, "all inputs"),
    "one state": (5, 3, 6, "states"),
    "no state": (4, 2, 5, "all states"),
    "one state, no input at first": (5, 3, 6, "states inputs"),
    "signs in two words": (70, 2, 3, ""),
    "words of two chunks": (20, 2, 28, ""),
}


def problem(name: str) -> tuple[Array, Array, Array, Array]:
    n, m, K, zero = SYSTEMS[name]
    A, B, u, x0 = integers(1, n, n), integers(2, n, m), integers(3, K, m), integers(4, n)
    if "columns" in zero:
        A[:, 1], B[:, 0] = 0.0, 0.0
    if "inputs" in zero:
        u[: K if "all" in zero else K // 2] = 0.0
    if "states" in zero:
        x0[:] = 0.0
        x0[2] = 0.0 if "all" in zero else -2.0
    return A, B, u, x0


def root_key(seed: int) -> bytes:
    return hashlib.sha256(b"stochens key v1\0int\0" + str(seed).encode()).digest()


FLAGS = list(itertools.product([True, False], repeat=3))


@pytest.mark.parametrize("name", SYSTEMS)
def test_runs_equal_the_twin(name: str) -> None:
    """Integer matrices: their 1-norms are exact in any order of summation."""
    A, B, u, x0 = problem(name)
    for A_, B_, x0_ in FLAGS if len(A) < 20 else [(True, True, True)]:
        sampled = tuple(itertools.compress(("A", "B", "x0"), (A_, B_, x0_)))
        found = se.simulate_ensemble((A, B), x0, u, 70, rng=7, keep="runs", sampled=sampled)
        expected = twin.simulation.simulate_runs(A, B, x0, u, 70, key=root_key(7), sampled=sampled)
        assert found.runs.shape == (70, len(u) + 1, len(A))
        if A_ and B_:
            assert np.array_equal(found.runs, expected)
        else:  # a product with an exact matrix may be rounded in another order
            assert_allclose(found.runs, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
        assert found.sampled == sampled


def test_golden_runs() -> None:
    """A change here changes every ensemble ever simulated: it needs a new stream version."""
    A, B, u, x0 = problem("first inputs zero")
    runs = se.simulate_ensemble((A, B), x0, u, 40, rng=2024, keep="runs").runs
    found = hashlib.sha256((runs + 0.0).astype("<f8").tobytes()).hexdigest()
    assert found == "5f47907b500f59f55a208a990b642ff24e03add23fdfbb9e62ac389474b76f14"


def test_the_twin_of_the_mean_field_has_its_moments() -> None:
    """4000 replicates each, in `make test` 1000; 18 means, |z| > 6 with probability 2e-9 each."""
    A, B, u, x0 = integers(1, 3, 3), integers(2, 3, 2), integers(3, 5, 2), integers(4, 3)
    gen, count = np.random.default_rng(5), sets(4000, 1000)
    theirs = np.array(
        [twin.simulation.simulate_mean_field(A, B, x0, u, 30, generator=gen) for _ in range(count)]
    )
    ours = se.simulate_ensemble(
        (A, B), x0, u, 30, averaging="mean-field", replicates=count, keep="runs", rng=5
    )
    for values in (theirs, ours.runs):
        error = values.std(axis=0) / np.sqrt(count)
        assert np.all(
            np.abs(values.mean(axis=0) - twin.simulation.simulate(A, B, x0, u)) <= 6 * error
        )
    ratio = theirs.var(axis=0) / ours.variance
    assert np.all(
        np.abs(ratio - 1.0) < 0.25
    )  # a standard deviation of 4.5 % each at 1000, were they normal


# -- moments over the runs -----------------------------------------------------------------------


@pytest.mark.parametrize("size", [2, 31, 1024, 1025, 3100])
@pytest.mark.parametrize("name", ["plain", "first inputs zero"])
def test_moments_are_those_of_the_runs(name: str, size: int) -> None:
    A, B, u, x0 = problem(name)
    full = se.simulate_ensemble((A, B), x0, u, size, rng=3, keep="covariance runs")
    covariance = np.array([np.cov(x.T) for x in full.runs.transpose(1, 0, 2)])
    scale = np.abs(covariance).max(axis=(1, 2), keepdims=True)
    mean = full.runs.mean(axis=0)
    assert np.all(np.abs(full.mean - mean) <= 1e-13 * np.abs(full.runs).max(axis=(0, 2))[:, None])
    assert np.all(np.abs(full.covariance - covariance) <= 1e-12 * scale)
    assert np.array_equal(full.covariance, full.covariance.transpose(0, 2, 1))
    assert np.array_equal(full.variance, np.einsum("kii->ki", full.covariance))
    diagonal = se.simulate_ensemble((A, B), x0, u, size, rng=3)
    assert diagonal.covariance is None
    assert diagonal.runs is None
    assert_allclose(diagonal.mean, full.mean, rtol=0, atol=1e-13 * np.abs(full.runs).max())
    assert np.all(np.abs(diagonal.variance - full.variance) <= 1e-12 * scale[:, :, 0])
    assert_allclose(diagonal.standard_error, np.sqrt(diagonal.variance / size))


def test_moments_of_a_mean_field_are_those_of_its_replicates() -> None:
    A, B, u, x0 = problem("plain")
    found = se.simulate_ensemble(
        (A, B), x0, u, 9, averaging="mean-field", replicates=37, keep="covariance runs", rng=3
    )
    assert found.runs.shape == (37, 7, 5)
    covariance = np.array([np.cov(x.T) for x in found.runs.transpose(1, 0, 2)])
    scale = np.abs(covariance).max(axis=(1, 2), keepdims=True)
    assert np.all(np.abs(found.covariance - covariance) <= 1e-12 * scale)
    assert_allclose(
        found.mean, found.runs.mean(axis=0), rtol=0, atol=1e-13 * np.abs(found.runs).max()
    )
    assert (found.size, found.replicates, found.averaging) == (9, 37, "mean-field")


def test_one_trajectory_has_no_variance() -> None:
    A, B, u, x0 = problem("plain")
    for options in ({}, {"averaging": "mean-field"}):
        found = se.simulate_ensemble((A, B), x0, u, 1, keep="covariance runs", rng=1, **options)
        assert (found.variance, found.covariance, found.standard_error) == (None, None, None)
        largest = np.abs(found.runs).max()
        assert_allclose(found.mean, found.runs[0], rtol=0, atol=1e-14 * largest)


def test_a_large_mean_does_not_hide_the_variance() -> None:
    """Sums of squares would lose it: the mean is 1e9, the variance about 1."""
    A, B = np.eye(2), np.array([[1.0, -0.5], [0.25, 1.0]])
    u, x0 = np.ones((3, 2)), np.array([1e9, -1e9])
    found = se.simulate_ensemble((A, B), x0, u, 5000, sampled="B", keep="runs", rng=1)
    expected = found.runs.var(axis=0, ddof=1)
    assert_allclose(found.variance, expected, rtol=1e-6, atol=1e-12)
    assert np.all(found.variance[1:] > 0.1)


# -- contracts -----------------------------------------------------------------------------------


def test_the_key_repeats_the_result() -> None:
    A, B, u, x0 = problem("plain")
    for options in ({}, {"averaging": "mean-field", "replicates": 5}):
        first = se.simulate_ensemble((A, B), x0, u, 100, **options)
        again = se.simulate_ensemble((A, B), x0, u, 100, rng=first.key, **options)
        other = se.simulate_ensemble((A, B), x0, u, 100, **options)
        assert np.array_equal(first.mean, again.mean)
        assert np.array_equal(first.variance, again.variance)
        assert not np.array_equal(first.mean, other.mean)
    assert first.status == "completed"


# -- the law of the runs -------------------------------------------------------------------------
