"""`Uncertain`: a state that is known up to a distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._base import validation
from .._base.records import SavedRecord
from ..exceptions import InputTypeError, NonFiniteError
from .entries import Entries, entries


@dataclass(frozen=True, eq=False)
class Uncertain(SavedRecord):
    """The initial state of a plan for a model from data, where it is known up to a distance.

    Parameters
    ----------
    values : array_like, shape (n,)
        The state, as far as it is known.
    radius : float
        The true state is within this distance of `values`, in the 2-norm; 0 or more.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.Uncertain([1.0, 2.0], 0.1)
    Uncertain([1.0, 2.0], 0.1)
    """

    values: Entries
    radius: float

    def __post_init__(self) -> None:
        given: object = self.values
        if given is None or isinstance(given, str):
            raise InputTypeError(f"`values` must be a state, got {validation.show(given)}")
        object.__setattr__(self, "values", entries("values", self.values))
        if not np.isfinite(self.values).all():  # type: ignore[arg-type]
            raise NonFiniteError(f"`values` is {np.asarray(self.values)!s:.60}: it must be finite")
        object.__setattr__(self, "radius", validation.nonnegative("radius", self.radius))
        super().__post_init__()

    def __repr__(self) -> str:
        return f"Uncertain({np.asarray(self.values).tolist()}, {self.radius:.6g})"
