"""Names of columns with their units; seconds from columns of times and dates."""

from __future__ import annotations

import re
from collections.abc import Collection
from datetime import date
from typing import Any

import numpy as np

from .._base.types import Floats
from ..exceptions import InputError

_WITH_UNIT = re.compile(r"(.*\S)\s+\[([^\[\]]*)\]")
_TITLE = re.compile(r"^(.*\S)\s*[\[(]\s*(?![-+]?\d)[^\[\]()]+[\])]$")
_WORDS = {  # (times, parts): a time times / parts is in seconds, rounded once
    (1, 1): "s sec secs second seconds",
    (1, 10**3): "ms msec msecs millis millisec millisecs millisecond milliseconds",
    # two letters for micro in Unicode
    (1, 10**6): "us \u00b5s \u03bcs usec usecs micros microsec microsecs microsecond microseconds",
    (1, 10**9): "ns nsec nsecs nanos nanosec nanosecs nanosecond nanoseconds",
    (60, 1): "min mins minute minutes",
    (3600, 1): "h hr hrs hour hours",
    (86400, 1): "d day days",
}
SECONDS = {word: ratio for ratio, words in _WORDS.items() for word in words.split()}
_ANY = "|".join(sorted(SECONDS, key=len, reverse=True))
_LONG = "|".join(sorted((word for word in SECONDS if len(word) > 1), key=len, reverse=True))
_BRACKETS = re.compile(r".*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*")
_ENDINGS = (  # t_ms, time.us, t ms; ms, tms, timeus; TimeUS, stampMs
    re.compile(rf".*[\s_.\-/]({_ANY})", re.IGNORECASE),
    re.compile(rf"(?:t|time|stamp|timestamp)?({_LONG})|(h)", re.IGNORECASE),
    re.compile(rf".*[a-z0-9]((?=[A-Z])(?i:{_LONG}))"),
)
_EPOCH = (9.4e8, 4.2e9)  # seconds from 1970 to 1999 and to 2103
LATEST = 1e11  # seconds, the year 5138


def name_and_unit(title: str) -> tuple[str, str]:
    """``delta_1 [rad]``: the name, and the unit or ""."""
    split = _WITH_UNIT.fullmatch(title)
    return (title, "") if split is None else (split[1], split[2])


def titled(name: str, titles: Collection[Any]) -> str:
    """The one of `titles` that is this name with a unit behind it; else the name.

    ``angle [rad]``, ``angle[rad]`` or ``angle (rad)``; but x[0] is a name.
    """
    fits = [one for one in titles if isinstance(one, str) and _TITLE.sub(r"\1", one) == name]
    return fits[0] if len(fits) == 1 and name not in titles else name


def unit_of(title: object) -> str:
    """The unit that the name of a column of times says, or ""; it need not be one of `SECONDS`."""
    if not isinstance(title, str):
        return ""
    found = _BRACKETS.fullmatch(title)
    if found is not None:
        return found[1].lower()
    fits = (one.fullmatch(title.strip()) for one in _ENDINGS)
    return next((str(one[one.lastindex or 0]).lower() for one in fits if one is not None), "")


def in_seconds(what: str, title: object, values: Floats) -> Floats:
    """Numbers of a column of times in seconds; refused where its unit is unknown.

    Numbers without a unit, beyond `LATEST`, that are ms, us or ns since 1970 in this century are
    taken as such.
    """
    unit = unit_of(title)
    if unit and unit not in SECONDS:
        raise InputError(
            f"`time` must be in seconds or a unit of time, but {what} is in {unit[:20]!r}: name "
            "s, ms, us, ns, min, h or d"
        )
    times, parts = SECONDS[unit or "s"]
    known = values[np.isfinite(values)]
    if not unit and len(known) and known.min() > LATEST:
        (low, high), ends = _EPOCH, np.array([known.min(), known.max()])
        fits = (k for k in (10**3, 10**6, 10**9) if low < ends[0] / k and ends[1] / k < high)
        parts = next(fits, 1)
    with np.errstate(over="ignore"):
        return values if times == parts else values * times / parts


def as_text(cell: Any) -> str:
    """A date or time in ISO 8601, "" where it is missing, ? where it is something else."""
    try:
        if cell is None or cell != cell:
            return ""
    except Exception:  # whatever a foreign object raises
        return "?"
    return str(cell).replace("\n", " ") if isinstance(cell, (str, date, np.datetime64)) else "?"
