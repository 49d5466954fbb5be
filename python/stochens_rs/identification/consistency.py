"""Which data, assumptions and known entries go together."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base.threads import get_num_threads
from ..exceptions import InputError
from ..theory.exact import EPS
from .assumptions import LARGEST, SMALLEST, Assumptions

if TYPE_CHECKING:
    from .._base.types import Floats


def refuse(assumed: Assumptions, single: bool) -> None:
    """Refuse assumptions that do not go together; `single`: every run is one pair."""
    if assumed.design == "independent" and not single:
        raise InputError(
            "`design` must be 'adaptive' for runs of several steps, whose states contain earlier "
            "noise; for 'independent' use data.last_pairs(), data.k_step(...) or from_pairs"
        )


def require_states(assumed: Assumptions, n: int) -> None:
    """Refuse exact states that a system of n states does not have."""
    if any(state >= n for state in assumed.exact):
        raise InputError(f"`exact` must have numbers of states, below {n}")


def require_sound(scale: Floats | None, known: Floats | None) -> None:
    """Refuse sizes and known entries that `identify` would not take."""
    if scale is not None and not SMALLEST <= scale.min() <= scale.max() <= LARGEST:
        raise InputError(f"`scale` must be in [{SMALLEST:g}, {LARGEST:g}]")
    if known is None:
        return
    free = np.isnan(known)
    if not free.any() or free.all() or not (free | (np.abs(known) <= LARGEST)).all():
        raise InputError(f"`known` must have numbers up to {LARGEST:g}, and nan, and not only nan")


def require_triangle_of(rows: Floats, triangle: Floats) -> None:
    """Refuse a triangle R with another ``R' R`` than that of the rows W.

    Householder's QR has an error of a few (N + w) w EPS of each column (Higham 2002, theorem 19.4).
    """
    if np.tril(triangle, -1).any():
        raise InputError("`triangle` must be upper triangular")
    N, w = rows.shape
    fresh = _core.triangle(rows, get_num_threads())
    sizes = np.abs(fresh).max(axis=0)  # no square overflows
    sizes = np.where(sizes == 0.0, 1.0, sizes)
    with np.errstate(over="ignore", invalid="ignore"):
        mine, theirs = fresh / sizes, triangle / sizes
        far = np.abs(mine.T @ mine - theirs.T @ theirs).max()
    if not far <= 8.0 * (N + w) * w * EPS:
        raise InputError("`triangle` must be that of the data")
