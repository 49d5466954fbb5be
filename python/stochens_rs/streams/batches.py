"""Realizations from arrays, ensembles and iterators, as blocks of rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .._base import validation
from .._base.types import Floats
from ..ensembles.ensemble import Ensemble
from ..exceptions import ShapeError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    FeedLike: TypeAlias = ArrayLike | Ensemble | Iterable[ArrayLike]

_BLOCK = 2**18  # entries in a block, 2 MiB


def blocks(name: str, value: Any, shape: tuple[int, ...]) -> Iterable[Floats]:
    """Return realizations of this shape as rows; arrays and ensembles are checked at once."""
    entries = int(np.prod(shape))
    rows = max(1, _BLOCK // entries)
    if isinstance(value, Ensemble):
        if value.shape != shape:
            raise ShapeError(f"`{name}` must have shape {shape}, got {value.shape}")
        return (block.reshape(-1, entries) for block in value._dense_blocks(rows))
    if isinstance(value, Iterator):
        return _gathered(name, value, shape, rows)
    array = validation.array(name, value, ndim=(len(shape), len(shape) + 1))
    if array.shape[-len(shape) :] != shape:
        raise ShapeError(
            f"`{name}` must have shape {shape} or (k, {', '.join(map(str, shape))}), "
            f"got {array.shape}"
        )
    return [array.reshape(-1, entries)]


def _gathered(
    name: str, items: Iterator[Any], shape: tuple[int, ...], rows: int
) -> Iterator[Floats]:
    """Collect single realizations into blocks of rows."""
    pending: list[Floats] = []
    try:
        for item in items:
            pending.append(_one(name, item, shape).ravel())
            if len(pending) == rows:
                yield np.stack(pending)
                pending = []
    except GeneratorExit:  # the core refused a block
        raise
    except BaseException:  # the realizations before the faulty one, or Ctrl-C, are taken in
        if pending:
            yield np.stack(pending)
        raise
    if pending:
        yield np.stack(pending)


def _one(name: str, item: object, shape: tuple[int, ...]) -> Floats:
    if len(shape) == 1:
        return validation.vector(name, item, length=shape[0])
    return validation.matrix(name, item, rows=shape[0], cols=shape[1])
