"""Models fused by data: twin and oracles, coverage of their regions, risks, and what is refused.

Coverage is judged as `identification_data` says: failures of a conservative statement at most the
quantile of the binomial law.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import stochens_rs as se
from core_regions import region_errors
from coverage_study import DELTA, at_most, coverage, most, sets
from declarations import opts
from identification_data import SKEWED, Y, Z, check, hull, independent, tuned
from stochens_rs import _core
from stochens_rs.exceptions import DataWarning, InputError
from stochens_rs.fusion import Alse
from twin import fusing_by_data as fd
from twin import laws
from twin import triangle as tr

pytestmark = pytest.mark.usefixtures("noise_by_formula")

MODELS = np.array([[[1.0, 0.2, 0.0], [-0.1, 0.8, 1.0]], [[0.8, 0.2, 0.0], [-0.1, 0.7, 1.0]]])


def ensemble(models, centre=None, offset=False):
    models = np.asarray(models)
    n, c = models.shape[1], None
    if offset:
        models, c = models[:, :, :-1], models[:, :, -1]
    return se.SystemEnsemble(models[:, :, :n], models[:, :, n:], c, centre=centre)


def model(**options):
    """Of data by formulas, whose outcomes repeat."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return se.identify(pairs(Z, Y), **opts(**options))


def pairs(z, y, offset=False):
    n = y.shape[1]
    return se.Trajectories.from_pairs(z[:, :n], z[:, n : z.shape[1] - offset], y)


def declared(z, y, sigma=None, offset=False, **words):
    words = {"design": "independent", "covariance": "scalar", **words}
    return se.identify(
        pairs(z, y, offset), **opts(sigma=sigma, intercept=offset, checks=False, **words)
    )


def fused_by(models, z, y, sigma=None, offset=False, method="alse"):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        data = declared(z, y, sigma, offset)
        return se.fuse(ensemble(models, offset=offset), method, data=data)


def Theta_of(model):
    return np.hstack([model.A, model.B, *([] if model.c is None else [model.c[:, None]])])


def error_of(region, model, Theta):
    """``||S^-1/2 (Theta - C) V^1/2||_F``, which the Frobenius radius of the region bounds."""
    root = model.least_squares.blocks[0].root
    L = np.linalg.cholesky(region.parts[0].S)
    return np.linalg.norm(np.linalg.solve(L, (Theta - region.centre) @ root.T))


def contains(region, Theta, n, m):
    c = Theta[:, n + m] if Theta.shape[1] > n + m else None
    return region.contains(Theta[:, :n], Theta[:, n : n + m], c)


# --- twin and oracles -----------------------------------------------------------------------------


def test_oracle():
    data = se.fuse(ensemble(MODELS), Alse(tol=1e-15), data=declared(Z, Y, 0.2))
    check(data.weights[0], 0.611012433393, rtol=1e-7)
    check(data.distance**2, 0.590027987076 / 0.04)
    check(1.0 - 3.0 / data.distance**2, 0.796619816977)  # the constant p - face - 2
    check(data.share, 1.0 - 1.5 * (1.0 - 0.796619816977))  # chi2 of 5 degrees is larger
    # one part of the region, in units of sigma
    check(0.04 * _core.hull_radius(data._hull, data._noise, 0.05, 0), 1.349148050135, rtol=1e-7)


CASES = {
    "plain": {},
    "few pairs": {"N": 4},
    "offset": {"offset": True},
    "one model": {"M": 1},
    "many models": {"M": 30, "n": 2, "d": 3},
    "noise known": {"sigma": 0.7},
    "few pairs, noise known": {"sigma": 0.7, "N": 3},
}


@pytest.mark.parametrize("case", CASES)
def test_equal_to_the_reference(case):
    o = {"n": 4, "d": 6, "N": 30, "M": 5, "sigma": None, "offset": False, **CASES[case]}
    gen, sigma = np.random.default_rng(5), o["sigma"]
    Theta, z, y = independent(gen, n=o["n"], d=o["d"], N=o["N"])
    if o["offset"]:
        y, z = y + 1.0 - z[:, -1:] @ Theta[:, -1:].T, z.copy()
        z[:, -1] = 1.0
    models = hull(gen, Theta, 0.5, 0.3, M=o["M"])
    ours = fused_by(models, z, y, sigma, o["offset"], Alse(tol=1e-15))
    twin = fd.fuse(models, tr.fit(tr.triangle(z, y)))
    unit = 1.0 if sigma is None else sigma
    check(ours.weights, twin.weights, rtol=1e-5, atol=1e-6)
    check(ours.distance * unit, np.sqrt(twin.distance2), rtol=1e-8)
    shrunk = fd.shrunken(twin, sigma, rule="tested")
    check(ours.share, shrunk.share, rtol=1e-6, atol=1e-9)
    check(Theta_of(ours), shrunk.model, rtol=1e-5, atol=1e-6)
    h = ours._hull
    assert (h.k, h.face, h.p) == (twin.k, twin.face, twin.p)
    region = ours._ball(DELTA, frobenius=True)
    f = twin.fitted
    # least squares: ||.||_F^2 is at most the rank times the largest root
    own = min(o["n"], f.rank) * ours.least_squares.region(DELTA / 2).parts[0].factor
    if sigma is None:
        own *= np.trace(f.S)
        near = fd.certificate_unknown(twin, DELTA / 2, cells=sets(400, 100)).factor
    else:
        own *= sigma**2
        near = fd.certificate(twin, sigma, DELTA / 2).factor
    if np.isinf(near):
        assert np.isinf(region.radius)
    else:
        radius2 = fd.between(near, own, np.sqrt(twin.distance2), shrunk.share)
        check(region.radius**2, radius2, rtol=1e-6 if sigma else sets(6e-3, 2.5e-2))
    assert region.frobenius * unit == pytest.approx(region.radius)
    assert bool(region.missing) == (o["N"] < o["d"])


def test_a_known_covariance_is_a_change_of_units():
    gen = np.random.default_rng(6)
    Theta, z, y = independent(gen, root=SKEWED)
    models = hull(gen, Theta, 0.5)
    Sigma = SKEWED @ SKEWED.T
    words = {"design": "independent", "checks": False}
    ours = se.fuse(
        ensemble(models), "alse", data=se.identify(pairs(z, y), **opts(covariance=Sigma, **words))
    )
    L = np.linalg.cholesky(Sigma)
    white = fd.fuse(np.linalg.solve(L, models), tr.fit(tr.triangle(z, np.linalg.solve(L, y.T).T)))
    check(ours.weights, white.weights, rtol=1e-4, atol=1e-5)
    check(ours.distance**2, white.distance2, rtol=1e-8)
    assert ours.region(DELTA).contains(Theta[:, :4], Theta[:, 4:])


# --- coverage -------------------------------------------------------------------------------------


def sparse(gen):
    """A model with zero columns, a state that is hardly ever excited, and 60 pairs."""
    Theta = np.where(gen.random((3, 5)) < 0.5, 0.0, 1.0)
    Theta[:, 2] = 0.0
    z = gen.standard_normal((60, 5)) * [1.0, 1e-3, 1.0, 10.0, 1.0]
    return Theta, z, z @ Theta.T + gen.standard_normal((60, 3))


def dependent(gen):
    """Fewer directions than states and inputs: the last input repeats the first state."""
    Theta, z, _ = independent(gen, n=3, d=5, N=40)
    z[:, 4] = 2.0 * z[:, 0]
    return Theta, z, z @ Theta.T + gen.standard_normal((40, 3))


SYSTEMS = {
    "plain": lambda gen: independent(gen, N=30),
    "sparse": sparse,
    "dependent": dependent,
    "one state": lambda gen: independent(gen, n=1, d=2, N=8),
    "fewer pairs": lambda gen: independent(gen, n=4, d=8, N=6),
}


@pytest.mark.parametrize("system", SYSTEMS)
def test_regions_hold(system):
    """240 runs, in `make test` 24: hulls with the truth and beside it; sigma known or not."""
    gen, runs = np.random.default_rng(71), sets(240, 24)
    failed, sizes = np.zeros(4, dtype=int), []
    for off in np.tile([0.0, 0.3, 30.0], runs // 3):
        Theta, z, y = SYSTEMS[system](gen)
        models = hull(gen, Theta, 0.5, off)
        n, m = len(Theta), Theta.shape[1] - len(Theta)
        for place, sigma in ((0, 1.0), (2, None)):
            fused = fused_by(models, z, y, sigma)
            regions = fused.regions(DELTA)  # `region` is the first, or least squares
            failed[place] += not all(contains(one, Theta, n, m) for one in regions)
            regions = fused.regions(DELTA, frobenius=True)
            failed[place + 1] += any(error_of(r, fused, Theta) > r.frobenius for r in regions)
            if sigma and off == 0.0:
                sizes.append(fused._ball(DELTA, frobenius=True).frobenius)
    for count in failed:
        at_most(count, runs)
    if system == "plain":  # sharper than least squares: chi with 24 degrees
        assert np.median(sizes) < np.sqrt(laws.chi2_upper(DELTA, 24))


def mixed(seed, ratio, alike, off=0.0):
    """Correlated noise of 5 states in units that reach from 1 to `ratio`: truth, models, data."""
    gen, n = np.random.default_rng(seed), 5
    T = np.geomspace(1.0, ratio, n)
    back = np.concatenate([1.0 / T, np.ones(2)])
    Theta, z, _ = independent(gen, n=n, d=n + 2, N=24)
    models = hull(gen, Theta, 0.5, off, M=4)
    noise = gen.standard_normal((24, n)) @ np.linalg.cholesky(1 - alike + alike * np.eye(n)).T
    y = (z @ Theta.T + noise) * T
    return T[:, None] * Theta * back, T[:, None] * models * back, z / back, y


@pytest.mark.parametrize("alike", [1.0, 0.02])
@pytest.mark.parametrize("off", [0.0, 1.0])
def test_regions_of_noise_that_nothing_is_declared_of_hold(alike, off):
    """The same in all units, and false alarms of "no mixture" at 1 % at most."""
    runs, failed, alarms = sets(150, 20), 0, 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        for seed in range(runs):
            found = []
            for ratio in (1.0, 1e5):
                Theta, models, z, y = mixed([75, seed], ratio, alike, off)
                data = pairs(z, y)
                fused = se.fuse(
                    ensemble(models), "alse", data=data, noise=se.Noise(design="independent")
                )
                found.append((contains(fused.region(DELTA), Theta, 5, 2), fused))
            (inside, one), (also, other) = found
            assert (inside, one.explained) == (also, other.explained)
            check(one.weights, other.weights, atol=1e-5, rtol=1e-4)
            check(one.share, other.share, atol=1e-6, rtol=1e-5)
            failed += not inside
            alarms += off == 0.0 and one.explained is False
    at_most(failed, runs)
    assert alarms <= most(runs, 0.01)


def test_a_state_without_noise_is_explained():
    """60 runs, of which the mixtures of 9 models of 10 entries contain the truth."""
    alarms = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        for seed in range(60):
            gen = np.random.default_rng([77, seed])
            Theta, z, _ = independent(gen, n=2, d=5, N=60)
            z[:, 4] = 1.0
            y = z @ Theta.T + 0.01 * gen.standard_normal((60, 2)) * [0.0, 1.0]
            models = hull(gen, Theta, 0.5, 0.0, M=9)
            data = declared(z, y, offset=True, covariance="full")
            alarms += se.fuse(ensemble(models, offset=True), "alse", data=data).explained is False
    assert alarms <= 4  # P(Binomial(60, 0.01) > 4) < 4e-4


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
def test_a_single_state_without_noise_is_explained():
    """Exact mixtures in fractions of 8 and 32: what is off the hull is rounding."""
    for seed in range(sets(200, 60)):
        gen = np.random.default_rng([78, seed])
        models = gen.integers(-8, 9, (2, 1, 2)) / 8.0
        share = gen.integers(0, 5) / 4.0
        Theta = share * models[0] + (1.0 - share) * models[1]
        z = gen.integers(-16, 17, (20, 2)) / 8.0
        data = pairs(z, z @ Theta.T)
        fused = se.fuse(ensemble(models), "alse", data=data, noise=se.Noise(design="independent"))
        assert fused.explained is not False


def test_noise_that_is_wrongly_declared_a_multiple_of_one_matrix_breaks_the_region():
    """States in units 1 to 100: the declaration is the user's, and it is named."""
    failed, runs = 0, sets(100, 30)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        for seed in range(runs):
            Theta, models, z, y = mixed([76, seed], 100.0, 1.0)
            fused = se.fuse(ensemble(models), "alse", data=declared(z, y))
            region = fused.region(DELTA)
            assert "sigma^2 I" in region.assumption
            failed += not contains(region, Theta, 5, 2)
    assert failed > 0.4 * runs


def test_regions_with_noise_to_come_hold():
    gen, runs, failed = np.random.default_rng(72), sets(250, 60), np.zeros(2, dtype=int)
    for k in range(runs):
        Theta, z, y = independent(gen, N=30)
        fused = fused_by(hull(gen, Theta, 0.5, 0.3 * (k % 2)), z, y, 1.0 if k % 3 else None)
        root, later = fused.least_squares.blocks[0].root, gen.standard_normal((4, 3))
        wrong = [False, False]
        for i, frobenius in enumerate((False, True)):
            for one in fused.regions(DELTA, future=3, frobenius=frobenius):
                both = np.hstack([(Theta - one.centre) @ root.T, later])
                wrong[i] |= np.linalg.norm(both, 2) > one.radius
                if frobenius:
                    size = np.linalg.norm(both) / np.sqrt(one.parts[0].S[0, 0])
                    wrong[i] |= size > one.frobenius
        failed += wrong
    for count in failed:
        at_most(count, runs)


def test_regions_in_closed_loop_hold():
    """Feedback tuned by the noise: the region is that of least squares."""
    gen, runs, failed = np.random.default_rng(73), sets(100, 40), 0
    for _ in range(runs):
        Theta, run = tuned(gen, 60)
        models = ensemble(hull(gen, Theta, 0.3, 0.1))
        data = se.Trajectories(*run)
        with pytest.warns(DataWarning):
            fused = se.fuse(models, "alse", data=data, noise=se.Noise(sigma=1.0))
        cure = "that of least squares, without the models; declare Noise("
        assert any(cure in text for text in fused.warnings)
        region = fused.region(DELTA)
        failed += not region.contains(Theta[:, :2], Theta[:, 2:])
        assert region.radius == fused.least_squares.region(DELTA).radius
    at_most(failed, runs)


@pytest.mark.parametrize("sigma", [1.0, None])
def test_the_region_is_no_wider_than_that_of_least_squares(sigma):
    """Twelve cells; where the ball may be smaller both have half of delta: at most 9 % wider."""
    gen, narrower = np.random.default_rng(78), 0
    for n, d, N, M in ((2, 3, 12, 3), (4, 6, 30, 5), (6, 8, 60, 4), (12, 14, 80, 2)):
        for off in (0.0, 0.3, 3.0):
            Theta, z, y = independent(gen, n=n, d=d, N=N)
            fused = fused_by(hull(gen, Theta, 0.5, off, M=M), z, y, sigma)
            region, own = fused.region(DELTA), fused.least_squares.region(DELTA)
            shared = fused._sharper(DELTA, 0)
            assert region.delta == DELTA
            assert region.radius <= own.radius * (1.09 if shared else 1.0)
            narrower += region.radius < own.radius
            is_own = np.array_equal(region.centre, own.centre)
            assert is_own == ("the region of least squares" in region.assumption)
            first, second = fused.regions(DELTA)
            assert first.radius <= second.radius
            # a plan has the smaller target of both, with noise as well
            plan = se.control(fused, gen.standard_normal(n), np.zeros(n), steps=3)
            found = [
                region_errors(one, plan.basis.x0, plan.u, rho0=0.0)
                for one in fused.regions(DELTA, frobenius=True)
            ]
            targets = [np.linalg.norm(e.states[-1]) + e.radii[-1] for e in found]
            assert plan.bound().target == pytest.approx(min(targets))
            assert np.isfinite(plan.bound(noise=True).target)
    assert narrower >= 1 or sigma is None


def test_models_of_the_same_data_break_the_region_and_are_refused():
    """Least squares among the models: the hull looks right whatever the truth is."""
    gen, runs, failed = np.random.default_rng(75), sets(100, 30), 0
    for _ in range(runs):
        Theta, z, y = independent(gen, N=30)
        own = declared(z, y, 1.0)
        others = hull(gen, Theta, 0.5, 3.0, M=2)
        fused = fused_by([Theta_of(own), *others], z, y, 1.0)
        ball = fused._ball(DELTA, frobenius=True)
        failed += error_of(ball, fused, Theta) > ball.frobenius
        with pytest.raises(InputError, match=r"ensemble\[0\]` was fitted on pairs of `data`"):
            se.fuse([own, *((T[:, :4], T[:, 4:]) for T in others)], "alse", data=own)
    assert coverage(failed, runs) < 0.1


# --- risks ----------------------------------------------------------------------------------------


RISKS = {  # n, d, N, M, off, and the largest ratio of the risks
    "right hull": (4, 6, 30, 4, 0.0, 0.3),
    "off": (4, 6, 30, 4, 0.3, 0.85),
    "far": (4, 6, 30, 4, 30.0, 1.002),
    "more models than directions": (2, 3, 20, 9, 0.0, 0.9),
    "small": (1, 4, 12, 2, 0.3, 1.0),
}


@pytest.mark.parametrize("sigma", [1.0, None])
@pytest.mark.parametrize("case", RISKS)
def test_mean_square_error_is_below_that_of_least_squares(case, sigma):
    """400 runs each, in `make test` 60 where that is enough: mean of ||(Theta - .) V^1/2||_F^2."""
    n, d, N, M, off, largest = RISKS[case]
    gen, risks = np.random.default_rng(76), []
    for _ in range(sets(400, 400 if case == "off" else 60)):
        Theta, z, y = independent(gen, n=n, d=d, N=N)
        fused = fused_by(hull(gen, Theta, 0.5, off, M=M), z, y, sigma)
        root = fused.least_squares.blocks[0].root
        both = fused, fused.least_squares
        risks.append([np.sum(((Theta_of(one) - Theta) @ root.T) ** 2) for one in both])
    ours, least = np.mean(risks, axis=0)
    assert ours <= largest * least


# --- what it says ---------------------------------------------------------------------------------


def test_a_point_between_is_where_the_weights_say():
    fused = se.fuse(ensemble(MODELS), "alse", data=declared(Z, Y, 0.2))
    F = np.tensordot(fused.weights, MODELS, axes=1)
    H = Theta_of(fused.least_squares)
    check(Theta_of(fused), F + fused.share * (H - F), rtol=1e-10)
    alone = se.fuse(ensemble(MODELS), "alse", data=declared(Z, Y, 0.2), shrink=False)
    assert alone.share == 0.0
    check(Theta_of(alone), F, rtol=1e-10)


def test_no_mixture_explains_the_data():
    gen = np.random.default_rng(8)
    Theta, z, y = independent(gen, N=30)
    for sigma in (1.0, None):
        with pytest.warns(DataWarning, match=r"^no mixture of the models explains the data$"):
            fused = se.fuse(
                ensemble(hull(gen, Theta, 0.1, 3.0)), "alse", data=declared(z, y, sigma)
            )
        assert fused.explained is False
        assert fused.share > 0.9


def test_level_of_the_warning():
    """500 right hulls, in `make test` 80: false alarms at 1 %."""
    gen, alarms, runs = np.random.default_rng(77), np.zeros(2, dtype=int), sets(500, 80)
    for _ in range(runs):
        Theta, z, y = independent(gen, n=2, d=3, N=12)
        alarms += [fused_by(hull(gen, Theta, 0.5), z, y, s).explained is False for s in (1.0, None)]
    assert np.all(alarms <= most(runs, 0.01))


def test_data_that_do_not_determine_the_model():
    gen = np.random.default_rng(9)
    Theta, z, y = independent(gen, n=3, d=5, N=3)
    models = hull(gen, Theta, 0.2)
    fused = fused_by(models, z, y, 1.0)
    region = fused.region(DELTA)
    assert len(region.missing) == 2
    inside, outside = z[0], gen.standard_normal(5)
    assert region.bound(inside[:3], inside[3:]) < np.inf
    assert region.bound(outside[:3], outside[3:]) == np.inf
    f = fused.least_squares.blocks[0]
    null = np.linalg.svd(z)[2][3:].T  # there the model is that of the mixture
    V = np.tensordot(fused.weights, models, axes=1)
    change = Theta_of(fused) - V
    check(change @ np.linalg.pinv(f.white @ np.eye(5)) @ f.white, change, atol=1e-10)
    assert null.shape == (5, 2)


def test_few_pairs_for_many_weights():
    gen = np.random.default_rng(10)
    Theta, z, y = independent(gen, n=3, d=5, N=3)
    with pytest.warns(DataWarning):
        fused = se.fuse(ensemble(hull(gen, Theta, 0.2, M=8)), "alse", data=declared(z, y))
    assert any("3 pairs for 7 free weights" in text for text in fused.warnings)
    assert any("too few pairs to estimate the noise" in text for text in fused.warnings)
    assert fused.share == 0.0
    assert fused.region(DELTA).radius == np.inf


def test_exact_data_inside_the_hull():
    data = pairs(Z, Z @ (MODELS.mean(axis=0)).T)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        fused = se.fuse(ensemble(MODELS), "alse", data=data, noise=se.Noise(design="independent"))
    check(Theta_of(fused), MODELS.mean(axis=0), atol=1e-6)
    assert fused.region(DELTA).radius < 1e-4


def test_offsets():
    x, u, w = np.random.default_rng(3).standard_normal((3, 30, 1))
    data = se.Trajectories.from_pairs(x, u, 0.8 * x + u + 2.0 + 0.1 * w)
    models = se.SystemEnsemble([[[0.9]], [[0.7]]], [[[1.0]], [[1.0]]], [[1.9], [2.1]])
    fused = se.fuse(models, "alse", data=data, noise=se.Noise(design="independent", sigma=0.1))
    assert fused.c == pytest.approx([2.0], abs=0.1)
    assert fused.region(DELTA).contains([[0.8]], [[1.0]], [2.0])
    with pytest.raises(InputError, match=r"must be a model with intercept"):
        se.fuse(models, "alse", data=se.identify(data, checks=False, noise=se.Noise(sigma=0.1)))


# --- what is refused ------------------------------------------------------------------------------


def some(seed=1, n=2, m=1, N=12, names=None):
    gen = np.random.default_rng(seed)
    z = gen.standard_normal((N, n + m))
    y = z @ gen.standard_normal((n + m, n)) + 0.1 * gen.standard_normal((N, n))
    return se.Trajectories.from_pairs(z[:, :n], z[:, n:], y, state_names=names)


def test_pairs_are_the_same_under_names_in_another_order():
    gen = np.random.default_rng(5)
    x, u = gen.standard_normal((31, 2)), gen.standard_normal((31, 2))
    table = {"p": x[:, 0], "v": x[:, 1], "F": u[:, 0], "G": u[:, 1]}
    own, turned = (
        se.Trajectories.from_table(table, states=states, inputs=inputs, dt=0.1)
        for states, inputs in ((["p", "v"], ["F", "G"]), (["v", "p"], ["G", "F"]))
    )
    model, exact = se.identify(own), se.System(np.eye(2), np.eye(2), dt=0.1)
    with pytest.raises(InputError, match=r"ensemble\[1\]` was fitted on pairs of `data`"):
        se.fuse([exact, model], "alse", data=turned)
    # in another unit and back, 1 / 3 is no longer 1 / 3
    again = {name: values * 1.1 / 1.1 for name, values in table.items()}
    again = se.Trajectories.from_table(again, states=["p", "v"], inputs=["F", "G"], dt=0.1)
    with pytest.raises(InputError, match=r"ensemble\[0\]` was fitted on pairs of `data`"):
        se.fuse([model, exact], "alse", data=again)
    other = {name: values[::-1] + 1.0 for name, values in table.items()}
    other = se.Trajectories.from_table(other, states=["v", "p"], inputs=["G", "F"], dt=0.1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        assert se.fuse([model, exact], "alse", data=other).models.size == 2


def test_models_about_an_estimate_are_refused_unless_declared():
    own = se.identify(some())
    cloud = own.draw(5, rng=1)
    with pytest.raises(InputError, match=r"scatters about an estimate from data.*independent=True"):
        se.fuse(cloud, "alse", data=some(2), noise=se.Noise(design="independent"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)
        fused = se.fuse(
            cloud, "alse", data=some(2), independent=True, noise=se.Noise(design="independent")
        )
        assert fused.models.size == 5
        other = se.fuse(
            [own, se.identify(some(3))], "alse", data=some(2), noise=se.Noise(design="independent")
        )
        with pytest.raises(InputError, match=r"`ensemble\[1\]` was fitted on pairs"):
            se.fuse(
                [own, other], "alse", data=[some(2), some(4)], noise=se.Noise(design="independent")
            )


@pytest.mark.parametrize("more", [{}, {"method": "uniform"}, {"target": [1.0]}])
def test_readings_weigh_no_models_and_this_is_said_before_anything_else(more):
    rng = np.random.default_rng(1)
    log = se.Trajectories(rng.standard_normal((61, 1)), rng.standard_normal((60, 1)), outputs=True)
    for data in (log, [log], se.identify(log, checks=False)):
        with pytest.raises(InputError, match="`data` must have states, got readings"):
            se.fuse(["no model"], **({"method": "alse"} | more), data=data)
