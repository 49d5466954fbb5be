"""Each assumption is needed: without it the coverage is visibly below the level."""

from __future__ import annotations

import numpy as np
import pytest

from identification_data import (
    DELTA,
    LAMS,
    at_most,
    coverage,
    hull,
    independent,
    misses,
    noisy_states,
    tuned,
)
from stochens_rs.reference import anytime as at
from stochens_rs.reference import fusing_by_data as fd
from stochens_rs.reference import quantiles as qu
from stochens_rs.reference import regions as rg
from stochens_rs.reference import residual_tests as rt
from stochens_rs.reference import signs
from stochens_rs.reference import triangle as tr


@pytest.mark.parametrize(("r", "limit"), [(1, 0.5), (3, 0.85)])
def test_directions_must_be_fixed_before_the_outcomes(r, limit):
    q = qu.roy_quantile(4, r, 34, DELTA)

    def holds(gen, Theta, z, y):  # at the worst direction, which needs the outcomes
        return rg.pivot(rg.full(tr.triangle(z, y), DELTA), Theta)[-1] <= q

    assert coverage(misses(60, 400, holds), 400) < limit


def test_scalar_covariance_must_be_scalar():
    def holds(gen, Theta, z, y):
        return rg.contains(rg.scalar(tr.triangle(z, y), DELTA), Theta)

    root = np.diag([1.0, 0.1, 0.1, 0.1])
    assert coverage(misses(61, 400, holds, root=root), 400) < 0.7


def test_pairs_must_not_be_counted_twice():
    def holds(gen, Theta, z, y):
        data = tr.triangle(z, y)
        return rg.contains(rg.full(tr.merge(data, data), DELTA), Theta)

    assert coverage(misses(62, 400, holds), 400) < 0.5


@pytest.mark.parametrize(("tails", "limit"), [(1e9, 0.8), (3, 0.1)])
def test_noise_that_grows_with_the_regressor_breaks_the_region_and_the_warning_fires(tails, limit):
    """How much depends on the tails of the regressors: 0.6 for Gaussian ones, near 0 for t(3)."""
    gen, runs, failed, fired = np.random.default_rng(63), 100, 0, 0
    for _ in range(runs):
        Theta = gen.standard_normal((4, 6))
        z = gen.standard_t(tails, (100, 6))
        y = z @ Theta.T + np.sum(z * z, axis=1, keepdims=True) * gen.standard_normal((100, 4))
        failed += not rg.contains(rg.full(tr.triangle(z, y), DELTA), Theta)
        fired += rt.p_values(z, y, 19, gen)[3] <= 0.0501
    assert coverage(failed, runs) < limit
    assert fired > 0.9 * runs


def test_heavy_tails_alone_do_not_break_the_region():
    gen, runs, failed = np.random.default_rng(64), 800, 0
    for _ in range(runs):
        Theta, z, _ = independent(gen)
        y = z @ Theta.T + gen.standard_t(2, (40, 4))
        failed += not rg.contains(rg.full(tr.triangle(z, y), DELTA), Theta)
    at_most(failed, runs)


def test_an_exact_region_must_not_be_looked_at_again_and_again():
    gen, runs, failed = np.random.default_rng(65), 80, 0
    for _ in range(runs):
        Theta, z, y = independent(gen, n=2, d=3, N=200)
        data = tr.triangle(z[:7], y[:7])
        for t in range(7, 200):
            data = tr.update(data, z[t], y[t])
            if t % 4 == 0 and not rg.contains(rg.full(data, DELTA), Theta):
                failed += 1
                break
    assert coverage(failed, runs) < 0.8


def test_a_random_walk_with_offset_breaks_the_exact_region():
    gen, runs, failed = np.random.default_rng(66), 500, 0
    for _ in range(runs):
        x = np.cumsum(gen.standard_normal((101, 1)), axis=0)
        z, y = tr.pairs([(x, np.zeros((100, 0)))], offset=True)
        failed += not rg.contains(rg.full(tr.triangle(z, y), DELTA), [[1.0, 0.0]])
    assert coverage(failed, runs) < 0.88


def test_states_read_with_error_break_the_exact_region_and_the_warning_fires():
    gen, runs, failed, fired = np.random.default_rng(67), 60, 0, 0
    for _ in range(runs):
        Theta, run = noisy_states(gen, 400, 0.3)
        z, y = tr.pairs([run])
        failed += not rg.contains(rg.full(tr.triangle(z, y), DELTA), Theta)
        fired += rt.p_values(z, y, 19, gen)[1] <= 0.0501
    assert coverage(failed, runs) < 0.6
    assert fired > 0.9 * runs


def test_models_fitted_on_the_same_data_break_the_certificate():
    gen, runs, failed = np.random.default_rng(68), 150, 0
    for _ in range(runs):
        Theta, z, y = independent(gen, N=30)
        m = tr.fit(tr.triangle(z, y))
        fused = fd.fuse([m.H, *hull(gen, Theta, 0.5, 3.0, M=2)], m)
        error = np.linalg.norm((fused.F - Theta) @ m.root.T)
        failed += error**2 > fd.certificate(fused, 1.0, DELTA).factor
    assert coverage(failed, runs) < 0.1


def test_closed_loop_breaks_the_exact_region():
    gen, runs, any_look = np.random.default_rng(69), 200, 0
    for _ in range(runs):
        Theta, run = tuned(gen, 150)
        z, y = tr.pairs([run])
        any_look += not all(
            rg.contains(rg.full(tr.triangle(z[:N], y[:N]), DELTA), Theta) for N in (8, 20, 60, 150)
        )
    assert coverage(any_look, runs) < 0.9


def test_a_design_that_stops_when_the_noise_has_pushed_breaks_the_exact_region():
    """One look, at a fixed N: four looks fail as often without feedback, this is feedback alone."""
    gen, runs = np.random.default_rng(72), 400
    failed = np.zeros(2, dtype=int)
    for _ in range(runs):
        w, z, M, V = gen.standard_normal(100), np.ones(100), 0.0, 0.0
        for t in range(100):
            z[t] = 1.0 if abs(M) < 2.0 * np.sqrt(V) or t < 2 else 1e-3
            M, V = M + w[t] * z[t], V + z[t] ** 2
        data = tr.triangle(z[:, None], 0.5 * z[:, None] + w[:, None])
        failed[0] += not rg.contains(rg.full(data, DELTA), [[0.5]])
        failed[1] += not rg.contains(at.known_noise(data, 1.0, DELTA), [[0.5]])
    assert coverage(failed[0], runs) < 0.85
    at_most(failed[1], runs)


def test_feedback_inside_breaks_the_regression_over_several_steps():
    gen, runs, failed = np.random.default_rng(73), 100, 0
    for _ in range(runs):
        z, y = [], []
        for _ in range(40):
            x0, w = gen.standard_normal(), gen.standard_normal(2)
            u0 = gen.standard_normal()
            x1 = 0.9 * x0 + u0 + w[0]
            u1 = -0.8 * x1 + 0.1 * gen.standard_normal()
            z.append([x0, u0, u1])
            y.append([0.9 * x1 + u1 + w[1]])
        failed += not rg.contains(rg.full(tr.triangle(z, y), DELTA), [[0.81, 0.9, 1.0]])
    assert coverage(failed, runs) < 0.05


def test_the_residual_of_missing_rows_must_be_counted():
    mix = np.random.default_rng(74).standard_normal((3, 6))
    gen, runs, failed = np.random.default_rng(75), 400, 0
    for _ in range(runs):
        Theta, z = gen.standard_normal((2, 6)), gen.standard_normal((12, 3)) @ mix
        data = tr.triangle(z, z @ Theta.T + gen.standard_normal((12, 2)))
        region = rg.full(data, DELTA)
        short = region._replace(S=data.R[6:, 6:].T @ data.R[6:, 6:])
        failed += not rg.contains(short, Theta)
    assert coverage(failed, runs) < 0.9


def test_a_changing_covariance_breaks_the_region_of_one_covariance():
    """Noise that is large while the regressors are: allowed for known sigma, not for unknown."""
    gen, runs, failed = np.random.default_rng(70), 100, np.zeros(2, dtype=int)
    size = np.where(np.arange(400) < 8, 10.0, 0.1)[:, None]
    for _ in range(runs):
        Theta, z, _ = independent(gen, n=2, d=3, N=400)
        z = z * size
        data = tr.triangle(z, z @ Theta.T + size * gen.standard_normal((400, 2)))
        failed[0] += not rg.contains(at.gaussian_noise(data, DELTA, LAMS), Theta)
        failed[1] += not rg.contains(at.known_noise(data, 10.0, DELTA, LAMS), Theta)
    assert coverage(failed[0], runs) < 0.6
    at_most(failed[1], runs)


def test_sign_vectors_must_not_be_filtered():
    gen, runs, failed = np.random.default_rng(71), 700, 0
    for _ in range(runs):
        z, w = gen.standard_normal((6, 3)), gen.standard_normal((6, 1))
        basis = np.linalg.qr(z)[0]
        vectors = signs.sign_vectors(200, 6, gen)
        bounded = [a for a in vectors if 3 <= np.sum(a > 0) <= 3][:9]
        failed += not signs.contains(w, basis, np.array(bounded), 1, gen)
    assert coverage(failed, runs) < 0.9 - 4 * np.sqrt(0.09 / runs)
