"""Risk of a worst-case design: the published equations, their short forms, and the coverage.

The risk of every fleet below is known exactly, so the only chance is in its units. A bound may be
exceeded in a share beta of all fleets; the alarm is three standard deviations above.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from twin import scenario as sc

BETA = 0.05


def allowed(fleets, beta=BETA):
    """The share that an event of probability beta exceeds three times in two thousand."""
    return beta + 3.0 * math.sqrt(beta * (1.0 - beta) / fleets)


# -- known digits ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("N", "d", "beta"), [(60, 4, 0.05), (3000, 21, 1e-6), (50, 50, 1e-9)])
def test_binomial_tails_are_incomplete_betas(N, d, beta):
    np.testing.assert_allclose(
        sc.a_priori(N, d, beta), stats.beta.isf(beta, d, N - d + 1), rtol=1e-10
    )
    k = d - 1
    np.testing.assert_allclose(
        sc.hold_out(N, k, beta), stats.beta.isf(beta, k + 1, N - k), rtol=1e-10
    )
    # nothing was discarded: the form for discarded units is the one before the data
    np.testing.assert_allclose(sc.discarding(N, 0, d, beta), sc.a_priori(N, d, beta), rtol=1e-12)


# -- coverage --------------------------------------------------------------------------------------


def test_hold_out():
    """20 000 tests of 200 fresh units at risks from 0 to 1/2, and the share nearest to beta."""
    gen, shares = np.random.default_rng(14), []
    for risk in (0.003, 0.01, 0.05, 0.2, 0.5):
        counts = gen.binomial(200, risk, size=20_000)
        eps = np.array([sc.hold_out(200, k, BETA) for k in range(201)])
        shares.append(np.mean(risk > eps[counts]))
        assert shares[-1] <= allowed(20_000)
    assert max(shares) > 0.02


def test_the_smaller_of_two_needs_half_of_beta_each():
    """Bounds chosen after the fact: with beta / 2 each, the smaller one still holds."""
    x = np.random.default_rng(16).random((40_000, 60))
    risk = 1.0 - (x.max(axis=1) - x.min(axis=1))
    fresh = np.random.default_rng(17).binomial(60, risk)
    tests = [np.array([sc.hold_out(60, k, b) for k in range(61)]) for b in (BETA, BETA / 2)]
    naive = np.minimum(sc.a_priori(60, 2, BETA), tests[0][fresh])
    half = np.minimum(sc.a_priori(60, 2, BETA / 2), tests[1][fresh])
    assert np.mean(risk > half) <= allowed(40_000)
    assert np.mean(risk > naive) > allowed(40_000)
