"""
May I close the loop?
=====================

A pendulum stands upright on a cart. All that is known are short runs with a random force. From N of
them a model is identified and a control over ten steps computed, back to rest from 10 cm and
0.05 rad away. The certificate says how far from rest the true rig can end, and is valid at every N.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")
# One log in a hundred fails a test by chance: no bound of it is finite, and a warning says so.
warnings.simplefilter("ignore", se.exceptions.DataWarning)

# The rig: position [m], angle [rad], speed [m/s], rate [rad/s]; force [N]. Only runs see it.
A = np.array([[1.0, -0.0099, 0.1, -0.0003], [0.0, 1.0594, 0.0, 0.102],
              [0.0, -0.2001, 1.0, -0.0099], [0.0, 1.2004, 0.0, 1.0594]])  # fmt: skip
B = np.array([[0.005], [-0.005], [0.1003], [-0.102]])
SIGMA = 0.0005  # of the noise of a step
SCALE = [0.1, 0.01, 0.1, 0.03, 1.0]  # expected sizes of states and force, before the data
x0, rest = np.array([0.1, 0.05, 0.0, 0.0]), np.zeros(4)


def runs(count, rng, steps=10):
    """So many runs from random states under random forces."""
    u, w = rng.standard_normal((count, steps, 1)), SIGMA * rng.standard_normal((count, steps, 4))
    x = [SCALE[:4] * rng.standard_normal((count, 4))]
    for k in range(steps):
        x.append(x[-1] @ A.T + u[:, k] @ B.T + w[:, k])
    return se.Trajectories(np.stack(x, axis=1), u, dt=0.1)


# %%
# What is declared about the noise decides what can be said. With all pairs of the runs any design
# is allowed, also feedback; without a known size of the noise it takes more runs. The last pair of
# each run is independent of the noise in it, and has an exact region, but there are few of them.
ways = {
    "noise of known size": lambda data: se.identify(data, noise=SIGMA, scale=SCALE, checks=False),
    "unknown size": lambda data: se.identify(data, scale=SCALE, checks=False),
    "last pairs only": lambda data: se.identify(
        data.last_pairs(), noise=se.Noise(design="independent"), checks=False
    ),
}
sizes, seeds = np.array([10, 20, 50, 100, 400]), 15
found = {name: np.empty((len(sizes), seeds, 2)) for name in ways}
for i, N in enumerate(sizes):
    for seed in range(seeds):
        data = runs(int(N), np.random.default_rng([seed, int(N)]))
        for name, way in ways.items():
            plan = se.control(way(data), x0, rest, steps=10)
            end = se.simulate((A, B), x0, plan.u).states[-1]
            found[name][i, seed] = plan.bound(0.05).target, np.linalg.norm(end)
beyond = sum(int(np.sum(one[..., 1] > one[..., 0])) for one in found.values())
print(f"the rig ended beyond its certificate in {beyond} of {3 * len(sizes) * seeds} cases")

# %%
fig, ax = plt.subplots(figsize=(7.5, 4.2))
for k, (name, one) in enumerate(found.items()):
    certificate, error = np.median(one, axis=1).T
    ax.loglog(sizes, certificate, "o-", color=f"C{k}")
    if k != 1:  # with all pairs the same control, whether the size of the noise is known or not
        ax.loglog(sizes, error, ":", color=f"C{k}")
    ax.text(440, certificate[-1] * (0.62, 1.0, 1.2)[k], name, color=f"C{k}", va="center")
ax.axhline(0.1, color="0.5", lw=0.8)
ax.text(2100, 0.105, "0.1: close the loop", ha="right", va="bottom", color="0.35")
ax.text(440, 0.004, "dotted: where the\nrig really ended", color="0.35", va="center")
ax.set(xlabel="runs N of one second", ylabel="distance from rest (2-norm)", xlim=(9, 2200))
ax.set_title("How far from rest may the rig end, with 95 %?")
ax.set_xticks(sizes, [str(N) for N in sizes])
ax.minorticks_off()
plt.show()
