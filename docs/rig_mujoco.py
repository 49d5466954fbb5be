"""Last table of measured-runs.md: python docs/rig_mujoco.py [--seeds R] [--runs N].

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
EXCURSIONS = (0.003, 0.01, 0.03, 0.1, 0.3)  # [rad]
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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--runs", type=int, default=30)
    options = parser.parse_args()
    warnings.simplefilter("ignore", se.exceptions.DataWarning)
    rig = Rig()
    A, B, c = rig.linear()
    pushed = np.random.default_rng(0)
    w = [rig.step(np.zeros(4), 0.0, pushed) - c for _ in range(2000)]
    print(f"deviations of the noise of a step: {np.std(w, axis=0)}\n")
    print(
        "| excursion | left out / noise | certificate | error | region failed | beyond | warned |"
    )
    print("|---|---|---|---|---|---|---|")
    for size in EXCURSIONS:
        rows = []
        for seed in range(options.seeds):
            rng = np.random.default_rng(seed)
            states, inputs, left = [], [], []
            for _ in range(options.runs):
                x = [size * START * rng.standard_normal(4)]
                u = size * CONTROL * rng.standard_normal(LENGTH)
                for k in range(LENGTH):
                    x.append(rig.step(x[-1], u[k], rng))
                    left.append(rig.step(x[-2], u[k]) - (A @ x[-2] + B[:, 0] * u[k] + c))
                states.append(np.array(x))
                inputs.append(u[:, None])
            data = se.Trajectories(states, inputs, dt=SUBSTEPS * rig.model.opt.timestep)
            model = se.identify(data, intercept=True, scale=size * np.append(START, CONTROL))
            plan = se.control(model, [0.0, size, 0.0, 0.0], np.zeros(4), steps=STEPS)
            x = np.array([0.0, size, 0.0, 0.0])
            for k in range(STEPS):
                x = rig.step(x, plan.u[k, 0])
            bound = plan.bound(DELTA).target
            error = float(np.linalg.norm(x))
            inside = model.region(DELTA).contains(A, B, c)
            outside = float(np.sqrt(np.mean(np.square(left)) / np.mean(np.square(w))))
            rows.append((outside, bound, error, not inside, error > bound, bool(model.warnings)))
        outside, bound, error, missed, beyond, warned = (
            np.array(r) for r in zip(*rows, strict=True)
        )
        print(
            f"| {size:g} rad | {np.median(outside):.2g} | {np.median(bound):.2g} | "
            f"{np.median(error):.2g} | {missed.sum()} of {len(rows)} | {beyond.sum()} of {len(rows)} "
            f"| {warned.sum()} of {len(rows)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
