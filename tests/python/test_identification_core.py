"""The compiled core of identification against its twin in plain NumPy and known numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special

from core_regions import core_region
from coverage_study import DELTA, exactly, sets
from identification_data import LAMS, Y, Z, check
from stochens_rs import _core as core
from stochens_rs.exceptions import InputError
from twin import anytime as at
from twin import certified_control as cc
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


# By Pfaffians in NumPy: n, d, nu, delta, and the quantiles of the
# largest root over a Wishart matrix, of G G', of the largest row, and of the least root.
QUANTILES = [
    (2, 3, 9, 0.05, 2.352760180305, 10.740345363727, 1.684700499108, 1.92534233065),
    (4, 6, 34, 0.001, 1.593841359701, 32.597719368337, 1.049910866578, 8.52455208465),
    (1, 7, 5, 0.01, 14.637715248465, 18.475306906582, 14.637715248465, 0.554298076729),
    (6, 2, 20, 0.1, 1.269360910110, 14.149149289782, 0.499436542395, 3.8451191700),
    (3, 3, 3, 0.05, 2589.198642356901, 13.115553282027, 20.360646202334, 0.00098333904574),
    (10, 15, 100, 0.05, 0.684817207726, 52.941517010983, 0.360763969791, 43.73139792061),
    (20, 22, 200, 0.01, 0.617460467012, 96.025285985676, 0.272261168848, 84.39013176503),
    (5, 8, 40_000, 0.05, 0.000697388875063, 27.886529414011, 0.000500950994083, None),
]


def test_exact_quantiles():
    for n, d, nu, delta, roy, wishart, row, smallest in QUANTILES:
        check(core.roy_quantile(n, d, nu, delta, 1), roy, rtol=1e-10)
        check(core.wishart_quantile(n, d, delta, 1), wishart, rtol=1e-10)
        check(core.row_quantile(n, d, nu, delta), row, rtol=1e-10)
        if smallest is not None:
            check(core.smallest_quantile(n, nu, delta, 1), smallest, rtol=1e-9)


def test_without_degrees_of_freedom_quantiles_are_infinite():
    assert core.roy_quantile(4, 6, 3, DELTA, 1) == np.inf
    assert core.joint_radii(4, 6, 3, DELTA, 1) == (np.inf, np.inf)
    assert core.scalar_quantile(2, 3, 0, DELTA, 1) == np.inf
    assert core.smallest_quantile(4, 3, DELTA, 1) == 0.0
    for bad in (0.0, 1.0, np.nan):
        with pytest.raises(InputError, match="delta"):
            core.roy_quantile(2, 3, 9, bad, 1)


def beta_roots(n, d, nu, size, gen):
    """`size` draws of all p = min(n, d) roots of E_nu^-1 G G', (size, p), nu >= n.

    lam = t / (1 - t), t the eigenvalues of B B', B upper bidiagonal with the diagonal
    c_p, c_{p-1} s'_{p-1}, .., c_1 s'_1 and above it -s_p c'_{p-1}, .., -s_2 c'_1, where
    c_k^2 ~ Beta((a + k)/2, (b + k)/2), c'_k^2 ~ Beta(k/2, (a + b + 1 + k)/2), s^2 = 1 - c^2,
    a = d - p, b = nu - p (Edelman and Sutton 2008).
    """
    if n > d:
        n, d, nu = d, n, nu + d - n
    p, a, b = n, d - n, nu - n
    k = np.arange(p, 0, -1)
    c2 = gen.beta((a + k) / 2.0, (b + k) / 2.0, (size, p))
    e2 = gen.beta(k[1:] / 2.0, (a + b + 1 + k[1:]) / 2.0, (size, p - 1))
    diagonal, above = c2.copy(), (1.0 - c2[:, :-1]) * e2  # squares
    diagonal[:, 1:] *= 1.0 - e2
    T = np.zeros((size, p, p))
    i = np.arange(p)
    T[:, i, i] = diagonal
    T[:, i[:-1], i[:-1]] += above
    T[:, i[1:], i[:-1]] = -np.sqrt(diagonal[:, 1:] * above)  # eigvalsh reads this half only
    t = np.clip(np.linalg.eigvalsh(T), 0.0, 1.0 - 1e-16)
    return np.asarray(t / (1.0 - t))


def test_drawn_quantiles_hold_their_levels(gen):
    """The draws of the core against fresh draws of the twin."""
    n, d, nu, draws = 4, 6, 34, 20_000
    spectral, frobenius = core.joint_radii(n, d, nu, DELTA, 1)
    assert (spectral, frobenius) == core.joint_radii(n, d, nu, DELTA, 2)
    roots = beta_roots(n, d, nu, draws, gen)
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


@pytest.mark.parametrize("inputs", ["proportional", "unused", "one in three"])
@pytest.mark.parametrize("units", [1.0, 1e-6, 1e6])
def test_missing_directions_of_inputs_alone_leave_steps_finite(gen, inputs, units):
    """The same radii as with the inputs that were free; what is known of A is known."""
    for _ in range(sets(30, 8)):
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


def test_least_squares_from_rows_and_from_their_triangle() -> None:
    """The last input is the first one minus twice the first state."""
    gen = np.random.default_rng(3)
    x, u = gen.standard_normal((40, 3)), gen.standard_normal((40, 1))
    Z, Y = np.hstack([x, u, u - 2.0 * x[:, :1]]), gen.standard_normal((40, 3))
    both = np.hstack([Z, Y])
    f, g = core.fit(both, 5, 40, 1), core.fit(core.triangle(both, 1), 5, 40, 1)
    assert (f.H == g.H).all()
    assert (f.rank, f.nu, f.N) == (4, 36, 40)
    E = Y - Z @ f.H.T
    np.testing.assert_allclose(f.S, E.T @ E, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(f.root.T @ f.root, Z.T @ Z, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(f.combinations(), [[1.0, 0.0, 0.0, -0.5, 0.5]], atol=1e-12)
