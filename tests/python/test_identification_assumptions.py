"""Each assumption is needed: without it the coverage is visibly below the level."""

from __future__ import annotations

import numpy as np
import pytest

from coverage_study import DELTA, at_most, coverage, failures
from identification_data import LAMS, hull, independent, misses, noisy_states, tuned
from twin import anytime as at
from twin import fusing_by_data as fd
from twin import quantiles as qu
from twin import regions as rg
from twin import residual_tests as rt
from twin import triangle as tr


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
    runs = 100

    def case(gen):
        Theta = gen.standard_normal((4, 6))
        z = gen.standard_t(tails, (100, 6))
        y = z @ Theta.T + np.sum(z * z, axis=1, keepdims=True) * gen.standard_normal((100, 4))
        outside = not rg.contains(rg.full(tr.triangle(z, y), DELTA), Theta)
        return outside, rt.p_values(z, y, 19, gen)[3] <= 0.0501

    failed, fired = failures(case, runs, 63)
    assert coverage(failed, runs) < limit
    assert fired > 0.9 * runs


def test_heavy_tails_alone_do_not_break_the_region():
    runs = 800

    def failed(gen):
        Theta, z, _ = independent(gen)
        y = z @ Theta.T + gen.standard_t(2, (40, 4))
        return not rg.contains(rg.full(tr.triangle(z, y), DELTA), Theta)

    at_most(failures(failed, runs, 64), runs)


def test_an_exact_region_must_not_be_looked_at_again_and_again():
    runs = 80

    def failed(gen):
        Theta, z, y = independent(gen, n=2, d=3, N=200)
        data = tr.triangle(z[:7], y[:7])
        for t in range(7, 200):
            data = tr.update(data, z[t], y[t])
            if t % 4 == 0 and not rg.contains(rg.full(data, DELTA), Theta):
                return True
        return False

    assert coverage(failures(failed, runs, 65), runs) < 0.8


def test_a_random_walk_with_offset_breaks_the_exact_region():
    runs = 500

    def failed(gen):
        x = np.cumsum(gen.standard_normal((101, 1)), axis=0)
        z, y = tr.pairs([(x, np.zeros((100, 0)))], offset=True)
        return not rg.contains(rg.full(tr.triangle(z, y), DELTA), [[1.0, 0.0]])

    assert coverage(failures(failed, runs, 66), runs) < 0.88


def test_states_read_with_error_break_the_exact_region_and_the_warning_fires():
    runs = 60

    def case(gen):
        Theta, run = noisy_states(gen, 400, 0.3)
        z, y = tr.pairs([run])
        outside = not rg.contains(rg.full(tr.triangle(z, y), DELTA), Theta)
        return outside, rt.p_values(z, y, 19, gen)[1] <= 0.0501

    failed, fired = failures(case, runs, 67)
    assert coverage(failed, runs) < 0.6
    assert fired > 0.9 * runs


def test_models_fitted_on_the_same_data_break_the_certificate():
    runs = 150

    def failed(gen):
        Theta, z, y = independent(gen, N=30)
        m = tr.fit(tr.triangle(z, y))
        fused = fd.fuse([m.H, *hull(gen, Theta, 0.5, 3.0, M=2)], m)
        error = np.linalg.norm((fused.F - Theta) @ m.root.T)
        return error**2 > fd.certificate(fused, 1.0, DELTA).factor

    assert coverage(failures(failed, runs, 68), runs) < 0.1


def test_closed_loop_breaks_the_exact_region():
    runs = 200

    def any_look(gen):
        Theta, run = tuned(gen, 150)
        z, y = tr.pairs([run])
        return not all(
            rg.contains(rg.full(tr.triangle(z[:N], y[:N]), DELTA), Theta) for N in (8, 20, 60, 150)
        )

    assert coverage(failures(any_look, runs, 69), runs) < 0.9


def test_a_design_that_stops_when_the_noise_has_pushed_breaks_the_exact_region():
    """One look, at a fixed N: four looks fail as often without feedback, this is feedback alone."""
    runs = 400

    def case(gen):
        w, z, M, V = gen.standard_normal(100), np.ones(100), 0.0, 0.0
        for t in range(100):
            z[t] = 1.0 if abs(M) < 2.0 * np.sqrt(V) or t < 2 else 1e-3
            M, V = M + w[t] * z[t], V + z[t] ** 2
        data = tr.triangle(z[:, None], 0.5 * z[:, None] + w[:, None])
        regions = rg.full(data, DELTA), at.known_noise(data, 1.0, DELTA)
        return [not rg.contains(region, [[0.5]]) for region in regions]

    failed = failures(case, runs, 72)
    assert coverage(failed[0], runs) < 0.85
    at_most(failed[1], runs)


def test_feedback_inside_breaks_the_regression_over_several_steps():
    runs = 100

    def failed(gen):
        z, y = [], []
        for _ in range(40):
            x0, w = gen.standard_normal(), gen.standard_normal(2)
            u0 = gen.standard_normal()
            x1 = 0.9 * x0 + u0 + w[0]
            u1 = -0.8 * x1 + 0.1 * gen.standard_normal()
            z.append([x0, u0, u1])
            y.append([0.9 * x1 + u1 + w[1]])
        return not rg.contains(rg.full(tr.triangle(z, y), DELTA), [[0.81, 0.9, 1.0]])

    assert coverage(failures(failed, runs, 73), runs) < 0.05


def test_the_residual_of_missing_rows_must_be_counted():
    mix = np.random.default_rng(74).standard_normal((3, 6))
    runs = 400

    def failed(gen):
        Theta, z = gen.standard_normal((2, 6)), gen.standard_normal((12, 3)) @ mix
        data = tr.triangle(z, z @ Theta.T + gen.standard_normal((12, 2)))
        region = rg.full(data, DELTA)
        short = region._replace(S=data.R[6:, 6:].T @ data.R[6:, 6:])
        return not rg.contains(short, Theta)

    assert coverage(failures(failed, runs, 75), runs) < 0.9


def test_a_changing_covariance_breaks_the_region_of_one_covariance():
    """Noise that is large while the regressors are: allowed for known sigma, not for unknown."""
    runs = 100
    size = np.where(np.arange(400) < 8, 10.0, 0.1)[:, None]

    def case(gen):
        Theta, z, _ = independent(gen, n=2, d=3, N=400)
        z = z * size
        data = tr.triangle(z, z @ Theta.T + size * gen.standard_normal((400, 2)))
        regions = at.gaussian_noise(data, DELTA, LAMS), at.known_noise(data, 10.0, DELTA, LAMS)
        return [not rg.contains(region, Theta) for region in regions]

    failed = failures(case, runs, 70)
    assert coverage(failed[0], runs) < 0.6
    at_most(failed[1], runs)
