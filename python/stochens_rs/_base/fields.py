"""The fields of a record that was made by hand: values of the declared types, or a clear error."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeAlias, get_args, get_origin

import numpy as np

from ..exceptions import InputTypeError
from . import gate, plain


def check(record: Any) -> None:
    """Refuse a record with a field that is not of its declared type; shapes are not looked at."""
    for name, fits in _fields(type(record)):
        if not fits(getattr(record, name)):
            _refuse(name, getattr(record, name), plain.declared(type(record))[name])


def _refuse(name: str, value: Any, kind: Any) -> None:
    words = plain.words(kind)
    if words and isinstance(value, str):
        gate.choice(name, value, words)
    raise InputTypeError(f"`{name}` must be {_said(kind)}, got {gate.show(value)}")


def _fields(cls: type[Any]) -> tuple[tuple[str, _Fits], ...]:
    """What tells for each field whether a value is of its declared type."""
    if cls not in _CHECKS:
        _CHECKS[cls] = tuple((name, _any(kind)) for name, kind in plain.declared(cls).items())
    return _CHECKS[cls]


def _any(kind: Any) -> _Fits:
    """What tells whether a value is of a declared type, which `plain` knows."""
    ways = tuple(_one(one) for one in plain.kinds(kind))
    return ways[0] if len(ways) == 1 else lambda value: any(fits(value) for fits in ways)


def _one(kind: Any) -> _Fits:
    outer, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return lambda value: True
    if kind in _PLAIN:
        return _PLAIN[kind]
    if outer is Literal:
        return lambda value: isinstance(value, str) and value in inner
    if outer is np.ndarray:
        wanted = get_args(inner[1])[0]
        if wanted is Any:
            return lambda value: isinstance(value, np.ndarray)
        sort = np.dtype(wanted).kind
        return lambda value: isinstance(value, np.ndarray) and value.dtype.kind == sort
    if outer is tuple:
        items = tuple(_any(one) for one in inner if one is not Ellipsis)
        if len(inner) == 2 and inner[1] is Ellipsis:
            return lambda value: isinstance(value, tuple) and all(map(items[0], value))
        return lambda value: (
            isinstance(value, tuple)
            and len(value) == len(items)
            and all(fits(item) for fits, item in zip(items, value, strict=True))
        )
    if outer is dict:
        key, entry = _any(inner[0]), _any(inner[1])
        return lambda value: (
            isinstance(value, dict) and all(map(key, value)) and all(map(entry, value.values()))
        )
    return lambda value: isinstance(value, outer or kind)


_Fits: TypeAlias = Callable[[Any], bool]
_CHECKS: dict[type[Any], tuple[tuple[str, _Fits], ...]] = {}
_PLAIN: dict[Any, _Fits] = {
    bool: lambda value: isinstance(value, (bool, np.bool_)),
    int: lambda value: isinstance(value, (int, np.integer)) and not isinstance(value, bool),
    float: gate.is_real,
    type(None): lambda value: value is None,
}


def _said(kind: Any) -> str:
    """A declared type in words."""
    words = []
    for one in plain.kinds(kind):
        of = get_origin(one) or one
        if of is Literal:
            words += [repr(word) for word in get_args(one)]
        elif one in _PLAIN:
            words.append("None" if of is type(None) else of.__name__)
        else:
            words.append(gate.article(of))
    return " or ".join(words)
