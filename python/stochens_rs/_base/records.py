"""What frozen records have in common."""

from __future__ import annotations

from dataclasses import fields
from typing import Any


def by_constructor(record: Any) -> tuple[Any, ...]:
    """What `pickle` and `copy` keep of a dataclass: its fields, for the constructor to check.

    A pickle may come from anywhere; what is wrong with it is said when it is loaded.
    """
    return type(record), tuple(getattr(record, one.name) for one in fields(record))
