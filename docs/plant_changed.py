"""Figure of plant-changed.md: python docs/plant_changed.py [--steps N] [--runs N].

False alarms of four plants in closed loop over the steps, and delays of detection for three faults
beside a CUSUM that knows the plant before and after the fault, of the same promise. Then, as a
table, which effects can have changed by the pairs after an alarm.
"""

from __future__ import annotations

import argparse
import pickle
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import stochens_rs as se

Floats = NDArray[np.float64]
EVERY, LONGEST, LOOKS = 1000.0, 3000, (30, 100, 400)
#: A, B, deviations of the noise, and of the dither.
PLANTS: dict[str, tuple[Any, Any, Any, float]] = {
    "pendulum on a cart": (
        [
            [1, -0.0099, 0.1, -0.0003],
            [0, 1.0594, 0, 0.102],
            [0, -0.2001, 1, -0.0099],
            [0, 1.2004, 0, 1.0594],
        ],
        [[0.005], [-0.005], [0.1003], [-0.102]],
        [5e-4] * 4,
        0.5,
    ),
    "two rooms, heated": ([[0.95, 0.03], [0.02, 0.9]], [[4e-4], [0.0]], [0.05, 0.05], 300.0),
    "unstable, scalar": ([[1.2]], [[1.0]], [0.1], 0.3),
    "resonance": (
        [[1, 0.1, 0], [0, 0.95, -0.3], [0, 0.3, 0.95]],
        [[0.0], [0.1], [0.2]],
        [0.01, 0.02, 0.02],
        1.0,
    ),
}


class Plant:
    """A plant in closed loop, its alarm, and faults."""

    def __init__(self, name: str, seed: int) -> None:
        A, B, sizes, self.dither = PLANTS[name]
        self.A, self.B, self.sizes = (np.array(one, dtype=np.float64) for one in (A, B, sizes))
        self.rng = np.random.default_rng(seed)
        Q, R = np.diag(self.sizes**-2), np.eye(1) / self.dither**2
        self.K = se.gain((self.A, self.B), Q, R).K
        runs = [self.follow(50) for _ in range(20)]
        data = se.Trajectories(*zip(*runs, strict=True))
        model = se.identify(data, noise=se.Noise(covariance=np.diag(self.sizes**2)))
        proof = se.gain(model, Q, R).certificate(0.05)
        self.K, self.watch = proof.K, proof.watch(every=EVERY)

    def follow(self, steps: int, fault: Any = None) -> tuple[Floats, Floats]:
        """States and inputs; the fault is there from the first step on."""
        A, B, load = (self.A, self.B, 0.0) if fault is None else fault
        x, u = [self.sizes * self.rng.standard_normal(len(A))], []
        for _ in range(steps):
            u.append(self.K @ x[-1] + self.dither * self.rng.standard_normal(1))
            noise = self.sizes * self.rng.standard_normal(len(A))
            x.append(A @ x[-1] + B @ u[-1] + load + noise)
        return np.array(x), np.array(u)

    @property
    def faults(self) -> dict[str, Any]:
        """A, B and a load of each fault."""
        load = np.zeros(len(self.A))
        load[-1] = self.sizes[-1]
        return {
            "input at 70 %": (self.A, 0.7 * self.B, 0.0),
            "input at 90 %": (self.A, 0.9 * self.B, 0.0),
            "load of 1 deviation": (self.A, self.B, load),
        }

    def false_alarms(self, steps: int) -> Floats:
        """How many alarms there were after each step without a fault."""
        x, u = self.follow(steps)
        pairs = zip(x, u, strict=False)
        return np.array([self.watch(*pair).alarms for pair in pairs], dtype=np.float64)

    def delays(self, fault: Any) -> tuple[float, float]:
        """Of the alarm, which has run without a fault before, and of the CUSUM."""
        watch = pickle.loads(pickle.dumps(self.watch))
        x, u = self.follow(200)
        for pair in zip(x, u, strict=False):
            watch(*pair)
        watch.clear()
        x, u = self.follow(LONGEST, fault)
        found = [np.inf, np.inf]
        sum_, (A, B, load) = 0.0, fault
        watch(np.full(len(A), np.nan), u[0])  # the run begins anew
        for k in range(LONGEST):
            if np.isinf(found[0]) and watch(x[k], u[k]).status == "alarm":
                found[0] = k
            off = (x[k + 1] - self.A @ x[k] - self.B @ u[k]) / self.sizes
            shift = ((A - self.A) @ x[k] + (B - self.B) @ u[k] + load) / self.sizes
            sum_ = max(0.0, sum_) + shift @ off - shift @ shift / 2.0
            if np.isinf(found[1]) and sum_ >= np.log(EVERY):
                found[1] = k + 1
            if np.isfinite(found).all():
                break
        return found[0], found[1]

    def explanations(self, fault: Any) -> list[set[str]]:
        """What alone can have changed, by so many pairs after the alarm; none: nothing proved."""
        watch = pickle.loads(pickle.dumps(self.watch))
        watch.clear()
        x, u = self.follow(LONGEST + LOOKS[-1], fault)
        watch(np.full(len(self.A), np.nan), u[0])  # the run begins anew
        found, alarmed = [], 0
        for pair in zip(x, u, strict=False):
            alarmed += watch(*pair).status == "alarm"
            if alarmed - 1 in LOOKS[len(found) : len(found) + 1]:
                found.append(set(watch.changes().explanations))
            if len(found) == len(LOOKS):
                break
        return found


def table(plants: dict[str, Plant], runs: int) -> None:
    """In how many runs a change is proved, how many explanations are left, and true ones lost."""
    pairs = " | ".join(f"{count} pairs" for count in LOOKS)
    print(f"| plant | changed | explanations | {pairs} | true one refuted |")
    for name, plant in plants.items():
        n = len(plant.A)
        slower = plant.A.copy()
        slower[-1, -1] -= 0.2
        for fault, true, what in (
            ((plant.A, 0.5 * plant.B, 0.0), "u[0]", "input at 50 %"),
            ((slower, plant.B, 0.0), f"x[{n - 1}](k+1)", "last entry of A less 0.2"),
        ):
            every = [found for _ in range(runs) if len(found := plant.explanations(fault)) == 3]
            cells, lost = [], 0
            for k in range(len(LOOKS)):
                proved = [one[k] for one in every if one[k]]
                left = f", {np.mean([len(one) for one in proved]):.1f} left" if proved else ""
                cells.append(f"{len(proved)} of {len(every)}{left}")
                lost += sum(true not in one for one in proved)
            print(f"| {name} | {what} | {2 * n + 1} | {' | '.join(cells)} | {lost} |")


def main(steps: int, runs: int, path: Path) -> None:
    """Draw both panels, and print their numbers."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.0), layout="constrained")
    left.plot([0, steps], [0, steps / EVERY], "k--", linewidth=1, label="promised")
    places, names, plants = [], [], {name: Plant(name, i) for i, name in enumerate(PLANTS)}
    for i, (name, plant) in enumerate(plants.items()):
        alarms = plant.false_alarms(steps)
        left.step(np.arange(len(alarms)), alarms, label=name, color=f"C{i}")
        print(f"{name}: {alarms[-1]:.0f} false alarms in {steps} steps")
        for j, (fault, change) in enumerate(plant.faults.items()):
            own, known = np.array([plant.delays(change) for _ in range(runs)]).T
            at = 4.0 * j + 0.7 * i
            low, middle, high = np.quantile(own, (0.1, 0.5, 0.9), method="nearest")
            right.plot([at, at], [low, min(high, LONGEST)], color=f"C{i}", linewidth=2)
            right.plot(at, middle, "o", color=f"C{i}")
            right.plot(at, np.median(known), "_", color="k", markersize=12)
            ratio = middle / np.median(known)
            print(f"  {fault}: {middle:.0f} steps, CUSUM {np.median(known):.0f}: {ratio:.1f} times")
            places, names = [*places, at], [*names, fault]
    left.set(xlabel="step", ylabel="false alarms", title="Without a fault")
    left.legend(frameon=False)
    right.set_yscale("log")
    right.set_xticks([4.0 * j + 1.05 for j in range(3)], list(dict.fromkeys(names)))
    right.set(ylabel="delay [steps]", title="Delay (10 %, median, 90 %); black: CUSUM")
    for ax in (left, right):
        ax.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    table(plants, runs)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--runs", type=int, default=40)
    given = parser.parse_args()
    main(given.steps, given.runs, Path(__file__).parent / "images" / "plant-changed.png")
