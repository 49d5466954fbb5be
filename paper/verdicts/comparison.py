"""SLSE against uniform weights: better in the mean square, not on every run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from stochens_rs import Key, Study, fuse_path, sample
from stochens_rs.theory.moments import mse

from ..common import ROUNDING, Floats, Method
from ..repeating import HERE, Where, complete

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Comparison:
    """Squared errors of SLSE and of uniform weights on the same runs.

    Attributes
    ----------
    target : ndarray, shape (n,)
        The vector that is sampled.
    sizes : ndarray of int, shape (k,)
        Numbers of realizations.
    slse, uniform : ndarray, shape (R, k)
        Squared errors of every run.
    bound : ndarray, shape (k,)
        ``V / sizes``, the mean square error of uniform weights, which bounds that of SLSE.
    """

    target: Floats
    sizes: NDArray[np.int64]
    slse: Floats
    uniform: Floats
    bound: Floats

    @property
    def mean_square(self) -> Floats:
        """Mean of the squared errors of SLSE, (k,)."""
        return np.asarray(self.slse.mean(axis=0))

    @property
    def standard_error(self) -> Floats:
        """Standard error of `mean_square`, (k,)."""
        return np.asarray(self.slse.std(axis=0, ddof=1) / np.sqrt(len(self.slse)))

    @property
    def worse(self) -> Floats:
        """Share of the runs in which SLSE is worse than uniform weights, (k,)."""
        # equal up to rounding is not worse
        rounding = ROUNDING * float(self.target @ self.target)
        return np.asarray((self.slse > self.uniform + rounding).mean(axis=0))

    @property
    def seen(self) -> str:
        """What a figure of them shows, in words."""
        uniform, most = self.uniform.mean(axis=0), int(np.argmax(self.worse))
        return (
            f"Mean square errors of {len(self.slse)} runs from N = {self.sizes[0]} to "
            f"{self.sizes[-1]}, on logarithmic axes: SLSE falls from {self.mean_square[0]:.2g} to "
            f"{self.mean_square[-1]:.2g}, uniform weights from {uniform[0]:.2g} to "
            f"{uniform[-1]:.2g} along V / N. SLSE is worse in at most "
            f"{100 * self.worse[most]:.2g} % of the runs, at N = {self.sizes[most]}."
        )

    def to_dict(self) -> dict[str, Any]:
        """What the figure shows, as plain lists."""
        return {
            "target": self.target.tolist(),
            "runs": len(self.slse),
            "sizes": self.sizes.tolist(),
            "slse_mean_square": self.mean_square.tolist(),
            "slse_standard_error": self.standard_error.tolist(),
            "uniform_mean_square": self.uniform.mean(axis=0).tolist(),
            "bound": self.bound.tolist(),
            "share_worse": self.worse.tolist(),
        }


def compare(target: Floats, key: Key, runs: int, size: int, where: Where = HERE) -> Comparison:
    """Fuse the same realizations both ways, `runs` times."""
    sizes = np.unique(np.geomspace(1, size, 40).astype(np.int64))
    function, grid = partial(_squared_errors, target), {"size": sizes.tolist()}
    study = Study(function, grid, replicates=runs, rng=key, nested="size")
    squares = complete(study, **where.of("comparison"))
    bound = np.array([mse(target, int(k)) for k in sizes])
    return Comparison(target, sizes, squares["slse"].T, squares["uniform"].T, bound)


def _squared_errors(target: Floats, key: Key, size: NDArray[np.int64]) -> dict[str, Floats]:
    ensemble = sample(target, int(size[-1]), rng=key)
    methods: tuple[Method, ...] = ("slse", "uniform")
    return {one: fuse_path(ensemble, size, one, target=target).errors ** 2 for one in methods}
