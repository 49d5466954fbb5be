"""Synchronous machines and networks of them without losses; random systems."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from .._base import running, validation
from .._base.files import checked_path
from .._base.running import interruptible
from .._base.types import ArrayLike, Floats, NDArray
from .._base.validation import show
from ..data.table import Table
from ..exceptions import InputError, InputTypeError, SizeError
from ..rng import RngLike, as_key
from ..system.conversions import discretize
from ..system.system import System

Base = Literal["system", "machine"]

_NEEDED = ("bus", "H", "D", "xd1")
_WANTED = "the columns bus, H, D and xd1, and optionally mva"


class Machines(NamedTuple):
    """One entry per machine, in per unit on the rating `mva`, or on the system base without it."""

    bus: NDArray[np.int64]
    H: Floats
    D: Floats
    xd1: Floats
    mva: Floats | None

    def on(self, base: Base, system_mva: float, ratings: Floats | None) -> Machines:
        """On the system base; `ratings` [MVA] are those of the case, if it has them."""
        if base == "system":
            if self.mva is not None:
                raise InputError(
                    "`machines` has a column mva: pass base='machine' to convert from these "
                    "ratings, or leave the column out if the data is on the system base"
                )
            return self
        mva = ratings if self.mva is None else self.mva
        if mva is None:
            raise InputError("`machines` must have a column mva with base='machine'")
        if not (mva > 0.0).all():
            raise InputError(
                f"the rating of the machine at bus {self.bus[np.argmin(mva > 0.0)]} must be "
                f"> 0 MVA, got {mva.min():g}: give `machines` a column mva"
            )
        # Reactances shrink and inertia and damping grow with the rating of the machine.
        ratio = mva / system_mva
        return Machines(self.bus, self.H * ratio, self.D * ratio, self.xd1 / ratio, None)


def read_machines(machines: object) -> Machines:
    """Return the machines, checked: whole bus numbers, H and xd1 > 0, D >= 0."""
    columns = _columns(machines)
    missing = next((name for name in _NEEDED if name not in columns), None)
    if missing is not None:
        hint = "; xd is the synchronous reactance, xd1 the transient one" if "xd" in columns else ""
        raise InputError(f"`machines` must have {_WANTED}; {missing} is missing{hint}")
    bus = validation.vector("machines['bus']", columns["bus"])
    if (np.floor(bus) != bus).any() or (np.abs(bus) > validation.EXACT).any():
        raise InputError("`machines['bus']` must hold whole numbers, the numbers of the buses")
    found: dict[str, Any] = {"mva": None}
    for name in (name for name in ("H", "D", "xd1", "mva") if name in columns):
        values = validation.vector(f"machines['{name}']", columns[name], length=len(bus))
        wrong = values < 0.0 if name == "D" else values <= 0.0
        if wrong.any():
            k, rule = int(np.argmax(wrong)), ">= 0" if name == "D" else "> 0"
            value = f"{values[k]:g} at bus {bus[k]:.0f}"
            raise InputError(f"`machines['{name}']` must be {rule}, got {value}")
        found[name] = values
    return Machines(bus.astype(np.int64), **found)


def _columns(machines: object) -> dict[str, Any]:
    """The columns of a CSV file, of a mapping of columns or of rows by bus, or of a DataFrame."""
    if isinstance(machines, (str, os.PathLike)):
        table, known = Table.of_file(checked_path("machines", machines)), {*_NEEDED, "mva"}
        read = {k: table.numbers("machines", k, whole=True) for k in table.names if k in known}
        return dict.fromkeys(table.names) | read
    if isinstance(machines, Mapping):
        if any(name in machines for name in _NEEDED):
            return {str(name): column for name, column in machines.items()}
        for bus, row in machines.items():
            if not isinstance(row, Mapping):
                raise InputTypeError(f"`machines[{bus!r}]` must be a mapping, got {show(row)}")
        names = dict.fromkeys(name for row in machines.values() for name in row)
        some = [name for name in names if any(name not in row for row in machines.values())]
        if some or not names:
            missing = some[0] if some else "nothing"
            raise InputError(f"`machines` must have {_WANTED} for each bus, got {missing} for some")
        rows = {str(name): [row[name] for row in machines.values()] for name in names}
        return {"bus": list(machines)} | rows
    frame: Any = machines
    try:
        columns = {str(name): np.asarray(frame[name]) for name in frame.columns}
        if frame.index.name == "bus":
            columns.setdefault("bus", np.asarray(frame.index))
    except Exception:  # not a DataFrame; anything a foreign object raises
        raise InputTypeError(
            "`machines` must be a mapping, a DataFrame or the path of a CSV file with "
            f"{_WANTED}, got {show(machines)}"
        ) from None
    return columns


SYSTEM_MVA = 100.0  # base power of the IEEE test networks
FREQUENCY_HZ = 60.0  # North America
# Branches (from, to, x) with x in per unit on 100 MVA, and the buses of the generators; and per
# generator its rating in MVA, H in s, x'd and D in per unit on that rating.
_DATA = json.loads(Path(__file__).with_name("networks.json").read_text("utf-8"))
NETWORKS = {int(k): (one["branches"], one["generators"]) for k, one in _DATA["networks"].items()}
MACHINES = {name: np.array(rows) for name, rows in _DATA["machines"].items()}


def random_system(n: int, m: int, rng: RngLike = None, *, spectral_radius: float = 1.0) -> System:
    """Draw a Gaussian ``A`` with a given spectral radius and a Gaussian ``B``.

    Parameters
    ----------
    n : int
        Number of states.
    m : int
        Number of inputs. With ``m < n`` a random target is not reachable in one step.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness.
    spectral_radius : float, default 1.0
        Largest modulus of an eigenvalue of ``A``, positive.

    Returns
    -------
    System
        ``A`` (n, n) is ``G * spectral_radius / rho(G)`` and ``B`` (n, m), with the entries of
        ``G``, then those of ``B``, independent standard normal in row-major order. ``dt`` is True
        (discrete time, no unit).

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    ResourceError
        If the matrices do not fit into the memory this process may use.

    Notes
    -----
    The normal variates are NumPy's (``Generator(Philox).standard_normal``). Another version of
    NumPy may give another system for the same ``rng``; save ``A`` and ``B`` to keep them.

    Examples
    --------
    >>> import numpy as np
    >>> from stochens_rs.cases import random_system
    >>> system = random_system(4, 2, rng=7, spectral_radius=0.9)
    >>> bool(np.isclose(np.abs(np.linalg.eigvals(system.A)).max(), 0.9))
    True
    """
    n, m = validation.size("n", n), validation.size("m", m)
    spectral_radius = validation.positive("spectral_radius", spectral_radius)
    # A, its copy in the eigenvalue routine, the scaled A, and B
    running.need("the random system", 8 * (3 * n * n + n * m))
    normal = as_key(rng).child("random_system").generator()

    def matrices() -> tuple[Floats, Floats]:
        G, B = normal.standard_normal((n, n)), normal.standard_normal((n, m))
        return G * (spectral_radius / float(np.abs(np.linalg.eigvals(G)).max())), B

    A, B = interruptible(matrices)
    return System(A, B, dt=True, name=f"random ({n} x {n}, spectral radius {spectral_radius:g})")


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
    machines = MACHINES[data].copy()
    if base == "machine":
        machines[:, 0] = SYSTEM_MVA
    return _ieee(14, machines, dt, method, f"{data} data, {base} base")


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
    return _ieee(39, MACHINES["pai"], dt, method, "Pai data, system base")


def _ieee(
    buses: int, machines: Floats, dt: float, method: Literal["zoh", "euler"], about: str
) -> System:
    branches, at = NETWORKS[buses]
    validation.choice("method", method, ("zoh", "euler"))
    name = f"IEEE {buses}-bus ({about}, {method})"
    data = dict(zip(("bus", "mva", "H", "xd1", "D"), (at, *machines.T), strict=True))
    return swing(branches, data, dt=dt, method=method, base="machine", name=name)


def swing(
    branches: ArrayLike,
    machines: object,
    *,
    dt: float = 0.01,
    method: Literal["zoh", "euler"] = "zoh",
    base: Literal["system", "machine"] = "system",
    base_mva: float = SYSTEM_MVA,
    frequency: float = FREQUENCY_HZ,
    name: str | None = None,
) -> System:
    """Lossless swing model of a network, reduced to its machines: the model of `ieee14`.

    Parameters
    ----------
    branches : array_like, shape (b, 3)
        Rows ``(from, to, x)``: two bus numbers and the series reactance of the line or
        transformer [pu on `base_mva`], positive.
    machines : mapping, DataFrame or path of a CSV file
        As in :func:`from_matpower`: ``bus``, ``H`` [s], ``D`` [pu], ``xd1`` [pu], optionally
        ``mva``.
    dt : float, default 0.01
        Step in seconds.
    method : {"zoh", "euler"}, default "zoh"
        ``"zoh"`` is exact for inputs held over a step, ``"euler"`` is ``I + dt A``.
    base : {"system", "machine"}, default "system"
        Whether the machines are given on `base_mva`, or each on its ``mva``.
    base_mva : float, default 100
        Base power of the system.
    frequency : float, default 60
        Nominal frequency [Hz].
    name : str, optional
        Label of the system.

    Returns
    -------
    System
        For g machines, in their order: ``A`` (2 g, 2 g), ``B`` (2 g, g). States: rotor angles
        [rad], then speed deviations [rad/s]. Inputs: mechanical powers [pu on `base_mva`].

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    ResourceError
        If the stiffness matrix does not fit into the memory this process may use.

    Notes
    -----
    ``M delta'' + D delta' + L delta = P`` with ``M = 2 H / w0``. A machine is a constant voltage
    behind x'd. The network has no resistances, charging, taps and loads, all voltages are 1 pu,
    and it is linearized at equal angles: a reactance x is a spring of stiffness 1/x, and ``L`` is
    what remains of the springs when the buses are eliminated. Modes come out too fast where
    machines are heavily loaded; :func:`from_matpower` keeps all that at an operating point.

    References
    ----------
    F. Doerfler and F. Bullo, "Kron reduction of graphs with applications to electrical networks",
    IEEE Trans. Circuits and Systems I 60(1), 2013.

    Examples
    --------
    >>> from stochens_rs.cases import swing
    >>> machines = {"bus": [1, 3], "H": [4.0, 6.0], "D": [2.0, 2.0], "xd1": [0.3, 0.2]}
    >>> swing([[1, 2, 0.1], [2, 3, 0.2]], machines, dt=0.05, name="two machines")
    <System two machines: n=4 m=2 dt=0.05>
    """
    validation.choice("base", base, ("system", "machine"))
    given = validation.matrix("branches", branches, cols=3)
    if not (given[:, 2] > 0.0).all():
        k = int(np.argmin(given[:, 2]))
        raise InputError(f"`branches[{k}]` must have a reactance > 0, got {given[k, 2]:g}")
    data = read_machines(machines).on(base, validation.positive("base_mva", base_mva), None)
    buses = data.bus.tolist()
    numbers, ends = np.unique(given[:, :2], return_inverse=True)
    place = {float(number): k for k, number in enumerate(numbers)}
    lost = next((bus for bus in buses if bus not in place), None)
    if lost is not None:
        raise InputError(f"`machines` names bus {lost}, which no branch has")
    running.need(f"the stiffness of {len(numbers)} buses", 8 * 3 * len(numbers) ** 2)
    rows = np.column_stack([ends.reshape(-1, 2) + 1, given[:, 2]])
    at = [place[bus] + 1 for bus in buses]
    hertz = checked_frequency(frequency)
    with np.errstate(all="ignore"):  # what is not finite is refused
        try:
            L = reduced_stiffness(len(numbers), rows, at, data.xd1)
        except np.linalg.LinAlgError:
            raise InputError("`branches` must connect every bus to a machine") from None
        A_c, B_c = swing_matrices(validation.matrix("L", L), data.H, data.D, hertz)
    A, B = discretize(A_c, B_c, dt, method)
    return System(A, B, dt=dt, name=name, **swing_labels(buses))


def checked_frequency(frequency: object) -> float:
    """Return a nominal frequency in Hz."""
    hertz = validation.positive("frequency", frequency, maximum=1000.0)
    if hertz < 1.0:
        raise SizeError(f"`frequency` must be at least 1 Hz, got {hertz:g}")
    return hertz


def reduced_stiffness(buses: int, branches: ArrayLike, at: Sequence[int], xd: Floats) -> Floats:
    """Stiffness between the generators after the buses are eliminated (Kron reduction).

    Parameters
    ----------
    buses : int
        Number of buses, numbered from 1.
    branches : rows (from, to, x)
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
    table = np.asarray(branches, dtype=float)
    ends, stiffness = table[:, :2].astype(np.int64) - 1, 1.0 / table[:, 2]
    L_ll = np.zeros((buses, buses))
    np.add.at(L_ll, (ends.ravel(), ends.ravel()), np.repeat(stiffness, 2))
    np.add.at(L_ll, (ends, ends[:, ::-1]), -stiffness[:, None])
    bus = np.asarray(at) - 1
    # The edge between a generator's internal node and its bus has stiffness 1/x'd.
    L_gl = np.zeros((bus.size, buses))
    L_gl[np.arange(bus.size), bus] = -1.0 / xd
    np.add.at(L_ll, (bus, bus), 1.0 / xd)
    L_red = np.diag(1.0 / xd) - L_gl @ np.linalg.solve(L_ll, L_gl.T)
    return np.asarray((L_red + L_red.T) / 2.0, dtype=np.float64)


def swing_matrices(
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
    w0 = 2.0 * np.pi * frequency
    M = 2.0 * H / w0
    zero, one = np.zeros((H.size, H.size)), np.eye(H.size)
    A = np.block([[zero, one], [-L_red / M[:, None], np.diag(-(D / w0) / M)]])
    return A, np.vstack([zero, np.diag(1.0 / M)])


def swing_labels(buses: Sequence[int]) -> dict[str, Any]:
    """Names and units of states and inputs, as arguments of `System`.

    Further machines at a bus are counted: 1, 1_2, 1_3.
    """
    again = [list(buses[: k + 1]).count(bus) for k, bus in enumerate(buses)]
    machines = [f"{b}" if k == 1 else f"{b}_{k}" for b, k in zip(buses, again, strict=True)]
    units = {
        f"{word}_{machine}": unit
        for word, unit in (("delta", "rad"), ("omega", "rad/s"), ("T_m", "pu"))
        for machine in machines
    }
    names = list(units)
    return {"states": names[: -len(machines)], "inputs": names[-len(machines) :], "units": units}
