"""Plans of models of outputs: drawn models, held-out runs, declared rest, loops that plan."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import stochens_rs as se
from coverage_study import sets
from declarations import opts
from hidden_outputs import Arx, Rig
from stochens_rs import _core
from stochens_rs.exceptions import InputError, ShapeError
from stochens_rs.identification.model import estimate_law
from twin import feedback as exact
from twin import windows as twin

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")


def planned(seed, runs=14, steps=50, **options):
    """A system, a plan for a model of it, its record, and the source of its noise."""
    rng = np.random.default_rng([17, seed])
    system = Arx(rng)
    model = se.identify(system.data(runs, steps, rng), **opts(lags=system.lags, **options))
    record = system.run(20, rng)
    return system, se.control(model, record=record, steps=8), record, rng


def last(y, window):
    return np.linalg.norm(y[-window.count :])


def test_drawn_models_miss_as_fresh_runs_do():
    """80 systems, 5 runs each: one in five misses by more than what 80 % of the models do.

    In `make test` 14, where a miss of a third of it is seen (12.6 of 14 beyond, 11 accepted).
    """
    beyond = {True: 0, False: 0}
    counted, count = 0, sets(80, 14)
    for seed in range(count):
        system, plan, record, rng = planned(seed)
        if plan.basis.model.warnings:
            continue
        counted += 1
        window = plan.basis.model.window
        for noise in (True, False):
            found = plan.typical(0.2, noise=noise, draws=200)
            assert found.miss < found.certified
            runs = [system.follow(*record, plan.u, rng, noise=float(noise)) for _ in range(5)]
            beyond[noise] += np.mean([last(y, window) > found.miss for y in runs])
    assert counted > 0.85 * count
    for share in beyond.values():  # between the quantiles of 12 and 28 %
        assert stats.binom.ppf(1e-4, counted, 0.12) <= share <= stats.binom.isf(1e-4, counted, 0.28)


def test_the_misses_are_those_of_the_drawn_models():
    _, plan, _, _ = planned(3)
    model, window = plan.basis.model, plan.basis.model.window
    law, key = estimate_law(model, windows=True), bytes(range(32))
    models = _core.estimate_draws(law, 30, key, 1).reshape(30, *model.coefficients.shape)
    target = np.arange(1.0, model.n_outputs + 1.0)
    given = plan.basis.x0, plan.u, target, False, 30, key, 1, window.core
    found = _core.drawn_misses(law, *given)
    for miss, Theta in zip(found, models, strict=True):
        loop, x, y = window.loop(Theta), plan.basis.x0, []
        for u in plan.u:
            both = np.concatenate([x, u])
            y.append(Theta @ loop.J @ both)
            x = loop.ABc @ both
        np.testing.assert_allclose(miss, last(np.array(y) - target, window), rtol=1e-9)
    with pytest.raises(ShapeError):
        _core.drawn_misses(law, plan.basis.x0[1:], *given[1:])
    with pytest.raises(InputError, match="not resampled"):
        model.draw(3)


def followed(system, plan, K, record, rng, noise):
    """Readings under ``u(k) + K (x(k) - xh(k))``, x the window of the run."""
    window, (y, u) = plan.basis.model.window, record
    for planned, xh in zip(plan.u, plan.predicted_states, strict=False):
        v = planned + K @ (window.state_of(y, u) - xh)
        y = np.vstack([y, system.follow(y, u, [v], rng, noise)])
        u = np.vstack([u, v])
    return y[-len(plan.u) :]


def test_typical_misses_of_plans_that_are_followed():
    """80 systems, 5 runs each; the models drawn one by one; without K it is another."""
    beyond, counted, count = {True: 0, False: 0}, 0, sets(80, 14)
    for seed in range(count):
        system, plan, record, rng = planned(seed)
        model = plan.basis.model
        if model.warnings:
            continue
        counted, gain = counted + 1, se.gain(model, 1.0, 1.0)
        for noise in (True, False):
            found = plan.typical(0.2, noise=noise, draws=200, gain=gain)
            assert found.certified == plan.bound(0.2, noise=noise, gain=gain).target
            runs = [followed(system, plan, gain.K, record, rng, float(noise)) for _ in range(5)]
            beyond[noise] += np.mean([last(y, model.window) > found.miss for y in runs])
    for share in beyond.values():
        assert stats.binom.ppf(1e-4, counted, 0.12) <= share <= stats.binom.isf(1e-4, counted, 0.28)
    law, key = estimate_law(model, windows=True), bytes(range(32))
    models = _core.estimate_draws(law, 30, key, 1).reshape(30, *model.coefficients.shape)
    given = plan.basis.x0, plan.u, np.zeros(model.n_outputs), False, 30, key, 1, model.window.core
    misses = _core.drawn_misses(law, *given, np.ascontiguousarray(gain.K))
    assert np.abs(misses / _core.drawn_misses(law, *given) - 1.0).max() > 0.01
    for miss, Theta in zip(misses, models, strict=True):
        loop, x, y = model.window.loop(Theta), plan.basis.x0, []
        for u, xh in zip(plan.u, plan.predicted_states, strict=False):
            both = np.concatenate([x, u + gain.K @ (x - xh)])
            y.append(Theta @ loop.J @ both)
            x = loop.ABc @ both
        np.testing.assert_allclose(miss, last(np.array(y), model.window), rtol=1e-8)
    with pytest.raises(ShapeError, match="gain"):
        _core.drawn_misses(law, *given, np.ones((model.m, model.n + 1)))


@pytest.mark.parametrize("noise", [True, False])
def test_typical_refuses_a_model_with_a_tail(noise):
    _, plan, _, _ = planned(3, tail=0.01)
    with pytest.raises(InputError, match="tail"):
        plan.typical(noise=noise)


def test_held_out_runs_say_where_the_next_one_is():
    """150 systems, 9 runs of each at 10 %: the next one is outside in about one of ten."""
    outside, missed, count = 0, 0, sets(150, 40)
    for seed in range(count):
        system, plan, record, rng = planned(seed, runs=6, steps=40, checks=False)
        begun, p = record[0][-1:], system.p
        held = [np.vstack([begun, system.follow(*record, plan.u, rng)]) for _ in range(10)]
        found = plan.validate(np.array(held[:-1]), 0.1)
        assert found.tube.shape == (9, p)
        assert found.noise_free is None
        assert found.rank == 9
        outside += (np.abs(held[-1] - plan.predicted_outputs) > found.tube).any()
        missed += np.linalg.norm(held[-1][-1]) > found.target
    least, most = (stats.binom.ppf(q, count, 0.1) for q in (1e-4, 1 - 1e-4))
    assert least <= outside <= most
    assert least <= missed <= most


# -- rest ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("how", [{"lags": 3}, {"filters": (0.4, 3)}])
@pytest.mark.parametrize(("delay", "intercept"), [(0, False), (2, True)])
def test_rest_is_that_of_the_twin(how, delay, intercept):
    gen = np.random.default_rng(1)
    for p, m in ((1, 1), (2, 1), (1, 2), (3, 2)):
        pole, count = how.get("filters", (None, 3))
        names = tuple(f"y{i}" for i in range(p)), tuple(f"u{j}" for j in range(m))
        window = se.identification.Regressors(*names, count, pole, delay, intercept)
        H, r = gen.standard_normal((p, window.length)), gen.standard_normal(p)
        expected = twin.rest(H, r, m, delay=delay, intercept=intercept, **how)
        u = np.ascontiguousarray(expected[1])
        x, z, off, rounding = window.core.rest(H, r, u)
        np.testing.assert_allclose(z, expected[0], rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(off, np.linalg.norm(H @ z - r), atol=1e-12)
        assert 0.0 < rounding < 1e-9
        still = window.state_of(np.tile(r, (30, 1)), np.tile(u, (29, 1)))
        np.testing.assert_allclose(x, still, atol=1e-12)
        points = _core.SetPoints(window.core, H, np.ones(p + m))
        np.testing.assert_allclose(points.of_inputs, expected[2], rtol=1e-12, atol=1e-14)
        # the model itself goes on from the window of a moving target to that one step later
        held = gen.permutation(p)[: min(p, m)]
        target, step, slope, bias = np.full(p, np.nan), np.zeros(p), np.zeros(p), np.ones(p)
        target[held], step[held], slope[held] = gen.standard_normal((3, len(held)))
        free = np.full(m, np.inf)
        point = points.at(target, np.eye(p), np.zeros(p), (-free, free), np.full(m, np.nan))
        if not np.asarray(point.exact)[held].all():
            continue  # it would take much of the others
        np.testing.assert_allclose(point.place[held], target[held])
        x, u = point.moving(bias, step, slope, np.zeros(m))
        J, ABc, G = window.core.linear(H)
        there = np.concatenate([x, u, np.ones(int(intercept))])
        after, _ = point.moving(bias, step + slope, slope, np.zeros(m))
        np.testing.assert_allclose(ABc @ there + G @ bias, after, atol=1e-8)
        read = H @ J @ there + bias
        np.testing.assert_allclose(read[held], (target + step + slope)[held], atol=1e-8)
    with pytest.raises(se.StochensError):
        window.core.rest(H, r[1:], u)
    with pytest.raises(se.StochensError):
        window.core.rest(H, np.nan * r, u)


def test_a_plant_that_is_declared_to_be_at_rest():
    rng = np.random.default_rng(2)
    model = se.identify(
        Rig().data(40, rng), accept="memory", checks=False, window=se.Window(lags=8)
    )
    cost = se.Cost(Q=[1.0, 1.0], R=0.01)
    plan = se.control(model, record="rest", target=[0.1, 0.0], steps=60, cost=cost)
    assert "declared: the plant was at rest" in plan.bound(0.05).assumption
    np.testing.assert_array_equal(plan.predicted_outputs[0], [0.0, 0.0])
    np.testing.assert_array_equal(plan.basis.x0, np.zeros(model.n))
    again = se.Plan.from_dict(plan.to_dict())
    assert again.basis.at_rest
    # beside its place the cart stands too, but a pendulum that is tilted does not
    beside = se.control(model, record=("rest", [0.2, 0.0], [0.0]), steps=60, cost=cost)
    assert beside.predicted_outputs[0, 0] == 0.2
    measured = se.control(model, record=(np.zeros((9, 2)), np.zeros((8, 1))), steps=60, cost=cost)
    assert "the record happened" in measured.bound(0.05).assumption
    for record, said in (
        (("rest", [0.0, 0.05], [0.0]), "at rest: at the outputs"),
        (("rest", [0.0, 0.0], [5.0]), "at rest: at the outputs"),
        ("still", "'rest'"),
        (("rest",), "a pair"),
    ):
        with pytest.raises(InputError, match=said):
            se.control(model, record=record, steps=60)
    loop = se.regulate(model, 60, offset_free=False, cost=cost)
    loop.start("rest")
    assert loop.plan.basis.at_rest


# -- loops that plan -----------------------------------------------------------------------------


def test_the_plan_of_a_loop_is_what_it_does_and_has_a_bound():
    system, plan, record, rng = planned(3)
    model = plan.basis.model
    loop = se.regulate(model, 8, offset_free=False, limits=(-0.5, 0.5))
    with pytest.raises(InputError, match="a full window"):
        _ = loop.plan
    acted, (y, u) = loop.start(record), [list(one) for one in record]
    for _ in range(20):
        np.testing.assert_allclose(loop.plan.u[0], acted, atol=1e-9)
        own = se.control(model, record=(np.array(y), np.array(u)), steps=8, limits=(-0.5, 0.5))
        np.testing.assert_allclose(loop.plan.bound().tube, own.bound().tube, rtol=1e-4)
        y.append(system.follow(y, u, acted[None], rng)[0])
        u.append(acted)
        acted = loop(y[-1])
    loop([np.nan, *y[-1][1:]])
    with pytest.raises(InputError, match="no reading was missing"):
        _ = loop.plan
    for other, said in (
        (se.regulate(model, 8, offset_free=True), "offset_free=False"),
        (se.regulate(se.gain(model, 1.0, 1.0), offset_free=False), "a loop that plans"),
    ):
        other.start(record)
        with pytest.raises(InputError, match=said):
            _ = other.plan
    with pytest.raises(InputError, match="nothing is proved for all time"):
        loop.certificate()


def test_readings_are_in_the_tubes_of_the_plans_of_a_loop():
    """40 systems, in `make test` 16: the plan of the third call is followed to its end, twice."""
    shares, count = [], sets(40, 16)
    for seed in range(count):
        system, plan, record, rng = planned(seed, checks=False)
        loop = se.regulate(plan.basis.model, 8, offset_free=False)
        acted, (y, u) = loop.start(record), [list(one) for one in record]
        for _ in range(3):
            y.append(system.follow(y, u, acted[None], rng)[0])
            u.append(acted)
            acted = loop(y[-1])
        own, bound = loop.plan, loop.plan.bound(0.3)
        for _ in range(2):
            off = system.follow(y, u, own.u, rng) - own.predicted_outputs[1:]
            shares.append((np.linalg.norm(off, axis=1) / bound.tube[1:]).max())
    assert np.sum(np.array(shares) > 1.0) <= 0.6 * count
    assert np.median(shares[:32]) == pytest.approx(0.5896, rel=0.02)  # as wide as it was


# -- long windows --------------------------------------------------------------------------------


@pytest.mark.parametrize("filters", [(0.7, 7), (0.7, 10), (0.8, 7)][: sets(3, 2)])
def test_loops_of_long_windows_are_certified(filters):
    """Up to 30 states that nearly depend on each other: .35, .62 and .74 of 1 by frequencies."""
    data = Rig().data(200, np.random.default_rng(1))
    model = se.identify(data, accept="memory", checks=False, window=se.Window(filters=filters))
    gain = se.gain(model, [1.0, 1.0], 0.01)
    proofs = gain.certificate(0.05), se.regulate(gain, offset_free=True).certificate(0.05)
    for number, proof in enumerate(proofs):
        assert proof.status == "certified"
        assert proof.check()
        assert proof.norm < 1.2 * proof.least
        if filters == (0.7, 7) and number < sets(2, 0):  # in rational numbers
            part, (n, d) = proof.region.parts[0], proof.region.centre.shape
            W, S = np.zeros((len(part.white), d)), np.zeros((n, n))
            W[:, part.columns], S[np.ix_(part.rows, part.rows)] = part.white, part.S
            given = proof.region.centre, W, S, proof.K
            assert exact.true(*given, np.sqrt(part.factor), proof.proof)
            assert not exact.true(*given, 20.0 * np.sqrt(part.factor), proof.proof)
    tube = gain.certificate(0.05).tube(np.zeros(model.n), 20, start=1e-3)
    assert np.isfinite(tube.radii).all()
