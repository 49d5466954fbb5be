"""
One command for a whole fleet: how often will a new unit miss?
==============================================================

Carts leave the factory with masses and frictions that differ by up to a fifth, and all get the same
program: 1 m in 2 s, with 2 N at most. 300 of them were measured. Which program is best for the
worst cart, and what does that say of carts that nobody has measured?
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")


def carts(count, rng, dt=0.1):
    """x = (position [m], speed [m/s]), u = force [N]."""
    mass, friction = 1.0 + rng.uniform(-0.2, 0.2, count), 0.5 + rng.uniform(-0.1, 0.1, count)
    fade = np.exp(-friction / mass * dt)  # of the speed in one step
    A, B = np.zeros((count, 2, 2)), np.zeros((count, 2, 1))
    A[:, 0, 0], A[:, 1, 1] = 1.0, fade
    A[:, 0, 1] = (1.0 - fade) * mass / friction
    B[:, 1, 0] = (1.0 - fade) / friction
    B[:, 0, 0] = (dt - A[:, 0, 1]) / friction
    return se.SystemEnsemble(A, B, dt=dt)


rng = np.random.default_rng(1)
units = carts(300, rng)
plan = se.control_fleet(units, [0.0, 0.0], [1.0, 0.0], 20, limits=(-2.0, 2.0), risk="worst")

# %%
# Two numbers with confidence 1 - 1e-6. The first takes nothing but the 300 carts: the command rests
# on two of them. The second counts fresh carts, and holds for any command. Both are about carts of
# the same law; those of another factory follow another one.
risk = plan.certify(1e-6)
held = plan.validate(carts(3000, rng), 1e-6)
print(f"from the design: at most {risk.epsilon:.1%} of new carts miss by more")
print(f"from 3000 fresh carts: at most {held.epsilon:.1%} ({held.count} did)")

# %%
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8), width_ratios=(1, 1.3))
times = 0.1 * np.arange(21)
left.axhspan(-2.0, 2.0, color="0.92")
left.stairs(plan.u[:, 0], times, baseline=None, color="C2", lw=2)
left.set(xlabel="time [s]", ylabel="force [N], grey: within the limits", title="The command")
plan.plot(right, validated=held)
right.set_title("Misses of all carts")
plt.show()
