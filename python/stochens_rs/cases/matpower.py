"""Solved cases of MATPOWER, pypower and pandapower: their tables, and their classical model."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal

import numpy as np

from .._base import validation
from .._base.files import checked_path
from .._base.types import Floats
from ..exceptions import InputError
from ..system.conversions import discretize
from ..system.system import System
from ._network import Complex, Machines, Network, read_file, read_machines, read_network
from .swing_models import FREQUENCY_HZ, checked_frequency, swing_labels, swing_matrices

__all__ = ["from_matpower", "read_matpower"]


def read_matpower(path: str | os.PathLike[str]) -> dict[str, Any]:
    """All tables of a MATPOWER file, as a dictionary that pypower solves.

    Parameters
    ----------
    path : path
        A MATPOWER ``.m`` file.

    Returns
    -------
    dict
        ``version``, ``baseMVA`` and the tables of the file, such as ``bus``, ``gen``, ``branch``
        and ``dcline``, as arrays of floats, in the units that the file states.

    Raises
    ------
    InputError, InputTypeError
        If the file is no MATPOWER case; or computes something beside its tables, as those of
        distribution networks in Ohm and kW do, with the line: ``loadcase`` and ``savecase`` of
        MATPOWER write the tables that such a file stands for.
    ImportError
        If matpowercaseframes is not installed (extra ``grids``).
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.cases.read_matpower("case.raw")
    Traceback (most recent call last):
        ...
    stochens_rs.exceptions.InputError: `case` must be a MATPOWER .m file, got case.raw
    """
    return read_file(Path(checked_path("path", path)))


def from_matpower(
    case: object,
    machines: object,
    *,
    dt: float = 0.01,
    method: Literal["zoh", "euler"] = "zoh",
    base: Literal["system", "machine"] = "system",
    frequency: float | None = None,
    mismatch: float = 0.01,
) -> System:
    """Swing model of a solved MATPOWER or pandapower case, linearized at its operating point.

    Parameters
    ----------
    case : path, mapping or pandapower net
        A MATPOWER ``.m`` file (read as `read_matpower` does: extra ``grids``); a dictionary with
        ``baseMVA``, ``bus``, ``gen`` and ``branch`` in MATPOWER's format, as pypower has it; or a
        pandapower net, of which the tables ``net._ppc`` of the last ``pandapower.runpp(net)`` are
        read, not ``net.bus``, ``net.line`` and so on.
    machines : mapping, DataFrame or path of a CSV file
        One row per generator in service (of pandapower also the ``ext_grid``), with columns
        ``bus`` (its number in the case, or in ``net.bus``), ``H`` [s], ``D`` [per unit power per
        per-unit speed, may be 0], ``xd1`` (transient reactance x'd [pu]) and optionally ``mva``;
        or ``{bus: {"H": ..., "D": ..., "xd1": ...}}``. Several generators at one bus take their
        rows in order. Other columns are ignored.
    dt : float, default 0.01
        Step in seconds.
    method : {"zoh", "euler"}, default "zoh"
        ``"zoh"`` is exact for inputs held over a step, ``"euler"`` is ``I + dt A``.
    base : {"system", "machine"}, default "system"
        ``"system"``: the machines are given on ``baseMVA`` of the case. ``"machine"``: each on
        its rating, the column ``mva`` or else ``mBase`` of the case; they are converted.
    frequency : float, optional
        Nominal frequency [Hz]. Default: that of a pandapower net, otherwise 60.
    mismatch : float, default 0.01
        Largest error of the power balance at a bus [pu on ``baseMVA``].

    Returns
    -------
    System
        For g generators, in the order of the case: ``A`` (2 g, 2 g), ``B`` (2 g, g). States: the
        deviations of the rotor angles [rad], then of the speeds [rad/s], from the operating
        point. Inputs: deviations of the mechanical powers [pu on ``baseMVA``].

    Raises
    ------
    InputError, InputTypeError
        If the case is not a solved power flow, a machine is missing or unknown, or an argument
        cannot be used; the message names it.
    ResourceError
        If the admittance matrix does not fit into the memory this process may use.
    ImportError
        If `case` is a file and matpowercaseframes is not installed.
    OSError
        If a file cannot be read.

    Notes
    -----
    No power flow is solved: voltages and powers are taken from the case, and refused if they miss
    the balance by more than `mismatch`. The files of MATPOWER hold rounded or no solutions:
    ``case39`` is solved to 10^-4 pu, ``case14`` to 0.04 and ``case9`` not at all.

    The classical model leaves much out: a machine is a constant voltage behind x'd, with
    constant mechanical power but for the input, without governor, exciter, stabilizer and
    saliency; loads are constant impedances; the network is in steady state. It describes the
    first swing and the frequencies of the electromechanical modes, not their damping. Shunts,
    resistances, taps and phase shifts are kept; DC lines are refused. Branches to isolated buses
    (type 4) and generators there are out of service, as in MATPOWER. Only angle differences
    matter, so ``A`` has the eigenvalue 1.

    References
    ----------
    P. M. Anderson and A. A. Fouad, *Power System Control and Stability*, ch. 2 and 3.
    R. D. Zimmerman, C. E. Murillo-Sanchez and R. J. Thomas, "MATPOWER: Steady-state operations,
    planning, and analysis tools for power systems research and education", IEEE Trans. Power
    Systems 26(1), 2011.

    Examples
    --------
    One machine at bus 1 and a strong one at bus 2, joined by a line of 0.5 pu:

    >>> from stochens_rs.cases import from_matpower
    >>> case = {
    ...     "baseMVA": 100.0,
    ...     "bus": [[1, 3, 0, 0, 0, 0, 1, 1.0, 0.0], [2, 2, 0, 0, 0, 0, 1, 1.0, 0.0]],
    ...     "gen": [[1, 0, 0, 0, 0, 1, 100, 1], [2, 0, 0, 0, 0, 1, 100, 1]],
    ...     "branch": [[1, 2, 0, 0.5, 0, 0, 0, 0, 0, 0, 1]],
    ... }
    >>> machines = {1: {"H": 4.0, "D": 2.0, "xd1": 0.3}, 2: {"H": 400.0, "D": 2.0, "xd1": 0.01}}
    >>> from_matpower(case, machines, dt=0.05)
    <System case (classical model, 60 Hz, zoh): n=4 m=2 dt=0.05>
    """
    validation.choice("base", base, ("system", "machine"))
    mismatch = validation.positive("mismatch", mismatch)
    if frequency is not None:
        frequency = checked_frequency(frequency)
    data = read_machines(machines)
    network = read_network(case)
    check_balance(network, mismatch)
    data = matched(network, data).on(base, network.mva, network.rating)
    hertz = frequency or checked_frequency(network.frequency or FREQUENCY_HZ)
    with np.errstate(all="ignore"):  # what is not finite is refused
        A_c, B_c = swing_matrices(synchronizing(network, data.xd1), data.H, data.D, hertz)
    A, B = discretize(A_c, B_c, dt, method)
    name = f"{network.name[:60]} (classical model, {hertz:g} Hz, {method})"
    return System(A, B, dt=dt, name=name, **swing_labels(network.label[network.at].tolist()))


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
                "; a plant without inertia is a negative load: take it out of gen and subtract its "
                "power from PD and QD"
            )
            raise InputError(
                "`machines` must have one row per generator in service: bus "
                f"{network.label[bus]} has {units[bus]}, got {len(found)}{'' if found else hint}"
            )
        if len({int(machines.bus[row]) for row in found}) > 1:
            raise InputError(
                f"`machines` names one bus ({network.label[bus]}) by two numbers: use one for "
                "all its rows, in the order of the generators"
            )
    order = [rows[int(bus)].pop(0) for bus in network.at]
    mva = None if machines.mva is None else machines.mva[order]
    H, D, xd1 = (column[order] for column in (machines.H, machines.D, machines.xd1))
    return Machines(machines.bus[order], H, D, xd1, mva)


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
