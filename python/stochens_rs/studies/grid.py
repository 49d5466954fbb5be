"""The configurations of a study: named axes of values, and the text that each has in a key."""

from __future__ import annotations

import json
import keyword
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from .._base import validation
from .._base.validation import show
from ..exceptions import InputError, InputTypeError
from .digest import digest

Label: TypeAlias = bool | int | float | str | None
# arguments of functions, and what results, their `about` and their summaries have themselves
_RESERVED = (
    *("key", "self", "replicate", "replicates", "name", "status", "schema", "grid", "values"),
    *("units", "failures", "seconds", "done", "failed", "infinite", "mean", "standard_error"),
    *("median", "q10", "q90", "function", "stochens_rs", "python", "numpy", "platform"),
    "processor",
)


@dataclass(frozen=True)
class Grid:
    """The axes: for each name its labels, and the values that the function gets for them."""

    labels: dict[str, tuple[Label, ...]]
    values: dict[str, tuple[Any, ...]]
    nested: str | None
    shared: tuple[str, ...]

    @property
    def outer(self) -> tuple[str, ...]:
        """The axes with one value in each call."""
        return tuple(name for name in self.labels if name != self.nested)

    @property
    def shape(self) -> tuple[int, ...]:
        """The lengths of these axes."""
        return tuple(len(self.labels[name]) for name in self.outer)

    @property
    def size(self) -> int:
        """The number of configurations."""
        return math.prod(self.shape)

    def positions(self, number: int) -> dict[str, int]:
        """Where a configuration lies on each axis; the last axis runs fastest."""
        found = {}
        for name, length in zip(reversed(self.outer), reversed(self.shape), strict=True):
            number, found[name] = divmod(number, length)
        return {name: found[name] for name in self.outer}

    def configuration(self, number: int) -> dict[str, Any]:
        """What the function gets: a value of each axis, and all values of the nested one."""
        chosen = {name: self.values[name][at] for name, at in self.positions(number).items()}
        return chosen if self.nested is None else {**chosen, self.nested: self.nested_values}

    @property
    def nested_values(self) -> Any:
        """The values of the nested axis: an array if they are numbers."""
        found = self.values[self.nested or ""]
        numbers = all(validation.is_real(value) for value in found)
        return np.array(found) if numbers else found

    def text(self, number: int) -> str:
        """The labels of a configuration as JSON, in the order of the names; not those of the nested
        axis and of shared ones.
        """
        labels = {
            name: _whole(self.labels[name][at])
            for name, at in self.positions(number).items()
            if name not in self.shared
        }
        return json.dumps(labels, sort_keys=True, separators=(",", ":"))

    def described(self, home: str = "") -> dict[str, Any]:
        """What must agree for a study to be continued, as plain values.

        Objects are described by their digests (see `digest` for `home`), None stands for a value
        that is its own label.
        """
        digests = {
            name: [
                None if value is label else digest(f"grid[{name!r}]", value, home)
                for label, value in zip(labels, self.values[name], strict=True)
            ]
            for name, labels in self.labels.items()
        }
        return {
            "grid": {name: list(labels) for name, labels in self.labels.items()},
            "digests": digests,
            "nested": self.nested,
            "shared": list(self.shared),
        }


def checked_grid(grid: object, nested: object = None, shared: object = ()) -> Grid:
    """Check the axes of a study."""
    if not isinstance(grid, Mapping):
        raise InputTypeError(f"`grid` must be a mapping of axes to values, got {show(grid)}")
    labels: dict[str, tuple[Label, ...]] = {}
    values: dict[str, tuple[Any, ...]] = {}
    for name, given in grid.items():
        validation.text("grid", name)
        if not name.isidentifier() or keyword.iskeyword(name):
            raise InputError(f"`grid` must name its axes as arguments of a function, got {name!r}")
        if name in _RESERVED:
            raise InputError(
                f"`grid` must not have an axis {name!r}: this name is that of something else in "
                "results, choose another one"
            )
        labels[name], values[name] = _axis(f"grid[{name!r}]", given)
    names = tuple(labels)
    if nested is not None:
        nested = validation.choice("nested", nested, names)
    axes = tuple(
        validation.choice("shared", name, names) for name in validation.items("shared", shared)
    )
    if nested in axes:
        raise InputError(f"`shared` must not contain the nested axis {nested!r}")
    return Grid(labels, values, nested, axes)


def _axis(name: str, given: object) -> tuple[tuple[Label, ...], tuple[Any, ...]]:
    """The labels and the values of one axis."""
    if isinstance(given, Mapping):
        for label in given:
            validation.text(f"{name} label", label)
        labels: tuple[Label, ...] = tuple(given)
        values = tuple(given.values())
    else:
        values = labels = tuple(plain_label(name, value) for value in validation.items(name, given))
    if not labels:
        raise InputError(f"`{name}` must have at least one value, got none")
    texts = [label_text(label) for label in labels]
    if len(set(texts)) < len(texts):
        twice = next(text for text in texts if texts.count(text) > 1)
        raise InputError(f"`{name}` must have different values, got {twice} twice")
    return labels, values


def plain_label(name: str, value: object) -> Label:
    """A number, a text or None, as Python has it."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, int) and abs(value) >= 2**1023:
        raise InputError(f"`{name}` must be numbers that a float holds, got {show(value)}")
    if value is None or type(value) in (bool, int):
        return value  # type: ignore[return-value]
    if isinstance(value, str):
        return validation.text(name, value)
    if isinstance(value, float):
        if math.isnan(value):
            raise InputError(f"`{name}` must not contain nan")
        return float(value)
    raise InputTypeError(
        f"`{name}` must contain numbers, texts or None, got {show(value)}: give other values "
        "names, as in {'a': ..., 'b': ...}"
    )


def label_text(label: Label) -> str:
    """A label as JSON; equal numbers have one text."""
    return json.dumps(_whole(label))


def _whole(label: Label) -> Label:
    """10 for 10.0."""
    whole = isinstance(label, float) and label.is_integer() and abs(label) < validation.EXACT
    return int(label) if whole else label  # type: ignore[arg-type]
