"""
Eight models and ten measurements: which model is right?
========================================================

Eight candidate models of a grid with ten machines differ in inertia and damping. Seconds of
measurements are too few to identify its 600 unknowns. Fused by the data, the models predict better
than the best of them and than their mean; where the data contradict all of them, least squares
takes over by itself.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")
warnings.simplefilter("ignore", se.exceptions.DataWarning)  # few pairs: directions without data

system = se.cases.ieee39(dt=0.05, method="euler")  # n = 20, m = 10
SIGMA = 0.02  # of the noise of a step
SIZE = np.repeat([0.2, 0.5, 1.0], 10)  # of angles [rad], speeds [rad/s], powers [pu]


def grid(rng, spread=0.3):
    """[A B] of machines whose inertia and damping vary by this share."""
    inertia, damping = np.exp(spread * rng.standard_normal((2, 10)))
    A, B = system.A.copy(), system.B.copy()
    A[10:, 10:] = np.eye(10) + (A[10:, 10:] - np.eye(10)) * damping[:, None]
    A[10:] = np.eye(10, 20, 10) + (A[10:] - np.eye(10, 20, 10)) / inertia[:, None]
    B[10:] /= inertia[:, None]
    return np.hstack([A, B])


# %%
# The error is that of the prediction of one step on fresh states and inputs, in units of the noise:
# for a grid that is a mixture of the models, and for one with inertias and dampings of its own.
NAMES = "best single model", "mean of the models", "least squares", "fused by the data"


def errors(N, rng, mixed):
    """The errors of all estimates after N measured steps."""
    models = np.array([grid(rng) for _ in range(8)])
    truth = np.tensordot(rng.dirichlet(np.ones(8)), models, 1) if mixed else grid(rng, 0.6)
    z = SIZE * rng.standard_normal((N, 30))
    y = z @ truth.T + SIGMA * rng.standard_normal((N, 20))
    data = se.Trajectories.from_pairs(z[:, :20], z[:, 20:], y)
    given = se.SystemEnsemble(models[:, :, :20], models[:, :, 20:])
    fused = se.fuse(given, "alse", data=data, noise=se.Noise(sigma=SIGMA, design="independent"))
    least = fused.least_squares
    best = min(models, key=lambda one: np.linalg.norm(y - z @ one.T))
    found = best, models.mean(axis=0), np.hstack([least.A, least.B]), np.hstack([fused.A, fused.B])
    return [np.linalg.norm((one - truth) * SIZE) / SIGMA for one in found]


sizes = [3, 10, 20, 40, 100, 400]
fig, axes = plt.subplots(1, 2, figsize=(11, 4), sharey=True)
for ax, mixed in zip(axes, (True, False), strict=True):
    seen = [[errors(N, np.random.default_rng([r, N]), mixed) for r in range(3)] for N in sizes]
    rms = np.sqrt(np.mean(np.square(seen), axis=1))
    for k, (name, curve) in enumerate(zip(NAMES, rms.T, strict=True)):
        color = ("C1", "0.5", "C2", "C0")[k]
        ax.loglog(sizes, curve, "o-", color=color, lw=3 if k == 3 else 1.5)
        if mixed:
            ax.text(450, curve[-1], name, color=color, va="center")
    ax.axhline(1.0, color="0.6", lw=0.8)
    ax.set_xticks(sizes, [str(N) for N in sizes])
    ax.minorticks_off()
axes[1].text(3, 0.95, "the noise of a step", color="0.35", va="top")
axes[0].set(xlabel="measured steps N", ylabel="error of a prediction / noise (rms)")
axes[0].set(xlim=(2.8, 5000), title="A mixture of the models is right")
axes[1].set(xlabel="measured steps N", title="No mixture is right")
plt.show()
