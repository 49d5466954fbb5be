"""Pooling of experiments: one model of all data together."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base import validation
from ..data.trajectories import pooled
from ..exceptions import InputError
from ..identification.checks import DRAWS, WORK
from ..identification.model import Model
from .by_data import shared_rows

if TYPE_CHECKING:
    from .._base.types import Floats


def pool(models: object) -> Model:
    """Least squares of the data of all models together; their estimates are not averaged.

    The triangles of the experiments, one above the other, have the triangle of all data.
    """
    given = [
        validation.instance("ensemble", one, Model) for one in validation.items("ensemble", models)
    ]
    if not given:
        raise InputError("`ensemble` must have at least one model, got an empty list")
    first = given[0]
    for k, one in enumerate(given[1:], start=1):
        _refuse_others(k, one, first)
        for j, earlier in enumerate(given[:k]):
            if shared_rows(one.data, earlier.data):
                raise InputError(
                    f"`ensemble[{k}]` was fitted on pairs that `ensemble[{j}]` was fitted on too: "
                    "a pair must not count twice"
                )
    data = pooled([one.data for one in given])
    triangle = first.triangle.copy()
    for one in given[1:]:
        _core.triangle_update(triangle, np.ascontiguousarray(one.triangle))
    made = replace(first, data=data, triangle=triangle, checks=None)
    if any(one.checks is not None for one in given) and data.size * data.n * DRAWS <= WORK:
        made = replace(made, checks=made.check())
    return made


def _refuse_others(k: int, one: Model, first: Model) -> None:
    """Refuse a model that is about another system, or assumes something else."""
    first._require_states("ensemble[0]")
    if one.data._about() != first.data._about():
        raise InputError(
            f"`ensemble[{k}]` must have the states, inputs, steps and dt of `ensemble[0]`: "
            f"{first!r} and {one!r}, with the same names"
        )
    for what in fields(first.assumptions):
        mine, its = getattr(one.assumptions, what.name), getattr(first.assumptions, what.name)
        if not _same(mine, its):
            word = "covariance" if what.name == "known" else what.name
            raise InputError(
                f"`ensemble[{k}]` must assume the same {word} as `ensemble[0]`, {_shown(its)}, got "
                f"{_shown(mine)}"
            )
    for name in ("intercept", "scale", "known"):
        if not _same(getattr(one, name), getattr(first, name)):
            word = "known entries" if name == "known" else name
            raise InputError(f"`ensemble[{k}]` must have the {word} of `ensemble[0]`")


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)
    return type(a) is type(b) and bool(a == b)


def _shown(value: str | Floats | None) -> str:
    return (
        f"'{value}'"
        if isinstance(value, str)
        else "another matrix"
        if value is not None
        else "none"
    )
