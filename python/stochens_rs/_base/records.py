"""Records: pickled with their constructor, turned into plain data, and saved in state files."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, ClassVar, ParamSpec, TypeVar, cast

import numpy as np

from ..exceptions import InputError, InputTypeError, ShapeError
from . import fields as fields_of
from . import memory, serialize, validation
from .durable import Durable, nothing_left

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from typing_extensions import Self

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
            serialize.RECORDS[cls.__name__] = cls

    def __post_init__(self) -> None:
        """Check that the fields are of their declared types; a class checks what else must hold."""
        if serialize.RECORDS.get(type(self).__name__) is type(self):
            fields_of.check(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), tuple(getattr(self, one.name) for one in fields(self))  # type: ignore[arg-type]

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
        found: dict[str, Any] = serialize.written("", self, Any, _put_lists)
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
            memory.need("a state to be saved", array.nbytes)
            flat = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).reshape(-1)
            sections[at] = array.ravel() if dtype == "float64" else flat.view(np.uint8)
            return {"type": "array", "name": at, "dtype": dtype, "shape": list(array.shape)}

        tree = {"schema": SCHEMA, **serialize.written("", self, Any, put)}
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
            return serialize.shaped(name, array, about.get("shape"))

        text = sections.pop("record")
        if text.dtype != np.uint8:
            raise InputError(f"`record` must be of uint8, got {text.dtype.name}")
        memory.need("the text of a saved record", _PARSED * text.size)
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


def _restored(cls: type[Any], tree: dict[str, Any], get: serialize.Get) -> Any:
    schema = tree.pop("schema", None)
    if not isinstance(schema, str) or schema != SCHEMA:
        raise InputError(f"`schema` must be '{SCHEMA}', got {validation.show(schema)}")
    if not isinstance(tree.get("type"), str) or tree["type"] != cls.__name__:
        raise InputError(
            f"`type` must be '{cls.__name__}', got {validation.show(tree.get('type'))}"
        )
    return serialize.restored("", tree, cls, get)


def _put_lists(name: str, array: NDArray[Any], known: bool) -> Any:
    memory.need("the numbers as lists", _IN_LIST * array.size)
    if known and array.size and array.ndim:
        return serialize.listed(array)
    dtype = _checked_dtype(name, array.dtype.name)
    values = serialize.listed(array.reshape(-1))
    return {"type": "array", "dtype": dtype, "shape": list(array.shape), "values": values}


def _of_lists(name: str, about: dict[str, Any]) -> NDArray[Any]:
    dtype, values = np.dtype(_checked_dtype(name, about.get("dtype"))), about.get("values")
    if not isinstance(values, list):
        raise InputError(f"`{name}` must have a list of values, got {validation.show(values)}")
    flat = serialize.of_list(name, values, dtype) if values else np.empty(0, dtype)
    if flat.ndim != 1:
        raise InputError(f"`{name}` must have values in one list")
    return serialize.shaped(name, flat, about.get("shape"))


def _checked_dtype(name: str, dtype: object) -> str:
    if dtype not in serialize.DTYPES:
        raise InputTypeError(
            f"`{name}` must be an array of {serialize.DTYPES[0]} or another number "
            f"type, got {validation.show(dtype)}"
        )
    return str(dtype)


def _refused(text: str) -> None:
    raise InputError(f"`record` must have no {text}")
