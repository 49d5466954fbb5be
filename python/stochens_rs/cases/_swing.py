"""The classical swing model of a power network, reduced to its generators.

Each generator is a constant voltage behind its transient reactance ``x'd``. The network is
lossless (resistances, line charging, loads and transformer taps are left out) and linearized at
equal angles and unit voltages, so that a line of reactance ``x`` is a spring of stiffness ``1/x``.

References
----------
P. M. Anderson and A. A. Fouad, *Power System Control and Stability*, ch. 2 (classical model).
F. Doerfler and F. Bullo, "Kron reduction of graphs with applications to electrical networks",
IEEE Trans. Circuits and Systems I 60(1), 2013.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from .._base import validation
from .._base.types import Floats
from ..exceptions import SizeError

Branch = tuple[int, int, float]

SYSTEM_MVA = 100.0  # base power of the IEEE test networks
FREQUENCY_HZ = 60.0  # North America


def checked_frequency(frequency: object) -> float:
    """Return a nominal frequency in Hz."""
    hertz = validation.positive("frequency", frequency, maximum=1000.0)
    if hertz < 1.0:
        raise SizeError(f"`frequency` must be at least 1 Hz, got {hertz:g}")
    return hertz


def reduced_stiffness(
    buses: int, branches: Sequence[Branch], at: Sequence[int], xd: Floats
) -> Floats:
    """Stiffness between the generators after the buses are eliminated (Kron reduction).

    Parameters
    ----------
    buses : int
        Number of buses, numbered from 1.
    branches : sequence of (from, to, x)
        Lines and transformers; ``x`` is the series reactance in per unit on the system base.
    at : sequence of int
        ``at[g]`` is the bus of generator ``g``.
    xd : (generators,) array
        Transient reactances in per unit on the system base.

    Returns
    -------
    (generators, generators) array
        ``L_red = L_gg - L_gl L_ll^-1 L_lg``: symmetric, rows sum to 0, off-diagonal ``<= 0``.
    """
    L_ll = np.zeros((buses, buses))
    for one, other, x in branches:
        i, j = one - 1, other - 1
        L_ll[[i, j], [i, j]] += 1.0 / x
        L_ll[[i, j], [j, i]] -= 1.0 / x
    bus = np.asarray(at) - 1
    generators = np.arange(bus.size)
    # The edge between a generator's internal node and its bus has stiffness 1/x'd.
    L_gl = np.zeros((bus.size, buses))
    L_gl[generators, bus] = -1.0 / xd
    np.add.at(L_ll, (bus, bus), 1.0 / xd)
    L_red = np.diag(1.0 / xd) - L_gl @ np.linalg.solve(L_ll, L_gl.T)
    return np.asarray((L_red + L_red.T) / 2.0, dtype=np.float64)


def swing(
    L_red: Floats, H: Floats, D: Floats, frequency: float = FREQUENCY_HZ
) -> tuple[Floats, Floats]:
    """Continuous-time swing equations ``M delta'' + D_rad delta' + L_red delta = P``.

    Parameters
    ----------
    L_red : (g, g) array
        Reduced stiffness in per unit per radian.
    H : (g,) array
        Inertia constants in seconds.
    D : (g,) array
        Damping in per unit power per per-unit speed. (The state holds rad/s, so it enters as
        ``D / w0``.)
    frequency : float, default 60
        Nominal frequency in Hz.

    Returns
    -------
    A : (2 g, 2 g) array
        ``[[0, I], [-M^-1 L_red, -M^-1 D_rad]]`` with ``M = 2 H / w0``, ``D_rad = D / w0`` and
        ``w0 = 2 pi frequency`` rad/s. State: angles in rad, then speed deviations in rad/s.
    B : (2 g, g) array
        ``[[0], [M^-1]]``. Input: mechanical power in per unit.
    """
    g = H.size
    w0 = 2.0 * np.pi * frequency
    M = 2.0 * H / w0
    A = np.zeros((2 * g, 2 * g))
    A[:g, g:] = np.eye(g)
    A[g:, :g] = -L_red / M[:, None]
    A[g:, g:] = np.diag(-(D / w0) / M)
    B = np.zeros((2 * g, g))
    B[g:] = np.diag(1.0 / M)
    return A, B


def swing_labels(buses: Sequence[int]) -> dict[str, Any]:
    """Names and units of states and inputs, as arguments of `System`.

    Further machines at a bus are counted: 1, 1_2, 1_3.
    """
    seen: Counter[int] = Counter()
    machines = []
    for bus in buses:
        seen[bus] += 1
        machines.append(f"{bus}" if seen[bus] == 1 else f"{bus}_{seen[bus]}")
    delta, omega, power = (
        [f"{word}_{machine}" for machine in machines] for word in ("delta", "omega", "T_m")
    )
    units = dict.fromkeys(delta, "rad") | dict.fromkeys(omega, "rad/s") | dict.fromkeys(power, "pu")
    return {"states": delta + omega, "inputs": power, "units": units}
