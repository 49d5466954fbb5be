"""Each assumption is needed: without it the coverage is visibly below the level."""

from __future__ import annotations

import numpy as np

from coverage_study import DELTA, at_most, coverage, failures
from identification_data import LAMS, independent
from twin import anytime as at
from twin import regions as rg
from twin import triangle as tr


def test_heavy_tails_alone_do_not_break_the_region():
    runs = 800

    def failed(gen):
        Theta, z, _ = independent(gen)
        y = z @ Theta.T + gen.standard_t(2, (40, 4))
        return not rg.contains(rg.full(tr.triangle(z, y), DELTA), Theta)

    at_most(failures(failed, runs, 64), runs)


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
