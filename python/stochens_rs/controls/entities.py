"""The arguments x0, xf and A of a control problem, in whatever way they are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .. import _core
from .._base import gate
from .._base.types import Status
from ..ensembles.counts import Counts
from ..ensembles.ensemble import Ensemble
from ..exceptions import InputError, InputTypeError, ShapeError
from ..fusion.fits import Fit

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats: TypeAlias = NDArray[np.float64]
    EntityLike: TypeAlias = Fit | Ensemble | Counts | ArrayLike


@dataclass(frozen=True)
class Entity:
    """One argument of a control problem: a fit, an ensemble, counts, or exact values."""

    name: str
    value: Fit | Ensemble | Counts | Floats

    def estimate(self) -> Floats:
        """What product fusion uses."""
        if isinstance(self.value, Fit | Counts):
            return self.value.estimate
        return self.value.mean() if isinstance(self.value, Ensemble) else self.value

    def _ensemble(self) -> Ensemble | None:
        if isinstance(self.value, Counts):
            raise InputTypeError(
                f"`{self.name}` must be an Ensemble or an array here: counts have no realizations"
            )
        if isinstance(self.value, Fit):
            if self.value.method != "uniform" or self.value.ensemble is None:
                raise InputError(
                    f"`{self.name}` must be an Ensemble or an array here, got a fit by "
                    f"'{self.value.method}': paired realizations share one weight vector, so "
                    "weights of their own go with fusion='product'"
                )
            return self.value.ensemble
        return self.value if isinstance(self.value, Ensemble) else None

    def realizations(self) -> _core.Draws | Floats:
        """What the core pairs up: draws, rows of dense realizations, or a flat exact value."""
        ensemble = self._ensemble()
        if ensemble is not None:
            return ensemble._core_realizations()
        return self.estimate().ravel()

    @property
    def by_rows(self) -> bool:
        """Whether the realizations of a matrix were drawn row by row."""
        ensemble = self._ensemble()
        return ensemble is not None and ensemble.axis == "rows"

    @property
    def size(self) -> int | None:
        """Number of realizations; None for exact values."""
        if isinstance(self.value, Fit):
            return len(self.value.weights)
        return self.value.size if isinstance(self.value, Ensemble | Counts) else None

    @property
    def status(self) -> Status:
        """How the fit ended."""
        return self.value.status if isinstance(self.value, Fit) else "completed"

    @property
    def description(self) -> dict[str, Any]:
        """What the plan's `info` says of it."""
        if isinstance(self.value, Fit):
            fit = self.value
            return {"method": fit.method, "size": self.size, "status": fit.status, "gap": fit.gap}
        if isinstance(self.value, Ensemble | Counts):
            return {"method": "uniform", "size": self.size}
        return {"method": "exact", "size": None}


def entities(x0: object, xf: object, A: object, *, n: int) -> tuple[Entity, Entity, Entity]:
    """Check the three arguments against the number of states."""
    checked = []
    for name, value, shape in (("x0", x0, (n,)), ("xf", xf, (n,)), ("A", A, (n, n))):
        if isinstance(value, Fit | Ensemble | Counts):
            if value.shape != shape:
                raise ShapeError(
                    f"`{name}` must have shape {shape} to fit `B` with {n} rows, got {value.shape}"
                )
            checked.append(Entity(name, value))
        elif len(shape) == 1:
            checked.append(Entity(name, gate.vector(name, value, length=n)))
        else:
            checked.append(Entity(name, gate.matrix(name, value, rows=n, cols=n)))
    return checked[0], checked[1], checked[2]
