"""Trajectories: exact, in random runs, and as a mean field.

The core is compared with the NumPy twin bit for bit, and with an independent oracle: the exact
distribution of a small system, enumerated atom by atom, and the recursion of its covariance, which
the enumeration confirms. Statistical tests have fixed keys and state their false-alarm rates; each
is shown a mutant that it must catch.
"""

from __future__ import annotations

import hashlib
import itertools
import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

import stochens_rs as se
from stochens_rs import reference as twin
from stochens_rs.exceptions import (
    NonFiniteError,
)

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
    assert_allclose(states, twin.simulate(A, B, x0, u), rtol=0, atol=1e-12 * np.abs(states).max())


def test_fields_of_a_trajectory() -> None:
    u = np.array([[1.0], [2.0]])
    path = se.simulate(se.System([[0.5, 0.0], [1.0, 0.0]], [[1.0], [0.0]], dt=0.25), [4.0, 0.0], u)
    assert path.states.tolist() == [[4.0, 0.0], [3.0, 4.0], [3.5, 3.0]]
    assert path.times.tolist() == [0.0, 0.25, 0.5]
    assert (path.dt, path.steps) == (0.25, 2)
    assert np.array_equal(path.inputs, u)
    u[0, 0] = 9.0  # the record has its own copy
    assert path.inputs[0, 0] == 1.0
    for dt in (None, True):
        unstated = se.simulate(se.System([[0.5]], [[1.0]], dt=dt), [0.0], [[1.0]])
        assert unstated.times.tolist() == [0.0, 1.0]
        assert unstated.dt is None


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
        expected = twin.simulate_runs(A, B, x0, u, 70, key=root_key(7), sampled=sampled)
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
        (A, B),
        x0,
        u,
        9,
        averaging="mean-field",
        replicates=37,
        keep="covariance runs",
        rng=3,
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


def test_nothing_drawn_is_the_exact_trajectory() -> None:
    gen = np.random.default_rng(1)
    A, B = gen.standard_normal((300, 300)) / 20, gen.standard_normal((300, 4))
    u, x0 = gen.standard_normal((6, 4)), gen.standard_normal(300)
    exact = se.simulate((A, B), x0, u).states
    for averaging in ("runs", "mean-field"):
        found = se.simulate_ensemble(
            (A, B),
            x0,
            u,
            40,
            sampled=(),
            averaging=averaging,
            replicates=1 if averaging == "runs" else 3,
            rng=1,
        )
        assert_allclose(found.mean, exact, rtol=0, atol=1e-13 * np.abs(exact).max())
        assert np.all(found.variance <= 1e-26 * np.abs(exact).max() ** 2)


# -- contracts -----------------------------------------------------------------------------------


@pytest.fixture
def threads_restored() -> Iterator[None]:
    yield
    se.set_num_threads(os.cpu_count() or 1)


@pytest.mark.usefixtures("threads_restored")
@pytest.mark.parametrize("averaging", ["runs", "mean-field"])
def test_threads_do_not_change_a_bit(averaging: str) -> None:
    A, B, u, x0 = problem("first inputs zero")
    options: dict[str, Any] = {"averaging": averaging, "keep": ("covariance", "runs")}
    if averaging == "mean-field":
        options["replicates"] = 100
    results = []
    for threads in (1, 2, 3):
        se.set_num_threads(threads)
        found = se.simulate_ensemble((A, B), x0, u, 7000, rng=1, **options)
        results.append([found.mean, found.variance, found.covariance, found.runs])
    for other in results[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_a_larger_ensemble_starts_with_the_smaller_one() -> None:
    A, B, u, x0 = problem("plain")
    whole = se.simulate_ensemble((A, B), x0, u, 2100, rng=1, keep="runs").runs
    for size in (1, 31, 33, 1024, 1025):
        part = se.simulate_ensemble((A, B), x0, u, size, rng=1, keep="runs").runs
        assert np.array_equal(part, whole[:size])


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


def test_zero_in_zero_out() -> None:
    for averaging in ("runs", "mean-field"):
        found = se.simulate_ensemble(
            (integers(1, 4, 4), np.ones((4, 2))),
            np.zeros(4),
            np.zeros((3, 2)),
            100,
            averaging=averaging,
            replicates=1 if averaging == "runs" else 4,
            rng=1,
        )
        assert not found.mean.any()
        assert not found.variance.any()


# -- the law of the runs -------------------------------------------------------------------------


def matrix_atoms(M: Array) -> list[tuple[float, Array]]:
    """Every realization of a matrix by columns, with its probability."""
    columns = []
    for column in M.T:
        g = np.abs(column).sum()
        unit = np.eye(len(column))
        columns.append(
            [(abs(v) / g, g * np.sign(v) * unit[i]) for i, v in enumerate(column) if v != 0.0]
            or [(1.0, 0.0 * column)]
        )
    return [
        (float(np.prod([p for p, _ in choice])), np.stack([c for _, c in choice], axis=1))
        for choice in itertools.product(*columns)
    ]


def enumerate_runs(A: Array, B: Array, u: Array, x0: Array) -> list[dict[tuple[float, ...], float]]:
    """The exact distribution of x^s(k), k = 0..K: states with their probabilities."""
    law: dict[tuple[float, ...], float] = {}
    for p, column in matrix_atoms(x0[:, None]):
        state = tuple(column[:, 0])
        law[state] = law.get(state, 0.0) + p
    laws = [law]
    atoms_A, atoms_B = matrix_atoms(A), matrix_atoms(B)
    for u_k in u:
        law, pushes = {}, [(p, b @ u_k) for p, b in atoms_B]
        for x, p in laws[-1].items():
            for (q, a), (r, push) in itertools.product(atoms_A, pushes):
                state = tuple(a @ np.array(x) + push)
                law[state] = law.get(state, 0.0) + p * q * r
        laws.append(law)
    return laws


def recursion(A: Array, B: Array, u: Array, x0: Array, size: float = 1.0) -> tuple[Array, Array]:
    """Means (K + 1, n) and covariances (K + 1, n, n) of a run, or of a mean field of `size`."""

    def T(M: Array, d: Array) -> Array:
        return np.diag(np.abs(M) @ (np.abs(M).sum(axis=0) * d)) - M @ np.diag(d) @ M.T

    mu, S = [x0], [T(x0[:, None], np.ones(1)) / size]
    for u_k in u:
        d = np.diag(S[-1]) + mu[-1] ** 2
        S.append(A @ S[-1] @ A.T + (T(A, d) + T(B, u_k**2)) / size)
        mu.append(A @ mu[-1] + B @ u_k)
    return np.array(mu), np.array(S)


SMALL = {
    "n=2, K=3": (2, 1, 3),
    "n=3, K=2": (3, 1, 2),
}


def excess(observed: NDArray[np.int64], p: Array) -> float:
    """Chi-square over its quantile at 1e-6 (Wilson-Hilferty, z = 4.75); rare cells are pooled."""
    expected = observed.sum() * p
    rare = expected < 10
    if rare.any():
        observed = np.append(observed[~rare], observed[rare].sum())
        expected = np.append(expected[~rare], expected[rare].sum())
    dof = len(expected) - 1
    statistic = float(np.sum((observed - expected) ** 2 / expected))
    quantile = dof * (1 - 2 / (9 * dof) + 4.75 * np.sqrt(2 / (9 * dof))) ** 3
    return statistic / quantile


def hits(states: Array, law: dict[tuple[float, ...], float]) -> NDArray[np.int64]:
    found, counts = np.unique(states, axis=0, return_counts=True)
    at = {state: i for i, state in enumerate(law)}
    observed = np.zeros(len(law), dtype=np.int64)
    for state, count in zip(found, counts, strict=True):
        observed[at[tuple(state)]] += count  # a state outside the law is a KeyError
    return observed


@pytest.mark.parametrize("name", SMALL)
def test_runs_have_the_law(name: str) -> None:
    """200 000 runs against the exact distribution at every step; at most 4 tests at 1e-6."""
    n, m, K = SMALL[name]
    A, B, u, x0 = integers(11, n, n), integers(12, n, m), integers(13, K, m), integers(14, n)
    laws = enumerate_runs(A, B, u, x0)
    runs = se.simulate_ensemble((A, B), x0, u, 200_000, keep="runs", rng=1).runs
    for k, law in enumerate(laws):
        if len(law) > 1:
            assert excess(hits(runs[:, k], law), np.array(list(law.values()))) < 1.0
    # the mutant: one realization of A kept over time
    gen = np.random.default_rng(1)
    atoms, p = [a for _, a in matrix_atoms(A)], [q for q, _ in matrix_atoms(A)]
    kept = np.array(atoms)[gen.choice(len(atoms), 200_000, p=p)]
    x = runs[:, 0]
    for k in range(K):
        pushes = [b @ u[k] for _, b in matrix_atoms(B)]
        chosen = gen.choice(len(pushes), len(x), p=[q for q, _ in matrix_atoms(B)])
        x = np.einsum("sij,sj->si", kept, x) + np.array(pushes)[chosen]
    assert excess(hits(x, laws[-1]), np.array(list(laws[-1].values()))) > 1.0


def gaussian(n: int, m: int, seed: int) -> tuple[Array, Array, Array]:
    """A with spectral radius 1, B and x0."""
    gen = np.random.default_rng(seed)
    A = gen.standard_normal((n, n))
    A /= np.abs(np.linalg.eigvals(A)).max()
    return A, gen.standard_normal((n, m)), gen.standard_normal(n)


def test_runs_are_unbiased_and_reused_realizations_are_not() -> None:
    """n = 10, K = 6, 2e5 runs: |mean - x(k)| over its predicted rms sqrt(tr S_k / N).

    In the normal limit a ratio above 3 has a probability below 1e-4 even for one direction that
    dominates. The mutant keeps one realization of A over time.
    """
    A, B, x0 = gaussian(10, 5, 1)
    u = np.random.default_rng(2).standard_normal((6, 5))
    N = 200_000
    mu, S = recursion(A, B, u, x0)
    rms = np.sqrt(np.einsum("kii->k", S) / N)
    found = se.simulate_ensemble((A, B), x0, u, N, rng=1)
    assert np.all(np.linalg.norm(found.mean - mu, axis=1) / rms < 3.0)
    variance = np.einsum("kii->ki", S).sum(axis=1)
    assert_allclose(found.variance.sum(axis=1), variance, rtol=0.1)

    free = np.zeros((2, 5))
    mu, S = recursion(A, B, free, x0)
    size = 20_000
    draws, start = se.sample(A, size, rng=3), se.sample(x0, size, rng=4).dense()
    reused = draws.dense()
    x2 = np.einsum("sij,sjk,sk->si", reused, reused, start, optimize=True).mean(axis=0)
    error = np.linalg.norm(x2 - mu[2]) / np.sqrt(np.trace(S[2]) / size)
    assert error > 3.0
    # E[(A^s)^2] = A^2 + diag(g_j |a_jj|) - A diag(a_jj)
    g, a = np.abs(A).sum(axis=0), np.diag(A)
    bias = (np.diag(g * np.abs(a)) - A * a) @ x0
    assert np.linalg.norm(x2 - mu[2] - bias) < 0.5 * np.linalg.norm(bias)


def z_scores(runs: Array, mu: Array, S: Array) -> Array:
    """Covariances around the exact mean against S, in their estimated standard errors."""
    d = runs - mu
    products = d[:, :, :, None] * d[:, :, None, :]
    error = products.std(axis=0) / np.sqrt(len(runs))
    return np.abs(products.mean(axis=0) - S) / np.where(error > 0, error, np.inf)


@pytest.mark.parametrize("averaging", ["runs", "mean-field"])
def test_covariances_follow_the_recursion(averaging: str) -> None:
    """40 000 trajectories, 24 different entries, |z| > 6: 5e-8 in all in the normal limit."""
    A, B, x0 = gaussian(3, 2, 5)
    u = np.random.default_rng(6).standard_normal((3, 2))
    N, count = 25, 40_000
    if averaging == "runs":
        size, options = 1.0, {"size": count}
    else:
        size, options = float(N), {"size": N, "averaging": averaging, "replicates": count}
    runs = se.simulate_ensemble((A, B), x0, u, rng=1, keep="runs", **options).runs
    mu, S = recursion(A, B, u, x0, size)
    assert np.all(z_scores(runs, mu, S) < 6.0)
    _, wrong = recursion(A, B, u, x0, 1.1 * size)
    assert np.any(z_scores(runs, mu, wrong) > 6.0)


def test_a_mean_field_beats_runs_over_several_steps() -> None:
    """n = 10, N = 200, K = 6, 500 replicates: the traces that the recursion predicts."""
    A, B, x0 = gaussian(10, 5, 1)
    u = np.random.default_rng(2).standard_normal((6, 5))
    N = 200
    found = se.simulate_ensemble((A, B), x0, u, N, averaging="mean-field", replicates=500, rng=1)
    mu, S = recursion(A, B, u, x0, N)
    expected = np.einsum("kii->k", S)
    assert_allclose(found.variance.sum(axis=1), expected, rtol=0.4)  # 10 % standard deviation
    assert np.all(np.linalg.norm(found.mean - mu, axis=1) < 4 * np.sqrt(expected / 500))
    _, of_runs = recursion(A, B, u, x0)
    assert np.trace(of_runs[6]) / N > 100 * expected[6]


# -- what is refused -----------------------------------------------------------------------------


def test_overflow_of_runs_is_named() -> None:
    grows = (1e60 * np.array([[1.0, -1.0], [-1.0, 1.0]]), np.zeros((2, 1)))
    u = np.zeros((8, 1))  # the exact trajectory of (1, 1) is 0; a run reaches (2e60)^8
    for averaging in ("runs", "mean-field"):
        with pytest.raises(NonFiniteError, match="a state of the ensemble overflows"):
            se.simulate_ensemble(grows, [1.0, 1.0], u, 10, averaging=averaging, rng=1)
    for keep in ((), "covariance"):
        with pytest.raises(NonFiniteError, match="a second moment of the ensemble overflows"):
            se.simulate_ensemble(grows, [1.0, 1.0], u[:3], 10, keep=keep, rng=1)


# -- figures ---------------------------------------------------------------------------------------
