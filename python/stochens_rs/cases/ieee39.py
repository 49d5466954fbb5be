"""The IEEE 39-bus (New England) network with ten generators: n = 20 states, m = 10 inputs."""

from __future__ import annotations

from typing import Literal

import numpy as np

from .._base.discretize import discretize
from .._base.types import Floats
from ..system import System
from ._swing import reduced_stiffness, swing, swing_labels

__all__ = ["ieee39"]

# (from, to, x): x in per unit on 100 MVA.
_BRANCHES = (
    (1, 2, 0.0411), (1, 39, 0.025), (2, 3, 0.0151), (2, 25, 0.0086), (2, 30, 0.0181),
    (3, 4, 0.0213), (3, 18, 0.0133), (4, 5, 0.0128), (4, 14, 0.0129), (5, 6, 0.0026),
    (5, 8, 0.0112), (6, 7, 0.0092), (6, 11, 0.0082), (6, 31, 0.025), (7, 8, 0.0046),
    (8, 9, 0.0363), (9, 39, 0.025), (10, 11, 0.0043), (10, 13, 0.0043), (10, 32, 0.02),
    (12, 11, 0.0435), (12, 13, 0.0435), (13, 14, 0.0101), (14, 15, 0.0217), (15, 16, 0.0094),
    (16, 17, 0.0089), (16, 19, 0.0195), (16, 21, 0.0135), (16, 24, 0.0059), (17, 18, 0.0082),
    (17, 27, 0.0173), (19, 20, 0.0138), (19, 33, 0.0142), (20, 34, 0.018), (21, 22, 0.014),
    (22, 23, 0.0096), (22, 35, 0.0143), (23, 24, 0.035), (23, 36, 0.0272), (25, 26, 0.0323),
    (25, 37, 0.0232), (26, 27, 0.0147), (26, 28, 0.0474), (26, 29, 0.0625), (28, 29, 0.0151),
    (29, 38, 0.0156),
)  # fmt: skip
_GENERATOR_BUSES = (30, 31, 32, 33, 34, 35, 36, 37, 38, 39)

# On 100 MVA. H in s, x'd and D in per unit.
_H = np.array([42.0, 30.3, 35.8, 28.6, 26.0, 34.8, 26.4, 24.3, 34.5, 500.0])
_XD = np.array([0.031, 0.0697, 0.0531, 0.0436, 0.132, 0.05, 0.049, 0.057, 0.057, 0.006])
_D = np.full(10, 50.0)


def _continuous(D: Floats) -> tuple[Floats, Floats, Floats]:
    """Continuous-time ``A``, ``B`` for the damping ``D`` (10,), and the stiffness ``L_red``."""
    L_red = reduced_stiffness(39, _BRANCHES, _GENERATOR_BUSES, _XD)
    A, B = swing(L_red, _H, D)
    return A, B, L_red


def ieee39(*, dt: float = 0.01, method: Literal["zoh", "euler"] = "zoh") -> System:
    """New England network: lossless classical swing model, Kron-reduced to its ten generators.

    Parameters
    ----------
    dt : float, default 0.01
        Step in seconds.
    method : {"zoh", "euler"}, default "zoh"
        ``"zoh"`` is exact for inputs held over a step; ``"euler"`` is ``I + dt A``, which keeps
        the zeros of the continuous-time ``A``.

    Returns
    -------
    System
        ``A`` (20, 20), ``B`` (20, 10). States: rotor angles of the generators at buses 30 to 39
        in rad, then their speed deviations in rad/s. Inputs: mechanical powers in per unit on
        100 MVA. Bus 39 stands for the rest of the interconnection (H = 500 s).

    Raises
    ------
    InputError
        An unknown ``method``, or a ``dt`` that is not a positive number.

    Notes
    -----
    The damping is D = 50 per unit at every machine, as in the data set of Nishikawa and Motter;
    the decay of a machine alone, ``D / (4 H)``, is 0.025 to 0.51 per second.
    As in :func:`ieee14`, ``A`` has the eigenvalue 1 (the common angle), ``"euler"`` is slightly
    unstable, and ``B`` has only half the rank needed to reach every state in one step.

    References
    ----------
    Branch reactances: ``case39`` of MATPOWER (Zimmerman, Murillo-Sanchez and Thomas, IEEE Trans.
    Power Systems 26(1), 2011), after Bills et al., EPRI report RP90-1, 1970, and Athay, Podmore
    and Virmani, IEEE Trans. PAS-98(2), 1979.
    Machines: M. A. Pai, *Energy Function Analysis for Power System Stability*, Kluwer, 1989.
    Damping: data set of T. Nishikawa and A. E. Motter, "Comparative analysis of existing models
    for power-grid synchronization", New J. Phys. 17, 2015.

    Examples
    --------
    >>> from stochens_rs.cases import ieee39
    >>> system = ieee39(method="euler")
    >>> system.A.shape, system.B.shape
    ((20, 20), (20, 10))
    """
    A_c, B_c, _ = _continuous(_D)
    A, B = discretize(A_c, B_c, dt, method)
    return System(
        A,
        B,
        dt=dt,
        name=f"IEEE 39-bus (Pai data, system base, {method})",
        **swing_labels(_GENERATOR_BUSES),
    )
