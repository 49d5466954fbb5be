"""Set points, ramps, spikes and missing readings, beside least squares, python-control and OSQP.

    python benches/set_points.py [runs]

Two plants that no other file has: a belt drive (motor encoder, slow camera, friction, 4 ms) and an
oven (2 heaters, 3 sensors, radiation, 10 s). Both ways get the same CSV files with lost rows and a
limit of the inputs, and close the loop on the same runs: noise, forces and faults have the same
seeds. Needs `pip install control osqp pandas scipy`.
"""

from __future__ import annotations

import inspect
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import control
import numpy as np
import osqp
import pandas as pd
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import block_diag

import stochens_rs as se

Floats = NDArray[np.float64]


class Belt:
    """Motor [rad] with friction, a load [mm] on a belt of 10 mm a radian, a camera of 15 ms."""

    dt, low, high, outputs, inputs = 0.004, -3.0, 3.0, ["motor", "load"], ["amps"]
    rows, files, size, held, ramp = 1000, 20, 0.5, {"load": 40.0}, 20.0  # mm a second
    failure, unit, spike = 5.0, "mm", 80.0
    weights = ([0.01, 1.0], [1.0])

    def __init__(self, seed: list[int]) -> None:
        self.rng, self.x, self.seen = np.random.default_rng(seed), np.zeros(4), 0.0
        self.force = self.rng.uniform(-0.3, 0.3)  # all the time, in amperes; the logs have none

    def read(self) -> Floats:
        return self.shown() + [2e-3, 0.15] * self.rng.standard_normal(2)

    def shown(self) -> Floats:
        return np.array([self.x[0], self.seen])

    def true(self) -> Floats:
        return self.x[[0, 2]]

    def step(self, u: Floats) -> None:
        push = u[0] + self.force + 0.02 * self.rng.standard_normal()
        for _ in range(8):
            motor, speed, load, pace = self.x
            pull = 2500.0 * (10.0 * motor - load) + 8.0 * (10.0 * speed - pace)
            rub = 15.0 * speed + 8.0 * np.tanh(speed / 0.05)
            away = np.array([speed, 300.0 * push - rub - 0.03 * pull, pace, pull])
            self.x = self.x + self.dt / 8 * away
            self.seen += self.dt / 8 / 0.015 * (self.x[2] - self.seen)

    def logger(self, y: Floats, wanted: float) -> Floats:
        return np.array([0.8 * (3.0 * wanted - y[0])])


class Oven:
    """Three zones [K over the hall], heaters at both ends, radiation, sensors that lag by 20 s."""

    dt, low, high, outputs, inputs = 10.0, 0.0, 4.0, ["left", "middle", "right"], ["one", "two"]
    rows, files, size, held, ramp = 500, 10, 0.5, {"left": 180.0, "right": 160.0}, 0.05  # K / s
    failure, unit, spike = 20.0, "K", 300.0
    weights = ([1.0, 0.01, 1.0], [10.0, 10.0])

    def __init__(self, seed: list[int]) -> None:
        self.rng = np.random.default_rng(seed)
        self.x, self.seen = np.full(3, 150.0), np.full(3, 150.0)
        self.force = self.rng.uniform(-0.1, 0.1, 2)  # kW of each heater

    def shown(self) -> Floats:
        return self.seen

    def read(self) -> Floats:
        return self.shown() + 0.3 * self.rng.standard_normal(3)

    def true(self) -> Floats:
        return self.x

    def step(self, u: Floats) -> None:
        one, two = u + self.force + 0.02 * self.rng.standard_normal(2)
        for _ in range(5):
            flow = 6e-3 * np.diff(self.x)  # kW
            loss = 4e-3 * self.x + 5.67e-12 * ((self.x + 293.0) ** 4 - 293.0**4)
            into = np.array([one + flow[0], flow[1] - flow[0], two - flow[1]]) - loss
            self.x = self.x + 2.0 * into / [3.0, 2.0, 3.5]
            self.seen = self.seen + 0.1 * (self.x - self.seen)

    def logger(self, y: Floats, wanted: float) -> Floats:
        return 1.2 + 0.02 * (150.0 + 20.0 * wanted - y[[0, 2]])


def write(kind: type, folder: Path) -> None:
    """Logs: a controller with steps of its target, dither, lost rows and empty cells."""
    for number in range(kind.files):
        plant, wanted = kind([1, number]), 0.0
        rng, plant.force = plant.rng, 0.0 * plant.force
        lines = [",".join(["time [s]", *kind.outputs, *kind.inputs])]
        for k in range(kind.rows):
            wanted = rng.uniform(-1.0, 1.0) if k % 60 == 0 else wanted
            y = plant.read()
            dither = kind.size * rng.standard_normal(len(kind.inputs))
            u = np.clip(plant.logger(y, wanted) + dither, kind.low, kind.high).round(4)
            cells = [f"{one:.4f}" for one in y]
            if rng.random() < 0.002:
                cells[-1] = ""
            if rng.random() >= 0.002:
                lines.append(",".join([f"{kind.dt * k:.3f}", *cells, *map(str, u)]))
            plant.step(u)
        (folder / f"log_{number}.csv").write_text("\n".join(lines) + "\n")


def ours(kind: type, folder: Path) -> se.loops.ReadingLoop:
    columns = {"outputs": kind.outputs, "inputs": kind.inputs, "time": "time"}
    data = se.Trajectories.from_csv(folder, **columns)
    accept = ("memory", "dead time", "nonlinear") if kind is Belt else ()
    model = se.identify(
        data, window=se.Window(lags=12), intercept=kind is Oven, accept=accept, checks=False
    )
    gain = se.gain(model, *kind.weights)
    limits = (kind.low, kind.high)
    return se.regulate(gain, target=kind.held, limits=limits, offset_free=True)


class Theirs:
    """ARX by least squares, its states with a disturbance of the inputs in a Kalman filter, MPC."""

    def __init__(self, kind: type, folder: Path, lags: int = 12, steps: int = 25) -> None:
        names, p, m = kind.outputs + kind.inputs, len(kind.outputs), len(kind.inputs)
        rows, n = [], lags * (p + m)
        for path in sorted(folder.glob("*.csv")):
            log = pd.read_csv(path).set_index("time [s]")
            log = log.reindex(np.arange(kind.rows) * kind.dt, method="nearest", tolerance=1e-4)
            part = log[names].interpolate().bfill().to_numpy()
            past = [part[lags - 1 - k : len(part) - 1 - k] for k in range(lags)]
            z = [one[:, :p] for one in past] + [one[:, p:] for one in past]
            rows.append(np.hstack([*z, part[lags:, :p]]))
        table = np.vstack(rows)
        self.mean = table.mean(axis=0)
        table = table - self.mean
        theta = np.linalg.lstsq(table[:, :n], table[:, n:], rcond=None)[0].T
        noise = np.cov((table[:, n:] - table[:, :n] @ theta.T).T)
        size = n - m  # states: lags of y, then of u before now
        A, B = np.zeros((size, size)), np.zeros((size, m))
        A[:p] = np.hstack([theta[:, : lags * p], theta[:, lags * p + m :]])
        B[:p] = theta[:, lags * p : lags * p + m]
        A[p : lags * p, : (lags - 1) * p] = np.eye((lags - 1) * p)
        B[lags * p : lags * p + m] = np.eye(m)
        A[lags * p + m :, lags * p : -m] = np.eye((lags - 2) * m)
        self.A = np.block([[A, B], [np.zeros((m, size)), np.eye(m)]])
        self.B, self.C = np.vstack([B, np.zeros((m, m))]), np.eye(p, size + m)
        walk = 1e-6 * (kind.high - kind.low) ** 2 * np.eye(m)
        Q = block_diag(noise, 1e-9 * np.eye(size - p), walk)
        self.R = 1e-2 * noise
        P = control.dlqe(self.A, np.eye(size + m), self.C, Q, self.R)[1]
        self.S = self.C @ P @ self.C.T + self.R
        self.L = P @ self.C.T @ np.linalg.inv(self.S)
        weights, self.p, self.m, self.n = np.diag(kind.weights[0]), p, m, size
        R, Qx = np.diag(kind.weights[1]), self.C[:, :size].T @ weights @ self.C[:, :size]
        _, S, _ = control.dlqr(A, B, Qx + 1e-6 * np.eye(size), R)
        F = np.vstack([np.linalg.matrix_power(A, k + 1) for k in range(steps)])
        G, W = np.zeros((steps * size, steps * m)), block_diag(*[Qx] * (steps - 1), S)
        for k in range(steps):
            for j in range(k + 1):
                block = np.linalg.matrix_power(A, k - j) @ B
                G[k * size : (k + 1) * size, j * m : (j + 1) * m] = block
        H = G.T @ W @ G + block_diag(*[R] * steps)
        self.f, self.solver = G.T @ W @ F, osqp.OSQP()
        ones = np.ones(steps * m)
        self.solver.setup(
            sparse.csc_matrix(np.triu(H)), 0 * ones, sparse.eye(steps * m, format="csc"),
            kind.low * ones, kind.high * ones, verbose=False, eps_abs=1e-4, eps_rel=1e-4,
        )  # fmt: skip
        self.kind, self.here = kind, self.mean[n - m * lags : n - m * lags + m]
        self.rest = np.block([[A - np.eye(size), B], [self.C[:, :size], np.zeros((p, m))]])

        self.reset()

    def reset(self) -> None:
        self.x, self.u, self.bad, self.k = np.zeros(self.n + self.m), None, 0, 0

    def __call__(self, y: Floats) -> Floats:
        held = [self.kind.outputs.index(name) for name in self.target]
        wanted = np.array([each[self.k] for each in self.target.values()]) - self.mean[held]
        self.k += 1
        if self.u is not None:
            self.x = self.A @ self.x + self.B @ self.u
        off = y - self.mean[: self.p] - self.x[: self.p]
        false = (np.abs(off) > 6.0 * np.sqrt(np.diag(self.S))) & (self.bad < 5)
        self.bad = self.bad + 1 if false.any() else 0
        self.x = self.x + self.L @ np.where(np.isfinite(off) & ~false, off, 0.0)
        x, d = np.split(self.x, [self.n])
        keep = np.r_[np.arange(self.n), self.n + np.array(held)]
        right = np.concatenate([-self.A[: self.n, self.n :] @ d, wanted])
        point = np.linalg.lstsq(self.rest[keep], right, rcond=None)[0]
        xs, us = np.split(point, [self.n])
        us = np.clip(us, self.kind.low - self.here, self.kind.high - self.here)
        ends = [
            np.tile(end - self.here - us, len(self.f) // self.m)
            for end in (self.kind.low, self.kind.high)
        ]
        self.solver.update(q=self.f @ (x - xs), l=ends[0], u=ends[1])
        found = self.solver.solve().x[: self.m] + us
        self.u = np.clip(found, self.kind.low - self.here, self.kind.high - self.here)
        return self.u + self.here


EVENTS = ("set points", "ramp", "spikes", "missing")


def run(kind: type, loop: Any, event: str, seed: int, calls: int = 900) -> Floats:
    """Of what has a target: how far off its mean is at the end, the largest, and the time.

    Both of what the sensors show without noise, as neither way can know how late they are, and the
    largest of the plant itself, too.
    """
    rng, plant = np.random.default_rng([2, seed]), kind([3, seed])
    off, real, spent = [], [], []
    held = [kind.outputs.index(name) for name in kind.held]
    way = np.tile(list(kind.held.values()), (calls, 1))
    if event == "ramp":
        far = kind.ramp * kind.dt * np.maximum(0.0, np.arange(calls) - 100.0)[:, None]
        begin = plant.true()[held]
        way = begin + np.clip(way - begin, -far, far)
    loop.reset()
    loop.target = dict(zip(kind.held, way.T, strict=True))
    for wanted in way:
        y = plant.read()
        if event == "spikes" and rng.random() < 0.02:
            y[rng.integers(len(y))] += kind.spike * rng.choice([-1.0, 1.0])
        if event == "missing":
            y[rng.random(len(y)) < 0.2] = np.nan
        start = time.perf_counter()
        u = loop(y)
        spent.append(time.perf_counter() - start)
        plant.step(u)
        off.append(plant.shown()[held] - wanted)
        real.append(plant.true()[held] - wanted)
    away, far = (np.abs(one[100 if event == "ramp" else calls // 2 :]) for one in (off, real))
    end = np.abs(np.mean(off[-calls // 4 :], axis=0)).max()
    return np.array([end, away.max(), far.max(), np.median(spent)])


def main(kinds: tuple[type, ...] = (Belt, Oven)) -> None:
    """Print the table, and the lines of both ways."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    for kind in kinds:
        with tempfile.TemporaryDirectory() as name:
            write(kind, Path(name))
            loops = {"ours": ours(kind, Path(name)), "theirs": Theirs(kind, Path(name))}
            proof = loops["ours"].certificate(0.05)
            print(f"\n{kind.__name__}: {runs} runs each; {proof.status}, {proof.margin:.2f}")
            heads = "held", "largest", "largest of all", "plant", "failures", "call"
            print(f"| {kind.unit} | way | {' | '.join(heads)} |")
            print(f"|---|---|{'---:|' * len(heads)}")
            for event in "set points", "ramp", "spikes", "missing":
                for way, loop in loops.items():
                    found = [run(kind, loop, event, seed) for seed in range(runs)]
                    held, most, far, spent = np.array(found).T
                    lost = int(np.sum(~(far < kind.failure)))
                    print(
                        f"| {event} | {way} | {np.median(held):.3f} | {np.median(most):.2f} | "
                        f"{most.max():.2f} | {np.median(far):.2f} | {lost} | "
                        f"{1e6 * np.median(spent):.0f} us |"
                    )
    for made in (ours, Theirs):
        print(made.__name__, len(inspect.getsource(made).splitlines()), "lines")


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
