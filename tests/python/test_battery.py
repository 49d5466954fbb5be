"""Tests of logs: equal to the twin, at their level on clean data, and with power on each fault."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy import stats

import hidden_systems as hidden
import stochens_rs as se
from coverage_study import sets
from declarations import opts
from stochens_rs.exceptions import InputError
from stochens_rs.identification import checks
from twin import battery as twin

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")

A, B, NOISE = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.0], [1.0]]), 0.1
GAIN = np.array([[-0.3, -0.5]])


def runs(gen, count, steps, *, dead=0, gain=None, act=lambda u: u, B=B, noise=NOISE, until=None):
    """States and inputs of runs of a plant that reads x without error."""
    states, inputs = [], []
    for _ in range(count):
        x, given = [gen.standard_normal(2)], []
        while len(given) < steps and not (until and given and until(x[-1])):
            u = gen.standard_normal(1) + (0.0 if gain is None else gain @ x[-1])
            given.append(u)
            late = given[-1 - dead] if len(given) > dead else np.zeros(1)
            size = noise(x[-1]) if callable(noise) else noise
            x.append(A @ x[-1] + B @ act(late) + size * gen.standard_normal(2))
        states.append(np.array(x))
        inputs.append(np.array(given))
    return states, inputs


def of(states, inputs, **words):
    return se.Trajectories(states, inputs, **words)


def last(states, inputs):
    return of(states, inputs).last_pairs()


def late_rows(gen):
    (x,), (u,) = runs(gen, 1, 400, gain=GAIN)
    return of(x[1:], u[:-1])


def spikes(gen, count, size):
    (x,), (u,) = runs(gen, 1, 800)
    x[gen.choice(np.arange(2, 798), count, replace=False), 0] += size
    return of(x, u)


def wrapped(gen):
    x, v, states, inputs = 0.0, 0.0, [], []
    for _ in range(600):
        states.append([(x + 180.0) % 360.0 - 180.0, v])
        inputs.append(gen.standard_normal(1))
        x += 0.1 * v + 0.1 * gen.standard_normal()
        v = 0.95 * v + 20.0 * inputs[-1][0] + gen.standard_normal()
    return of([*states, [(x + 180.0) % 360.0 - 180.0, v]], inputs)


def changed(gen):
    (x, u), (y, v) = runs(gen, 10, 20), runs(gen, 10, 20, B=1.3 * B)
    return of(x + y, u + v)


def reshaped(gen):
    (x,), (u,) = runs(gen, 1, 799)
    return of(list(x.reshape(40, 20, 2)), list(np.vstack([u, u[:1]]).reshape(40, 20, 1)[:, :-1]))


def read(gen, dead=0, error=0.0, noise=NOISE):
    x, u = runs(gen, 10, 150, dead=dead, noise=noise)
    y = [one[:, :1] + error * gen.standard_normal((len(one), 1)) for one in x]
    return of(y, u, outputs=True)


def heading(gen):
    """An angle held at the end of its range, where many jumps are undone at once, as spikes are."""
    x, inputs = [np.zeros(1)], gen.standard_normal((400, 1))
    for u in inputs:
        x.append(0.98 * x[-1] + 2.0 * u + 0.1 * gen.standard_normal(1))
    return of(np.array(x) % 360.0, inputs)


def twice(data):
    return [data, data]


EXACT = {"design": "independent"}
#: Data with a fault, how they are identified, and the names of which one must be said first.
FAULTS = {
    "dead time": (lambda g: of(*runs(g, 20, 20, dead=2)), {"sigma": NOISE}, "dead time"),
    "dead time, last pairs": (lambda g: last(*runs(g, 40, 20, dead=1)), EXACT, "dead time"),
    "late rows": (late_rows, {}, "late rows"),
    "one spike": (lambda g: spikes(g, 1, 5.0), {}, "spikes"),
    "eight spikes": (lambda g: spikes(g, 8, 1.0), {}, "spikes"),
    "wrapped angle": (wrapped, {}, "wrap"),
    "wrapped heading": (heading, {}, "wrap"),
    "sigma at a third": (lambda g: of(*runs(g, 5, 20)), {"sigma": NOISE / 3}, "noise size"),
    "bound at a third": (
        lambda g: of(*runs(g, 5, 20)),
        {"sigma": NOISE / 3, "noise": "sub-gaussian"},
        "noise size",
    ),
    "dead zone": (
        lambda g: of(*runs(g, 20, 20, act=lambda u: np.sign(u) * np.maximum(abs(u) - 0.5, 0.0))),
        {"sigma": NOISE},
        "nonlinear",
    ),
    "saturated motor": (
        lambda g: of(*runs(g, 20, 20, act=lambda u: np.clip(u, -1.0, 1.0))),
        {"sigma": NOISE},
        "nonlinear",
    ),
    "not scalar": (
        lambda g: last(*runs(g, 60, 10, noise=np.array([0.1, 0.3]))),
        {"covariance": "scalar", **EXACT},
        "noise shape",
    ),
    "a switch ends runs": (
        lambda g: last(*runs(g, 40, 200, until=lambda x: abs(x[0]) > 2.0)),
        EXACT,
        "ends",
    ),
    "a file twice": (lambda g: twice(of(*runs(g, 20, 10))), {}, "equal rows"),
    "last pairs twice": (lambda g: twice(last(*runs(g, 20, 10))), EXACT, "equal rows"),
    "one log reshaped": (reshaped, {"sigma": NOISE, "pilot": 0.1}, "starts"),
    "offset": (
        lambda g: (lambda x, u: of([one + 5.0 for one in x], u))(*runs(g, 20, 20)),
        {},
        "offset",
    ),
    "hidden state, last pairs": (
        lambda g: (lambda x, u: last([one[:, 1:] for one in x], u))(*runs(g, 40, 20)),
        EXACT,
        "memory",
    ),
    "clipped": (
        lambda g: (lambda x, u: of([np.clip(one, -1.2, 1.2) for one in x], u))(*runs(g, 20, 20)),
        {},
        "clipped memory",
    ),
    "change": (changed, {}, "change nonlinear"),
    "noise of the state": (
        lambda g: of(*runs(g, 20, 20, noise=lambda x: 0.1 * (1.0 + abs(x[0])))),
        {},
        "variance outliers change spikes nonlinear",
    ),
    "readings, dead time": (lambda g: read(g, dead=8), {"lags": 4}, "dead time"),
    "readings with error": (lambda g: read(g, error=0.1, noise=0.0), {"lags": 4}, "memory"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_refused_and_named(fault):
    """In each set nothing is bounded, and the first reason is that of the fault."""
    make, options, names = FAULTS[fault]
    for seed in range(sets(40, 3)):
        model = se.identify(
            make(np.random.default_rng([920, seed])), **opts(**options, checks=False)
        )
        assert model.doubts
        assert any(name in names for name in model._faults), (seed, list(model._faults))
        assert np.isinf(model.region(0.05).radius)
        if model.window is None:
            bound = se.control(model, [1.0] * model.n, [0.0] * model.n, steps=3).bound(0.05)
            assert np.isinf(bound.target)


def clean(gen, system):
    """Runs of a system, their last pairs, or pairs; with what is declared truly of them."""
    n, m = system.B.shape
    scalar = gen.random() < 0.5
    root = NOISE * hidden.NOISES["isotropic" if scalar else "correlated"](gen, n)
    grows = np.abs(np.linalg.eigvals(system.A)).max() > 1.01
    steps, count = int(gen.integers(3, 11 if grows else 40)), int(gen.integers(12, 40))
    feedback, least = gen.random() < 0.6, min(n, m)
    start, u, w = np.split(gen.standard_normal((count, n + steps * (m + n))), [n, n + steps * m], 1)
    u, w = u.reshape(count, steps, m), w.reshape(count, steps, n)
    x = np.zeros((count, steps + 1, n))
    x[:, 0] = start
    for k in range(steps):
        if feedback:
            u[:, k, :least] -= 0.1 * np.clip(x[:, k, :least], -1.0, 1.0)
        x[:, k + 1] = x[:, k] @ system.A.T + u[:, k] @ system.B.T + w[:, k] @ root.T
    true = [{}, {"sigma": NOISE}, {"covariance": "scalar"}, {"covariance": "diagonal"}]
    options = true[gen.integers(4)] if scalar else {}
    data = of(list(x), list(u))
    return [(data, options), (data.last_pairs(), EXACT)]


def test_less_than_one_in_a_hundred_clean_logs_is_refused():
    """Of all kinds of systems but those whose noise is below the rounding of other units."""
    refused, asked = [], 0
    for seed in range(sets(150, 6)):
        gen = np.random.default_rng([921, seed])
        sizes = int(gen.integers(1, 5)), int(gen.integers(1, 3))
        for system in hidden.of_each_kind(gen, *sizes, without=("mixed_state_units",)):
            for data, options in clean(gen, system):
                model = se.identify(data, **opts(**options, checks=False))
                asked += 1
                refused += [(system.kind, seed, name) for name in list(model._faults)[:1]]
    assert len(refused) <= stats.binom.isf(1e-3, asked, 0.01), refused


@pytest.mark.parametrize("seed", range(4))
def test_the_tests_are_those_of_the_twin(seed):
    gen = np.random.default_rng([922, seed])
    data = of(*runs(gen, 6, 15, dead=seed % 2))
    x, u, y = data.pairs()
    model = se.identify(data, checks=False)
    for name, expected in twin.tests(x, u, y, data.layout.places(), data.layout.runs()).items():
        np.testing.assert_allclose(model.tests[name], expected, rtol=1e-6, err_msg=name)


def test_a_test_that_is_accepted_is_named_everywhere(tmp_path):
    data = of(*runs(np.random.default_rng(923), 20, 20, dead=2))
    refused = se.identify(data, checks=False)
    names = tuple(refused._faults)
    model = se.identify(data, accept=names, checks=False)
    assert model.doubts == ()
    assert np.isfinite(model.region(0.05).radius)
    said = f"accepted by name: {', '.join(names)}"
    plan = se.control(model, [1.0, 0.0], [0.0, 0.0], steps=3)
    assert said in model.region().assumption
    assert said in plan.bound(0.05).assumption
    assert said in se.gain(model, 1.0, 1.0).certificate(0.05).region.assumption
    assert any(text.startswith("accepted: inputs 2 steps earlier") for text in model.warnings)
    model.save(tmp_path / "model.state")
    assert se.Model.load(tmp_path / "model.state").assumptions.accept == names
    with pytest.raises(InputError, match="`accept` must be one of 'equal rows'"):
        se.identify(data, accept="everything")


def test_an_input_without_effect_leaves_no_gain():
    x, u = runs(np.random.default_rng(924), 10, 30, B=0.0 * B)
    data = of(x, u)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        models = [se.identify(data, accept=one, checks=False) for one in ((), "no effect")]
    first, second = (se.gain(model, 1.0, 1.0).certificate(0.05) for model in models)
    assert first.status == "undetermined"
    assert "u[0] has no effect within its bounds" in first.reason
    assert second.status == "certified"
    few = se.gain(se.identify(of(*runs(np.random.default_rng(924), 3, 3))), 1.0, 1.0)
    reason = few.certificate(0.05).reason
    assert "9 pairs leave the sign of every effect open, of the states too: measure more" in reason


def test_last_pairs_keep_the_rows_before(tmp_path):
    data = of(*runs(np.random.default_rng(925), 12, 8))
    data.last_pairs().save(tmp_path / "last.state")
    loaded = se.Trajectories.load(tmp_path / "last.state")
    assert loaded == data.last_pairs()
    assert loaded.whole == data
    assert data.last_pairs()[:5].whole == data[:5]
    assert (
        se.identify(data.last_pairs(), **opts(**EXACT, checks=False)).tests["memory"] > checks.FAULT
    )


WINDOWS = None, se.Window(lags=1), se.Window(lags=3), se.Window(filters=(0.5, 3))


@pytest.mark.parametrize("at", [60, 700])
@pytest.mark.parametrize("window", WINDOWS)
def test_a_spike_is_seen_and_placed_wherever_it_is(at, window):
    """Also in the first part, which tells window and scale, and where filters remember it."""
    (x,), (u,) = runs(np.random.default_rng(926), 1, 800)
    clean = x.copy()
    x[at, 0] += 99.0
    names = {"outputs": True, "dt": 0.5, "state_names": ["place", "speed"]}
    model = se.identify(of([x], [u], **names), window=window)
    (doubt,) = (text for text in model.doubts if "accept='spikes'" in text)
    assert f"at {0.5 * at:g} s of data[0] (place = {x[at, 0]:.6g})" in doubt
    assert "wrap" not in model.tests
    assert "spikes" not in se.identify(of([clean], [u], **names), window=window).tests


def test_the_place_of_a_spike_counts_the_rows_that_were_lost():
    rows = {name: [] for name in ("run", "time", "y", "u")}
    rng = np.random.default_rng(927)
    for run in range(3):
        y = rng.standard_normal(300).cumsum() * 0.1
        y[150] += 50.0 * (run == 1)
        for k in np.delete(np.arange(300), [30, 31, 90]):
            for name, one in zip(rows, (run, 0.1 * k, y[k], rng.standard_normal()), strict=True):
                rows[name].append(one)
    columns = {"outputs": ["y"], "inputs": ["u"], "by": "run", "time": "time"}
    data = se.Trajectories.from_table(rows, **columns)
    (doubt, *_) = se.identify(data, window=se.Window(lags=2)).doubts
    assert "at about 15 s of data[1] (y = 5" in doubt


def test_the_places_of_outliers_among_last_pairs_are_those_in_their_runs():
    rng = np.random.default_rng(928)
    x, u = runs(rng, 60, 10)
    odd = sorted(rng.choice(60, 8, replace=False).tolist())
    for run in odd:
        x[run][-1] += 20.0 * rng.standard_normal(2)
    model = se.identify(last(x, u), **opts(**EXACT, checks=False))
    (doubt,) = model.doubts
    places = ", ".join(f"step 9 of data[{run}]" for run in odd[:5])
    assert doubt.startswith(f"what follows {places} and 3 more is no Gaussian noise")
