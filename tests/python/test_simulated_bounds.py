"""Simulated bounds: the errors have the right law, and the order statistic is a valid bound."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import stats

import stochens_rs as se
import tail_bounds as bounds
from coverage_study import sets
from stochens_rs import _core
from stochens_rs.exceptions import SizeError
from stochens_rs.rng import as_key
from stochens_rs.theory import drawn_bounds as drawn_errors
from stochens_rs.theory.drawn_bounds import DrawnEntity as Entity
from stochens_rs.theory.drawn_bounds import PlanErrors

# -- the order statistic ---------------------------------------------------------------------------


def test_the_order_statistic_is_chosen_by_the_binomial_tail():
    for runs, delta in itertools.product((100, 1000, 8192, 131072), (0.9, 0.3, 0.05, 0.01, 1e-3)):
        allowed = _core.exceedances(runs, delta)
        tail = stats.binom(runs, 0.9 * delta).cdf
        if allowed is None:
            assert tail(0) > 0.01 * delta
        else:
            assert tail(allowed) <= 0.01 * delta * (1 + 1e-9)
            assert tail(allowed + 1) > 0.01 * delta * (1 - 1e-9)


def test_the_order_statistic_fails_as_often_as_it_may():
    """2000 simulated bounds on uniform errors: P(bound below the quantile) <= 0.01 delta.

    Its mutant, the plain empirical quantile, is below in about half of the cases.
    """
    delta, runs = 0.1, 2000
    draws = np.random.default_rng(1).random((2000, runs))
    found = np.array([_core.drawn_bounds(errors[:, None], delta)[0] for errors in draws])
    # 0.001 each: 2 expected, 8 or more with probability 1e-3
    assert (found < 1.0 - 0.9 * delta).sum() < 8
    plain = np.quantile(draws, 1.0 - delta, axis=1)
    assert (plain < 1.0 - 0.9 * delta).sum() > 1000
    # the chance that a fresh error exceeds the bound, over everything
    assert (1.0 - found).mean() < delta


def test_the_largest_of_few_errors_fails_as_often_as_it_may():
    """It is beaten by a fresh error with probability 1 / (R + 1), over both.

    10 000 bounds from 40 errors at delta .1, which are too few for a binomial tail: 244 failures
    expected, +-5 standard errors; the mutant, the second largest, fails 488 times.
    """
    delta = 0.1
    draws = np.random.default_rng(2).random((10_000, 41))
    assert _core.exceedances(40, delta) is None
    few = np.ascontiguousarray(draws[:, :40])
    found = np.array([_core.drawn_bounds(errors[:, None], delta)[0] for errors in few])
    assert abs((draws[:, 40] > found).sum() - 244) < 78
    second = np.sort(draws[:, :40], axis=1)[:, -2]
    assert (draws[:, 40] > second).sum() > 400


def test_errors_are_bought_by_their_work():
    """As many as half a second gives, but 4 / delta at least, within 10 s of one thread."""
    assert drawn_errors.runs_for(0.05, 1e4) == 8192
    assert drawn_errors.runs_for(0.05, 1e12) is None
    assert drawn_errors.runs_for(0.001, 1e3) == 131072
    assert drawn_errors.runs_for(0.001, 1e6) == 4000
    assert drawn_errors.runs_for(1e-6, 1e3) is None  # 2^21 at most
    for cost in (1e3, 1e5, 1e6, 1e9):
        least = drawn_errors.least_delta(cost)
        runs = drawn_errors.runs_for(least, cost)
        assert 4.0 / least <= runs <= 4.0 / least + 1
        assert runs * cost <= 1e10 + cost
        assert drawn_errors.runs_for(0.99 * least, cost) is None
        for delta in (0.5, 0.05, 0.01, 0.001):
            runs = drawn_errors.runs_for(delta, cost)
            assert runs is None or runs >= 4.0 / delta


@pytest.mark.parametrize(("n", "K", "least"), [(5, 1, 4e-6), (20, 4, 6e-5), (100, 4, 1.5e-3)])
def test_small_probabilities_are_simulated(n, K, least):
    gen = np.random.default_rng(n)
    data = (gen.standard_normal((n, n)), gen.standard_normal((n, n // 2))), *np.ones((2, n))
    bound = bounds.bound("simulated", "state", *data, steps=K)
    assert bound.least_delta(10**5) <= least


# -- the law of the errors -------------------------------------------------------------------------


def p_value(first, second):
    """Kolmogorov-Smirnov; rounded, as equal errors of discrete laws differ by rounding."""
    return stats.ks_2samp(first.round(9), second.round(9)).pvalue


def plans(system, x0, xf, size, count, *, steps=1, fusion="product", axis="columns", **options):
    """Errors of plans from real samples, (count, 2)."""
    found = []
    for seed in range(count):
        key = as_key(10_000 + seed)
        drawn = [
            se.sample(w, size, rng=key.child(name), axis=axis, **options)
            for name, w in (("x0", x0), ("xf", xf), ("A", system.A))
        ]
        plan = se.control((drawn[2], system.B), *drawn[:2], steps=steps, fusion=fusion)
        error = plan.error(system, x0, xf)
        found.append((error.state, error.control))
    return np.array(found)


@pytest.mark.parametrize(
    "options",
    [
        {"scheme": "systematic"},
        {"scheme": "systematic", "axis": "rows"},
        {"scheme": "systematic", "fusion": "diagonal"},
        {"scheme": "systematic", "steps": 3},
        {},
        {"axis": "rows", "steps": 3},
        {"fusion": "diagonal", "axis": "rows"},
    ],
    ids=str,
)
def test_errors_against_real_samples(options):
    """Two samples of 400 and 4000 errors of each kind: Kolmogorov-Smirnov at level 1e-4."""
    gen = np.random.default_rng(6)
    system = se.System(gen.standard_normal((3, 3)), gen.standard_normal((3, 2)))
    x0, xf = gen.standard_normal(3), gen.standard_normal(3)
    real = plans(system, x0, xf, 37, 400, **options)
    law = bounds.bound("simulated", "state", system, x0, xf, **options).errors(37)
    drawn = law.draw(4000, as_key(5))
    for k in range(2):
        assert p_value(real[:, k], drawn[:, k]) > 1e-4
        # the mutant: a sample larger by a half
        assert p_value(real[:, k] / math.sqrt(1.5), drawn[:, k]) < 1e-4


def test_errors_are_a_function_of_key_and_run():
    law = bounds.bound(
        "simulated", "state", (np.ones((3, 3)), np.eye(3)), np.ones(3), np.zeros(3)
    ).errors(50)
    drawn = law.draw(1000, as_key(1))
    np.testing.assert_array_equal(law.draw(100, as_key(1)), drawn[:100])
    assert (law.draw(1000, as_key(2)) != drawn).any()
    try:
        se.set_num_threads(1)
        one = law.draw(1000, as_key(1))
        se.set_num_threads(3)
        np.testing.assert_array_equal(law.draw(1000, as_key(1)), one)
    finally:
        se.set_num_threads(None)
    np.testing.assert_array_equal(one, drawn)


# -- coverage --------------------------------------------------------------------------------------


def strange_systems():
    """Systems very different from a Gaussian one."""
    gen = np.random.default_rng(8)
    sparse = gen.standard_normal((5, 5)) * (gen.random((5, 5)) < 0.3)
    empty = gen.standard_normal((4, 4))
    empty[:, 1] = 0.0
    big = gen.standard_normal((4, 4))
    big[:, 0] *= 1e6
    stiff = gen.standard_normal((3, 3)) @ np.diag([1.0, 1e-5, 1e-9])
    return {
        "sparse": (sparse, gen.standard_normal((5, 3)), gen.standard_normal(5), np.zeros(5)),
        "zero column": (empty, np.eye(4), np.ones(4), np.array([1.0, 0.0, 0.0, -1.0])),
        "big column": (big, gen.standard_normal((4, 2)), np.array([1.0, 0, 0, 1.0]), np.ones(4)),
        "ill-conditioned B": (gen.standard_normal((3, 3)), stiff, np.ones(3), np.ones(3)),
        "rank 1": (np.ones((3, 3)), np.ones((3, 2)), np.array([0.0, 1.0, -1.0]), np.ones(3)),
        "one entry": (np.diag([2.0, 0.0]), np.eye(2), np.array([1.0, 0.0]), np.array([0.0, 3.0])),
    }


def test_a_wrong_law_is_no_bound():
    """Realizations of another vector than the one declared: the assumption does not hold."""
    gen = np.random.default_rng(9)
    A, B = gen.standard_normal((4, 4)), gen.standard_normal((4, 4))
    x0, xf = gen.standard_normal(4), gen.standard_normal(4)
    radius = bounds.bound("simulated", "state", (A, B), x0, xf).radius(500, 0.2)
    errors = plans(se.System(A, B), 1.3 * x0, xf, 500, 300)[:, 0]
    same = plans(se.System(A, B), x0, xf, 500, 300)[:, 0]
    assert (same > radius).sum() <= 88 < (errors > radius).sum()


def test_four_steps_of_the_grid_are_bounded_closely():
    """Within 1.2 times the quantile of 20 000 other errors, at every size."""
    system = se.cases.ieee14()
    x0, xf = np.random.default_rng(0).standard_normal(10), np.zeros(10)
    bound = bounds.bound("simulated", "state", system, x0, xf, steps=4)
    for size in (10**4, 10**6, 10**8)[:: sets(1, 2)]:
        drawn = bound.errors(size).draw(20_000, as_key(11))[:, 0]
        ratio = bound.radius(size, 0.05) / np.quantile(drawn, 0.95)
        assert 0.97 < ratio < 1.2
    plan = se.steer(system, x0, xf, 10_000, steps=4, rng=2)
    assert plan.bound().state == pytest.approx(bound.radius(10_000, 0.05), rel=1e-12)
    assert plan.bound().target < 0.6  # the formulas give 29.7


# -- sizes -----------------------------------------------------------------------------------------


def test_radius_and_size_agree():
    A, B, x0, xf = strange_systems()["sparse"]
    for quantity, data in (("state", ((A, B), x0, xf)), ("vector", (x0,)), ("matrix", (A,))):
        bound = bounds.bound("simulated", quantity, *data)
        for delta in (0.3, 0.02):
            radius = bound.radius(300, delta)
            size = bound.required_size(radius, delta)
            assert bound.radius(size, delta) <= radius
            assert size == pytest.approx(300, rel=0.05)
    with pytest.raises(SizeError, match=r"`delta` must be at least .* got 1e-07"):
        bound.radius(100, 1e-7)
    assert bound.required_size(1.0, 1e-7) is None
    assert bound.required_size(1e-12, 0.1) is None


def test_fixed_estimates_are_not_drawn_again():
    A, B, x0, xf = strange_systems()["big column"]
    fit = A + 0.1
    errors = PlanErrors(
        B, Entity(x0), Entity(xf, None, 20), Entity(A, fit), steps=1, paired=False, rows=False
    )
    assert errors.random
    exact = PlanErrors(B, Entity(x0), Entity(xf), Entity(A, fit), steps=1, paired=False, rows=False)
    assert not exact.random
    P = B @ np.linalg.pinv(B)
    found = exact.draw(3, as_key(1))[:, 0]
    np.testing.assert_allclose(found, np.linalg.norm(P @ (fit - A) @ x0), rtol=1e-9)


def test_the_mean_of_pairs_is_rounded_once():
    """A law with one outcome: the error is rounding, at any number of realizations."""
    for size in (10**3, 10**6):
        drawn = [se.sample(w, size, rng=k) for k, w in enumerate(([0.3], [0.7], [[0.1]]))]
        plan = se.control((drawn[2], [[1.0]]), *drawn[:2], fusion="diagonal")
        error = plan.error(se.System([[0.1]], [[1.0]]), [0.3], [0.7])
        assert error.state <= plan.bound().state < 1e-14
