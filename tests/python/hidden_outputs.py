"""Hidden systems that are read through outputs, and runs of them."""

from __future__ import annotations

from functools import cache

import numpy as np

import stochens_rs as se


class Arx:
    """``y(t+1) = sum A_i y(t-i) + sum B_i u(t-i) + w(t+1)``, w of covariance L L'."""

    def __init__(self, rng):
        p, m, lags = rng.integers(1, 4), rng.integers(1, 3), rng.integers(1, 5)
        self.p, self.m, self.lags = int(p), int(m), int(lags)
        # A(q) of matrices with poles of radius up to 1.02
        radius = rng.uniform(0.5, 1.02)
        while True:
            A = rng.standard_normal((lags, p, p)) / np.arange(1, lags + 1)[:, None, None]
            C = np.eye(p * lags, k=-p)
            C[:p] = np.hstack(A)
            size = np.abs(np.linalg.eigvals(C)).max()
            if size > 0.1:
                break
        self.A = A * (radius / size) ** np.arange(1, lags + 1)[:, None, None]
        self.B = rng.standard_normal((lags, p, m)) / np.arange(1, lags + 1)[:, None, None]
        self.L = 0.1 * np.tril(rng.uniform(0.3, 1.0, (p, p)))
        self.K = 0.1 * rng.standard_normal((m, p))

    def follow(self, y, u, inputs, rng, noise=1.0):
        """Outputs (K, p) under these inputs after a record."""
        y, u, K = list(y), list(u), len(inputs)
        for v in inputs:
            u.append(v)
            past = range(self.lags)
            mean = sum(self.A[i] @ y[-1 - i] + self.B[i] @ u[-1 - i] for i in past)
            y.append(mean + noise * self.L @ rng.standard_normal(self.p))
        return np.array(y[len(y) - K :])

    def runs(self, count, steps, rng):
        """Readings (count, steps + 1, p) and inputs (count, steps, m): saturated feedback, dither.

        All runs advance together; each takes its numbers from `rng` behind those of the last.
        """
        p, m, lags = self.p, self.m, self.lags
        ends = np.cumsum([lags * p, (lags - 1) * m])
        z = rng.standard_normal((count, ends[1] + (steps + 1 - lags) * (m + p)))
        y, u = np.zeros((count, steps + 1, p)), np.zeros((count, steps, m))
        y[:, :lags] = z[:, : ends[0]].reshape(count, lags, p)
        u[:, : lags - 1] = z[:, ends[0] : ends[1]].reshape(count, lags - 1, m)
        later = z[:, ends[1] :].reshape(count, -1, m + p)
        for t in range(lags, steps + 1):
            dither, noise = np.split(later[:, t - lags], [m], axis=1)
            u[:, t - 1] = np.clip(y[:, t - 1] @ self.K.T, -1.0, 1.0) + dither
            y[:, t] = noise @ self.L.T
            for i in range(lags):
                y[:, t] += y[:, t - 1 - i] @ self.A[i].T + u[:, t - 1 - i] @ self.B[i].T
        return y, u

    def run(self, steps, rng):
        """One of `runs`."""
        (y,), (u,) = self.runs(1, steps, rng)
        return y, u

    def data(self, count, steps, rng):
        y, u = self.runs(count, steps, rng)
        return se.Trajectories(list(y), list(u), outputs=True)

    def model(self, count, steps, rng):
        """Least squares of such runs over as many lags."""
        window = se.Window(lags=self.lags)
        return se.identify(self.data(count, steps, rng), checks=False, window=window)


def one_log(ahead, seed, steps=300, sizes=(1, 1), noise=0.05, lags=1):
    """Readings and inputs of ``y(t+1) = ahead(y, u) + noise``, from all of both up to t."""
    rng = np.random.default_rng(seed)
    y, u = np.zeros((steps, sizes[0])), rng.standard_normal((steps - 1, sizes[1]))
    for t in range(lags - 1, steps - 1):
        y[t + 1] = ahead(y[: t + 1], u[: t + 1]) + noise * rng.standard_normal(sizes[0])
    return y, u


def of_lags(y, u, lags=1, **options):
    """A model of one log."""
    data = se.Trajectories([y], [u], outputs=True)
    return se.identify(data, window=se.Window(lags=lags), **options)


class Rig:
    """A cart with a pole at 50 Hz: position (noise 0.3 mm) and angle (0.5 mrad) are read.

    1 kg, 0.2 kg at 0.5 m, friction 0.5 N s / m, force noise 0.02 N.
    """

    def __init__(self):
        M, m, arm, b, g, dt = 1.0, 0.2, 0.5, 0.5, 9.81, 0.02
        A = np.zeros((5, 5))
        A[0, 2] = A[1, 3] = 1.0
        A[2, 1:3], A[2, 4] = [-m * g / M, -b / M], 1.0 / M
        A[3, 1:3], A[3, 4] = [(M + m) * g / (M * arm), b / (M * arm)], -1.0 / (M * arm)
        whole, term = np.eye(5), np.eye(5)
        for k in range(1, 30):
            term = term @ A * dt / k
            whole = whole + term
        self.A, self.B = whole[:4, :4], whole[:4, 4]
        self.noise = np.array([3e-4, 5e-4])

    def simulate(self, act, steps, rng, x0, force=0.0, noise=1.0):
        """Readings (steps + 1, 2) and inputs (steps, 1) of a controller of readings."""
        x, y, u = np.array(x0, dtype=float), [], []
        for _ in range(steps):
            y.append(x[:2] + noise * self.noise * rng.standard_normal(2))
            u.append(float(act(y[-1])))
            x = self.A @ x + self.B * (u[-1] + force + noise * 0.02 * rng.standard_normal())
        y.append(x[:2] + noise * self.noise * rng.standard_normal(2))
        return np.array(y), np.array(u)[:, None]

    def logger(self, dither):
        """A feedback from filtered differences, with a ``dither()`` of 1 N; runs may lead."""
        before, v = None, 0.0

        def act(y):
            nonlocal before, v
            v = np.zeros_like(y) if before is None else 0.6 * v + 0.4 * (y - before) / 0.02
            before = y
            known = np.concatenate([y, v], axis=-1) @ [1.5, 28.0, 2.6, 5.0]
            return np.clip(known + dither(), -10.0, 10.0)

        return act

    def data(self, runs, rng, steps=150):
        """Logged runs, which advance together; each draws behind the last."""
        x = rng.standard_normal((runs, 4)) * [0.05, 0.02, 0.05, 0.05]
        z = rng.standard_normal((runs, 4 * steps + 2))
        dithers = iter(z[:, 2:-2:4].T)
        act = self.logger(lambda: next(dithers))
        y, u = np.zeros((runs, steps + 1, 2)), np.zeros((runs, steps, 1))
        for t in range(steps + 1):
            y[:, t] = x[:, :2] + self.noise * z[:, 4 * t : 4 * t + 2]
            if t < steps:
                u[:, t, 0] = act(y[:, t])
                x = x @ self.A.T + (u[:, t] + 0.02 * z[:, 4 * t + 3 : 4 * t + 4]) * self.B
        names = {"state_names": ["pos", "angle"], "input_names": ["force"]}
        return se.Trajectories(list(y), list(u), dt=0.02, outputs=True, **names)


class Belt:
    """A belt drive at 250 Hz: motor angle [rad] and load [mm], 10 mm/rad; it integrates.

    Two outputs, one input [A]; read with noise of 1 mrad and 20 um.
    """

    def __init__(self):
        J, k, c, d, kt = 1e-3, 0.4, 0.004, 0.004, 0.05
        A = np.zeros((5, 5))
        A[0, 2] = A[1, 3] = 1.0
        A[2] = np.array([-k, k, -(c + d), c, kt]) / J
        A[3] = np.array([k, -k, c, -(c + d), 0.0]) / J
        whole, term = np.eye(5), np.eye(5)
        for j in range(1, 40):
            term = term @ A * 0.004 / j
            whole = whole + term
        self.A, self.B = whole[:4, :4], whole[:4, 4]
        self.C = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 10.0, 0.0, 0.0]])
        self.noise = np.array([1e-3, 2e-2])

    def simulate(self, act, steps, rng, noise=1.0):
        """Readings (steps, 2), inputs (steps, 1) and true positions (steps, 2) of a controller."""
        x, y, u, true = np.zeros(4), [], [], []
        for _ in range(steps):
            true.append(self.C @ x)
            y.append(true[-1] + noise * self.noise * rng.standard_normal(2))
            u.append(np.atleast_1d(act(y[-1])))
            push = noise * 0.02 * rng.standard_normal(2)
            x = self.A @ x + self.B * u[-1] + np.array([0.0, 0.0, *push])
        return np.array(y), np.array(u), np.array(true)

    def data(self, runs, rng, steps=500):
        """Logged runs between two places."""
        y, u = [], []
        for _ in range(runs):
            place, k = rng.uniform(-4.0, 4.0), 0

            def act(read, place=place):
                nonlocal k
                k += 1
                goal = place if (k // 100) % 2 == 0 else -place
                return np.clip(0.6 * (goal - read[0]) + 0.6 * rng.standard_normal(), -3.0, 3.0)

            read, acted, _ = self.simulate(act, steps, rng)
            y.append(read)
            u.append(acted[:-1])
        names = {"state_names": ["phi", "load"], "input_names": ["amps"]}
        return se.Trajectories(y, u, dt=0.004, outputs=True, **names)


@cache
def regulated_belt():
    """The belt, a model of runs of it, and a gain."""
    plant = Belt()
    data = plant.data(8, np.random.default_rng(1))
    model = se.identify(data, accept="memory", checks=False, window=se.Window(filters=(0.6, 4)))
    return plant, model, se.gain(model, [100.0, 1.0], 1.0)
