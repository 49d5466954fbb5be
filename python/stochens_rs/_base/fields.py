"""Fields of records: their declared types in words and as checks, their values as plain data.

The format of plain data is that of `docs/systems.md`.
"""

from __future__ import annotations

import inspect
import math
import types as kinds_of_types
from collections.abc import Callable
from functools import cache
from itertools import repeat
from typing import Any, Literal, NoReturn, TypeAlias, Union, get_args, get_origin, get_type_hints

import numpy as np

from ..exceptions import InputError, InputTypeError, StochensError
from . import types, validation
from .types import NDArray

Put: TypeAlias = Callable[[str, NDArray[Any], bool], Any]
Get: TypeAlias = Callable[[str, dict[str, Any], "np.dtype[Any]"], NDArray[Any] | None]

# All classes that can be read, by their names: `Record` enters those of this package.
RECORDS: dict[str, type[Any]] = {}
_DECLARED: dict[type[Any], dict[str, Any]] = {}
# What makes a record of its fields, and what then checks it, by class.
_MAKERS: dict[type[Any], tuple[Any, Any]] = {}
_DTYPES = ("float64", "int64", "int8", "bool", "uint8", "uint16", "uint32", "uint64")
_NOT_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
_NUMBERS = {"f": (float, int), "b": (bool,), "i": (int,), "u": (int,)}  # in lists, by kind of dtype
_LONGEST = 2**63  # of whole numbers
_EMPTY = 2**20  # the largest side of an array without entries


def enter(record: type[Any], made_by: Any = None, verify: Any = None, /, **arguments: Any) -> None:
    """List a class, and the types of the arguments where the constructor, of the core, has none."""
    RECORDS[record.__name__], _MAKERS[record] = record, (made_by or record, verify)
    if arguments:
        _DECLARED[record] = arguments


def declared(record: type[Any]) -> dict[str, Any]:
    """The arguments of the constructor of a record, and their types."""
    if record not in _DECLARED:
        made_by = _MAKERS[record][0] if record in _MAKERS else record
        found = get_type_hints(made_by, localns={**vars(types), **RECORDS})
        names = inspect.signature(made_by).parameters
        _DECLARED[record] = {name: found[name] for name in names}
    return _DECLARED[record]


def kinds(kind: Any) -> tuple[Any, ...]:
    """The types of a union; of another type this type alone."""
    union = get_origin(kind) in (Union, kinds_of_types.UnionType)
    return get_args(kind) if union else (kind,)


def _inner(kind: Any, outer: Any) -> tuple[Any, ...]:
    """What stands in the brackets of `outer` in a declared type; () if it is not there."""
    return next((get_args(one) for one in kinds(kind) if get_origin(one) is outer), ())


def _dtype(kind: Any) -> np.dtype[Any] | None:
    """The dtype of a declared array; None if there is no array, or one of any dtype."""
    inner = _inner(kind, np.ndarray)
    scalar = get_args(inner[1])[0] if inner else Any
    return None if scalar is Any else np.dtype(scalar)


def _items(kind: Any, count: int) -> list[Any] | None:
    """The types of the items of a declared tuple with this many; None if there is none."""
    inner = _inner(kind, tuple)
    if inner[1:] == (Ellipsis,):
        return [inner[0]] * count
    return list(inner) if inner and len(inner) == count else None


@cache
def test(kind: Any) -> Callable[[Any], bool]:
    """Whether a value is of a declared type."""
    tests = [_test(one) for one in kinds(kind)]
    return tests[0] if len(tests) == 1 else lambda value: any(one(value) for one in tests)


def _test(kind: Any) -> Callable[[Any], bool]:
    outer, inner = get_origin(kind) or kind, get_args(kind)
    if kind in _PLAIN:
        return _PLAIN[kind]
    if outer is Literal:
        return lambda value: isinstance(value, str) and value in inner
    if outer is np.ndarray:
        dtype = _dtype(kind)
        letters = "fiu" if dtype is None else dtype.kind
        return lambda value: (
            isinstance(value, np.ndarray)
            and value.dtype.kind in letters
            and not isinstance(value, np.ma.MaskedArray)
        )
    if outer is tuple:
        return lambda value: isinstance(value, tuple) and _fit(value, _items(kind, len(value)))
    if outer is dict:
        return lambda value: (
            isinstance(value, dict)
            and _fit(value, repeat(inner[0]))
            and _fit(value.values(), repeat(inner[1]))
        )
    return lambda value: isinstance(value, outer)


def _fit(values: Any, of: Any) -> bool:
    return of is not None and all(test(one)(value) for value, one in zip(values, of, strict=False))


def _is_int(value: Any) -> bool:
    return validation.is_real(value) and isinstance(value, (int, np.integer))


_PLAIN: dict[Any, Callable[[Any], bool]] = {
    Any: lambda _: True,
    bool: lambda value: isinstance(value, (bool, np.bool_)),
    int: lambda value: _is_int(value) and -_LONGEST <= value < 2 * _LONGEST,
    # neither nan nor an integer beyond the largest number
    float: lambda value: (
        _PLAIN[int](value) if _is_int(value) else validation.is_real(value) and value == value
    ),
    type(None): lambda value: value is None,
}


def refuse(name: str, value: Any, kind: Any) -> NoReturn:
    """Say which type was declared, and what was found."""
    literals = _inner(kind, Literal)
    if literals and isinstance(value, str):
        validation.choice(name, value, literals)
    words = [repr(word) for word in literals]
    for one in kinds(kind):
        of = get_origin(one) or one
        if of is type(None):
            words.append("None")
        elif of is not Literal:
            words.append(of.__name__ if one in _PLAIN else validation.article(of))
    raise InputTypeError(f"`{name}` must be {' or '.join(words)}, got {validation.show(value)}")


def written(name: str, value: Any, kind: Any, put: Put) -> Any:
    """Return plain data for a value of the declared type `kind`; `put` writes the arrays."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, int) and abs(value) < _LONGEST:
        return value
    if isinstance(value, float):
        if math.isfinite(value):
            return value
        text = str(value)
        return text if float in kinds(kind) else {"type": "float", "value": text}
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, np.ndarray) and value.dtype.name in _DTYPES:
        dtype = _dtype(kind)  # numpy takes None for float64
        return put(name, value, dtype is not None and dtype == value.dtype)
    if isinstance(value, (tuple, list)):
        inner = _items(kind, len(value)) if isinstance(value, tuple) else None
        of_rows = zip(value, inner or repeat(Any), strict=False)
        rows = [written(f"{name}.{k}", item, of, put) for k, (item, of) in enumerate(of_rows)]
        free = isinstance(value, tuple) and inner is None
        return {"type": "tuple", "items": rows} if free else rows
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        _, of = _inner(kind, dict) or (None, None)
        found = {
            key: written(f"{name}.{k}", item, of or Any, put)
            for k, (key, item) in enumerate(value.items())
        }
        return {"type": "dict", "items": found} if of is None and "type" in value else found
    record = type(value)
    if RECORDS.get(record.__name__) is not record:
        raise InputTypeError(f"`{name}` cannot be saved: {validation.show(value)}")
    at = f"{name}." if name else ""
    values = zip(declared(record).items(), value.__reduce__()[1], strict=True)
    parts = {field: written(f"{at}{field}", part, of, put) for (field, of), part in values}
    if _short(record) and record in kinds(kind):
        return next(iter(parts.values()))
    return {"type": record.__name__, **parts}


def restored(name: str, value: Any, kind: Any, get: Get) -> Any:
    """Undo `written`; what is not of the declared type is refused."""
    options, found = kinds(kind), value
    if isinstance(value, str):
        found = _of_text(name, value, options, get)
    elif isinstance(value, dict):
        found = _of_dict(name, value, kind, get)
    elif isinstance(value, list):
        dtype, inner = _dtype(kind), _items(kind, len(value))
        if dtype is not None:
            return of_list(name, value, dtype)
        if inner is not None or Any in options:
            of_rows = zip(value, inner or repeat(Any), strict=False)
            rows = [restored(f"{name}[{k}]", item, of, get) for k, (item, of) in enumerate(of_rows)]
            found = rows if inner is None else tuple(rows)
    elif value is not None and not (
        isinstance(value, (bool, int)) or (isinstance(value, float) and math.isfinite(value))
    ):
        refuse(name, value, kind)
    if not test(kind)(found):
        refuse(name, value, kind)
    return found


def listed(array: NDArray[Any]) -> Any:
    """The entries as nested lists, ready for JSON: nan as None, infinite ones as "inf", "-inf"."""
    if array.dtype.kind != "f" or np.isfinite(array).all():
        return array.tolist()
    cells = array.astype(object)
    cells[np.isnan(array)] = None
    cells[np.isposinf(array)], cells[np.isneginf(array)] = "inf", "-inf"
    return cells.tolist()


def of_list(name: str, value: list[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Undo `listed`."""
    cells = np.array(value, dtype=object)
    numbers = cells.ravel().tolist()
    if dtype.kind == "f":
        texts: dict[Any, float] = {None: math.nan, **_NOT_FINITE}
        numbers = [texts.get(x, x) if x is None or type(x) is str else x for x in numbers]
    good = bool(numbers) and all(type(x) in _NUMBERS[dtype.kind] for x in numbers)
    try:
        array = np.array(numbers).astype(dtype) if good else cells
        good = good and (dtype.kind == "f" or array.tolist() == numbers)
    except (OverflowError, TypeError):  # beyond the largest number
        good = False
    if not good:
        raise InputTypeError(f"`{name}` must be nested lists of {dtype.name} of equal lengths")
    return array.reshape(cells.shape)


def _of_text(name: str, value: str, options: tuple[Any, ...], get: Get) -> Any:
    if Any in options or str in options:
        return value
    if float in options and value in _NOT_FINITE:
        return _NOT_FINITE[value]
    for short in filter(_short, options):
        return _made(name, short, dict.fromkeys(declared(short), value), get)
    try:
        return bytes.fromhex(value) if bytes in options else value
    except ValueError:
        raise InputError(f"`{name}` must be hexadecimal, got {validation.show(value)}") from None


def _of_dict(name: str, value: dict[str, Any], kind: Any, get: Get) -> Any:
    free, of = Any in kinds(kind), _inner(kind, dict)
    what = value["type"] if isinstance(value.get("type"), str) else ""
    if of or (free and "type" not in value):
        at = (f"{name}[{key!r:.40}]" for key in value)
        inner = of[1] if of else Any
        return {key: restored(next(at), item, inner, get) for key, item in value.items()}
    if what == "array" and (free or _inner(kind, np.ndarray)):
        return _of_array(name, value, get)
    if free and what == "tuple":
        return restored(name, value.get("items"), tuple[Any, ...], get)
    if free and what == "dict":
        return restored(name, value.get("items"), dict[str, Any], get)
    if free and what == "float" and str(value.get("value")) in _NOT_FINITE:
        return _NOT_FINITE[str(value["value"])]
    record = RECORDS.get(what)
    bases = tuple(one for one in kinds(kind) if isinstance(one, type) and get_origin(one) is None)
    if record is None or not (free or issubclass(record, bases)):
        refuse(name, what or value, kind)
    fields = {field: item for field, item in value.items() if field != "type"}
    return _made(name, record, fields, get)


def _of_array(name: str, about: dict[str, Any], get: Get) -> NDArray[Any]:
    """The array that these data describe, which may come from anywhere."""
    dtype, shape = str(about.get("dtype")), about.get("shape")
    if dtype not in _DTYPES:
        raise InputTypeError(f"`{name}` must be an array of numbers, got {validation.show(dtype)}")
    flat = get(name, about, np.dtype(dtype))
    if flat is None or flat.ndim != 1 or flat.dtype != dtype:
        raise InputError(f"`{name}` must be one list or array of {dtype}")
    sides = shape if isinstance(shape, list) and len(shape) <= 8 else [-1]
    good = all(type(side) is int and side >= 0 for side in sides)
    if not good or math.prod(sides) != flat.size or (not flat.size and max(sides) > _EMPTY):
        raise InputError(f"`{name}` must have {flat.size} entries, got another shape")
    return flat.reshape(sides)


def _made(name: str, record: type[Any], fields: dict[str, Any], get: Get) -> Any:
    """Call the constructor of a record, which checks the fields."""
    wanted, at = declared(record), f"{name}." if name else ""
    for field in (*wanted, *fields):
        if (field in wanted) != (field in fields):
            problem = "is missing" if field in wanted else "is no field"
            shown = f"`{at}{field}`" if field in wanted else validation.show(field)
            raise InputError(f"{shown} {problem} of {validation.article(record)}")
    given = {field: restored(f"{at}{field}", fields[field], wanted[field], get) for field in wanted}
    try:
        make, verify = _MAKERS[record]
        made = make(**given)
        if verify is not None:
            verify(made)
    except (StochensError, MemoryError):
        raise
    except Exception as error:  # whatever fields that do not go together lead to
        where, text = f"`{name}`" if name else "the data", " ".join(str(error).split())
        raise InputError(f"{where} cannot be {validation.article(record)}: {text:.200}") from error
    return made


def _short(kind: Any) -> bool:
    """Whether a class is a record with one field of bytes, as `Key`."""
    listed_one = isinstance(kind, type) and RECORDS.get(kind.__name__) is kind
    return listed_one and list(declared(kind).values()) == [bytes]
