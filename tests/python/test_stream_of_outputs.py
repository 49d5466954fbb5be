"""`ModelStream` of outputs: what holds at all looks at logs together, forecasts, refusals."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import stochens_rs as se
from core_regions import share
from coverage_study import at_most, sets
from hidden_outputs import Arx
from stochens_rs.exceptions import InputError, SolverError

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")


def stream_of(system, **options):
    return se.ModelStream(system.p, system.m, window=se.Window(lags=system.lags), **options)


def truth(system):
    return np.hstack([*system.A, *system.B])


def missed_at(seed, looks=5, declared=None, delta=0.2):
    """Looks after each log of a hidden plant until a gain is certified, and the largest share."""
    rng = np.random.default_rng(seed)
    system, largest = Arx(rng), 0.0
    options = {}
    if declared is not None:
        options["noise"] = se.Noise(covariance=declared**2 * system.L @ system.L.T)
    stream = stream_of(system, delta=delta, **options)
    for _ in range(looks):
        stream.update(system.data(1, 30, rng))
        model = stream.model
        if model.size <= model.regressors.length + 2 * system.p:
            continue
        largest = max(largest, share(model.region(delta), truth(system)))
        try:
            look = stream.look(gain=se.gain(model, 1.0, 1.0))
        except SolverError:
            continue
        if look.stop:
            return largest, look.proof, system, model
    return largest, None, system, model


def test_what_holds_at_any_look():
    """Hidden plants, a look after each log, delta = 20 %: regions, and loops that end it."""
    shares, unstable, stopped, count = [], 0, 0, sets(200, 10)
    for seed in range(count):
        largest, proof, system, model = missed_at(seed)
        shares.append(largest)
        if proof is None:
            continue
        stopped += 1
        A, B = np.split(model.window.loop(truth(system)).ABc, [model.n], axis=1)
        unstable += np.abs(np.linalg.eigvals(A + B @ proof.K)).max() >= 1.0
        assert proof.check()
    assert stopped > 0.2 * count
    at_most(np.sum(np.array(shares) > 1.0), count, 0.2)
    at_most(unstable, stopped, 0.2)
    assert np.median(shares[:10]) == pytest.approx(0.02044, rel=0.02)  # as wide as they were


@pytest.mark.usefixtures("noise_by_formula")
def test_a_noise_that_is_declared_too_small_makes_regions_miss():
    count = sets(100, 6)
    missed = sum(missed_at(seed, declared=0.3)[0] > 1.0 for seed in range(count))
    assert missed > 0.5 * count


def test_the_plan_of_the_look_that_stops():
    """Hidden plants, delta = 20 %: the means of the last readings are as far off as is said."""
    failed, stopped, count = 0, 0, sets(200, 10)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        system = Arx(rng)
        stream, record = stream_of(system, delta=0.2), system.run(20, rng)
        for _ in range(5):
            stream.update(system.data(1, 30, rng))
            if stream.size <= stream.model.regressors.length + 2 * system.p:
                continue
            look = stream.look(record, np.zeros(system.p), tol=1.0, steps=6)
            assert look.stop == (look.forecast == 0.0)
            if look.stop:
                mean = system.follow(*record, look.u, rng, noise=0.0)
                failed += np.linalg.norm(mean[-system.lags :]) > look.certificate.target
                stopped += 1
                break
    assert stopped > 0.25 * count
    at_most(failed, stopped, 0.2)


def test_the_region_is_that_of_any_time_and_the_forecast_leads_to_the_tolerance():
    rng = np.random.default_rng(3)
    system = Arx(rng)
    names = {"state_names": [f"a{i}" for i in range(system.p)]}
    stream = stream_of(system, scale=2.0, delta=0.1, **names)
    logs = [system.data(1, 40, rng) for _ in range(6)]
    with pytest.raises(InputError, match="`window` must have the outputs"):
        stream.update(logs[0])
    stream = stream_of(system, scale=2.0, delta=0.1)
    with pytest.raises(InputError, match="no log yet"):
        _ = stream.model
    for log in logs:
        stream.update(log)
    window = se.Window(lags=system.lags)
    whole = se.identify(logs, window=window, scale=2.0, checks=False)
    for delta in (0.1, 0.02):
        own, other = stream.model.region(delta), whole.region(delta, anytime=True)
        np.testing.assert_allclose(own.centre, other.centre, rtol=1e-9)
        assert own.radius == pytest.approx(other.radius, rel=1e-9)
        assert own.radius != pytest.approx(whole.region(delta).radius, rel=1e-9)
    with pytest.raises(InputError, match=r"`delta` must be at most 0\.1, which all looks"):
        stream.model.region(0.2)
    plan = se.control(stream.model, record=system.run(20, rng), steps=6)
    with pytest.raises(InputError, match="fixed beforehand"):
        plan.typical()
    again = pickle.loads(pickle.dumps(stream))
    assert again.size == stream.size == whole.size
    assert again.model.region(0.1).radius == stream.model.region(0.1).radius


def test_forecasts_of_logs(tmp_path):
    """The forecast of the looks before is within a factor of 4 of what it took, in the median."""
    ratios = []
    for seed in range(sets(40, 5)):
        rng = np.random.default_rng(100 + seed)
        system = Arx(rng)
        stream, said = stream_of(system), []
        record = system.run(20, rng)
        tol = None
        for _ in range(12):
            stream.update(system.data(1, 40, rng))
            if stream.size < 3 * stream.model.regressors.length:
                continue
            look = stream.look(record, np.zeros(system.p), tol=tol or 1.0, steps=6)
            error = look.certificate.parts["model error"]
            if tol is None:
                tol = look.certificate.parts["reach"] + 0.6 * error
                look = stream.look(record, np.zeros(system.p), tol=tol, steps=6)
            said.append(stream.size + look.forecast)
            if look.stop:
                ratios.append(said[0] / stream.size)
                break
    assert len(ratios) > 2
    assert 0.25 < np.median(ratios) < 4.0
    path = tmp_path / "stream"
    stream.save(path)
    assert se.ModelStream.load(path).size == stream.size


def test_windows_of_earlier_runs_and_what_is_refused():
    rng = np.random.default_rng(5)
    system = Arx(rng)
    before = se.identify(system.data(6, 60, rng), window=se.Window(filters=(0.5, 4)), checks=False)
    stream = se.ModelStream(system.p, system.m, window=before.window)
    stream.update(system.data(3, 60, rng))
    assert stream.model.window == before.window
    assert "any design, valid for all N at once" in stream.model.region().assumption
    for options, text in (
        ({"window": se.Window()}, "`window` must be Window"),
        ({"window": se.Window(filters=(0.5, 4))}, "`window` must be Window"),
        ({"window": se.Window(lags=2, tail=0.1)}, "without a tail"),
        ({"window": se.Window(lags=2), "first": 3}, "with `first`"),
        ({"window": before.window, "intercept": True}, "`intercept` must be False"),
    ):
        with pytest.raises(InputError, match=text):
            se.ModelStream(system.p, system.m, **options)
    with pytest.raises(InputError, match="`u` must be left out with `window`"):
        stream.look(system.run(20, rng), np.zeros(system.p), tol=1.0, u=[[0.0] * system.m])
    with pytest.raises(InputError, match="must be left out with Trajectories"):
        stream.update(system.data(1, 60, rng), [0.0])
