"""Certificates of plans of the rig, without and with a pilot: python benches/pilot.py [sets].

For N runs of 10 steps and a plan of 10 steps at delta = .05: the median and the 95 % quantile of
the true miss of least squares of all runs, then the medians of the certificates (over that
quantile), and how often they failed.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np

import stochens_rs as se

sys.path.insert(0, str(Path(__file__).parents[1] / "docs"))
from rig import SCALE, SIGMA, STEPS, X0, XF, A, B, gaussian, runs

WAYS = {
    "any design": {"sigma": SIGMA, "scale": SCALE},
    "pilot": {"sigma": SIGMA, "pilot": 0.1},
    "pilot, reference": {"sigma": SIGMA, "pilot": 0.1, "reference": (X0, XF, STEPS)},
    "the same, sigma unknown": {
        "covariance": "scalar",
        "pilot": 0.1,
        "reference": (X0, XF, STEPS),
    },
}


def miss(u: np.ndarray) -> float:
    """Where the true rig ends."""
    return float(np.linalg.norm(se.simulate((A, B), X0, u).states[-1] - XF))


def main(sets: int) -> None:
    """Print one line for each way and number of runs."""
    warnings.simplefilter("ignore", se.exceptions.DataWarning)
    for N in (10, 20, 50, 100, 400):
        found: dict[str, list[tuple[float, float]]] = {name: [] for name in WAYS}
        for seed in range(sets):
            data, _ = runs(N, np.random.default_rng([seed, N, 77]), gaussian)
            for name, options in WAYS.items():
                model = se.identify(data, checks=False, **options)
                plan = se.control(model, X0, XF, steps=STEPS)
                found[name].append((plan.bound(0.05).target, miss(plan.u)))
        all_runs = [error for _, error in found["any design"]]
        q = float(np.quantile(all_runs, 0.95))
        print(f"N={N}: miss {np.median(all_runs):.4f}, 95 % {q:.4f}, {sets} sets")
        for name, pairs in found.items():
            targets, errors = (np.array(column) for column in zip(*pairs, strict=True))
            print(
                f"  {name}: {np.median(targets):.4f} ({np.median(targets) / q:.2f}), "
                f"failed {int(np.sum(errors > targets))}"
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
