"""The compiled core of identification against its twin in plain NumPy and known numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special

from core_regions import core_region
from coverage_study import DELTA, exactly
from identification_data import LAMS, Y, Z, check, independent
from stochens_rs import _core as core
from stochens_rs.exceptions import InputError
from twin import anytime as at
from twin import certified_control as cc
from twin import quantiles as qu
from twin import residual_tests as rt
from twin import triangle as tr


def fitted_to(z, y):
    """Least squares of the twin, its arrays row by row."""
    found = tr.fit(tr.triangle(z, y))
    rows = {name: np.ascontiguousarray(getattr(found, name)) for name in ("H", "white", "missing")}
    return found._replace(**rows)


@pytest.mark.parametrize(("size", "k"), [(1, 1), (3, 5), (40, 5), (700, 26), (1200, 70)])
def test_triangles(gen, size, k):
    rows = gen.standard_normal((size, k)) * np.geomspace(1.0, 1e8, k)
    found = core.triangle(rows, 1)
    expected = tr.r_factor(rows)
    np.testing.assert_allclose(
        found / np.geomspace(1.0, 1e8, k),
        expected / np.geomspace(1.0, 1e8, k),
        rtol=0,
        atol=2e-14 * size,
    )
    assert np.all(np.diag(found) >= 0.0)
    grown = np.zeros((k, k))
    for part in np.array_split(rows, 3):
        core.triangle_update(grown, part)
    np.testing.assert_allclose(grown, found, rtol=1e-9, atol=1e-6 * np.abs(found).max() * 1e-8)


def test_a_triangle_keeps_the_digits_that_normal_equations_lose(gen):
    """Columns that differ by 1e-7: their squares differ by less than rounding."""
    x = gen.standard_normal((500, 1))
    rows = np.hstack([x, x + 1e-9 * gen.standard_normal((500, 1))])
    assert np.isclose(core.triangle(rows, 1)[1, 1], tr.r_factor(rows)[1, 1], rtol=1e-5)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(rows.T @ rows)


# -- laws ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "d", "nu", "delta"),
    [
        (2, 3, 9, 0.05),
        (4, 6, 34, 0.001),
        (1, 7, 5, 0.01),
        (6, 2, 20, 0.1),
        (3, 3, 3, 0.05),
        (10, 15, 100, 0.05),
        (20, 22, 200, 0.01),
        (5, 8, 40_000, 0.05),
    ],
)
def test_exact_quantiles(n, d, nu, delta):
    check(core.roy_quantile(n, d, nu, delta, 1), qu.roy_quantile(n, d, nu, delta), rtol=1e-10)
    check(core.wishart_quantile(n, d, delta, 1), qu.wishart_quantile(n, d, delta), rtol=1e-10)
    check(core.row_quantile(n, d, nu, delta), qu.row_quantile(n, d, nu, delta), rtol=1e-10)
    if nu <= 500:
        check(
            core.smallest_quantile(n, nu, delta, 1), qu.smallest_quantile(n, nu, delta), rtol=1e-9
        )


def test_scalar_quantiles():
    check(core.scalar_quantile(4, 6, 34, 0.05, 1), 0.166390274969643, rtol=1e-10)
    check(core.scalar_quantile(1, 3, 9, 0.05, 1), qu.scalar_quantile(1, 3, 9, 0.05), rtol=1e-10)


def test_without_degrees_of_freedom_quantiles_are_infinite():
    assert core.roy_quantile(4, 6, 3, DELTA, 1) == np.inf
    assert core.joint_radii(4, 6, 3, DELTA, 1) == (np.inf, np.inf)
    assert core.scalar_quantile(2, 3, 0, DELTA, 1) == np.inf
    assert core.smallest_quantile(4, 3, DELTA, 1) == 0.0
    for bad in (0.0, 1.0, np.nan):
        with pytest.raises(InputError, match="delta"):
            core.roy_quantile(2, 3, 9, bad, 1)


def test_drawn_quantiles_hold_their_levels(gen):
    """The draws of the core against fresh draws of the twin."""
    n, d, nu, draws = 4, 6, 34, 20_000
    spectral, frobenius = core.joint_radii(n, d, nu, DELTA, 1)
    assert (spectral, frobenius) == core.joint_radii(n, d, nu, DELTA, 2)
    roots = qu.beta_roots(n, d, nu, draws, gen)
    out = (roots[:, -1] > spectral**2) | (roots.sum(axis=1) > frobenius**2)
    exactly(np.sum(out), draws)
    exactly(np.sum(roots.sum(axis=1) > core.trace_quantile(n, d, nu, DELTA, 1)), draws)
    G = gen.standard_normal((draws, n, d)) / np.sqrt(gen.chisquare(nu, (draws, n, 1)))
    largest = np.linalg.norm(G, 2, axis=(1, 2)) ** 2
    exactly(np.sum(largest > core.diagonal_quantile(n, d, nu, DELTA, 1)), draws)


@pytest.mark.parametrize("degrees", [1, 2, 7, 300, 100_000])
@pytest.mark.parametrize("delta", [0.5, 0.05, 1e-9])
def test_plain_laws(degrees, delta):
    for a in (1, 6, 40):  # the quantile of F in SciPy has no digits of a small delta
        y = special.betaincinv(degrees / 2, a / 2, delta)
        x = (
            degrees * special.betaincinv(a / 2, degrees / 2, 1 - delta) / a / y
            if delta == 0.5
            else degrees * (1 - y) / (a * y)
        )
        check(core.f_upper(delta, a, degrees), x, rtol=1e-10 if degrees < 1000 else 1e-8)


@pytest.mark.parametrize("n", [1, 2, 10, 300])
@pytest.mark.parametrize("ld", [0.0, 3.0, 300.0, 5000.0])
def test_levels_of_the_mixtures(n, ld):
    for delta in (0.05, 1e-12):
        check(core.sphere_level(n, ld, delta), at.sphere_level(n, ld, delta), rtol=1e-11)


def test_levels_of_least_squares():
    data = tr.triangle(Z, Y)
    info = [at.information(data, lam) for lam in LAMS]
    ld = np.array([i.ld for i in info])
    wider = np.array([1.0 + lam / i.smallest for lam, i in zip(LAMS, info, strict=True)])
    for frobenius in (False, True):
        expected = at.least_squares_level(data, DELTA, LAMS, frobenius=frobenius)
        check(core.least_squares_level(2, ld, wider, DELTA, frobenius), expected, rtol=1e-11)
    for n in (1, 4, 30):
        check(core.one_noise(n, DELTA), at.one_noise(n, DELTA), rtol=1e-7)
    check(core.log_multigamma(20.5, 7), special.multigammaln(20.5, 7), rtol=1e-13)


# -- several steps ---------------------------------------------------------------------------------


def steps(fitted, x0, inputs, *, spectral, frobenius=np.inf, rho0=0.0, noise=False):
    """States, radii, first order, b_k and the lengths of z_k, as the twin."""
    n, d = fitted.H.shape
    x0, inputs = np.asarray(x0, dtype=float), np.asarray(inputs, dtype=float)
    offset = inputs.shape[1] == d - n - 1
    radii = {"spectral": spectral, "frobenius": frobenius, "noise": noise}
    region, part = core_region(fitted, fitted.S, offset=offset, **radii)
    found = region.errors(x0, inputs, rho0, None)
    z = np.hstack([found.states[:-1], inputs, np.ones((len(inputs), int(offset)))])
    lengths = np.array([part.length(row) for row in z])
    return found.states, found.radii, found.linear, found.rest, lengths


@pytest.mark.parametrize("options", [{}, {"frobenius": 1.4}, {"rho0": 0.1}, {"noise": True}])
@pytest.mark.parametrize("offset", [False, True])
def test_several_steps(gen, options, offset):
    _Theta, z, y = independent(gen, n=4, d=6 + offset, N=60)
    if offset:
        z[:, -1] = 1.0
    fitted = fitted_to(z, y)
    x0, u = gen.standard_normal(4), gen.standard_normal((5, 2))
    expected = cc.several_steps(fitted, x0, u, spectral=1.1, **options)
    for found, value in zip(steps(fitted, x0, u, spectral=1.1, **options), expected, strict=True):
        # the search for the nuclear bound stops within 1e-6 of the least: rounding moves it so far
        check(found, value, rtol=1e-6, atol=1e-12)


def test_steps_that_the_data_do_not_show():
    z = Z.copy()
    z[:, 2] = 0.0  # no input was ever given
    fitted = fitted_to(z, Y)
    expected = cc.several_steps(fitted, [1.0, -1.0], [[0.0], [1.0]], spectral=1.0)
    found = steps(fitted, [1.0, -1.0], [[0.0], [1.0]], spectral=1.0)
    assert np.isfinite(found[1][1])
    assert np.isinf(found[1][2])
    for a, b in zip(found, expected, strict=True):
        check(a, b, rtol=1e-10)


@pytest.mark.parametrize("inputs", ["proportional", "unused", "one in three"])
@pytest.mark.parametrize("units", [1.0, 1e-6, 1e6])
def test_missing_directions_of_inputs_alone_leave_steps_finite(gen, inputs, units):
    """The same radii as with the inputs that were free; what is known of A is known."""
    for _ in range(30):
        n = 3
        x, u = gen.standard_normal((60, n)), units * gen.standard_normal((60, 2))
        map_ = {
            "proportional": np.array([[1.0, 0.0, 2.0 / 3.0], [0.0, 1.0, 0.0]]),
            "unused": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
            "one in three": gen.standard_normal((2, 3)),
        }[inputs]
        x[:, 2] = x[:, 1] + 1e-3 * x[:, 2]
        y = x @ gen.standard_normal((n, n)) + u @ gen.standard_normal((2, n)) / units
        y += 0.1 * gen.standard_normal(y.shape)
        fitted, few = fitted_to(np.hstack([x, u @ map_]), y), fitted_to(np.hstack([x, u]), y)
        assert fitted.missing.shape == (6, 1)
        rows = np.hstack([x, u @ map_, y])
        estimate = core.fit(core.triangle(rows, 1), rows.shape[1] - n, len(rows), 1)
        for missing in (fitted.missing, estimate.missing):
            assert not np.any(missing[:n])
        x0, plan = gen.standard_normal(n), units * gen.standard_normal((4, 2))
        options = {"spectral": 0.5, "frobenius": 0.8, "rho0": 0.1}
        found = steps(fitted, x0, plan @ map_, **options)
        assert np.all(np.isfinite(found[1]))
        check(found[1], steps(few, x0, plan, **options)[1], rtol=1e-6)
        check(found[1], cc.several_steps(fitted, x0, plan @ map_, **options).radii, rtol=1e-9)


@pytest.mark.parametrize("gain", [1.0, 1e-3, 1e-9])
def test_missing_directions_of_states_make_steps_infinite(gen, gain):
    """An input that is a feedback of a state, however small: nothing may be concluded."""
    x, u = gen.standard_normal((60, 3)), gen.standard_normal((60, 2))
    u[:, 1] = u[:, 0] + gain * x[:, 0]
    fitted = fitted_to(np.hstack([x, u]), x + 0.1 * gen.standard_normal((60, 3)))
    assert np.any(fitted.missing[0])
    found = steps(fitted, np.ones(3), gen.standard_normal((3, 2)), spectral=0.5)
    assert np.all(np.isinf(found[1][1:]))
    follows = np.array([[1.0, 1.0 + gain], [0.5, 0.5]])  # the first step is one of the data
    found = steps(fitted, np.ones(3), follows, spectral=0.5)
    assert np.isfinite(found[1][1])
    assert np.isinf(found[1][2])


# -- replicates ------------------------------------------------------------------------------------

KEY = bytes(range(32))


def test_the_law_of_drawn_models():
    fitted = fitted_to(Z, Y)
    size = 40_000
    V = fitted.white.T @ fitted.white
    law = fitted.H, fitted.white, fitted.S, "full", fitted.nu
    draws = core.estimate_draws(law, size, KEY, 1)
    models, spread = draws.reshape(size, 2, 3), np.kron(V, fitted.S / (fitted.nu - 3))
    error = models.mean(axis=0) - fitted.H
    assert np.all(np.abs(error) < 5 * models.std(axis=0) / np.sqrt(size))
    found = np.cov(models.transpose(0, 2, 1).reshape(size, -1).T)
    scale = np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
    assert np.max(np.abs(found - spread) / scale) < 0.05


# -- tests of residuals ----------------------------------------------------------------------------


def residual_checks(z, y, draws, threads=1):
    rows, tested = np.hstack([z, y]), list(range(y.shape[1]))
    return core.residual_checks(rows, z.shape[1], tested, draws, KEY, threads)


def test_p_values_of_residuals(gen):
    """Near those of the twin; small for noise that is correlated in time."""
    _, z, y = independent(gen, n=2, d=3, N=60)
    own = rt.p_values(z, y, 2000, gen)
    found, distances = residual_checks(z, y, 2000)
    assert np.all(np.abs(found - own) < 5 * np.sqrt(2 * 0.25 / 2000))
    assert np.array_equal(found, residual_checks(z, y, 2000, threads=2)[0])
    assert np.all(np.abs(distances) < 6)
    w = gen.standard_normal((61, 2))
    correlated = z @ np.ones((3, 2)) + w[1:] + 0.9 * w[:-1]
    found, distances = residual_checks(z, correlated, 999)
    assert found[1] < 0.01
    assert distances[1] > 4  # Gaussian noise has 0 +- 1
    assert residual_checks(z[:4], y[:4], 9) is None
