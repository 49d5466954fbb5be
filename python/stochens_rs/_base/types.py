"""Types, choices and numbers that several parts share, and arithmetic without overflow."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike as ArrayLike
from numpy.typing import NDArray as NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
    from matplotlib.figure import SubFigure as SubFigure
    from typing_extensions import Self as Self
    from typing_extensions import dataclass_transform as dataclass_transform
else:  # neither package is needed to run
    Axes = Figure = SubFigure = Self = Any

    def dataclass_transform(**_):
        return lambda kind: kind


Floats: TypeAlias = NDArray[np.float64]
Axis: TypeAlias = Literal["columns", "rows"]
Scheme: TypeAlias = Literal["iid", "systematic"]
Centre: TypeAlias = Literal["truth", "estimate"]
Quantity: TypeAlias = Literal["state", "control"]
Fusion: TypeAlias = Literal["product", "diagonal"]
Averaging: TypeAlias = Literal["runs", "mean-field"]
Places: TypeAlias = str | int | Sequence[str | int] | None  # by name or number; None: all

AXES: tuple[Axis, ...] = get_args(Axis)
SCHEMES: tuple[Scheme, ...] = get_args(Scheme)
CENTRES: tuple[Centre, ...] = get_args(Centre)
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
FUSIONS: tuple[Fusion, ...] = get_args(Fusion)
AVERAGINGS: tuple[Averaging, ...] = get_args(Averaging)

EXACT = 2**53  # up to here a float holds every whole number
DELTA = 0.05  # probability of failure of a bound, if none is given

# How a computation ended, from best to worst. Wrong input raises an exception instead.
Status: TypeAlias = Literal[
    "completed",  # there was nothing to optimise
    "optimal",  # the gap is within the tolerance
    "converged",  # the stopping rule is satisfied
    # The others return the best result so far:
    "optimal_inaccurate",  # the gap is above the tolerance, and no solver got further
    "max_steps",  # the limit on the number of steps was reached
    "time_limit",  # the limit on the time of a run was reached
    "user_limit",  # the limit on the time or the passes of a solver was reached
    "interrupted",  # Ctrl-C
    "kept",  # an earlier plan goes on, corrected by its feedback
    "held",  # the next input of an earlier plan
    "unproved",  # a promise has ended, or the certificate is of other systems
    "undecided",  # a limit of a state is broken, and whether all can be kept is not known
    "infeasible",  # limits that cannot be kept are missed by as little as possible
]
STATUSES: tuple[Status, ...] = get_args(Status)


def worst(statuses: Iterable[Status]) -> Status:
    """Return the status that comes last in `STATUSES`."""
    return max(statuses, key=STATUSES.index)


# Relative differences up to 4 500 eps are rounding: sums of n terms in pairs lose log2(n) eps
# (Higham, Accuracy and Stability of Numerical Algorithms (2002), 4.2), sampling errors are larger.
ROUNDING = 1e-12


def norm(values: Floats) -> float:
    """Return the 2-norm of all entries, scaled so that no square overflows or underflows."""
    largest = float(np.abs(values).max())
    if largest == np.inf:  # and not inf / inf
        return largest
    return largest and largest * float(np.linalg.norm((values / largest).ravel()))


def shared(a: Floats, b: Floats) -> int:
    """How many different rows of `b` are rows of `a`, but for rounding of the largest entries.

    Rows are sorted by one combination of their entries, and compared where it is the same.
    """
    a, b = np.unique(a, axis=0), np.unique(b, axis=0)
    size = np.maximum(np.abs(a).max(axis=0), np.abs(b).max(axis=0))
    size[size == 0.0] = 1.0
    a, b = a / size, b / size
    along = 1.0 + np.arange(len(size)) * 0.6180339887498949 % 1.0
    order = np.argsort(a @ along)
    a, near = a[order], ROUNDING * along.sum()
    first = np.searchsorted(a @ along, b @ along - near, "left")
    last = np.searchsorted(a @ along, b @ along + near, "right")
    return sum(
        bool((np.abs(a[first[i] : last[i]] - b[i]) <= ROUNDING).all(axis=1).any())
        for i in np.flatnonzero(last > first)
    )


def most_changing(curves: Floats, most: int) -> list[int]:
    """The places of the columns that change most, at most so many, in their order."""
    with np.errstate(over="ignore", invalid="ignore"):
        order = np.argsort(-np.ptp(curves, axis=0), kind="stable")
    return sorted(order[:most].tolist())


def smallest_size(enough: Callable[[int], bool]) -> int | None:
    """The smallest size in 1 .. 2^53 that is enough, as all larger ones must be; None: none is."""
    sizes = range(1, EXACT + 1)
    at = bisect_left(sizes, True, key=enough)
    return sizes[at] if at < len(sizes) else None
