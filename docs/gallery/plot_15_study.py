"""
Which way to fuse is best for my system, and from which size on?
================================================================

One draw is an anecdote. A study repeats a function over a grid of sizes and methods, with random
numbers that depend on nothing but its key: the same bits in this process, on a pool or on a
cluster, also after an interruption.
"""

import matplotlib.pyplot as plt

import stochens_rs as se

plt.style.use("stochens_rs.style")

system = se.cases.random_system(8, 4, rng=3)
x0, xf = [1.0] * 8, [0.0] * 8

# %%
# ``studies.error`` computes the errors of the estimates, of the control and of the state. The sizes
# are prefixes of one sample, and all methods see the same samples.
study = se.Study(
    se.studies.error(system, x0, xf),
    {"size": [10, 30, 100, 300, 1000, 3000], "method": ["uniform", "slse", "alse"]},
    replicates=40,
    rng=1,
    nested="size",
    shared=["method"],
)
results = study.run()
print(results)
print(results.select(size=1000).summary())

# %%
# Medians, and bands from the 10 % to the 90 % quantile. ALSE and SLSE are fitted to the exact
# system here, which is the best case.
fig, (left, right) = plt.subplots(1, 2, figsize=(11, 4))
results.plot("size", "A", "method", ax=left)
results.plot("size", "control", "method", ax=right)
left.set(xlabel="realizations N", ylabel="relative error of A", ylim=(1e-4, 2))
left.set_title("The matrix that is fitted")
right.set(xlabel="realizations N", ylabel="relative error of the control", ylim=(1e-4, 5))
right.set_title("The control from it")
plt.show()
