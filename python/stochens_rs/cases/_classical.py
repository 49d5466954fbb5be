"""The classical model of a solved network, linearized and reduced to its machines."""

from __future__ import annotations

import numpy as np

from .._base import validation
from .._base.types import Floats
from ..exceptions import InputError
from ._machines import Machines
from ._network import Complex, Network


def check_balance(network: Network, mismatch: float) -> None:
    """Refuse voltages that miss the power balance, and buses that no generator feeds."""
    fed_in = np.zeros_like(network.load)
    np.add.at(fed_in, network.at, network.power)
    # S_k = V_k conj(sum_l Y_kl V_l) leaves bus k through the network.
    missed = np.abs(fed_in - network.load - network.V * (network.Y @ network.V).conj())
    k = int(np.argmax(missed))
    if not missed[k] <= mismatch:
        raise InputError(
            f"`case` is not a solved power flow: the balance is off by {missed[k]:.2g} pu at bus "
            f"{network.label[k]} (allowed: {mismatch:g}); solve it first (runpf of MATPOWER or "
            "pypower, runpp of pandapower) and pass the result, or allow more with mismatch="
        )
    joined = network.Y != 0.0
    reached = np.zeros(len(network.V), dtype=bool)
    reached[network.at] = True
    while (wider := reached | (joined @ reached)).sum() > reached.sum():
        reached = wider
    if not reached.all():
        raise InputError(
            f"bus {network.label[int(np.argmin(reached))]} is connected to no generator in "
            "service: give it type 4 or take it out of `case`"
        )


def matched(network: Network, machines: Machines) -> Machines:
    """One machine per generator in service, in the order of the generators."""
    rows: dict[int, list[int]] = {}
    for row, number in enumerate(machines.bus.tolist()):
        if number not in network.bus_of:
            raise InputError(f"`machines` names bus {number}, which is not in `case`")
        rows.setdefault(network.bus_of[number], []).append(row)
    units = np.bincount(network.at, minlength=len(network.V))
    for bus in np.union1d(network.at, list(rows)):
        found = rows.get(int(bus), [])
        if len(found) != units[bus]:
            hint = (
                ""
                if found
                else (
                    "; a plant without inertia is a negative load: take it out of gen and subtract "
                    "its power from PD and QD"
                )
            )
            raise InputError(
                "`machines` must have one row per generator in service: bus "
                f"{network.label[bus]} has {units[bus]}, got {len(found)}{hint}"
            )
        if len({int(machines.bus[row]) for row in found}) > 1:
            raise InputError(
                f"`machines` names one bus ({network.label[bus]}) by two numbers: use one for "
                "all its rows, in the order of the generators"
            )
    ordered = [rows[int(bus)].pop(0) for bus in network.at]
    return machines.take(ordered)


def internal(network: Network, xd1: Floats) -> tuple[Complex, Complex]:
    """Voltages behind transient reactance (g,) and the admittances (g, g) between them.

    ``E = V + j x'd I`` with ``I = conj(S / V)``; loads become the admittances ``conj(S) / |V|^2``,
    and all buses are eliminated (Kron reduction).
    """
    V, at = network.V, network.at
    E = V[at] + 1j * xd1 * (network.power / V[at]).conj()
    y = 1.0 / (1j * xd1)
    Y_ll = network.Y + np.diag(network.load.conj() / np.abs(V) ** 2)
    np.add.at(Y_ll, (at, at), y)
    Y_lg = np.zeros((len(V), len(at)), dtype=np.complex128)
    Y_lg[at, np.arange(len(at))] = -y
    try:
        Y = np.diag(y) - Y_lg.T @ np.linalg.solve(Y_ll, Y_lg)
    except np.linalg.LinAlgError:
        raise InputError("`case` cannot be reduced: its admittance matrix is singular") from None
    return E, np.asarray(Y, dtype=np.complex128)


def synchronizing(network: Network, xd1: Floats) -> Floats:
    """``K[i, j] = dP_i / d delta_j`` [pu/rad] between the machines; rows sum to 0.

    From ``P_i = sum_j E_i E_j (G_ij cos d_ij + B_ij sin d_ij)`` with ``d_ij = delta_i - delta_j``,
    ``K_ij = E_i E_j (G_ij sin d_ij - B_ij cos d_ij)`` for j != i.
    """
    E, Y = internal(network, xd1)
    angle = np.angle(E)
    d = angle[:, None] - angle[None, :]
    K = np.outer(np.abs(E), np.abs(E)) * (Y.real * np.sin(d) - Y.imag * np.cos(d))
    np.fill_diagonal(K, 0.0)
    np.fill_diagonal(K, -K.sum(axis=1))
    return validation.matrix("K", K)
