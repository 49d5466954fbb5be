"""Numbers, arrays and arrays with names, as they were given, for a system that is not known yet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from .._base import validation
from .._base.align_labels import aligned, aligned_weight
from .._base.reading import labels_along, shown_labels
from .._base.records import Record, SavedRecord
from .._base.types import Floats
from ..exceptions import InputError, InputTypeError, NonFiniteError

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from typing_extensions import Self


@dataclass(frozen=True, eq=False)
class Named(Record):
    """An array with names along its last axis."""

    values: Floats
    names: tuple[str, ...]

    @property
    def index(self) -> tuple[str, ...] | None:
        """The names of a vector, as pandas has them."""
        return self.names if self.values.ndim == 1 else None

    @property
    def columns(self) -> tuple[str, ...] | None:
        """The names of the columns of a matrix, as pandas has them."""
        return None if self.values.ndim == 1 else self.names

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype=dtype)


Entries: TypeAlias = float | Floats | Named | None


class Asked(SavedRecord, listed=False):
    """Numbers, arrays and arrays with names, which a system brings into its order."""

    def _keep(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def given(self) -> tuple[str, ...]:
        """The names of what was given."""
        return tuple(one.name for one in fields(self) if getattr(self, one.name) is not None)  # type: ignore[arg-type]

    def only(self, *names: str) -> Self:
        """Refuse what is not among `names`, where a function has no use for it."""
        for name in self.given:
            if name not in names:
                kind = type(self).__name__
                raise InputError(
                    f"`{kind.lower()}` must have {' and '.join(names)} only here, got "
                    f"{kind}({name}={_shown(getattr(self, name))})"
                )
        return self

    def __repr__(self) -> str:
        shown = (f"{name}={_shown(getattr(self, name))}" for name in self.given)
        return f"{type(self).__name__}({', '.join(shown)})"


def pair_of(name: str, value: Any) -> Any:
    """A pair (low, high) of `entries`, or None; from pairs by name two arrays with these names."""
    if value is None:
        return None
    if isinstance(value, Mapping):
        return _sides_by_name(name, value)
    try:
        pair = validation.items(name, value)
    except InputTypeError:
        raise InputTypeError(
            f"`{name}` must be a pair (low, high), got {validation.show(value)}"
        ) from None
    if len(pair) != 2:
        raise InputError(f"`{name}` must be a pair (low, high), got {len(pair)} items")
    return tuple(entries(f"{name}[{k}]", side) for k, side in enumerate(pair))


def _sides_by_name(name: str, value: Mapping[Any, Any]) -> tuple[Named, Named]:
    """``{"force": (-8, 8)}`` as (low, high), each of these names."""
    names = tuple(value)
    if not names or not all(isinstance(one, str) for one in names):
        raise InputTypeError(f"`{name}` must name what has limits by texts, got {names!s:.60}")
    sides = np.array([[-np.inf], [np.inf]]) * np.ones(len(names))
    for k, one in enumerate(names):
        of = f"{name}[{one!r:.30}]"
        for side, end in zip(sides, pair_of(of, value[one]) or (), strict=False):
            if end is not None and not isinstance(end, float):
                raise InputTypeError(
                    f"`{of}` must be a pair of numbers, got {validation.show(end)}"
                )
            side[k] = side[k] if end is None else end
    return Named(sides[0], names), Named(sides[1], names)


def entries(name: str, value: Any, *, square: bool = False) -> Any:
    """A number as it is, numbers as an array, and with the labels of a table.

    A `square` table has the same names along both axes, and is kept in the order of its columns.
    """
    if value is None or isinstance(value, (str, Named)):
        return value
    found = _named(name, value, square)
    given = validation.read(name, value) if found is None else found.values
    if given.dtype.kind not in "iuf":
        raise InputTypeError(
            f"`{name}` must be a number or an array of numbers, got {validation.show(value)}"
        )
    if np.isnan(given).any():
        raise NonFiniteError(f"`{name}` has nan: leave out what is not known, or pass None")
    if found is not None:
        return found
    return float(given) if given.ndim == 0 else given.astype(np.float64)


def _named(name: str, value: Any, square: bool) -> Named | None:
    """A table with names along its last axis, or None for anything else."""
    if isinstance(value, (np.ndarray, list, tuple, int, float)):
        return None
    along = labels_along(value)
    if not along or not along[-1] or not all(isinstance(label, str) for label in along[-1]):
        return None
    names = tuple(map(str, along[-1]))
    found = (aligned_weight if square else aligned)(name, value, names)
    if found is value:  # rows that are no times: `read` says what is wrong
        return None
    return Named(np.asarray(found, dtype=np.float64), names)


def _shown(value: Any) -> str:
    """A number as it is, an array by its entries where they are few, else by its shape."""
    if isinstance(value, Named):
        return f"{_shown(value.values)} of {shown_labels(value.names)}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_shown, value))})"
    if not isinstance(value, np.ndarray):
        return repr(value)
    return f"array {value.shape}" if value.size > 6 else str(value.tolist())
