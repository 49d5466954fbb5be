"""Types and choices that several parts of the package share, each under one name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike as ArrayLike
from numpy.typing import NDArray as NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
    from matplotlib.figure import SubFigure as SubFigure
    from typing_extensions import Self as Self
else:  # neither package is needed to run
    Axes = Figure = SubFigure = Self = Any

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
    "undecided",  # a limit of a state is broken, and whether all can be kept is not known
    "infeasible",  # limits that cannot be kept are missed by as little as possible
]
STATUSES: tuple[Status, ...] = get_args(Status)


def worst(statuses: Iterable[Status]) -> Status:
    """Return the status that comes last in `STATUSES`."""
    return max(statuses, key=STATUSES.index)
