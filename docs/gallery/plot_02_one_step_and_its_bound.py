"""
How far off can a control from 10 000 realizations be?
======================================================

Neither the network nor its state is given here, only random realizations with one nonzero entry in
each column. Their averages give the control of one step, and a simulation of the draws gives a
bound that holds with the probability you ask for.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

system = se.cases.ieee14(dt=0.1)  # five generators, inputs in pu of 100 MVA
x0 = np.array([0.0, 0.02, -0.015, 0.01, -0.005, *[0.0] * 5])  # angles [rad], speeds [rad/s]
xf = np.zeros(10)

# %%
# One call draws the realizations, averages them, and computes the control.
plan = se.steer(system, x0, xf, 10_000, rng=2)
bound = plan.bound(0.05)  # each radius is exceeded with probability 5 % at most
error = plan.error(system, x0, xf)
print(f"state within {bound.state:.4f}, off by {error.state:.4f}")
print(f"control within {bound.control:.4f} pu, off by {error.control:.4f} pu")

# %%
# Is that bound right, and is it tight? Draw everything again 500 times.
again = [se.steer(system, x0, xf, 10_000, rng=seed).error(system, x0, xf) for seed in range(500)]
errors = np.array([one.control for one in again])
print(f"beyond the bound: {np.mean(errors > bound.control):.1%} of 500")

# %%
exact = se.control(system, x0, xf).u[0]
fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6))
machines = np.arange(1, 6)
left.bar(machines, exact, color="0.8", width=0.6)
left.plot(machines, plan.u[0], "o", color="C0")
left.text(2.35, exact[1], "bars: exact", color="0.35")
left.text(2.35, exact[1] - 0.008, "dots: 10 000 realizations", color="C0")
left.set(xlabel="generator", ylabel="mechanical power [pu]", title="The control")
right.hist(errors, bins=30, color="C0")
right.axvline(bound.control, color="C2", lw=2)
right.text(1.02 * bound.control, 20, " bound\n for 5 %", color="C2")
right.set(xlabel=r"error of the control, $\|u - v\|_2$ [pu]", ylabel="of 500 repetitions")
right.set_title("Its error in repetitions, and the bound")
right.set_xlim(0, 1.3 * max(bound.control, errors.max()))
plt.show()
