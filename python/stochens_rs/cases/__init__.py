"""Example systems: two power networks from public data, random systems, and systems from files.

`ieee14`, `ieee39` and `random_system` return a :class:`stochens_rs.System` whose ``name`` states
the data, the base and the discretization. `CASES` has those that the command line and
:func:`stochens_rs.paper.power` know by name.
"""

from __future__ import annotations

from collections.abc import Callable

from ..system import System
from .from_file import Problem, from_file
from .ieee14 import ieee14
from .ieee39 import ieee39
from .random_system import random_system

#: The examples that the command line knows by name. Each can be called without arguments. States:
#: angles in rad, then as many speeds in rad/s.
CASES: dict[str, Callable[..., System]] = {"ieee14": ieee14, "ieee39": ieee39}

__all__ = ["CASES", "Problem", "from_file", "ieee14", "ieee39", "random_system"]
