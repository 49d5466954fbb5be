"""Records: their fields are checked by declarations, made plain, pickled, and saved in state files.

``Annotated[Floats, "step+1 state"]`` is an array of shape (K + 1, n) of finite numbers in the units
of the states; the first field with a dimension says how long it is. After the
dimensions "infinite" allows infinite numbers, and "own unit" says that the unit is not that of the
last dimension. For a number or a text it is a check of `validation`, as in `Probability`.
"""

from __future__ import annotations

import functools
import json
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import cache
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    ParamSpec,
    TypeAlias,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from ..exceptions import InputError, InputTypeError, ShapeError
from . import running, saving, types, validation
from .saving import Durable, nothing_left

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from typing_extensions import Self


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
    if saving.RECORDS.get(record.__name__) != record or hasattr(record, "_made_by"):
        return {}
    hints = get_type_hints(record, localns={**vars(types), **saving.RECORDS}, include_extras=True)
    found = {}
    for name in saving.declared(record):
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
    kind, value = saving.declared(type(record))[name], getattr(record, name)
    words = saving.words(kind)
    if words and isinstance(value, str):
        validation.choice(name, value, words)
    raise InputTypeError(f"`{name}` must be {_said(kind)}, got {validation.show(value)}")


@cache
def _tests(record: Any) -> tuple[tuple[str, Test], ...]:
    """Name and test of each field, by the type that `saving.declared` gives."""
    return tuple((name, _test(kind)) for name, kind in saving.declared(record).items())


def _test(kind: Any) -> Test:
    """Whether a value is of a declared type."""
    tests = tuple(_test_one(one) for one in saving.kinds(kind))
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
    for one in saving.kinds(kind):
        of = get_origin(one) or one
        if of is Literal:
            words += [repr(word) for word in get_args(one)]
        elif one in _PLAIN:
            words.append("None" if of is type(None) else of.__name__)
        else:
            words.append(validation.article(of))
    return " or ".join(words)


SCHEMA = "stochens-record/1"
P = ParamSpec("P")
R = TypeVar("R")
_ROOM = __name__.partition(".")[0] + "."
# Bytes of a number in a list, and of what a byte of JSON can become, in CPython.
_IN_LIST, _PARSED = 40, 80


class Record:
    """Base of the classes that are made of numbers, texts, arrays and other records.

    Pickling, copying, `from_dict` and `load` call the constructor, which checks the fields, because
    data can come from anywhere. A class that has another one than its own names it ``_made_by``.
    """

    __slots__ = ()

    _kind: ClassVar[str]

    def __init_subclass__(cls, *, listed: bool = True, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "_kind" not in vars(cls):
            cls._kind = re.sub(r"(?<!^)(?=[A-Z])", "-", cls.__name__).lower()
        if listed and cls.__module__.startswith(_ROOM):
            saving.RECORDS[cls.__name__] = cls

    def __post_init__(self) -> None:
        """Check that the fields are of their declared types; a class checks what else must hold."""
        if saving.RECORDS.get(type(self).__name__) is type(self):
            check(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), tuple(getattr(self, one.name) for one in fields(self))  # type: ignore[arg-type]

    def _keep(self, **values: Any) -> None:
        """Set fields to what the constructor made of its arguments."""
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _verify(self) -> None:
        """Check what the constructor trusts, after the fields came from plain data."""

    def to_dict(self) -> dict[str, Any]:
        """Turn into plain data, ready for ``json.dumps``.

        Returns
        -------
        dict
            "schema", "type", and the fields: arrays as nested lists with None for nan, infinite
            numbers as "inf" and "-inf", keys as hexadecimal digits, records as dicts with their
            "type". Arrays whose type or shape a list does not tell are dicts with "dtype",
            "shape" and "values".

        Raises
        ------
        ResourceError
            If the lists do not fit into the memory this process may use.
        InputTypeError
            If an entry of a field is of a type of your own.

        Examples
        --------
        >>> import stochens_rs as se
        >>> path = se.simulate(([[0.5]], [[1.0]]), [2.0], [[1.0]])
        >>> path.to_dict()["states"]
        [[2.0], [2.0]]
        """
        found: dict[str, Any] = saving.written("", self, Any, _put_lists)
        return {"schema": SCHEMA, **found}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Undo `to_dict`.

        Parameters
        ----------
        data : mapping
            What `to_dict` returned, possibly written to JSON and read again.

        Returns
        -------
        Self
            With the same bits in every field.

        Raises
        ------
        InputError, InputTypeError
            If the data are something else; the message names the field.

        Examples
        --------
        >>> import json, stochens_rs as se
        >>> fit = se.fuse(se.sample([3.0, -1.0], 10, rng=1))
        >>> text = json.dumps(fit.to_dict(), allow_nan=False)
        >>> bool((se.Fit.from_dict(json.loads(text)).estimate == fit.estimate).all())
        True
        """
        if not isinstance(data, Mapping):
            raise InputTypeError(f"`data` must be a dict of to_dict(), got {validation.show(data)}")
        try:
            made: Self = _restored(cls, dict(data), _of_lists)
        except RecursionError:
            raise InputError("`data` must not be nested so deeply") from None
        return made


class Options(Record, listed=False):
    """Base of the records that users make to say what they want; shown as they would be typed."""

    __slots__ = ()

    def __repr__(self) -> str:
        own: Any = type(self)
        said = [
            f"{one.name}={getattr(self, one.name)!r}"
            for one in fields(own)
            if not _is_default(one.default, getattr(self, one.name))
        ]
        return f"{own.__name__}({', '.join(said)})"


def _is_default(default: object, value: object) -> bool:
    return value is default or (type(value) is type(default) and value == default)


class SavedRecord(Record, Durable, listed=False):
    """Base of the records that have files of their own.

    Two are equal if their files have the same bits; a class may declare that it compares less.
    """

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other) or not isinstance(other, SavedRecord):
            return NotImplemented
        if self is other:
            return True
        mine, its = self._to_sections(), other._to_sections()
        return mine.keys() == its.keys() and all(
            np.array_equal(array.view(np.uint8), its[name].view(np.uint8))
            for name, array in mine.items()
        )

    __hash__ = None  # type: ignore[assignment]  # as for arrays

    def _to_sections(self) -> dict[str, Any]:
        sections: dict[str, Any] = {}

        def put(name: str, array: NDArray[Any], _: bool) -> dict[str, Any]:
            dtype = _checked_dtype(name, array.dtype.name)
            at = name if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", name) else ""
            at = at or f"array.{len(sections)}"
            running.need("a state to be saved", array.nbytes)
            flat = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).reshape(-1)
            sections[at] = array.ravel() if dtype == "float64" else flat.view(np.uint8)
            return {"type": "array", "name": at, "dtype": dtype, "shape": list(array.shape)}

        tree = {"schema": SCHEMA, **saving.written("", self, Any, put)}
        text = json.dumps(tree, allow_nan=False, separators=(",", ":")).encode()
        return {**sections, "record": np.frombuffer(text, dtype=np.uint8)}

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Self:
        def get(name: str, about: dict[str, Any]) -> NDArray[Any]:
            at, dtype = about.get("name"), _checked_dtype(name, about.get("dtype"))
            flat = sections.pop(at, None) if isinstance(at, str) else None
            stored = np.float64 if dtype == "float64" else np.uint8
            if flat is None or flat.dtype != stored or flat.nbytes % np.dtype(dtype).itemsize:
                raise InputError(f"`{name}` must be an array of {dtype} in this file")
            if dtype == "bool" and flat.size and flat.max() > 1:
                raise InputError(f"`{name}` must have entries 0 and 1")
            array = flat.view(np.dtype(dtype).newbyteorder("<")).astype(dtype, copy=False)
            return saving.shaped(name, array, about.get("shape"))

        text = sections.pop("record")
        if text.dtype != np.uint8:
            raise InputError(f"`record` must be of uint8, got {text.dtype.name}")
        running.need("the text of a saved record", _PARSED * text.size)
        try:
            tree = json.loads(text.tobytes(), parse_constant=_refused)
            if not isinstance(tree, dict):
                raise InputError("`record` must be an object")
            made: Self = _restored(cls, tree, get)
        except RecursionError:
            raise InputError("`record` must not be nested so deeply") from None
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"`record` must be JSON: {error}"[:200]) from None
        nothing_left(sections)
        return made


def trusted(kind: Callable[P, R], /, *args: P.args, **fields: P.kwargs) -> R:
    """``kind(*args, **fields)`` without its checks: the fields were just computed or checked."""
    made = object.__new__(cast("type[Any]", kind))
    made.__dict__["__post_init__"] = _unchecked  # called in place of that of the class
    made.__init__(*args, **fields)
    del made.__dict__["__post_init__"]
    return cast("R", made)


def _unchecked() -> None:
    """Check nothing."""


def require_shapes(record: Any, **wanted: tuple[int, ...]) -> None:
    """Refuse arrays among the fields of a record that have other shapes; None is no array."""
    for name, shape in wanted.items():
        found = getattr(record, name)
        if found is not None and np.shape(found) != shape:
            raise ShapeError(f"`{name}` must have shape {shape}, got {np.shape(found)}")


def _restored(cls: type[Any], tree: dict[str, Any], get: saving.Get) -> Any:
    schema = tree.pop("schema", None)
    if not isinstance(schema, str) or schema != SCHEMA:
        raise InputError(f"`schema` must be '{SCHEMA}', got {validation.show(schema)}")
    if not isinstance(tree.get("type"), str) or tree["type"] != cls.__name__:
        raise InputError(
            f"`type` must be '{cls.__name__}', got {validation.show(tree.get('type'))}"
        )
    return saving.restored("", tree, cls, get)


def _put_lists(name: str, array: NDArray[Any], known: bool) -> Any:
    running.need("the numbers as lists", _IN_LIST * array.size)
    if known and array.size and array.ndim:
        return saving.listed(array)
    dtype = _checked_dtype(name, array.dtype.name)
    values = saving.listed(array.reshape(-1))
    return {"type": "array", "dtype": dtype, "shape": list(array.shape), "values": values}


def _of_lists(name: str, about: dict[str, Any]) -> NDArray[Any]:
    dtype, values = np.dtype(_checked_dtype(name, about.get("dtype"))), about.get("values")
    if not isinstance(values, list):
        raise InputError(f"`{name}` must have a list of values, got {validation.show(values)}")
    flat = saving.of_list(name, values, dtype) if values else np.empty(0, dtype)
    if flat.ndim != 1:
        raise InputError(f"`{name}` must have values in one list")
    return saving.shaped(name, flat, about.get("shape"))


def _checked_dtype(name: str, dtype: object) -> str:
    if dtype not in saving.DTYPES:
        raise InputTypeError(
            f"`{name}` must be an array of {saving.DTYPES[0]} or another number "
            f"type, got {validation.show(dtype)}"
        )
    return str(dtype)


def _refused(text: str) -> None:
    raise InputError(f"`record` must have no {text}")


if TYPE_CHECKING or sys.version_info >= (3, 12):
    from functools import cached_property as cached_property
else:

    class cached_property(functools.cached_property):
        """As of Python 3.12, without the lock of one class, which a fork leaves held for ever.

        Two threads may both compute the value: they keep the same one.
        """

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            if instance is None:
                return self
            kept = instance.__dict__
            if self.attrname not in kept:
                return kept.setdefault(self.attrname, self.func(instance))
            return kept[self.attrname]
