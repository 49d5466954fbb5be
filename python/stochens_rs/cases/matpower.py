"""Solved cases of MATPOWER, pypower and pandapower: their tables, and their classical model."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from .._base import running, validation
from .._base.files import checked_path, regular_file
from .._base.tables import extra
from .._base.types import Floats, NDArray
from ..exceptions import InputError, InputTypeError, ShapeError
from ..system.conversions import discretize
from ..system.system import System
from .swing_models import (
    FREQUENCY_HZ,
    Machines,
    checked_frequency,
    read_machines,
    swing_labels,
    swing_matrices,
)

__all__ = ["from_matpower", "read_matpower"]


Complex = NDArray[np.complex128]
Indices = NDArray[np.int64]

# Columns of the tables (MATPOWER User's Manual, appendix B), counted from 0.
BUS, TYPE, PD, QD, GS, BS, VM, VA = 0, 1, 2, 3, 4, 5, 7, 8
GEN_BUS, PG, QG, MBASE, GEN_STATUS = 0, 1, 2, 6, 7
FROM, TO, R, X, CHARGING, TAP, SHIFT, STATUS = 0, 1, 2, 3, 4, 8, 9, 10
# Added by pandapower: what the `to` end differs by, and the conductance to ground.
R_ASYM, X_ASYM, G, G_ASYM, B_ASYM = 21, 22, 23, 24, 25
WIDTH = {"bus": 9, "gen": 8, "branch": 11}
STATE = {"bus": TYPE, "gen": GEN_STATUS, "branch": STATUS}
USED = {
    "bus": (BUS, TYPE, PD, QD, GS, BS, VM, VA),
    "gen": (GEN_BUS, PG, QG, GEN_STATUS),  # and MBASE, which may be nan
    "branch": (FROM, TO, R, X, CHARGING, TAP, SHIFT, STATUS, R_ASYM, X_ASYM, G, G_ASYM, B_ASYM),
}
ISOLATED = 4  # type of a bus without connection
_TEXTS = ("bus_name", "branch_name", "gen_name")
# Comments and what is behind the dots of a continued line; or a text in quotation marks.
_COMMENT = re.compile(
    r"^[ \t]*%\{[ \t]*$.*?^[ \t]*%\}[ \t]*$|%[^\n]*|\.\.\.[^\n]*|('[^'\n]*'|\"[^\"\n]*\")",
    re.DOTALL | re.MULTILINE,
)
# `function mpc = case9`, `end`, and a name of `mpc` that is a table, a cell, a text or a number.
_PLAIN = re.compile(
    r"(?<![^\s;,])(?:function\s+mpc\s*=\s*\w+|end|return|"
    r"mpc\.([\w.]+)\s*=\s*(?:\[[^\[\]]*\]|\{[^{}]*\}|(?:'')+|[-+\d.eE]+))(?![^\s;,])"
)


class Network(NamedTuple):
    """Buses 0, 1, ... with all values in per unit on `mva`; generators in service only.

    Attributes
    ----------
    name : str
        Of the case.
    mva : float
        Base power of the system.
    frequency : float or None
        In Hz, if the case says it.
    bus_of : dict of int to int
        From the numbers of the case to 0, 1, ....
    label : (n,) array of int
        The numbers of the case.
    Y : (n, n) complex array
        Bus admittance matrix with shunts, without loads.
    V, load : (n,) complex arrays
        Voltages and consumed powers.
    at : (g,) array of int
        The buses of the generators.
    power : (g,) complex array
        What they feed in.
    rating : (g,) array
        In MVA.
    """

    name: str
    mva: float
    frequency: float | None
    bus_of: dict[int, int]
    label: Indices
    Y: Complex
    V: Complex
    load: Complex
    at: Indices
    power: Complex
    rating: Floats


def read_network(case: object) -> Network:
    """Return the network of any of the three kinds of cases."""
    if isinstance(case, (str, os.PathLike)):
        path = checked_path("case", case)
        return _network(read_matpower(path), Path(path).stem, None)
    if getattr(case, "_ppc", ...) is not ...:
        return _pandapower(case)
    if isinstance(case, Mapping):
        return _network(case, "case", None)
    wanted = "the path or dictionary of a MATPOWER case or a pandapower net"
    raise InputTypeError(f"`case` must be {wanted}, got {validation.show(case)}")


def _refuse_statements(path: Path) -> None:
    """Refuse a file with more than one table of each name: what it computes is not executed."""
    seen: set[str] = set()

    def without(found: re.Match[str]) -> str:
        if found[1] in seen:
            return found[0]
        seen.update(filter(None, (found[1],)))
        return "\n" * found[0].count("\n")

    text = path.read_text(encoding="utf-8", errors="replace")
    text = _COMMENT.sub(lambda one: "''" if one[1] else "\n" * one[0].count("\n"), text)
    text = _PLAIN.sub(without, text)
    statement = re.search(r"[^\s;,][^\n]*", text)
    if statement is not None:
        line = text.count("\n", 0, statement.start()) + 1
        raise InputError(
            f"{path}, line {line}: {statement[0][:60]!r} is no table of numbers, and nothing is "
            "computed here: run loadcase and savecase in MATPOWER and pass that file"
        )


def _pandapower(net: Any) -> Network:
    try:
        tables, lookup = net._ppc, np.asarray(net._pd2ppc_lookups["bus"])
        solved = bool(net.converged) and tables is not None
        frequency, name = float(net.f_hz), net.name
    except Exception:  # anything a foreign object raises
        solved = False
    if not solved:
        raise InputError("`case` has no solved power flow: call pandapower.runpp(net) first")
    # Buses joined by a closed switch are one bus; -1 stands for no bus.
    numbers = {k: int(lookup[k]) for k in range(len(lookup)) if lookup[k] >= 0}
    label = str(name) if isinstance(name, str) and name else "pandapower net"
    return _network(tables, label, numbers, frequency)


def _network(
    case: Mapping[str, Any],
    name: str,
    numbers: dict[int, int] | None,
    frequency: float | None = None,
) -> Network:
    """`numbers` are names of the buses that differ from those in the tables."""
    missing = next((key for key in ("baseMVA", *WIDTH) if key not in case), None)
    if missing is not None:
        raise InputError(f"`case` must have baseMVA, bus, gen and branch, {missing} is missing")
    base = case["baseMVA"]
    base = base.item() if isinstance(base, np.ndarray) else base
    mva = validation.positive("case['baseMVA']", base)
    (bus, _), (gen, _), (branch, places) = (_table(case, key) for key in WIDTH)
    lines = case.get("dcline")
    for row in np.atleast_2d(np.asarray([] if lines is None else lines, dtype=float)):
        if len(row) and row[2] > 0:
            raise InputError(
                "`case['dcline']` must have no DC lines in service, got one from bus "
                f"{row[0]:g} to bus {row[1]:g}: make it a load at the one and a negative load at "
                "the other, with the powers of the solved case, and set its status to 0"
            )
    # as MATPOWER: what is at an isolated bus is out of service
    every = np.asarray(case["bus"], dtype=float)
    isolated = every[every[:, TYPE] == ISOLATED, BUS]
    gen = gen[~np.isin(gen[:, GEN_BUS], isolated)]
    joined = ~np.isin(branch[:, [FROM, TO]], isolated).any(axis=1)
    branch, places = branch[joined], places[joined]
    label = bus[:, BUS].astype(np.int64)
    index = {int(number): k for k, number in enumerate(label)}
    if len(index) < len(bus):
        raise InputError("`case['bus']` must have every bus number once")
    at = _indices("case['gen']", gen[:, GEN_BUS], index)
    f, t = (_indices("case['branch']", branch[:, column], index) for column in (FROM, TO))
    running.need(f"the admittances of {len(bus)} buses", 16 * 4 * len(bus) ** 2)
    Y = _admittances(branch, places, f, t, len(bus))
    np.fill_diagonal(Y, Y.diagonal() + (bus[:, GS] + 1j * bus[:, BS]) / mva)
    if not (bus[:, VM] > 0.0).all():
        k = int(np.argmin(bus[:, VM]))
        raise InputError(f"`case` must have voltages > 0, got {bus[k, VM]:g} at bus {label[k]}")
    V: Any = bus[:, VM] * np.exp(1j * np.deg2rad(bus[:, VA]))
    load: Any = (bus[:, PD] + 1j * bus[:, QD]) / mva
    power: Any = (gen[:, PG] + 1j * gen[:, QG]) / mva
    if numbers is not None:
        index = {outer: index[inner] for outer, inner in numbers.items() if inner in index}
        for outer in reversed(index):  # the first of several names of one bus
            label[index[outer]] = outer
    return Network(name, mva, frequency, index, label, Y, V, load, at, power, gen[:, MBASE])


def _table(case: Mapping[str, Any], key: str) -> tuple[Floats, Indices]:
    """The rows in service, as floats that are finite where they are used, and their places."""
    name = f"case['{key}']"
    given = validation.read(name, case[key])
    if given.ndim != 2 or not len(given) or given.shape[1] < WIDTH[key]:
        raise ShapeError(
            f"`{name}` must have one row or more, of at least the {WIDTH[key]} columns of "
            f"MATPOWER's format, got shape {given.shape}"
        )
    if given.dtype.kind not in "iuf":
        validation.matrix(name, given)  # raises
    status = given[:, STATE[key]]
    rows = status != ISOLATED if key == "bus" else status > 0
    used = rows[:, None] & np.isin(np.arange(given.shape[1]), USED[key])
    table = validation.matrix(name, np.where(used, given, 0)).copy()  # the rest may be nan
    if key == "gen":
        table[:, MBASE] = given[:, MBASE]
    if not rows.any():
        raise InputError(f"`{name}` has no row in service")
    return table[rows], np.flatnonzero(rows)


def _indices(name: str, numbers: Floats, index: dict[int, int]) -> Indices:
    unknown = next((number for number in numbers if number not in index), None)
    if unknown is not None:
        raise InputError(f"`{name}` names bus {unknown:g}, which is not in `case['bus']`")
    return np.array([index[int(number)] for number in numbers], dtype=np.int64)


def _admittances(branch: Floats, places: Indices, f: Indices, t: Indices, buses: int) -> Complex:
    """Bus admittance matrix (MATPOWER User's Manual, section 3.2: pi model with a transformer)."""
    own = np.zeros((len(branch), 5))  # in MATPOWER's format both ends are alike
    if branch.shape[1] > B_ASYM:
        own = branch[:, [R_ASYM, X_ASYM, G, G_ASYM, B_ASYM]]
    z = branch[:, R] + 1j * branch[:, X]
    z_t = z + own[:, 0] + 1j * own[:, 1]
    if not (z.all() and z_t.all()):
        k = int(np.argmin(np.abs(z * z_t)))
        raise InputError(f"`case['branch'][{places[k]}]` has no impedance: join its two buses")
    charging = own[:, 2] + 1j * branch[:, CHARGING]
    ratio = np.where(branch[:, TAP] == 0.0, 1.0, branch[:, TAP])
    tap = ratio * np.exp(1j * np.deg2rad(branch[:, SHIFT]))
    Y = np.zeros((buses, buses), dtype=np.complex128)
    np.add.at(Y, (f, f), (1.0 / z + charging / 2.0) / ratio**2)
    np.add.at(Y, (f, t), -1.0 / (z * tap.conj()))
    np.add.at(Y, (t, f), -1.0 / (z_t * tap))
    np.add.at(Y, (t, t), 1.0 / z_t + (charging + own[:, 3] + 1j * own[:, 4]) / 2.0)
    return Y


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
    path = Path(checked_path("path", path))
    if path.suffix.lower() != ".m":
        raise InputError(f"`case` must be a MATPOWER .m file, got {path}")
    regular_file(path)
    with extra(f"{path} is a MATPOWER file, read by matpowercaseframes", "grids"):
        import matpowercaseframes
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the parser, about pandas
            frames = matpowercaseframes.CaseFrames(str(path))
        tables: dict[str, Any] = {"version": "2", "baseMVA": frames.baseMVA}
        for name in frames.attributes:
            frame = getattr(frames, name)
            if name in WIDTH or (hasattr(frame, "to_numpy") and name not in _TEXTS):
                tables[name] = frame.to_numpy(dtype=float, copy=True)
        tables = {name: tables[name] for name in (*tables, *WIDTH)}
    except Exception as error:  # of the parser, on a file of another kind
        raise InputError(
            f"{path} must be a MATPOWER case with numbers in bus, gen and branch "
            f"({type(error).__name__}: {str(error)[:80]})"
        ) from error
    _refuse_statements(path)
    return tables


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
