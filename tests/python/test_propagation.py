"""From a region to the error of a plan: the worst case over the region, and Gaussian noise to come.

U1 to U3 are numbers of one small problem (`formula_data`), found by another program. Coverage is
judged as `coverage_study` says.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stochens_rs as se
from core_regions import core_region, region_errors
from coverage_study import DELTA, at_most, coverage, exactly, repeated
from declarations import opts
from hidden_systems import KINDS, NOISES, covariance, drawn, of_each_kind
from stochens_rs import _core
from stochens_rs.certificates import of_model
from stochens_rs.certificates.of_model import GaussianNoise, trajectory
from twin import certified_control as cc
from twin import laws
from twin import triangle as tr
from twin.regions import root_of

# -- known numbers ---------------------------------------------------------------------------------

SIGMA = 0.2


def formula_data():
    """H, T and z of a plan over 3 steps for three runs by integer formulas; T'T = V^-1."""
    Theta = np.array([[0.9, 0.2, 0.0], [-0.1, 0.8, 1.0]])
    H0, seen, out, instruments = np.array([[0.8, 0.1, 0.1], [0.0, 0.9, 0.9]]), [], [], []
    for r in range(3):
        x = start = np.array([((3 * r + 2 * i + 1) ** 2 % 7 - 3) / 2 for i in range(2)])
        for k in range(4):
            u = (2 * r + 1) * (k + 2) ** 2 % 5 - 2
            w = np.array([((i + 3) * (4 * r + k + 2) ** 2 % 13 - 6) / 20 for i in range(2)])
            seen.append([*x, u])
            instruments.append([*start, u])
            x, start = Theta @ seen[-1] + w, H0 @ instruments[-1]
            out.append(x)
    Z, Y, zeta = (np.array(rows).T for rows in (seen, out, instruments))
    Q = zeta.T @ np.linalg.inv(np.linalg.qr(zeta.T)[1])
    T = np.linalg.inv(Z @ Q)
    return Y @ Q @ T, T


H, T = formula_data()
INPUTS = np.array([[0.5], [0.0], [-0.5]])
ROOT, X0 = SIGMA * np.eye(2), np.array([1.0, -1.0])


def steps(spectral, frobenius, to_come=None):
    """States, radii, first order and b_k."""
    fitted = tr.fit(tr.triangle(np.eye(3), np.zeros((3, 2))))._replace(H=H, white=T)
    region, _ = core_region(fitted, ROOT @ ROOT.T, spectral=spectral, frobenius=frobenius)
    found = region.errors(X0, INPUTS, 0.0, to_come)
    return found.states, found.radii, found.linear, found.rest


def plan_terms():
    """M_{K-1-j} and c_j of the plan."""
    at = trajectory(H, X0, INPUTS)
    back = [np.linalg.matrix_power(H[:, :2], p) @ ROOT for p in (2, 1, 0)]
    return back, np.hstack([at[:-1], INPUTS]) @ T.T


def test_noise_to_come_of_the_formula_data():
    """U2; the noise of the run with what the error of the model makes of it is an event apart."""
    A, N, tilted = H[:, :2], np.zeros((2, 2)), T[:, :2]
    seen = []
    for p in range(3):
        power = np.linalg.matrix_power(A, p)
        N = N + SIGMA**2 * power @ power.T
        seen.append(_core.normal_quantile(tilted @ N @ tilted.T, 0.005))
    np.testing.assert_allclose(
        [N[0, 0], N[0, 1], N[1, 1]], [0.107198896721, 0.008722797436, 0.097855065241], rtol=1e-9
    )
    assert _core.normal_quantile(N, 0.04) == pytest.approx(0.813589687566, rel=1e-10)
    np.testing.assert_allclose(seen[:2], [0.201366257721, 0.272533519324], rtol=1e-9)
    plain, noisy = steps(4.0, 5.0), steps(4.0, 5.0, (ROOT, 0.04, 0.005))
    assert plain[3][1] == pytest.approx(0.119780581346, rel=1e-11)
    np.testing.assert_array_equal(noisy[3], plain[3])
    bounds = cc.with_noise(A, ROOT, tilted, SIGMA**2 * np.eye(2), 4.0, 3)
    for k, level in ((1, 0.005), (2, 0.005), (3, 0.04)):
        quantile = _core.normal_quantile(bounds[k], level)
        assert noisy[1][k] - plain[1][k] == pytest.approx(quantile, rel=1e-7)
    assert quantile > 0.813589687566  # that of the model alone
    none = steps(4.0, 5.0, (np.zeros((2, 2)), 0.04, 0.005))
    np.testing.assert_array_equal(none[1], plain[1])


@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_root_of_a_covariance_is_exact_in_the_units_of_each_row(n):
    """Of all kinds of noise, also of states without any, in units far apart; as the plain twin."""
    gen = np.random.default_rng(n)
    for kind in ("correlated", "isotropic", "one_force"):
        sizes = 10.0 ** gen.uniform(-12, 12, n)
        C = np.ascontiguousarray(covariance(kind, gen, n) * sizes * sizes[:, None])
        deviations = np.sqrt(np.diag(C))
        one, twin = _core.covariance_root(C), root_of(C)
        for root in (one, twin):
            off = np.abs(root @ root.T - C)
            assert (off <= 1e-13 * n * deviations * deviations[:, None]).all()
    assert not _core.covariance_root(np.zeros((n, n))).any()


@pytest.mark.parametrize("n", [1, 2, 3, 12])
def test_quantiles_of_normal_vectors(n):
    """The twin; draws, judged as all counts are; far tails."""
    gen, runs = np.random.default_rng(n), 20_000
    for kind in ("correlated", "isotropic", "one_force"):
        C = covariance(kind, gen, n)
        x = np.linalg.norm(gen.standard_normal((runs, n)) @ root_of(C).T, axis=1)
        for delta in (0.5, 0.05, 1e-3):
            found = _core.normal_quantile(C, delta)
            assert found == pytest.approx(laws.normal_quantile(C, delta), rel=1e-7)
            exactly(np.sum(x > found), runs, delta)
    tiny = _core.normal_quantile(np.eye(n), 1e-12)
    assert tiny == pytest.approx(np.sqrt(laws.chi2_upper(1e-12, n)), rel=1e-9)


# -- the twin --------------------------------------------------------------------------------------


@pytest.mark.parametrize("K", [1, 5])
@pytest.mark.parametrize("n", [1, 4])
@pytest.mark.parametrize("noise", ["none", "in the region", "Gaussian"])
def test_the_twin_finds_the_same(n, K, noise):
    gen = np.random.default_rng([n, K])
    Theta, z = gen.standard_normal((n, n + 2)) / np.sqrt(n), gen.standard_normal((40, n + 2))
    fitted = tr.fit(tr.triangle(z, z @ Theta.T + 0.1 * gen.standard_normal((40, n))))
    x0, u = gen.standard_normal(n), gen.standard_normal((K, 2))
    N = covariance("correlated", gen, n)
    to_come = (N, 0.02, 0.003) if noise == "Gaussian" else None
    for spectral, frobenius in ((1.3, np.inf), (1.3, 1.9), (1.0, 1.0)):
        options = {"spectral": spectral, "frobenius": frobenius, "rho0": 0.01}
        twin = cc.several_steps(
            fitted, x0, u, noise=noise == "in the region", to_come=to_come, **options
        )
        radii = {"spectral": spectral, "frobenius": frobenius}
        region, _ = core_region(fitted, fitted.S, noise=noise == "in the region", **radii)
        noisy = None if to_come is None else (root_of(N), *to_come[1:])
        found = region.errors(x0, u, 0.01, noisy)
        both = (found.radii, twin.radii), (found.linear, twin.linear), (found.rest, twin.rest)
        for ours, its in both:
            np.testing.assert_allclose(ours, its, rtol=1e-7)


# -- brute force: nothing in the region is above the bounds ----------------------------------------


def measured(gen, A, B, N=60, scale=0.1, **options):
    """A model from pairs of a system with noise of the size of its states, in their units."""
    n, m = B.shape
    sizes = scale * np.maximum(np.linalg.norm(A, axis=1), np.linalg.norm(B, axis=1))
    sizes[sizes == 0.0] = scale
    z = gen.standard_normal((N, n + m))
    y = z @ np.hstack([A, B]).T + sizes * gen.standard_normal((N, n))
    data = se.Trajectories.from_pairs(z[:, :n], z[:, n:], y)
    options = options or {"covariance": np.diag(sizes**2)}
    return se.identify(data, **opts(design="adaptive", checks=False, **options)), sizes


def largest(region, x0, u, weigh, gen, starts=3, rounds=25):
    """The largest ``||weigh (x(k) - xh(k))||`` found in the region, k the number of inputs.

    For each Gamma the polar factor of the gradient maximizes the linear term over the ball.
    """
    part, n = region.parts[0], region.n
    root, white, rho = root_of(part.S), part.white, np.sqrt(part.factor)
    at, best = trajectory(region.centre, x0, u), 0.0
    for start in range(starts):
        U, _, V = np.linalg.svd(gen.standard_normal((n, len(white))), full_matrices=False)
        gamma, last = (rho if start else 1e-6 * rho) * U @ V, 0.0
        for _ in range(rounds):
            Theta = region.centre + root @ gamma @ white
            x = trajectory(Theta, x0, u)
            off = weigh @ (x - at)[-1]
            value = float(np.linalg.norm(off))
            best = max(best, value)
            if value == 0.0 or (value < last * (1 + 1e-9) and value != best):
                break
            back, slope = weigh.T @ off / value, np.zeros_like(Theta)
            for k in range(len(u) - 1, -1, -1):
                slope += np.outer(back, np.concatenate([x[k], u[k]]))
                back = Theta[:, :n].T @ back
            U, _, V = np.linalg.svd(root.T @ slope @ white.T, full_matrices=False)
            gamma, last = rho * U @ V, value
    return best


# A chain is known exactly up to noise of every entry, as are all others.
SIMPLE = ("dense", "sparse", "weakly_coupled", "orthogonal", "memoryless", "chain", "scalar")


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_in_the_region_is_worse(kind):
    """The tube, b_k, components and the target at 3 plans of each kind; x within 40 % above."""
    gen, ratios = np.random.default_rng([5, list(KINDS).index(kind)]), []
    for n, m, K in ((2, 1, 5), (3, 1, 8), (5, 2, 4)):
        A, B = drawn(kind, gen, n, m)[1:]
        n, m = B.shape
        model, _ = measured(gen, A, B, N=30 * n)
        region = model.region(DELTA, frobenius=True)
        x0, u = gen.standard_normal(n), gen.standard_normal((K, m))
        found = region_errors(region, x0, u, rho0=0.0)
        units = [np.eye(n)[[i]] for i in range(n)]
        for k in (1, K // 2, K):
            worst = largest(region, x0, u[:k], np.eye(n), gen)
            assert worst <= found.radii[k] * (1 + 1e-9)
        ratios.append(found.radii[K] / worst)
        for i in range(n):
            assert largest(region, x0, u, units[i], gen, 2) <= found.components[i] * (1 + 1e-9)
        at = trajectory(region.centre, x0, u)
        ways = [(region.core, u, None, False)]
        bands = _core.certify((x0, 0.0), at[-1], at, ways, None, True)[4]
        np.testing.assert_allclose(bands[-1], found.components)
        for i in range(n):
            worst = largest(region, x0, u[: K // 2], units[i], gen, 2)
            assert worst <= bands[K // 2, i] * (1 + 1e-9)
        part = region.parts[0]
        half = part.white[:, :n]
        b = region_errors(replace(region, frobenius=None), x0, u).rest
        assert largest(region, x0, u[: K - 1], half, gen, 2) <= b[K - 1] * (1 + 1e-9)
    if kind in SIMPLE:
        assert np.median(ratios) < 1.4


def test_the_rank_may_not_be_left_out():
    """The Frobenius norm of the first order times the spectral radius alone is exceeded."""
    gen, above = np.random.default_rng(6), 0
    for one in of_each_kind(gen, 4, 2, without=("mixed_state_units", "tiny")):
        n, m = one.B.shape
        model, _ = measured(gen, one.A, one.B, N=4000, scale=0.01)
        region = model.region(DELTA)
        x0, u = gen.standard_normal(n), gen.standard_normal((5, m))
        wrong = replace(region, frobenius=np.sqrt(region.parts[0].factor))
        false, true = (region_errors(r, x0, u, rho0=0.0).radii[-1] for r in (wrong, region))
        worst = largest(region, x0, u, np.eye(n), gen)
        above += worst > false * 1.01
        assert worst <= true * (1 + 1e-9)
    assert above > 5


# -- Gaussian noise to come ------------------------------------------------------------------------


def noisy_path(gen, A, B, x0, u, root):
    path = [x0]
    for acting in u:
        path.append(A @ path[-1] + B @ acting + root @ gen.standard_normal(len(A)))
    return np.array(path)


def wrong(found, plan, path):
    """Target, tube and components."""
    away = np.linalg.norm(path - plan.predicted_states, axis=1)
    apart = path[-1] - plan.basis.xf
    return [
        np.linalg.norm(apart) > found.target,
        bool((away > found.tube * (1 + 1e-9) + 1e-12).any()),
        bool((np.abs(apart) > found.components).any()),
    ]


DECLARED = {
    "known": lambda S, B: {"covariance": S},
    "independent": lambda S, B: {"covariance": S, "design": "independent"},
    "by rows": lambda S, B: {"covariance": S, "known": (None, np.where(abs(B) > 1, B, np.nan))},
    "unknown": lambda S, B: {},
}


# Medians of the first error over its tube, for each declaration: no tube becomes smaller unseen.
USUAL = {
    "isotropic": (0.2956, 0.3748, 0.2647, 0.1512),
    "correlated": (0.1862, 0.2705, 0.2062, 0.0952),
    "graded": (0.1342, 0.2098, 0.1486, 0.0759),
}


@pytest.mark.parametrize("declared", DECLARED)
@pytest.mark.parametrize("noise", USUAL)
@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
def test_certificates_with_noise_hold(declared, noise):
    """40 runs of each covariance and declaration, K = 1 and 5; every kind of system in turn."""
    kinds = [k for k in KINDS if k not in ("mixed_state_units", "one_huge_entry", "graded")]
    runs, counter = 40, iter(range(10_000))

    def case(gen):
        kind = kinds[next(counter) % len(kinds)]
        A, B = drawn(kind, gen, 3, 2)[1:]
        n, m = B.shape
        S = 0.01 * covariance(noise, gen, n)
        root, z = root_of(S), gen.standard_normal((120, n + m))
        y = z @ np.hstack([A, B]).T + gen.standard_normal((120, n)) @ root.T
        data = se.Trajectories.from_pairs(z[:, :n], z[:, n:], y)
        options = {"design": "adaptive"} | DECLARED[declared](S, B)
        model = se.identify(data, **opts(checks=False, **options))
        failed, shares = [], []
        for K in (1, 5):
            plan = se.control(model, gen.standard_normal(n), np.zeros(n), steps=K)
            found = plan.bound(DELTA, noise=True)
            path = noisy_path(gen, A, B, plan.basis.x0, plan.u, root)
            failed.append(wrong(found, plan, path))
            shares.append(np.linalg.norm(path[1] - plan.predicted_states[1]) / found.tube[1])
        return {
            "failed": np.array(failed),
            "finite": np.isfinite(found.target),
            "shares": np.array(shares),
        }

    seed = [list(DECLARED).index(declared), list(NOISES).index(noise)]
    found = repeated(case, runs, np.random.SeedSequence(seed))
    at_most(found["failed"].sum(axis=0), runs)
    assert found["finite"].mean() > (0.0 if declared == "unknown" else 0.9)
    usual = USUAL[noise][list(DECLARED).index(declared)]
    assert np.median(found["shares"]) == pytest.approx(usual, rel=0.02)


def test_the_quantile_of_the_noise_is_exact():
    """A model known almost exactly: 4 % of delta = .1 each at the end; half of the quantile fails.

    1000 runs of noise to come for one model of 20 000 pairs and a state held at 0.
    """
    gen, runs, delta, K = np.random.default_rng(3), 1000, 0.1, 6
    A, B = drawn("dense", gen, 3, 1)[1:]
    model, sizes = measured(gen, A, B, N=20_000, scale=0.3)
    plan = se.control(model, np.zeros(3), np.zeros(3), steps=K)
    found = plan.bound(delta, noise=True)
    ends = np.array(
        [noisy_path(gen, A, B, np.zeros(3), plan.u, np.diag(sizes))[-1] for _ in range(runs)]
    )
    off, powers = (
        np.linalg.norm(ends, axis=1),
        [np.linalg.matrix_power(model.A, p) for p in range(K)],
    )
    omega = _core.normal_quantile(sum(P @ np.diag(sizes**2) @ P.T for P in powers), 0.04)
    exactly(np.sum(off > omega), runs, 0.04)
    assert omega <= found.target < 1.3 * omega
    at_most(np.sum(off > found.target), runs, 0.04)
    assert coverage(np.sum(off > found.target / 2), runs) < 0.8
    outside = (np.abs(ends) > found.components).any(axis=1)
    at_most(np.sum(outside), runs, 0.04)


def test_what_the_model_makes_of_the_noise_may_not_be_left_out():
    """The cross term: with radii of the region at their largest, e(k) without n_k is exceeded.

    For the Gamma in the region that is worst for the noise that came, 60 draws of one case where
    the model is uncertain and its own first order is nothing: x0 = 0, u = 0.
    """
    gen, K = np.random.default_rng(8), 4
    A, B = drawn("dense", gen, 2, 1)[1:]
    model, sizes = measured(gen, 1.2 * A, B, N=12, scale=1.0)
    region = model.region(DELTA)
    part, x0, u = region.parts[0], np.zeros(2), np.zeros((K, 1))
    noise = GaussianNoise(np.diag(sizes), 0.02, 0.005 / (2 * (K - 1)))
    found = region_errors(region, x0, u, rho0=0.0, to_come=noise).radii[-1]
    plain = region_errors(region, x0, u, rho0=0.0).radii[-1]
    powers = [np.linalg.matrix_power(region.centre[:, :2], p) @ noise.root for p in range(K)]
    omega = _core.normal_quantile(sum(P @ P.T for P in powers), noise.end)
    root, rho = root_of(part.S), np.sqrt(part.factor)
    worst = 0.0
    for _ in range(60):
        w = gen.standard_normal((K, 2)) @ noise.root.T
        for _ in range(8):
            U, _, V = np.linalg.svd(gen.standard_normal((2, 3)), full_matrices=False)
            Theta = region.centre + root @ (rho * U @ V) @ part.white
            x = x0
            for k in range(K):
                x = Theta @ np.concatenate([x, u[k]]) + w[k]
            worst = max(worst, np.linalg.norm(x))
    assert plain == 0.0
    assert omega < worst <= found


def test_the_noise_is_that_of_the_certificate():
    """Smaller than the ball over all noise vectors, and refused where there is no bound."""
    gen = np.random.default_rng(9)
    A, B = drawn("dense", gen, 4, 2)[1:]
    model, sizes = measured(gen, A, B, N=400)
    plan = se.control(model, gen.standard_normal(4), np.zeros(4), steps=6)
    found = plan.bound(noise=True)
    radius = np.sqrt(_core.wishart_quantile(4, 6, DELTA / 2, 1))
    ball = of_model.SizedNoise(radius, np.diag(sizes))
    before = region_errors(
        model.region(DELTA / 2, frobenius=True), plan.basis.x0, plan.u, rho0=0.0, to_come=ball
    )
    assert found.parts["model error"] < 0.6 * before.radii[-1]
    assert "noise to come independent of the data" in found.assumption
    few, _ = measured(gen, A, B, N=8, noise="gaussian")
    nothing = se.control(few, np.zeros(4), np.zeros(4), steps=3)
    assert nothing.bound(noise=True).target == np.inf
