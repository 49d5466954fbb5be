"""
What do the limits of the motor cost?
=====================================

The pendulum on a cart again, from a model of 30 measured runs. The smallest control that brings it
to rest in two seconds needs several newtons. Within limits the plan says which are active, what
they cost, and how far from the best it can be. (That a plan of two
seconds needs corrections is seen in the middle: the pendulum falls by itself.)
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

# Position [m], angle [rad], speed [m/s], rate [rad/s]; force [N]. Only the runs see A and B.
A = np.array([[1.0, -0.0099, 0.1, -0.0003], [0.0, 1.0594, 0.0, 0.102],
              [0.0, -0.2001, 1.0, -0.0099], [0.0, 1.2004, 0.0, 1.0594]])  # fmt: skip
B = np.array([[0.005], [-0.005], [0.1003], [-0.102]])
SCALE = np.array([0.1, 0.01, 0.1, 0.03, 1.0])

rng = np.random.default_rng(1)
states, inputs = [SCALE[:4] * rng.standard_normal((30, 4))], rng.standard_normal((30, 10, 1))
for k in range(10):
    noise = 0.0005 * rng.standard_normal((30, 4))
    states.append(states[-1] @ A.T + inputs[:, k] @ B.T + noise)
data = se.Trajectories(np.stack(states, axis=1), inputs, dt=0.1)
model = se.identify(data, noise=0.0005, scale=SCALE)

# %%
# One plan of 20 steps for each limit; ``missed`` is what the limit adds to the cost ``objective``.
x0, rest = [0.1, 0.05, 0.0, 0.0], np.zeros(4)
cost = se.Cost(Q=[1.0, 10.0, 0.1, 1.0], R=0.01)
limits = np.geomspace(0.7, 4.0, 15)
plans = [se.control(model, x0, rest, steps=20, limits=(-f, f), cost=cost) for f in limits]
print(plans[3])
print(f"off the least cost by {plans[3].limited.gap:.1e} at most")

# %%
fig, (left, middle, right) = plt.subplots(1, 3, figsize=(11, 3.5))
times = 0.1 * np.arange(21)
for plan, limit, color in ((plans[3], limits[3], "C0"), (plans[-1], limits[-1], "C1")):
    left.stairs(plan.u[:, 0], times, baseline=None, color=color, lw=2)
    at = np.where(plan.limited.active[:, 0] != 0, plan.u[:, 0], np.nan)
    left.stairs(at, times, baseline=None, color=color, lw=5)
    middle.plot(times, 1000 * plan.states((A, B), x0)[:, 1], color=color, lw=2)
    left.text(0.6, limit * 0.6 + 0.2, f"limit {limit:.2g} N", color=color)
left.set(xlabel="time [s]", ylabel="force [N]", title="The force; thick: at its limit")
middle.axhline(0.0, color="0.6", lw=0.8)
middle.set(
    xlabel="time [s]", ylabel="angle of the rig [mrad]", title="What the rig does, uncorrected"
)
costs = [plan.limited.objective for plan in plans]
right.plot(limits, costs, color="C0")
right.fill_between(
    limits, [p.limited.objective - p.limited.missed for p in plans], costs, alpha=0.25
)
right.text(1.3, 1.05 * costs[3], "cost of the plan", color="C0")
right.text(0.75, costs[-1] * 0.8, "shaded: the price of the limit", color="0.35")
right.set(xlabel="limit of the force [N]", ylabel="cost J", ylim=(0, None))
plt.show()
