"""The window that the data choose, beside a shorter one: what is certified, and what is wrong.

    python benches/windows.py [plants of a kind]

Hidden plants of eight kinds, fast and slow, drawn anew for each number; readings have errors, so
that no window is exact. "package" is the window of `identify`. "short" is the window with the
fewest regressors for the pairs that are left among those whose AIC is within 6 of the least, and
one filter more. A model is "wrong" if a run without noise leaves the bounds of one step anywhere; a
region of 95 % allows 1 in 20.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

import stochens_rs as se
from stochens_rs.identification import Regressors
from stochens_rs.identification.assumptions import ACCEPTED
from stochens_rs.identification.window import rows_of
from stochens_rs.system.conversions import discretize

Floats = NDArray[np.float64]
POLES, COUNTS, WITHIN = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95), range(2, 9), 6.0


@dataclass
class Plant:
    """x+ = A x + B u + G w, y = C x + s v; logged under P (y - goal) + D (filtered differences)."""

    A: Floats
    B: Floats
    C: Floats
    G: Floats
    s: Floats
    P: Floats
    D: Floats
    dither: float
    limit: float
    size: tuple[int, int]  # runs and steps
    Q: list[float]
    R: float
    goal: float = 0.0

    def runs(self, rng: np.random.Generator, runs: int, noise: float = 1.0) -> se.Trajectories:
        """Runs that advance together."""
        n, steps, p = len(self.A), self.size[1], len(self.C)
        x, v, goal = np.zeros((runs, n)), np.zeros((runs, p)), np.zeros((runs, p))
        Y, U = np.zeros((runs, steps + 1, p)), np.zeros((runs, steps, self.B.shape[1]))
        for t in range(steps + 1):
            Y[:, t] = x @ self.C.T + noise * self.s * rng.standard_normal((runs, p))
            if t == steps:
                break
            if t % 60 == 0:
                goal = self.goal * rng.uniform(-1.0, 1.0, (runs, 1)) * np.ones((1, p))
            v = 0.6 * v + 0.4 * (Y[:, t] - Y[:, t - 1]) if t else v
            known = (Y[:, t] - goal) @ self.P.T + v @ self.D.T
            dither = self.dither * rng.standard_normal(U[:, t].shape)
            U[:, t] = np.clip(known + dither, -self.limit, self.limit)
            force = rng.standard_normal((runs, self.G.shape[1])) @ self.G.T
            x = x @ self.A.T + U[:, t] @ self.B.T + noise * force
        return se.Trajectories(list(Y), list(U), outputs=True)


def sampled(A: object, B: object, dt: float) -> tuple[Floats, Floats]:
    """With inputs that are held."""
    return discretize(np.array(A, dtype=float), np.array(B, dtype=float), dt, "zoh")


def belt(rng: np.random.Generator, by: Callable[..., Floats]) -> Plant:
    J, k, c, d, kt = by(1e-3), by(0.4), by(0.004), by(0.004), by(0.05)
    rows = [[-k / J, k / J, -(c + d) / J, c / J], [k / J, -k / J, c / J, -(c + d) / J]]
    A, B = sampled([[0, 0, 1, 0], [0, 0, 0, 1], *rows], [[0], [0], [kt / J], [0]], 0.004)
    C, G = np.array([[1.0, 0, 0, 0], [0, 10.0, 0, 0]]), 0.02 * np.eye(4)[:, 2:]
    s, P, D = np.array([1e-3, 0.02]), np.array([[-0.6, 0.0]]), np.zeros((1, 2))
    return Plant(A, B, C, G, s, P, D, 0.6, 3.0, (8, 500), [100.0, 1.0], 1.0, 4.0)


def cart(rng: np.random.Generator, by: Callable[..., Floats]) -> Plant:
    M, m, arm, b = by(1.0, 0.2), by(0.2, 0.2), by(0.5, 0.2), by(0.5)
    rows = [[0, -m * 9.81 / M, -b / M, 0], [0, (M + m) * 9.81 / (M * arm), b / (M * arm), 0]]
    A, B = sampled([[0, 0, 1, 0], [0, 0, 0, 1], *rows], [[0], [0], [1 / M], [-1 / (M * arm)]], 0.02)
    s, P, D = np.array([3e-4, 5e-4]), np.array([[1.5, 28.0]]), np.array([[130.0, 250.0]])
    return Plant(A, B, np.eye(4)[:2], 0.02 * B, s, P, D, 1.0, 10.0, (20, 150), [10.0, 10.0], 0.1)


def servo(rng: np.random.Generator, by: Callable[..., Floats]) -> Plant:
    A, B = sampled([[0, 1], [0, -by(8.0)]], [[0], [by(60.0)]], 0.002)
    s, C = np.array([1e-3 * np.exp(rng.uniform(-1, 1))]), np.array([[1.0, 0.0]])
    about = np.array([[-6.0]]), np.zeros((1, 1)), 2.0, 6.0, (6, 600), [100.0], 0.01, 1.0
    return Plant(A, B, C, 0.3 * B, s, *about)


def resonant(rng: np.random.Generator, by: Callable[..., Floats]) -> Plant:
    w, v, z = by(12.0), by(35.0), by(0.03)
    modes = [[0, 1, 0, 0], [-(w**2), -2 * z * w, 0, 0], [0, 0, 0, 1], [0, 0, -(v**2), -2 * z * v]]
    A, B = sampled(modes, [[0], [w**2], [0], [0.3 * v**2]], 0.01)
    s, C = np.array([0.02 * np.exp(rng.uniform(-1, 1))]), np.array([[1.0, 0.0, 1.0, 0.0]])
    none = np.zeros((1, 1))
    return Plant(A, B, C, 0.05 * B, s, none, none, 1.0, 4.0, (6, 500), [1.0], 1.0)


def tanks(rng: np.random.Generator, by: Callable[..., Floats]) -> Plant:
    t, a = by(np.array([60.0, 80.0, 50.0, 70.0])), by(np.array([0.7, 0.6]), 0.2)
    A = np.diag(-1 / t)
    A[0, 2], A[1, 3] = 1 / t[2:]
    A, B = sampled(A, 0.1 * np.array([[a[0], 0], [0, a[1]], [0, 1 - a[1]], [1 - a[0], 0]]), 5.0)
    s, none = 0.05 * np.exp(rng.uniform(-1, 1)) * np.ones(2), np.zeros((2, 2))
    about = none, none, 1.0, 3.0, (4, 500), [1.0, 1.0], 0.1
    return Plant(A, B, np.eye(4)[:2], 0.03 * np.eye(4), s, *about)


def room(rng: np.random.Generator, by: Callable[..., Floats]) -> Plant:
    air, walls, inner, outer = by(2e6), by(2e7), by(0.004), by(0.01)
    rows = [[-1 / air, 1 / air], [1 / walls, -1 / walls - inner / outer / walls]]
    A, B = sampled(np.array(rows) / inner, [[1e3 / air], [0]], 300.0)
    s, C = np.array([0.05 * np.exp(rng.uniform(-1, 1))]), np.array([[1.0, 0.0]])
    about = np.array([[-0.3]]), np.zeros((1, 1)), 0.8, 3.0, (4, 500), [1.0], 0.1, 2.0
    return Plant(A, B, C, np.diag([0.03, 0.01]), s, *about)


def oven(rng: np.random.Generator, by: Callable[..., Floats]) -> Plant:
    c, k, loss = (by(np.array(v), 0.3) for v in ([400, 300, 500], [0.8, 0.6], [0.6, 0.5, 0.7]))
    flow = np.diag([k[0], k[0] + k[1], k[1]]) - np.diag(k, 1) - np.diag(k, -1)
    A = -(np.diag(loss) + flow) / c[:, None]
    A, B = sampled(A, [[3 / c[0], 0], [0, 0], [0, 3 / c[2]]], 10.0)
    s, C = 0.05 * np.exp(rng.uniform(-0.5, 0.5)) * np.ones(2), np.eye(3)[[0, 2]]
    about = -0.5 * np.eye(2), np.zeros((2, 2)), 8.0, 60.0, (6, 300), [1.0, 1.0], 0.01, 10.0
    return Plant(A, B, C, 0.02 * np.eye(3), s, *about)


def hidden(rng: np.random.Generator, by: Callable[..., Floats]) -> Plant:
    n, p = int(rng.integers(2, 5)), int(rng.integers(1, 3))
    A = rng.standard_normal((n, n))
    A *= rng.uniform(0.6, 0.98) / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((n, 1)), rng.standard_normal((p, n))
    process, sensor = (np.exp(rng.uniform(*np.log(ends))) for ends in ((0.01, 0.3), (0.03, 1.0)))
    about = -0.2 * rng.standard_normal((1, p)), np.zeros((1, p)), 1.0, 3.0, (15, 120), [1.0] * p
    return Plant(A, B, C, process * np.eye(n), sensor * np.ones(p), *about, 1.0)


def readings_over_noise(data: se.Trajectories, places: NDArray[np.int64], first: int) -> float:
    """The largest range of a reading over the deviation of its noise, by a model of six lags."""
    window = Regressors(data.state_names, data.input_names, 6)
    rows = rows_of(window, data)[1][np.flatnonzero(places >= window.fill) < first]
    Z, Y = rows[:, : window.length], rows[:, window.length :]
    squares = ((Y - Z @ np.linalg.lstsq(Z, Y, rcond=None)[0]) ** 2).sum(axis=0)
    read = np.vstack([data.rows[:first, : data.n], data.rows[:first, -data.n :]])
    return float((np.ptp(read, axis=0) / np.sqrt(squares / (len(Z) - Z.shape[1]))).max())


def filled_after(pole: float, count: int, ratio: float, pieces: int) -> int:
    """The rows after which the start values of filters are below the noise of all pieces."""
    rows, most = np.arange(1000), np.sqrt((1 - pole**2) / pieces)
    return int(np.argmax(binom.cdf(count - 1, rows, 1 - pole) * ratio <= most))


def short(data: se.Trajectories) -> se.Window | None:
    """The other rule, on the rows of the first quarter that all windows have."""
    first, names = -(-data.size // 4), (data.state_names, data.input_names)
    places = data.layout.places()
    begins, tried = int((places[:first] == 0).sum()), []
    ratio = readings_over_noise(data, places, first)
    most = min(np.median(data.pieces) / 2, 2 * first / (3 * begins))
    for pole in POLES:
        for count in COUNTS:
            if (burn := filled_after(pole, count, ratio, len(data.pieces))) <= most:
                tried.append(Regressors(*names, count, pole, 0, False, burn))
    common, found = max((one.burn for one in tried), default=0), []
    for window in tried:
        rows, at = rows_of(window, data)[1], np.flatnonzero(places >= window.fill)
        rows, d = rows[(at < first) & (places[at] >= common)], window.length
        if len(rows) >= 2 * (d + data.n):
            off = (
                rows[:, d:] - rows[:, :d] @ np.linalg.lstsq(rows[:, :d], rows[:, d:], rcond=None)[0]
            )
            fit = len(rows) * np.linalg.slogdet(off.T @ off / len(rows))[1]
            left = np.maximum(0, data.pieces - window.burn).sum()
            found.append((fit + 2 * data.n * d, d / left, window))
    near = [one for one in found if one[0] <= min(found, key=lambda one: one[0])[0] + WITHIN]
    best = min(near, key=lambda one: one[1])[2] if near else None
    return best and se.Window(filters=(best.pole, best.count + 1))


def judged(
    plant: Plant, data: se.Trajectories, window: se.Window | None, seed: list[int]
) -> Floats:
    """Whether a gain is certified, its margin, and whether the region is wrong."""
    model = se.identify(data, window=window, checks=False, accept=ACCEPTED)
    proof = se.gain(model, plant.Q, plant.R).certificate(0.05)
    rows = rows_of(model.window, plant.runs(np.random.default_rng(seed), 2, 0.0))[1]
    region, d, n = model.region(0.05), model.window.length, model.n_outputs
    off = np.linalg.norm(rows[:, d:] - rows[:, :d] @ model.coefficients.T, axis=1)
    wrong = any(size > region.bound(z[:n], z[n:d]) for size, z in zip(off, rows, strict=True))
    return np.array([proof.status == "certified", proof.margin, wrong])


def drawn(rng: np.random.Generator, by: float, shape: tuple[int, ...]) -> Floats:
    """Factors of constants that are known to a share."""
    return np.exp(rng.uniform(-by, by, shape))


def main(kinds: tuple[Callable[..., Plant], ...]) -> None:
    """Print the table."""
    count, total = int(sys.argv[1]) if len(sys.argv) > 1 else 8, []
    print(f"| {count} plants each | package: certified | margin | wrong | short | margin | wrong |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for number, kind in enumerate(kinds):
        found = []
        for seed in range(count):
            rng = np.random.default_rng([77, number, seed])
            plant = kind(
                rng, lambda x, by=0.4, rng=rng: x * np.exp(rng.uniform(-by, by, np.shape(x)))
            )
            data = plant.runs(rng, plant.size[0])
            windows = None, short(data)
            found.append([judged(plant, data, one, [79, number, seed]) for one in windows])
        total += found
        print(line(kind.__name__, found))
    print(line("all", total))


def line(name: str, found: list[list[Floats]]) -> str:
    """Of both rules: how many are certified, the median margin, how many are wrong."""
    cells = []
    for rule in np.array(found).transpose(1, 2, 0):
        cells += [f"{rule[0].sum():.0f}", f"{np.median(rule[1]):.2f}", f"{rule[2].sum():.0f}"]
    return f"| {name} | {' | '.join(cells)} |"


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main((belt, cart, servo, resonant, tanks, room, oven, hidden))
