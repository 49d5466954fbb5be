"""`identify(pilot=..., reference=...)`: arguments, records, files, and what plans are told."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

import stochens_rs as se
from coverage_study import sets
from declarations import opts
from pilot_sets import led, measured, rig
from stochens_rs.exceptions import InputError
from stochens_rs.identification.assumptions import checked_assumptions, least_correlation
from twin.pilot import estimate, simulated

PLANT = rig()
A, B = PLANT.A, PLANT.B
TASK = (PLANT.x0, PLANT.xf, 10)


def runs(count: int = 30, seed: int = 0, length: int = 10) -> se.Trajectories:
    """Runs of the rig in open loop."""
    plant = PLANT._replace(length=length)
    rows, _ = measured(plant, count, np.random.default_rng(seed))
    each = rows.reshape(count, length, 9)
    states = [np.vstack([run[:, :4], run[-1:, 5:]]) for run in each]
    return se.Trajectories(states, [run[:, 4:5] for run in each])


def sharp(**options: object) -> se.Model:
    """With a tenth of the runs as pilot and the task as reference."""
    options = {"pilot": 0.1, "reference": TASK, "sigma": PLANT.sigma, "checks": False, **options}
    return se.identify(runs(), **opts(**options))


def test_a_plan_near_the_reference() -> None:
    model = sharp()
    plan = se.control(model, PLANT.x0, PLANT.xf, steps=10)
    bound = plan.bound(0.05)
    miss = np.linalg.norm(led(np.hstack([A, B]), PLANT.x0, plan.u)[-1] - PLANT.xf)
    assert miss <= bound.target
    assert list(bound.parts) == ["reach", "quantile", "mismatch", "rest"]
    assert bound.target == pytest.approx(sum(bound.parts.values()), rel=1e-12)
    assert bound.largest == "quantile"
    assert "reference fixed" in bound.assumption
    assert "runs 0 to 2" in bound.assumption
    plain = se.identify(runs(), checks=False, noise=se.Noise(sigma=PLANT.sigma))
    other = se.control(plain, PLANT.x0, PLANT.xf, steps=10).bound(0.05)
    assert bound.target < other.target / 3
    # without a reference, or for other steps, that of any plan: between the two
    for one, steps in ((sharp(reference=None), 10), (model, 11)):
        found = se.control(one, PLANT.x0, PLANT.xf, steps=steps).bound(0.05)
        assert list(found.parts) == ["reach", "model error", "start"]
        assert bound.target < found.target < other.target
    region = model.region(0.05, frobenius=True)
    assert region.contains(A, B)
    assert region.radius < plain.region(0.05).radius
    assert plan.bound(0.05, noise=True).target > bound.target
    uncertain = se.control(model, se.Uncertain(PLANT.x0, 0.001), PLANT.xf, steps=10)
    assert "start" in uncertain.bound(0.05).parts


def test_models_are_drawn_by_the_law_of_the_pilot() -> None:
    """``H + sigma G T``: the covariance of a row over 4000 draws, within 5 standard errors."""
    model = sharp()
    rows = np.hstack(model.data.pairs())
    start, size = rows[:, :5].reshape(-1, 10, 5)[:, 0, :4], model.data.size
    zeta = simulated(model.pilot.model, start, np.full(size // 10, 10), rows[:, 4:5], None)
    found = estimate(zeta, rows[:, :5], rows[:, 5:])
    drawn = model.draw(4000, rng=1)
    off = np.concatenate([drawn.A, drawn.B], axis=2) - np.hstack([model.A, model.B])
    expected = PLANT.sigma**2 * found.T.T @ found.T
    error = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / 4000)
    for i in range(4):
        assert np.all(np.abs(off[:, i].T @ off[:, i] / 4000 - expected) <= 5 * error)
    plan = se.control(model, PLANT.x0, PLANT.xf, steps=10)
    near = plan.typical(0.05)
    miss = np.linalg.norm(led(np.hstack([A, B]), PLANT.x0, plan.u)[-1] - PLANT.xf)
    assert miss < near.miss < near.certified == plan.bound(0.05).target
    with pytest.raises(InputError, match="a model without a pilot"):
        se.design(plan, 10, limits=(-1.0, 1.0))


def test_every_pilot() -> None:
    data = runs()
    near = (A * 1.02, B)
    older = se.identify(runs(40, 5), checks=False, noise=se.Noise(sigma=PLANT.sigma))
    for pilot in (3, 0.1, near, se.System(*near), older):
        bound = _bound(data, pilot=pilot, reference=TASK)
        assert np.isfinite(bound.target)
    plan = se.control(older, PLANT.x0, PLANT.xf, steps=10)
    by_plan = _bound(data, pilot=older, reference=plan)
    assert by_plan.target == pytest.approx(_bound(data, pilot=older, reference=TASK).target, 1e-6)
    offset = sharp(intercept=True)
    assert offset.c is not None
    found = se.control(offset, PLANT.x0, PLANT.xf, steps=10).bound()
    assert np.isfinite(found.target)


def _bound(data: se.Trajectories, **options: object) -> se.Certificate:
    model = se.identify(data, **opts(sigma=PLANT.sigma, checks=False, **options))
    return se.control(model, PLANT.x0, PLANT.xf, steps=10).bound()


def test_feedback_with_dither() -> None:
    gain = np.array([[0.5, 2.0, 0.2, 0.4]])
    plant = PLANT._replace(gain=gain)
    rows, dither = measured(plant, 20, np.random.default_rng(2))
    each = rows.reshape(20, 10, 9)
    states = [np.vstack([run[:, :4], run[-1:, 5:]]) for run in each]
    data = se.Trajectories(states, [run[:, 4:5] for run in each])
    bound = _bound(data, pilot=3, reference=TASK, inputs=gain, dither=dither)
    assert "gain" in bound.assumption
    assert bound.target < 0.2


def test_a_pilot_that_says_nothing() -> None:
    data = runs(6)
    states = [run[0] for run in data.runs]
    still = se.Trajectories(states, [0.0 * run[1] for run in data.runs])
    with pytest.warns(se.exceptions.DataWarning):
        model = se.identify(
            still,
            checks=False,
            noise=se.Noise(sigma=PLANT.sigma),
            pilot=se.Pilot((A, B), reference=TASK),
        )
    assert any("pilot" in text for text in model.warnings)
    assert model.region(0.05).radius == np.inf


@pytest.mark.usefixtures("noise_by_formula")
def test_unequal_lengths_that_were_planned() -> None:
    """The model is that of the formula; 200 sets at 20 %, in `make test` 80, both sides at 1e-3."""
    gen, missed, count = np.random.default_rng(21), 0, sets(200, 80)
    for number in range(count):
        each = [runs(1, 1000 * number + k, int(gen.integers(3, 15))).runs[0] for k in range(14)]
        data = se.Trajectories([x for x, _ in each], [u for _, u in each])
        options = {"pilot": 4, "checks": False, "lengths_fixed": True}
        model = se.identify(data, **opts(covariance=np.eye(4) * PLANT.sigma**2, **options))
        missed += not model.region(0.2).contains(A, B)
    low, high = stats.binom.ppf([5e-4, 1 - 5e-4], count, 0.2)
    assert low <= missed <= high  # exact up to the halves of the two norms
    rows, lengths = data[4:].rows, data[4:].lengths
    starts = rows[np.cumsum(lengths) - lengths, :4]
    Q = np.linalg.qr(simulated(model.pilot.model, starts, lengths, rows[:, 4:5], None))[0]
    Z, Y = rows[:, :5], rows[:, 5:]
    H = np.linalg.solve((Q.T @ Z), Q.T @ Y).T
    np.testing.assert_allclose(np.hstack([model.A, model.B]), H, rtol=1e-6, atol=1e-9)


def test_a_singular_known_covariance() -> None:
    """One force disturbs all states: a root of rank 1. Without a pilot it is refused."""
    root = np.array([[0.0], [0.0], [1.0], [-1.0]]) * PLANT.sigma
    gen = np.random.default_rng(5)
    states, inputs = [], []
    for _ in range(30):
        x, u = [gen.standard_normal(4) * PLANT.starts], gen.standard_normal((10, 1))
        for k in range(10):
            x.append(A @ x[-1] + B @ u[k] + root @ gen.standard_normal(1))
        states.append(np.array(x))
        inputs.append(u)
    data, known = se.Trajectories(states, inputs), root @ root.T
    with pytest.raises(InputError, match="positive definite"):
        se.identify(data, checks=False, noise=se.Noise(covariance=known))
    model = se.identify(
        data,
        checks=False,
        noise=se.Noise(covariance=known, exact=[0, 1, 2, 3]),
        pilot=se.Pilot(0.1, reference=TASK),
    )
    bound = se.control(model, PLANT.x0, PLANT.xf, steps=10).bound(0.05)
    plan = se.control(model, PLANT.x0, PLANT.xf, steps=10)
    miss = np.linalg.norm(led(np.hstack([A, B]), PLANT.x0, plan.u)[-1] - PLANT.xf)
    assert miss <= bound.target < np.inf
    assert model.region(0.05).contains(A, B)
    assert plan.bound(0.05, noise=True).target < np.inf
    with pytest.raises(InputError, match="positive semidefinite"):
        se.identify(
            data, checks=False, noise=se.Noise(covariance=known - 1e-8 * np.eye(4)), pilot=0.1
        )


@pytest.mark.parametrize("units", [1.0, np.array([1e-9, 1.0, 1e7, 3.0])])
def test_covariances_that_are_singular_up_to_rounding(units: Any) -> None:
    """Of rank 2 with least eigenvalues around 0: for no rounding and in no unit one is refused."""
    least = []
    for seed in range(20):
        root = np.random.default_rng(seed).standard_normal((4, 2)) * np.reshape(units, (-1, 1))
        known = root @ root.T
        least.append(least_correlation(known))
        found = checked_assumptions(se.Noise(covariance=known), "abcd", singular=True)
        np.testing.assert_allclose(found.known, known, rtol=1e-15)
        with pytest.raises(InputError, match="`covariance` must be positive definite"):
            checked_assumptions(se.Noise(covariance=known), "abcd")
    assert min(least) < 0.0 < max(least)
    wrong = (np.eye(4) - (1.0 + 1e-14) / 4.0) * (np.reshape(units, (-1, 1)) * units)
    with pytest.raises(InputError, match=r"positive semidefinite, .* is -1.3"):
        checked_assumptions(se.Noise(covariance=wrong), "abcd", singular=True)
