"""Values that are computed once, when they are first asked for."""

from __future__ import annotations

import functools
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or sys.version_info >= (3, 12):
    from functools import cached_property as cached_property
else:

    class cached_property(functools.cached_property):
        """As of Python 3.12, without the lock of one class, which a fork leaves held for ever.

        Two threads may both compute the value: they keep the same one.
        """

        def __get__(self, instance: Any, owner: type | None = None) -> Any:
            if instance is None:
                return self
            kept = instance.__dict__
            if self.attrname not in kept:
                return kept.setdefault(self.attrname, self.func(instance))
            return kept[self.attrname]
