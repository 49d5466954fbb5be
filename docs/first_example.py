"""Draw the picture of the README's first example: python docs/first_example.py [OUT.png].

The rotors of a power network with five generators shall be back at their angles in one step of
0.1 s, from at most 0.02 rad (1 degree) away. The state x0 and the matrix A are only seen through
random realizations, each of which keeps one entry of x0 and one entry in every column of A.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import stochens_rs as se

SIZE = 10_000
SYSTEM = se.cases.ieee14(dt=0.1)  # n = 10 states, m = 5 inputs
X0 = np.array([0.0, 0.02, -0.015, 0.01, -0.005, *[0.0] * 5])  # angles [rad], speeds [rad/s]
XF = np.zeros(SYSTEM.n)  # where it shall be one step later
TARGETS = (X0, XF, SYSTEM.A)
EXACT = np.linalg.pinv(SYSTEM.B) @ (XF - SYSTEM.A @ X0)  # v*: what full knowledge would apply

INK, FUSED, OTHER, PALE = "#222222", "#0072b2", "#d55e00", "#c8c8c8"


def controls(ax: Axes) -> None:
    """One realization is useless, and 10 000 fused ones are not."""
    rng = np.random.default_rng(2)
    x0, xf, A = (se.sample(target, SIZE, rng=rng) for target in TARGETS)
    single = se.realization_controls((A, SYSTEM.B), x0, xf)  # (SIZE, m)
    plan = se.control((A, SYSTEM.B), x0, xf)

    inputs = np.arange(1, SYSTEM.m + 1)
    low, high = np.quantile(single, [0.05, 0.95], axis=0)
    ax.bar(inputs, high - low, bottom=low, width=0.5, color=PALE, label="one realization, 90 %")
    ax.hlines(EXACT, inputs - 0.34, inputs + 0.34, color=INK, linewidth=2, label="exact control")
    ax.plot(inputs, plan.u[0], "o", color=FUSED, label=f"{SIZE:,} realizations fused")
    ax.use_sticky_edges = False  # or the axis ends where the longest bar does
    ax.set(
        xlabel="generator",
        ylabel="mechanical power [pu of 100 MVA]",
        xticks=inputs,
        title="The control",
    )
    ax.legend(frameon=False, loc="upper right")


def errors(ax: Axes) -> None:
    """How the error falls with the number of realizations, seen and predicted."""
    sizes = np.unique(np.logspace(1, 5, 17).astype(int))
    norm = float(np.linalg.norm(EXACT))
    looks = (("iid", FUSED, "independent draws"), ("systematic", OTHER, "systematic draws"))
    for scheme, colour, label in looks:
        rng = np.random.default_rng(2)
        seen = []
        for size in sizes:
            x0, xf, A = (se.sample(t, size, rng=rng, scheme=scheme) for t in TARGETS)
            plan = se.control((A, SYSTEM.B), x0, xf)
            seen.append(plan.error(SYSTEM, X0, XF).control_relative)
        ax.loglog(sizes, seen, "o", color=colour, label=f"{label}, one run")
    rms = [se.theory.moments.control_rms(SYSTEM, X0, XF, int(size)) / norm for size in sizes]
    ax.loglog(sizes, rms, color=FUSED, label="independent draws, predicted rms")
    ax.set(xlabel="realizations", ylabel="relative error", title="Its error")
    ax.legend(frameon=False, loc="lower left")


def main() -> None:
    """Draw both panels into one file."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images/first-example.png")
    out.parent.mkdir(parents=True, exist_ok=True)
    with plt.rc_context({"axes.spines.top": False, "axes.spines.right": False, "font.size": 9}):
        figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
        controls(left)
        errors(right)
        figure.savefig(out, dpi=160)
    print(out)


if __name__ == "__main__":
    main()
