"""Last table of measured-runs.md: python docs/rig_mujoco.py [--seeds R].

The runs come from a simulator of rigid bodies, MuJoCo, with the inverted pendulum that Gymnasium
ships: `pip install mujoco gymnasium`. It is not linear. A region covers the noise, not what a
linear model leaves out, so this compares the certificate with the error for runs and tasks that
stay close to the upright position, and for such that do not.
"""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

import stochens_rs as se

Floats = NDArray[np.float64]
XML = Path(gymnasium.__file__).parent / "envs/mujoco/assets/inverted_pendulum.xml"
SUBSTEPS = 4  # of 0.02 s in a step, each with its own push
LENGTH, STEPS = 5, 8
PUSH = np.array([0.5, 0.05])  # standard deviations of the random pushes [N, N m]
START = np.array([1.0, 1.0, 2.0, 2.0])  # of the first states, for an excursion of 1 rad
CONTROL = 3.0  # of the input, for an excursion of 1 rad
ROWS = (  # runs, their excursion [rad], the angle from which the control starts [rad]
    (30, 0.01, 0.01),
    (300, 0.01, 0.01),
    (300, 0.01, 0.1),
    (300, 0.01, 0.3),
    (30, 0.03, 0.03),
    (300, 0.03, 0.03),
    (30, 0.1, 0.1),
    (300, 0.1, 0.1),
)
DELTA = 0.05


class Rig:
    """The simulator as a map of state (cart, angle, speed, rate) and input to the next state."""

    def __init__(self) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(XML))
        self.model.actuator_ctrllimited[:] = 0  # the limit of the force is another matter
        self.data = mujoco.MjData(self.model)

    def step(self, x: Floats, u: float, rng: np.random.Generator | None = None) -> Floats:
        """One step, with random pushes if there is a generator."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:], self.data.ctrl[0] = x[:2], x[2:], u
        for _ in range(SUBSTEPS):
            if rng is not None:
                self.data.qfrc_applied[:] = PUSH * rng.standard_normal(2)
            mujoco.mj_step(self.model, self.data)
        return np.concatenate([self.data.qpos, self.data.qvel])

    def linear(self, h: float = 1e-5) -> tuple[Floats, Floats, Floats]:
        """A, B and c at the upright position, by central differences."""
        columns = [
            (self.step(z[:4], z[4]) - self.step(-z[:4], -z[4])) / (2 * h) for z in h * np.eye(5)
        ]
        Theta = np.column_stack(columns)
        return Theta[:, :4], Theta[:, 4:], self.step(np.zeros(4), 0.0)


def once(
    rig: Rig, Theta: tuple[Floats, Floats, Floats], count: int, size: float, task: float, seed: int
) -> tuple[float, ...]:
    """Identify from `count` runs of excursions `size`, and control from an angle of `task`.

    Root mean square of what the linear system leaves out of a step; certificate and true error;
    whether the region misses the linear system, the error is beyond the certificate, and the
    residuals warn.
    """
    A, B, c = Theta
    rng = np.random.default_rng(seed)
    states, inputs, left = [], [], []
    for _ in range(count):
        x = [size * START * rng.standard_normal(4)]
        u = size * CONTROL * rng.standard_normal(LENGTH)
        for k in range(LENGTH):
            x.append(rig.step(x[-1], u[k], rng))
            left.append(rig.step(x[-2], u[k]) - (A @ x[-2] + B[:, 0] * u[k] + c))
        states.append(np.array(x))
        inputs.append(u[:, None])
    data = se.Trajectories(states, inputs, dt=SUBSTEPS * rig.model.opt.timestep)
    model = se.identify(data, intercept=True, scale=size * np.append(START, CONTROL))
    start = np.array([0.0, task, 0.0, 0.0])
    plan = se.control(model, start, np.zeros(4), steps=STEPS)
    end = start
    for k in range(STEPS):
        end = rig.step(end, plan.u[k, 0])
    bound, error = plan.bound(DELTA).target, float(np.linalg.norm(end))
    missed = not model.region(DELTA).contains(A, B, c)
    warned = model.checks is not None and bool(model.checks.warnings)
    return float(np.sqrt(np.mean(np.square(left)))), bound, error, missed, error > bound, warned


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    seeds = parser.parse_args().seeds
    warnings.simplefilter("ignore", se.exceptions.DataWarning)
    rig = Rig()
    Theta = rig.linear()
    pushed = np.random.default_rng(0)
    w = [rig.step(np.zeros(4), 0.0, pushed) - Theta[2] for _ in range(2000)]
    noise = float(np.sqrt(np.mean(np.square(w))))
    heads = ("runs", "excursion [rad]", "task from [rad]", "left out / noise", "certificate")
    heads += ("true error", "region failed", "certificate failed", "residuals warn")
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for count, size, task in ROWS:
        rows = [once(rig, Theta, count, size, task, seed) for seed in range(seeds)]
        left, bound, error, *counts = np.array(rows).T
        cells = [f"{count}", f"{size:g}", f"{task:g}", f"{np.median(left) / noise:.2g}"]
        cells += [f"{np.median(bound):.2g}", f"{np.median(error):.2g}"]
        cells += [f"{int(one.sum())} of {seeds}" for one in counts]
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
