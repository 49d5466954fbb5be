"""What a plan for a model from data keeps for its certificate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .._base import validation
from .._base.records import Record
from .._base.types import Floats
from ..exceptions import InputTypeError, ShapeError
from ..identification.identified import Identified
from ..identification.model import Model

if TYPE_CHECKING:
    from ..identification.window import Window


@dataclass(frozen=True, eq=False)
class ModelBasis(Record):
    """What a plan for a model from data keeps.

    Attributes
    ----------
    model : Identified
        The model, with its regions.
    x0, xf : ndarray, shape (n,)
        Initial state and target.
    x0_error : float
        How far the true initial state may be from `x0`, in the 2-norm.
    """

    model: Identified
    x0: Floats
    xf: Floats
    x0_error: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.model, Identified):
            raise InputTypeError(
                f"`model` must be a model from data, got {validation.show(self.model)}"
            )
        n = len(self.model.A)
        for name, value in (("x0", self.x0), ("xf", self.xf)):
            if validation.kept(name, value, ndim=(1,)).shape != (n,):
                raise ShapeError(f"`{name}` must have shape ({n},), got {value.shape}")
        validation.nonnegative("x0_error", self.x0_error)

    @property
    def window(self) -> Window | None:
        """That of a model of outputs."""
        return self.model.window if isinstance(self.model, Model) else None

    def outputs(self, states: Floats, u: Floats) -> Floats | None:
        """What a model of outputs leads to in a step from each of the states under each input."""
        if not isinstance(self.model, Model) or self.model.window is None:
            return None
        ones = np.ones((len(u), int(self.model.intercept)))
        return np.hstack([states, u, ones]) @ (self.model._H @ self.model._loop.J).T
