"""Identification in plain NumPy: the formulas against known numbers."""

from __future__ import annotations

import numpy as np

from coverage_study import DELTA
from identification_data import POINT, THETA, Y, Z, check
from twin import anytime as at
from twin import certified_control as cc
from twin import fusing_by_data as fd
from twin import laws
from twin import quantiles as qu
from twin import regions as rg
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


def test_bounds_at_a_point():
    check(tr.length(FIT, POINT), 0.178749950455)
    region = rg.full(DATA, DELTA)
    check(rg.bound(region, POINT), 0.185505135251)
    check(rg.component_bounds(region, POINT)[0], 0.184570037684)
    check(rg.bound(rg.scalar(DATA, DELTA), POINT), 0.111280959627)
    noisy = cc.one_noisy_step(rg.full(DATA, DELTA, future=1), POINT[:2], POINT[2:], np.zeros(2))
    check(noisy.model, 1.173596784293)
    check(qu.roy_quantile(2, 4, 9, 0.05), 2.915655205842)


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


def test_regions_of_unknown_covariance():
    a = laws.chi2_quantile(0.01, 50)
    check([a, 4 / (a - 4)], [29.706682698841, 0.155601562709])
    check(at.universal(DATA, 0.05, l0=1.0, psi=1.0, nu0=4.0).factor, 2246.2010650656)


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
