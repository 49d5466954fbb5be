"""`design`: the oracle of the formula, the best of all vertices, what it gains, what it refuses."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs import _core
from test_typical import A, B, data

pytestmark = pytest.mark.usefixtures("noise_by_formula")

KEY = bytes(range(32))
H0 = np.array([[0.8, 0.1, 0.1], [0.0, 0.9, 0.9]])


def simulated(x0, u) -> np.ndarray:
    """The rows z of a run of H0."""
    rows = []
    for inputs in u:
        rows.append(np.concatenate([x0, inputs]))
        x0 = H0 @ rows[-1]
    return np.array(rows)


def instruments() -> np.ndarray:
    """Three runs of four steps of H0 from integers."""
    rows = []
    for r in range(3):
        x0 = [(((3 * r + 2 * i + 1) ** 2) % 7 - 3) / 2 for i in range(2)]
        rows.append(simulated(x0, [[((2 * r + 1) * (k + 2) ** 2) % 5 - 2.0] for k in range(4)]))
    return np.vstack(rows)


def psi() -> np.ndarray:
    """``sum_jk tr(A^{p_j} A^{p_k}') z_j z_k'`` of the plan, by its definition."""
    z = simulated([1.0, -1.0], [[0.4], [0.1], [-0.4]])
    powers = [np.linalg.matrix_power(H0[:, :2], 2 - j) for j in range(3)]
    found = np.zeros((3, 3))
    for j, k in itertools.product(range(3), repeat=2):
        found += np.trace(powers[j] @ powers[k].T) * np.outer(z[j], z[k])
    return found


def asked(V, starts, steps, low=-1.0, high=1.0):
    white = np.linalg.inv(np.linalg.cholesky(V))
    return _core.next_runs(
        H0, white, np.eye(2), np.array([1.0, -1.0]), np.array([[0.4], [0.1], [-0.4]]),
        np.array(starts), steps, np.full((steps, 1), low), np.full((steps, 1), high), KEY,
    )  # fmt: skip


def test_the_formula_and_the_best_vertex() -> None:
    """Values that two other codes computed."""
    zeta = instruments()
    V, P = zeta.T @ zeta, psi()
    assert np.linalg.det(V) == pytest.approx(9818.701109004, rel=1e-12)
    entries = [P[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (2, 2))]
    np.testing.assert_allclose(entries, [7.324512, -6.092304, 5.068064, 0.010376], rtol=1e-12)
    inputs, phi = asked(V, [[1.0, -1.0]], 3)
    assert phi[0] == pytest.approx(1.741562977059, rel=1e-12)
    M = np.linalg.inv(V) @ P @ np.linalg.inv(V)
    z = simulated([1.0, -1.0], inputs.reshape(3, 1))
    assert np.trace(M @ z.T @ z) == pytest.approx(1.385365029221, rel=1e-12)
    assert inputs[0].tolist() == [-1.0, -1.0, -1.0]
    every = []
    for u in itertools.product((-1.0, 1.0), repeat=3):
        z = simulated([1.0, -1.0], np.array(u)[:, None])
        every.append(np.trace(P @ np.linalg.inv(V + z.T @ z)))
    assert phi[1] == pytest.approx(min(every), rel=1e-12)


def test_many_runs_against_the_definition() -> None:
    """50 random V and starts, runs of 4 steps: near the best vertex of each run in turn."""
    gen, lost = np.random.default_rng(1), []
    P = psi()
    for _ in range(50):
        G = gen.standard_normal((3, 6))
        V, starts = G @ G.T, gen.standard_normal((3, 2))
        inputs, phi = asked(V, starts, 4, -0.5, 1.0)
        for r, (start, u) in enumerate(zip(starts, inputs, strict=True)):
            assert phi[r] == pytest.approx(np.trace(P @ np.linalg.inv(V)), rel=1e-9)
            assert set(u) <= {-0.5, 1.0}
            M = np.linalg.inv(V) @ P @ np.linalg.inv(V)
            values = []
            for v in [u, *itertools.product((-0.5, 1.0), repeat=4)]:
                z = simulated(start, np.array(v)[:, None])
                values.append(np.trace(M @ z.T @ z))
            lost.append(1.0 - values[0] / max(values))
            z = simulated(start, u[:, None])
            V = V + z.T @ z
    assert np.mean(np.array(lost) < 1e-9) > 0.9
    assert np.mean(lost) < 0.02


def test_the_forecast_and_what_is_gained() -> None:
    """40 sets: the executed certificate near the forecast, and below that of random inputs."""
    gen, ratios, gains = np.random.default_rng(2), [], []
    for seed in range(40):
        before = data(6, 8, seed=100 + seed)
        model = se.identify(before, checks=False, noise=se.Noise(sigma=0.1))
        plan = se.control(model, [1.0, 0.5], [0.0, 0.0], steps=5)
        more = se.design(plan, 20, limits=(-1.0, 1.0), x0=[0.0, 0.0])
        assert more.forecast[0] == pytest.approx(plan.bound().target, rel=1e-12)
        assert (np.diff(more.forecast) < 0.0).all()
        found = []
        for u in (more.inputs, np.clip(gen.standard_normal(more.inputs.shape), -1.0, 1.0)):
            x = np.zeros((20, 6, 2))
            for k in range(5):
                x[:, k + 1] = x[:, k] @ A.T + u[:, k] @ B.T + 0.1 * gen.standard_normal((20, 2))
            states = [*(x for x, _ in before.runs), *x]
            both = se.Trajectories(states, [*(u for _, u in before.runs), *u])
            later = se.identify(both, checks=False, noise=se.Noise(sigma=0.1))
            found.append(se.control(later, [1.0, 0.5], [0.0, 0.0], steps=5).bound().target)
        ratios.append(found[0] / more.forecast[-1])
        gains.append(found[0] / found[1])
    assert 0.85 < np.median(ratios) < 1.15
    assert np.median(gains) < 0.9


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
@pytest.mark.parametrize("window", [se.Window(lags=2, delay=1), se.Window(filters=(0.5, 2))])
def test_runs_of_readings(window) -> None:
    """20 logs more: the definition in z, and a smaller error of the model than random inputs."""
    gen = np.random.default_rng(5)

    def logs(inputs):
        outputs = np.zeros((len(inputs), inputs.shape[1] + 1, 2))
        for t in range(inputs.shape[1]):
            moved = outputs[:, t] @ [[0.9, 0.0], [0.2, 0.8]] - 0.1 * outputs[:, max(t - 1, 0)]
            moved[:, 1] += 0.3 * inputs[:, max(t - 1, 0), 0]
            outputs[:, t + 1] = moved + 0.05 * gen.standard_normal(moved.shape)
        return list(outputs), list(inputs)

    def identified(*some):
        outputs, inputs = ([*itertools.chain(*each)] for each in zip(*some, strict=True))
        data = se.Trajectories(outputs, inputs, outputs=True)
        return se.identify(data, window=window, checks=False, accept=["memory"])

    first = logs(gen.uniform(-1.0, 1.0, (30, 20, 1)))
    model = identified(first)
    plan = se.predict(model, record="rest", inputs=np.full((8, 1), 0.5))
    more = se.design(plan, 20, limits=(-1.0, 1.0), steps=20)
    assert set(more.inputs.ravel()) == {-1.0, 1.0}
    # phi = tr Psi V^-1 in z = J (x, u, 1), before and after the first run
    J, AB, G = model.loop
    n, covariance = model.n, G @ model.covariance @ G.T
    A = AB[:, :n]

    def rows(x, u):
        found = []
        for one in u:
            found.append(J @ np.r_[x, one, np.ones(J.shape[1] - n - 1)])
            x = AB @ np.r_[x, one, np.ones(J.shape[1] - n - 1)]
        return np.array(found)

    z = rows(plan.basis.x0, plan.u)
    powers = [np.linalg.matrix_power(A, 7 - j) for j in range(8)]
    weight = [[np.trace(p @ covariance @ q.T) for q in powers] for p in powers]
    white = model.blocks[0].white
    Psi, V = z.T @ weight @ z, np.linalg.inv(white.T @ white)
    own = rows(more.starts[0], more.inputs[0])
    phi = [np.trace(Psi @ np.linalg.inv(one)) for one in (V, V + own.T @ own)]
    bound = plan.bound()
    fixed = sum(part for name, part in bound.parts.items() if name != "model error")
    falls = (more.forecast[:2] - fixed) / bound.parts["model error"]
    np.testing.assert_allclose(falls, np.sqrt(np.array(phi) / phi[0]), rtol=1e-6)
    error = []
    for inputs in (more.inputs, gen.uniform(-1.0, 1.0, more.inputs.shape)):
        later = se.predict(identified(first, logs(inputs)), record="rest", inputs=plan.u)
        error.append(later.bound().parts["model error"])
    assert error[0] < 0.85 * error[1]
    with pytest.raises(se.exceptions.InputError, match="`x0` must be left out"):
        se.design(plan, 2, limits=(-1.0, 1.0), x0=np.zeros(n))
