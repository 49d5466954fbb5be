"""The fields of a record that was made by hand: values of the declared types, or a clear error."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, get_args, get_origin

import numpy as np

from ..exceptions import InputTypeError
from . import gate, plain


def check(record: Any) -> None:
    """Refuse a record with a field that is not of its declared type; shapes are not looked at."""
    for name, kind in plain.declared(type(record)).items():
        value = getattr(record, name)
        if _fits(value, kind):
            continue
        words = plain.words(kind)
        if words and isinstance(value, str):
            gate.choice(name, value, words)
        raise InputTypeError(f"`{name}` must be {_said(kind)}, got {gate.show(value)}")


def _fits(value: Any, kind: Any) -> bool:
    """Whether a value is of a declared type, which `plain` knows."""
    return any(_is(value, one) for one in plain.kinds(kind))


def _is(value: Any, kind: Any) -> bool:
    outer, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return True
    if kind in _PLAIN:
        return _PLAIN[kind](value)
    if outer is Literal:
        return isinstance(value, str) and value in inner
    if outer is np.ndarray:
        wanted = get_args(inner[1])[0]
        known = wanted is Any or (
            isinstance(value, np.ndarray) and value.dtype.kind == np.dtype(wanted).kind
        )
        return isinstance(value, np.ndarray) and known
    if outer is tuple:
        every = len(inner) == 2 and inner[1] is Ellipsis
        return isinstance(value, tuple) and (
            all(_fits(item, inner[0]) for item in value)
            if every
            else len(value) == len(inner) and all(map(_fits, value, inner))
        )
    if outer is dict:
        return isinstance(value, dict) and all(
            _fits(key, inner[0]) and _fits(item, inner[1]) for key, item in value.items()
        )
    return isinstance(value, outer or kind)


_PLAIN: dict[Any, Callable[[Any], bool]] = {
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
