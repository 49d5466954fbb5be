"""Pickling of frozen records."""

from __future__ import annotations

from dataclasses import fields
from typing import Any


def by_constructor(record: Any) -> tuple[Any, ...]:
    """Return what `__reduce__` needs to rebuild a dataclass with its constructor.

    The constructor checks the fields, because a pickle can come from anywhere.
    """
    return type(record), tuple(getattr(record, one.name) for one in fields(record))
