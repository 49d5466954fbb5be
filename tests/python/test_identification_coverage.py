"""Every statement about measured data holds as often as it says, by simulation."""

from __future__ import annotations

import numpy as np
import pytest

from coverage_study import DELTA, at_most, exactly, failures, repeated, sets
from identification_data import (
    LAMS,
    RUNS,
    SKEWED,
    check,
    hull,
    independent,
    k_step_case,
    misses,
    rolled,
    stable,
    tuned,
)
from twin import anytime as at
from twin import certified_control as cc
from twin import fusing_by_data as fd
from twin import input_error as ie
from twin import laws
from twin import quantiles as qu
from twin import regions as rg
from twin import residual_tests as rt
from twin import triangle as tr


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
    q_R = qu.roy_quantile(4, 9, 34, DELTA)
    q_T = qu.trace_quantile(4, 9, 34, DELTA)
    both = qu.joint_radii(4, 9, 34, DELTA)

    def failed(gen):
        Theta, z, y = independent(gen, root=root)
        m = tr.fit(tr.triangle(z, y))
        X = np.hstack([(m.H - Theta) @ m.root.T, root @ gen.standard_normal((4, 3))])
        sizes = np.linalg.svd(np.linalg.solve(np.linalg.cholesky(m.S), X), compute_uv=False)
        top, trace = sizes[0] ** 2, np.sum(sizes**2)
        return [
            top > q_R,
            trace > q_T,
            top > both.spectral**2 or trace > both.frobenius**2,
        ]

    exactly(failures(failed, RUNS, 25), RUNS)


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

    at_most(misses(31, RUNS, holds, root=SKEWED), RUNS)


def test_coverage_where_the_data_miss_directions():
    """Rank 3 of 6, also for a region of few pairs: the residual of the missing rows is counted."""
    mix = np.random.default_rng(32).standard_normal((3, 6))

    def failed(gen):
        Theta, z = gen.standard_normal((2, 6)), gen.standard_normal((8, 3)) @ mix
        data = tr.triangle(z, z @ Theta.T + gen.standard_normal((8, 2)))
        region = rg.full(data, DELTA)
        assert region.fitted.rank == 3
        X = (region.fitted.H - Theta) @ region.fitted.root.T
        X = np.linalg.solve(np.linalg.cholesky(region.S), X)
        return np.linalg.norm(X, 2) ** 2 > region.factor

    exactly(failures(failed, RUNS, 33), RUNS)


def test_supermartingale_of_the_sphere_mixture():
    """Its mean is at most 1 at the true Theta, in closed loop, at all N."""

    def value(gen):
        Theta, run = tuned(gen, 12)
        z, y = tr.pairs([run])
        data = tr.triangle(z, y - z @ Theta.T)
        M = at.ridge(data, 1.0, 0.5, 4.0, 0.0).H  # M V_lam^-1
        V = z.T @ z + 4.0 * np.eye(3)
        c = np.linalg.eigvalsh(M @ V @ M.T)[-1] / 2.0
        return {"M": np.exp(laws.log_hyp1f1(0.5, 1.0, c) - at.information(data, 4.0).ld / 2)}

    values = repeated(value, sets(1500, 400), 34)["M"]
    assert np.mean(values) <= 1.0 + 4.0 * np.std(values) / np.sqrt(len(values))
    assert np.mean(values) > 0.3  # not empty


def test_level_of_the_residual_tests():
    runs = sets(600, 150)

    def low(gen):
        _, z, y = independent(gen, n=2, d=3, N=14, root=SKEWED[:2, :2])
        return rt.p_values(z, y, 19, gen) <= 0.0501  # exactly one in twenty

    exactly(failures(low, runs, 35), runs)


def test_regions_for_any_design_hold_at_all_looks():
    """Feedback tuned by past noise, unstable plant, four looks; exogenous regions fail here."""
    runs = sets(100, 30)

    def failed(gen):
        Theta, run = tuned(gen, 150)
        z, y = tr.pairs([run])
        now = np.zeros(3, dtype=bool)
        for N in (8, 20, 60, 150):
            data = tr.triangle(z[:N], y[:N])
            regions = [at.known_noise(data, 1.0, DELTA, LAMS)]
            regions.append(at.universal(data, DELTA, l0=1.0, psi=1.0, nu0=4.0))
            now[:2] |= [not rg.contains(region, Theta) for region in regions]
        last = at.gaussian_noise(data, DELTA, LAMS)
        now[2] = not rg.contains(last, Theta)
        return {"failed": now, "finite": np.isfinite(last.factor)}

    found = repeated(failed, runs, 38)
    assert found["finite"].all()
    at_most(found["failed"].sum(axis=0), runs)


@pytest.mark.parametrize("noise", [False, True])
def test_certificates_of_several_steps_hold(noise):
    runs = sets(150, 40)

    def case(gen):
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
        return {"ratio": steps.radii[-1] / error}

    ratios = repeated(case, runs, 40)["ratio"]
    at_most(np.sum(ratios < 1.0), runs)
    assert 3.0 < np.median(ratios) < 20.0


@pytest.mark.parametrize("off", [0.0, 0.3, 3.0])
def test_certificates_of_models_fused_by_data_hold(off):
    runs = sets(60, 12)

    def case(gen):
        Theta, z, y = independent(gen, n=4, d=6, N=30)
        fused = fd.fuse(hull(gen, Theta, 0.5, off), tr.fit(tr.triangle(z, y)))
        error = np.linalg.norm((fused.F - Theta) @ fused.fitted.root.T)
        known = fd.certificate(fused, 1.0, DELTA)
        unknown = fd.certificate_unknown(fused, DELTA, cells=10)
        factors = np.array([known.factor, unknown.factor])
        return {"failed": error**2 > factors, "size": np.sqrt(factors)}

    found = repeated(case, runs, 42)
    at_most(found["failed"].sum(axis=0), runs)
    if off == 0.0:  # sharper than least squares: chi with 24 degrees
        assert np.median(found["size"], axis=0)[0] < np.sqrt(laws.chi2_upper(DELTA, 24))


def test_shrinking_towards_the_hull_beats_least_squares():
    for off, gain in ((0.0, 0.5), (0.3, 0.9), (30.0, 1.01)):

        def case(gen, off=off):
            Theta, z, y = independent(gen, n=4, d=6, N=30)
            m = tr.fit(tr.triangle(z, y))
            fused = fd.fuse(hull(gen, Theta, 0.5, off), m)
            models = [m.H, fd.shrunken(fused, 1.0).model, fd.shrunken(fused).model]
            return {"risk": [np.sum(((H - Theta) @ m.root.T) ** 2) for H in models]}

        mean = repeated(case, sets(250, 120), 43)["risk"].mean(axis=0)
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
    runs = sets(60, 15)
    found = repeated(lambda gen: dict(zip(("N", "error"), stopped(gen), strict=True)), runs, 44)
    at_most(np.sum(found["error"] > 0.15), runs)
    assert np.median(found["N"]) < 400
    check(at.look_shares(2000, DELTA).sum(), DELTA * (1 - 1 / 2001))


def test_coverage_of_the_correction_from_a_second_half():
    """For noise sigma^2 I the first-order correction has an exact ball; here the last direction."""
    runs = sets(500, 200)

    def failed(gen):
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
        return np.linalg.norm(split.correction - exact) > split.radius

    at_most(failures(failed, runs, 45), runs)


def test_error_of_the_input_holds():
    runs = sets(400, 200)

    def case(gen):
        Theta, data, x0, _ = k_step_case(gen, 1)
        region = rg.full(data, DELTA)
        H, xf = region.fitted.H, gen.standard_normal(4)
        u = np.linalg.lstsq(H[:, 4:], xf - H[:, :4] @ x0)[0] + gen.normal(0, 0.1, 2)
        v = np.linalg.lstsq(Theta[:, 4:], xf - Theta[:, :4] @ x0)[0]
        limit = ie.input_bound(region, x0, u, xf)
        return np.linalg.norm(u - v) > limit, np.isfinite(limit)

    failed, finite = failures(case, runs, 46)
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
