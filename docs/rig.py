"""Tables and figures of measured-runs.md and close-the-loop.md: python docs/rig.py [options].

An inverted pendulum on a cart, linear about the upright position, known only through N short runs
in which a random force acts. From each set of runs a model is identified and a control over 10
steps computed, whose certificate is compared with where it leads the true system. Medians over
R sets of runs with seeds 0 .. R - 1, and how often the region or the certificate failed.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from growing_data import draw_certificates
from numpy.typing import NDArray

import stochens_rs as se

Floats = NDArray[np.float64]
STATES = ("position [m]", "angle [rad]", "speed [m/s]", "rate [rad/s]")
DT = 0.1  # [s]
SIZES = (10, 20, 50, 100, 400)  # runs
LENGTH = STEPS = 10  # steps of a run, and of the control
SIGMA = 0.0005  # standard deviation of the noise of a step, in the units of each state
READING = 0.002  # that of the error of a reading
START = np.array([0.1, 0.01, 0.1, 0.03])  # standard deviations of the first state of a run
FORCE = 1.0  # standard deviation of the force [N]
X0, XF = np.array([0.1, 0.05, 0.0, 0.0]), np.zeros(4)
DELTA = 0.05
WIDEST = 5.0 / np.sqrt(0.9 + 0.1 * 25.0)  # deviation of that part, where that of all is 1


def plant(cart: float, mass: float, rod: float) -> tuple[Floats, Floats]:
    """A and B of a cart [kg] with a point mass [kg] on a rod [m], the force held for DT."""
    gravity = 9.81
    F = np.zeros((5, 5))
    F[0, 2] = F[1, 3] = 1.0
    F[2, 1], F[2, 4] = -mass * gravity / cart, 1.0 / cart
    F[3, 1], F[3, 4] = (cart + mass) * gravity / (cart * rod), -1.0 / (cart * rod)
    term = total = np.eye(5)
    for k in range(1, 25):  # exp(F DT)
        term = term @ F * (DT / k)
        total = total + term
    return total[:4, :4], total[:4, 4:]


A, B = plant(1.0, 0.2, 1.0)


def gaussian(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Gaussian noise of deviation 1."""
    return rng.standard_normal(shape)


def student(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Student's t with 3 degrees of freedom, of deviation 1."""
    return rng.standard_t(3, shape) / np.sqrt(3.0)


def mixture(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Nine of ten Gaussian, the tenth five times as wide; of deviation 1 together."""
    wide = np.where(rng.random(shape) < 0.1, WIDEST, WIDEST / 5.0)
    return wide * rng.standard_normal(shape)


NOISES = {"Gaussian": gaussian, "t(3)": student, "mixture": mixture}


def runs(
    N: int, rng: np.random.Generator, noise: Callable[..., Floats], reading: float = 0.0
) -> se.Trajectories:
    """N runs of LENGTH steps under a random force, each from near a random set point."""
    u = FORCE * rng.standard_normal((N, LENGTH, 1))
    w = SIGMA * noise(rng, (N, LENGTH + 1, 4))
    x = np.empty((N, LENGTH + 1, 4))
    x[:, 0] = START * rng.standard_normal((N, 4)) + w[:, LENGTH]
    for k in range(LENGTH):
        x[:, k + 1] = x[:, k] @ A.T + u[:, k] @ B.T + w[:, k]
    x += reading * noise(rng, x.shape)
    return se.Trajectories(x, u, dt=DT, state_names=STATES, input_names=["force [N]"])


@dataclass(frozen=True)
class Way:
    """A way to identify and certify, and the laws of noise under which it holds."""

    fit: Callable[[se.Trajectories, int], se.Model]
    holds: tuple[str, ...]


SCALE = (*START, FORCE)
WAYS = {
    "last pairs, Gaussian": Way(
        lambda data, seed: se.identify(
            data.last_pairs(), noise=se.Noise(design="independent"), checks=False
        ),
        ("Gaussian",),
    ),
    "all pairs, sigma known": Way(
        lambda data, seed: se.identify(data, noise=SIGMA, scale=SCALE, checks=False),
        ("Gaussian",),
    ),
    "all pairs, sigma unknown": Way(
        lambda data, seed: se.identify(data, scale=SCALE, checks=False), ("Gaussian",)
    ),
    "all pairs, sub-Gaussian": Way(
        lambda data, seed: se.identify(
            data,
            noise=se.Noise(law="sub-gaussian", sigma=WIDEST * SIGMA),
            scale=SCALE,
            checks=False,
        ),
        ("Gaussian", "mixture"),
    ),
}


@dataclass(frozen=True)
class Result:
    """Certificates, true errors and region failures, each (R,)."""

    certificates: Floats
    errors: Floats
    missed: NDArray[np.bool_]

    @property
    def failures(self) -> int:
        """In how many of R runs the control ended beyond the certificate."""
        return int(np.sum(self.errors > self.certificates))


def once(way: Way, data: se.Trajectories, seed: int) -> tuple[float, float, bool]:
    """Certificate, true error, and whether the region misses the true system."""
    model = way.fit(data, seed)
    region = model.region(DELTA)
    plan = se.control(model, X0, XF, steps=STEPS)
    end = se.simulate((A, B), X0, plan.u).states[-1]
    error = float(np.linalg.norm(end - XF))
    return plan.bound(DELTA).target, error, not region.contains(A, B)


def compare(law: str, reading: float, ways: dict[str, Way], seeds: int) -> dict[str, list[Result]]:
    """The results of each way for all SIZES."""
    found: dict[str, list[Result]] = {name: [] for name in ways}
    for N in SIZES:
        rows: dict[str, list[tuple[float, float, bool]]] = {name: [] for name in ways}
        for seed in range(seeds):
            data = runs(N, np.random.default_rng([seed, N]), NOISES[law], reading)
            for name, way in ways.items():
                rows[name].append(once(way, data, seed))
        for name, all_ in rows.items():
            certificates, errors, missed = (np.array(column) for column in zip(*all_, strict=True))
            found[name].append(Result(certificates, errors, missed))
    return found


def table(found: dict[str, list[Result]], seeds: int, assumed: set[str]) -> str:
    """Medians of certificate / true error for each N; failures over all N together.

    A way outside `assumed` gets a star: what it assumes does not hold.
    """
    heads = ["", *(f"N = {N}" for N in SIZES), "region failed", "certificate failed"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for name, results in found.items():
        cells = [f"{_shown(one.certificates)} / {_shown(one.errors)}" for one in results]
        total = seeds * len(SIZES)
        cells.append(f"{sum(int(one.missed.sum()) for one in results)} of {total}")
        cells.append(f"{sum(one.failures for one in results)} of {total}")
        lines.append("| " + " | ".join([name + ("" if name in assumed else " *"), *cells]) + " |")
    return "\n".join(lines)


def _shown(values: Floats) -> str:
    middle = float(np.median(values))
    if not np.isfinite(middle):
        return "inf"
    return f"{middle:.2g}" if middle < 1e3 else "> 1000"


def main() -> None:
    """Print the tables and draw the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--images", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    warnings.simplefilter("ignore", se.exceptions.DataWarning)
    options.images.mkdir(parents=True, exist_ok=True)
    example(options.images)
    first_control(options.images)
    within_limits(options.images)
    margins(options.images)
    which_number(options.images)
    known = {"all pairs, sigma known": WAYS["all pairs, sigma known"]}
    for law, reading, ways in (
        *((law, 0.0, WAYS) for law in NOISES),
        *((law, READING, known) for law in NOISES),  # no way holds: the states are no states
    ):
        found = compare(law, reading, ways, options.seeds)
        print(f"{law} noise, {'states read with error' if reading else 'exact states'}\n")
        assumed = {name for name, way in ways.items() if law in way.holds and not reading}
        print(table(found, options.seeds, assumed), end="\n\n", flush=True)
        if law == "Gaussian" and not reading:
            draw(found, options.images)


def example(images: Path) -> None:
    """The figures of one model: a run that was kept apart, and the residuals."""
    data = runs(31, np.random.default_rng(3), gaussian)
    model = se.identify(data[:30], noise=SIGMA, scale=SCALE)
    states, inputs = data[30]
    plan = se.predict(model, states[0], inputs)
    plan.plot(plan.bound(DELTA, noise=True), measured=states).savefig(images / "tube.png", dpi=110)
    model.plot().savefig(images / "residuals.png", dpi=110)


def first_control(images: Path) -> None:
    """The figure of README.md: a control from a CSV file."""
    path = Path(__file__).parent / "data" / "runs.csv"
    states, inputs = ["position", "angle", "speed", "rate"], ["force"]
    data = se.Trajectories.from_csv(path, states=states, inputs=inputs, by="run", time="time")
    plan = se.control(
        se.identify(data), [0.1, 0.0, 0.0, 0.0], np.zeros(4), steps=10, limits=(-4.0, 4.0)
    )
    plan.plot(states=["position", "angle"]).savefig(images / "first-control.png", dpi=110)


def within_limits(images: Path) -> None:
    """The figures of close-the-loop.md: a plan within limits, and the feedback."""
    data = runs(30, np.random.default_rng(1), gaussian)
    model = se.identify(data, noise=SIGMA, scale=SCALE)
    cost = se.Cost(Q=[1.0, 10.0, 0.1, 1.0], R=0.01)
    task: dict[str, Any] = {"limits": (-1.0, 1.0), "cost": cost}
    plan = se.control(model, X0, XF, steps=20, **task)
    figure = plan.plot(measured=plan.states((A, B), X0))
    figure.savefig(images / "limits-plan.png", dpi=110)
    loop = se.regulate(model, 20, **task)
    se.track((A, B), np.zeros((61, 4)), controller=loop, x0=X0, noise=SIGMA, rng=3)
    loop.plot().savefig(images / "limits-loop.png", dpi=110)


def margins(images: Path) -> None:
    """The figure of how-much-can-go-wrong.md."""
    data = runs(6, np.random.default_rng(1), gaussian)
    model = se.identify(data, noise=SIGMA, scale=SCALE)
    loop = se.gain(model, Q=[1.0, 10.0, 0.1, 1.0], R=0.01)
    loop.certificate(DELTA).margins().plot().savefig(images / "margins.png", dpi=110)


def which_number(images: Path, sets: int = 60) -> None:
    """The figure and the table of "Which number should I trust?": medians, noise included."""
    rows = []
    for N in SIZES:
        numbers, ends = [], []
        for seed in range(sets):
            rng = np.random.default_rng([seed, N, 7])
            data = runs(N, rng, gaussian)
            plain = se.identify(data, noise=SIGMA, scale=SCALE, checks=False)
            model = se.identify(
                data, noise=SIGMA, pilot=se.Pilot(0.1, reference=(X0, XF, STEPS)), checks=False
            )
            if plain.warnings or model.warnings:
                continue
            any_plan = se.control(plain, X0, XF, steps=STEPS).bound(DELTA, noise=True)
            plan = se.control(model, X0, XF, steps=STEPS)
            w = SIGMA * rng.standard_normal((119, STEPS, 4))
            x = np.empty((119, STEPS + 1, 4))
            x[:, 0] = X0
            for k in range(STEPS):
                x[:, k + 1] = x[:, k] @ A.T + plan.u[k] @ B.T + w[:, k]
            typical = plan.typical(DELTA, noise=True)
            held = plan.validate(x[:19], DELTA)
            numbers.append([any_plan.target, typical.certified, typical.miss, held.target])
            ends.append(np.linalg.norm(x[19:, -1] - XF, axis=1))
        rows.append([*np.median(numbers, axis=0), np.quantile(ends, 1 - DELTA)])
        print(f"| {N} | " + " | ".join(f"{value:.2g}" for value in rows[-1]) + " |")
    any_plan, guaranteed, typical, validated, truth = np.array(rows).T
    ax = draw_certificates(
        np.array(SIZES),
        {
            "guaranteed, any design": (any_plan, None),
            "guaranteed, reference declared": (guaranteed, truth),
            "typical": (typical, None),
            "validated, 19 runs": (validated, None),
        },
        across="measured runs N",
        up="distance from the target after 10 steps",
        kinds=("the number", "truth: 95 % of the next runs"),
    )
    ax.set_yticks([0.05, 0.1, 0.2], ["0.05", "0.1", "0.2"])
    ax.figure.savefig(images / "which-number.png", dpi=110)


def draw(found: dict[str, list[Result]], images: Path) -> None:
    """The figure of certificates over N."""
    curves = {
        name: (
            np.array([np.median(one.certificates) for one in results]),
            np.array([np.median(one.errors) for one in results]),
        )
        for name, results in found.items()
    }
    ax = draw_certificates(
        np.array(SIZES), curves, across="runs N", up="distance from the target after 10 steps"
    )
    ax.figure.savefig(images / "certificates.png", dpi=110)


if __name__ == "__main__":
    main()
