"""All checks of arguments; other modules rely on them.

Each function takes the name of the argument first. Messages are one line of at most 300 characters:
the argument, what was expected, what was found. No input is modified. A returned array may be the
caller's own, so it must not be written to.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from itertools import islice, pairwise
from typing import Any, TypeGuard, TypeVar

import numpy as np

from ..exceptions import InputError, InputTypeError, NonFiniteError, ShapeError, SizeError
from .reading import aligned, printable, shown_labels, shown_shape, warn, whole
from .reading import article as article
from .reading import read as read
from .reading import show as show
from .types import EXACT as EXACT
from .types import Floats, NDArray

T = TypeVar("T")
W = TypeVar("W", bound=str)

_BOOLS = frozenset((bool, np.bool_))


def vector(
    name: str, value: object, *, length: int | None = None, labels: Sequence[str] | None = None
) -> Floats:
    """Return `value` as a C-contiguous float64 array of shape (length,), length >= 1.

    A table whose labels are `labels`, the names of its entries, is brought into their order.
    """
    return shaped(name, value, ("n" if length is None else length,), labels)


def measured(name: str, value: object, names: Sequence[str]) -> Floats:
    """Return what sensors say as a new float64 array, one number for each of `names`.

    Only type and shape are checked: nan, inf and what is too large are for the caller to judge. Of
    one sensor a number will do.
    """
    if type(value) is np.ndarray and value.dtype == np.float64 and value.shape == (len(names),):
        return value.copy()
    given = _numeric(name, value, names)
    if given.ndim == 0 and len(names) == 1:
        given = given.reshape(1)
    if given.shape != (len(names),):  # the text takes time
        _fit(name, value, given, (len(names),), f", one number for each of {shown_labels(names)}")
    if isinstance(value, (list, tuple)) and not _BOOLS.isdisjoint(map(type, value)):
        raise InputTypeError(f"`{name}` must contain integers or real floats, got a bool")
    with np.errstate(all="ignore"):  # a long double may overflow
        return given.astype(np.float64)


def broken(values: Floats, most: Floats | float, names: Sequence[str]) -> str | None:
    """Say why measured values cannot be true, nan, inf or above `most`; None if they can."""
    good = np.abs(values) <= most
    if good.all():
        return None
    wrong = (f"{names[i]} = {values[i]:.3g}" for i in np.flatnonzero(~good)[:3])
    return f"{', '.join(wrong)} cannot have been measured"


def matrix(
    name: str,
    value: object,
    *,
    rows: int | None = None,
    cols: int | None = None,
    square: bool = False,
    labels: Sequence[str] | None = None,
) -> Floats:
    """Return `value` as a C-contiguous float64 array of shape (rows, cols), both >= 1.

    `labels` of the columns as in `vector`.
    """
    height = "n" if rows is None else rows
    width = height if square else "m" if cols is None else cols
    return shaped(name, value, (height, width), labels)


def inputs(
    name: str,
    value: object,
    *,
    cols: int,
    rows: str = "K",
    empty: bool = True,
    labels: Sequence[str] | None = None,
) -> Floats:
    """Return vectors over time as C-contiguous float64 of shape (rows, cols), rows >= 0.

    `rows` is for messages; without `empty` there must be one at least; `labels` as in `matrix`.
    """
    given = read(name, value if labels is None else aligned(name, value, labels))
    _fit(name, value, given, (rows, cols), ", one row per step")
    return matrix(name, given, cols=cols) if len(given) or not empty else np.zeros((0, cols))


def starts(x0: object, N: int, n: int, names: Sequence[str] = ()) -> Floats:
    """Where the units begin, as (1, n) or (N, n); a series or table by the names of the states."""
    given = read("x0", aligned("x0", x0, names) if names else x0)
    if given.ndim == 2:
        return frozen(matrix("x0", given, rows=N, cols=n))
    return frozen(vector("x0", given, length=n)[None, :])


def array(name: str, value: object, *, ndim: tuple[int, ...], finite: bool = True) -> Floats:
    """Return `value` as a C-contiguous float64 array with one of the numbers of dimensions."""
    given = _numeric(name, value)
    if given.ndim not in ndim:
        wanted = " or ".join(map(str, ndim))
        raise ShapeError(f"`{name}` must have {wanted} dimensions, got {_found(value, given)}")
    return _finite(name, given) if finite else np.ascontiguousarray(given, dtype=np.float64)


def output(name: str, value: object, shape: tuple[int, ...], apart: dict[str, object]) -> Floats:
    """Return `value` if results of this shape can be written into it.

    It must be an ndarray of native float64, C-contiguous, aligned and writeable, and share no
    memory with the arrays of `apart`, whose keys are the names of their arguments.
    """
    array = _floats(name, value)
    _fit(name, value, array, shape)
    if not (array.flags.carray and array.flags.writeable):
        raise InputError(f"`{name}` must be C-contiguous, aligned and writeable, it is not")
    for other, one in apart.items():
        if isinstance(one, np.ndarray) and np.shares_memory(array, one):
            raise InputError(f"`{name}` must not share memory with `{other}`, it would change it")
    return array


def kept(
    name: str,
    value: object,
    *,
    ndim: tuple[int, ...] = (1, 2),
    shape: tuple[int, ...] | None = None,
) -> Floats:
    """Return `value` if it is an ndarray of finite float64, as the fields of records are."""
    given = _floats(name, value)
    if shape is not None:
        _fit(name, value, given, shape)
    array(name, given, ndim=ndim)
    return given


def _floats(name: str, value: object) -> Floats:
    if type(value) is not np.ndarray or value.dtype != np.float64:
        found = f" of {str(value.dtype)[:40]}" if isinstance(value, np.ndarray) else ""
        raise InputTypeError(f"`{name}` must be an ndarray of float64, got {show(value)}{found}")
    return value


def size(name: str, value: object, *, minimum: int = 1, maximum: int = EXACT) -> int:
    """Return a count as int: integers and whole floats such as 1e6, never bool or text."""
    count = whole(value)
    if count is None:
        raise InputTypeError(f"`{name}` must be a whole number, got {show(value)}")
    if not minimum <= count <= maximum:
        raise SizeError(f"`{name}` must be in [{minimum}, {maximum}], got {show(count)}")
    return count


def sizes(name: str, value: object, *, maximum: int) -> NDArray[np.int64]:
    """Return strictly increasing counts, 1 <= sizes[k] <= maximum, as an int64 array."""
    given = _numeric(name, value)
    _fit(name, value, given, ("k",))
    counts = [size(f"{name}[{k}]", one, maximum=maximum) for k, one in enumerate(given.tolist())]
    for k, (before, after) in enumerate(pairwise(counts), 1):
        if after <= before:
            raise InputError(f"`{name}[{k}]` is {after} after {before}: sizes must increase")
    return np.array(counts, dtype=np.int64)


def choice(name: str, value: object, allowed: tuple[W, ...]) -> W:
    """Return `value` if it is one of `allowed`; the message names the nearest one."""
    if isinstance(value, str) and value in allowed:
        return value
    listed = f"{'one of ' * (len(allowed) > 1)}{', '.join(repr(word) for word in allowed)}"
    if not isinstance(value, str):
        raise InputTypeError(f"`{name}` must be {listed}, got {show(value)}")
    raise InputError(f"`{name}` must be {listed}, got {show(value)}{nearest(value, allowed)}")


def subset(name: str, value: object, allowed: tuple[W, ...]) -> tuple[W, ...]:
    """Return the words of `value`, "A B" or several, each one of `allowed`, in its order."""
    words = value.split() if isinstance(value, str) else items(name, value)
    found = {choice(name, word, allowed) for word in words}
    return tuple(word for word in allowed if word in found)


def nearest(value: str, allowed: Iterable[str]) -> str:
    """The end of a message that asks whether one of `allowed` was meant; "" if none is near."""
    names = {name.lower(): name for name in islice(allowed, 1000)}
    near = difflib.get_close_matches(value[:40].lower(), names, n=1)
    return f"; did you mean {names[near[0]][:40]!r}?" if near else ""


def items(name: str, value: object, what: str = "a list") -> list[Any]:
    """Return the items of `value` as a list; text, sets and mappings are refused."""
    if not isinstance(value, (str, bytes, AbstractSet, Mapping)):
        try:
            return list(value)  # type: ignore[call-overload, no-any-return]
        except MemoryError:
            raise
        except Exception:  # not iterable, or its iterator raises
            pass
    raise InputTypeError(f"`{name}` must be {what}, got {show(value)}")


def flag(name: str, value: object) -> bool:
    """Return a bool; 0, 1 and text are refused."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputTypeError(f"`{name}` must be True or False, got {show(value)}")
    return bool(value)


def positive(name: str, value: object, *, maximum: float = math.inf) -> float:
    """Return a finite real number > 0 as float."""
    rule = "> 0" if maximum == math.inf else f"> 0 and at most {maximum:g}"
    return _real(name, value, rule, lambda number: 0.0 < number <= maximum)


def nonnegative(name: str, value: object) -> float:
    """Return a finite real number >= 0 as float."""
    return _real(name, value, ">= 0", lambda number: number >= 0.0)


def probability(name: str, value: object) -> float:
    """Return a real number in (0, 1) as float; a chance of error above one half is warned of."""
    number = _real(name, value, "in (0, 1)", lambda number: 0.0 < number < 1.0)
    if number > 0.5 and name in ("delta", "guarantee"):
        warn(
            f"`{name}` = {number:g} is the probability of an error: what follows holds with "
            f"{100.0 * (1.0 - number):.3g} % only; for {100.0 * number:.3g} % pass "
            f"{1.0 - number:.3g}"
        )
    return number


def _real(name: str, value: object, rule: str, fits: Callable[[float], bool]) -> float:
    if not is_real(value):
        raise InputTypeError(f"`{name}` must be a real number {rule}, got {show(value)}")
    try:
        number = float(value)
    except OverflowError:
        raise SizeError(f"`{name}` is too large for a float: {show(value)}") from None
    if not math.isfinite(number):
        raise NonFiniteError(f"`{name}` is {number}: it must be finite")
    if not fits(number):
        raise SizeError(f"`{name}` must be {rule}, got {show(value)}")
    return number + 0.0  # without the sign of -0


def deviations(name: str, value: Any, count: int) -> Floats:
    """Standard deviations (count,) from a number or one for each."""
    if is_real(value):
        return np.full(count, nonnegative(name, value))
    found = vector(name, value, length=count)
    if (found < 0.0).any():
        raise InputError(f"`{name}` must be standard deviations >= 0, got {found.min():.3g}")
    return found.copy()


def instance(name: str, value: object, kind: type[T]) -> T:
    """Return `value` if it is an instance of `kind`."""
    if not isinstance(value, kind):
        raise InputTypeError(f"`{name}` must be {article(kind)}, got {show(value)}")
    return value


def left_out(where: str, /, **arguments: object) -> None:
    """Refuse arguments that are not None where they make no sense."""
    for name in [one for one, value in arguments.items() if value is not None]:
        raise InputError(f"`{name}` must be left out {where}, got {show(arguments[name])}")


def same_sizes(name: str, found: tuple[int, ...], wanted: tuple[int, ...], like: str) -> None:
    """Refuse other numbers of states and inputs than those of what it goes with."""
    if found != wanted:
        (n, m), (states, inputs) = wanted, found
        raise ShapeError(f"`{name}` must have n={n} m={m} as {like}, got n={states} m={inputs}")


def same_dt(name: str, dt: object, wanted: object, like: str) -> None:
    """Refuse another time between two steps; one that is not stated goes with all."""
    if not (isinstance(dt, float) and isinstance(wanted, float)):
        return
    if not math.isclose(dt, wanted, rel_tol=1e-9):
        raise ShapeError(f"`{name}` must have dt={wanted:g} as {like}, got dt={dt:g}")


def text(name: str, value: object) -> str:
    """Return a string that can be encoded as UTF-8 (without lone surrogates)."""
    if not isinstance(value, str):
        raise InputTypeError(f"`{name}` must be a string, got {show(value)}")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise InputError(f"`{name}` must be valid UTF-8 text, got {show(value)}") from None
    return value


def line(name: str, value: object) -> str:
    """Return a string of one line, without control characters: it will be printed."""
    if printable(text(name, value)) != value:
        raise InputError(f"`{name}` must be one line without control characters, got {show(value)}")
    return str(value)


def is_real(value: object) -> TypeGuard[float]:
    """Whether `value` is a real number; not for bool and numpy.timedelta64."""
    numbers = (int, float, np.integer, np.floating)
    return isinstance(value, numbers) and not isinstance(value, (bool, np.timedelta64))


def frozen(checked: Floats) -> Floats:
    """Return a copy that cannot be made writeable, because its memory is a `bytes` object."""
    copied: Floats = np.frombuffer(checked.tobytes(), dtype=np.float64).reshape(checked.shape)
    return copied


def shaped(
    name: str, value: object, wanted: tuple[int | str, ...], labels: Sequence[str] | None = None
) -> Floats:
    """Return `value` as finite numbers of a shape, in which a letter stands for any length."""
    given = _numeric(name, value, labels)
    _fit(name, value, given, wanted)
    return _finite(name, given)


def _numeric(name: str, value: object, labels: Sequence[str] | None = None) -> NDArray[Any]:
    """Return `value` as an array of real numbers with at least one entry."""
    given = read(name, value if labels is None else aligned(name, value, labels))
    if given.dtype.kind not in "iuf":
        array = isinstance(value, (np.ndarray, np.generic)) or given.ndim > 0
        found = f"dtype {str(given.dtype)[:40]}" if array else show(value)
        cure = {"c": f"; pass {name}.real", "b": f"; pass {name}.astype(float)"}
        hint = cure.get(given.dtype.kind, "") if isinstance(value, np.ndarray) else ""
        raise InputTypeError(f"`{name}` must contain integers or real floats, got {found}{hint}")
    if given.ndim > 0 and given.size == 0:
        raise ShapeError(f"`{name}` must have at least one entry, got shape {shown_shape(given)}")
    return given


def _fit(
    name: str, value: object, given: NDArray[Any], wanted: tuple[int | str, ...], meaning: str = ""
) -> None:
    """Refuse another shape; a letter stands for any length, the same one everywhere."""
    if given.shape == wanted:
        return
    lengths = dict(zip(wanted, given.shape, strict=False))
    lengths |= {side: side for side in wanted if isinstance(side, int)}
    if given.shape != tuple(lengths.get(side) for side in wanted):
        shape = f"({', '.join(map(str, wanted))}{',' * (len(wanted) == 1)})"
        hint, last = "", wanted[-1]
        if len(wanted) == 1 and given.ndim == 2 and 1 in given.shape:
            hint = f"; use {name}.ravel()"
        elif len(wanted) == 2 and given.ndim == 1 and given.size and wanted[0] not in (last, 1):
            hint = f"; use {name}.reshape(-1, {last if isinstance(last, int) else 1})"
        found = _found(value, given)
        raise ShapeError(f"`{name}` must have shape {shape}{meaning}, got {found}{hint}")


def _found(value: object, given: NDArray[Any]) -> str:
    """The shape that was found, or the scalar."""
    scalar = given.ndim == 0 and not isinstance(value, np.ndarray)
    return show(value) if scalar else shown_shape(given)


def _finite(name: str, given: NDArray[Any]) -> Floats:
    """Return `given` as C-contiguous, aligned, native float64 without nan and inf."""
    with np.errstate(all="ignore"):  # a long double may overflow; the check below finds it
        floats: Floats = np.require(given, np.float64, ["C_CONTIGUOUS", "ALIGNED"])
    finite = np.isfinite(floats)
    if not finite.all():
        where = np.unravel_index(int(np.argmin(finite)), floats.shape)
        index = f"[{', '.join(str(int(i)) for i in where)}]" if where else ""
        rule = "entries must be finite" if where else "it must be finite"
        raise NonFiniteError(f"`{name}{index}` is {floats[where]}: {rule}")
    return floats
