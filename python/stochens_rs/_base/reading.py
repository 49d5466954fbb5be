"""What the user passes as an array or a table: reading it, bringing it into order, showing it."""

from __future__ import annotations

import operator
import unicodedata
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..exceptions import InputError, InputTypeError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


# Objects of the package that are passed for an array, and the array to pass in their place.
_ARRAYS = {
    "Counts": "an array here, got Counts: pass counts.estimate",
    "Ensemble": "an array here, got an Ensemble: pass ensemble.mean()",
    "Fit": "an array here, got a Fit: pass fit.estimate",
    "Plan": "an array, got a Plan: pass plan.u",
    "System": "an array, got a System: pass system.{}",
}


def read(name: str, value: object) -> NDArray[Any]:
    """Return `np.asarray(value)`; refuse labels, masks and sparse matrices."""
    if not isinstance(value, (np.ndarray, list, tuple)):
        _refuse_records(name, value)
        _refuse_labels(name, value)
    if isinstance(value, np.ma.MaskedArray):
        raise InputTypeError(f"`{name}` is a masked array: fill it first, e.g. {name}.filled(0.0)")
    if type(value).__module__.split(".")[:2] == ["scipy", "sparse"]:
        raise InputTypeError(f"`{name}` is a sparse matrix: pass {name}.toarray()")
    try:
        given = np.asarray(value)
    except MemoryError:
        raise
    except Exception as error:  # a ragged list, or anything a foreign `__array__` raises
        raise InputTypeError(
            f"`{name}` cannot be read as an array of numbers: {show(value)} (rows of unequal "
            "length, or not in main memory?)"
        ) from error
    _refuse_inner_labels(name, value, given.ndim)
    return given


def _refuse_records(name: str, value: object) -> None:
    """Refuse an object of the package, recognised by its name: no module above is imported."""
    kind = type(value)
    if kind.__module__.startswith("stochens_rs.") and kind.__name__ in _ARRAYS:
        wanted = _ARRAYS[kind.__name__].format("A" if name == "A" else "B")
        raise InputTypeError(f"`{name}` must be {wanted}")


def _refuse_inner_labels(name: str, value: object, ndim: int) -> None:
    """Refuse labels inside a list of `ndim` dimensions."""
    if ndim > 1 and isinstance(value, (list, tuple)):
        for item in value:
            if isinstance(item, (list, tuple)):
                _refuse_inner_labels(name, item, ndim - 1)
            elif not isinstance(item, np.ndarray):
                _refuse_labels(name, item)


def _refuse_labels(name: str, value: object) -> None:
    """Refuse a table or series with labels, unless they are 0, 1, 2, ... or dim_0, dim_1, ...

    pandas, xarray, polars and pyarrow are recognised by their attributes; none is imported.
    """
    try:
        labels = list(_labels(value))
    except Exception:  # `np.asarray` says what is wrong with it
        return
    shown = "; ".join(
        f"{what}: {', '.join(show(label).partition(' ')[2] or '?' for label in found[:3])}"
        f"{', ...' if len(found) > 3 else ''}"
        for what, found in labels
    )
    if shown:
        shown = shown if len(shown) <= 100 else shown[:96] + " ..."
        raise InputError(
            f"`{name}` has labels ({shown}), which would be ignored: bring all arguments into one "
            "order, A.loc[states, states].to_numpy(), x0[states].to_numpy() in pandas, or pass "
            f"{name}.to_numpy() if the order is right"
        )


def _labels(value: Any) -> Iterator[tuple[str, list[Any]]]:
    """The labels along every axis that has any."""
    for what in ("index", "columns", "column_names"):
        found = getattr(value, what, None)
        if found is not None and not callable(found):
            labels = list(found)
            if not _counted(labels, "column_"):  # polars names columns so by default
                yield what, labels
    dims, coords = getattr(value, "dims", None), getattr(value, "coords", None)
    if dims is not None and coords is not None:
        if len(dims) > 1 and not _counted(list(dims), "dim_"):
            yield "dims", list(dims)
        for dim in dims:
            labels = list(np.asarray(coords[dim])) if dim in coords else []
            if not _counted(labels):
                yield str(dim), labels


def labels_along(value: Any) -> list[list[Any]]:
    """The labels along each axis of a table, [] for an axis without; [] if it is no table."""
    try:
        dims, coords = getattr(value, "dims", None), getattr(value, "coords", None)
        if dims is not None and coords is not None:
            found = [list(np.asarray(coords[dim])) if dim in coords else [] for dim in dims]
        else:
            axes = (getattr(value, what, None) for what in ("index", "columns"))
            found = [list(axis) for axis in axes if axis is not None and not callable(axis)]
        return [[] if _counted(labels) else labels for labels in found]
    except Exception:  # whatever a foreign object raises: `read` looks at it again
        return []


def shown_labels(labels: Sequence[Any]) -> str:
    """At most three labels as text."""
    plain = [str(label) if isinstance(label, str) else label for label in labels[:3]]
    some = ", ".join(f"{label!r:.24}" for label in plain)
    return f"{some}{', ...' if len(labels) > 3 else ''}"


def origin(value: object, given: NDArray[Any]) -> str:
    """The kind of numbers that was found."""
    if given.ndim == 0 and not isinstance(value, (np.ndarray, np.generic)):
        return show(value)
    return f"dtype {str(given.dtype)[:40]}"


def found_shape(value: object, given: NDArray[Any]) -> str:
    """The shape that was found, or the scalar."""
    if given.ndim == 0 and not isinstance(value, np.ndarray):
        return show(value)
    return shown_shape(given)


def _counted(labels: list[Any], prefix: str | None = None) -> bool:
    """Whether labels are 0, 1, 2, ... as integers, or these after the prefix."""
    return all(
        (not isinstance(label, (float, np.floating)) and whole(label) == k)
        or (prefix is not None and label == f"{prefix}{k}")
        for k, label in enumerate(labels)
    )


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


def shown_shape(given: NDArray[Any]) -> str:
    """Return the shape as text."""
    return str(given.shape) if given.ndim <= 5 else f"{given.ndim} dimensions"


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


# Dimensions of the matrices in xarray: which axis is which does not follow from labels alone.
DIMS = {"A": ("state_next", "state"), "B": ("state_next", "input")}


def aligned(name: str, value: Any, names: Sequence[str]) -> Any:
    """Bring the last axis of a table with labels into the order of `names`.

    Anything without labels there goes through as it is; so do labels that are not names of a system
    whose states or inputs are only numbered, which `read` refuses. Rows of a table in time must
    have labels that increase.
    """
    if isinstance(value, (np.ndarray, list, tuple, int, float)):
        return value
    along = labels_along(value)
    if not along or not along[-1]:
        return value
    order = _order(along[-1], names)
    if order is None:
        if all(name in (f"x[{k}]", f"u[{k}]") for k, name in enumerate(names)):
            return value
        raise InputError(
            f"`{name}` has the labels {shown_labels(along[-1])}, expected the names "
            f"{shown_labels(names)}: bring it into the order of these and pass {name}.to_numpy()"
        )
    if len(along) > 2 or (len(along) == 2 and not _increasing(along[0])):
        return value
    return np.asarray(value)[..., order]


def aligned_weight(name: str, value: Any, names: Sequence[str]) -> Any:
    """The same for a diagonal, or for a square table with the same names along rows and columns."""
    if isinstance(value, (np.ndarray, list, tuple, int, float)):
        return value
    along = labels_along(value)
    if not along or not along[-1] or np.ndim(value) != 2:
        return aligned(name, value, names)
    rows, cols = (along * 2)[:2]  # names along columns alone: those of the rows are the same
    return _placed(name, (np.asarray(value), rows, cols), names, names)


def matrices(
    A: Any, B: Any, states: Sequence[str] | None, inputs: Sequence[str] | None
) -> tuple[Any, Any, Sequence[str] | None, Sequence[str] | None]:
    """A and B, whose tables may have labels, in one order of the states; and the names.

    The order is that of `states` if they are given, else that of the rows of A. What has no labels
    goes through as it is, and so does what `read` has to refuse.
    """
    of_A, of_B = _table("A", A), _table("B", B)
    if of_A is None and of_B is None:
        return A, B, states, inputs
    order = states
    if order is None and of_A is not None and of_B is not None:
        order = of_A[1]
    if order is None:
        return A, B, states, inputs
    if of_A is not None:
        A = _placed("A", of_A, order, order)
    if of_B is not None:
        inputs = of_B[2] if inputs is None else inputs
        B = _placed("B", of_B, order, inputs)
    return A, B, order, inputs


def _table(name: str, value: Any) -> tuple[NDArray[Any], list[str], list[str]] | None:
    """The array and its names along rows and columns, if both have them."""
    if isinstance(value, (np.ndarray, list, tuple)):
        return None
    dims = getattr(value, "dims", None)
    if isinstance(dims, tuple):
        if sorted(map(str, dims)) != sorted(DIMS[name]):
            return None
        value = value.transpose(*DIMS[name])
    along = labels_along(value)
    if len(along) != 2 or not all(
        found and all(isinstance(label, str) for label in found) for found in along
    ):
        return None
    return np.asarray(value), *([str(label) for label in found] for found in along)  # type: ignore[return-value]


def _placed(
    name: str,
    table: tuple[NDArray[Any], list[str], list[str]],
    rows: Sequence[str],
    cols: Sequence[str],
) -> NDArray[Any]:
    values, of_rows, of_cols = table
    places = []
    for what, found, wanted in (("rows", of_rows, rows), ("columns", of_cols, cols)):
        order = _order(found, wanted)
        if order is None:
            odd = next((label for label in found if label not in wanted), None)
            odd = next((label for label in found if found.count(label) > 1), odd)
            lacks = next((label for label in wanted if label not in found), None)
            said = f"{lacks!r:.40} is missing" if odd is None else f"got {odd!r:.40}"
            raise InputError(
                f"`{name}` must have the labels {shown_labels(wanted)} along its {what}, each "
                f"once, {said}"
            )
        places.append(order)
    return values[np.ix_(*places)]


def _order(found: Sequence[Any], wanted: Sequence[str]) -> list[int] | None:
    """Where each of the wanted labels is, if the labels are these, each once."""
    if len(found) != len(wanted) or not all(isinstance(label, str) for label in found):
        return None
    place = {str(label): k for k, label in enumerate(found)}
    if len(place) < len(found) or any(name not in place for name in wanted):
        return None
    return [place[name] for name in wanted]


def _increasing(labels: Sequence[Any]) -> bool:
    """Whether labels of rows, times or steps, are in order; also if there are none."""
    try:
        rises = all(bool(a < b) for a, b in pairwise(labels))
        return rises and not any(isinstance(label, str) for label in labels)
    except Exception:  # labels that cannot be compared
        return False
