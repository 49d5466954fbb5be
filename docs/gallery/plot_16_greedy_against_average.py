"""
Is a greedy fit never worse than the average?
=============================================

The paper that this package follows says so of SLSE, one line search per realization, for every
sequence of realizations (Lemma 4.5). Three realizations of a 2 x 2 matrix show that it is false.
What is true is enough in practice: it holds in the mean square, and with one more line search it
holds always. ``python -m paper claims`` checks all statements of the paper in this way.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

# %%
# Their average is the matrix itself, and SLSE ends at the squared error 1/5.
A = [[1.0, 1.0], [2.0, 2.0]]
three = [[[0.0, 0.0], [3.0, 3.0]], [[3.0, 0.0], [0.0, 3.0]], [[0.0, 3.0], [3.0, 0.0]]]
ensemble = se.Ensemble.from_samples(np.array(three))
for method in ("uniform", "slse", "slse-safeguarded"):
    print(f"{method}: squared error {se.fuse(ensemble, method, target=A).error ** 2:.3f}")

# %%
# How often does that happen by chance? For the vector (2, 1, 1) and four realizations exactly in
# 5 of 32 cases.
w, sizes, runs = [2.0, 1.0, 1.0], np.arange(1, 13), 2000
rng = np.random.default_rng(1)
ensembles = [se.sample(w, int(sizes[-1]), rng=rng) for _ in range(runs)]
squares = {
    method: np.array([se.fuse_path(one, sizes, method, target=w).errors ** 2 for one in ensembles])
    for method in ("uniform", "slse", "slse-safeguarded")
}
worse = {m: np.mean(found > squares["uniform"] + 1e-12, axis=0) for m, found in squares.items()}
print(f"N = 4: {worse['slse'][3]:.1%} of {runs} runs, 5/32 = {5 / 32:.1%}")

# %%
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8))
left.bar(sizes, 100 * worse["slse"], color="C2")
left.plot(sizes, 100 * worse["slse-safeguarded"], "s", color="C0")
left.text(6.2, 12, "SLSE", color="C2")
left.text(6.2, 10.8, "with one more line search: never", color="C0")
left.set(
    xlabel="realizations N",
    ylabel="of 2000 runs [%]",
    title="How often is the fit worse than the average?",
)
names = ("average", "0.4"), ("", "C2"), ("SLSE, with and without\none more line search", "C0")
for found, (name, color) in zip(squares.values(), names, strict=True):
    right.semilogy(sizes, found.mean(axis=0), "o-", color=color)
    right.text(12.3, found.mean(axis=0)[-1], name, color=color, va="center")
right.set(xlabel="realizations N", ylabel="mean of the squared errors", xlim=(0.5, 21))
right.set_title("And in the mean?")
right.set_xticks(range(2, 13, 2))
plt.show()
