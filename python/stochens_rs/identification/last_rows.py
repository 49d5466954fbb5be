"""The record at the end of a CSV file: the rows up to now that follow on each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..data.gaps import NEAR
from ..data.table import Table
from ..exceptions import InputError

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..data.table import Text
    from .model import Model


def last_rows(path: str, model: Model, time: str | None, how: Text) -> tuple[Floats, Floats]:
    """The record (outputs, inputs) for a model of outputs, whose columns the file has.

    It begins behind the last row that is not complete, or that `time` says was lost; of the last
    row of all the inputs are not used, as they act after its reading.
    """
    table = Table.of_file(path, how)

    def columns(argument: str, names: tuple[str, ...]) -> Floats:
        return np.column_stack([table.numbers(argument, table.title(name)) for name in names])

    y, u = columns("outputs", model.outputs), columns("inputs", model.input_names)
    if not np.isfinite(y[-1]).all():
        raise InputError(f"{path} must have all outputs in its last row, where the plan starts")
    # whether a row and the next one are a step of the record
    follows = np.isfinite(np.hstack([y, u])[:-1]).all(axis=1)
    if time is not None:
        if model.dt is None:
            raise InputError("`time` must be left out for a model whose logs had no times")
        follows &= np.abs(np.diff(table.times(table.title(time))) / model.dt - 1.0) <= NEAR
    first = int(np.max(np.flatnonzero(~follows), initial=-1)) + 1
    return y[first:], u[first:-1]
