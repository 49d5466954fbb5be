"""The fields of a record: what a declaration says of each is checked here, or a clear error.

``Annotated[Floats, "step+1 state"]`` is an array of shape (K + 1, n) of finite numbers in the units
of the states; the first field with a dimension says how long it is. Further words: "infinite", the
numbers may be; "own unit", they have not that of the last dimension. For a number or a text the
word is a check of `validation`: `Probability` and the like.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    TypeAlias,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from ..exceptions import InputError, InputTypeError, ShapeError
from . import serialize, types, validation

Test: TypeAlias = Callable[[Any], bool]


def _from_zero(name: str, value: float) -> None:
    if not value >= 0.0:
        raise InputError(f"`{name}` must be >= 0, got {value:g}")


FromZero: TypeAlias = Annotated[float, _from_zero]  # infinite, too
Probability: TypeAlias = Annotated[float, validation.probability]  # in (0, 1)
Positive: TypeAlias = Annotated[float, validation.positive]
Count: TypeAlias = Annotated[int, validation.size]  # >= 1


class Rule(NamedTuple):
    """What the declaration of a field says beside its type: dimensions and words, or a check."""

    dims: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    check: Callable[[str, Any], Any] | None = None


def check(record: Any) -> None:
    """Refuse a record with a field that is not of its declared type, shape and range."""
    own: Any = type(record)
    for name, fits in _tests(own):
        if not fits(getattr(record, name)):
            _refuse(record, name)
    sizes(record)


def sizes(record: Any) -> dict[str, int]:
    """The length of each dimension that the fields of a record name; refuses what does not fit."""
    own: Any = type(record)
    found: dict[str, int] = {}
    for name, rule in rules(own).items():
        value = getattr(record, name)
        if value is None:
            continue
        if rule.check is not None:
            rule.check(name, value)
            continue
        fits = value.ndim == len(rule.dims) and all(
            _fits(dim, length, found) for dim, length in zip(rule.dims, value.shape, strict=True)
        )
        if not fits:
            wanted = ", ".join(str(_length(dim, found) or dim) for dim in rule.dims)
            raise ShapeError(f"`{name}` must have shape ({wanted}), got {value.shape}")
        if value.dtype.kind == "f" and value.size and "infinite" not in rule.words:
            validation.kept(name, value, ndim=(value.ndim,))
    labels = getattr(record, "labels", None)
    if labels is not None and {"state", "input"} <= found.keys():
        labels.require(found["state"], found["input"])
    return found


@cache
def rules(record: Any) -> dict[str, Rule]:
    """What the declarations of a record say beside the types, by field."""
    if serialize.RECORDS.get(record.__name__) != record or hasattr(record, "_made_by"):
        return {}
    hints = get_type_hints(
        record, localns={**vars(types), **serialize.RECORDS}, include_extras=True
    )
    found = {}
    for name in serialize.declared(record):
        for kind in (hints[name], *get_args(hints[name])):
            if get_origin(kind) is Annotated:
                first, *more = kind.__metadata__
                text = isinstance(first, str)
                found[name] = Rule(tuple(first.split()), (*more,)) if text else Rule(check=first)
    return found


def _fits(dim: str, length: int, known: dict[str, int]) -> bool:
    """Whether a dimension, such as "step+1", has this length; a new name gets it."""
    new = [part for part in dim.split("+") if not part.isdigit() and part not in known]
    if len(new) == 1:
        known[new[0]] = 0
        known[new[0]] = length - (_length(dim, known) or 0)
        return known[new[0]] >= 0
    return length == _length(dim, known)


def _length(dim: str, known: dict[str, int]) -> int | None:
    """The length of a dimension; None where a name in it is not known."""
    parts = dim.split("+")
    if not all(part.isdigit() or part in known for part in parts):
        return None
    return sum(int(part) if part.isdigit() else known[part] for part in parts)


def _refuse(record: Any, name: str) -> None:
    kind, value = serialize.declared(type(record))[name], getattr(record, name)
    words = serialize.words(kind)
    if words and isinstance(value, str):
        validation.choice(name, value, words)
    raise InputTypeError(f"`{name}` must be {_said(kind)}, got {validation.show(value)}")


@cache
def _tests(record: Any) -> tuple[tuple[str, Test], ...]:
    """Name and test of each field; `serialize` knows their types."""
    return tuple((name, _test(kind)) for name, kind in serialize.declared(record).items())


def _test(kind: Any) -> Test:
    """Whether a value is of a declared type."""
    tests = tuple(_test_one(one) for one in serialize.kinds(kind))
    if len(tests) == 1:
        return tests[0]
    return lambda value: any(test(value) for test in tests)


def _test_one(kind: Any) -> Test:
    outer, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return lambda _: True
    if kind in _PLAIN:
        return _PLAIN[kind]
    if outer is Literal:
        return lambda value: isinstance(value, str) and value in inner
    if outer is np.ndarray:
        wanted = get_args(inner[1])[0]
        letters = "fiu" if wanted is Any else np.dtype(wanted).kind
        return lambda value: (
            isinstance(value, np.ndarray)
            and value.dtype.kind in letters
            and not isinstance(value, np.ma.MaskedArray)
        )
    if outer is tuple and len(inner) == 2 and inner[1] is Ellipsis:
        each = _test(inner[0])
        return lambda value: isinstance(value, tuple) and all(map(each, value))
    if outer is tuple:
        tests = [_test(one) for one in inner]
        return lambda value: (
            isinstance(value, tuple)
            and len(value) == len(tests)
            and all(test(item) for test, item in zip(tests, value, strict=True))
        )
    if outer is dict:
        keys, items = map(_test, inner)
        return lambda value: (
            isinstance(value, dict) and all(map(keys, value)) and all(map(items, value.values()))
        )
    return lambda value: isinstance(value, outer or kind)


def _is_int(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and -(2**63) <= int(value) < 2**64


def _is_number(value: Any) -> bool:
    return _is_int(value) if isinstance(value, int) else bool(value == value)


_PLAIN: dict[Any, Test] = {
    bool: lambda value: isinstance(value, (bool, np.bool_)),
    int: lambda value: validation.is_real(value) and _is_int(value),
    # neither nan nor an integer beyond the largest number
    float: lambda value: validation.is_real(value) and _is_number(value),
    type(None): lambda value: value is None,
}


def _said(kind: Any) -> str:
    """A declared type in words."""
    words = []
    for one in serialize.kinds(kind):
        of = get_origin(one) or one
        if of is Literal:
            words += [repr(word) for word in get_args(one)]
        elif one in _PLAIN:
            words.append("None" if of is type(None) else of.__name__)
        else:
            words.append(validation.article(of))
    return " or ".join(words)
