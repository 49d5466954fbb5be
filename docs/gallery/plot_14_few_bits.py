"""
Few bits from each of many nodes: what is sampling good for?
============================================================

Each node may send 8 bits. Where all nodes know the same vector, entries by node number are
thousands of times better than drawn indices. Where each node has a sparse vector of its own and
their mean is wanted, drawn indices are far better, and their error is known beforehand.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

n, rng = 100, np.random.default_rng(1)
sizes = [300, 1000, 3000, 10_000]


def by_number(own, rng):
    """Node k sends entry k mod n, rounded at random to 8 bits."""
    k, step = np.arange(len(own)), abs(own).max() / 127
    values = step * np.floor(own[k, k % n] / step + rng.random(len(own)))
    return np.bincount(k % n, values) / np.bincount(k % n)


def drawn(own, rng):
    """Node k sends an index that it draws, and a sign: packed, read and averaged."""
    messages = [se.sample(one, 1, rng=rng).to_bytes() for one in own]
    pairs = zip(messages, abs(own).sum(axis=1), strict=True)
    return se.fuse([se.Ensemble.from_bytes(data, n, norm) for data, norm in pairs]).estimate


# %%
# The dashes are the exact mean square error of drawn indices, the mean of
# :math:`\|x_k\|_1^2 - \|x_k\|_2^2` over the nodes, divided by their number.
fig, axes = plt.subplots(1, 2, figsize=(9.5, 3.8), sharey=True)
x = rng.standard_normal(n)
for ax, name in zip(axes, ("all know the same vector", "each has its own"), strict=True):
    for N in sizes:
        own = np.tile(x, (N, 1)) if ax is axes[0] else rng.dirichlet(np.full(n, 0.03), N)
        mean = own.mean(axis=0)
        for way, color in ((drawn, "C0"), (by_number, "C1")):
            error = np.sum((way(own, rng) - mean) ** 2) / np.sum(mean**2)
            ax.loglog(N, error, "o", color=color)
        spread = np.mean(abs(own).sum(axis=1) ** 2 - np.sum(own**2, axis=1))
        ax.loglog(N, spread / N / np.sum(mean**2), "_", color="C0", ms=22)
    ax.set(xlabel="nodes, 8 bits each", title=name, xlim=(200, 15_000))
axes[0].text(1000, 0.2, "an index that is drawn", color="C0")
axes[0].text(1000, 2e-5, "an entry by node number", color="C1")
axes[0].set_ylabel("relative mean square error")
plt.show()
