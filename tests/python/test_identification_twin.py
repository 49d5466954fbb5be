"""Identification in plain NumPy: known numbers, coverage by simulation, and what must fail.

Coverage: with R runs at level 5 % the number of failures is binomial. An exact statement is
accepted between the quantiles of 0.5e-5 and 1 - 0.5e-5, a conservative one below the quantile of
1 - 1e-5: a false alarm of 1e-5 for each of the about 40 counts, once and for all, as seeds are
fixed. Anti-tests break an assumption and demand coverage visibly below the level.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

import identification_data as d0
from identification_data import SKEWED, THETA, Y, Z, independent, stable, tuned
from stochens_rs.reference import anytime as at
from stochens_rs.reference import certified_control as cc
from stochens_rs.reference import fusing_by_data as fd
from stochens_rs.reference import input_error as ie
from stochens_rs.reference import instruments as iv
from stochens_rs.reference import laws, signs
from stochens_rs.reference import polynomial_roots as pr
from stochens_rs.reference import quantiles as qu
from stochens_rs.reference import regions as rg
from stochens_rs.reference import resampling as rs
from stochens_rs.reference import residual_tests as rt
from stochens_rs.reference import triangle as tr

ALARM = 1e-5
DELTA = 0.05
POINT = d0.POINT
DATA = tr.triangle(Z, Y)
FIT = tr.fit(DATA)


def check(actual, expected, rtol=2e-12, atol=6e-13):  # numbers with 12 decimals
    np.testing.assert_allclose(actual, expected, rtol=rtol, atol=atol)


def exactly(failures, runs, rate=DELTA):
    low, high = stats.binom.ppf([ALARM / 2, 1 - ALARM / 2], runs, rate)
    assert low <= failures <= high, f"{failures} of {runs}, expected {rate * runs:g}"


def at_most(failures, runs, rate=DELTA):
    high = stats.binom.ppf(1 - ALARM, runs, rate)
    assert failures <= high, f"{failures} of {runs}, expected at most {rate * runs:g}"


# -- known numbers ---------------------------------------------------------------------------------


def test_triangle_and_least_squares():
    R11 = DATA.R[:3, :3]
    V = [[115, 41, -11], [41, 103, -11], [-11, -11, 99]]
    check(R11.T @ R11, V, atol=1e-12)
    check(np.prod(np.diag(R11)) ** 2, 989_780)
    check(FIT.H, [[0.910915759058, 0.201738164036, -0.029402089353],
                  [-0.031460324517, 0.751160257835, 0.998148477439]], atol=6e-13)  # fmt: skip
    S = [[0.453161369193, 0.042660146699], [0.042660146699, 0.062427872861]]
    check(FIT.S, S, atol=6e-13)
    check(DATA.R[3:, 3:].T @ DATA.R[3:, 3:], FIT.S, atol=1e-13)
    assert (FIT.rank, FIT.nu) == (3, 9)
    check(tr.leverages(Z)[:3], [0.144743276284, 0.292909535452, 0.305134474328])
    check(FIT.white @ FIT.root.T, np.eye(3), atol=1e-14)


def test_triangles_are_updated_and_merged_exactly():
    halves = tr.merge(tr.triangle(Z[:5], Y[:5]), tr.triangle(Z[5:], Y[5:]))
    check(halves.R, DATA.R, atol=1e-13)
    grown = tr.triangle(Z[:1], Y[:1])
    for z, y in zip(Z[1:], Y[1:], strict=True):
        grown = tr.update(grown, z, y)
    check(grown.R, DATA.R, atol=1e-13)
    assert grown.N == halves.N == 12


def test_pivots_of_the_data_set():
    roots = rg.pivot(rg.full(DATA, DELTA), THETA)
    check([roots[-1], roots.sum()], [8.576000255872, 8.799829996301], rtol=1e-11)
    X = (FIT.H - THETA) @ FIT.root.T
    check([np.linalg.norm(X, 2), np.linalg.norm(X)], [0.724677222758, 0.788613186516])


def test_roots_of_least_squares_in_closed_form():
    check(qu.roy_cdf(0.5, 2, 3, 9), 367 / 512, rtol=1e-14)
    check(qu.roy_cdf(0.3, 2, 3, 9), 0.311376393, rtol=1e-14)
    check(qu.roy_quantile(2, 3, 9, 0.05), 2.352760180305)
    check(qu.roy_quantile(2, 2, 9, 0.05), 1.765073871830)
    check(qu.roy_quantile(2, 1, 9, 0.05), 1.114742526881)
    check(qu.roy_quantile(4, 6, 34, 0.05), 0.878703628912667)
    check(qu.roy_quantile(4, 6, 34, 0.001), 1.59384135970193, rtol=1e-11)
    check(qu.roy_quantile(4, 3, 34, 0.05), 0.588992481883)
    check(qu.roy_quantile(4, 1, 34, 0.05), 0.345634465762168)
    check(qu.roy_quantile(3, 2, 20, 0.05), 0.762982611331)
    check(qu.roy_quantile(2, 5, 12, 0.05), 2.113591033513)
    # 50 digits of the same formula
    check(qu.roy_quantile(10, 15, 100, 0.05), 0.68481720772601836, rtol=1e-11)
    check(qu.roy_quantile(8, 12, 60, 0.01), 1.21828685238584594, rtol=1e-11)


def test_roots_of_wishart_matrices_in_closed_form():
    pairs = [(2, 3), (4, 6), (1, 5)]
    found = [np.sqrt(qu.wishart_quantile(*p, 0.05)) for p in pairs]
    check(found, [3.277246613199, 4.65007831702905234, 3.327235743604])
    check(np.sqrt(qu.wishart_quantile(10, 15, 0.05)), 7.27609215245260164)
    found = [qu.scalar_quantile(*p, 0.05) for p in [(1, 3, 9), (2, 3, 9), (4, 6, 34)]]
    check(found, [1.287516119208, 0.751702538693, 0.166390274969643], rtol=1e-11)


@pytest.mark.parametrize("p", [2, 3, 5, 8, 10])
def test_both_laws_are_1_at_the_end(p):
    assert qu.roy_fault(p, p + 4, 6 * p) < 1e-5
    assert qu.wishart_fault(p, p + 4) < 1e-6


def test_the_laws_know_where_they_lose_their_digits():
    assert qu.roy_fault(15, 17, 100) > qu.TRUSTED * DELTA
    assert qu.roy_fault(20, 22, 200) > 1.0
    assert qu.roy_quantile(4, 6, 34, 1e-15) == np.inf  # no form has these digits, nor any draw


@pytest.mark.parametrize(
    "case", [(2, 3, 9), (3, 5, 12), (2, 3, 3), (5, 5, 5), (4, 2, 20), (1, 4, 9)]
)
def test_both_forms_of_the_laws_agree(case):
    for theta in (0.3, 0.6, 0.9, 1.0):
        check(pr.roy_cdf(theta, *case), qu.roy_cdf(theta, *case), 1e-12, 1e-12)
    for x in (3.0, 9.0, 20.0, np.inf):
        check(pr.wishart_cdf(x, *case[:2]), qu.wishart_cdf(x, *case[:2]), 1e-12, 1e-12)


def test_the_form_in_polynomials_keeps_its_digits():
    for case in [(10, 15, 100), (20, 22, 200), (40, 45, 500), (10, 15, 2000)]:
        check(pr.roy_cdf(1.0, *case), 1.0, rtol=1e-10)
        check(pr.wishart_cdf(np.inf, *case[:2]), 1.0, rtol=1e-11)
    # 50 digits of the form in powers
    check(qu.roy_quantile(15, 15, 100, 0.05), 0.909140858288492612, rtol=1e-11)
    check(pr.roy_cdf(0.68481720772601836 / 1.68481720772601836, 10, 15, 100), 0.95)
    check(pr.wishart_cdf(7.27609215245260164**2, 10, 15), 0.95)
    roots = qu.beta_roots(20, 22, 200, 4000, np.random.default_rng(1))
    exactly(np.sum(roots[:, -1] > qu.roy_quantile(20, 22, 200, DELTA)), 4000)


@pytest.mark.parametrize(
    ("n", "d", "nu"), [(1, 3, 9), (2, 3, 9), (4, 6, 34), (6, 2, 20), (3, 3, 3)]
)
def test_beta_model_has_the_roots_of_gaussian_matrices(n, d, nu):
    gen, draws = np.random.default_rng(2), 20_000
    roots = qu.beta_roots(n, d, nu, draws, gen)
    exactly(np.sum(roots[:, -1] > qu.roy_quantile(n, d, nu, 0.05)), draws)
    G, E = gen.standard_normal((2000, n, d)), gen.standard_normal((2000, n, nu))
    product = np.linalg.solve(E @ E.transpose(0, 2, 1), G @ G.transpose(0, 2, 1))
    trace = np.trace(product, axis1=1, axis2=2)
    assert stats.ks_2samp(trace, roots.sum(axis=1)).pvalue > ALARM


def test_moments_and_smallest_roots_of_the_simulated_laws():
    roots = qu.beta_roots(4, 6, 34, 100_000, np.random.default_rng(3)).sum(axis=1)
    assert abs(roots.mean() - 24 / 29) < 4.5 * roots.std() / np.sqrt(len(roots))
    gen = np.random.default_rng(4)
    smallest = np.linalg.svd(gen.standard_normal((4000, 4, 34)), compute_uv=False)[:, -1] ** 2
    exactly(np.sum(smallest < qu.smallest_quantile(4, 34, 0.05)), 4000)


def test_bounds_at_a_point():
    check(tr.length(FIT, POINT), 0.178749950455)
    region = rg.full(DATA, DELTA)
    check(rg.bound(region, POINT), 0.185505135251)
    check(rg.component_bounds(region, POINT)[0], 0.184570037684)
    check(rg.bound(rg.scalar(DATA, DELTA), POINT), 0.111280959627)
    noisy = cc.one_noisy_step(rg.full(DATA, DELTA, future=1), POINT[:2], POINT[2:], np.zeros(2))
    check(noisy.model, 1.173596784293)
    check(qu.roy_quantile(2, 4, 9, 0.05), 2.915655205842)


def test_instruments():
    q = qu.roy_quantile(2, 3, 9, DELTA)
    same = iv.instrumented(Z, Z, Y, DELTA)
    check(same.V, FIT.root.T @ FIT.root, atol=1e-12)
    check(same.centre, FIT.H, atol=1e-13)
    check(same.S, q * FIT.S, atol=1e-13)
    check(rg.bound(iv.region(same), POINT), rg.bound(rg.full(DATA, DELTA), POINT))
    found = iv.instrumented(d0.INSTRUMENTS, d0.Z_READ, Y, DELTA, q=0.5)
    check(found.centre[0], [0.9159556976, 0.1537706312, 0.0231910600], rtol=0, atol=6e-11)
    check(found.S, [[0.2938039719, -0.0529729158], [-0.0529729158, 0.0047987039]], 0, 6e-11)
    check(found.V[0, 0], 120.02000177, rtol=0, atol=6e-9)
    assert found.status == "empty"
    with pytest.raises(ValueError, match="empty"):
        iv.region(found)


def test_sphere_mixture():
    check(at.sphere_level(1, 22, 0.05), 11 + np.log(20))
    cases = [(2, 10, 0.05), (4, 22, 0.05), (10, 60, 0.01)]
    found = [at.sphere_level(*case) for case in cases]
    check(found, [9.673318542407, 18.936369258257, 49.510828368918], rtol=1e-12)
    check(np.exp(laws.log_hyp1f1(0.5, 1.5, 2.0)), 2.364453892805, rtol=1e-12)
    info = at.information(DATA, 1.0)
    check(info, [13.836882541412, 67.518679400620], rtol=1e-12)
    check(at.sphere_level(2, info.ld, 0.05), 11.692318326802, rtol=1e-12)
    region = at.known_noise(DATA, 0.3, 0.05)
    check([rg.radius(region), rg.bound(region, POINT)], [1.461433607245, 0.261231184889])
    check(at.ridge(DATA, 0.3, 0.05, 1.0, 2.0).radius, 1.692345815544)


@pytest.mark.parametrize("n", [1, 2, 10, 300])
@pytest.mark.parametrize("ld", [0.0, 1e-3, 3.0, 300.0, 5000.0])
@pytest.mark.parametrize("delta", [0.5, 0.05, 1e-12])
def test_sphere_level_solves_its_equation(n, ld, delta):
    c = at.sphere_level(n, ld, delta)
    check(laws.log_hyp1f1(0.5, n / 2, c), ld / 2 - np.log(delta), rtol=1e-12, atol=1e-13)


def test_regions_of_unknown_covariance():
    a = laws.chi2_quantile(0.01, 50)
    check([a, 4 / (a - 4)], [29.706682698841, 0.155601562709])
    check(at.universal(DATA, 0.05, l0=1.0, psi=1.0, nu0=4.0).factor, 2246.2010650656)


def test_gaussian_noise_in_one_dimension_is_put_together_as_stated():
    data = tr.triangle(Z, Y[:, :1])
    rho2 = 2 * at.sphere_level(1, at.information(data, 1.0).ld, 0.025)
    rho2 *= 1 + 1 / at.information(data, 1.0).smallest
    a = laws.chi2_quantile(0.025, 12)
    assert a < rho2
    assert at.gaussian_noise(data, 0.05).factor == np.inf
    longer = tr.merge(*[data] * 8)
    info = at.information(longer, 1.0)
    rho2 = 2 * at.sphere_level(1, info.ld, 0.025) * (1 + 1 / info.smallest)
    a = laws.chi2_quantile(0.025, 96)
    check(at.gaussian_noise(longer, 0.05).factor, rho2 / (a - rho2))


EIGHT_SIGNS = np.array([[1.0, *rest] for rest in itertools.product([1.0, -1.0], repeat=3)])


def test_sign_perturbed_sums():
    z, y = np.array([[1.0], [2.0], [-1.0], [3.0]]), np.array([[1.0], [3.0], [-1.0], [2.0]])
    check(tr.fit(tr.triangle(z, y)).H, [[14 / 15]], rtol=1e-14)
    r = [np.inf, 1.549193338483, 0.258198889747, 1.807392228230,
         2.194690562851, 0.258198889747, 1.807392228230, 0.258198889747]  # fmt: skip
    check(signs.radii(z, y, EIGHT_SIGNS), r, rtol=1e-11)
    check(signs.sign_radius(1.3, 0.4), 1.3 / 0.6, rtol=1e-13)
    check(signs.chance_of_infinity(15, 4), 0.03515625, rtol=1e-14)
    check(signs.chance_of_infinity(12, 3), 0.03857421875, rtol=1e-14)
    assert rg.radius(signs.ellipsoid(z, y, EIGHT_SIGNS, 1)) == np.inf
    check(rg.radius(signs.ellipsoid(z, y, EIGHT_SIGNS, 2)), 2.194690562851, rtol=1e-11)


def test_radius_of_a_sign_vector_is_the_maximum():
    gen = np.random.default_rng(5)
    s, K = gen.standard_normal((3, 2)), np.array([[0.5, 0.2], [0.2, -0.6]])
    radius = signs.sign_radius(s, K)
    X = gen.standard_normal((20_000, 3, 2))
    X /= np.linalg.norm(X, axis=(1, 2), keepdims=True)
    # on the ray r X:  r^2 = ||s - r X K||^2
    XK = X @ K
    a, b = 1 - np.sum(XK**2, axis=(1, 2)), np.sum(s * XK, axis=(1, 2))
    r = (-b + np.sqrt(b * b + a * np.sum(s * s))) / a
    assert 0.97 * radius < r.max() <= radius * (1 + 1e-9)


def steps_of_the_data_set(**options):
    u = [[0.5], [0.0], [-0.5]]
    return cc.several_steps(FIT, [1.0, -1.0], u, spectral=np.sqrt(1.2), **options)


def test_several_steps():
    steps = steps_of_the_data_set(frobenius=np.sqrt(1.5))
    check(steps.states[3], [0.491473192146, -0.693577119257])
    check(steps.sizes, [0.178749950455, 0.085974974573, 0.086239745577])
    check(steps.linear[3], 0.236959828427)
    check(steps.rest, [0.0, 0.012958575976, 0.019349802407, 0.025776650886], rtol=3e-11)
    check(steps.radii[3], 0.260230790267)
    beta = np.sqrt(1.2 * np.linalg.norm(FIT.S, 2))
    scalar = cc.scalar_steps(FIT, steps.states, steps.sizes, beta=beta)
    check(scalar[1:], [0.132482260241, 0.202310782847, 0.275234378473])
    check(steps.radii[1], scalar[1], rtol=1e-13)  # one step: no remainder, no difference


def test_limits_of_a_noncentrality():
    check(laws.noncentrality_limit(32, 32, 0.025), 21.445789230634)
    check(laws.noncentrality_limit(150, 147, 0.025), 43.023665602840)
    check(laws.noncentrality_limit(10, 5, 0.05), 18.117739807813)
    assert laws.noncentrality_limit(0.1, 32, 0.025) == 0.0


MODELS = np.array([[[1.0, 0.2, 0.0], [-0.1, 0.8, 1.0]], [[0.8, 0.2, 0.0], [-0.1, 0.7, 1.0]]])


def test_models_fused_by_data():
    fused = fd.fuse(MODELS, FIT)
    check(fused.weights[0], 0.611012433393)
    check(fused.distance2, 0.590027987076)
    check(fd.shrunken(fused, 0.2, rule="mallows").share, 0.593239633955)
    check(fd.shrunken(fused, 0.2).share, 0.796619816977)
    check(fd.certificate(fused, 0.2, 0.05).factor, 1.349148050135)
    assert (fused.k, fused.p) == (1, 6)


def test_least_squares_as_one_more_model_has_the_closed_form_of_mallows():
    fused = fd.fuse(MODELS, FIT)
    share = np.linspace(0.0, 1.0, 100_001)
    criterion = (1 - share) ** 2 * fused.distance2 + 2 * 0.04 * 6 * share
    found = fd.shrunken(fused, 0.2, rule="mallows").share
    assert abs(share[np.argmin(criterion)] - found) < 1e-5


@pytest.mark.parametrize("models", [[THETA], [THETA, THETA], [FIT.H, FIT.H + 1.0]])
def test_fusing_few_or_equal_models(models):
    fused = fd.fuse(models, FIT)
    error = np.linalg.norm((fused.F - THETA) @ FIT.root.T) ** 2
    assert error <= fd.certificate(fused, 0.5, DELTA).factor < np.inf
    assert fd.certificate_unknown(fused, DELTA, cells=5).factor < np.inf
    if fused.k == 0:
        limit = laws.noncentrality_limit(fused.off2 / 0.25, 6, DELTA)
        check(fd.certificate(fused, 0.5, DELTA).factor, 0.25 * limit)


def test_leave_one_out_is_the_fit_without_the_pair():
    own = tr.residuals(Z, Y) / (1 - tr.leverages(Z))[:, None]
    for t in range(12):
        kept = np.arange(12) != t
        H = tr.fit(tr.triangle(Z[kept], Y[kept])).H
        check(own[t], Y[t] - H @ Z[t], atol=1e-13)
    weights = fd.leave_one_out(MODELS, Z, Y)
    errors = np.array([*(Y - Z @ m.T for m in MODELS), own])
    for other in np.random.default_rng(6).dirichlet(np.ones(3), 50):
        best = np.linalg.norm(np.tensordot(weights, errors, axes=1))
        assert best <= np.linalg.norm(np.tensordot(other, errors, axes=1)) + 1e-12


def test_ensembles_from_data():
    check(rs.residual_shift(Z, Y), [[-0.000116785529, -0.000104686127, -0.000144140697],
                                    [-0.004277269983, -0.003834129399, -0.005279153042]],
          atol=6e-13)  # fmt: skip
    counts = [2, 0, 1, 0, 3, 1, 1, 0, 1, 0, 2, 1]
    model = rs.weighted_models(Z, Y, [counts])[0]
    check(model, [[0.91869790702, 0.195814039637, -0.00807556955],
                  [-0.03629460001, 0.760799979794, 0.996257724494]], atol=6e-12)  # fmt: skip
    S = [[0.075526894866, 0.00711002445], [0.00711002445, 0.010404645477]]
    check(FIT.S / (FIT.nu - 3), S, atol=6e-13)
    check(qu.order_quantile(np.arange(1.0, 20.0), 0.05), 19.0)


def covariance(models):
    rows = models.transpose(0, 2, 1).reshape(len(models), -1)
    return np.cov(rows.T)


def test_laws_of_the_ensembles():
    gen, size = np.random.default_rng(7), 40_000
    V = FIT.white.T @ FIT.white
    for models, mean, spread in [
        (rs.region_draws(FIT, size, gen), FIT.H, np.kron(V, FIT.S / (FIT.nu - 3))),
        (rs.residual_models(Z, Y, size, gen, signs=True), FIT.H, rs.wild_covariance(Z, Y)),
        (rs.residual_models(Z, Y, size, gen), FIT.H, None),
        (rs.residual_models(Z, Y, size, gen, centred=False), FIT.H + rs.residual_shift(Z, Y), None),
    ]:
        error = models.mean(axis=0) - mean
        assert np.all(np.abs(error) < 5 * models.std(axis=0) / np.sqrt(size))
        if spread is not None:
            scale = np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
            assert np.max(np.abs(covariance(models) - spread) / scale) < 0.05
    few = rs.weighted_models(Z, Y, [[6, 6] + [0] * 10])
    assert np.all(np.isnan(few))


def test_pooling_beats_every_weight():
    gen = np.random.default_rng(8)
    Theta, z, _ = independent(gen, n=2, d=3, N=30)
    data = []
    for part, scale in zip(np.split(z, [6, 12]), (1.0, 0.05, 2.0), strict=True):
        noise = gen.standard_normal((len(part), 2))
        data.append(tr.triangle(scale * part, scale * part @ Theta.T + noise))
    w = rs.precision_weights(data)
    costs = np.array([np.sum(tr.fit(part).white ** 2) for part in data])
    pooled = np.sum(rs.pooled(data).white ** 2)
    assert pooled < w**2 @ costs < np.full(3, 1 / 3) ** 2 @ costs
    for other in gen.dirichlet(np.ones(3), 100):
        assert w**2 @ costs <= other**2 @ costs + 1e-15
    V = [tr.fit(part).root.T @ tr.fit(part).root for part in data]
    H = sum(tr.fit(part).H @ v for part, v in zip(data, V, strict=True)) @ np.linalg.inv(sum(V))
    check(rs.pooled(data).H, H, rtol=1e-10)


def test_mean_of_pseudoinverses():
    check(ie.mean_pseudoinverse([1.0, 0.0], 1.0), [0.3934693403, 0.0], rtol=1e-10)
    b = np.array([1.0, 0.0]) + np.random.default_rng(9).standard_normal((400_000, 2))
    found = b / np.sum(b * b, axis=1, keepdims=True)
    kept = np.abs(found[:, 0]) < 1e3  # the variance is infinite: what is left out is below 1e-3
    assert abs(found[kept, 0].mean() - 0.3934693403) < 0.02


def test_error_in_the_states_biases_least_squares():
    M = np.array([[1.25]])  # 1 + the error's 0.25
    plim = 0.9 * (M - 0.25) / M
    check(plim, [[0.72]])
    gen = np.random.default_rng(10)
    x = gen.standard_normal((200_000, 1))
    read, y = x + 0.5 * gen.standard_normal(x.shape), 0.9 * x
    assert abs(tr.fit(tr.triangle(read, y)).H[0, 0] - 0.72) < 0.01
    assert abs(iv.corrected(read, y, [[0.25]])[0, 0] - 0.9) < 0.01
    with pytest.raises(ValueError, match="error covariance"):
        iv.corrected(read, y, [[1.3]])
    check(rs.autoregression_bias(0.8, 50), -0.032)


def test_what_the_data_do_not_show_is_infinite():
    z = np.array([[1.0, 2, 1], [2, 4, 0], [3, 6, 1], [4, 8, 0]])
    data = tr.triangle(z, z @ np.array([[1.0], [2.0], [3.0]]) + [[0.1], [-0.1], [0.2], [0.0]])
    m = tr.fit(data)
    assert (m.rank, m.nu) == (2, 2)
    region = rg.full(data, DELTA)
    assert rg.bound(region, [1.0, 2.0, 0.0]) < np.inf
    assert rg.bound(region, [2.0, -1.0, 0.0]) == np.inf
    direction = m.missing[:, 0] / m.missing[0, 0]
    check(direction, [1.0, -0.5, 0.0], atol=1e-14)


# -- coverage: the statement holds as often as it says ---------------------------------------------

RUNS = 1500


def misses(seed, runs, holds, **options):
    """How often holds(gen, Theta, Z, Y) is false over data of `independent`."""
    gen = np.random.default_rng(seed)
    return sum(not holds(gen, *independent(gen, **options)) for _ in range(runs))


def test_coverage_of_the_full_region():
    exactly(
        misses(
            20,
            RUNS,
            lambda gen, Theta, z, y: rg.contains(rg.full(tr.triangle(z, y), DELTA), Theta),
            root=SKEWED,
        ),
        RUNS,
    )


@pytest.mark.parametrize("r", [1, 3])
def test_coverage_of_fixed_directions(r):
    Q = np.random.default_rng(21).standard_normal((6, r))

    def holds(gen, Theta, z, y):
        region = rg.directions(tr.triangle(z, y), Q, DELTA)
        return rg.pivot_in(region, Theta, Q)[-1] <= region.factor

    exactly(misses(22, RUNS, holds, root=SKEWED), RUNS)


def test_coverage_of_combinations():
    L = np.random.default_rng(23).standard_normal((4, 2))

    def holds(gen, Theta, z, y):
        return rg.contains(rg.combinations(tr.triangle(z, y), L, DELTA), L.T @ Theta)

    exactly(misses(24, RUNS, holds, root=SKEWED), RUNS)


def test_coverage_with_noise_to_come():
    """Model and three noises in one event: largest root, trace, and both at once."""
    root = SKEWED
    failed = np.zeros(3, dtype=int)
    gen = np.random.default_rng(25)
    q_R = qu.roy_quantile(4, 9, 34, DELTA)
    q_T = qu.trace_quantile(4, 9, 34, DELTA)
    both = qu.joint_radii(4, 9, 34, DELTA)
    for _ in range(RUNS):
        Theta, z, y = independent(gen, root=root)
        m = tr.fit(tr.triangle(z, y))
        X = np.hstack([(m.H - Theta) @ m.root.T, root @ gen.standard_normal((4, 3))])
        sizes = np.linalg.svd(np.linalg.solve(np.linalg.cholesky(m.S), X), compute_uv=False)
        top, trace = sizes[0] ** 2, np.sum(sizes**2)
        failed += [
            top > q_R,
            trace > q_T,
            top > both.spectral**2 or trace > both.frobenius**2,
        ]
    for count in failed:
        exactly(count, RUNS)


def test_coverage_with_independent_components():
    root = np.diag([1.0, 0.1, 0.1, 3.0])

    def rows(gen, Theta, z, y):
        m = tr.fit(tr.triangle(z, y))
        X = (m.H - Theta) @ m.root.T
        return np.all(np.sum(X**2, axis=1) <= qu.row_quantile(4, 6, 34, DELTA) * np.diag(m.S))

    exactly(misses(26, RUNS, rows, root=root), RUNS)

    def spectral(gen, Theta, z, y):
        return rg.contains(rg.diagonal(tr.triangle(z, y), DELTA), Theta)

    exactly(misses(27, RUNS, spectral, root=root), RUNS)


def test_coverage_with_scalar_covariance():
    def unknown(gen, Theta, z, y):
        return rg.contains(rg.scalar(tr.triangle(z, y), DELTA), Theta)

    exactly(misses(28, RUNS, unknown, root=0.3 * np.eye(4)), RUNS)

    def known(gen, Theta, z, y):
        return rg.contains(rg.known(tr.triangle(z, y), 0.3, DELTA), Theta)

    exactly(misses(29, RUNS, known, root=0.3 * np.eye(4)), RUNS)


def test_coverage_with_known_entries():
    free = np.random.default_rng(30).random((4, 6)) < 0.5
    free[0] = False

    def holds(gen, Theta, z, y):
        rows = rg.pattern(z, y, free, DELTA, known=np.where(free, 0.0, Theta))
        good = []
        for i in range(4):
            m = rows.fits[i]
            x = (rows.H[i] - Theta[i])[free[i]] @ m.root.T
            good.append(x @ x <= rows.quantiles[i] * m.S[0, 0] + 1e-20)
        return all(good)

    at_most(misses(31, 800, holds, root=SKEWED), 800)


def test_coverage_where_the_data_miss_directions():
    """Rank 3 of 6, also for a region of few pairs: the residual of the missing rows is counted."""
    mix = np.random.default_rng(32).standard_normal((3, 6))
    gen, failed = np.random.default_rng(33), 0
    for _ in range(RUNS):
        Theta, z = gen.standard_normal((2, 6)), gen.standard_normal((8, 3)) @ mix
        data = tr.triangle(z, z @ Theta.T + gen.standard_normal((8, 2)))
        region = rg.full(data, DELTA)
        assert region.fitted.rank == 3
        X = (region.fitted.H - Theta) @ region.fitted.root.T
        X = np.linalg.solve(np.linalg.cholesky(region.S), X)
        failed += np.linalg.norm(X, 2) ** 2 > region.factor
    exactly(failed, RUNS)


def test_supermartingale_of_the_sphere_mixture():
    """Its mean is at most 1 at the true Theta, in closed loop, at all N."""
    gen, values = np.random.default_rng(34), []
    for _ in range(1500):
        Theta, run = tuned(gen, 12)
        z, y = tr.pairs([run])
        data = tr.triangle(z, y - z @ Theta.T)
        M = at.ridge(data, 1.0, 0.5, 4.0, 0.0).H  # M V_lam^-1
        V = z.T @ z + 4.0 * np.eye(3)
        c = np.linalg.eigvalsh(M @ V @ M.T)[-1] / 2.0
        values.append(np.exp(laws.log_hyp1f1(0.5, 1.0, c) - at.information(data, 4.0).ld / 2))
    assert np.mean(values) <= 1.0 + 4.0 * np.std(values) / np.sqrt(len(values))
    assert np.mean(values) > 0.3  # not empty


def test_level_of_the_residual_tests():
    gen, runs = np.random.default_rng(35), 600
    low = np.zeros(len(rt.NAMES), dtype=int)
    for _ in range(runs):
        _, z, y = independent(gen, n=2, d=3, N=14, root=SKEWED[:2, :2])
        low += rt.p_values(z, y, 19, gen) <= 0.0501  # exactly one in twenty
    for count in low:
        exactly(count, runs)


def test_coverage_of_sign_perturbed_sums():
    gen, failed = np.random.default_rng(36), 0
    for _ in range(RUNS):
        z = gen.standard_normal((8, 2))
        w = gen.standard_t(1.5, (8, 2)) * np.arange(1, 9)[:, None]
        basis = np.linalg.qr(z)[0]
        vectors = signs.sign_vectors(20, 8, gen)
        failed += not signs.contains(w, basis, vectors, 1, gen)
    exactly(failed, RUNS)


def test_ellipsoid_holds_the_set_of_sign_perturbed_sums():
    gen = np.random.default_rng(37)
    for _ in range(10):
        _, z, y = independent(gen, n=2, d=2, N=12)
        vectors = signs.sign_vectors(10, 12, gen)
        ball = signs.ellipsoid(z, y, vectors, 2)
        m = ball.fitted
        for _ in range(60):
            X = gen.standard_normal((2, 2))
            X *= 1.02 * min(rg.radius(ball), 1e3) / np.linalg.norm(X)
            errors = y - z @ (m.H + X @ m.white).T
            assert not signs.contains(errors, z @ m.white.T, vectors, 2, gen)


LAMS = tuple(4.0**j for j in range(6))


def test_regions_for_any_design_hold_at_all_looks():
    """Feedback tuned by past noise, unstable plant, four looks; exogenous regions fail here."""
    gen, runs = np.random.default_rng(38), 100
    failed = np.zeros(3, dtype=int)
    for _ in range(runs):
        Theta, run = tuned(gen, 150)
        z, y = tr.pairs([run])
        now = np.zeros(3, dtype=bool)
        for N in (8, 20, 60, 150):
            data = tr.triangle(z[:N], y[:N])
            regions = [at.known_noise(data, 1.0, DELTA, LAMS)]
            regions.append(at.universal(data, DELTA, l0=1.0, psi=1.0, nu0=4.0))
            now[:2] |= [not rg.contains(region, Theta) for region in regions]
        now[2] = not rg.contains(at.gaussian_noise(data, DELTA, LAMS), Theta)
        failed += now
    assert np.isfinite(at.gaussian_noise(data, DELTA, LAMS).factor)
    for count in failed:
        at_most(count, runs)


def noisy_states(gen, T, sv, sw=0.1):
    """A stable plant whose states are read with error; inputs, and the pairs as read."""
    A, B = np.array([[0.8, 0.2], [-0.1, 0.7]]), np.array([[0.0], [1.0]])
    x, u = np.zeros((T + 1, 2)), gen.standard_normal((T, 1))
    w = sw * gen.standard_normal((T, 2))
    for t in range(T):
        x[t + 1] = A @ x[t] + B @ u[t] + w[t]
    return np.hstack([A, B]), (x + sv * gen.standard_normal(x.shape), u)


def past_inputs(run, lags=5):
    """Every second pair of a run and its present and past inputs."""
    z, y = tr.pairs([run])
    u = z[:, 2]
    keep = np.arange(lags, len(u), 2)
    zeta = np.column_stack([u[keep - j] for j in range(lags + 1)])
    return zeta, z[keep], y[keep]


@pytest.mark.parametrize(("sv", "sw"), [(0.3, 0.1), (0.1, 0.0), (0.0, 0.1)])
def test_coverage_of_instruments(sv, sw):
    gen, runs, failed, unbounded = np.random.default_rng(39), 250, 0, 0
    for _ in range(runs):
        Theta, run = noisy_states(gen, 200, sv, sw)
        found = iv.instrumented(*past_inputs(run), DELTA)
        failed += not iv.contains(found, Theta)
        unbounded += found.status == "unbounded"
    exactly(failed, runs)
    assert unbounded < runs / 2


def k_step_case(gen, K, N=60):
    A, B = stable(gen)
    Theta = np.hstack([A, B])
    z = gen.standard_normal((N, 6))
    data = tr.triangle(z, z @ Theta.T + 0.1 * gen.standard_normal((N, 4)))
    return Theta, data, gen.standard_normal(4), gen.standard_normal((K, 2))


def rolled(Theta, x0, inputs, noise=None):
    x = np.asarray(x0)
    for k, u in enumerate(inputs):
        x = Theta @ np.concatenate([x, u]) + (0.0 if noise is None else noise[k])
    return x


@pytest.mark.parametrize("noise", [False, True])
def test_certificates_of_several_steps_hold(noise):
    gen, runs, failed, ratios = np.random.default_rng(40), 150, 0, []
    for _ in range(runs):
        Theta, data, x0, u = k_step_case(gen, 5)
        region = rg.joint(data, DELTA, future=5 if noise else 0)
        steps = cc.several_steps(
            region.fitted,
            x0,
            u,
            spectral=region.spectral,
            frobenius=region.frobenius,
            rho0=0.01,
            noise=noise,
        )
        e0 = gen.standard_normal(4)
        start = x0 + 0.01 * e0 / np.linalg.norm(e0)
        w = 0.1 * gen.standard_normal((5, 4)) if noise else None
        error = np.linalg.norm(rolled(Theta, start, u, w) - steps.states[-1])
        failed += error > steps.radii[-1]
        ratios.append(steps.radii[-1] / error)
    at_most(failed, runs)
    assert 3.0 < np.median(ratios) < 20.0


def test_direct_regression_over_several_steps():
    """(x0, u0, .., u(K-1)) to x(K) of independent open-loop runs: exact pairs of one step."""
    gen, runs, failed = np.random.default_rng(41), 600, 0
    A, B = stable(gen, n=2, m=1)
    Theta, K = np.hstack([A, B]), 3
    powers = [np.linalg.matrix_power(A, p) for p in range(K + 1)]
    direct = np.hstack([powers[K], *[powers[K - 1 - k] @ B for k in range(K)]])
    for _ in range(runs):
        some = []
        for _ in range(14):
            x, u = [gen.standard_normal(2)], gen.standard_normal((K + 1, 1))
            for k in range(K + 1):
                x.append(Theta @ np.concatenate([x[-1], u[k]]) + 0.3 * gen.standard_normal(2))
            some.append((np.array(x), u))
        region = rg.full(tr.triangle(*tr.k_step(some, K)), DELTA)
        failed += not rg.contains(region, direct)
    exactly(failed, runs)


def hull(gen, Theta, spread, off=0.0, M=4):
    """Models around Theta whose hull holds it, or is `off` beside it."""
    models = Theta + spread * gen.standard_normal((M, *Theta.shape))
    return models - models.mean(axis=0) + Theta + off * gen.standard_normal(Theta.shape)


@pytest.mark.parametrize("off", [0.0, 0.3, 3.0])
def test_certificates_of_models_fused_by_data_hold(off):
    gen, runs = np.random.default_rng(42), 60
    failed, sizes = np.zeros(2, dtype=int), []
    for _ in range(runs):
        Theta, z, y = independent(gen, n=4, d=6, N=30)
        fused = fd.fuse(hull(gen, Theta, 0.5, off), tr.fit(tr.triangle(z, y)))
        error = np.linalg.norm((fused.F - Theta) @ fused.fitted.root.T)
        known = fd.certificate(fused, 1.0, DELTA)
        unknown = fd.certificate_unknown(fused, DELTA, cells=10)
        failed += [error**2 > known.factor, error**2 > unknown.factor]
        sizes.append(np.sqrt([known.factor, unknown.factor]))
    for count in failed:
        at_most(count, runs)
    if off == 0.0:  # sharper than least squares: chi with 24 degrees
        assert np.median(sizes, axis=0)[0] < np.sqrt(laws.chi2_upper(DELTA, 24))


def test_shrinking_towards_the_hull_beats_least_squares():
    for off, gain in ((0.0, 0.5), (0.3, 0.9), (30.0, 1.01)):
        gen, risks = np.random.default_rng(43), []
        for _ in range(250):
            Theta, z, y = independent(gen, n=4, d=6, N=30)
            m = tr.fit(tr.triangle(z, y))
            fused = fd.fuse(hull(gen, Theta, 0.5, off), m)
            models = [m.H, fd.shrunken(fused, 1.0).model, fd.shrunken(fused).model]
            risks.append([np.sum(((H - Theta) @ m.root.T) ** 2) for H in models])
        mean = np.mean(risks, axis=0)
        assert np.all(mean[1:] <= gain * mean[0])


def stopped(gen, sigma=0.1, tolerance=0.15):
    """Feedback exploration until the certificate is below the tolerance; its true error."""
    A, B = stable(gen, n=2, m=1, size=0.8)
    Theta = np.hstack([A, B])
    z = np.array([0.5, -0.5, 0.3])
    xf = Theta @ z
    data, x = None, np.zeros(2)
    for N in range(1, 401):
        u = np.array([-0.2 * x[0] + gen.standard_normal()])
        pair = np.concatenate([x, u])
        x = Theta @ pair + sigma * gen.standard_normal(2)
        data = tr.triangle(pair[None], x[None]) if data is None else tr.update(data, pair, x)
        if N % 20 == 0:
            u = np.linalg.lstsq(tr.fit(data).H[:, 2:], xf - tr.fit(data).H[:, :2] @ z[:2])[0]
            point = np.concatenate([z[:2], u])
            found = at.look(data, point, xf, sigma, DELTA, tolerance, LAMS)
            if found.certificate <= tolerance:
                return N, np.linalg.norm(Theta @ point - xf)
    return 400, 0.0


def test_stopping_by_the_certificate_is_valid():
    gen = np.random.default_rng(44)
    found = np.array([stopped(gen) for _ in range(60)])
    at_most(np.sum(found[:, 1] > 0.15), 60)
    assert np.median(found[:, 0]) < 400
    check(at.look_shares(2000, DELTA).sum(), DELTA * (1 - 1 / 2001))


def test_coverage_of_the_correction_from_a_second_half():
    """For noise sigma^2 I the first-order correction has an exact ball; here the last direction."""
    gen, runs, failed = np.random.default_rng(45), 500, 0
    for _ in range(runs):
        Theta, first, x0, u = k_step_case(gen, 3, N=40)
        model = tr.fit(first)
        z = gen.standard_normal((40, 6))
        y = z @ Theta.T + 0.1 * gen.standard_normal((40, 4))
        split = cc.split_correction(model, z, y, x0, u, DELTA)
        x, exact = x0, np.zeros(4)
        for step in u:
            zh = np.concatenate([x, step])
            exact = model.H[:, :4] @ exact + (Theta - model.H) @ zh
            x = model.H @ zh
        failed += np.linalg.norm(split.correction - exact) > split.radius
    at_most(failed, runs)


def test_error_of_the_input_holds():
    gen, runs, failed, finite = np.random.default_rng(46), 400, 0, 0
    for _ in range(runs):
        Theta, data, x0, _ = k_step_case(gen, 1)
        region = rg.full(data, DELTA)
        H, xf = region.fitted.H, gen.standard_normal(4)
        u = np.linalg.lstsq(H[:, 4:], xf - H[:, :4] @ x0)[0] + gen.normal(0, 0.1, 2)
        v = np.linalg.lstsq(Theta[:, 4:], xf - Theta[:, :4] @ x0)[0]
        limit = ie.input_bound(region, x0, u, xf)
        finite += np.isfinite(limit)
        failed += np.linalg.norm(u - v) > limit
    at_most(failed, runs)
    assert finite > runs / 2


def test_bounds_of_separate_estimates_hold():
    gen = np.random.default_rng(47)
    for _ in range(300):
        A, B, x0, xf = (gen.standard_normal(s) for s in ((3, 3), (3, 2), 3, 3))
        dA, dB, d0_, df = (0.3 * gen.standard_normal(s) for s in ((3, 3), (3, 2), 3, 3))
        u = gen.standard_normal(2)
        norm = np.linalg.norm
        limit = ie.separate_bound(
            A + dA,
            B + dB,
            x0 + d0_,
            xf + df,
            u,
            eA=norm(dA, 2),
            eB=norm(dB, 2),
            e0=norm(d0_),
            ef=norm(df),
        )
        assert norm(A @ x0 + B @ u - xf) <= limit + 1e-12


def test_limits_of_bounded_noise_are_certain():
    gen = np.random.default_rng(48)
    for _ in range(20):
        theta, z = gen.standard_normal(3), gen.standard_normal((15, 3))
        y = z @ theta + gen.uniform(-0.2, 0.2, 15)
        point = gen.standard_normal(3)
        low, high = signs.bounded_range(z, y, 0.2, point)
        assert low <= theta @ point <= high
    with pytest.raises(ValueError, match="no theta"):
        signs.bounded_range(z, y, 1e-4, point)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_one_sub_gaussian_noise(n):
    gen = np.random.default_rng(49)
    r = at.one_noise(n, DELTA)
    if n == 1:  # two tails: cosh(s r) exp(-s^2/2) against exp(s r - s^2/2) / 2
        assert abs(r - np.sqrt(2 * np.log(2 / DELTA))) < 1e-3
    ball = gen.standard_normal((100_000, n))
    at_most(np.sum(np.linalg.norm(ball, axis=1) > r), 100_000)
    assert (
        np.sqrt(laws.chi2_upper(DELTA, n)) < r < np.sqrt(n) + np.sqrt(2 * np.log(1 / DELTA)) + 0.1
    )


# -- anti-tests: with an assumption broken the coverage is visibly below the level -----------------


def coverage(misses_, runs):
    return 1.0 - misses_ / runs


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


def test_an_exact_region_must_not_be_looked_at_after_every_pair():
    gen, runs, failed = np.random.default_rng(65), 60, 0
    for _ in range(runs):
        Theta, z, y = independent(gen, n=2, d=3, N=200)
        data = tr.triangle(z[:7], y[:7])
        for t in range(7, 200):
            data = tr.update(data, z[t], y[t])
            if not rg.contains(rg.full(data, DELTA), Theta):
                failed += 1
                break
    assert coverage(failed, runs) < 0.75


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


def test_noise_enters_every_step_of_the_first_order():
    """sqrt(1 + ||c||^2): one step of the recursion is the bound of one noisy step."""
    q = qu.roy_quantile(2, 4, 9, DELTA)
    steps = cc.several_steps(FIT, POINT[:2], [POINT[2:]], spectral=np.sqrt(q), noise=True)
    check(steps.radii[1], 1.173596784293)


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
