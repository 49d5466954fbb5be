"""Records as plain data and as state files, in the format of `docs/saving.md`."""

from __future__ import annotations

import contextlib
import inspect
import math
import os
import types as kinds_of_types
import warnings
import weakref
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Literal,
    TypeAlias,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from .. import _core
from ..exceptions import (
    InputError,
    InputTypeError,
    StateError,
    StateRecoveredWarning,
    StochensError,
)
from . import running, types, validation
from .files import PathLike, checked_path
from .types import Floats
from .validation import show

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from typing_extensions import Self


if TYPE_CHECKING:
    Put: TypeAlias = Callable[[str, NDArray[Any], bool], Any]
    Get: TypeAlias = Callable[[str, dict[str, Any]], NDArray[Any]]

# All classes that can be read, by their names: `Record` enters those of this package.
RECORDS: dict[str, type[Any]] = {}
DTYPES = ("float64", "int64", "int8", "bool", "uint8", "uint16", "uint32", "uint64")
_DECLARED: dict[type[Any], dict[str, Any]] = {}
_NOT_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
_LONGEST = 2**63  # of whole numbers
_EMPTY = 2**20  # the largest side of an array without entries


def enter(record: type[Any], **arguments: Any) -> None:
    """List a class of the core, whose constructor takes arguments of these types."""
    RECORDS[record.__name__], _DECLARED[record] = record, arguments


def declared(record: type[Any]) -> dict[str, Any]:
    """The arguments of the constructor of a record, and their types."""
    if record not in _DECLARED:
        made_by = getattr(record, "_made_by", record)
        found = get_type_hints(made_by, localns={**vars(types), **RECORDS})
        names = inspect.signature(made_by).parameters
        _DECLARED[record] = {name: found[name] for name in names}
    return _DECLARED[record]


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
    if isinstance(value, np.ndarray):
        dtype = _dtype(kind)  # numpy takes None for float64
        return put(name, value, dtype is not None and dtype == value.dtype)
    if isinstance(value, tuple):
        inner = _items(kind, len(value))
        rows = [
            written(f"{name}.{k}", item, of, put)
            for k, (item, of) in enumerate(zip(value, inner or [Any] * len(value), strict=True))
        ]
        return {"type": "tuple", "items": rows} if inner is None else rows
    if isinstance(value, list):
        return [written(f"{name}.{k}", item, Any, put) for k, item in enumerate(value)]
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        of = _values(kind)
        found = {
            key: written(f"{name}.{k}", item, Any if of is None else of, put)
            for k, (key, item) in enumerate(value.items())
        }
        return {"type": "dict", "items": found} if of is None and "type" in value else found
    record = type(value)
    if RECORDS.get(record.__name__) is not record:
        raise InputTypeError(f"`{name}` cannot be saved: {validation.show(value)}")
    fields = declared(record)
    at = f"{name}." if name else ""
    parts = {
        field: written(f"{at}{field}", part, fields[field], put)
        for field, part in zip(fields, value.__reduce__()[1], strict=True)
    }
    if _short(record) and record in kinds(kind):
        return next(iter(parts.values()))
    return {"type": record.__name__, **parts}


def restored(name: str, value: Any, kind: Any, get: Get) -> Any:
    """Undo `written`; what is not of the declared type is refused."""
    options = kinds(kind)
    free = Any in options
    if value is None or isinstance(value, bool):
        if free or type(value) in options:
            return value
    elif isinstance(value, int):
        if abs(value) < _LONGEST and (free or int in options or float in options):
            return value
    elif isinstance(value, float):
        if math.isfinite(value) and (free or float in options):
            return value
    elif isinstance(value, str):
        return _of_text(name, value, kind, options)
    elif isinstance(value, list):
        dtype = _dtype(kind)
        if dtype is not None:
            return of_list(name, value, dtype)
        inner = _items(kind, len(value))
        if inner is not None:
            return tuple(
                restored(f"{name}[{k}]", item, of, get)
                for k, (item, of) in enumerate(zip(value, inner, strict=True))
            )
        if free:
            return [restored(f"{name}[{k}]", item, Any, get) for k, item in enumerate(value)]
    elif isinstance(value, dict):
        return _of_dict(name, value, kind, options, get)
    raise InputTypeError(f"`{name}` must be {_said(kind)}, got {validation.show(value)}")


def listed(array: NDArray[Any]) -> Any:
    """The entries as nested lists, ready for JSON: nan as None, infinite ones as "inf", "-inf"."""
    if array.dtype.kind != "f" or np.isfinite(array).all():
        return array.tolist()
    kept = array.astype(object)
    kept[np.isnan(array)] = None
    kept[np.isposinf(array)], kept[np.isneginf(array)] = "inf", "-inf"
    return kept.tolist()


def shaped(name: str, array: NDArray[Any], shape: Any) -> NDArray[Any]:
    """Return the array in this shape, which may come from anywhere."""
    good = isinstance(shape, list) and len(shape) <= 8
    good = good and all(type(side) is int and side >= 0 for side in shape)
    if not good or math.prod(shape) != array.size or (not array.size and max(shape) > _EMPTY):
        raise InputError(f"`{name}` must have {array.size} entries, got another shape")
    return array.reshape(shape)


def _of_text(name: str, value: str, kind: Any, options: tuple[Any, ...]) -> Any:
    if Any in options or str in options:
        return value
    allowed = words(kind)
    if value in allowed:
        return value
    if float in options and value in _NOT_FINITE:
        return _NOT_FINITE[value]
    short = [one for one in options if _short(one)]
    if short:
        return _made(name, short[0], dict.fromkeys(declared(short[0]), value), _no_arrays)
    if bytes in options:
        try:
            return bytes.fromhex(value)
        except ValueError:
            raise InputError(
                f"`{name}` must be hexadecimal, got {validation.show(value)}"
            ) from None
    if allowed:
        validation.choice(name, value, allowed)
    raise InputTypeError(f"`{name}` must be {_said(kind)}, got {validation.show(value)}")


def of_list(name: str, value: list[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Undo `listed`."""
    if dtype.kind == "f":
        value = _numbers(name, value)
    try:
        found = np.array(value)
        good = found.dtype.kind in ("iuf" if dtype.kind == "f" else dtype.kind.replace("u", "iu"))
        array = found.astype(dtype)
        good = good and (dtype.kind == "f" or bool((array == found).all()))
    except (ValueError, OverflowError):
        good = False
    if not good or not array.size:
        raise InputTypeError(f"`{name}` must be nested lists of {dtype.name} of equal lengths")
    return array


def _numbers(name: str, value: list[Any]) -> list[Any]:
    """Nested lists with numbers in the places of what `listed` writes for those not finite."""
    found: list[Any] = []
    for item in value:
        if isinstance(item, list):
            found.append(_numbers(name, item))
        elif item is None:
            found.append(math.nan)
        elif isinstance(item, str) and item in _NOT_FINITE:
            found.append(_NOT_FINITE[item])
        elif type(item) is float or (type(item) is int and abs(item) < _LONGEST):
            found.append(float(item))
        else:
            raise InputTypeError(f"`{name}` must be nested lists of numbers")
    return found


def _of_dict(
    name: str, value: dict[str, Any], kind: Any, options: tuple[Any, ...], get: Get
) -> Any:
    free, of = Any in options, _values(kind)
    if of is not None or (free and "type" not in value):
        inner = Any if of is None else of
        at = (f"{name}[{key!r:.40}]" for key in value)
        return {key: restored(next(at), item, inner, get) for key, item in value.items()}
    what = value["type"] if isinstance(value.get("type"), str) else None
    rest = {key: item for key, item in value.items() if key != "type"}
    if what == "array" and (free or any(get_origin(one) is np.ndarray for one in options)):
        array, wanted = get(name, rest), _dtype(kind)
        if wanted is not None and array.dtype != wanted:
            raise InputTypeError(f"`{name}` must be of {wanted.name}, got {array.dtype.name}")
        return array
    if free and what == "tuple" and isinstance(rest.get("items"), list):
        return tuple(restored(name, item, Any, get) for item in rest["items"])
    if free and what == "dict" and isinstance(rest.get("items"), dict):
        return {key: restored(name, item, Any, get) for key, item in rest["items"].items()}
    if free and what == "float" and rest.get("value") in tuple(_NOT_FINITE):
        return _NOT_FINITE[rest["value"]]
    record = RECORDS.get(what or "")
    bases = tuple(one for one in options if isinstance(one, type) and get_origin(one) is None)
    if record is None or not (free or issubclass(record, bases)):
        shown = validation.show(value.get("type", value))
        raise InputTypeError(f"`{name}` must be {_said(kind)}, got {shown}")
    return _made(name, record, rest, get)


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
        made = getattr(record, "_made_by", record)(**given)
        if hasattr(made, "_verify"):
            made._verify()
    except (StochensError, MemoryError):
        raise
    except Exception as error:  # whatever fields that do not go together lead to
        where, text = f"`{name}`" if name else "the data", " ".join(str(error).split())
        raise InputError(f"{where} cannot be {validation.article(record)}: {text:.200}") from error
    return made


def _no_arrays(name: str, _: dict[str, Any]) -> NDArray[Any]:
    raise InputTypeError(f"`{name}` must not be an array")


def kinds(kind: Any) -> tuple[Any, ...]:
    """The types of a union; of another type this type alone."""
    union = get_origin(kind) in (Union, kinds_of_types.UnionType)
    return get_args(kind) if union else (kind,)


def words(kind: Any) -> tuple[Any, ...]:
    """The words among which a declared type has its values; none if there are none."""
    return tuple(w for one in kinds(kind) if get_origin(one) is Literal for w in get_args(one))


def _dtype(kind: Any) -> np.dtype[Any] | None:
    """The dtype of a declared array; None if there is no array, or one of any dtype."""
    for one in kinds(kind):
        if get_origin(one) is np.ndarray:
            scalar = get_args(get_args(one)[1])[0]
            return None if scalar is Any else np.dtype(scalar)
    return None


def _items(kind: Any, count: int) -> list[Any] | None:
    """The types of the items of a declared tuple with this many; None if there is none."""
    for one in kinds(kind):
        if get_origin(one) is tuple:
            inner = get_args(one)
            if inner[-1] is Ellipsis:
                return [inner[0]] * count
            if len(inner) == count:
                return list(inner)
    return None


def _values(kind: Any) -> Any:
    """The type of the values of a declared dict; None if there is none."""
    found = [get_args(one)[1] for one in kinds(kind) if get_origin(one) is dict]
    return found[0] if found else None


def _short(kind: Any) -> bool:
    """Whether a class is a record with one field of bytes, as `Key`."""
    listed = isinstance(kind, type) and RECORDS.get(kind.__name__) is kind
    return listed and list(declared(kind).values()) == [bytes]


def _said(kind: Any) -> str:
    """A declared type in words."""
    names = []
    for one in kinds(kind):
        if get_origin(one) is Literal:
            names += [repr(word) for word in get_args(one)]
        elif get_origin(one) is np.ndarray:
            names.append("nested lists")
        else:
            names.append("None" if one is type(None) else getattr(one, "__name__", str(one)))
    return " or ".join(names)


if TYPE_CHECKING:
    Section: TypeAlias = NDArray[np.uint8] | NDArray[np.uint64] | Floats


# Endings of tables, text and figures, which a state file is not.
_FOREIGN = (".csv", ".json", ".nc", ".parquet", ".pdf", ".png", ".tex", ".txt", ".xlsx")
_ELEMENTS = (np.dtype(np.uint8), np.dtype(np.uint64), np.dtype(np.float64))


def is_state(path: PathLike) -> bool:
    """Whether a file begins as one that `save` wrote: the length of a JSON header, and its "{"."""
    found = Path(checked_path("path", path))
    if not found.is_file():  # a pipe may block
        return False
    with found.open("rb") as file:
        begin = file.read(9)
    length = int.from_bytes(begin[:8], "little")
    return begin[8:] == b"{" and length + 8 <= found.stat().st_size


def save(
    path: PathLike,
    kind: str,
    sections: Mapping[str, NDArray[Any]],
    held: _core.StateLock | None = None,
) -> int:
    """Save one-dimensional uint8, uint64 or float64 arrays as the next generation at `path`.

    They are on the disk when this returns; after an exception, the previous generation can be
    loaded. No other thread may change the arrays meanwhile. `held` is the lock on `path`, if the
    caller has it. Returns the generation, from 1. Raises `StateError` if the file at `path` is not
    a state of this `kind`, `StateLockedError` if it is being written, `StateIOError` if writing
    fails.
    """
    checked = checked_path("path", path)
    if checked.lower().endswith(_FOREIGN):
        raise InputError(
            f"`path` must not end in {Path(checked).suffix}: `save` writes a file for `load`; "
            "`to_pandas`, `to_xarray` and `to_dict` give tables and plain data"
        )
    arrays = [(name, _section(name, array)) for name, array in sections.items()]
    running.need("a state to be saved", sum(array.nbytes for _, array in arrays))
    return _core.storage_save(checked, kind, arrays, held)


def load(path: PathLike, kind: str) -> tuple[int, dict[str, Section]]:
    """Return the generation and the arrays of the state of this `kind` at `path`.

    Nothing is written. If the file is missing or damaged, the previous generation is returned with
    a `StateRecoveredWarning`. Raises `StateError` if neither can be used, `StateNotFoundError` if
    neither exists, `StateIOError` if reading fails.
    """
    checked = checked_path("path", path)
    with contextlib.suppress(OSError):  # the core reports a bad path
        running.need("a state to be loaded", 2 * os.stat(checked).st_size)  # file and arrays
    generation, sections, recovered = _core.storage_load(checked, kind)
    if recovered is not None:
        warnings.warn(
            f"{recovered}: generation {generation} was loaded instead",
            StateRecoveredWarning,
            stacklevel=3,
        )
    return generation, sections


def encode(kind: str, generation: int, sections: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the bytes of a state file with these arrays (see `save`)."""
    arrays = [(name, _section(name, array)) for name, array in sections.items()]
    running.need("a state to be saved", sum(array.nbytes for _, array in arrays))
    return _core.storage_encode(kind, generation, arrays)


def decode(source: str, content: bytes, kind: str) -> tuple[int, dict[str, Section]]:
    """Return the generation and the arrays in the bytes of a state file (see `load`)."""
    return _core.storage_decode(source, content, kind)


_held: weakref.WeakSet[_core.StateLock] = weakref.WeakSet()


def lock(path: str) -> _core.StateLock:
    """Lock a path for writing, until `release`; raises `StateLockedError` if it is locked."""
    made = _core.StateLock(path)
    _held.add(made)
    return made


def _let_go() -> None:
    """Release the locks in a forked child: its copies would outlive those of the parent."""
    for one in list(_held):
        one.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)


def _section(name: str, array: NDArray[Any]) -> NDArray[Any]:
    if not isinstance(array, np.ndarray) or array.dtype not in _ELEMENTS or array.ndim != 1:
        raise InputTypeError(
            f"`sections[{name!r:.20}]` must be a one-dimensional array of uint8, uint64 or "
            f"float64, got {show(array)}"
        )
    return np.ascontiguousarray(array)


class Durable:
    """Base of the classes that can be saved as named arrays and loaded again."""

    __slots__ = ()

    _kind: ClassVar[str]

    def _to_sections(self) -> dict[str, Any]:
        raise NotImplementedError

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Self:
        raise NotImplementedError

    def save(self, path: PathLike) -> int:
        """Save to a file.

        Parameters
        ----------
        path : path
            The file; the previous state is kept as ``<path>.prev``.

        Returns
        -------
        int
            The generation: 1 for the first state at this path, then one more each time. The state
            is on the disk when this returns.

        Raises
        ------
        StateError
            If the file at `path` is something else than an earlier state of this kind.
        StateLockedError
            If another thread or process is saving there, or a run has it as its checkpoint.
        StateIOError
            If writing fails, for example for lack of space or permission. The previous states are
            not changed.
        InputError, InputTypeError
            If `path` is not a path.

        Notes
        -----
        The format is safetensors, with a version and a SHA-256 digest; loading executes nothing
        (``docs/saving.md``). The file is written under another name, synced and renamed, and
        the directory is synced: a complete state is on the disk at any time.

        Examples
        --------
        >>> import tempfile, pathlib, stochens_rs as se
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "a.state"
        >>> stream = se.Stream(([[2.0]], [[1.0]]), [1.0], [0.0], rng=1)
        >>> stream.step(1000)
        >>> stream.save(path)
        1
        >>> se.Stream.load(path).steps
        1000
        """
        return save(path, self._kind, self._to_sections())

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Load what was saved.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        Self
            With the same bits in every field; a stream continues exactly as it.

        Raises
        ------
        StateError
            If neither the file nor the previous generation can be used: damaged, of another kind,
            of a newer version, or with contents that cannot be.
        StateNotFoundError
            If neither exists.
        StateIOError
            If reading fails.
        InputError, InputTypeError
            If `path` is not a path.

        Warns
        -----
        StateRecoveredWarning
            If the file is missing or damaged and the previous generation was loaded.

        Notes
        -----
        Nothing is written. Checked are the sizes (before memory is allocated), the digest, and the
        numbers: finite; of a stream, estimates in the hull of the realizations, and the key and the
        problem those of the digest; of a model, the triangle that of the data, and all that
        `identify` checks; of other results, the types of their fields and all that their
        constructors check.

        Examples
        --------
        See `save`.
        """
        _, sections = load(path, cls._kind)
        try:
            return cls._from_sections(sections)
        except KeyError as error:
            raise StateError(f"{os.fspath(path)} must have an array {error}, got none") from error
        except (InputError, InputTypeError) as error:
            raise StateError(f"{os.fspath(path)}: {error}") from error


def nothing_left(sections: dict[str, Any]) -> None:
    """Refuse arrays that nothing has taken."""
    if sections:
        raise InputError(f"a file of this kind has no array '{min(sections)}'")
