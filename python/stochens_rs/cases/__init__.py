"""Systems to try things on: two power networks from public data, random systems, your own file.

Every function but `from_file` returns a :class:`stochens_rs.System` whose ``name`` says which data,
base and discretization were used.
"""

from __future__ import annotations

from .from_file import Problem, from_file
from .ieee14 import ieee14
from .ieee39 import ieee39
from .random_system import random_system

__all__ = ["Problem", "from_file", "ieee14", "ieee39", "random_system"]
