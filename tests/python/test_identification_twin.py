"""Identification in plain NumPy: the formulas against known numbers."""

from __future__ import annotations

import numpy as np

from identification_data import POINT, Y, Z, check
from twin import anytime as at
from twin import laws
from twin import quantiles as qu
from twin import regions as rg
from twin import triangle as tr

DATA = tr.triangle(Z, Y)


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


def test_limits_of_a_noncentrality():
    check(laws.noncentrality_limit(32, 32, 0.025), 21.445789230634)
    check(laws.noncentrality_limit(150, 147, 0.025), 43.023665602840)
    check(laws.noncentrality_limit(10, 5, 0.05), 18.117739807813)
    assert laws.noncentrality_limit(0.1, 32, 0.025) == 0.0
