"""Runs of given systems, each once: `simulate_ensemble` of a SystemEnsemble."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError


def problem(N: int, n: int, m: int, K: int, *, offset: bool, each: bool, seed: int = 1):
    gen = np.random.default_rng(seed)
    A = gen.standard_normal((N, n, n)) / np.sqrt(n)
    B, c = gen.standard_normal((N, n, m)), gen.standard_normal((N, n)) if offset else None
    models = se.SystemEnsemble(A, B, c, centre="estimate", dt=0.5)
    return models, gen.standard_normal((N, n) if each else n), gen.standard_normal((K, m))


def loop(models: se.SystemEnsemble, x0: np.ndarray, u: np.ndarray) -> np.ndarray:
    """All runs (N, K + 1, n), with the terms of a product added from the first column on."""
    N, n, m = models.size, models.n, models.m
    runs = np.empty((N, len(u) + 1, n))
    for s in range(N):
        runs[s, 0] = x0 if x0.ndim == 1 else x0[s]
        for k in range(len(u)):
            total = np.zeros(n)
            for j in range(n):
                total += models.A[s, :, j] * runs[s, k, j]
            for j in range(m):
                total += models.B[s, :, j] * u[k, j]
            runs[s, k + 1] = total if models.c is None else total + models.c[s]
    return runs


SHAPES = [(1, 3, 2, 4), (2, 1, 1, 1), (31, 2, 3, 6), (32, 4, 1, 3), (33, 3, 2, 0), (150, 5, 2, 7)]


@pytest.mark.parametrize("each", [False, True])
@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_runs_are_those_of_a_loop_bit_for_bit_and_moments_those_of_the_runs(shape, offset, each):
    models, x0, u = problem(*shape, offset=offset, each=each)
    found = se.simulate_ensemble(models, x0, u, keep="covariance runs")
    expected = loop(models, x0, u)
    assert found.runs.tobytes() == expected.tobytes()
    # against a mean in double-double: both sums have an error of some ulp of the largest run
    size = np.abs(expected).max(axis=0)
    mean = expected.astype(np.longdouble).mean(axis=0)
    assert (np.abs(found.mean - mean) <= 4e-16 * size).all()
    if models.size == 1:
        assert found.variance is found.covariance is found.standard_error is None
        return
    d = expected - mean
    covariance = np.einsum("ski,skj->kij", d, d) / (models.size - 1)
    scale = np.abs(np.einsum("ski,skj->kij", np.abs(d), np.abs(d))) / (models.size - 1)
    assert (np.abs(found.covariance - covariance) <= 1e-14 * scale + 1e-300).all()
    diagonal = se.simulate_ensemble(models, x0, u)
    assert diagonal.runs is diagonal.covariance is None
    np.testing.assert_array_equal(diagonal.mean, found.mean)
    np.testing.assert_allclose(diagonal.variance, found.variance, rtol=1e-14, atol=0)
    variances = np.diagonal(found.covariance, axis1=1, axis2=2)
    np.testing.assert_array_equal(found.variance, variances)


def test_one_system_runs_as_simulate_does():
    models, x0, u = problem(3, 6, 2, 8, offset=False, each=False)
    runs = se.simulate_ensemble(models, x0, u, keep="runs").runs
    for s, system in enumerate(models):
        np.testing.assert_array_equal(runs[s], se.simulate(system, x0, u).states)


def test_no_digits_are_lost_far_from_zero():
    """Equal runs have no variance; runs near 1e8 have that of their differences."""
    A, B = np.array([[[1.0]], [[-1.0]]] * 40), np.ones((80, 1, 1))
    found = se.simulate_ensemble(se.SystemEnsemble(A, B), [3e7], np.zeros((2, 1)))
    assert found.variance[[0, 2]].tolist() == [[0.0], [0.0]]
    assert found.variance[1, 0] == pytest.approx(80 / 79 * 9e14, rel=1e-15)
    start = 1e8 + np.arange(64.0)[:, None]
    one = se.SystemEnsemble(np.ones((64, 1, 1)), np.zeros((64, 1, 1)))
    found = se.simulate_ensemble(one, start, np.zeros((1, 1)))
    np.testing.assert_allclose(found.variance, np.var(np.arange(64.0), ddof=1), rtol=1e-15)


def test_models_of_a_bootstrap_are_run():
    """The spread of a step from one state is that of the estimate, which has a formula."""
    gen = np.random.default_rng(8)
    x, u, w = gen.standard_normal((3, 400, 1))
    data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
    model = se.identify(data, noise=se.Noise(design="independent", sigma=0.1))
    models = model.draw(20_000, rng=1)
    found = se.simulate_ensemble(models, [1.0], [[2.0]])
    V = np.hstack([x, u]).T @ np.hstack([x, u])
    z = np.array([1.0, 2.0])
    exact = 0.01 * z @ np.linalg.solve(V, z)
    assert found.variance[1, 0] == pytest.approx(exact, rel=5 * np.sqrt(2 / 20_000))
    np.testing.assert_allclose(found.mean[1], model.A @ [1.0] + model.B @ [2.0], atol=1e-3)


def test_slices_of_models():
    models, _, _ = problem(7, 2, 1, 1, offset=True, each=False)
    part = models[1:6:2]
    assert isinstance(part, se.SystemEnsemble)
    assert (part.size, part.centre, part.dt) == (3, "estimate", 0.5)
    np.testing.assert_array_equal(part.A, models.A[1:6:2])
    np.testing.assert_array_equal(part.c, models.c[1:6:2])
    assert models[::-1][::-1] == models
    with pytest.raises(InputError, match="at least one model"):
        models[7:]


def test_memory_is_asked_for_first(monkeypatch):
    models, x0, u = problem(50_000, 2, 1, 4000, offset=False, each=False)
    monkeypatch.setattr("stochens_rs._base.running.memory_left", lambda: 1 << 30)
    with pytest.raises(se.exceptions.ResourceError, match="and the runs of 50000 trajectories"):
        se.simulate_ensemble(models, x0, u, keep="runs")
