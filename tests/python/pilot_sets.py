"""Measured runs, plans by least squares, and certificates by a pilot, for tests of coverage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stochens_rs import _core

Array = NDArray[np.float64]


class Plant(NamedTuple):
    """A system with the runs that are measured on it and the task asked of it."""

    A: Array
    B: Array
    sigma: float
    starts: Array  # deviations of the first state of a run
    length: int
    x0: Array
    xf: Array
    steps: int
    gain: Array | None = None


def rig() -> Plant:
    """The linear cart-pole: cart 1 kg, point mass .2 kg on a rod of 1 m, held for .1 s."""
    gravity = 9.81
    F = np.zeros((5, 5))
    F[0, 2] = F[1, 3] = F[2, 4] = 1.0
    F[2, 1], F[3, 1], F[3, 4] = -0.2 * gravity, 1.2 * gravity, -1.0
    term = total = np.eye(5)
    for k in range(1, 25):
        term = term @ F * (0.1 / k)
        total = total + term
    start, x0 = np.array([0.1, 0.01, 0.1, 0.03]), np.array([0.1, 0.05, 0.0, 0.0])
    return Plant(total[:4, :4], total[:4, 4:], 0.0005, start, 10, x0, np.zeros(4), 10)


def family(n: int, m: int, radius: float, steps: int, seed: int = 0) -> Plant:
    """A dense system of this spectral radius from a fixed seed, runs of 10 steps."""
    gen = np.random.default_rng([seed, n, m, steps])
    A = gen.standard_normal((n, n))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    B = gen.standard_normal((n, m))
    return Plant(A, B, 0.1, np.ones(n), 10, gen.standard_normal(n), np.zeros(n), steps)


FAMILIES = {
    "n2 stable": family(2, 1, 0.9, 5),
    "n3": family(3, 1, 1.05, 10),
    "n6": family(6, 2, 0.9, 20),
    "n10": family(10, 5, 0.9, 5),
    "n4 one step": family(4, 4, 0.95, 1),
    "n2 unstable": family(2, 1, 1.1, 20),
    "n8": family(8, 3, 1.02, 10),
}


def measured(plant: Plant, runs: int, gen: np.random.Generator) -> tuple[Array, Array]:
    """Rows (x, u, x_next) of runs with random inputs, and their dither."""
    (n, m), L = plant.B.shape, plant.length
    x = plant.starts * gen.standard_normal((runs, n))
    v = gen.standard_normal((runs, L, m))
    w = plant.sigma * gen.standard_normal((runs, L, n))
    rows = np.empty((runs, L, 2 * n + m))
    for k in range(L):
        u = v[:, k] if plant.gain is None else v[:, k] + x @ plant.gain.T
        after = x @ plant.A.T + u @ plant.B.T + w[:, k]
        rows[:, k] = np.hstack([x, u, after])
        x = after
    return rows.reshape(runs * L, -1), v.reshape(runs * L, m)


def steered(Theta: Array, x0: Array, xf: Array, steps: int) -> Array:
    """The least inputs (K, m) that lead a model from x0 to xf, as near as they can."""
    n = len(Theta)
    pushes, power = [], np.eye(n)
    for _ in range(steps):
        pushes.insert(0, power @ Theta[:, n:])
        power = power @ Theta[:, :n]
    u = np.linalg.lstsq(np.hstack(pushes), xf - power @ x0, rcond=None)[0]
    return np.ascontiguousarray(u.reshape(steps, -1))


def led(Theta: Array, x0: Array, u: Array, noise: Array | None = None) -> Array:
    """The states (K + 1, n) under inputs."""
    x = [np.asarray(x0, dtype=float)]
    for k, one in enumerate(u):
        x.append(Theta @ np.concatenate([x[-1], one]) + (0.0 if noise is None else noise[k]))
    return np.array(x)


def split(rows: Array, plant: Plant, share: float = 0.1) -> tuple[Array, Array]:
    """The pilot of the first runs by least squares, and the rows of the others."""
    n, m = plant.B.shape
    count = len(rows) // plant.length
    first = max(2, -(-2 * (n + m) // plant.length), round(share * count)) * plant.length
    H0 = np.linalg.lstsq(rows[:first, : n + m], rows[:first, n + m :], rcond=None)[0].T
    return np.ascontiguousarray(H0), np.ascontiguousarray(rows[first:])


def piloted(H0: Array, rows: Array, plant: Plant, dither: Array | None = None) -> _core.Pilot:
    """The model of the main runs by these instruments."""
    lengths = np.full(len(rows) // plant.length, plant.length)
    feedback = None
    if plant.gain is not None and dither is not None:
        feedback = plant.gain, np.ascontiguousarray(dither[-len(rows) :])
    return _core.Pilot(rows, lengths, H0, feedback, 1)


def covariance(plant: Plant) -> tuple[str, Array]:
    """The known covariance as the core takes it."""
    return "known", plant.sigma**2 * np.eye(len(plant.A))


@dataclass(frozen=True)
class Outcome:
    """Certificate and truth of one data set."""

    target: float
    miss: float
    parts: tuple[float, ...]
    failed: bool
    outside_tube: bool
    outside_components: bool


def outcome(
    plant: Plant,
    runs: int,
    gen: np.random.Generator,
    delta: float = 0.05,
    *,
    unknown: str | None = None,
    noise: bool = False,
    pilot: Array | None = None,
) -> Outcome:
    """Identify, plan to the task, certify, and lead the true system."""
    n, K, Theta = len(plant.A), plant.steps, np.hstack([plant.A, plant.B])
    rows, dither = measured(plant, runs, gen)
    H0, main = split(rows, plant) if pilot is None else (pilot, rows)
    model = piloted(H0, main, plant, dither)
    reference = model.reference(plant.x0, steered(H0, plant.x0, plant.xf, K))
    u = steered(model.centre, plant.x0, plant.xf, K)
    predicted = led(model.centre, plant.x0, u)
    law = covariance(plant) if unknown is None else (unknown, None)
    found = model.near(reference, plant.x0, plant.xf, u, predicted, law, delta, noise)
    shocks = plant.sigma * gen.standard_normal((K, n)) if noise else None
    true = led(Theta, plant.x0, u, shocks)
    miss, off = np.abs(true[-1] - plant.xf), np.linalg.norm(true - predicted, axis=1)
    size = float(np.linalg.norm(miss))
    return Outcome(
        found[0],
        size,
        found[1:5],
        bool(size > found[0]),
        bool((off > found[5] + 1e-14 * np.abs(true).max()).any()),
        bool((miss > found[6]).any()),
    )
