"""The fields of a record that was made by hand: values of the declared types, or a clear error."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, Literal, TypeAlias, get_args, get_origin

import numpy as np

from ..exceptions import InputTypeError
from . import serialize, validation

Test: TypeAlias = Callable[[Any], bool]


def check(record: Any) -> None:
    """Refuse a record with a field that is not of its declared type; shapes are not looked at."""
    own: Any = type(record)
    for name, fits in _tests(own):
        if not fits(getattr(record, name)):
            _refuse(record, name)


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
        if wanted is Any:
            return lambda value: isinstance(value, np.ndarray)
        letter = np.dtype(wanted).kind
        return lambda value: isinstance(value, np.ndarray) and value.dtype.kind == letter
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


_PLAIN: dict[Any, Test] = {
    bool: lambda value: isinstance(value, (bool, np.bool_)),
    int: lambda value: isinstance(value, (int, np.integer)) and not isinstance(value, bool),
    float: validation.is_real,
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
