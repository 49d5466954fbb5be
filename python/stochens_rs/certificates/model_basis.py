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
    read : ndarray, shape (n_outputs,), or None
        For a model of outputs, the last readings of the record that led to `x0`.
    at_rest : bool
        Whether that record was not measured: the plant was declared to be at rest.
    given : bool
        Whether the inputs were given, and `xf` is where the model ends: there is no target then.
    """

    model: Identified
    x0: Floats
    xf: Floats
    x0_error: float = 0.0
    read: Floats | None = None
    at_rest: bool = False
    given: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.model, Identified):
            raise InputTypeError(
                f"`model` must be a model from data, got {validation.show(self.model)}"
            )
        super().__post_init__()
        n = len(self.model.A)
        for name, value in (("x0", self.x0), ("xf", self.xf)):
            if validation.kept(name, value, ndim=(1,)).shape != (n,):
                raise ShapeError(f"`{name}` must have shape ({n},), got {value.shape}")
        validation.nonnegative("x0_error", self.x0_error)
        for name, flag in (("at_rest", self.at_rest), ("given", self.given)):
            validation.flag(name, flag)
        outputs = (self.model.n_outputs,) if isinstance(self.model, Model) and self.window else ()
        if (() if self.read is None else self.read.shape) != outputs:
            raise ShapeError("`read` must have the last readings of a model of outputs, else None")

    @property
    def window(self) -> Window | None:
        """That of a model of outputs."""
        return self.model.window if isinstance(self.model, Model) else None

    @property
    def target(self) -> Floats | None:
        """Where the states, or the outputs, are to end; None where the inputs were given."""
        if self.given:
            return None
        return self.xf if self.read is None else self.xf[: len(self.read)]

    @property
    def names(self) -> tuple[str, ...]:
        """Those of the outputs, or of the states."""
        return self.model.outputs if isinstance(self.model, Model) else self.model.state_names

    def outputs(self, states: Floats, u: Floats) -> Floats | None:
        """What was read, and what a model of outputs leads to from each of the states but the last.

        (K + 1, n_outputs); None for a model of states.
        """
        if not isinstance(self.model, Model) or self.read is None:
            return None
        ones = np.ones((len(u), int(self.model.intercept)))
        ahead = np.hstack([states[:-1], u, ones]) @ (self.model._H @ self.model._loop.J).T
        return np.vstack([self.read, ahead])
