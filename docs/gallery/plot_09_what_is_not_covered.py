"""
What does a certificate from data not cover?
============================================

A certificate covers the noise and the finite number of runs. It does not cover that the system is
not linear. Here a pendulum with a motor at its pivot, held near the upright position in the runs,
is asked to come back from ever larger angles.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

DT, SIGMA = 0.05, 1e-4


def step(x, u, parts=10):
    """Angle [rad] and rate [rad/s] after 0.05 s with the acceleration u [rad/s^2]."""
    x = np.array(x, dtype=float)
    for _ in range(parts):  # semi-implicit Euler
        x[..., 1] += DT / parts * (9.81 * np.sin(x[..., 0]) + u)
        x[..., 0] += DT / parts * x[..., 1]
    return x


def runs(excursion, rng, count=100, steps=5):
    """Measured runs near upright under random accelerations."""
    x, u = [excursion * rng.standard_normal((count, 2))], excursion * 10
    u = u * rng.standard_normal((count, steps, 1))
    for k in range(steps):
        x.append(step(x[-1], u[:, k, 0]) + SIGMA * rng.standard_normal((count, 2)))
    return se.Trajectories(np.stack(x, axis=1), u, dt=DT)


# %%
# Runs of small excursions make a good linear model for small angles, and no residual can warn of
# angles that no run has visited. Runs of large excursions are not linear: the residuals say so, and
# as states one step earlier explain most of what is left, nothing is certified.
angles = np.geomspace(0.01, 1.5, 14)
found = {}
for excursion in (0.02, 0.3):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        model = se.identify(runs(excursion, np.random.default_rng(1)), noise=SIGMA)
    print(f"runs of {excursion} rad: {len(said)} warning", *(str(one.message) for one in said))
    rows = []
    for angle in angles:
        plan = se.control(model, [angle, 0.0], [0.0, 0.0], steps=10)
        x = np.array([angle, 0.0])
        for u in plan.u:
            x = step(x, u[0])
        rows.append((plan.bound(0.05).target, np.linalg.norm(x)))
    found[excursion] = np.array(rows)

# %%
fig, axes = plt.subplots(1, 2, figsize=(9.5, 3.8), sharey=True)
for ax, (excursion, rows) in zip(axes, found.items(), strict=True):
    ax.axvspan(angles[0], 2 * excursion, color="0.92")
    ax.text(0.03, 0.92, "grey: where most runs were", color="0.35", transform=ax.transAxes)
    if np.isinf(rows[:, 0]).all():
        ax.text(0.03, 0.84, "no certificate: see model.doubts", color="C0", transform=ax.transAxes)
    for column, color, label in ((0, "C0", "certificate"), (1, "C2", "true error")):
        if np.isinf(rows[:, column]).all():
            continue
        ax.loglog(angles, rows[:, column], "o-", color=color, ms=4)
        ax.text(1.7, rows[-1, column], label, color=color, va="center")
    ax.set(xlabel="the task starts at [rad]", title=f"Runs of about {excursion} rad")
    ax.set_xlim(angles[0], 15)
    ax.set_ylim(5e-5, 10)
axes[0].set_ylabel("distance from upright (2-norm)")
plt.show()
