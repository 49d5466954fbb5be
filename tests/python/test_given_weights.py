"""Weights that are given, or follow from variances: equations, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from declarations import opts
from stochens_rs.exceptions import InputError

INDEPENDENT = {"design": "independent", "checks": False}


def experiments(gen, counts, *, n=3, d=5, scales=None):
    """Data of several experiments with one system, of unlike size and excitation."""
    Theta = gen.standard_normal((n, d))
    found = []
    for k, N in enumerate(counts):
        size = 1.0 if scales is None else scales[k]
        z = size * gen.standard_normal((N, d))
        y = z @ Theta.T + 0.1 * gen.standard_normal((N, n))
        found.append(se.Trajectories.from_pairs(z[:, :n], z[:, n:], y))
    return Theta, found


def test_weights_that_are_given():
    realizations = se.Ensemble.from_samples([[1.0, 0.0], [0.0, 1.0], [2.0, 2.0]])
    fit = se.fuse(realizations, weights=[2, 1, 1], target=[1.0, 1.0])
    assert (fit.method, fit.status, fit.info) == ("weighted", "completed", {})
    np.testing.assert_allclose(fit.weights, [0.5, 0.25, 0.25])
    np.testing.assert_allclose(fit.estimate, [1.0, 0.75])
    assert fit.error == pytest.approx(0.25)
    drawn = se.sample([3.0, -1.0, 2.0], 40, rng=1)
    w = np.linspace(0.0, 1.0, 40)
    np.testing.assert_allclose(
        se.fuse(drawn, weights=w).estimate, w @ drawn.dense() / w.sum(), rtol=1e-12
    )


def test_precision_weights_are_best_and_their_error_is_as_stated():
    """4000 runs of 3 realizations, in `make test` 800: rms within 4 standard errors."""
    gen, v = np.random.default_rng(7), np.array([1.0, 4.0, 100.0])
    errors, equal, count = [], [], sets(4000, 800)
    for _ in range(count):
        E = np.array([5.0, -2.0]) + np.sqrt(v / 2.0)[:, None] * gen.standard_normal((3, 2))
        realizations = se.Ensemble.from_samples(E)
        fit = se.fuse(realizations, weights="precision", variances=v)
        mean = se.fuse(realizations, variances=v)
        errors.append(np.sum((fit.estimate - [5.0, -2.0]) ** 2))
        equal.append(np.sum((mean.estimate - [5.0, -2.0]) ** 2))
    assert (fit.method, mean.method) == ("precision", "uniform")
    np.testing.assert_allclose(fit.weights, 1.0 / v / np.sum(1.0 / v))
    assert fit.info["rms"] == pytest.approx(np.sum(1.0 / v) ** -0.5)
    assert mean.info["rms"] == pytest.approx(np.sqrt(105.0) / 3.0)
    for found, stated in ((errors, fit.info["rms"]), (equal, mean.info["rms"])):
        assert abs(np.mean(found) - stated**2) < 4.0 * np.std(found) / np.sqrt(count)


def test_weights_of_models():
    models = se.SystemEnsemble([[[1.0]], [[0.5]]], [[[1.0]], [[2.0]]], [[0.0], [4.0]])
    assert se.fuse(models).estimate.tolist() == [[0.75, 1.5, 2.0]]
    fit = se.fuse(models, weights=[3.0, 1.0])
    assert fit.estimate.tolist() == [[0.875, 1.25, 1.0]]
    near = se.fuse(models, "alse", target=[[0.75, 1.5, 2.0]])
    assert near.error < 1e-4


def test_precision_of_experiments():
    """Variances in proportion to tr V_i^-1 come near to pooling, equal weights do not."""
    gen, errors = np.random.default_rng(8), []
    for _ in range(200):
        Theta, sets = experiments(gen, [8, 10, 60], n=2, d=3, scales=[0.2, 1.0, 1.0])
        models = [se.identify(one, **opts(**INDEPENDENT)) for one in sets]
        v = [np.sum(m.blocks[0].white ** 2) for m in models]
        apart = se.SystemEnsemble([m.A for m in models], [m.B for m in models], centre="truth")
        pooled = se.identify(sets, **opts(**INDEPENDENT))
        found = [
            np.hstack([pooled.A, pooled.B]),
            se.fuse(apart, weights="precision", variances=v).estimate,
            se.fuse(apart).estimate,
        ]
        errors.append([np.sum((H - Theta) ** 2) for H in found])
    pooled, precision, equal = np.mean(errors, axis=0)
    assert pooled < precision < 0.1 * equal


def test_a_bound_needs_more_than_weights_of_its_own():
    x0 = se.sample([1.0, 2.0], 50, rng=1)
    fit = se.fuse(x0, weights=np.arange(1.0, 51.0))
    plan = se.control(([[0.9, 0.2], [-0.1, 0.8]], [[0.0], [1.0]]), fit, [0.0, 1.0])
    with pytest.raises(InputError, match="with its own weights"):
        plan.bound(0.05, x0=[1.0, 2.0])
