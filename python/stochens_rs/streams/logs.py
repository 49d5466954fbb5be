"""`Logs`: what a `ModelStream` of outputs has taken in, and its model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from .. import _core
from .._base import validation
from .._base.names import texts
from .._base.records import Probability, SavedRecord, cached_property, trusted
from .._base.running import get_num_threads
from .._base.types import Floats
from ..data import Trajectories
from ..data.trajectories import pooled
from ..exceptions import InputError
from ..identification import Window
from ..identification.assumptions import Assumptions, checked_scale
from ..identification.model import Model
from ..identification.window import Regressors, rows_of, spread


@dataclass(frozen=True, eq=False, repr=False)
class Logs(SavedRecord):
    """Logs of outputs, and what was declared of them before the first one."""

    window: Regressors
    assumptions: Assumptions
    scale: Annotated[Floats, "column"]
    delta: Probability
    dt: float | None
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
        about: Any = (
            self.data,
            triangle,
            *declared,
            None,
            None,
            None,
            self.window,
            0,
            None,
            self.delta,
        )
        return trusted(Model, *about)

    def after(self, runs: Any) -> Logs:
        """With more runs."""
        new = validation.instance("x", runs, Trajectories)
        names = self.window.outputs, self.window.inputs
        if not new.outputs or (new.state_names, new.input_names, new.dt) != (*names, self.dt):
            raise InputError(
                f"`x` must be runs of the outputs {', '.join(names[0])} and the inputs "
                f"{', '.join(names[1])} with dt={self.dt}, got {new!r}"
            )
        made = replace(self, data=new if self.data is None else pooled([self.data, new], "x"))
        rows = made.model.rows  # refuses logs that do not fill the window
        if not np.isfinite(np.vdot(rows, rows)):
            raise InputError("`x` is too large: its squares overflow")
        return made


def declared_window(
    window: Any, n: int, m: int, names: tuple[Any, Any], offset: bool
) -> Regressors:
    """The window of n outputs and m inputs, which no data choose."""
    if isinstance(window, Regressors):
        if (len(window.outputs), len(window.inputs)) != (n, m) or offset != window.intercept:
            raise InputError(
                f"`window` must be of n={n} m={m} and intercept={offset}, got {window}"
            )
        return window
    asked = validation.instance("window", window, Window)
    if not isinstance(asked.lags, int) or not isinstance(asked.delay, int) or asked.delay < 0:
        raise InputError(
            "`window` must be Window(lags=, delay=) of numbers, or `model.window` of earlier runs: "
            f"what these data choose holds for no later look, got {window}"
        )
    if asked.tail:
        raise InputError("`window` must have no tail in a stream")
    outputs = texts("state_names", names[0]) or tuple(f"y[{i}]" for i in range(n))
    inputs = texts("input_names", names[1]) or tuple(f"u[{j}]" for j in range(m))
    if (len(outputs), len(inputs)) != (n, m):
        raise InputError(f"`state_names` and `input_names` must be {n} and {m} names")
    return Regressors(outputs, inputs, asked.lags, None, asked.delay, offset)


def sizes(window: Regressors, scale: Any) -> Floats:
    """The sizes of the regressors that are expected before the data."""
    count = len(window.outputs) + len(window.inputs)
    own = checked_scale(scale, count, window.intercept)
    return validation.frozen(spread(window, own))
