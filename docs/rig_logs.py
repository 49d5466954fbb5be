"""The logs of logs.md and readings.md: python docs/rig_logs.py writes them, always the same.

A pendulum on a cart, not linearized, is held upright at 50 Hz by a feedback with 1 N of dither, for
16 runs of 3 s. The force acts one sample late. The logger loses rows and cells by chance, and its
stamps jitter while the sampling does not.

docs/data/readings are 40 runs of the same rig with less noise, of which only position and angle are
read, with errors: speeds are not in these logs, and the feedback has none but filtered differences.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
CART, MASS, ROD, FRICTION, GRAVITY = 1.0, 0.2, 0.5, 0.5, 9.81  # [kg], [kg], [m], [N s/m], [m/s^2]
DT, FINE = 0.02, 20  # sampling [s], and parts of it in which the noise is drawn
RUNS, ROWS = 16, 150
FORCE, TORQUE = 0.02, 0.01  # noise of a sample: what it adds to speed [m/s] and rate [rad/s]
LOST, EMPTY, JITTER = 0.012, 0.004, 0.1  # of the rows, of the angles, of a sample
CALM = 25  # how many times less noise the runs of READINGS have
READ = np.array([3e-4, 5e-4])  # errors of reading [m], [rad]
FOLDER = Path(__file__).parent / "data" / "logs"
READINGS = FOLDER.parent / "readings"
HEAD = "time [s],position [m],angle [rad],speed [m/s],rate [rad/s],force [N]"


def sample(x: Floats, force: float, noise: Floats) -> Floats:
    """One sample later, by Euler's method with the noise (FINE, 2) of speed and rate."""
    x = x.copy()
    for w in noise:
        s, c = np.sin(x[1]), np.cos(x[1])
        push = force - FRICTION * x[2]
        total = CART + MASS * s * s
        cart = (push + MASS * s * (ROD * x[3] ** 2 - GRAVITY * c)) / total
        turn = (GRAVITY * s * (CART + MASS) - c * (push + MASS * ROD * x[3] ** 2 * s)) / (
            ROD * total
        )
        x += DT / FINE * np.array([x[2], x[3], cart, turn])
        x[2:] += w
    return x


def linear() -> tuple[Floats, Floats]:
    """A and B about the upright position, by central differences."""
    still, step = np.zeros((FINE, 2)), 1e-6
    columns = []
    for i in range(5):
        d = np.eye(5)[i] * step
        columns.append((sample(d[:4], d[4], still) - sample(-d[:4], -d[4], still)) / (2 * step))
    both = np.array(columns).T
    return both[:, :4], both[:, 4:]


def feedback() -> Floats:
    """The gain of least cost (Riccati, 500 steps), where the last force is a state."""
    A, B = linear()
    late = np.block([[A, B], [np.zeros((1, 5))]])
    b, P, K = np.eye(5)[:, 4:], np.eye(5), np.zeros((1, 5))
    for _ in range(500):
        K = np.linalg.solve(0.1 + b.T @ P @ b, b.T @ P @ late)
        P = np.diag([10.0, 10.0, 1.0, 1.0, 0.0]) + late.T @ P @ (late - b @ K)
    return K


def main() -> None:
    """Write the files."""
    rng, K = np.random.default_rng(7), feedback()
    FOLDER.mkdir(parents=True, exist_ok=True)
    size = np.array([FORCE, TORQUE]) / np.sqrt(FINE)
    for run in range(RUNS):
        x, last = rng.standard_normal(4) * [0.1, 0.03, 0.05, 0.05], 0.0
        lines = [HEAD]
        for k in range(ROWS):
            force = round(float((-K @ np.append(x, last))[0]) + rng.standard_normal(), 5)
            stamp = 100.0 * run + DT * (k + JITTER * rng.uniform(-1.0, 1.0))
            angle = "" if rng.random() < EMPTY else f"{x[1]:.7f}"
            cells = [f"{stamp:.4f}", f"{x[0]:.7f}", angle, f"{x[2]:.6f}", f"{x[3]:.6f}"]
            if k == 0 or rng.random() >= LOST:
                lines.append(",".join([*cells, f"{force:.5f}"]))
            x = sample(x, last, size * rng.standard_normal((FINE, 2)))
            last = force
        (FOLDER / f"run_{run + 1}.csv").write_text("\n".join(lines) + "\n")


def readings() -> None:
    """Write the files of readings."""
    rng, K = np.random.default_rng(8), feedback()
    READINGS.mkdir(parents=True, exist_ok=True)
    size = np.array([FORCE, TORQUE]) / np.sqrt(FINE) / CALM
    for run in range(40):
        x, last, v, before = (
            rng.standard_normal(4) * [0.1, 0.03, 0.05, 0.05],
            0.0,
            np.zeros(2),
            None,
        )
        lines = ["time [s],position [m],angle [rad],force [N]"]
        for k in range(ROWS):
            y = np.round(x[:2] + READ * rng.standard_normal(2), 6)
            v = v if before is None else 0.6 * v + 0.4 * (y - before) / DT
            force = round(
                float((-K @ np.concatenate([y, v, [last]]))[0]) + rng.standard_normal(), 5
            )
            if k == 0 or rng.random() >= LOST / 4:
                lines.append(f"{100.0 * run + DT * k:.2f},{y[0]:.6f},{y[1]:.6f},{force:.5f}")
            x = sample(x, last, size * rng.standard_normal((FINE, 2)))
            last, before = force, y
        (READINGS / f"run_{run + 1}.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
    readings()
