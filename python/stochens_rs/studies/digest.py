"""A digest of a function or of any value, to see whether a study is continued with the same one.

Equal values give equal digests in every process. Nothing of a value can be read back from it.
"""

from __future__ import annotations

import functools
import hashlib
import types
from collections.abc import Iterable
from typing import Any

import numpy as np

from .._base.gate import show
from ..exceptions import InputError

_DEEPEST = 100  # levels of nesting, far below the limit of Python's stack
_PLAIN = (type(None), bool, int, complex, str, bytes)


def digest(name: str, value: object) -> str:
    """Return the SHA-256 of `value` as 64 hexadecimal digits; `name` is for messages.

    Of a function: its compiled code, defaults, the values of its closure, and the functions of its
    own module, numbers, texts and arrays that it names. Of an object: its class by name, and what
    it would be pickled with.
    """
    return _Digest(name).of(value).hex()


def full_name(function: object) -> str:
    """Module and qualified name of what is called."""
    while isinstance(function, functools.partial):
        function = function.func
    named = function if hasattr(function, "__qualname__") else type(function)
    return f"{named.__module__}.{named.__qualname__}"


class _Digest:
    def __init__(self, name: str) -> None:
        self._name = name
        self._open: list[int] = []  # what is being read, from the outermost on

    def of(self, value: Any) -> bytes:
        """The digest of a value: of its kind and its parts."""
        if type(value) in _PLAIN:
            return _joined(type(value).__name__, repr(value).encode())
        if isinstance(value, float):  # with its subclass numpy.float64
            return _joined("float", float(value).hex().encode())
        if id(value) in self._open:
            return _joined("above", str(self._open.index(id(value))).encode())
        if len(self._open) >= _DEEPEST:
            raise InputError(f"`{self._name}` must be nested less than {_DEEPEST} levels deep")
        self._open.append(id(value))
        try:
            kind, parts = self._parts(value)
            return _joined(kind, *(self.of(part) for part in parts))
        finally:
            self._open.pop()

    def _parts(self, value: Any) -> tuple[str, Iterable[Any]]:
        """What kind of value it is, and what it consists of."""
        if isinstance(value, (np.ndarray, np.generic)) and not value.dtype.hasobject:
            return "array", (value.dtype.str, value.shape, value.tobytes())
        if type(value) in (list, tuple):
            return type(value).__name__, value
        if isinstance(value, (set, frozenset)):
            return "set", sorted(self.of(item) for item in value)
        if type(value) is dict:
            return "dict", sorted(self.of(key) + self.of(item) for key, item in value.items())
        if isinstance(value, types.CodeType):
            names = (value.co_names, value.co_varnames, value.co_freevars, value.co_cellvars)
            counts = (value.co_argcount, value.co_kwonlyargcount, value.co_flags)
            return "code", (value.co_code, value.co_consts, *names, *counts)
        if isinstance(value, types.FunctionType):
            cells = [cell.cell_contents for cell in value.__closure__ or ()]
            own = (value.__code__, value.__defaults__, value.__kwdefaults__)
            return "function", (full_name(value), *own, cells, self._named(value))
        if isinstance(value, (type, types.ModuleType, types.BuiltinFunctionType)):
            owner = getattr(value, "__self__", None)
            bound = None if isinstance(owner, (types.ModuleType, type)) else owner
            module = getattr(value, "__module__", None)
            return "name", (str(module), getattr(value, "__qualname__", value.__name__), bound)
        if isinstance(value, types.MethodType):
            return "method", (value.__func__, value.__self__)
        return "object", self._pickled(value)

    def _pickled(self, value: Any) -> Iterable[Any]:
        """What an object would be pickled with: a callable, its arguments, the state, the items."""
        try:
            made = value.__reduce_ex__(4)
        except Exception as error:
            raise InputError(
                f"`{self._name}` contains {show(value)}, which cannot be saved with the study: "
                "pass it by name in an axis {name: value}, or make it inside the function"
            ) from error
        if isinstance(made, str):  # the name of a global
            return (type(value), made)
        make, arguments, state, items, pairs = (*made, None, None, None)[:5]
        return (make, arguments, state, list(items or ()), dict(pairs or ()))

    @staticmethod
    def _named(function: types.FunctionType) -> dict[str, Any]:
        """The globals that a function names: functions of its module, numbers, texts, arrays."""
        around = function.__globals__
        found: dict[str, Any] = {}
        for name in sorted(_names(function.__code__)):
            value = around.get(name)
            own = getattr(value, "__module__", None) == function.__module__
            if (isinstance(value, types.FunctionType) and own) or (
                isinstance(value, (bool, int, float, str, tuple, np.ndarray, np.generic))
            ):
                found[name] = value
        return found


def _names(code: types.CodeType) -> set[str]:
    inner = (const for const in code.co_consts if isinstance(const, types.CodeType))
    return set(code.co_names).union(*(_names(one) for one in inner))


def _joined(kind: str, *parts: bytes) -> bytes:
    """SHA-256 of the parts, each with its length before it."""
    found = hashlib.sha256()
    for part in (kind.encode(), *parts):
        found.update(len(part).to_bytes(8, "little") + part)
    return found.digest()
