"""
How many realizations keep the error of the control below 5 %?
==============================================================

Asked before anything is drawn. Every bound answers with a number that is enough; the simulated one
is close to the number that is needed, and the formulas hold for every probability.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

system = se.cases.ieee14(dt=0.1)
x0 = np.array([0.0, 0.02, -0.015, 0.01, -0.005, *[0.0] * 5])  # angles [rad], speeds [rad/s]
xf = np.zeros(10)
need = se.required_samples(system, x0, xf, 0.05, delta=0.01, quantity="control", rng=1)
print(need)

# %%
# ``expected_size`` brings the root mean square error there, which is no guarantee.
names = [row.name for row in need.rows] + ["expected error, no guarantee"]
sizes = [row.size for row in need.rows] + [need.expected_size]

# %%
# On the right the error that one in a hundred repetitions exceeds, over the number of realizations.
norm = np.linalg.norm(se.control(system, x0, xf).u)
grid = np.geomspace(1000, 200_000, 6).astype(int)
bound = [se.theory.drawn_bound("control", system, x0, xf, size=N, delta=0.01)[0] for N in grid]
radii = np.array(bound) / norm
rms = [se.theory.moments.control_rms(system, x0, xf, int(N)) / norm for N in grid]

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), width_ratios=(1.2, 1))
left.plot(sizes[:-1], names[:-1], "o", ms=8)
left.plot(sizes[-1:], names[-1:], "o", ms=8, color="0.6")
for k, size in enumerate(sizes):
    left.text(size * 1.25, k, f"{size:,}", va="center", color="0.25")
left.set(
    xscale="log",
    xlim=(1000, 10 * max(sizes)),
    xlabel="realizations that are enough",
    title="How many do the bounds ask for?",
)
left.invert_yaxis()
right.loglog(grid, radii, "o-", color="C0")
right.loglog(grid, rms, color="0.5")
right.axhline(0.05, color="C2", lw=1)
right.text(grid[0], 0.052, "5 %", color="C2", va="bottom")
right.text(grid[3], 1.3 * radii[3], "bound for 1 %", color="C0")
right.text(grid[3], 0.5 * rms[3], "rms, exact", color="0.35", ha="right")
right.set(
    xlabel="realizations N",
    ylabel="relative error of the control",
    title="The error over their number",
)
plt.show()
