"""Columns that are no states of a plant are found, and no certificate from them is finite."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy import linalg, stats

import hidden_systems as hidden
import stochens_rs as se
from coverage_study import at_most, failures, repeated, sets
from stochens_rs.exceptions import DataWarning
from stochens_rs.identification import checks as residual_checks

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")

# -- the rig: a cart with a pendulum, of which position and angle are read -------------------------

DT, NAMES = 0.02, ("position", "angle", "speed", "rate")
SCALE = (0.05, 0.02, 0.05, 0.05, 1.0)
READ, FORCE = np.array([3e-4, 5e-4]), 0.02  # [m, rad], [N]
X0, XF = np.array([0.2, 0.05, 0.0, 0.0]), np.zeros(4)


def plant():
    """A cart of 1 kg with friction 0.5 N s/m, 0.2 kg on a rod of 0.5 m, the force held for DT."""
    F = np.zeros((5, 5))
    F[0, 2] = F[1, 3] = 1.0
    F[2, 1], F[2, 2], F[2, 4] = -0.2 * 9.81, -0.5, 1.0
    F[3, 1], F[3, 2], F[3, 4] = 1.2 * 9.81 / 0.5, 0.5 / 0.5, -1.0 / 0.5
    whole = linalg.expm(F * DT)
    return whole[:4, :4], whole[:4, 4:]


A, B = plant()
_P = linalg.solve_discrete_are(A, B, np.diag([10.0, 10.0, 1.0, 1.0]), np.eye(1))
GAIN = np.linalg.solve(np.eye(1) + B.T @ _P @ B, B.T @ _P @ A)


def logged(gen, runs, *, read=READ, root=FORCE * B, steps=150):
    """States, readings and forces of runs with feedback from filtered differences and a dither."""
    x, v, before = gen.standard_normal((runs, 4)) * SCALE[:4], np.zeros((runs, 2)), None
    states, readings, forces = [x], [], []
    for _ in range(steps):
        y = x[:, :2] + read * gen.standard_normal((runs, 2))
        if before is not None:
            v = 0.7 * v + 0.3 * (y - before) / DT
        u, before = gen.standard_normal((runs, 1)) - np.hstack([y, v]) @ GAIN.T, y
        x = x @ A.T + u @ B.T + gen.standard_normal((runs, root.shape[1])) @ root.T
        states.append(x)
        readings.append(y)
        forces.append(u)
    return tuple(np.array(one).swapaxes(0, 1) for one in (states, readings, forces))


def backward(y):
    return np.concatenate([y[:, 1:], np.diff(y, axis=1) / DT], axis=2)[:, :-1], slice(1, -1)


def forward(y):
    return np.concatenate([y[:, :-1], np.diff(y, axis=1) / DT], axis=2), slice(0, -1)


def central(y):
    v = (y[:, 2:] - y[:, :-2]) / (2 * DT)
    return np.concatenate([y[:, 1:-1], v], axis=2), slice(1, -1)


def filtered(y):
    v = [np.zeros_like(y[:, 0])]
    for k in range(1, y.shape[1]):
        v.append(0.7 * v[-1] + 0.3 * (y[:, k] - y[:, k - 1]) / DT)
    return np.concatenate([y, np.array(v).swapaxes(0, 1)], axis=2), slice(0, None)


def smoothed(y):
    """Savitzky and Golay: value and slope of a parabola through seven readings."""
    value, slope = np.array([-2, 3, 6, 7, 6, 3, -2]) / 21, np.arange(-3, 4) / 28 / DT
    parts = [
        sum(c * y[:, k : y.shape[1] - 6 + k] for k, c in enumerate(cs)) for cs in (value, slope)
    ]
    return np.concatenate(parts, axis=2), slice(3, -3)


DIFFERENCES = {f.__name__: f for f in (backward, forward, central, filtered, smoothed)}


def differenced(gen, runs, kind, **options):
    """Runs whose speeds are computed from the readings."""
    _, y, u = logged(gen, runs, **options)
    states, kept = DIFFERENCES[kind](y)
    inputs = u[:, kept]
    return trajectories(states, inputs[:, : states.shape[1] - 1])


def trajectories(states, inputs):
    return se.Trajectories(states, inputs, dt=DT, state_names=NAMES, input_names=["force"])


def true_distance(plan):
    """How far the plant itself ends from the target."""
    return np.linalg.norm(se.simulate((A, B), X0, plan.u).states[-1])


# -- power -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", DIFFERENCES)
@pytest.mark.parametrize("runs", [2, 10])
def test_finite_differences_are_refused(kind, runs):
    """In each of 20 sets, in `make test` 6: readings with an error, and exact ones."""

    def missed(gen):
        found = []
        for read in (READ, 0.0 * READ):
            data = differenced(gen, runs, kind, read=read)
            found.append(not se.identify(data, checks=False).doubts)
        return found

    assert failures(missed, sets(20, 6), 100).max() == 0


def test_certificates_from_differences_are_wrong_and_hence_infinite():
    """The wrong ones come back where the check is passed over, as a mutant would."""
    wrong = 0
    for seed in range(5):
        data = differenced(np.random.default_rng([101, seed]), 40, "central")
        model = se.identify(data, scale=SCALE, checks=False)
        for steps in (10, 25, 50):
            plan = se.control(model, X0, XF, steps=steps)
            bound = plan.bound(0.05)
            assert bound.target == bound.state == bound.control == np.inf
            assert np.isinf(bound.components).all()
            assert np.isinf(bound.tube[1:]).all()
            vars(model).update(doubts=(), _faults={})
            wrong += plan.bound(0.05).target < true_distance(plan)
            del vars(model)["doubts"], vars(model)["_faults"]
    assert wrong >= 12


# -- honest states ---------------------------------------------------------------------------------


def innovations(gen, runs, steps=150):
    """States of the plant's Kalman filter in its steady state: two innovations in four states."""
    Q, R, C = FORCE**2 * B @ B.T, np.diag(READ**2), np.eye(2, 4)
    P = linalg.solve_discrete_are(A.T, C.T, Q + 1e-14 * np.eye(4), R)
    E = C @ P @ C.T + R
    L = A @ P @ C.T @ np.linalg.inv(E)
    return logged(gen, runs, root=L @ np.linalg.cholesky(E), steps=steps)


HONEST = {
    "one force": (logged, ["position", "angle", "speed"]),
    "Kalman filter": (innovations, ["position", "angle"]),
}


@pytest.mark.parametrize("kind", HONEST)
def test_states_with_few_sources_of_noise_can_be_declared(kind):
    draw, exact = HONEST[kind]

    def case(gen):
        x, _, u = draw(gen, 10)
        data = trajectories(x, u)
        model = se.identify(data, scale=SCALE, checks=False, noise=se.Noise(exact=exact))
        refused = not se.identify(data, scale=SCALE, checks=False).doubts
        plan = se.control(model, X0, XF, steps=10)
        bound = plan.bound(0.05)
        wide = bound.target < true_distance(plan) or not model.region(0.05).contains(A, B)
        return {"failed": wide, "open": refused, "doubts": bool(model.doubts),
                "finite": np.isfinite(bound.target)}  # fmt: skip

    runs = sets(40, 10)
    found = repeated(case, runs, 103)
    at_most(found["failed"].sum(), runs)
    at_most(found["doubts"].sum(), runs, 2e-3)
    assert not found["open"].any()
    assert found["finite"].sum() >= runs - 1


def test_one_more_lag_has_its_level_on_all_kinds_of_systems():
    """One alarm in 2 000 is allowed.

    With noise of full rank nothing is tied either, but where the noise of a state is below the
    rounding of what comes from others in far larger units.
    """
    alarms, tested, tied, seeds = 0, 0, [], sets(50, 10)
    for seed in range(seeds):
        gen = np.random.default_rng([104, seed])
        kinds = hidden.of_each_kind(gen, int(gen.integers(1, 5)), int(gen.integers(1, 3)))
        for system in kinds:
            n, m = system.B.shape
            steps = int(gen.integers(3, 12 if system.kind == "unstable" else 30))
            root = 0.1 * hidden.NOISES[gen.choice(["isotropic", "correlated"])](gen, n)
            states, inputs = [], []
            for _ in range(gen.integers(1, 12)):
                x, u = [gen.standard_normal(n)], gen.standard_normal((steps, m))
                for acting in u:
                    feedback = -0.1 * np.clip(x[-1][: min(n, m)], -1.0, 1.0)
                    acting[: min(n, m)] += feedback
                    x.append(system.A @ x[-1] + system.B @ acting + root @ gen.standard_normal(n))
                states.append(np.array(x))
                inputs.append(u)
            model = se.identify(se.Trajectories(states, inputs), checks=False)
            if "memory" in model.tests:
                tested += 1
                alarms += model.tests["memory"] < residual_checks.FAULT
            if any("tied" in text or "no residual" in text for text in model.doubts):
                tied.append(system.kind)
    assert set(tied) <= {"mixed_state_units", "one_huge_entry"}
    assert tested > 16 * seeds
    assert alarms <= stats.binom.ppf(1 - 2e-4, tested, residual_checks.FAULT)


def test_the_lag_test_is_exact_for_one_row():
    """F of the regression by hand, at its quantile: significant above, not below."""
    gen = np.random.default_rng(105)
    for _ in range(20):
        x, u = [np.zeros(1)], gen.standard_normal((40, 1))
        late = gen.uniform(0.3, 1.2)
        w = gen.standard_normal(41)
        for k, acting in enumerate(u):
            x.append(0.6 * x[-1] + acting + w[k + 1] + late * w[k])
        rows = np.hstack([np.array(x[:-1]), u])
        Z, earlier, y = rows[1:], rows[:-1], np.array(x[2:])  # the first has no row before it
        wide = np.hstack([Z, earlier])
        S0, S1 = (np.sum((y - R @ np.linalg.lstsq(R, y, rcond=None)[0]) ** 2) for R in (Z, wide))
        p = stats.f.sf((S0 / S1 - 1.0) * (39 - 4) / 2, 2, 39 - 4)
        model = se.identify(se.Trajectories(np.array(x), u), checks=False)
        assert model.tests["memory"] == pytest.approx(p, rel=1e-6)
        assert model._tested["memory"].share == pytest.approx(1.0 - S1 / S0)


# -- where it shows --------------------------------------------------------------------------------


def test_tests_that_were_not_made_say_so(monkeypatch):
    gen = np.random.default_rng(110)
    x, u = gen.standard_normal((41, 2)), gen.standard_normal((40, 1))
    monkeypatch.setattr(residual_checks, "WORK", 499 * 79)
    with pytest.warns(DataWarning, match="the residuals were not tested, as 40 pairs take long"):
        model = se.identify(se.Trajectories(x, u))
    assert "not tested" in model._repr_html_()
    assert model.check(99) is not None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tested = se.identify(se.Trajectories(x[:40], u[:39]))
    assert tested.checks is not None
