"""Certified loops of MuJoCo's cart-pole: what is declared of its remainder, and what follows."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import most, sets

mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: pip install mujoco")

XML = """
<mujoco>
  <option timestep="0.01" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="0.1"/>
      <geom type="box" size="0.1 0.05 0.05" mass="1" contype="0" conaffinity="0"/>
      <body name="pole" pos="0 0 0">
        <joint name="hinge" type="hinge" axis="0 1 0" damping="0.002"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.6" size="0.02" mass="0.1"
              contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="slide" gear="1"/></actuator>
</mujoco>
"""
STATES = ["position", "angle", "speed", "rate"]
# in these units the remainder of a step has rows of about one size, and so have its arguments
UNITS, FORCE = np.array([0.02, 0.05, 0.3, 1.0]), 10.0
NOISE, ZONE, STEPS = 1e-4, 2.5, 60
DECLARED = 0.0017  # times the cube of (angle, rate, force) within ZONE


class Rig:
    """A step of 0.05 s of the simulator, in these units."""

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(XML)
        self.data = mujoco.MjData(self.model)
        columns = [(self.step(h) - self.step(-h)) / 2e-5 for h in 1e-5 * np.eye(5)]
        self.Theta = np.column_stack(columns)

    def step(self, z):
        mujoco.mj_resetData(self.model, self.data)
        x = UNITS * z[:4]
        self.data.qpos[:], self.data.qvel[:], self.data.ctrl[0] = x[:2], x[2:], FORCE * z[4]
        for _ in range(5):
            mujoco.mj_step(self.model, self.data)
        return np.concatenate([self.data.qpos, self.data.qvel]) / UNITS

    def remainder(self, z):
        return np.linalg.norm(self.step(z) - self.Theta @ z)

    def runs(self, rng, count, size, steps=10):
        states, inputs = [], []
        for _ in range(count):
            x = [size * rng.standard_normal(4) * [1, 1, 0.5, 0.2]]
            u = 0.1 * size * rng.standard_normal((steps, 1))
            for v in u:
                x.append(self.step(np.append(x[-1], v)) + NOISE * rng.standard_normal(4))
            states.append(np.array(x))
            inputs.append(u)
        return se.Trajectories(states, inputs, state_names=STATES, input_names=["force"])


def identified(data, at_most, cut):
    zone = {"power": 3, "within": ZONE, "cut": cut}
    misfit = se.Misfit(on=STATES, of=["angle", "rate", "force"], at_most=at_most, **zone)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return se.identify(
            data, noise=NOISE, scale=[1, 1, 0.5, 0.2, 0.1], misfit=misfit, checks=False,
            accept=("nonlinear", "outliers", "noise size"),
        )  # fmt: skip


@pytest.fixture(scope="module")
def rig():
    return Rig()


def test_the_remainder_of_a_step_is_as_small_as_declared(rig):
    rng, worst = np.random.default_rng(0), 0.0
    for _ in range(sets(20_000, 2_000)):
        z = rng.standard_normal(3)
        z *= ZONE * rng.random() ** (1 / 3) / np.linalg.norm(z)
        position, speed = 3.0 * rng.standard_normal(2)
        whole = np.array([position, z[0], speed, z[1], z[2]])
        worst = max(worst, rig.remainder(whole) / np.linalg.norm(z) ** 3)
    assert 0.5 * DECLARED < worst < DECLARED


def test_regions_and_tubes_hold_with_the_declaration_and_not_without(rig):
    count = sets(200, 12)
    missed, none, left, certified = 0, 0, 0, 0
    for seed in range(count):
        data = rig.runs(np.random.default_rng(seed), 8, 0.5)
        system = rig.Theta[:, :4].copy(), rig.Theta[:, 4:].copy()
        wide, narrow = (identified(data, DECLARED, cut) for cut in (ZONE, 1.0))
        none += not identified(data, 0.0, ZONE).region(0.05).contains(*system)
        covered = [model.region(0.05).contains(*system) for model in (wide, narrow)]
        missed += not all(covered)
        proof = se.gain(narrow, Q=[0.1, 1.0, 0.1, 0.3], R=1.0).certificate(0.05)
        certified += proof.status == "certified"
        x = np.array([0.5, 0.5, 0.0, 0.0])
        tube = proof.tube(x, STEPS)
        assert np.isfinite(tube.radii).all() == (proof.status == "certified")
        for centre, size in zip(tube.states[1:], tube.radii[1:], strict=True):
            x = rig.step(np.append(x, proof.K @ x))
            left += not np.linalg.norm(x - centre) <= size
        # a further start, as far as all systems stay where the declaration holds
        far = proof.holds(states=(-1e3, 1e3), x0=[0.5, 0.5, 0.0, 0.0])
        x = far * np.array([0.5, 0.5, 0.0, 0.0])
        for _ in range(300):
            x = rig.step(np.append(x, proof.K @ x))
            left += not abs(x[1]) <= ZONE
        left += not np.linalg.norm(x[[1, 3]]) < 0.05
    assert certified > 0.8 * count
    assert missed <= most(count, 0.05)
    assert left == 0
    assert none > 0.8 * count
