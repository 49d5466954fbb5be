"""`Logs`: what a `ModelStream` of outputs has taken in, and its model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from .. import _core
from .._base import validation
from .._base.records import Positive, Probability, SavedRecord, cached_property
from .._base.running import get_num_threads
from .._base.types import Floats
from ..data import Trajectories
from ..data.trajectories import pooled
from ..exceptions import InputError
from ..identification import Window
from ..identification.assumptions import Assumptions
from ..identification.model import Model
from ..identification.window import Regressors, rows_of


@dataclass(frozen=True, eq=False, repr=False)
class Logs(SavedRecord):
    """Logs of outputs, and what was declared of them before the first one."""

    window: Regressors
    assumptions: Assumptions
    scale: Annotated[Floats, "column"]
    delta: Probability
    dt: Positive | None
    data: Trajectories | None = None

    @property
    def size(self) -> int:
        """How many pairs have a complete window."""
        return 0 if self.data is None else self.model.size

    @cached_property
    def model(self) -> Model:
        """The model of all logs so far, whose regions hold at all looks together."""
        if self.data is None:
            raise InputError("the stream has no log yet: update it with one")
        triangle = _core.triangle(rows_of(self.window, self.data)[1], get_num_threads())
        declared = self.assumptions, self.scale, self.window.intercept
        return Model(self.data, triangle, *declared, window=self.window, looks=self.delta)

    def after(self, runs: Any) -> Logs:
        """With more runs."""
        new = validation.instance("x", runs, Trajectories)
        if not new.outputs or new.dt != self.dt:
            raise InputError(f"`x` must be runs of outputs with dt={self.dt}, got {new!r}")
        made = replace(self, data=new if self.data is None else pooled([self.data, new], "x"))
        if not np.isfinite(made.model.triangle).all():  # refuses what fills no window, too
            raise InputError("`x` is too large: its squares overflow")
        return made


def declared_window(window: Any, names: tuple[Any, Any], offset: bool) -> Regressors:
    """The window of these outputs and inputs, which no data of the stream choose."""
    if isinstance(window, Regressors):
        if (len(window.outputs), len(window.inputs)) != tuple(map(len, names)):
            raise InputError(f"`window` must be of the sizes of this stream, got {window}")
        if window.intercept != offset:
            raise InputError(f"`intercept` must be {window.intercept}, as that of the window")
        return window
    asked = validation.instance("window", window, Window)
    lags, delay = asked.lags, asked.delay
    if not isinstance(lags, int) or not isinstance(delay, int) or delay < 0 or asked.tail:
        raise InputError(
            "`window` must be Window(lags=, delay=) of numbers, without a tail, or `model.window` "
            f"of earlier runs: what these data choose holds for no later look, got {window}"
        )
    return Regressors(*names, lags, None, delay, offset)
