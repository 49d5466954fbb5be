"""Certificates of plans over the 95 % quantile of the true error, logs with feedback.

    python benches/followed.py [sets]

Of each plant `sets` data sets (default 30). The error of each output at the last step, of its mean
and of a run with noise, under the plan in open loop and followed with a gain; certificates at 5 %,
of all steps and outputs together, without a reference and with one: `Pilot(inputs="any",
reference=plan, gain=gain)` of the first quarter of the runs. Medians over the quantile, the median
over the outputs.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import stochens_rs as se

Floats = NDArray[np.float64]
DELTA = 0.05


class Plant(NamedTuple):
    """``y(t+1) = sum_i A_i y(t-i) + B u(t) + L w(t)``, logged under ``u = K y + dither``.

    With one lag y is the state. `start` is where plans begin, `clip` limits the input.
    """

    A: Floats
    B: Floats
    L: Floats
    K: Floats
    runs: int
    length: int
    steps: int
    spread: Floats
    start: Floats
    dither: float = 0.5
    clip: float = np.inf

    @property
    def lags(self) -> int:
        return len(self.A)

    def run(self, rng: np.random.Generator, steps: int) -> tuple[Floats, Floats]:
        p, m = self.B.shape
        y = [self.spread * rng.standard_normal(p) for _ in range(self.lags)]
        u = [np.zeros(m)] * (self.lags - 1)
        for _ in range(steps):
            v = self.K @ y[-1] + self.dither * rng.standard_normal(m)
            u.append(np.clip(v, -self.clip, self.clip))
            y.append(self.ahead(y, u[-1], self.L @ rng.standard_normal(p)))
        return np.array(y), np.array(u)

    def ahead(self, y: list[Floats], u: Floats, w: Floats) -> Floats:
        past = sum(A @ y[-1 - i] for i, A in enumerate(self.A))
        return np.asarray(past + self.B @ u + w)

    def data(self, rng: np.random.Generator) -> se.Trajectories:
        runs = [self.run(rng, self.length) for _ in range(self.runs)]
        return se.Trajectories(*map(list, zip(*runs, strict=True)), outputs=self.lags > 1)

    def end(
        self, y: list[Floats], u: list[Floats], act: Callable[..., Floats], w: Floats
    ) -> Floats:
        y, u = list(y), list(u)
        for k in range(self.steps):
            u.append(act(k, y, u))
            y.append(self.ahead(y, u[-1], self.L @ w[k]))
        return y[-1]


def one_pole() -> Plant:
    one = np.eye(1)
    log = -0.6 * one, 12, 20, 10
    return Plant(1.15 * one[None], one, 0.3 * one, *log, np.ones(1), np.ones(1), clip=1.0)


def plants() -> dict[str, Plant]:
    """Cart-pole at 50 Hz with 20 and 100 runs, an unstable pole, six states, readings."""
    gen = np.random.default_rng(1)
    pole = np.array([[1, 0.02, 0, 0], [0, 0.99, -0.014, 0], [0, 0, 1, 0.02], [0, 0.02, 0.47, 1.0]])
    push, noise = np.array([[0.0002], [0.02], [-0.0004], [-0.04]]), np.diag([2, 20, 2, 20]) * 1e-4
    held, spread = np.array([[0.6, 1.2, 14.0, 2.9]]), np.array([0.05, 0.05, 0.02, 0.05])
    cart = pole[None], push, noise, held
    at = np.array([0.1, 0.0, 0.05, 0.0])
    six = gen.standard_normal((6, 6))
    six *= 1.02 / np.abs(np.linalg.eigvals(six)).max()
    inputs = gen.standard_normal((6, 2))
    read = np.array([[[1.2, 0.1], [0.0, 0.9]], [[-0.35, 0.0], [0.1, -0.1]]])
    held_read = read, np.array([[1.0], [0.5]]), 0.05 * np.eye(2), np.array([[-0.3, 0.0]])
    open_six = six[None], inputs, 0.1 * np.eye(6), np.zeros((2, 6))
    return {
        "cart-pole, 20 runs": Plant(*cart, 20, 20, 10, spread, at),
        "cart-pole, 100 runs": Plant(*cart, 100, 20, 10, spread, at),
        "pole 1.15, clipped": one_pole(),
        "6 states, 2 inputs": Plant(*open_six, 20, 20, 10, np.ones(6), np.ones(6)),
        "readings, 2 lags": Plant(*held_read, 16, 40, 15, np.ones(2), np.ones(2), clip=1.0),
    }


class Follower(NamedTuple):
    """The inputs of a plan, with feedback from the window of readings where there is a gain."""

    plan: Any
    window: Any
    K: Floats | None

    def __call__(self, k: int, y: list[Floats], u: list[Floats]) -> Floats:
        if self.K is None:
            return np.asarray(self.plan.u[k])
        of = self.window
        x = y[-1] if of is None else of.state_of(np.array(y), np.array(u))
        return np.asarray(self.plan.u[k] + self.K @ (x - self.plan.predicted_states[k]))


def of_set(plant: Plant, seed: int) -> dict[str, Floats]:
    """True errors (outputs) and certificates of one data set, by kind."""
    rng = np.random.default_rng([11, seed])
    data, share = plant.data(rng), plant.runs // 4
    known = np.diag(np.diag(plant.L) ** 2)
    options: dict[str, Any] = {"checks": False}
    if plant.lags > 1:
        options["window"] = se.Window(lags=plant.lags)
        record = plant.run(rng, 10)
        start: dict[str, Any] = {"record": record}
    else:
        options["noise"] = se.Noise(covariance=known)
        record = np.array([plant.start]), np.zeros((0, plant.B.shape[1]))
        start = {"x0": plant.start, "xf": np.zeros(len(plant.start))}

    def parts(model: se.Model) -> tuple[Any, Any]:
        return se.gain(model, 1.0, 0.1), se.control(model, **start, steps=plant.steps)

    first = parts(se.identify(data[:share], **options))
    found: dict[str, Floats] = {}
    w = rng.standard_normal((plant.steps, len(plant.L)))
    declared = "any" in (se.Pilot.__doc__ or "")
    for kind in ("plain", "near") if declared else ("plain",):
        for follow in (False, True):
            if kind == "near":
                task = {"reference": first[1], "gain": first[0] if follow else None}
                options["pilot"] = se.Pilot(share, inputs="any", **task)
            model = se.identify(data, **options)
            gain, plan = parts(model)
            act = Follower(plan, model.window, gain.K if follow else None)
            ahead = plan.predicted_outputs
            ahead = plan.predicted_states if ahead is None else ahead
            for noisy in (False, True):
                end = plant.end(list(record[0]), list(record[1]), act, w * noisy)
                bound = plan.bound(DELTA, noise=noisy, gain=gain if follow else None)
                read = plant.lags > 1
                radius = bound["readings"].radius[-1] if read else bound["components"].radius
                name = "followed" if follow else "open loop"
                name += f"{', noise' if noisy else ''}|{kind}"
                found[name] = np.asarray(radius)
                found[f"{name} error"] = np.abs(end - ahead[-1])
    return found


def main(sets: int) -> None:
    for name, plant in plants().items():
        every = [of_set(plant, seed) for seed in range(sets)]
        for key in [key for key in every[0] if not key.endswith("error")]:
            certified = np.median([one[key] for one in every], axis=0)
            errors = np.array([one[f"{key} error"] for one in every])
            ratio = np.median(certified / np.quantile(errors, 0.95, axis=0))
            radii = np.array([one[key] for one in every])
            failed = (errors > radii * (1 + 1e-9) + 1e-12).any(axis=1).sum()
            print(f"{name:22} {key:26} certificate / q95 {ratio:8.3g}   failed {failed}/{sets}")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 30)
