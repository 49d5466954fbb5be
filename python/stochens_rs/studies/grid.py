"""The configurations of a study: named axes of values, and the text that each has in a key."""

from __future__ import annotations

import functools
import hashlib
import inspect
import io
import json
import keyword
import math
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from .._base import validation
from .._base.validation import show
from ..exceptions import InputError, InputTypeError

Label: TypeAlias = bool | int | float | str | None
OWN = ("key", "self", "replicate")  # names of arguments and columns that every study has


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
        places = np.unravel_index(number, self.shape) if self.shape else ()
        return {name: int(at) for name, at in zip(self.outer, places, strict=True)}

    def configuration(self, number: int) -> dict[str, Any]:
        """What the function gets: a value of each axis, and all values of the nested one, which
        are an array if they are numbers.
        """
        chosen = {name: self.values[name][at] for name, at in self.positions(number).items()}
        if self.nested is not None:
            every = self.values[self.nested]
            numbers = all(validation.is_real(value) for value in every)
            chosen[self.nested] = np.array(every) if numbers else every
        return chosen

    def text(self, number: int) -> str:
        """The labels of a configuration as JSON, in the order of the names; not those of the nested
        axis and of shared ones.
        """
        places = self.positions(number).items()
        labels = {k: _whole(self.labels[k][at]) for k, at in places if k not in self.shared}
        return json.dumps(labels, sort_keys=True, separators=(",", ":"))

    def digests(self) -> dict[str, tuple[str | None, ...]]:
        """Those of the values, by axis; None for a value that is its own label."""
        return {
            name: tuple(
                None if value is label else digest(f"grid[{name!r}]", value)
                for label, value in zip(labels, self.values[name], strict=True)
            )
            for name, labels in self.labels.items()
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
        if name in OWN:
            raise InputError(f"`grid` must not have an axis {name!r}, which every study has")
        labels[name], values[name] = _axis(f"grid[{name!r}]", given)
    names = tuple(labels)
    if nested is not None:
        nested = validation.choice("nested", nested, names)
    listed = validation.items("shared", shared)
    axes = tuple(validation.choice("shared", name, names) for name in listed)
    if nested in axes:
        raise InputError(f"`shared` must not contain the nested axis {nested!r}")
    return Grid(labels, values, nested, axes)


def _axis(name: str, given: object) -> tuple[tuple[Label, ...], tuple[Any, ...]]:
    """The labels and the values of one axis."""
    if isinstance(given, Mapping):
        labels: tuple[Label, ...] = tuple(validation.text(f"{name} label", one) for one in given)
        values = tuple(given.values())
    else:
        values = labels = tuple(_plain(name, value) for value in validation.items(name, given))
    if not labels:
        raise InputError(f"`{name}` must have at least one value, got none")
    texts = [json.dumps(_whole(label)) for label in labels]  # equal numbers have one text
    if len(set(texts)) < len(texts):
        twice = next(text for text in texts if texts.count(text) > 1)
        raise InputError(f"`{name}` must have different values, got {twice} twice")
    return labels, values


def _plain(name: str, value: object) -> Label:
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


def _whole(label: Label) -> Label:
    """10 for 10.0."""
    whole = isinstance(label, float) and label.is_integer() and abs(label) < validation.EXACT
    return int(label) if whole else label  # type: ignore[arg-type]


def full_name(function: object) -> str:
    """Module and qualified name of what is called."""
    while isinstance(function, functools.partial):
        function = function.func
    named: Any = function if hasattr(function, "__qualname__") else type(function)
    return f"{named.__module__}.{named.__qualname__}"


def function_digest(function: Any, version: str | None) -> str:
    """SHA-256 of the name and the source text of a function, of `version`, and of what a partial
    function, a method or an object that is called holds.
    """
    parts: list[Any] = [full_name(function), version]
    while isinstance(function, functools.partial):
        parts += [function.args, sorted(function.keywords.items())]
        function = function.func
    if inspect.ismethod(function):
        parts.append(function.__self__)
    elif not hasattr(function, "__qualname__"):
        parts.append(function)
        function = type(function)
    try:
        parts.append(inspect.getsource(function))
    except (OSError, TypeError) as error:
        if version is None:
            raise InputError(
                f"`version` must be given: the source text of {parts[0]} is not known, got None"
            ) from error
    return digest("function", parts)


def digest(name: str, value: object) -> str:
    """SHA-256 of what a value is pickled as; `name` is for messages."""
    file = io.BytesIO()
    pickler = pickle.Pickler(file, 4)
    pickler.fast = True  # the same bytes for equal values, whatever objects they share
    try:
        pickler.dump(value)
    except Exception as error:  # whatever a foreign object raises
        reason = " ".join(str(error).split())[:120]
        raise InputError(
            f"`{name}` holds what cannot be kept with the study ({reason}): name it in an axis "
            "{name: value}, or make it inside the function"
        ) from error
    return hashlib.sha256(file.getvalue()).hexdigest()
