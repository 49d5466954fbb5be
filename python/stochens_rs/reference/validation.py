"""Compare the core with the NumPy functions of this package, on this machine.

The only file here that uses the rest of the package, by its public names.
"""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import controls, fusing, sampling, simulation

_TOLERANCE = 1e-9  # of ALSE, relative to ||E*||^2: the default of `fuse`
_ROUNDING = 1e-10  # of all else that is not equal to the bit, relative to the largest entry


class Comparison(NamedTuple):
    """One computation of the core beside the one in NumPy.

    Attributes
    ----------
    name : str
        What was computed.
    cases : int
        In how many random problems.
    difference : float
        The largest difference between both, relative to the largest entry of the problem.
    allowed : float
        How large it may be: 0 where both must be equal to the bit.
    """

    name: str
    cases: int
    difference: float
    allowed: float

    @property
    def passed(self) -> bool:
        """Whether the difference is at most the allowed one."""
        return self.difference <= self.allowed

    def __str__(self) -> str:
        said = "ok" if self.passed else "WRONG"
        return (
            f"{self.name:<42} {self.cases:>4} problems   difference {self.difference:8.2g}   "
            f"allowed {self.allowed:8.2g}   {said}"
        )


def validate(cases: int = 20, seed: int = 1) -> tuple[Comparison, ...]:
    """Compare draws, weights, controls and simulations of the core with those in NumPy.

    Parameters
    ----------
    cases : int, default 20
        Number of random problems, with up to 6 states, 4 inputs and 60 realizations.
    seed : int, default 1
        Chooses the problems.

    Returns
    -------
    tuple of Comparison
        One for each computation; print them, and look at `passed`.

    Examples
    --------
    >>> import stochens_rs as se
    >>> all(found.passed for found in se.reference.validate(cases=3))
    True
    """
    se = importlib.import_module(__package__.rpartition(".")[0])
    gen = np.random.default_rng(seed)
    found: dict[str, list[tuple[float, float]]] = {}
    for case in range(cases):
        for name, got, expected, allowed in _problem(se, gen, case):
            scale = float(np.abs(expected).max(initial=0.0)) or 1.0
            off = float(np.abs(np.subtract(got, expected)).max(initial=0.0)) / scale
            found.setdefault(name, []).append((off, allowed))
    return tuple(
        Comparison(name, len(many), max(off for off, _ in many), many[0][1])
        for name, many in found.items()
    )


Compared = tuple[str, NDArray[Any] | float, NDArray[Any] | float, float]


def _problem(se: Any, gen: np.random.Generator, case: int) -> list[Compared]:
    """A random problem: name, result of the core, result in NumPy, allowed difference."""
    n, m, N = (int(k) for k in gen.integers([1, 1, 2], [7, 5, 61]))
    A, B = gen.normal(size=(n, n)), gen.normal(size=(n, m))
    x0, xf = gen.normal(size=n), gen.normal(size=n)
    drawn, dense = {}, {}
    compared: list[Compared] = []
    for name, target in (("x0", x0), ("xf", xf), ("A", A)):
        for scheme in ("iid", "systematic"):
            one = se.sample(target, N, rng=case, scheme=scheme)
            indices = sampling.sample_indices(target, N, key=bytes(one.key), scheme=scheme)
            compared.append((f"draws, {scheme}", one.indices, indices, 0.0))
        drawn[name] = se.sample(target, N, rng=se.Key.from_hex(f"{case:064x}").child(name))
        dense[name] = sampling.dense(drawn[name].indices, sampling.atoms(target))
        compared += _weights(se, drawn[name], dense[name], target)
    system = drawn["A"], B
    for fusion in ("product", "diagonal"):
        u = se.control(system, drawn["x0"], drawn["xf"], fusion=fusion).u[0]
        own = controls.control(dense["A"], B, dense["x0"], dense["xf"], fusion=fusion)
        compared.append((f"control, {fusion} fusion", u, own, _ROUNDING))
    each = se.realization_controls(system, drawn["x0"], drawn["xf"])
    own = controls.realization_controls(dense["A"], B, dense["x0"], dense["xf"])
    compared.append(("controls of realizations", each, own, _ROUNDING))
    u = gen.normal(size=(5, m))
    states = se.simulate((A, B), x0, u).states
    compared.append(("simulation", states, simulation.simulate(A, B, x0, u), _ROUNDING))
    return compared


def _weights(se: Any, drawn: Any, dense: NDArray[Any], target: NDArray[Any]) -> list[Compared]:
    """The estimates of each method; for ALSE the squared error, whose minimiser need not be one."""
    unit = float(np.sum(target**2))
    compared: list[Compared] = []
    for method, own in fusing.METHODS.items():
        fit, expected = se.fuse(drawn, method, target=target), own(dense, target)
        if method == "alse":  # + 1: differences relative to ||E*||^2, not to an error that may be 0
            got, wanted = (one.error**2 / unit + 1.0 for one in (fit, expected))
            compared.append(("alse, squared error", got, wanted, _TOLERANCE))
        else:
            compared.append((f"{method} estimate", fit.estimate, expected.estimate, _ROUNDING))
    return compared
