"""One replicate of an experiment: sample x0, xf and A, fuse each by every method, compute the
controls of one step.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stochens_rs import Ensemble, Key, control, fuse_path, realization_controls, sample
from stochens_rs.fusion import Alse

from ..common import STATUSES, Floats
from ..methods import METHODS

Sizes = NDArray[np.int64]


class FusedEntity(NamedTuple):
    """One sampled entity (x0, xf or A) and its estimates after sizes[0], sizes[1], ... samples."""

    ensemble: Ensemble
    estimates: Floats  # (methods, k, *shape)
    errors: Floats  # (k, methods), absolute
    statuses: Floats  # (k,) of the solves for ALSE weights, by their places in `STATUSES`
    gaps: Floats  # (k,) of these solves, on ||sum w E - E*||^2 / ||E*||^2

    @classmethod
    def draw(cls, target: Floats, sizes: Sizes, key: Key, tol: float) -> FusedEntity:
        """Sample ``sizes[-1]`` realizations of `target` and fuse every prefix by every method."""
        ensemble = sample(target, int(sizes[-1]), rng=key)
        how = {**{method: method for method in METHODS}, "alse": Alse(tol=tol)}
        paths = {
            method: fuse_path(ensemble, sizes, how[method], target=target, estimates=True)
            for method in METHODS
        }
        solved, scale = paths["alse"], float(np.sum(target**2))
        gaps = np.zeros(len(sizes)) if solved.gaps is None or not scale else solved.gaps / scale
        return cls(
            ensemble,
            np.array([path.estimates for path in paths.values()]),
            np.stack([path.errors for path in paths.values()], axis=1),
            np.array([STATUSES.index(status) for status in solved.statuses], dtype=np.float64),
            gaps,
        )


def solves(name: str, entities: Iterable[FusedEntity]) -> dict[str, Floats]:
    """How the solves for the ALSE weights of some entities ended, (k, entities) each."""
    found = list(entities)
    return {
        f"status_{name}": np.stack([one.statuses for one in found], axis=1),
        f"gap_{name}": np.stack([one.gaps for one in found], axis=1),
    }


@dataclass(frozen=True, eq=False)
class Step:
    """The exact data of one step from x0 towards xf."""

    A: Floats
    B: Floats
    x0: Floats
    xf: Floats

    @cached_property
    def control(self) -> Floats:
        """The exact control ``v = B+ (xf - A x0)``."""
        exact: Floats = control((self.A, self.B), self.x0, self.xf).u[0]
        return exact

    @property
    def reached(self) -> Floats:
        """``A x0 + B v``."""
        return self.A @ self.x0 + self.B @ self.control

    def __reduce__(self) -> tuple[Any, ...]:
        return Step, (self.A, self.B, self.x0, self.xf)  # without what was computed

    def unreachable(self) -> dict[str, float]:
        """The smallest distance from xf, ``||xf - A x0 - B v||``, also over ``||xf - A x0||``."""
        needed = self.xf - self.A @ self.x0
        residual = float(np.linalg.norm(needed - self.B @ self.control))
        return {"residual": residual, "relative": residual / float(np.linalg.norm(needed))}

    def draw(self, key: Key, sizes: Sizes, tol: float) -> tuple[dict[str, FusedEntity], Floats]:
        """Sample and fuse "x0", "xf" and "A", with keys of these names.

        Returns the three, and the errors ``u - v`` of the controls after each number of samples,
        (k, curves, m), with the curves in the order of `paper.methods.STYLES`.
        """
        drawn = {
            name: FusedEntity.draw(target, sizes, key.child(name), tol)
            for name, target in (("x0", self.x0), ("xf", self.xf), ("A", self.A))
        }
        x0, xf, A = drawn["x0"], drawn["xf"], drawn["A"]
        # Diagonal fusion: u = mean_s B+ (xf^s - A^s x0^s)
        u = realization_controls((A.ensemble, self.B), x0.ensemble, xf.ensemble)
        diagonal = np.cumsum(u, axis=0)[sizes - 1] / sizes[:, None]
        # Product fusion: u = B+ (xf_hat - A_hat x0_hat)
        drift = np.einsum("ckij,ckj->cki", A.estimates, x0.estimates)
        product = (xf.estimates - drift) @ np.linalg.pinv(self.B).T
        return drawn, np.stack([diagonal, *product], axis=1) - self.control
