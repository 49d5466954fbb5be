"""How often regions of models of outputs miss, on systems unlike each other; seeds are fixed."""

from __future__ import annotations

import numpy as np
import pytest

import hidden_systems as hidden
import stochens_rs as se
from coverage_study import at_most, sets
from declarations import opts
from stochens_rs.identification import Regressors
from stochens_rs.identification.assumptions import ACCEPTED
from stochens_rs.identification.window import rows_of
from twin.predictors import kalman, unbiased

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")


def missed(model, Theta, delta=0.05):
    """Whether the region does not contain Theta."""
    n = model.n_outputs
    return not model.region(delta).contains(Theta[:, :n], Theta[:, n:])


# -- windows that are exact ----------------------------------------------------------------------


def hidden_arx(gen):
    """Coefficients of 1 to 5 lags of 1 to 3 outputs; stable, or with a root up to 1.05."""
    ny, m, p = (int(gen.integers(1, most + 1)) for most in (3, 2, 5))
    A = [0.6 * gen.standard_normal((ny, ny)) / (k + 1) for k in range(p)]
    companion = np.vstack([np.hstack(A), np.eye(ny * p)[: ny * (p - 1)]])
    radius, wanted = np.abs(np.linalg.eigvals(companion)).max(), gen.uniform(0.5, 1.05)
    A = [one * (wanted / radius) ** (k + 1) for k, one in enumerate(A)]
    return ny, m, p, np.hstack(A), gen.standard_normal((ny, m * p))


def arx_runs(gen, system, runs, steps, size=0.3):
    """Runs with correlated noise, and limited feedback from what was read."""
    ny, m, p, A, B = system
    L = size * np.linalg.cholesky(np.eye(ny) + 0.5)
    K = 0.2 * gen.standard_normal((m, ny))
    z = gen.standard_normal((runs, steps + p, m + ny))
    y, u = np.zeros((runs, steps + 2 * p, ny)), np.zeros((runs, steps + 2 * p - 1, m))
    for t in range(p, steps + 2 * p):
        dither, noise = np.split(z[:, t - p], [m], axis=1)
        u[:, t - 1] = np.clip(-y[:, t - 1] @ K.T, -2.0, 2.0) + dither
        past, acting = (one[:, t - p : t][:, ::-1].reshape(runs, -1) for one in (y, u))
        y[:, t] = past @ A.T + acting @ B.T + noise @ L.T
    return list(y[:, p - 1 :]), list(u[:, p - 1 :])


def padded(system, lags):
    """Theta with more lags than the system has."""
    ny, m, p, A, B = system
    more = lags - p
    return np.hstack([A, np.zeros((ny, more * ny)), B, np.zeros((ny, more * m))])


def test_systems_with_lags_and_feedback():
    misses, runs = 0, sets(240, 10)
    for seed in range(runs):
        gen = np.random.default_rng([7, seed])
        system = hidden_arx(gen)
        data = se.Trajectories(*arx_runs(gen, system, 10, 70), outputs=True)
        lags = system[2] + 2 * (seed % 2)
        model = se.identify(data, checks=False, window=se.Window(lags=lags))
        assert np.isfinite(model.region(0.05).radius)
        misses += missed(model, padded(system, lags))
    at_most(misses, runs)


def filter_runs(gen, window, Theta, runs, steps, size):
    """Runs of y+ = Theta z + w from rest, z the filters of the window; and feedback."""
    ny, m = len(window.outputs), len(window.inputs)
    K = 0.2 * gen.standard_normal((m, ny))
    outputs, inputs = [], []
    for _ in range(runs):
        x, y, u = np.zeros(len(window.state_names)), [np.zeros(ny)], []
        loop = window.loop(Theta)
        for _ in range(steps):
            u.append(np.clip(-K @ y[-1], -2.0, 2.0) + gen.standard_normal(m) * (len(u) > 0))
            w = size * gen.standard_normal(ny)
            y.append(Theta @ (loop.J @ np.concatenate([x, u[-1]])) + w)
            x = window.core.advance(x, y[-1], u[-1])
        outputs.append(np.array(y))
        inputs.append(np.array(u))
    return outputs, inputs


def test_systems_with_filters():
    misses, runs = 0, sets(150, 10)
    for seed in range(runs):
        gen = np.random.default_rng([8, seed])
        ny, m, r = (int(gen.integers(1, most + 1)) for most in (2, 2, 3))
        pole = float(gen.choice([0.2, 0.5, 0.7, 0.85]))
        names = tuple(f"y{i}" for i in range(ny)), tuple(f"u{j}" for j in range(m))
        window = Regressors(*names, r, pole)
        while True:
            Theta = gen.standard_normal((ny, window.length)) / r
            radius = np.abs(np.linalg.eigvals(window.loop(Theta).ABc[:, :-m])).max()
            if radius < 1.02:
                break
        # starts at rest, the first reading and input 0: the filters are exact from the first row
        data = se.Trajectories(*filter_runs(gen, window, Theta, 10, 90, 0.3), outputs=True)
        model = se.identify(data, checks=False, window=se.Window(filters=(pole, r)))
        misses += missed(model, Theta)
    at_most(misses, runs)


def share_of_late_inputs(declared, sets_, accept=()):
    """In how many data sets of hidden systems with dead times of 1 to 3 steps the region misses."""
    missed_, found = 0, 0
    for seed in range(sets_):
        gen = np.random.default_rng([11, seed])
        for system in hidden.of_each_kind(gen, 3, 1, without=("tiny",)):
            (n, m), delay = system.B.shape, int(gen.integers(1, 4))
            states, inputs = [], []
            for _ in range(6):
                x, u = [gen.standard_normal(n)], list(np.zeros((delay, m)))
                for k in range(12 if system.kind == "unstable" else 40):
                    u.append(gen.standard_normal(m))
                    u[-1][0] -= 0.1 * np.clip(x[-1][0], -1.0, 1.0)
                    w = 0.1 * gen.standard_normal(n)
                    x.append(system.A @ x[-1] + system.B @ u[k] + w)
                states.append(np.array(x))
                inputs.append(np.array(u[delay:]))
            data = se.Trajectories(states, inputs)
            model = se.identify(
                data, accept=accept, checks=False, window=se.Window(delay=delay if declared else 0)
            )
            region = model.region(0.05)
            missed_ += region.bounded and not region.contains(system.A, system.B)
            found += 1
    return missed_, found


def test_states_with_a_declared_dead_time():
    at_most(*share_of_late_inputs(True, sets(60, 3)))


def test_states_with_a_dead_time_that_is_not_declared_have_no_region():
    count = sets(3, 2)
    assert share_of_late_inputs(False, count)[0] == 0
    missed_, found = share_of_late_inputs(False, count, ACCEPTED)
    assert missed_ > 0.5 * found


# -- state space with errors of reading: windows are exact only in the limit --------------------


def hidden_states(gen):
    """A, B, C and covariances of noise and readings; 2 to 4 states, 1 or 2 of them read."""
    n, ny = int(gen.integers(2, 5)), int(gen.integers(1, 3))
    A = gen.standard_normal((n, n))
    A *= gen.uniform(0.6, 0.98) / np.abs(np.linalg.eigvals(A)).max()
    B, C = gen.standard_normal((n, 1)), gen.standard_normal((ny, n))
    process, sensor = (np.exp(gen.uniform(*np.log(ends))) for ends in ((0.01, 0.3), (0.03, 1.0)))
    return A, B, C, process**2 * np.eye(n), sensor**2 * np.eye(ny)


def state_runs(gen, system, runs, steps, *, unlogged=None):
    """Runs with feedback from the readings, or by a gain from states that are not logged."""
    A, B, C, Q, R = system
    n, (process, sensor) = len(A), (np.sqrt(one[0, 0]) for one in (Q, R))
    K = 0.2 * gen.standard_normal((1, len(C))) if unlogged is None else unlogged
    dither = 1.0 if unlogged is None else 0.3
    outputs, inputs = [], []
    for _ in range(runs):
        x, y, u = gen.standard_normal(n), [], []
        for _ in range(steps + 1):
            y.append(C @ x + sensor * gen.standard_normal(len(C)))
            known = y[-1] if unlogged is None else x
            u.append(np.clip(-K @ known, -2.0, 2.0) + dither * gen.standard_normal(1))
            x = A @ x + B @ u[-1] + process * gen.standard_normal(n)
        outputs.append(np.array(y))
        inputs.append(np.array(u[:-1]))
    return se.Trajectories(outputs, inputs, outputs=True)


def share_missed(lags, count, accept=(), **options):
    misses = found = 0
    for seed in range(count):
        gen = np.random.default_rng([9, seed])
        system = hidden_states(gen)
        if lags * len(system[2]) < len(system[0]):
            continue
        data = state_runs(gen, system, 15, 120, **options)
        model = se.identify(data, accept=accept, checks=False, window=se.Window(lags=lags))
        misses += missed(model, unbiased(*system, lags)[0])
        found += 1
    return misses / found


def test_the_predictor_of_the_twin():
    A, B, C = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]]), np.array([[1.0, 0.0]])
    Q, R = 0.01 * B @ B.T, np.array([[1e-4]])
    np.testing.assert_allclose(kalman(A, C, Q, R)[1], 1.5625e-4, rtol=1e-10)
    Theta, error = unbiased(A, B, C, Q, R, 2)
    np.testing.assert_allclose(Theta, [[2.0, -1.0, 0.005, 0.005]], atol=1e-12)
    np.testing.assert_allclose(error, 6.005e-4, rtol=1e-10)
    expected = [1.334304746046, 0.3313905079089, -0.6656952539545, 0.005, 0.008328476269772]
    np.testing.assert_allclose(unbiased(A, B, C, Q, R, 3)[0][0, :5], expected, rtol=1e-10)
    np.testing.assert_allclose(unbiased(A, B, C, Q, R, 8)[1], 1.692627676503e-4, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("lags", "most"), [(12, 0.05), (16, 0.05)])
def test_systems_with_errors_of_reading(lags, most):
    assert share_missed(lags, sets(120, 12)) <= most


# -- what breaks them ----------------------------------------------------------------------------


@pytest.mark.slow
def test_windows_that_are_too_short_fail():
    assert share_missed(3, sets(120, 12), ACCEPTED) > 0.3


def test_a_controller_that_sees_what_is_not_logged_breaks_every_region():
    misses, runs = 0, sets(12, 4)
    for seed in range(runs):
        gen = np.random.default_rng([10, seed])
        A = np.array([[0.95, 0.3], [0.0, 0.9]])
        system = A, np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), 0.1 * np.eye(2), np.eye(1)
        gain = np.array([[0.1, 0.5]])
        data = state_runs(gen, system, 15, 120, unlogged=gain)
        misses += missed(
            se.identify(data, checks=False, window=se.Window(lags=12)), unbiased(*system, 12)[0]
        )
    assert misses / runs > 0.4


# -- windows that the data chose -----------------------------------------------------------------


def share_broken(count, **how):
    """In how many systems a noise-free run leaves the bounds of one step somewhere."""
    broken = 0
    for seed in range(count):
        gen = np.random.default_rng([15, seed])
        system = hidden_states(gen)
        model = se.identify(state_runs(gen, system, 20, 140), **opts(checks=False, **how))
        A, B, C, Q, R = system
        silent = state_runs(gen, (A, B, C, 0.0 * Q, 0.0 * R), 1, 140)
        rows = rows_of(model.window, silent)[1]
        region, d, n = model.region(0.05), model.window.length, model.n_outputs
        assert region.bounded
        errors = np.linalg.norm(rows[:, d:] - rows[:, :d] @ model.coefficients.T, axis=1)
        bounds = [region.bound(z[:n], z[n:d]) for z in rows[:, :d]]
        broken += bool((errors > bounds).any())
    return broken / count


def test_windows_that_the_first_part_chooses():
    """Of 340 sets 6 are broken, 5 by the same rule in plain NumPy; a tube of 10 steps in one."""
    count = sets(60, 8)
    assert share_broken(count) <= max(0.05, 1 / count)


def test_one_lag_is_no_window():
    assert share_broken(sets(30, 8), lags=1, accept=ACCEPTED) > 0.3
