"""Records: their fields are checked by declarations, made plain, pickled, and saved in state files.

``Annotated[Floats, "step+1 state"]`` is an array of shape (K + 1, n) of finite numbers in the units
of the states; the first field with a dimension says how long it is. A first dimension "run" may be
left out in all fields of a record together. After the dimensions "infinite" allows infinite
numbers, and "own unit" says that the unit is not that of the last dimension. For a number or a text
it is a check of `validation`, as in `Probability`.
"""

from __future__ import annotations

import functools
import json
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from dataclasses import fields as fields_of
from functools import cache
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
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
from . import fields, running, show, types, validation
from .files import Durable
from .types import NDArray, Self


def _from_zero(name: str, value: float) -> float:
    if not fields.test(float)(value):
        fields.refuse(name, value, float)
    if not value >= 0.0:
        raise InputError(f"`{name}` must be >= 0, got {value:g}")
    return value


FromZero: TypeAlias = Annotated[float, _from_zero]  # infinite, too
NotNegative: TypeAlias = Annotated[float, validation.nonnegative]
Probability: TypeAlias = Annotated[float, validation.probability]  # in (0, 1)
Positive: TypeAlias = Annotated[float, validation.positive]
Dense: TypeAlias = Annotated[types.Floats, validation.kept]  # a vector or a matrix
Line: TypeAlias = Annotated[str, validation.line]
Count: TypeAlias = Annotated[int, validation.size]  # >= 1
Index: TypeAlias = Annotated[int, functools.partial(validation.size, minimum=0)]


class Rule(NamedTuple):
    """What the declaration of a field says beside its type: dimensions and words, or a check."""

    dims: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    check: Callable[[str, Any], Any] | None = None


def check(record: Any) -> None:
    """Refuse a record with a field that is not of its declared type, shape and range.

    A number becomes what its check returns.
    """
    known, free = rules(record.__class__), Rule()
    for name, kind in fields.declared(record.__class__).items():
        value, checked = getattr(record, name), known.get(name, free).check
        if checked is not None and value is not None:
            record._keep(**{name: checked(name, value)})
        elif not fields.test(kind)(value):
            fields.refuse(name, value, kind)
    sizes(record)


def sizes(record: Any) -> dict[str, int]:
    """The length of each dimension that the fields of a record name; refuses what does not fit."""
    found: dict[str, int] = {}
    runs: bool | None = None  # whether there is an axis of runs, the same for all fields
    for name, rule in rules(record.__class__).items():
        value, dims = getattr(record, name), rule.dims
        if value is None or rule.check is not None:
            continue
        if dims[:1] == ("run",):
            runs = value.ndim == len(dims) if runs is None else runs
            dims = dims[not runs :]
        fits = value.ndim == len(dims) and all(
            _fits(dim, length, found) for dim, length in zip(dims, value.shape, strict=True)
        )
        if not fits:
            wanted = ", ".join(str(_length(dim, found) or dim) for dim in dims)
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
    if fields.RECORDS.get(record.__name__) != record or record._made_by:
        return {}
    hints = get_type_hints(record, localns={**vars(types), **fields.RECORDS}, include_extras=True)
    found = {}
    for name in fields.declared(record):
        for kind in (hints[name], *get_args(hints[name])):
            if get_origin(kind) is Annotated:
                first, *more = kind.__metadata__
                text = isinstance(first, str)
                found[name] = Rule(tuple(first.split()), (*more,)) if text else Rule(check=first)
    return found


def _fits(dim: str, length: int, known: dict[str, int]) -> bool:
    """Whether a dimension, such as "step+1", has this length; a new name gets it."""
    dim = dim.removeprefix("from_").removeprefix("other_")
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


SCHEMA = "stochens-record/1"
P = ParamSpec("P")
R = TypeVar("R")
_ROOM = __name__.partition(".")[0] + "."
# Bytes of a number in a list, and of what a byte of JSON can become, in CPython.
_IN_LIST, _PARSED = 40, 80


@types.dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
class Record:
    """Base of the classes that are made of numbers, texts, arrays and other records.

    Those of this package are frozen dataclasses without a decorator, with `eq` compared by their
    fields; but those without `init` make themselves, and those that are not `listed` only hand
    down methods.

    Pickling, copying, `from_dict` and `load` call the constructor, which checks the fields, because
    data can come from anywhere. A class that has another one than its own names it ``_made_by``.
    """

    __slots__ = ()

    _kind: ClassVar[str]
    _made_by: ClassVar[Callable[..., Any] | None] = None
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __init_subclass__(
        cls, *, listed: bool = True, init: bool = True, eq: bool = False, **options: Any
    ) -> None:
        super().__init_subclass__(**options)
        if "_kind" not in vars(cls):
            cls._kind = re.sub(r"(?<!^)(?=[A-Z])", "-", cls.__name__).lower()
        if listed and cls.__module__.startswith(_ROOM):
            if init:
                dataclass(frozen=True, eq=eq, repr=cls.__repr__ is object.__repr__)(cls)
            fields.enter(cls, cls._made_by, cls._verify)

    def __post_init__(self) -> None:
        """Check the fields by their declarations, and then what else must hold."""
        if fields.RECORDS.get(type(self).__name__) is type(self):
            check(self)
        self._check()

    def _check(self) -> None:
        """Check what the declarations of the fields do not say."""

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), tuple(getattr(self, one.name) for one in fields_of(self))

    def _repr_html_(self) -> str:
        """The fields that are numbers, texts or vectors, and a drawing of the first over steps."""
        own, drawn = cast("Any", type(self)), ""
        facts: dict[str, Any] = {}
        for name in (*fields.declared(own), "covers", "assumption"):
            value, title = getattr(self, name, None), name.replace("_", " ")
            dims = rules(own).get(name, Rule()).dims
            if isinstance(value, (str, int, float)):
                facts[title] = value
            elif value is not None and dims and not dims[0].startswith("step"):
                facts[title] = show.vector(value) if value.ndim == 1 else None
            elif value is not None and not drawn and dims and dims[0].endswith("+1"):
                curves = value.reshape(len(value), -1)
                drawn = show.states(np.arange(len(curves)), curves, title)
        return show.card(self, facts.items(), drawn)

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
        return {"schema": SCHEMA, **fields.written("", self, Any, _put_lists)}

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
        return _restored(cls, data, _of_lists)


class Options(Record, listed=False):
    """Base of the records that users make to say what they want; shown as they would be typed."""

    __slots__ = ()

    def __repr__(self) -> str:
        given = []
        for one in fields_of(self):
            value = getattr(self, one.name)
            if type(value) is not type(one.default) or value != one.default:
                given.append(f"{one.name}={value!r}")
        return f"{type(self).__name__}({', '.join(given)})"


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
            short = re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", name)
            at = name if short else f"array.{len(sections)}"
            running.need("a state to be saved", array.nbytes)
            flat = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).reshape(-1)
            sections[at] = flat if array.dtype == np.float64 else flat.view(np.uint8)
            return {"type": "array", "name": at, **_about(array)}

        tree = {"schema": SCHEMA, **fields.written("", self, Any, put)}
        text = json.dumps(tree, allow_nan=False, separators=(",", ":")).encode()
        return {**sections, "record": np.frombuffer(text, dtype=np.uint8)}

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Self:
        def get(_: str, about: dict[str, Any], dtype: np.dtype[Any]) -> NDArray[Any] | None:
            flat = sections.pop(str(about.get("name")), None)
            stored = np.float64 if dtype == np.float64 else np.uint8
            if flat is None or flat.dtype != stored or flat.nbytes % dtype.itemsize:
                return None
            if dtype == np.bool_ and flat.max(initial=0) > 1:
                return None
            found: NDArray[Any] = flat.view(dtype.newbyteorder("<")).astype(dtype, copy=False)
            return found

        text = sections.pop("record")
        running.need("the text of a saved record", _PARSED * text.size)
        try:
            made = _restored(cls, json.loads(text.tobytes()), get)
        except (ValueError, RecursionError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"`record` must be JSON: {error}"[:200]) from None
        if sections:
            raise InputError(f"a file of this kind has no array '{min(sections)}'")
        return made


def trusted(kind: Callable[P, R], /, *args: P.args, **fields: P.kwargs) -> R:
    """``kind(*args, **fields)`` without its checks: the fields were just computed or checked."""
    made = object.__new__(cast("type[Any]", kind))
    made.__dict__["__post_init__"] = lambda: None  # called in place of that of the class
    made.__init__(*args, **fields)
    del made.__dict__["__post_init__"]
    return cast("R", made)


def require_shapes(record: Any, **wanted: tuple[int, ...]) -> None:
    """Refuse arrays among the fields of a record that have other shapes; None is no array."""
    for name, shape in wanted.items():
        found = getattr(record, name)
        if found is not None and np.shape(found) != shape:
            raise ShapeError(f"`{name}` must have shape {shape}, got {np.shape(found)}")


def _restored(cls: type[R], tree: Any, get: fields.Get) -> R:
    """A record from plain data, which may come from anywhere."""
    if not isinstance(tree, Mapping):
        raise InputTypeError(f"`data` must be a dict of to_dict(), got {validation.show(tree)}")
    for name, wanted in (("schema", SCHEMA), ("type", cls.__name__)):
        found = tree.get(name)
        if not isinstance(found, str) or found != wanted:
            raise InputError(f"`{name}` must be '{wanted}', got {validation.show(found)}")
    record = {name: value for name, value in tree.items() if name != "schema"}
    try:
        return cast("R", fields.restored("", record, cls, get))
    except RecursionError:
        raise InputError("`data` must not be nested so deeply") from None


def _about(array: NDArray[Any]) -> dict[str, Any]:
    return {"dtype": array.dtype.name, "shape": list(array.shape)}


def _put_lists(_: str, array: NDArray[Any], known: bool) -> Any:
    running.need("the numbers as lists", _IN_LIST * array.size)
    if known and array.size and array.ndim:
        return fields.listed(array)
    return {"type": "array", **_about(array), "values": fields.listed(array.reshape(-1))}


def _of_lists(name: str, about: dict[str, Any], dtype: np.dtype[Any]) -> NDArray[Any] | None:
    values = about.get("values")
    if isinstance(values, list) and values:
        return fields.of_list(name, values, dtype)
    return np.empty(0, dtype) if values == [] else None


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
