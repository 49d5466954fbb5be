"""Which region a model has: the assumptions on one side, what is asked for on the other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np

from .. import _core
from .._base import validation
from .._base.threads import get_num_threads
from ..exceptions import InputError, ShapeError
from .assumptions import Assumptions

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from .._base.types import Floats

Method: TypeAlias = Literal["auto", "mixture", "universal"]
METHODS: tuple[Method, ...] = ("auto", "mixture", "universal")


class Wish(NamedTuple):
    """What is asked of a region; `Model.region` says what each means."""

    delta: float
    components: bool = False
    directions: Floats | None = None
    future: int = 0
    frobenius: bool = False
    method: Method = "auto"
    anytime: bool = False


def region_of(
    estimate: _core.Estimate, noise: Assumptions, wish: Wish, units: Floats | _core.Estimate
) -> _core.Region:
    """The region of the core; `units`: a scale, or the estimate of the first pairs."""
    known = None if noise.known is None else np.ascontiguousarray(noise.known)
    law = noise.design, noise.noise, noise.covariance, known
    if isinstance(units, np.ndarray):
        units = np.ascontiguousarray(units)
    return estimate.region(law, units, *wish, get_num_threads(), noise.tail)


def directions(
    d: int, n: int, m: int, x0: ArrayLike | None, given: ArrayLike | None
) -> Floats | None:
    """The columns that span all z asked for: given, or those of one x0 and every u."""
    if x0 is None and given is None:
        return None
    if x0 is None:
        Q = validation.matrix("directions", given)
        if len(Q) != d:
            raise ShapeError(
                f"`directions` must have {d} rows, (x, u{', 1' if d > n + m else ''}), got {len(Q)}"
            )
    else:
        if given is not None:
            raise InputError("`x0` and `directions` must not be given both")
        start = validation.vector("x0", x0, length=n)
        largest = max(1.0, float(np.abs(start).max()))
        fixed = np.concatenate([start / largest, np.zeros(m), np.ones(d - n - m) / largest])
        Q = np.column_stack([fixed, np.eye(d)[:, n : n + m]])
    if not Q.any():
        raise InputError("`directions` must have an entry other than 0")
    sizes = np.abs(Q).max(axis=0)
    return Q / np.where(sizes == 0.0, 1.0, sizes)


def refuse(noise: Assumptions, wish: Wish, by_rows: bool) -> None:
    """Refuse a region that the assumptions do not have."""
    plain = noise.design == "independent" and noise.noise == "gaussian"
    for name, asked in (
        ("directions", wish.directions is not None),
        ("future", wish.future > 0),
    ):
        if asked and (not plain or by_rows or wish.components):
            raise InputError(
                f"`{name}` needs a region of all rows at once for design='independent', "
                "noise='gaussian', without `components`"
            )
    one_level = plain or noise.known is not None
    if one_level and (wish.method != "auto" or (wish.anytime and noise.design == "independent")):
        raise InputError(
            "`method` and `anytime` are for Gaussian noise of unknown covariance with "
            "design='adaptive'"
        )
    if wish.frobenius and (by_rows or wish.components or wish.directions is not None):
        raise InputError("`frobenius` needs one region for all rows and directions")


def said(noise: Assumptions, wish: Wish | None, first: int = 0) -> str:
    """The assumptions in words; the `first` pairs tell the scale."""
    text = noise.text
    if noise.noise == "gaussian" and noise.design == "independent":
        text += ", independent of all states and inputs"
    elif first:
        text += (
            ", any design, for a number of pairs fixed beforehand and in the order of time, of "
            f"which the first {first} tell the scale"
        )
    elif noise.known is not None or (wish is not None and wish.anytime):
        text += ", any design, valid for all N at once"
    else:
        text += ", any design, for a number of pairs fixed beforehand"
    if noise.tail:
        text += f", beside it a declared tail of {noise.tail:g} deviations"
    if wish is not None and wish.directions is not None:
        text += "; states and inputs in a span fixed before the outcomes"
    return text
