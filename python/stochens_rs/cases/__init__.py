"""Example systems: two power networks from public data, random systems, and systems from files.

`ieee14`, `ieee39` and `random_system` return a :class:`stochens_rs.System` whose ``name`` states
the data, the base and the discretization.
"""

from __future__ import annotations

from .from_file import Problem, from_file
from .ieee14 import ieee14
from .ieee39 import ieee39
from .random_system import random_system

__all__ = ["Problem", "from_file", "ieee14", "ieee39", "random_system"]
