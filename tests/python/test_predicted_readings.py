"""`predict` for models of outputs: runs that were kept apart against the tube of their readings."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import at_most, sets
from declarations import opts
from hidden_outputs import Arx
from stochens_rs.exceptions import InputError, InputTypeError, ShapeError
from stochens_rs.identification.assumptions import ACCEPTED
from stochens_rs.identification.model import estimate_law

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
STEPS = 10


class Plant:
    """``x+ = A x + B u(t - delay) + w``, ``y = C x + v``, of 2 to 4 states and 1 or 2 outputs.

    The errors of reading have deviations from 0.02 to 1, unlike each other.
    """

    def __init__(self, gen, delay=0):
        n, p = int(gen.integers(2, 5)), int(gen.integers(1, 3))
        A = gen.standard_normal((n, n))
        self.A = A * gen.uniform(0.6, 0.95) / np.abs(np.linalg.eigvals(A)).max()
        self.B, self.C = gen.standard_normal((n, 1)), gen.standard_normal((p, n))
        self.process, self.sensor = np.exp(gen.uniform(*np.log([0.02, 0.2]))), np.ones(p)
        self.sensor *= np.exp(gen.uniform(*np.log([0.02, 1.0]), p))
        self.K, self.delay = 0.2 * gen.standard_normal((p, 1)), delay

    def runs(self, gen, count, steps, size, hold=1):
        """So many runs at once, with feedback; the rest of the inputs is new after `hold` steps."""
        n, p = len(self.A), len(self.C)
        x, y, u = gen.standard_normal((count, n)), [], [np.zeros((count, 1))] * self.delay
        for t in range(steps + 1):
            y.append(x @ self.C.T + self.sensor * gen.standard_normal((count, p)))
            own = size * gen.standard_normal((count, 1)) if t % hold == 0 else own  # noqa: F821
            u.append(np.clip(y[-1] @ self.K, -2.0, 2.0) + own)
            noise = self.process * gen.standard_normal((count, n))
            x = x @ self.A.T + u[t] @ self.B.T + noise
        acted = np.stack(u[self.delay : -1], axis=1)
        return se.Trajectories(list(np.stack(y, axis=1)), list(acted), outputs=True)


def left(seed, deltas, **window):
    """Whether readings of a run that was kept apart leave the tubes; its inputs last longer."""
    gen = np.random.default_rng([21, seed])
    plant = Plant(gen, delay=3)
    model = se.identify(plant.runs(gen, 15, 80, 1.0), **opts(checks=False, **window))
    apart = plant.runs(gen, 1, model.window.fill + STEPS, 30.0, hold=8)
    ((record, inputs, readings),) = model.window.stretches(apart, STEPS)
    plan = se.predict(model, record=record, inputs=inputs)
    off = np.linalg.norm(readings - plan.predicted_outputs, axis=1)
    return [bool((off > plan.bound(delta).tube).any()) for delta in deltas]


def test_readings_that_were_kept_apart_are_in_the_tube():
    """One run of each plant under inputs of another kind; false alarms 1e-5 for each level."""
    levels, plants = (0.05, 0.5), sets(50, 25)
    count = np.sum([left(seed, levels, lags=8, delay=3) for seed in range(plants)], axis=0)
    for outside, delta in zip(count, levels, strict=True):
        at_most(outside, plants, delta)


def test_windows_that_do_not_reach_back_to_the_input_leave_the_tube():
    """The same plants, and two lags without the delay of 3 steps; 5 % are allowed."""
    assert sum(left(seed, (0.05,), lags=2, accept=ACCEPTED)[0] for seed in range(30)) > 10


def kept(lags=None, seed=3, **how):
    """A system, a model of it, and a run that was kept apart, as `stretches` cuts it."""
    gen = np.random.default_rng([22, seed])
    system = Arx(gen)
    data = system.data(14, 50, gen)
    how = how or {"lags": system.lags if lags is None else lags}
    model = se.identify(data, **opts(checks=False, **how))
    return system, model, model.window.stretches(system.data(1, 60, gen), 8)


@pytest.mark.parametrize("how", [{}, {"filters": (0.4, 3)}])
def test_the_bounds_are_those_of_a_plan_with_these_inputs(how):
    _, model, ((record, inputs, readings), *_) = kept(**how)
    plan = se.control(model, record=record, steps=8)
    same = se.predict(model, record=record, inputs=plan.u)
    np.testing.assert_array_equal(same.predicted_outputs, plan.predicted_outputs)
    for options in ({}, {"noise": False}):
        one, other = plan.bound(0.1, **options), same.bound(0.1, **options)
        for name in ("tube", "mean", "readings"):
            np.testing.assert_array_equal(other[name].radius, one[name].radius)
        # without a target all distances are from what is predicted
        np.testing.assert_array_equal(other.outputs, other["readings"].radius[1:])
        assert other.parts["reach"] == 0.0
        count = model.window.count
        assert other.target == pytest.approx(np.linalg.norm(other.tube[-count:]), rel=1e-12)
        assert "the predicted outputs" in other["last"].distance_from
    given = se.predict(model, record=record, inputs=inputs)
    assert given.basis.target is None
    assert "inputs given; true system: see bound()" in repr(given)
    np.testing.assert_array_equal(given.predicted_outputs[0], readings[0])
    again = pickle.loads(pickle.dumps(given))
    np.testing.assert_array_equal(again.bound().tube, given.bound().tube)
    assert se.Plan.from_dict(given.to_dict()).basis.given


def test_the_misses_of_drawn_models_are_from_what_is_predicted():
    """A target for each of the last rows: the same runs as with a target of 0, and its distance."""
    _, model, ((record, inputs, _), *_) = kept()
    plan = se.predict(model, record=record, inputs=inputs)
    rows = min(model.window.count, len(inputs))
    law, key = estimate_law(model, windows=True), bytes(range(32))
    begin, end = (plan.basis.x0, plan.u), (False, 20, key, 1, model.window.core)
    goal = plan.predicted_outputs[-rows:]
    misses = se._core.drawn_misses(law, *begin, goal.ravel(), *end)
    models = se._core.estimate_draws(law, 20, key, 1).reshape(20, *model.coefficients.shape)
    for miss, Theta in zip(misses, models, strict=True):
        loop, x, y = model.window.loop(Theta), plan.basis.x0, []
        for u in plan.u:
            both = np.concatenate([x, u])
            y.append(Theta @ loop.J @ both)
            x = loop.ABc @ both
        assert miss == pytest.approx(np.linalg.norm(np.array(y[-rows:]) - goal), rel=1e-9)
    with pytest.raises(ShapeError):
        se._core.drawn_misses(law, *begin, goal.ravel()[1:], *end)


# -- stretches -----------------------------------------------------------------------------------


def test_stretches_follow_on_each_other_within_pieces():
    k = np.concatenate([np.arange(12.0), np.arange(9.0)])
    lost = np.where(np.arange(21) == 7, np.nan, k)  # pieces of 6, 3 and 8 pairs
    table = {"run": np.repeat([0, 1], [12, 9]), "y": lost, "u": 100.0 + k}
    data = se.Trajectories.from_table(table, outputs=["y"], inputs=["u"], by="run")
    window = se.identification.Regressors(data.outputs, data.input_names, 3)
    found = window.stretches(data, 2)
    ends = [(record[0][-1, 0], len(record[0]), len(record[1])) for record, _, _ in found]
    assert ends == [(2.0, 3, 2), (4.0, 5, 4), (2.0, 3, 2), (4.0, 5, 4), (6.0, 7, 6)]
    for record, inputs, readings in found:
        begun = record[0][-1, 0]
        np.testing.assert_array_equal(readings[:, 0], begun + np.arange(3.0))
        np.testing.assert_array_equal(inputs[:, 0], 100.0 + begun + np.arange(2.0))
        np.testing.assert_array_equal(record[1][:, 0], 100.0 + record[0][:-1, 0])
    assert len(window.stretches(data, 6)) == 1
    with pytest.raises(InputError, match="must have a piece of 9 pairs, 2 to fill the window"):
        window.stretches(data, 7)
    with pytest.raises(InputTypeError, match="`data` must be a Trajectories"):
        window.stretches(data.runs, 2)
