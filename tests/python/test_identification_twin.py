"""Identification in plain NumPy: the formulas against known numbers and each other."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from coverage_study import ALARM, DELTA, exactly
from identification_data import LAMS, POINT, THETA, Y, Z, check, independent
from twin import anytime as at
from twin import certified_control as cc
from twin import fusing_by_data as fd
from twin import input_error as ie
from twin import laws
from twin import polynomial_roots as pr
from twin import quantiles as qu
from twin import regions as rg
from twin import resampling as rs
from twin import triangle as tr

DATA = tr.triangle(Z, Y)
FIT = tr.fit(DATA)


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


def test_a_region_for_directions_knows_no_other():
    """x0 fixed beforehand, u free: z in the span of (x0, 0) and (0, 1)."""
    Q = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]])
    region = rg.directions(DATA, Q, DELTA)
    check(region.factor, qu.roy_quantile(2, 2, 9, DELTA))
    assert rg.bound(region, POINT) < rg.bound(rg.full(DATA, DELTA), POINT)
    assert rg.bound(region, [1.0, -1.01, 0.5]) == np.inf
    step = cc.one_step(region, POINT[:2], POINT[2:], np.zeros(2))
    assert step.certificate == step.reach + step.model < np.inf
    assert cc.one_step(region, POINT[:2], POINT[2:], np.zeros(2), rho0=0.1).start == np.inf


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


def test_a_mean_of_mixtures_is_sharper_than_the_best_of_them():
    single = [at.least_squares_level(DATA, DELTA / len(LAMS), [lam]) for lam in LAMS]
    together = at.least_squares_level(DATA, DELTA, LAMS)
    assert at.least_squares_level(DATA, DELTA, [4.0]) < together * 1.2
    assert together < min(single)
    check(
        at.least_squares_level(DATA, DELTA, [4.0, 4.0]), at.least_squares_level(DATA, DELTA, [4.0])
    )


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


def steps_of_the_data_set(**options):
    u = [[0.5], [0.0], [-0.5]]
    return cc.several_steps(FIT, [1.0, -1.0], u, spectral=np.sqrt(1.2), **options)


def test_several_steps():
    steps = steps_of_the_data_set(frobenius=np.sqrt(1.5))
    check(steps.states[3], [0.491473192146, -0.693577119257])
    check(steps.sizes, [0.178749950455, 0.085974974573, 0.086239745577])
    # nuclear norms: 6 % below the weighted inequality
    root = np.linalg.cholesky(1.2 * FIT.S)
    back = [np.linalg.matrix_power(FIT.H[:, :2], p) @ root for p in (2, 1, 0)]
    check(cc.weighted_cauchy_schwarz(back, steps.sizes), 0.236959828427)
    assert 0.94 * 0.236959828427 < steps.linear[3] < 0.95 * 0.236959828427
    check(steps.rest[1], 0.012958575976, rtol=3e-11)
    assert (steps.rest <= np.array([0.0, 0.012958575977, 0.019349802408, 0.025776650887])).all()
    assert 0.93 * 0.260230790267 < steps.radii[3] < 0.95 * 0.260230790267
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


def test_leverages_give_the_residual_of_a_fit_without_the_pair():
    own = tr.residuals(Z, Y) / (1 - tr.leverages(Z))[:, None]
    for t in range(12):
        others = np.arange(12) != t
        H = tr.fit(tr.triangle(Z[others], Y[others])).H
        check(own[t], Y[t] - H @ Z[t], atol=1e-13)


def test_ensembles_from_data():
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
    ]:
        error = models.mean(axis=0) - mean
        assert np.all(np.abs(error) < 5 * models.std(axis=0) / np.sqrt(size))
        if spread is not None:
            scale = np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
            assert np.max(np.abs(covariance(models) - spread) / scale) < 0.05


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


def test_noise_enters_every_step_of_the_first_order():
    """sqrt(1 + ||c||^2): one step of the recursion is the bound of one noisy step."""
    q = qu.roy_quantile(2, 4, 9, DELTA)
    steps = cc.several_steps(FIT, POINT[:2], [POINT[2:]], spectral=np.sqrt(q), noise=True)
    check(steps.radii[1], 1.173596784293)
