"""Tables with the names of states and inputs, brought into the order of the system.

pandas and xarray are recognised by their attributes; none is imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from ..exceptions import InputError
from .reading import labels_along, shown_labels

if TYPE_CHECKING:
    from numpy.typing import NDArray

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
