"""
Which way to fuse is best for my system, and from which size on?
================================================================

One draw is an anecdote. A study repeats a function over a grid of sizes and methods, with random
numbers that depend on nothing but its key: the same bits in this process, on a pool or on a
cluster, also after an interruption.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

system = se.cases.random_system(8, 4, rng=3)
x0, xf = [1.0] * 8, [0.0] * 8

# %%
# The relative errors of the matrix and of the control from it. The sizes are prefixes of one
# sample, and all methods see the same samples.
exact = se.control(system, x0, xf).u[0]


def errors(key, size, method):
    """Return the errors for each of the sizes."""
    path = se.fuse_path(
        se.sample(system.A, int(size[-1]), rng=key), size, method, target=system.A, estimates=True
    )
    u = [se.control((A, system.B), x0, xf).u[0] for A in path.estimates]
    off = np.linalg.norm(u - exact, axis=1)
    return {
        "A": path.errors / np.linalg.norm(system.A),
        "control": off / np.linalg.norm(exact),
    }


study = se.Study(
    errors,
    {"size": [10, 30, 100, 300, 1000, 3000], "method": ["uniform", "slse", "alse"]},
    replicates=40,
    rng=1,
    nested="size",
    shared=["method"],
)
results = study.run()
print(results)

# %%
# Medians, and bands from the 10 % to the 90 % quantile. ALSE and SLSE are fitted to the exact
# system here, which is the best case.
fig, axes = plt.subplots(1, 2, figsize=(11, 4))
for ax, name in zip(axes, ["A", "control"], strict=True):
    for k, method in enumerate(results.grid["method"]):
        low, middle, high = np.quantile(results.values[name][:, k], [0.1, 0.5, 0.9], axis=1)
        ax.loglog(results.grid["size"], middle, marker="o", label=method)
        ax.fill_between(results.grid["size"], low, high, alpha=0.2)
    ax.set(xlabel="realizations N", ylabel=f"relative error of {name}")
axes[0].set_ylim(1e-4, 2)
axes[0].set_title("The matrix that is fitted")
axes[1].set_ylim(1e-4, 5)
axes[1].set_title("The control from it")
axes[0].legend()
plt.show()
