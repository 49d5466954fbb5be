"""
What does an assumption about the noise buy?
============================================

Twenty measured pairs of a system with one state and one input leave a set of pairs (a, b) that can
be true. What is declared about the noise decides how large the set is. Nothing is inferred from the
data: a wrong declaration makes a wrong set.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

# %%
# Each set contains the true (a, b) with probability 95 %. An *independent* design means that states
# and inputs were chosen without a look at the noise; *any design* also allows feedback, and asking
# again after every pair.
a, b, sigma = 0.9, 0.5, 0.2
ways = {
    "size known": lambda data: se.identify(
        data, noise=se.Noise(sigma=sigma, design="independent"), checks=False
    ),
    "size unknown": lambda data: se.identify(
        data, noise=se.Noise(design="independent"), checks=False
    ),
    "size known, any design": lambda data: se.identify(data, noise=sigma, checks=False),
}


def measured(seed):
    """Twenty pairs, and the states that follow."""
    x, u, w = np.random.default_rng(seed).standard_normal((3, 20, 1))
    return se.Trajectories.from_pairs(x, u, a * x + b * u + sigma * w)


one = {name: way(measured(1)).region(0.05) for name, way in ways.items()}
many = {
    name: np.mean([way(measured(seed)).region(0.05).entry_bounds[0, 0] for seed in range(100)])
    for name, way in ways.items()
}

# %%
# ``plot`` draws which pairs of two coefficients are in a region, here of all two.
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 4), width_ratios=(1.4, 1))
for name, region in one.items():
    region.plot(label=name, ax=left)
left.plot(a, b, "P", color="k", ms=9)
left.text(a + 0.015, b, "true", va="center")
left.set(xlabel="a", ylabel="b", title="One set of 20 pairs")
colors = [edge.get_edgecolor() for edge in left.patches]
right.barh(list(many), many.values(), color=colors)
for k, width in enumerate(many.values()):
    right.text(width, k, f" {width:.2f}", va="center")
right.invert_yaxis()
right.set(xlabel="a is within ±", title="Mean of 100 such sets")
plt.show()
