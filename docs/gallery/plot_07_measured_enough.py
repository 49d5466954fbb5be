"""
When have I measured enough?
============================

Experiments cost time. A ``ModelStream`` may be asked after every run whether the data are enough,
inputs may react to what was seen, and stopping at the first yes is valid: all looks are one event
of probability 5 %.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

A = np.array([[1.0, 0.1], [-0.2, 0.95]])  # position [m], speed [m/s]; only the runs see it
B = np.array([[0.0], [0.1]])  # force [N]
x0, xf, tol = np.array([1.0, 0.0]), np.zeros(2), 0.1
rng = np.random.default_rng(4)

# %%
# Noise of one unknown covariance, and a feedback in the runs. After each run of ten pairs: what
# would a control of 20 steps achieve, and how many more pairs will it take?
stream = se.ModelStream(2, 1, delta=0.05)
looks, errors = [], []
while not looks or not looks[-1].stop:
    x = rng.standard_normal(2)
    for _ in range(10):
        u = -0.5 * x[1:] + rng.standard_normal(1)
        following = A @ x + B @ u + 0.01 * rng.standard_normal(2)
        stream.update(x, u, following)
        x = following
    looks.append(stream.look(x0, xf, steps=20, tol=tol))
    errors.append(np.linalg.norm(se.simulate((A, B), x0, looks[-1].u).states[-1] - xf))
print(looks[-1])
print(looks[-1].certificate.assumption)

# %%
# The forecast assumes that the data go on like those so far. It is no bound.
pairs = np.array([look.size for look in looks])
certificates = np.array([look.certificate.target for look in looks])
ends = pairs + np.array([look.forecast for look in looks])
fig, (top, bottom) = plt.subplots(2, 1, figsize=(7, 5), sharex=True, height_ratios=(3, 2))
seen = certificates < 100  # for the first runs it is huge or infinite
top.semilogy(pairs[seen], certificates[seen], "o-", color="C0", ms=4)
top.semilogy(pairs, errors, "o-", color="C2", ms=4)
top.axhline(tol, color="0.5", lw=0.8)
top.text(10, 1.15 * tol, "tolerance", color="0.35")
top.text(105, 0.5, "certificate", color="C0")
top.text(105, 0.006, "where the system would really end", color="C2")
top.set(ylabel="distance from xf (2-norm)", title="After each run: enough?")
known = np.isfinite(ends)
bottom.plot(pairs[known], ends[known], "o-", color="C1", ms=4)
bottom.axhline(pairs[-1], color="0.5", lw=0.8)
bottom.text(pairs[-1], 330, f"stopped at {pairs[-1]} pairs", color="0.35", ha="right")
bottom.set(
    xlabel="measured pairs",
    ylabel="forecast of the end [pairs]",
    ylim=(0, None),
    title="How many will it take?",
)
plt.show()
