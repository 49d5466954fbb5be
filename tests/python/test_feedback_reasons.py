"""Why nothing is certified of a gain, in words."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from stochens_rs import _core
from stochens_rs.exceptions import SolverError
from stochens_rs.feedback.certificate import judged, unmoved
from stochens_rs.identification.model import in_states
from twin.feedback import unmoved as twin_unmoved

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")

B = np.array([[0.5], [0.0]])
APART = np.array([[0.9, 0.2], [0.0, 1.05]])  # nothing moves the second state
CHAIN = np.array([[1.05, 0.2], [0.1, 0.7]])


def model_of(A, runs, outputs, seed=1, B=B):
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(runs):
        x, u = np.zeros((41, 2)), rng.standard_normal((40, 1))
        x[0] = 0.1 * rng.standard_normal(2)
        for k in range(40):
            x[k + 1] = A @ x[k] + B @ u[k] + 0.05 * rng.standard_normal(2)
        found.append((x, u))
    read = {"outputs": True} if outputs else {}
    data = se.Trajectories(*zip(*found, strict=True), state_names=["a", "b"], **read)
    return se.identify(data, checks=False, **({"window": se.Window(lags=2)} if outputs else {}))


@pytest.mark.parametrize("outputs", [False, True])
def test_a_mode_that_no_input_moves_is_named(outputs):
    model = model_of(APART, 30, outputs)
    why = unmoved(model, 0.05)
    assert why is not None
    assert re.match(r"b has a part that is 1\.0[3-7]\d? times as large after a step, and the", why)
    proof = se.gain(model, [1.0, 1.0], 1.0).certificate(0.05)
    assert proof.status in ("refuted", "not provable")
    assert proof.reason == why
    assert why in repr(proof)
    with pytest.raises(SolverError, match="the data do not show that an input moves it"):
        se.gain(model, [1.0, 1.0], 1.0, guarantee=0.05)


def late_runs(late, spike=False):
    """Readings of inputs that act `late` steps after they are logged."""
    rng, runs = np.random.default_rng(4), []
    for _ in range(12):
        y, u = np.zeros((61, 1)), rng.standard_normal((60, 1))
        for k in range(60):
            acting = u[k - late, 0] if k >= late else 0.0
            y[k + 1] = 0.9 * y[k] + acting + 0.05 * rng.standard_normal()
        runs.append((y, u))
    if spike:
        runs[8][0][30] = -9999.0
    return se.Trajectories(*zip(*runs, strict=True), outputs=True)


@pytest.mark.parametrize("weights", [{}, {"Q": 1.0, "R": 1.0, "guarantee": 0.05}])
def test_no_guarantee_for_inputs_that_act_late_names_the_cure(weights):
    late = se.identify(late_runs(1), checks=False, window=se.Window(lags=2, delay=1))
    assert late.doubts == ()
    with pytest.raises(SolverError, match="inputs act 1 step late; pass Q and R, and no `guar"):
        se.gain(late, **weights)
    assert se.gain(late, 1.0, 1.0).certificate(0.05).status == "certified"


@pytest.mark.parametrize("weights", [{}, {"Q": 1.0, "R": 1.0, "guarantee": 0.05}])
def test_no_gain_of_a_doubted_log_names_the_doubt(weights):
    short = se.identify(late_runs(1), checks=False, window=se.Window(lags=1))
    for model in (short, se.identify(late_runs(0, True), checks=False, window=se.Window(lags=2))):
        with pytest.raises(SolverError) as raised:
            se.gain(model, **weights)
        assert str(raised.value) == f"no gain was found: {model.doubts[0]}"


@pytest.mark.parametrize("outputs", [False, True])
def test_a_mode_that_the_input_moves_is_not(outputs):
    model = model_of(CHAIN, 30, outputs)
    assert np.abs(np.linalg.eigvals(model.A)).max() > 1.0
    assert unmoved(model, 0.05) is None
    assert se.gain(model, [1.0, 1.0], 1.0).certificate(0.05).status == "certified"


def test_complex_modes_are_looked_at_in_both_parts():
    turn = 1.03 * np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    assert unmoved(model_of(turn, 30, False), 0.05) is None
    why = unmoved(model_of(turn, 30, False, B=0.0 * B), 0.05)
    assert why is not None
    assert "1.03 times as large" in why


@pytest.mark.parametrize("outputs", [False, True])
def test_unmoved_modes_are_those_of_the_plain_twin(outputs):
    """The fastest of them; also of complex ones, and of small effects of the input."""
    rng, verdicts = np.random.default_rng(3), []
    for seed in range(sets(60, 12)):
        A = rng.standard_normal((2, 2)) * [[1.0, 1.0], [rng.integers(0, 2), 1.0]]
        A *= rng.uniform(0.9, 1.08) / np.abs(np.linalg.eigvals(A)).max()
        effect = rng.choice([0.0, 1e-3, 0.3], (2, 1))
        model = model_of(A, 12, outputs, seed, effect)
        region, rows = in_states(model, model.region(0.05)), model.n_outputs
        modes, found = twin_unmoved(region, rows), _core.unmoved(region.core, rows)
        assert (found is None) == (not modes)
        if found is not None:
            most = max(grown for _, grown in modes)
            assert found[1] == pytest.approx(most, rel=1e-9)
            assert found[0] in [state for state, grown in modes if grown > most - 1e-9]
        verdicts.append(found is None)
    assert 0 < sum(verdicts) < len(verdicts)


def test_too_few_logs_say_how_many_more():
    """A forecast from the size of the region, and none where the model itself is unstable."""
    model = model_of(CHAIN, 2, False, seed=3)
    bold = se.gain(model, [1.0, 1.0], 1e-6)
    proof = judged(model.region(0.05), 0.0 * bold.K, model.labels, model)
    assert proof.status == "refuted"
    assert proof.spectral_radius >= 1.0
    assert "and the model itself: take another gain" in repr(proof)
    proof = dataclasses.replace(proof, least=1.5, spectral_radius=0.9)
    assert "; more logs, or a gain with a better margin" in repr(proof)  # of what is not known


def test_what_rounding_decides_has_a_reason():
    """Many filters that are long beside what they follow."""
    rng = np.random.default_rng(1)
    u, y, x = np.repeat(rng.standard_normal((300, 1)), 10, axis=0), np.zeros((3001, 1)), 0.0
    for k in range(3000):
        x = 0.995 * x + 0.01 * u[k, 0] + 0.002 * rng.standard_normal()
        y[k + 1] = x + 0.003 * rng.standard_normal()
    data, how = se.Trajectories([y], [u], outputs=True), ("memory", "offset")
    found = []
    for count in (12, 13, 14):
        model = se.identify(data, window=se.Window(filters=(0.9, count)), checks=False, accept=how)
        loop = se.regulate(se.gain(model, 100.0, 1.0), offset_free=True)
        found.append(loop.certificate(0.05))
    proof = next(one for one in found if one.status == "undecided")
    assert "the proof fails by rounding, with a region" in proof.reason
    assert "fewer lags or filters" in proof.reason
    assert proof.reason in repr(proof)


@pytest.mark.usefixtures("noise_by_formula")
@pytest.mark.parametrize("outputs", [False, True])
def test_how_many_logs_are_forecast_from_few(outputs):
    """From one or two logs: so many do, within a factor of 4 (N^(-1/2) alone: 100 and more)."""
    ratios, begin = [], 4 if outputs else 1
    for seed in range(sets(40, 4)):
        model = model_of(CHAIN, begin, outputs, seed=seed)
        K = se.gain(model_of(CHAIN, 200, outputs, seed=99), [1.0, 1.0], 1.0).K
        proof = judged(in_states(model, model.region(0.05)), K, model.labels, model)
        found = re.search(r"about ([0-9.e+]+) times as many logs", repr(proof))
        if proof.status == "certified" or found is None:
            continue
        for times in (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 64, 128):
            later = model_of(CHAIN, begin * times, outputs, seed=seed)
            own = judged(in_states(later, later.region(0.05)), K, later.labels, later)
            if own.status == "certified":
                break
        ratios.append(float(found[1]) / times)
    assert ratios
    assert 0.25 < np.median(ratios) < 4.0
