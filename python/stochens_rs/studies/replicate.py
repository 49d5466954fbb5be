"""One replicate of an experiment: sample x0, xf and A, fuse each by every method, compute the
controls of one step.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._base.types import Fusion
from ..controls.realization import realization_controls
from ..ensembles.ensemble import Ensemble
from ..ensembles.sampling import sample
from ..fusion.fusing import Method
from ..fusion.paths import fuse_path
from ..rng import Key
from ..theory.exact import Best, best_control
from .methods import METHODS

Floats = NDArray[np.float64]
Sizes = NDArray[np.int64]


@dataclass
class Solves:
    """How the solves for ALSE weights ended, and the worst gap among them."""

    statuses: Counter[str] = field(default_factory=Counter)
    worst_gap: float = 0.0

    def add(self, statuses: tuple[str, ...], gaps: Floats | None, scale: float) -> None:
        """`gaps` are absolute, on ``||sum w E - E*||^2``; they are kept relative to `scale`."""
        self.statuses.update(statuses)
        if gaps is not None and scale > 0:
            self.worst_gap = max(self.worst_gap, float(np.max(gaps)) / scale)

    def to_dict(self, tol: float) -> dict[str, Any]:
        """Number of solves, how they ended, the worst relative gap and the tolerance asked for."""
        return {
            "solves": sum(self.statuses.values()),
            "statuses": dict(sorted(self.statuses.items())),
            "worst_relative_gap": self.worst_gap,
            "tol": tol,
        }


@dataclass(frozen=True)
class Entity:
    """One sampled entity (x0, xf or A) with its estimates after sizes[0], sizes[1], ... samples."""

    ensemble: Ensemble
    estimates: dict[Method, Floats]  # by method, (k, *shape)
    errors: dict[Method, Floats]  # by method, (k,), absolute

    @classmethod
    def draw(cls, target: Floats, sizes: Sizes, rng: Key, tol: float, solves: Solves) -> Entity:
        """Sample ``sizes[-1]`` realizations of `target` and fuse every prefix by every method."""
        ensemble = sample(target, int(sizes[-1]), rng=rng)
        estimates: dict[Method, Floats] = {}
        errors: dict[Method, Floats] = {}
        for method in METHODS:
            path = fuse_path(ensemble, sizes, method, target=target, tol=tol, estimates=True)
            if "interrupted" in path.statuses:
                raise KeyboardInterrupt  # an incomplete replicate is not kept
            assert path.estimates is not None  # estimates=True
            estimates[method], errors[method] = path.estimates, path.errors
            if method == "alse":
                solves.add(path.statuses, path.gaps, float(np.sum(target**2)))
        return cls(ensemble, estimates, errors)


@dataclass(frozen=True)
class Step:
    """The exact data of one step from x0 towards xf."""

    A: Floats
    B: Floats
    x0: Floats
    xf: Floats

    @cached_property
    def exact(self) -> Best:
        """The exact control ``v = B+ (xf - A x0)``, and where it leads."""
        return best_control(self.A, self.B, self.x0, self.xf)

    def unreachable(self) -> dict[str, float]:
        """The smallest distance from xf, ``||xf - A x0 - B v||``, also over ``||xf - A x0||``."""
        residual = float(np.linalg.norm(self.exact.needed - self.exact.pushed))
        return {
            "residual": residual,
            "relative": residual / float(np.linalg.norm(self.exact.needed)),
        }

    def draw(
        self, key: Key, sizes: Sizes, tol: float, solves: Mapping[str, Solves]
    ) -> tuple[dict[str, Entity], dict[tuple[Method, Fusion], Floats]]:
        """Sample and fuse "x0", "xf" and "A", with keys of these names.

        Returns the three, and the errors ``u - v`` of the controls after each number of samples,
        (k, m) for every pair (method, fusion). Solves are counted where `solves` names the entity.
        """
        drawn = {
            name: Entity.draw(target, sizes, key.child(name), tol, solves.get(name, Solves()))
            for name, target in (("x0", self.x0), ("xf", self.xf), ("A", self.A))
        }
        x0, xf, A = drawn["x0"], drawn["xf"], drawn["A"]
        errors: dict[tuple[Method, Fusion], Floats] = {}
        # Diagonal fusion: u = mean_s B+ (xf^s - A^s x0^s)
        u = realization_controls((A.ensemble, self.B), x0.ensemble, xf.ensemble)
        average = np.cumsum(u, axis=0)[sizes - 1] / sizes[:, None]
        errors["uniform", "diagonal"] = average - self.exact.u
        for method in METHODS:
            # Product fusion: u = B+ (xf_hat - A_hat x0_hat)
            drift = np.einsum("kij,kj->ki", A.estimates[method], x0.estimates[method])
            u = (xf.estimates[method] - drift) @ self.exact.factors.inverse.T
            errors[method, "product"] = u - self.exact.u
        return drawn, errors
