"""A digest of a function or of any value, to see whether a study is continued with the same one.

Equal values give equal digests in every process. Nothing of a value can be read back from it.
"""

from __future__ import annotations

import copyreg
import dis
import functools
import hashlib
import sys
import sysconfig
import types
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from .._base.validation import show
from ..exceptions import InputError

_DEEPEST = 100  # levels of nesting, far below the limit of Python's stack
_PLAIN = (type(None), bool, int, complex, str, bytes)
_CACHED = type(functools.cache(len))
_PACKAGE = __name__.partition(".")[0]  # its code is that of a version, which a study has
_MORE = (float, tuple, np.ndarray, np.generic)
_READING = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS")
# members of a class that Python makes
_MADE = (types.MemberDescriptorType, types.GetSetDescriptorType)


def digest(name: str, value: object, home: str = "") -> str:
    """Return the SHA-256 of `value` as 64 hexadecimal digits; `name` is for messages.

    Of a function: its compiled code, defaults, the values of its closure, and what it names of the
    globals of its module: functions of that module in the same way, other code by its name, values;
    values other than numbers, texts and arrays in the module `home` only. Of an object: its class
    by name, of those in `home` also the code, and what it would be pickled with. Of a function that
    caches: the function, not what it has cached.
    """
    return _Digest(name, home).whole(value).hex()


def full_name(function: object) -> str:
    """Module and qualified name of what is called."""
    named = _named(function)
    return f"{named.__module__}.{named.__qualname__}"


def home_of(function: object) -> str:
    """The module of what is called; none for those of this package."""
    module = str(_named(function).__module__)
    return "" if module.partition(".")[0] == _PACKAGE else module


def _named(function: object) -> Any:
    while isinstance(function, functools.partial):
        function = function.func
    return function if hasattr(function, "__qualname__") else type(function)


class _Digest:
    def __init__(self, name: str, home: str) -> None:
        self._name, self._home, self._where = name, home, ""
        self._open: list[int] = []  # what is being read, from the outermost on
        self._globals: dict[tuple[int, str], tuple[str, Any]] = {}
        self._classes: dict[int, type] = {}
        self._offered: dict[str, dict[int, str]] = {}  # by package: names of what its modules have

    def whole(self, value: Any) -> bytes:
        """The digest of a value, and of all globals and classes that it leads to, each once."""
        own = self.of(value)
        others: dict[tuple[int, str], bytes] = {}
        while len(others) < len(self._globals) + len(self._classes):
            for where, (name, found) in list(self._globals.items()):
                if where not in others:
                    self._where = f" as global {name!r}"
                    others[where] = _joined(name, self.of(found))
            for at, made in list(self._classes.items()):
                if (at, "") not in others:
                    self._where = f" in the class {made.__qualname__!r}"
                    others[at, ""] = _joined(made.__qualname__, self._class(made))
        return _joined("whole", own, *sorted(others.values()))

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
            self._find_globals(value)
            own = (value.__code__, value.__defaults__, value.__kwdefaults__)
            return "function", (full_name(value), *own, list(_cells(value)))
        if isinstance(value, _CACHED):
            return "cached", (value.__wrapped__,)
        if isinstance(value, (type, types.ModuleType, types.BuiltinFunctionType)):
            return "name", self._by_name(value)
        if isinstance(value, types.MethodType):
            return "method", (value.__func__, value.__self__)
        return "object", self._pickled(value)

    def _by_name(self, value: Any) -> Iterable[Any]:
        owner = getattr(value, "__self__", None)
        bound = None if isinstance(owner, (types.ModuleType, type)) else owner
        module = str(getattr(value, "__module__", None))
        name = getattr(value, "__qualname__", getattr(value, "__name__", ""))
        if isinstance(value, type) and module == self._home:
            self._classes[id(value)] = value
        return module, name, bound

    def _class(self, made: type) -> bytes:
        """The code and the values of a class, but for what Python adds."""
        found = {}
        for name, value in vars(made).items():
            kind, parts = type(value).__name__, _parts_of_member(value)
            special = name == "_abc_impl" or (name.startswith("__") and name.endswith("__"))
            if isinstance(value, _MADE) or (special and not parts):
                continue
            mine = [full_name(p) if self._is_foreign(p) else p for p in parts or (value,)]
            found[name] = (kind, *mine)
        return self.of((list(made.__bases__), found))

    def _is_foreign(self, value: object) -> bool:
        return isinstance(value, types.FunctionType) and value.__module__ != self._home

    def _pickled(self, value: Any) -> Iterable[Any]:
        """What an object would be pickled with: a callable, its arguments, the state, the items.

        Of one that an installed package offers, as scipy.stats does `norm`: its name.
        """
        package = type(value).__module__.partition(".")[0]
        if package not in self._offered:
            self._offered[package] = _offers(package)
        if id(value) in self._offered[package]:
            return (type(value), self._offered[package][id(value)])
        try:
            how = copyreg.dispatch_table.get(type(value))
            made = value.__reduce_ex__(4) if how is None else how(value)
        except Exception as error:
            raise InputError(
                f"`{self._name}` contains {show(value)}{self._where}, which cannot be saved with "
                "the study: pass it by name in an axis {name: value}, or make it inside the "
                "function"
            ) from error
        if isinstance(made, str):  # the name of a global
            return (type(value), made)
        make, arguments, state, items, pairs = (*made, None, None, None)[:5]
        if self._is_foreign(make):
            make = full_name(make)
        return (make, arguments, state, list(items or ()), dict(pairs or ()))

    def _find_globals(self, function: types.FunctionType) -> None:
        """Note the globals that a function names."""
        around, module = function.__globals__, function.__module__
        for name in _global_names(function.__code__).intersection(around):
            value = around[name]
            code = value.__wrapped__ if isinstance(value, _CACHED) else value
            if isinstance(code, types.FunctionType):
                value = value if code.__module__ == module else full_name(code)
            elif module != self._home and not isinstance(value, (*_PLAIN[1:], *_MORE)):
                continue
            self._globals[id(around), name] = (f"{module}.{name}", value)


def _parts_of_member(value: Any) -> tuple[Any, ...]:
    """The functions that a member of a class is made of, if it is."""
    if isinstance(value, (types.FunctionType, _CACHED)):
        return (value,)
    if isinstance(value, (staticmethod, classmethod)):
        return (value.__func__,)
    if isinstance(value, property):
        return (value.fget, value.fset, value.fdel)
    return (value.func,) if isinstance(value, functools.cached_property) else ()


def _offers(package: str) -> dict[int, str]:
    """The smallest name of each object in the modules of an installed package, by its id."""
    found: dict[int, str] = {}
    folders = tuple(sysconfig.get_paths()[kind] for kind in ("stdlib", "purelib", "platlib"))
    for full, module in list(sys.modules.items()):
        if full.partition(".")[0] == package and str(getattr(module, "__file__", "")).startswith(
            folders
        ):
            for name, value in list(vars(module).items()):
                found[id(value)] = min(name, found.get(id(value), name))
    return found


def _cells(function: types.FunctionType) -> Iterator[Any]:
    for cell in function.__closure__ or ():
        try:
            yield cell.cell_contents
        except ValueError:  # not assigned yet
            yield None


def _global_names(code: types.CodeType) -> set[str]:
    """The globals that code reads, also in functions and classes that it makes."""
    inner = (const for const in code.co_consts if isinstance(const, types.CodeType))
    own = {one.argval for one in dis.get_instructions(code) if one.opname in _READING}
    return own.union(*(_global_names(one) for one in inner))


def _joined(kind: str, *parts: bytes) -> bytes:
    """SHA-256 of the parts, each with its length before it."""
    found = hashlib.sha256()
    for part in (kind.encode(), *parts):
        found.update(len(part).to_bytes(8, "little") + part)
    return found.digest()
