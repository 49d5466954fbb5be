"""The classical model of a network whose power flow is solved, as a linear system."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal

import numpy as np

from .._base import validation
from .._base.discretize import discretize
from .._base.files import checked_path
from ..system import System
from ._classical import check_balance, matched, synchronizing
from ._machines import read_machines
from ._network import read_file, read_network
from ._swing import FREQUENCY_HZ, checked_frequency, swing, swing_labels

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
        If the file is no MATPOWER case, or computes something else than the notes say.
    ImportError
        If matpowercaseframes is not installed (extra ``grids``).
    OSError
        If the file cannot be read.

    Notes
    -----
    Of what a file computes beside its tables, assignments to their entries are executed, in order:
    ``mpc.bus(:, [PD, QD]) = mpc.bus(:, [PD, QD]) / 1e3``, ``mpc.branch(7, BR_STATUS) = 0``, with
    numbers, named numbers, ``idx_bus``, ``idx_brch``, ``idx_gen`` and ``define_constants``. All
    other statements are refused with their line.

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
        A_c, B_c = swing(synchronizing(network, data.xd1), data.H, data.D, hertz)
    A, B = discretize(A_c, B_c, dt, method)
    name = f"{network.name[:60]} (classical model, {hertz:g} Hz, {method})"
    return System(A, B, dt=dt, name=name, **swing_labels(network.label[network.at].tolist()))
