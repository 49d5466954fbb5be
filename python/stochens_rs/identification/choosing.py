"""Which window a model of outputs has: declared, or chosen by the first part of the data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from .. import _core
from .._base import validation
from .._base.threads import get_num_threads
from ..exceptions import InputError
from .window import Window

if TYPE_CHECKING:
    from .._base.types import Floats
    from ..data import Trajectories

Lags: TypeAlias = "int | Literal['auto'] | None"
Order: TypeAlias = "Literal['auto'] | None"
Delay: TypeAlias = "int | tuple[int, int]"

POLES = (0.2, 0.4, 0.6, 0.8, 0.9)  # of filters that are tried
FILTERS, LAGS = 6, 12  # how many at most
COMPARED = 3  # of which two rows for each unknown are enough for a choice
LARGEST = 2**16  # of lags, filters and delays
SHARE = 4  # the first quarter of the pairs chooses
FILLED = 4  # filters that use up more than a quarter of the median piece give way to lags


def chosen_window(
    runs: Trajectories, lags: Any, filters: Any, order: Any, delay: Any, offset: bool
) -> tuple[Window | None, int]:
    """The window of the arguments of `identify`, and how many pairs it was chosen from.

    None and 0 for states without a dead time; with one, a window of the states now and past inputs.
    """
    asked = {"lags": lags, "filters": filters, "order": order}
    given = [name for name, one in asked.items() if one is not None]
    least, most = _delays(delay)
    if not runs.outputs:
        if given:
            raise InputError(
                f"`{given[0]}` is for outputs, but `data` has states: read it with outputs= in "
                "place of states="
            )
        if most == 0:
            return None, 0
        if runs.steps > 1:
            raise InputError("`delay` must be left out for pairs over several steps")
        if least == most:
            lags = 1
    if len(given) > 1:
        raise InputError(f"only one of `lags`, `filters` and `order` must be given, got {given}")
    # for filters that are declared the first part says only how long they fill
    first = -(-runs.size // (SHARE if filters is None else 2 * SHARE))
    names = runs.state_names, runs.input_names
    auto = isinstance(lags, str) and lags == "auto"
    if lags is not None and not auto:
        if least != most:
            raise InputError("`delay` must be one number with `lags`: a range is for order='auto'")
        return Window(
            *names, validation.size("lags", lags, maximum=LARGEST), None, least, offset
        ), 0
    begins = (runs._pieces.places()[:first] == 0).tolist()
    start = runs._rows[:first], begins, runs.n, runs.m, offset
    if filters is not None:
        pole, count = _filters(filters)
        if least != most:
            raise InputError("`delay` must be one number with `filters`")
        ratio = _core.readings_over_noise(*start)
        burn = _core.window_burn(pole, count, ratio, len(runs.pieces))
        return Window(*names, count, pole, least, offset, burn), first
    poles = [] if auto or not runs.outputs else list(POLES)
    tried = (FILTERS, LAGS if runs.outputs else 1)
    if order is not None:
        validation.choice("order", order, ("auto",))
    pieces = len(runs.pieces), int(np.median(runs.pieces))
    found = _core.choose_window(*start, poles, tried, (least, most), pieces)
    if not runs.outputs:  # states say all of the past but the inputs under way
        return Window(*names, 1, None, found[2], offset), first
    if FILLED * found[3] > pieces[1]:
        found = _core.choose_window(*start, [], tried, (least, most), pieces)
    one, count, back, burn, told, rows = found
    # two rows for each unknown of a longer window, or nothing says that a short one is enough
    needed = 2 * (min(told + 1, COMPARED) * (runs.n + runs.m) + offset + runs.n)
    if rows < needed:
        raise InputError(
            f"`data` must be longer, or its window declared by lags= or filters=, got {runs.size} "
            f"pairs, and needs {SHARE * (first + needed - rows)} to choose one by its first quarter"
        )
    return Window(*names, count, one, back, offset, burn, told), first


def sized(
    runs: Trajectories, window: Window, sizes: Floats | None, first: int
) -> tuple[Floats | None, int]:
    """The expected sizes of z, None for those of the first part, and how many pairs that has.

    The first part holds the pairs that the window was chosen from, and the first rows that say the
    size of the others; where all rows are too few for that, z is expected to be of size 1.
    """
    if sizes is not None:
        return window._spread(sizes), first
    before, after = window._rows(runs, first)
    rows = np.concatenate([before, after])
    asked = _core.first_pairs(rows, window.length, get_num_threads())
    if asked is None:
        return np.ones(window.length), first
    count = max(asked, len(before))
    return None, first if count == len(before) else window._place(runs, count)


def _delays(delay: Any) -> tuple[int, int]:
    """The least and the largest delay."""
    if isinstance(delay, tuple):
        if len(delay) != 2:
            raise InputError(
                f"`delay` must be a number or a pair of them, got {validation.show(delay)}"
            )
        least = validation.size("delay[0]", delay[0], minimum=0)
        return least, validation.size("delay[1]", delay[1], minimum=least, maximum=LARGEST)
    one = validation.size("delay", delay, minimum=0, maximum=LARGEST)
    return one, one


def _filters(filters: Any) -> tuple[float, int]:
    if not isinstance(filters, (tuple, list)) or len(filters) != 2:
        raise InputError(
            f"`filters` must be a pair (pole, number), as (0.8, 4), got {validation.show(filters)}"
        )
    pole = validation.probability("filters[0]", filters[0])
    return pole, validation.size("filters[1]", filters[1], maximum=LARGEST)
