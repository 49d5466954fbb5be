"""
How good is a matrix that is put together from its realizations?
================================================================

Each realization of the 10 x 10 matrix of a power network has one entry in every column, right only
in the mean. The plain average needs a hundred times more of them for one more digit. Weights that
are fitted to a target do much better, as long as the target is right.
"""

import matplotlib.pyplot as plt
import numpy as np

import stochens_rs as se

plt.style.use("stochens_rs.style")

A = se.cases.ieee14(dt=0.1).A  # five generators: angles [rad] and speeds [rad/s]
sizes = np.unique(np.geomspace(10, 3000, 25).astype(int))
drawn = se.sample(A, 3000, rng=1)  # the first k are those of a sample of size k

# %%
# *uniform* averages the first N realizations. *SLSE* makes one line search per realization, *ALSE*
# finds the best weights with sum 1. Both need a target to fit to, which is the exact matrix here:
# the best case. With a nominal model as the target the result is as wrong as that model.
names = {"uniform": "average", "slse": "SLSE", "alse": "ALSE"}
curves = {
    label: se.fuse_path(drawn, sizes, name, target=A).errors / np.linalg.norm(A)
    for name, label in names.items()
}
expected = [se.theory.moments.mse(A, int(N)) ** 0.5 / np.linalg.norm(A) for N in sizes]

# %%
# The error of the average is known before anything is drawn: its mean square is
# :math:`\sum_j (g_j^2 - \|a_j\|_2^2) / N` with the column sums :math:`g_j = \|a_j\|_1`. ALSE is
# exact but for rounding as soon as the matrix lies in the convex hull of its realizations.
fig, ax = plt.subplots(figsize=(7, 4))
ax.loglog(sizes, expected, color="0.7", lw=5)
ax.text(300, 1.9 * expected[12], "grey: expected rms of the average", color="0.35")
for k, (label, errors) in enumerate(curves.items()):
    seen = errors > 1e-5  # what the axes show
    ax.loglog(sizes[seen], errors[seen], marker=".", color=f"C{k}")
    if not seen.all():
        label += f":\nexact from N = {sizes[seen].max()}\nor a little later"
    end = np.flatnonzero(seen)[-1]
    ax.text(1.1 * sizes[end], errors[end], label, color=f"C{k}", va="center")
ax.set(xlabel="realizations N", ylabel="relative error (Frobenius norm)", xlim=(10, 9000))
ax.set(ylim=(1e-5, 1), title="Error of a matrix that is put together from N realizations")
plt.show()
