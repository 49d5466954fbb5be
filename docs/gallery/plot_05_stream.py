"""
When may a stream of realizations stop?
=======================================

Realizations arrive one by one, and the control is up to date after each. The stream stops when a
certificate shows that the state is at most 0.001 away from where the exact control leads. A rule
that looks at the last change of the control instead stops far too early.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

system = se.cases.ieee14(dt=0.1)
x0 = np.array([0.0, 0.02, -0.015, 0.01, -0.005, *[0.0] * 5])  # angles [rad], speeds [rad/s]
xf = np.zeros(10)

stream = se.Stream(system, x0, xf, rng=1)
run = stream.run(tol=1e-3)
print(run.status, f"after {run.steps} steps: error {run.error:.5f} <= {run.certificate:.5f}")

# %%
# Stop where the control has changed by less than the tolerance, on the same realizations:
hasty = se.Stream(system, x0, xf, rng=1)
early = hasty.run(tol=1e-3, rule="printed")
print(early.status, f"after {early.steps} steps: error {early.error:.5f}")

# %%
# The stream knows the exact system here, so the true error can be drawn beside the
# certificate. ``DataStream`` needs no exact values, ``ModelStream`` none but measured pairs.
trace = stream.trace
fig, ax = plt.subplots(figsize=(7, 4))
ax.loglog(trace.steps, trace.errors, color="C0")
ax.loglog(trace.steps, trace.certificates, color="C2")
ax.axhline(1e-3, color="0.5", lw=0.8)
ax.text(1.1, 1.1e-3, "tolerance", color="0.35")
ax.plot(early.steps, early.error, "X", color="0.1", ms=9)
ax.text(1.1, 0.015, "the last change is small:\nstops at the cross", color="0.1")
middle = len(trace.steps) * 2 // 3
ax.text(trace.steps[middle], 2.0 * trace.certificates[middle], "certificate", color="C2")
ax.text(trace.steps[middle], 0.4 * trace.errors[middle], "error", color="C0", ha="right")
ax.set(xlabel="realizations", ylabel=r"$\|B (u - v)\|_2$ (rad and rad/s)", xlim=(1, None))
ax.set_title("The certificate says when to stop")
plt.show()
