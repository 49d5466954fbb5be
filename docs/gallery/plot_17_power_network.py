"""
How many steps bring a network of ten generators back?
======================================================

The New England network with 39 buses, after a disturbance has moved its angles. With a mechanical
power for each of the ten generators one step can stop the machines, but not return the angles. Two
steps can, with hundreds of megawatts, and more steps take less. Where all is known from random
realizations only, the error tends to grow with the number of steps.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

system = se.cases.ieee39(dt=0.1)  # 10 angles [rad], 10 speeds [rad/s]; powers [pu of 100 MVA]
x0 = np.concatenate([0.02 * np.random.default_rng(5).standard_normal(10), np.zeros(10)])
xf = np.zeros(20)

# %%
# With the exact system: what is out of reach, and the largest power. Then the same from a million
# realizations, with a bound of the distance from the target.
steps = [1, 2, 4, 6, 8]
exact = [se.control(system, x0, xf, steps=K) for K in steps]
drawn = [se.steer(system, x0, xf, 10**6, steps=K, rng=1) for K in steps]
ends = [np.linalg.norm(se.simulate(system, x0, plan.u).states[-1] - xf) for plan in drawn]
bounds = [plan.bound(0.05).target for plan in drawn]
for K, plan, end in zip(steps, exact, ends, strict=True):
    power = 100 * abs(plan.u).max()
    print(f"K = {K}: {plan.reachability.relative:.0%} out of reach, {power:.0f} MW, ends {end:.4f}")

# %%
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8))
left.semilogy(steps, [100 * abs(plan.u).max() for plan in exact], "o-")
left.set(xlabel="steps of 0.1 s", ylabel="largest power of a generator [MW]")
left.set(xlim=(0, 9), title="The largest power")
right.axhline(np.linalg.norm(x0), color="0.6", lw=0.8)
right.semilogy(steps, bounds, "o-", color="C2")
right.semilogy(steps, ends, "o-", color="C0")
right.text(8.2, bounds[-1], "bound, 95 %", color="C2", va="center")
right.set_title("The end, from a million realizations")
right.text(8.2, ends[-1], "really", color="C0", va="center")
right.text(8, np.linalg.norm(x0), "at the start", color="0.35", ha="right", va="bottom")
right.set(xlabel="steps of 0.1 s", ylabel="distance from the target", xlim=(0.8, 10.5))
plt.show()
