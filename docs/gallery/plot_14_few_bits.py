"""
Few bits from each of many sensors: what is sampling good for?
==============================================================

Many nodes see the same vector, and each may send an index and a sign, 8 bits. The mean of these
singletons is unbiased; for a vector with few nonzero entries its error is smallest. Where one node
may send 100 bytes, nobody needs this: rounding to 8 bits is better by orders of magnitude.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

n, rng = 100, np.random.default_rng(1)
vectors = {"dense": rng.standard_normal(n), "5 of them not 0": np.zeros(n)}
vectors["5 of them not 0"][:5] = rng.standard_normal(5)
BITS = int(np.ceil(np.log2(n))) + 1  # an index and a sign; the scale ||w||_1 is common knowledge

# %%
# The other way to send one index is a coordinate that is chosen uniformly, with its value in 16
# bits. Both are averaged. The lines are exact expected errors, the dots the means of 20 draws.
budget = np.geomspace(1e3, 1e6, 7)


def of_coordinates(w, bits):
    """n w_i e_i for a uniform i: mean square error (n - 1) ||w||^2 for one."""
    return (n - 1) / (bits / (BITS + 15))


def of_singletons(w, bits):
    """One nonzero entry for each index: mean square error ||w||_1^2 - ||w||^2 for one."""
    return se.theory.moments.vector_mse(w, int(bits / BITS)) / (w @ w)


fig, axes = plt.subplots(1, 2, figsize=(10, 3.8), sharey=True)
for ax, (name, w) in zip(axes, vectors.items(), strict=True):
    ax.loglog(budget, [of_coordinates(w, bits) for bits in budget], color="C1")
    ax.loglog(budget, [of_singletons(w, bits) for bits in budget], color="C0", lw=2.5)
    for bits in budget:
        drawn = [se.fuse(se.sample(w, int(bits / BITS), rng=rng)).estimate for _ in range(20)]
        ax.plot(bits, np.mean(np.sum((drawn - w) ** 2, axis=1)) / (w @ w), "o", color="C0")
    step = abs(w).max() / 127.0
    rounded = np.sum((np.round(w / step) * step - w) ** 2) / (w @ w)
    ax.plot(8 * n, rounded, "s", color="C2", ms=8)
    ax.text(1.15 * 8 * n, rounded, "one node sends all, 8 bits each", color="C2", va="center")
    ax.set(xlabel="bits in all", title=f"a vector of {n} entries, {name}")
axes[0].text(8e3, 1.6 * of_coordinates(vectors["dense"], 8e3), "uniform coordinates", color="C1")
axes[0].text(3e3, 0.2 * of_singletons(vectors["dense"], 3e3), "singletons", color="C0", ha="right")
axes[0].set_ylabel("relative mean square error")
plt.show()
