"""Risk of a worst-case design: the published equations, their short forms, and the coverage.

The risk of every fleet below is known exactly, so the only chance is in its units. A bound may be
exceeded in a share beta of all fleets; the alarm is three standard deviations above.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from coverage_study import sets
from twin import populations as pop
from twin import scenario as sc

BETA = 0.05


def close(value, digits):
    assert abs(value - digits) <= 1e-10 * abs(digits) + 6e-13, (value, digits)


def allowed(fleets, beta=BETA):
    """The share that an event of probability beta exceeds three times in two thousand."""
    return beta + 3.0 * math.sqrt(beta * (1.0 - beta) / fleets)


# -- known digits ----------------------------------------------------------------------------------


def test_digits():
    close(sc.a_priori(60, 4, 0.05), 0.124187210477)
    close(sc.a_priori(3000, 21, 1e-6), 0.016696732911)
    close(sc.judged(60, 3, 0.05), 0.166517980033)
    close(sc.judged(3000, 5, 1e-6), 0.009723323179)
    for N, k, beta in ((60, 3, 0.05), (60, 0, 0.05), (200, 15, 1e-6)):
        close(sc.compression(N, k, beta), 1 - (beta / N / math.comb(N, k)) ** (1 / (N - k)))
    close(sc.relaxed(60, 3, 0.05)[1], 0.181159658474)
    lower, upper = sc.relaxed(60, 10, 0.01)
    close(lower, 0.046720257502)
    close(upper, 0.377934953896)
    e = sc.judged(60, 0, 0.05)
    np.testing.assert_allclose(61 * e * (1 - e) ** 60, 0.05 * (1 - (1 - e) ** 61), rtol=1e-12)
    np.testing.assert_allclose(sc.relaxed(3000, 171, 1e-6), [0.0357, 0.0847], atol=5e-5)
    hold_out = [sc.hold_out(3000, k, 1e-6) for k in (0, 30, 150)]
    np.testing.assert_allclose(hold_out, [0.0046, 0.0215, 0.0715], atol=6e-5)
    discarding = [sc.discarding(3000, r, 21, 1e-6) for r in (30, 150)]
    np.testing.assert_allclose(discarding, [0.0481, 0.1206], atol=5e-5)


def test_sizes():
    assert sc.required_scenarios(0.05, 21, 1e-6) == 992
    assert sc.required_scenarios(0.01, 21, 1e-6) == 5020
    assert [sc.required_scenarios(0.05, d, 1e-6) for d in (2, 6, 11, 41)] == [326, 498, 677, 1559]
    for eps, d, beta in ((0.3, 1, 0.5), (0.05, 4, 1e-3), (0.9, 3, 0.2)):
        N = sc.required_scenarios(eps, d, beta)
        assert sc.a_priori(N, d, beta) <= eps * (1 + 1e-12)
        assert sc.a_priori(N - 1, d, beta) > eps


@pytest.mark.parametrize("beta", [1e-2, 1e-6, 1e-12])
@pytest.mark.parametrize(("N", "k"), [(20, 0), (20, 12), (60, 3), (500, 20), (3000, 171)])
def test_the_sums_collapse(N, k, beta):
    """The short forms: one binomial probability against one binomial tail."""
    e = sc.judged(N, k, beta)
    tail = stats.binom.logsf(k, N + 1, e)
    left = np.log(k + 1) + stats.binom.logpmf(k + 1, N + 1, e)
    np.testing.assert_allclose(left, np.log(beta) + tail, atol=1e-8)


@pytest.mark.parametrize(("N", "k", "r"), [(20, 0, 0), (20, 12, 2), (60, 3, 5), (500, 20, 5)])
def test_compression_is_hold_out_for_every_choice_of_units(N, k, r):
    """The others are fresh units: at the level beta / N for each of the C(N, k) choices."""
    for beta in (1e-2, 1e-6):
        e = sc.compression(N, k, beta, r)
        left = math.log(math.comb(N, k)) + stats.binom.logcdf(r, N - k, e)
        np.testing.assert_allclose(left, np.log(beta / N), rtol=1e-9)
        level = math.exp(math.log(beta / N) - math.log(math.comb(N, k)))
        if level > 1e-300:
            np.testing.assert_allclose(e, sc.hold_out(N - k, r, level), rtol=1e-9)
        assert e >= sc.judged(N, k, beta)


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


def test_order_and_ends():
    """More support, more violations, fewer units, more confidence: more risk. Nothing known: 1."""
    forms = (sc.judged, sc.compression, lambda N, k, b: sc.relaxed(N, k, b)[1], sc.hold_out)
    for form in (*forms, sc.a_priori):
        values = [form(60, k, 0.05) for k in range(1, 61)]
        assert np.all(np.diff(values) >= 0.0)
        assert form(61, 5, 0.05) < form(60, 5, 0.05) < form(60, 5, 0.01) < 1.0
    assert [form(60, 60, 0.05) for form in forms] == [1.0] * 4
    assert sc.a_priori(60, 61, 0.05) == 1.0
    assert sc.discarding(60, 30, 31, 0.05) == 1.0
    lower = [sc.relaxed(60, k, 0.05)[0] for k in range(61)]
    assert lower[0] == 0.0
    assert np.all(np.diff(lower) >= 0.0)
    assert 0.8 < lower[60] < 1.0
    # judging pays only well below d
    assert sc.judged(60, 3, 0.05) > sc.a_priori(60, 3, 0.05)
    assert sc.judged(3000, 5, 1e-6) < sc.a_priori(3000, 21, 1e-6)
    # very small beta: nothing under- or overflows
    assert 0.1 < sc.a_priori(3000, 21, 1e-300) < 0.4


# -- coverage --------------------------------------------------------------------------------------


def test_the_interval_program_is_exact():
    """40 000 fleets of 60 points, d = 2: P(risk > eps) = beta; d without the value fails."""
    x = np.random.default_rng(11).random((40_000, 60))
    risk = 1.0 - (x.max(axis=1) - x.min(axis=1))
    share = np.mean(risk > sc.a_priori(60, 2, BETA))
    assert abs(share - BETA) <= 3.0 * math.sqrt(BETA / 40_000)
    np.testing.assert_allclose(stats.beta.sf(sc.a_priori(60, 2, BETA), 2, 59), BETA, rtol=1e-10)
    assert np.mean(risk > sc.a_priori(60, 1, BETA)) > 2 * allowed(40_000)  # counts u, not the value


def test_gains_under_a_limit():
    """20 000 fleets of 60 gains a ~ U(1, 2), target 1, u <= limit: one or two units support u.

    Free u = 2 / (a_min + a_max), the value |a_min u - 1|: the risk is P(a outside [a_min, a_max]).
    At u = limit the smallest gain alone supports it, risk P(a < a_min) + P(a > 2 / u - a_min).
    """
    gen, N, fleets = np.random.default_rng(12), 60, 20_000
    a = 1.0 + gen.random((fleets, N))
    low, high = a.min(axis=1), a.max(axis=1)
    free, limit = 2.0 / (low + high), 2.0 / 2.999
    limited = free > limit
    u = np.where(limited, limit, free)
    k = np.where(limited, 1, 2)
    top = np.clip(2.0 / u - low, 1.0, 2.0)  # misses as much as the smallest gain, on the other side
    risk = (low - 1.0) + (2.0 - top)
    assert 0.05 < np.mean(k == 1) < 0.95
    for form in (sc.judged, sc.compression):
        eps = np.array([0.0, form(N, 1, BETA), form(N, 2, BETA)])[k]
        assert np.mean(risk > eps) <= allowed(fleets)
    assert np.mean(risk > sc.a_priori(N, 2, BETA)) <= allowed(fleets)
    # a support that is not one: of two copies of each unit asked one at a time, none is needed
    assert np.mean(risk > sc.judged(2 * N, 0, BETA)) > 2 * allowed(fleets)
    # the twin's own fleets give the same u, value and support
    pytest.importorskip("clarabel")
    for i in range(60):
        units = [pop.unit([[g]], [1.0]) for g in a[i]]
        w = pop.worst(units, 0.0, limit)
        np.testing.assert_allclose([w.u[0], w.value], [u[i], 1.0 - low[i] * u[i]], atol=1e-8)
        if abs(free[i] - limit) > 1e-4:
            assert len(pop.support(units, lambda v: pop.worst(v, 0.0, limit))) == k[i]


def test_fleets_in_the_plane():
    """2000 fleets of 40 units ||u - b||, b normal, |u| <= 0.3: d = 3, the risk by a chi-square.

    P(||b - u|| > t) is the tail of a noncentral chi-square of 2 degrees. Supports of 1, 2 and 3.
    `make test` has 600 fleets.
    """
    pytest.importorskip("clarabel")
    gen, N, fleets = np.random.default_rng(13), 40, sets(2000, 600)
    box = np.array([0.3, 0.1])
    risks, sizes = np.empty(fleets), np.empty(fleets, dtype=int)

    def solver(units):
        return pop.worst(units, -box, box)

    for i in range(fleets):
        b = gen.normal(size=(N, 2))
        # start with the farthest in 12 directions, and add units until all are met
        angles = np.arange(12) * np.pi / 6.0
        near = np.unique(np.argmax(b @ np.array([np.cos(angles), np.sin(angles)]), axis=0))
        while True:
            w = solver([(np.eye(2), x) for x in b[near]])
            far = np.argmax(np.linalg.norm(b - w.u, axis=1))
            if np.linalg.norm(b[far] - w.u) <= w.value * (1 + 1e-9):
                break
            near = np.append(near, far)
        sizes[i] = len(pop.support([(np.eye(2), x) for x in b[near]], solver))
        risks[i] = stats.ncx2.sf(w.value**2, 2, max(w.u @ w.u, 1e-12))
    assert set(sizes) == {1, 2, 3}
    assert np.mean(risks > sc.a_priori(N, 3, BETA)) <= allowed(fleets)
    for form in (sc.judged, sc.compression):
        eps = np.array([form(N, k, BETA) for k in range(4)])[sizes]
        assert np.mean(risks > eps) <= allowed(fleets)
        # not so wide that nothing is said
        assert np.mean(eps) < 0.28


def test_hold_out():
    """20 000 tests of 200 fresh units at risks from 0 to 1/2, and the share nearest to beta."""
    gen, shares = np.random.default_rng(14), []
    for risk in (0.003, 0.01, 0.05, 0.2, 0.5):
        counts = gen.binomial(200, risk, size=20_000)
        eps = np.array([sc.hold_out(200, k, BETA) for k in range(201)])
        shares.append(np.mean(risk > eps[counts]))
        assert shares[-1] <= allowed(20_000)
    assert max(shares) > 0.02


def boxes(gen, fleets, N, sides, r):
    """Smallest boxes after leaving out r of N uniform points, each time the one that gains most.

    Minimize the sum of the sides of a box that contains all points: d = 2 sides, every point
    that is left out lies outside. Returns the risk 1 - volume, exactly.
    """
    x = gen.random((fleets, N, sides))
    order = np.argsort(x, axis=1)
    every, axis = np.arange(fleets)[:, None], np.arange(sides)[None, :]
    bottom, top = np.zeros((fleets, sides), int), np.full((fleets, sides), N - 1)
    gone = np.zeros((fleets, N), dtype=bool)

    def skip(at, step):
        """Ranks moved inwards over points that are gone."""
        while True:
            out = gone[every, order[every, at, axis]]
            if not out.any():
                return at
            at = at + step * out

    for _ in range(r):
        gain = np.zeros((fleets, N))
        for at, step in ((bottom, 1), (top, -1)):
            point = order[every, at, axis]
            after = skip(at + step, step)
            width = step * (x[every, order[every, after, axis], axis] - x[every, point, axis])
            np.add.at(gain, (every, point), width)
        gone[every[:, 0], np.argmax(gain, axis=1)] = True
        bottom, top = skip(bottom, 1), skip(top, -1)
    low = x[every, order[every, bottom, axis], axis]
    high = x[every, order[every, top, axis], axis]
    return 1.0 - np.prod(high - low, axis=1)


def test_discarded_units_need_their_own_form():
    """400 fleets of 400 points in a box of 40 sides, 80 left out: d = 80. The two-sided form for
    relaxed programs, with k = discarded + support, is exceeded far too often."""
    gen, fleets, N, sides, r = np.random.default_rng(15), 400, 400, 40, 80
    d = 2 * sides
    risk = boxes(gen, fleets, N, sides, r)
    assert np.mean(risk > sc.discarding(N, r, d, BETA)) <= allowed(fleets)
    assert np.mean(risk > sc.relaxed(N, r + d, BETA)[1]) > 2 * allowed(fleets)
    # and as if nothing had been left out
    assert np.mean(risk > sc.a_priori(N, d, BETA)) > 0.9
    # without discarding all forms hold
    plain = boxes(gen, fleets, N, sides, 0)
    assert np.mean(plain > sc.a_priori(N, d, BETA)) <= allowed(fleets)
    assert np.mean(plain > sc.relaxed(N, d, BETA)[1]) <= allowed(fleets)


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
