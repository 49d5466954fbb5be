"""Plans from models of measured data: oracles, the twin, brute force, and what is refused."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pytest

import stochens_rs as se
from core_regions import region_errors
from coverage_study import DELTA
from declarations import opts
from identification_data import POINT, Y, Z, check, stable
from stochens_rs import _core
from stochens_rs.certificates.of_model import trajectory
from stochens_rs.identification.assumptions import ACCEPTED
from stochens_rs.identification.identified import Identified
from twin import certified_control as cc
from twin import triangle as tr
from twin.anytime import one_noise


def uncertain(x0, xf, radius):
    """Both ends of a plan, the first within a radius."""
    return se.Uncertain(x0, radius), xf


def model_of(z, y, n=None, **options):
    n = y.shape[1] if n is None else n
    options = {"design": "independent", "checks": False, **options}
    pairs = se.Trajectories.from_pairs(z[:, :n], z[:, n:], y)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", se.exceptions.DataWarning)  # few pairs, equal ones
        return se.identify(pairs, **opts(accept=ACCEPTED, **options))


def case(seed, N=40, sigma=0.3, n=4, m=2):
    gen = np.random.default_rng(seed)
    Theta = np.hstack(stable(gen, n, m))
    z = gen.standard_normal((N, n + m))
    y = z @ Theta.T + sigma * gen.standard_normal((N, n))
    return gen, Theta, z, y


def under(plan, u):
    """The same plan with another control."""
    model = plan.basis.model
    Theta = np.hstack([model.A, model.B, *([] if model.c is None else [model.c[:, None]])])
    return replace(plan, u=u, predicted_states=trajectory(Theta, plan.basis.x0, u))


def measured(gen, Theta, runs, K, sigma=0.1):
    n = len(Theta)
    x, u = gen.standard_normal((runs, K + 1, n)), gen.standard_normal((runs, K, len(Theta[0]) - n))
    for k in range(K):
        x[:, k + 1] = np.concatenate([x[:, k], u[:, k]], axis=1) @ Theta.T + sigma * x[:, k + 1]
    return se.Trajectories(x, u)


# -- known numbers ---------------------------------------------------------------------------------


def test_one_step_of_the_formula_data():
    model = model_of(Z, Y)
    plan = under(se.control(model, POINT[:2], [0.0, 0.0]), POINT[None, 2:])
    found = plan.bound()
    check(found.tube, [0.0, 0.185505135251])
    check(found.target - found.parts["reach"], 0.185505135251)
    check(plan.bound(noise=True).state, 1.173596784293)
    errors = region_errors(model.region(), POINT[:2], POINT[None, 2:], rho0=0.0)
    check(errors.components[0], 0.184570037684)
    scalar = under(
        se.control(model_of(Z, Y, covariance="scalar"), POINT[:2], [0.0, 0.0]), plan.u
    ).bound()
    check(scalar.state, 0.111280959627)
    check(scalar.components, np.abs(scalar_end(plan)) + 0.111280959627)


def scalar_end(plan):
    return plan.predicted_states[-1]


# -- the twin --------------------------------------------------------------------------------------


# -- brute force -----------------------------------------------------------------------------------


def on_the_boundary(gen, shape, spectral, frobenius=np.inf):
    """A matrix with the largest norms that are allowed; half of them of rank one."""
    G = gen.standard_normal(shape)
    if gen.random() < 0.5:
        G = np.outer(gen.standard_normal(shape[0]), gen.standard_normal(shape[1]))
    G *= spectral / np.linalg.norm(G, 2)
    return G * min(1.0, frobenius / np.linalg.norm(G))


def sampled(gen, region, K):
    """A model of the region, and noise that it covers with it."""
    D, w = np.zeros_like(region.centre), np.zeros((K, region.n))
    joint = np.inf if region.frobenius is None else region.frobenius
    for part in region.parts:
        rank = len(part.white)
        shape = len(part.rows), rank + (K if region.future else 0)
        G = np.linalg.cholesky(part.S) @ on_the_boundary(gen, shape, np.sqrt(part.factor), joint)
        D[np.ix_(part.rows, part.columns)] = G[:, :rank] @ part.white
        if region.future:
            w = G[:, rank:].T
    return region.centre + D, w


# x0, xf and the error of x0: a model error, an uncertain start, and nothing but noise
ENDS = [
    ([1.0, -1.0], [0.5, 0.5], 0.0),
    ([0.0, 0.0], [0.0, 0.0], 0.3),
    ([0.0, 0.0], [0.0, 0.0], 0.0),
]


@pytest.mark.parametrize(
    ("kind", "noise"), [("all rows", False), ("all rows", True), ("by rows", False)]
)
@pytest.mark.parametrize("ends", ENDS)
def test_no_model_of_the_region_leaves_the_tube(kind, noise, ends):
    """1 500 models, noises and starts: none beyond the radii, and some beyond 0.4 of them."""
    gen, Theta, z, y = case(11, N=15, n=2, m=1)
    known, K = None, 3
    if kind == "by rows":
        known = np.where([[1, 0], [1, 1]], np.nan, Theta[:, :2])
    model = model_of(z, y, known=(known, None))
    plan = se.control(model, *uncertain(*ends), steps=K)
    found = plan.bound(noise=noise)
    wish = {} if known is not None else {"frobenius": True, "future": K if noise else 0}
    region = model.region(**wish)
    assert len(region.parts) == (1 if known is None else 2)
    error = np.zeros((1500, K + 1, 2))
    for one in error:
        T, w = sampled(gen, region, K)
        off = gen.standard_normal(2)
        x = plan.basis.x0 + ends[2] * off / np.linalg.norm(off)
        for k in range(K + 1):
            one[k] = x - plan.predicted_states[k]
            if k < K:
                x = T @ np.concatenate([x, plan.u[k]]) + w[k]
    largest = np.linalg.norm(error, axis=2).max(axis=0)
    missed = np.abs(plan.predicted_states[-1] - plan.basis.xf + error[:, -1]).max(axis=0)
    assert (largest <= found.tube * (1 + 1e-12)).all()
    assert (missed <= found.components).all()
    assert (largest[1:] >= 0.4 * found.tube[1:]).all()


@pytest.mark.parametrize("law", ["gaussian", "bounded", "sub-gaussian"])
@pytest.mark.parametrize("K", [1, 3])
def test_noise_of_known_size_joins_the_radii(law, K):
    """||[D V^1/2, w]|| from both parts, each at half of delta; one step, or Gaussian: the sum."""
    gen, _, z, y = case(41)
    model = model_of(z, y, noise=law, sigma=0.3, design="adaptive", scale=1.0)
    plan = se.control(model, *gen.standard_normal((2, 4)), steps=K)
    rho = np.sqrt(model.region(DELTA / 2).parts[0].factor)
    q = {
        "gaussian": np.sqrt(_core.wishart_quantile(4, 1, DELTA / 2, 1)),
        "bounded": np.sqrt(K),
        "sub-gaussian": np.sqrt(K) * one_noise(4, DELTA / 2 / K),
    }[law]
    fitted, S = tr.fit(tr.triangle(z, y)), 0.09 * np.eye(4)
    if K == 1:
        options = {"spectral": rho}
    elif law == "gaussian":
        noise = 0.09 * np.eye(4), 0.4 * DELTA, 0.1 * DELTA / 4
        options = {"spectral": rho, "frobenius": 2.0 * rho, "to_come": noise}
    else:
        both = np.hypot(2.0 * rho, np.sqrt(min(4, K)) * q)
        options = {"spectral": np.hypot(rho, q), "frobenius": both, "noise": True}
    twin = cc.several_steps(fitted, plan.basis.x0, plan.u, S=S, **options)
    added = 0.3 * q if K == 1 else 0.0
    np.testing.assert_allclose(plan.bound(noise=True).tube[-1], twin.radii[-1] + added, rtol=1e-6)


# -- what a plan says ------------------------------------------------------------------------------


class Shifted(Identified):
    """A model whose region has another centre, as that of a fused model."""

    def __init__(self, model, shift):
        self.inner, self.shift = model, shift
        self.of_A = np.arange(model.Theta.shape[1]) < len(model.A)

    Theta = property(lambda self: self.inner.Theta + self.shift * self.of_A)
    warnings = property(lambda self: self.inner.warnings)
    dt = property(lambda self: self.inner.dt)
    state_names = property(lambda self: self.inner.state_names)
    input_names = property(lambda self: self.inner.input_names)

    def region(self, delta=0.05, *, future=0, frobenius=False):
        return self.inner.region(delta, future=future, frobenius=frobenius)


@pytest.mark.parametrize("K", [1, 4])
def test_a_region_with_another_centre(K):
    gen, _, z, y = case(17)
    model, ends = model_of(z, y), gen.standard_normal((2, 4))
    plan = se.control(Shifted(model, 0.02), *ends, steps=K)
    found, own = plan.bound(), under(se.control(model, *ends, steps=K), plan.u)
    beside = np.linalg.norm(own.predicted_states - plan.predicted_states, axis=1)
    np.testing.assert_allclose(found.tube, own.bound().tube + beside)
    assert found.target == pytest.approx(own.bound().target)
    assert plan.bound(noise=True).target > found.target


def test_infinite_is_an_answer():
    gen, _, z, y = case(19)
    z[:, 4] = z[:, 5]
    model = model_of(z, y)
    plan = se.control(model, *gen.standard_normal((2, 4)), steps=2)
    assert np.isfinite(plan.bound().target)  # the model asks for what the data have shown
    assert any("not determine" in text for text in plan.info["warnings"])
    found = under(plan, np.outer([1.0, 1.0], [1.0, 2.0])).bound()
    assert found.target == found.state == found.tube[-1] == np.inf
    assert found["target"].reason == "the data do not determine the system along u[0] - u[1]"
    assert "u[0] - u[1]" in repr(found)
    assert found.largest == "model error"
    assert pickle.loads(pickle.dumps(found)).to_dict() == found.to_dict()
    few = se.control(model_of(z[:7, [0, 1, 2, 3, 5]], y[:7]), np.ones(4), np.ones(4)).bound()
    assert np.isinf(few.target)
    assert "too few data" in repr(few)


def test_an_input_without_effect_in_the_data_stays_at_rest():
    gen, _, z, y = case(23)
    z[:, 5] = 0.0
    model = model_of(z, y)
    for K in (1, 4, 6):
        plan = se.control(model, *gen.standard_normal((2, 4)), steps=K)
        assert not plan.u[:, 1].any()
        assert np.isfinite(plan.bound().target)


def test_a_plan_beyond_the_data_says_so():
    _, _, z, y = case(3)
    model = model_of(z, y)
    near = se.control(model, [0.1] * 4, [0.0] * 4, steps=4)
    far = se.control(model, [100.0] * 4, [0.0] * 4, steps=4)
    assert not any("times the largest" in text for text in near.info["warnings"])
    assert any("times the largest in the data" in text for text in far.info["warnings"])
    assert not any("times the largest" in text for text in near.bound(0.05).warnings)
    assert any("times the largest in the data" in text for text in far.bound(0.05).warnings)
