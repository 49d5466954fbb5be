"""Numbers, limits and names as they are typed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click
import numpy as np

from .._base.reading import number
from .._base.validation import nearest
from ..data.gaps import NEAR
from ..data.table import Table, titled
from ..exceptions import InputError, SolverError
from ..feedback import Loop, gain

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..identification import Model
T = TypeVar("T")


def names_of(option: str, text: str) -> list[str]:
    """Read ``a,b``."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise click.BadParameter(f"{text!r} has an empty name", param_hint=option)
    return names


def parsed(option: str, text: str, wanted: str, read: Callable[[str], T]) -> T:
    """What `read` makes of a text, which must be `wanted`."""
    try:
        return read(text)
    except ValueError:
        message = f"{text!r} must be {wanted}"
        raise click.BadParameter(message, param_hint=option) from None


def vector_of(option: str, text: str | None, n: int, default: Any) -> Any:
    """Read ``1,0,-0.5``: `n` numbers."""
    if text is None and default is None:
        raise click.UsageError(f"give {option}, {n} numbers with commas")
    return default if text is None else np.array(_numbers(option, text, f"{n} finite", n))


def entries_of(option: str, text: str, count: int) -> Floats:
    """Read ``1`` or ``1,0,2``, one number for each."""
    values = _numbers(option, text, f"1 or {count} finite" if count > 1 else "a finite", 1, count)
    return np.full(count, values[0]) if len(values) == 1 else np.array(values)


def sides_of(option: str, texts: Sequence[str], names: Sequence[str]) -> tuple[Floats, Floats]:
    """Read ``-1,1`` and ``force=-1,1``."""
    low, high = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for text in sorted(texts, key=lambda text: "=" in text):  # those of all, then those of one
        name, equals, pair = text.rpartition("=")
        name = titled(name, names)
        if equals and name not in names:
            known = f"{', '.join(names)}{nearest(name, names)}"
            raise click.BadParameter(f"{name!r} must be one of {known}", param_hint=option)
        values = _numbers(option, pair)
        if len(values) != 2 or any(map(math.isnan, values)):
            raise click.BadParameter(f"{pair!r} must be LOW,HIGH", param_hint=option)
        chosen = names.index(name) if equals else slice(None)
        low[chosen], high[chosen] = values
    return low, high


def _numbers(option: str, text: str, wanted: str = "", *counts: int) -> list[float]:
    """Numbers with commas; so many of them, all finite, if `counts` are given."""
    values = parsed(
        option, text, "numbers with commas", lambda text: [number(one) for one in text.split(",")]
    )
    if counts and not (len(values) in counts and all(map(math.isfinite, values))):
        many = "number" if wanted == "a finite" else "numbers"
        raise click.BadParameter(f"must be {wanted} {many}, got {text!r}", param_hint=option)
    return values


def feedback_for(model: Model, Q: str | None, R: str | None, widest: float | None = None) -> Loop:
    """The gain of least squares with ``--Q`` and ``--R``, 1 where they are left out.

    With `widest` that of the widest margin in the region of this probability.
    """
    try:
        if widest is not None:
            return gain(model, guarantee=widest)
        states = (Q or "1").count(",") + 1 == model.n
        of_states = entries_of("--Q", Q or "1", model.n if states else model.n_outputs)
        return gain(model, np.diag(of_states), np.diag(entries_of("--R", R or "1", model.m)))
    except SolverError as error:
        raise click.UsageError(f"no gain: {error}") from error


def last_rows(path: str, model: Model, time: str | None, skip: int) -> tuple[Floats, Floats]:
    """The record (outputs, inputs) for a model of outputs, whose columns the file has.

    It begins behind the last row that is not complete, or that `time` says was lost; of the last
    row of all the inputs are not used, as they act after its reading.
    """
    table = Table.of_file(path, skip)

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
