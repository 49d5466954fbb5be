"""What a control over several steps knows of the entities behind it, and of powers of A."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from . import _radii
from .exceptions import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .rng import Key

    Floats: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Known:
    """What a plan keeps of one entity: its estimate, and what is known of the error.

    `law` is "exact", "iid" or "systematic" (uniform averages of `size` realizations of `value`,
    drawn with `key` along `axis`), "fit" (weights fitted to a target, at the distance `error`
    from it) or "unknown".
    """

    name: str
    estimate: Floats
    law: Literal["exact", "iid", "systematic", "fit", "unknown"]
    value: Floats | None = None
    size: int | None = None
    axis: Literal["columns", "rows"] = "columns"
    error: float | None = None
    key: Key | None = None

    @property
    def random(self) -> bool:
        """Whether the radius takes a share of delta."""
        return self.law == "iid"

    def radius(self, delta: float) -> float:
        """The distance of the estimate, with probability 1 - delta: 2-norm, spectral norm."""
        if self.law == "exact":
            return 0.0
        if self.law == "fit" and self.error is not None:
            return self.error
        if self.value is None or self.size is None:
            raise InputError(
                f"`{self.name}`: nothing is known of the law behind these realizations, so there "
                "is no radius; use error_bound(system, x0, xf) with nominal values"
            )
        # Rows of A are columns of A^T, which has the same norm.
        value = self.value.T if self.axis == "rows" and self.value.ndim == 2 else self.value
        scale = float(np.abs(value).max()) or 1.0  # so that squares neither overflow nor vanish
        return scale * self._radius(value / scale, self.size, delta)

    def _radius(self, value: Floats, size: int, delta: float) -> float:
        if self.law == "systematic":
            return _radii.systematic_radius(value if value.ndim == 2 else value[:, None], size)
        if value.ndim == 1:
            return _radii.vector_radius(value, size, delta)
        return _radii.matrix_radius(value, size, delta)


def spectral_norms(powers: Floats) -> Floats:
    """2-norm of every matrix of a stack."""
    return np.asarray(np.linalg.norm(powers, ord=2, axis=(1, 2)), dtype=np.float64)


def grown(norms: Floats, eA: float) -> Floats:
    """Bounds of ``||A^k||`` from ``norms[k] = ||A_hat^k||`` and ``||A - A_hat|| <= eA``.

    ``A^k = A_hat^k + sum_{i<k} A^i (A - A_hat) A_hat^{k-1-i}``.
    """
    if eA == 0.0:
        return norms
    found = np.empty_like(norms)
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(len(norms)):
            found[k] = norms[k] + eA * float(found[:k] @ norms[:k][::-1])
    return found
