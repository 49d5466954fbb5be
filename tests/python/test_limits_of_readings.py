"""Limits of outputs and of rates for models of readings: plans and loops."""

from __future__ import annotations

import copy

import numpy as np
import pytest

import stochens_rs as se
from hidden_outputs import one_log
from stochens_rs.exceptions import InputError

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
WINDOWS = [se.Window(lags=2), se.Window(filters=(0.5, 4))]
COST = se.Cost(Q=1.0, R=1e-4)


class Tank:
    """A second-order level that overshoots, in steps of 1 s."""

    def __init__(self) -> None:
        self.y, self.u = np.zeros(2), 0.0

    def step(self, u: float, noise: float) -> float:
        new = 1.6 * self.y[0] - 0.64 * self.y[1] + 0.1 * u + 0.05 * self.u + noise
        self.y, self.u = np.array([new, self.y[0]]), u
        return float(new)


@pytest.fixture(scope="module", params=WINDOWS, ids=["lags", "filters"])
def model(request):
    rng, outputs, inputs = np.random.default_rng(1), [], []
    for _ in range(30):
        tank, u = Tank(), rng.uniform(-1.0, 1.0, (59, 1))
        read = [tank.step(float(one[0]), 0.01 * rng.standard_normal()) for one in u]
        outputs.append(np.array([0.0, *read])[:, None])
        inputs.append(u)
    data = se.Trajectories(outputs, inputs, outputs=True, state_names=["level"])
    return se.identify(data, window=request.param)


def with_readings(model):
    """x+ = A x + B u, y+ = C x + D u as one system of (x, y)."""
    A, B, n = model.A, model.B, model.n
    ahead = model.coefficients @ model.loop.J
    wide = np.block([[A, np.zeros((n, 1))], [ahead[:, :n], np.zeros((1, 1))]])
    return wide, np.vstack([B, ahead[:, n:]])


@pytest.mark.parametrize("rate", [None, 0.3])
def test_a_plan_is_that_of_the_states_with_the_readings(model, rate):
    more = {} if rate is None else {"rate": rate, "previous": 0.0}
    limits = se.Limits(u=(-1.0, 1.0), x={"level": (-0.1, 1.02)}, soft=1e3, **more)
    plan = se.control(model, record="rest", target=[1.0], steps=30, limits=limits, cost=COST)
    n, low, high = model.n, np.full(model.n + 1, -np.inf), np.full(model.n + 1, np.inf)
    low[-1], high[-1] = -0.1, 1.02
    weight = np.zeros((n + 1, n + 1))
    weight[0, 0] = 1.0  # a number is a weight of the readings, or of their first filters
    us, rest = plan.limited.task.resting, np.r_[plan.basis.xf, 1.0]
    # of v = u - u_s and x - x_s
    if rate is not None:
        more["previous"] = -us
    sides = (-1.0 - us, 1.0 - us), (low - rest, high - rest)
    own = se.Limits(u=sides[0], x=sides[1], soft=1e3, **more)
    start, cost = np.r_[plan.basis.x0, 0.0] - rest, se.Cost(Q=weight, R=1e-4)
    other = se.control(with_readings(model), start, 0.0 * rest, steps=30, limits=own, cost=cost)
    np.testing.assert_allclose(plan.u, other.u + us, atol=2e-6)
    assert plan.limited.status == other.limited.status == "optimal"
    free = se.control(model, record="rest", target=[1.0], steps=30, limits=(-1.0, 1.0), cost=COST)
    if rate is not None:
        assert np.abs(np.diff(plan.u[:, 0], prepend=0.0)).max() <= rate + 1e-12
        assert "at their rate" in str(plan)
    assert plan.predicted_outputs.max() <= max(free.predicted_outputs.max(), 1.021)
    assert "readings at a limit" in str(plan)
    assert np.isfinite(plan.bound(0.05).tube).all() or model.doubts
    again = se.Plan.from_dict(plan.to_dict())
    np.testing.assert_array_equal(again.u, plan.u)
    lines = [line for line in plan.plot().axes[0].lines if set(line.get_ydata()) == {1.02}]
    assert len(lines) == 1


@pytest.mark.parametrize("of_gain", [True, False])
def test_a_loop_changes_its_input_by_the_rate_at_most(model, of_gain, tmp_path):
    """Also behind missing and false readings, another target, another input than was returned."""
    rng = np.random.default_rng(2)
    limits = se.Limits(u=(-1.0, 1.0), rate=0.1, previous=0.25)
    if of_gain:
        loop = se.regulate(se.gain(model, 1.0, 10.0), limits=limits, offset_free=True, target=[0.5])
    else:
        loop = se.regulate(model, 15, limits=limits, cost=COST, offset_free=True, target=[0.5])
    tank, applied, read = Tank(), 0.25, 0.0
    for t in range(120):
        read = np.nan if t % 7 == 3 else 1e3 if t % 31 == 5 else read
        u = loop([read], applied=[applied], target=[1.0] if t == 60 else None)
        assert abs(u[0] - applied) <= 0.1 + 1e-12
        assert abs(u[0]) <= 1.0
        if t == 80:
            loop.save(tmp_path / "loop.npz")
            loop = type(loop).load(tmp_path / "loop.npz")
        applied = float(u[0]) if t != 90 else -0.2  # by hand
        read = tank.step(applied, 0.01 * rng.standard_normal())
    assert abs(tank.y[0] - 1.0) < 0.1
    assert loop.calls == 120
    other = copy.deepcopy(loop)
    np.testing.assert_array_equal(other([0.9]), loop([0.9]))
    if not of_gain:
        with pytest.raises(InputError, match="offset_free=False"):
            _ = loop.plan


def test_a_loop_holds_its_readings_below_the_limit(model):
    """The overshoot of the free loop is gone, and a constant that acts changes nothing."""
    most = {}
    cost = se.Cost(Q=np.eye(model.n), R=1e-6)
    for name, x in (("free", None), ("soft", (None, 1.02))):
        tank, rng, limits = Tank(), np.random.default_rng(4), se.Limits(u=(-1.0, 1.0), x=x)
        loop = se.regulate(model, 30, limits=limits, cost=cost, offset_free=True, target=[1.0])
        read, seen = 0.0, []
        for t in range(160):
            read = tank.step(
                float(loop([read])[0]) + 0.05 * (t > 80), 0.002 * rng.standard_normal()
            )
            seen.append(read)
        most[name] = max(seen[:80])
        assert np.mean(seen[-30:]) == pytest.approx(1.0, abs=0.01)
    assert most["soft"] <= min(most["free"], 1.04)


@pytest.mark.parametrize(
    ("window", "names"), [(se.Window(lags=3), ["y[0]"]), (se.Window(filters=(0.5, 3)), ["y[0]~1"])]
)
def test_a_tube_draws_the_outputs_and_not_their_lags(window, names):
    y, u = one_log(lambda y, u: 0.8 * y[-1] + u[-1], 1, 301, noise=0.01)
    data = se.Trajectories([y], [u], outputs=True)
    model = se.identify(data, window=window, accept=["memory"], checks=False)
    proof = se.gain(model, 1.0, 1.0).certificate(0.05)
    tube = proof.tube(np.zeros(model.n), 10)
    assert [ax.get_ylabel() for ax in tube.plot().axes] == [*names, "u[0]"]
    assert len(tube.plot(states=model.state_names[:2]).axes) == 3
