"""Seconds from columns of time: their unit, which the name says, and dates and times."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date, datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np

from ..exceptions import InputError

if TYPE_CHECKING:
    from .types import Floats

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
_ZONED = re.compile(r"(.*:\d\d(?:\.\d+)?)\s*(?:Z|UTC|([-+])(\d\d)(?::?(\d\d))?)", re.IGNORECASE)
_DATE = re.compile(r"\d{4}-\d\d(-\d\d([T ]\d\d(:\d\d(:\d\d(\.\d+)?)?)?)?)?", re.IGNORECASE)


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
        low, high = _EPOCH
        fits = (
            k for k in (10**3, 10**6, 10**9) if low < known.min() / k and known.max() / k < high
        )
        parts = next(fits, 1)
    with np.errstate(over="ignore"):
        return values if times == parts else values * times / parts


def instants(cells: Sequence[Any]) -> Floats:
    """Dates and times in seconds since the first of them; nan where one is missing.

    They are texts as in ISO 8601, or objects of `datetime`, all with a time zone or all without.
    A ValueError has the place of the first one that is neither.
    """
    second = np.timedelta64(1, "s")
    stamps = np.full(len(cells), "NaT", dtype="datetime64[ns]")
    zones: set[bool] = set()
    for k, cell in enumerate(cells):
        try:
            if cell is None or cell != cell or (isinstance(cell, str) and not cell.strip()):
                continue
            local, ahead = _apart(cell)
            stamps[k] = np.datetime64(local, "ns") - np.timedelta64(ahead or 0, "us")
        except Exception:  # not a date, or whatever a foreign object raises
            raise ValueError(k) from None
        zones.add(ahead is not None)
        if len(zones) > 1:
            raise ValueError(k)
    since: Floats = (stamps - stamps[:1]) / second
    return since


def _apart(cell: Any) -> tuple[Any, int | None]:
    """A time without its zone, and how many microseconds that is ahead of UTC."""
    if not isinstance(cell, str):
        if not isinstance(cell, (date, np.datetime64)):
            raise ValueError(cell)
        offset = cell.utcoffset() if isinstance(cell, datetime) else None
        if not isinstance(cell, datetime) or offset is None:
            return cell, None
        return cell.replace(tzinfo=None), offset // timedelta(microseconds=1)
    text = cell.strip().replace(",", ".")
    found = _ZONED.fullmatch(text)
    local, sign, hours, minutes = (text, None, None, None) if found is None else found.groups()
    if not _DATE.fullmatch(local):  # NumPy reads "now" as well
        raise ValueError(cell)
    if found is None:
        return local, None
    ahead = 60_000_000 * (60 * int(hours or 0) + int(minutes or 0))
    return local, -ahead if sign == "-" else ahead
