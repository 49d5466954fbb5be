"""Risk numbers: published values, closed forms, and their coverage."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stochens_rs.theory import scenario

BETA = 0.05


def test_published_values() -> None:
    """Those that rust/fleet/tests.rs has not, and one of each that it has."""
    assert scenario.a_priori(60, 4, 0.05) == pytest.approx(0.124187210477, abs=6e-13)
    assert scenario.relaxed(60, 3, 0.05)[1] == pytest.approx(0.181159658474, abs=6e-13)
    sizes = [scenario.required_scenarios(0.05, d, 1e-6) for d in (2, 6, 11, 21, 41)]
    assert sizes == [326, 498, 677, 992, 1559]
    # k = 0 in closed form: 61 e (1-e)^60 = beta (1 - (1-e)^61)
    e = scenario.judged(60, 0, 0.05)
    assert 61 * e * (1 - e) ** 60 == pytest.approx(0.05 * (1 - (1 - e) ** 61), rel=1e-13)
    # r = 0 in closed form: C(N, k) (1-e)^(N-k) = beta / N
    e = 1.0 - (1e-6 / (200 * math.comb(200, 15))) ** (1.0 / 185)
    assert scenario.compression(200, 15, 1e-6) == pytest.approx(e, rel=1e-12)
    after = [scenario.discarding(3000, r, 21, 1e-6) for r in (30, 150)]
    assert np.round(after, 4).tolist() == [0.0481, 0.1206]
    fresh = [scenario.hold_out(3000, v, 1e-6) for v in (0, 30, 150)]
    np.testing.assert_allclose(fresh, [0.0046, 0.0215, 0.0715], atol=6e-5)


def test_large_sizes_stay_in_order() -> None:
    """10^9 units: nothing is summed, and the numbers are those of the Poisson limit."""
    N, beta = 10**9, 1e-6
    assert N * scenario.hold_out(N, 0, beta) == pytest.approx(-np.log(beta), rel=1e-7)
    lower, upper = scenario.relaxed(N, 1000, beta)
    assert lower < 1e-6 < upper < scenario.judged(N, 1000, beta) * 1.1 < 1.4e-6
    # k ln(N / k) + k of all choices of k units
    assert N * scenario.compression(N, 1000, beta) == pytest.approx(14845.6, rel=1e-4)
    assert scenario.required_scenarios(1e-8, 1, beta) == pytest.approx(
        -np.log(beta) * 1e8, rel=1e-7
    )


def test_the_a_priori_risk_is_exact_for_intervals() -> None:
    """Uniforms, d = 2: the risk of [min, max] has the law Beta(2, N-1), so 5 % exceed eps."""
    gen = np.random.default_rng(1)
    eps = scenario.a_priori(60, 2, 0.05)
    drawn = gen.random((200_000, 60))
    risk = 1.0 - (drawn.max(axis=1) - drawn.min(axis=1))
    assert abs(np.mean(risk > eps) - 0.05) < 5 * np.sqrt(0.05 * 0.95 / 200_000)


def after_discarding(gen: np.random.Generator, N: int, d: int, r: int) -> float:
    """The risk of min sum z_i, z_i >= v for each of N units (i, v), i of d, v uniform, without r.

    Each time the unit goes without which the sum falls most.
    """
    group, v = gen.integers(0, d, N), gen.random(N)
    left = [np.sort(np.append(v[group == i], 0.0)) for i in range(d)]
    falls = np.array([x[-1] - x[-2] if len(x) > 1 else 0.0 for x in left])
    for _ in range(r):
        i = int(falls.argmax())
        left[i] = left[i][:-1]
        falls[i] = left[i][-1] - left[i][-2] if len(left[i]) > 1 else 0.0
    return float(np.mean([1.0 - x[-1] for x in left]))


def test_after_discarding_only_the_bound_of_2011_holds() -> None:
    gen = np.random.default_rng(2)
    N, d, r, beta = 1000, 50, 100, 0.05
    risk = np.array([after_discarding(gen, N, d, r) for _ in range(300)])
    assert np.mean(risk > scenario.discarding(N, r, d, beta)) <= beta
    # the bound for relaxed designs, taken with all that were left out and the support, fails
    assert np.mean(risk > scenario.relaxed(N, r + d, beta)[1]) > 0.2


def allowed(fleets, beta=BETA):
    """The share that an event of probability beta exceeds three times in two thousand."""
    return beta + 3.0 * math.sqrt(beta * (1.0 - beta) / fleets)


# -- known digits ----------------------------------------------------------------------------------


# -- coverage --------------------------------------------------------------------------------------


def test_hold_out():
    """20 000 tests of 200 fresh units at risks from 0 to 1/2, and the share nearest to beta."""
    gen, shares = np.random.default_rng(14), []
    for risk in (0.003, 0.01, 0.05, 0.2, 0.5):
        counts = gen.binomial(200, risk, size=20_000)
        eps = np.array([scenario.hold_out(200, k, BETA) for k in range(201)])
        shares.append(np.mean(risk > eps[counts]))
        assert shares[-1] <= allowed(20_000)
    assert max(shares) > 0.02


def test_the_smaller_of_two_needs_half_of_beta_each():
    """Bounds chosen after the fact: with beta / 2 each, the smaller one still holds."""
    x = np.random.default_rng(16).random((40_000, 60))
    risk = 1.0 - (x.max(axis=1) - x.min(axis=1))
    fresh = np.random.default_rng(17).binomial(60, risk)
    tests = [np.array([scenario.hold_out(60, k, b) for k in range(61)]) for b in (BETA, BETA / 2)]
    naive = np.minimum(scenario.a_priori(60, 2, BETA), tests[0][fresh])
    half = np.minimum(scenario.a_priori(60, 2, BETA / 2), tests[1][fresh])
    assert np.mean(risk > half) <= allowed(40_000)
    assert np.mean(risk > naive) > allowed(40_000)
