"""Two masses and a shaft, read by encoders at 100 Hz behind two samples of delay; its logs."""

from __future__ import annotations

import functools
import warnings

import numpy as np

import stochens_rs as se

MOTOR, STIFF, DAMP, DRAG = 0.02, 20.0, 0.05, np.array([0.05, 0.03])
ENCODERS = 360.0 / np.array([4096.0, 8192.0])
COLUMNS = {"state_names": ["motor", "load"], "input_names": ["torque"], "outputs": True}


class Drive:
    """Some drives at once: angles and speeds (4, count) in rad; readings in degrees."""

    def __init__(self, rng, count=1, friction=0.0):
        self.rng, self.friction, self.x = rng, friction, np.zeros((4, count))
        self.late = [np.zeros(count)] * 2
        self.load, self.inertia, self.at_input = 0.0, 0.03, 0.0

    def read(self):
        """The angles, rounded by the encoders, (count, 2)."""
        return np.round(np.degrees(self.x[:2].T) / ENCODERS) * ENCODERS

    def step(self, u):
        """One sample with a torque of each, and noise of 0.02 Nm."""
        self.late.append(np.clip(u, -2.0, 2.0) + self.at_input)
        noise = 0.02 * self.rng.standard_normal(self.x.shape[1])
        torque = self.late.pop(0) + noise
        for _ in range(10):
            angle, speed = self.x[:2], self.x[2:]
            twist = STIFF * (angle[0] - angle[1]) + DAMP * (speed[0] - speed[1])
            slows = DRAG[:, None] * speed + self.friction * np.tanh(speed / 0.05)
            motor = (torque - twist - slows[0]) / MOTOR
            load = (twist - slows[1] - self.load) / self.inertia
            self.x = self.x + 0.001 * np.vstack([speed, motor, load])


@functools.cache
def model(friction=0.0):
    """From 30 logs of 2 s."""
    rng = np.random.default_rng(1)
    drive = Drive(rng, 30, friction)
    drive.x[:2], drive.x[2:] = rng.uniform(-3.0, 3.0, 30), 2.0 * rng.standard_normal(30)
    y, u, held = [drive.read()], [], None
    for k in range(200):
        held = rng.uniform(-1.8, 1.8, 30) if k % 4 == 0 else held
        u.append(held)
        drive.step(held)
        y.append(drive.read())
    runs = np.array(y).transpose(1, 0, 2), np.array(u).T[:, :, None]
    data = se.Trajectories(*map(list, runs), dt=0.01, **COLUMNS)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return se.identify(data, window=se.Window(lags=13, delay=2), accept="memory")


def loop(friction=0.0, watched=False):
    """A loop that holds the angle of the load."""
    gain, limits = se.gain(model(friction), [0.04, 0.04], 1.0), se.Limits(u=(-2.0, 2.0))
    made = se.regulate(gain, target={"load": 0.0}, limits=limits, offset_free=True)
    if watched:
        made.watch = made.certificate(0.05).watch(every=1e5)
    return made


def ride(loop, drive, calls, change=None, at=None, sign=1.0):
    """Calls of the loop beside the drive, which is changed before call `at`."""
    for k in range(calls):
        if k == at:
            change(drive)
        drive.step(loop(sign * drive.read()[0]))
    return loop
