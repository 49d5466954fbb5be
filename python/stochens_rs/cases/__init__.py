"""Example systems: power networks, random systems, and systems from files.

All but `from_file` and `read_matpower` return a :class:`stochens_rs.System` whose ``name`` states
the data and the discretization: `ieee14` and `ieee39` from public data, `swing` from branches and
machines, `from_matpower` from a solved case of MATPOWER, pypower or pandapower.
`CASES` has those that the command line knows by name.
"""

from __future__ import annotations

from collections.abc import Callable

from ..system.system import System
from .from_file import Problem, from_file
from .matpower import from_matpower, read_matpower
from .swing_models import ieee14, ieee39, random_system, swing

#: The examples that the command line knows by name. Each can be called without arguments. States:
#: angles in rad, then as many speeds in rad/s.
CASES: dict[str, Callable[..., System]] = {case.__name__: case for case in (ieee14, ieee39)}

__all__ = [
    "CASES",
    "Problem",
    "from_file",
    "from_matpower",
    "ieee14",
    "ieee39",
    "random_system",
    "read_matpower",
    "swing",
]


def __dir__() -> list[str]:
    return __all__
