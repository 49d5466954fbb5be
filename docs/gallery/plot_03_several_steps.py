"""
What can four steps reach that one step cannot?
===============================================

One step of 0.1 s stops the generators but leaves their angles where they are: the target is out of
reach, and the plan says by how much. Four steps bring the angles back, with less power, and the
bound covers all four.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

system = se.cases.ieee14(dt=0.1)
x0 = np.array([0.0, 0.02, -0.015, 0.01, -0.005, *[0.0] * 5])  # angles [rad], speeds [rad/s]
xf = np.zeros(10)

# %%
# The same realizations give both controls. ``target`` bounds the distance from ``xf`` itself, also
# the part that no control of so many steps can reach.
plans = {K: se.steer(system, x0, xf, 100_000, steps=K, rng=2) for K in (1, 4)}
for K, plan in plans.items():
    away = np.linalg.norm(se.simulate(system, x0, plan.u).states[-1] - xf)
    print(f"K = {K}: {plan.reachability.relative:.0%} of the change is out of reach,")
    print(f"  ends {away:.4f} from xf, certified {plan.bound(0.05).target:.4f}")

# %%
colors = ["C0", "C1", "C2", "C5", "C6"]
fig, axes = plt.subplots(2, 2, figsize=(9, 5), sharex=True, sharey="row")
for (K, plan), (top, bottom) in zip(plans.items(), axes.T, strict=True):
    run = se.simulate(system, x0, plan.u)
    times = 0.1 * np.arange(K + 1)
    for k in range(5):
        top.plot(times, 1000 * run.states[:, k], "o-", color=colors[k])
        bottom.stairs(plan.u[:, k], times, baseline=None, color=colors[k], lw=2)
    top.axhline(0.0, color="0.6", lw=0.8)
    top.set_title("One step: out of reach" if K == 1 else "Four steps")
    bottom.axhline(0.0, color="0.6", lw=0.8)
    bottom.set_xlabel("time [s]")
for k, angle in enumerate(x0[:5]):
    axes[0, 0].text(0.11, 1000 * angle, f"generator {k + 1}", color=colors[k], va="bottom")
axes[0, 0].set_ylabel("angle [mrad]")
axes[1, 0].set_ylabel("mechanical power [pu]")
plt.show()
