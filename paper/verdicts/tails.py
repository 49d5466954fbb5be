"""Simulated errors and the bounds on them: Lemma 4.2 on a hard system.

The system is ``A = H / sqrt(n)`` with a Hadamard matrix H, ``x0 = (1, .., 1) / sqrt(n)``,
``xf = 0`` and ``B = I``: all norms that the paper uses are 1, while a realization of A has the
2-norm n. The error is that of the state under the averaged controls of paired realizations,
``||B (v - u)||``, the quantity of Lemma 4.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from stochens_rs import Key, Study, System
from stochens_rs.theory import drawn_bound

from .. import bounds as printed_bounds
from ..common import Floats
from ..repeating import HERE, Where, complete

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Tails:
    """Radii at one probability of failure.

    Attributes
    ----------
    n : int
        Order of the Hadamard matrix.
    delta : float
        Probability of failure.
    runs : int
        Runs behind the empirical quantile.
    sizes : ndarray of int, shape (k,)
        Numbers of realizations.
    empirical : ndarray, shape (k,)
        The error that a share `delta` of the runs exceeds.
    ours : ndarray, shape (k,)
        The smallest bound that holds.
    bounds : tuple of str, length k
        How `theory.drawn_bound` has it, for each size.
    printed : ndarray, shape (k,)
        Lemma 4.2 with ``beta = max(||A||, 1, ||x0||)`` and ``C = n``.
    failures : ndarray of int, shape (k, 2)
        Runs beyond the bound that holds, and beyond the printed one.
    """

    n: int
    delta: float
    runs: int
    sizes: NDArray[np.int64]
    empirical: Floats
    ours: Floats
    bounds: tuple[str, ...]
    printed: Floats
    failures: NDArray[np.int64]

    @property
    def bound(self) -> str:
        """The names of `bounds`, each once."""
        return ", ".join(dict.fromkeys(self.bounds))

    @property
    def seen(self) -> str:
        """What a figure of them shows, in words."""
        above = self.ours / self.empirical
        broken = int((self.empirical > self.printed).sum())
        return (
            f"State error not exceeded in {100 * (1 - self.delta):g} % of {self.runs} runs, on "
            f"logarithmic axes: from {self.empirical[0]:.2g} at N = {self.sizes[0]} to "
            f"{self.empirical[-1]:.2g} at N = {self.sizes[-1]}. The {self.bound} bound is "
            f"{above.min():.2g} to {above.max():.2g} times as large; the radius of Lemma 4.2 is "
            f"smaller than the error at {broken} of {len(self.sizes)} sizes, and "
            f"{self.printed[0]:.2g} at N = {self.sizes[0]}."
        )

    def to_dict(self) -> dict[str, Any]:
        """The fields as plain numbers and lists."""
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}
        return {**plain, "bounds": list(self.bounds)}


def hadamard(n: int) -> Floats:
    """Sylvester's Hadamard matrix of order n, a power of two."""
    H = np.ones((1, 1))
    while len(H) < n:
        H = np.block([[H, H], [H, -H]])
    return H


def hard_system(n: int) -> tuple[Floats, Floats]:
    """``A = H / sqrt(n)`` and ``x0 = (1, .., 1) / sqrt(n)``."""
    return hadamard(n) / np.sqrt(n), np.full(n, 1.0 / np.sqrt(n))


def drift_errors(A: Floats, x0: Floats, size: int, runs: int, gen: np.random.Generator) -> Floats:
    """``||mean of A^s x0^s - A x0||`` of `runs` independent averages over `size` pairs.

    ``A^s x0^s`` has one nonzero entry: with probability ``|x0_j| / g0 |a_ij| / g_j`` it is
    ``g0 g_j sign(a_ij x0_j)`` in place i. Equal atoms are counted together, by one multinomial.
    """
    g, g0 = np.abs(A).sum(axis=0), np.abs(x0).sum()
    p = np.abs(A) / g * np.abs(x0) / g0
    value = g0 * g * np.sign(A * x0)
    place = np.broadcast_to(np.arange(len(A))[:, None], A.shape)
    atoms, which = np.unique(
        np.stack([place[p > 0], value[p > 0]], axis=1), axis=0, return_inverse=True
    )
    masses = np.bincount(which.ravel(), weights=p[p > 0])
    hits = gen.multinomial(size, masses / masses.sum(), size=runs)
    means = np.zeros((runs, len(A)))
    for k, (i, v) in enumerate(atoms):
        means[:, int(i)] += v / size * hits[:, k]
    return np.asarray(np.linalg.norm(means - A @ x0, axis=1))


def measure(
    key: Key, *, n: int = 64, runs: int = 4000, delta: float = 0.01, where: Where = HERE
) -> Tails:
    """Simulate the error and evaluate the bounds on a grid of sizes."""
    A, x0 = hard_system(n)
    xf, system = np.zeros(n), System(A, np.eye(n))
    printed = printed_bounds.Lemma42(system, x0, xf, reading="matrix")
    sizes = np.array([10, 30, 100, 300, 1000, 3000])
    study = Study(partial(_errors, A, x0, runs), {"size": sizes}, replicates=1, rng=key)
    found = complete(study, **where.of("tails"))["errors"][:, 0]
    rows, names = [], []
    for size, errors in zip(sizes.tolist(), found, strict=True):
        radius, name = drawn_bound(
            "state", system, x0, xf, size=size, delta=delta, fusion="diagonal"
        )
        names.append(name)
        theirs = printed.radius(size, delta)
        quantile = float(np.quantile(errors, 1.0 - delta))
        rows.append((quantile, radius, theirs, (errors > radius).sum(), (errors > theirs).sum()))
    table = np.array(rows)
    empirical, radii, printed_radii = table[:, :3].T
    failures = table[:, 3:].astype(np.int64)
    return Tails(n, delta, runs, sizes, empirical, radii, tuple(names), printed_radii, failures)


def _errors(A: Floats, x0: Floats, runs: int, key: Key, size: int) -> dict[str, Floats]:
    return {"errors": drift_errors(A, x0, size, runs, key.generator())}
