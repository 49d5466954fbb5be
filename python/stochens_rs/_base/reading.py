"""What the user passes as an array or a table: reading it, bringing it into order, showing it."""

from __future__ import annotations

import operator
import re
import sys
import unicodedata
import warnings
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any

import numpy as np

from ..exceptions import DataWarning, InputError, InputTypeError
from .types import NDArray

# Objects of the package that are passed for an array, and the array to pass in their place.
_ARRAYS = {
    "Counts": "an array here, got Counts: pass counts.estimate",
    "Ensemble": "an array here, got an Ensemble: pass ensemble.mean()",
    "Fit": "an array here, got a Fit: pass fit.estimate",
    "Plan": "an array, got a Plan: pass plan.u",
    "System": "an array, got a System: pass system.{}",
}
_TITLE = re.compile(r"^(.*\S)\s*[\[(]\s*(?![-+]?\d)[^\[\]()]+[\])]$")
# What has no labels.
_PLAIN = (np.ndarray, list, tuple, int, float)


def read(name: str, value: object) -> NDArray[Any]:
    """Return `np.asarray(value)`; refuse labels, masks and sparse matrices."""
    kind = type(value)
    if kind.__module__.startswith("stochens_rs.") and kind.__name__ in _ARRAYS:
        wanted = _ARRAYS[kind.__name__].format("A" if name == "A" else "B")
        raise InputTypeError(f"`{name}` must be {wanted}")
    if isinstance(value, np.ma.MaskedArray):
        raise InputTypeError(f"`{name}` is a masked array: fill it first, e.g. {name}.filled(0.0)")
    if kind.__module__.split(".")[:2] == ["scipy", "sparse"]:
        raise InputTypeError(f"`{name}` is a sparse matrix: pass {name}.toarray()")
    _refuse_labels(name, value)
    try:
        given = np.asarray(value)
    except MemoryError:
        raise
    except Exception as error:  # a ragged list, or anything a foreign `__array__` raises
        raise InputTypeError(
            f"`{name}` cannot be read as an array of numbers: {show(value)} (rows of unequal "
            "length, or not in main memory?)"
        ) from error
    level = [value]
    for _ in range(given.ndim - 1):  # labels inside a list
        level = [one for row in level if isinstance(row, (list, tuple)) for one in row]
        for one in level:
            _refuse_labels(name, one)
    return given


def _refuse_labels(name: str, value: Any) -> None:
    """Refuse a table or series with labels, unless they are 0, 1, 2, ... or dim_0, dim_1, ..."""
    if isinstance(value, _PLAIN):
        return
    axes, dims = _axes(value), getattr(value, "dims", None)
    if isinstance(dims, tuple) and len(dims) > 1 and not _counted(list(dims), "dim_"):
        axes = {"dims": list(dims), **axes}
    shown = "; ".join(f"{what}: {shown_labels(axis)}" for what, axis in axes.items() if axis)
    if shown:
        shown = shown if len(shown) <= 100 else shown[:96] + " ..."
        raise InputError(
            f"`{name}` has labels ({shown}), which would be ignored: bring all arguments into one "
            "order, A.loc[states, states].to_numpy(), x0[states].to_numpy() in pandas, or pass "
            f"{name}.to_numpy() if the order is right"
        )


def _axes(value: Any) -> dict[str, list[Any]]:
    """The labels along each axis of a table, [] for 0, 1, 2, ...; {} if it is no table.

    pandas, xarray, polars and pyarrow are recognised by their attributes; none is imported.
    """
    try:
        dims, coords = getattr(value, "dims", None), getattr(value, "coords", None)
        if dims is not None and coords is not None:
            axes = {str(d): list(np.asarray(coords[d])) if d in coords else [] for d in dims}
        else:
            found = [(what, getattr(value, what, None)) for what in ("index", "columns")]
            axes = {what: list(one) for what, one in found if one is not None and not callable(one)}
        # polars names columns by default column_0, column_1, ...
        return {d: [] if _counted(axis, "column_") else axis for d, axis in axes.items()}
    except Exception:  # whatever a foreign object raises: `np.asarray` says what is wrong with it
        return {}


def titled(name: Any, titles: Collection[Any]) -> Any:
    """The one of `titles` that is this name with a unit behind it; else the name.

    ``angle [rad]``, ``angle[rad]`` or ``angle (rad)``; but x[0] is a name.
    """
    if not isinstance(name, str) or name in titles:
        return name
    fits = [one for one in titles if isinstance(one, str) and _TITLE.sub(r"\1", one) == name]
    return fits[0] if len(fits) == 1 else name


def _counted(labels: list[Any], prefix: str) -> bool:
    """Whether labels are 0, 1, 2, ... as integers, or these after the prefix."""
    return all(
        (not isinstance(label, (float, np.floating)) and whole(label) == k)
        or label == f"{prefix}{k}"
        for k, label in enumerate(labels)
    )


def labels_along(value: Any) -> list[list[Any]]:
    """The labels along each axis of a table, [] for an axis without; [] if it is no table."""
    return [] if isinstance(value, _PLAIN) else list(_axes(value).values())


def aligned(name: str, value: Any, names: Sequence[str], *, square: bool = False) -> Any:
    """Bring the last axis of a table, or a dict of numbers, into the order of `names`.

    Both axes of a `square` table with two: the names of the rows are those of the columns where it
    has these alone. Anything without labels along its last axis goes through as it is; so does a
    table whose rows, in time, have no labels that increase, which `read` refuses.
    """
    if isinstance(value, Mapping) and all(np.ndim(one) == 0 for one in value.values()):
        return _placed(name, value, [list(value)], (names,))
    along = labels_along(value)
    if not along or not along[-1]:
        return value
    if square and np.ndim(value) == 2:
        return _placed(name, value, (along * 2)[:2], (names, names))
    found = _placed(name, value, along[-1:], (names,))
    if len(along) == 1:
        return found
    with suppress(Exception):  # labels that cannot be compared
        rises = all(bool(a < b) for a, b in pairwise(along[0]))
        if len(along) == 2 and rises and not any(isinstance(row, str) for row in along[0]):
            return found
    return value


# Dimensions of the matrices in xarray: which axis is which does not follow from labels alone.
DIMS = {"A": ("state_next", "state"), "B": ("state_next", "input")}


def matrices(
    A: Any, B: Any, states: Sequence[str] | None, inputs: Sequence[str] | None
) -> tuple[Any, Any, Sequence[str] | None, Sequence[str] | None]:
    """A and B, whose tables may have labels, in one order of the states; and the names.

    The order is that of `states` if they are given, else that of the rows of A. What has no labels
    goes through as it is, and so does what `read` has to refuse.
    """
    of_A, of_B = _table("A", A), _table("B", B)
    order = of_A[1][0] if states is None and of_A and of_B else states
    if order is None or not (of_A or of_B):
        return A, B, states, inputs
    if of_A is not None:
        A = _placed("A", *of_A, (order, order))
    if of_B is not None:
        inputs = of_B[1][1] if inputs is None else inputs
        B = _placed("B", *of_B, (order, inputs))
    return A, B, order, inputs


def _table(name: str, value: Any) -> tuple[NDArray[Any], list[list[str]]] | None:
    """The array and its names along rows and columns, if both have them."""
    dims = getattr(value, "dims", None)
    if isinstance(dims, tuple):
        if sorted(map(str, dims)) != sorted(DIMS[name]):
            return None
        value = value.transpose(*DIMS[name])
    along = labels_along(value)
    named = all(axis and all(isinstance(label, str) for label in axis) for axis in along)
    if len(along) != 2 or not named:
        return None
    return np.asarray(value), [list(map(str, axis)) for axis in along]


def _placed(
    name: str, value: Any, found: list[list[Any]], wanted: Sequence[Sequence[str]]
) -> NDArray[Any]:
    """The table in the order of the wanted names along its last axes; units may be left out."""
    values, plain = np.asarray(value), f"{name}.to_numpy()"
    if isinstance(value, Mapping):
        values, plain = np.array(list(value.values())), "numbers without names"
    for k, (labels, names) in enumerate(zip(found, wanted, strict=True)):
        has = [titled(str(label), names) for label in labels]
        if sorted(has) != sorted(names):
            odd = [one for one in has if one not in names or has.count(one) > 1]
            lack = next((repr(one) for one in names if one not in has), "")
            where = f" along its {('rows', 'columns')[k]}" if len(found) == 2 else ""
            raise InputError(
                f"`{name}` must have the labels {shown_labels(names)}{where}, each once, "
                f"{f'got {shown_labels(odd[:1])}' if odd else f'{lack:.40} is missing'}: rename "
                f"them, or pass {plain} if the order is right"
            )
        values = values.take([has.index(one) for one in names], axis=k - len(found))
    return values


def show(value: object) -> str:
    """Describe any object on one line of at most 60 characters, without raising."""
    kind = type(value).__name__[:24]
    if isinstance(value, int) and value.bit_length() > 100:
        return f"{'-' if value < 0 else ''}int of {value.bit_length()} bits"
    if isinstance(value, np.ndarray):
        return f"{kind} of shape {shown_shape(value)}"
    if value is None:
        return "None"
    if isinstance(value, (str, bytes)):
        return f"{kind} {value[:30]!r:.34}"
    if isinstance(value, (bool, int, float, np.generic)):
        return f"{kind} {value!s:.34}"
    return f"an object of type {kind}"


def shown_labels(labels: Sequence[Any]) -> str:
    """At most three labels as text."""
    some = (
        f"{str(label)[:30]!r:.34}" if isinstance(label, str) else show(label).partition(" ")[2]
        for label in labels[:3]
    )
    return f"{', '.join(some)}{', ...' if len(labels) > 3 else ''}"


def shown_shape(given: NDArray[Any]) -> str:
    """Return the shape as text."""
    return str(given.shape) if given.ndim <= 5 else f"{given.ndim} dimensions"


def number(text: str) -> float:
    """The number that a text is, as `float`; but 1_5, which is 15 in Python, is a ValueError."""
    if "_" in text:
        raise ValueError(f"{text!r} is not a number")
    return float(text)


def printable(text: str) -> str:
    """The text with ? for what is not printed as one line, such as what moves a cursor."""
    if text.isprintable():
        return text
    # other blanks of Unicode, such as the one that breaks no line, do no harm
    return "".join(c if c.isprintable() or unicodedata.category(c) == "Zs" else "?" for c in text)


def whole(value: object) -> int | None:
    """Return the whole number that `value` stands for, or None."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, (bool, np.bool_, np.timedelta64, np.ndarray)):
        return None
    if isinstance(value, (float, np.floating)):
        return int(value) if float(value).is_integer() else None
    try:
        return operator.index(value)  # type: ignore[arg-type]
    except Exception:  # not an integer, or anything a foreign `__index__` raises
        return None


def article(kind: type) -> str:
    """The name of a class with its article."""
    return f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"


def warn(text: str) -> None:
    """Warn of data at the line outside of this package that led here."""
    level, frame, package = 1, sys._getframe(), __name__.partition(".")[0]
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] == package:
        level, frame = level + 1, frame.f_back
    warnings.warn(DataWarning(text), stacklevel=level)
