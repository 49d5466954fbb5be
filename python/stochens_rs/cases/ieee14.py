"""The IEEE 14-bus network with five generators: n = 10 states, m = 5 inputs."""

from __future__ import annotations

from typing import Literal

import numpy as np

from .._base import validation
from .._base.discretize import discretize
from .._base.types import Floats
from ..system import System
from ._swing import SYSTEM_MVA, reduced_stiffness, swing, swing_labels

__all__ = ["ieee14"]

# (from, to, x): x in per unit on 100 MVA.
_BRANCHES = (
    (1, 2, 0.05917), (1, 5, 0.22304), (2, 3, 0.19797), (2, 4, 0.17632), (2, 5, 0.17388),
    (3, 4, 0.17103), (4, 5, 0.04211), (4, 7, 0.20912), (4, 9, 0.55618), (5, 6, 0.25202),
    (6, 11, 0.1989), (6, 12, 0.25581), (6, 13, 0.13027), (7, 8, 0.17615), (7, 9, 0.11001),
    (9, 10, 0.0845), (9, 14, 0.27038), (10, 11, 0.19207), (12, 13, 0.19988), (13, 14, 0.34802),
)  # fmt: skip
_GENERATOR_BUSES = (1, 2, 3, 6, 8)

# Per generator: rating MVA, H in s, x'd and D in per unit on that rating.
_CLASSIC = np.array([
    [615.0, 5.148, 0.2995, 2.0],
    [60.0, 6.54, 0.185, 2.0],
    [60.0, 6.54, 0.185, 2.0],
    [25.0, 5.06, 0.232, 2.0],
    [25.0, 5.06, 0.232, 2.0],
])  # fmt: skip
_ANDES = np.array([
    [100.0, 4.0, 0.6, 0.0],
    [100.0, 6.5, 0.6, 0.0],
    [100.0, 5.0, 0.6, 0.0],
    [100.0, 5.0, 0.6, 0.0],
    [100.0, 5.0, 0.6, 0.0],
])  # fmt: skip


def _continuous(data: str, base: str) -> tuple[Floats, Floats, Floats]:
    """Continuous-time ``A``, ``B`` and the reduced stiffness ``L_red``."""
    rating, H, xd, D = (_CLASSIC if data == "classic" else _ANDES).T
    # Reactances shrink and inertia and damping grow with the rating of the machine.
    ratio = rating / SYSTEM_MVA if base == "system" else np.ones_like(rating)
    L_red = reduced_stiffness(14, _BRANCHES, _GENERATOR_BUSES, xd / ratio)
    A, B = swing(L_red, H * ratio, D * ratio)
    return A, B, L_red


def ieee14(
    *,
    data: Literal["classic", "andes"] = "classic",
    base: Literal["system", "machine"] = "system",
    dt: float = 0.01,
    method: Literal["zoh", "euler"] = "zoh",
) -> System:
    """IEEE 14-bus network: lossless classical swing model, Kron-reduced to its five generators.

    Parameters
    ----------
    data : {"classic", "andes"}, default "classic"
        Machine parameters (see References). The network is the same for both.
    base : {"system", "machine"}, default "system"
        ``"system"`` converts the machine parameters from the rating of each machine to 100 MVA.
        ``"machine"`` does not: unphysical for the classic data, but found in published models.
        All ratings of the ``"andes"`` data are 100 MVA, so both choices give the same system.
    dt : float, default 0.01
        Step in seconds.
    method : {"zoh", "euler"}, default "zoh"
        ``"zoh"`` is exact for inputs held over a step and fills all 100 entries of ``A``;
        ``"euler"`` (``I + dt A``) has 40 nonzero entries, with another sampling variance.

    Returns
    -------
    System
        ``A`` (10, 10), ``B`` (10, 5). States: rotor angles of the generators at buses
        1, 2, 3, 6, 8 in rad, then their speed deviations in rad/s. Inputs: mechanical powers in
        per unit on 100 MVA.

    Raises
    ------
    InputError
        An unknown choice, or a ``dt`` that is not a positive number.

    Notes
    -----
    Only angle differences matter, so ``A`` has the eigenvalue 1. This is the spectral radius with
    ``"zoh"``; with ``"euler"`` the lightly damped modes are unstable (1.006 at 0.01 s). ``B`` has
    rank 5: one step reaches a 5-dimensional subspace, with a distance to a random target of about
    ``sqrt(1/2)`` of its norm; two steps reach every state.

    References
    ----------
    Branch reactances: IEEE 14-bus test case, Power Systems Test Case Archive, University of
    Washington (1962 AEP data), as distributed with MATPOWER (``case14``; Zimmerman,
    Murillo-Sanchez and Thomas, IEEE Trans. Power Systems 26(1), 2011).
    ``"classic"`` machines: Anderson and Fouad, *Power System Control and Stability*, and the
    14-bus dynamic case of PSAT (Milano, IEEE Trans. Power Systems 20(3), 2005).
    ``"andes"`` machines: 14-bus dynamic case of ANDES (Cui, Li and Tomsovic, IEEE Trans. Power
    Systems 36(2), 2021), D = 0.

    Examples
    --------
    >>> from stochens_rs.cases import ieee14
    >>> system = ieee14(data="andes", dt=0.02)
    >>> system.A.shape, system.B.shape
    ((10, 10), (10, 5))
    """
    validation.choice("data", data, ("classic", "andes"))
    validation.choice("base", base, ("system", "machine"))
    A_c, B_c, _ = _continuous(data, base)
    A, B = discretize(A_c, B_c, dt, method)
    return System(
        A,
        B,
        dt=dt,
        name=f"IEEE 14-bus ({data} data, {base} base, {method})",
        **swing_labels(_GENERATOR_BUSES),
    )
