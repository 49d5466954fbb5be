"""Data of networks: solved power flows and synchronous machines, from files and mappings."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from .._base import running, validation
from .._base.files import checked_path
from .._base.tables import extra
from .._base.types import Floats, NDArray
from ..data.table import Table
from ..exceptions import InputError, InputTypeError, ShapeError

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
            k = int(np.argmax(wrong))
            raise InputError(
                f"`machines['{name}']` must be {'>= 0' if name == 'D' else '> 0'}, "
                f"got {values[k]:g} at bus {bus[k]:.0f}"
            )
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
                raise InputTypeError(
                    f"`machines[{validation.show(bus)}]` must be a mapping with H, D and xd1, "
                    f"got {validation.show(row)}"
                )
        names = dict.fromkeys(name for row in machines.values() for name in row)
        some = [name for name in names if any(name not in row for row in machines.values())]
        if some or not names:
            raise InputError(
                "`machines` must give H, D and xd1 for every bus, "
                f"got {some[0] if some else 'nothing'} for some only"
            )
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
            f"{_WANTED}, got {validation.show(machines)}"
        ) from None
    return columns


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
        path = Path(checked_path("case", case))
        return _network(read_file(path), path.stem, None)
    if getattr(case, "_ppc", ...) is not ...:
        return _pandapower(case)
    if isinstance(case, Mapping):
        return _network(case, "case", None)
    raise InputTypeError(
        "`case` must be the path of a MATPOWER .m file, a MATPOWER dictionary or a pandapower "
        f"net, got {validation.show(case)}"
    )


def read_file(path: Path) -> dict[str, Any]:
    """All tables of a MATPOWER file that computes nothing."""
    if path.suffix.lower() != ".m":
        raise InputError(f"`case` must be a MATPOWER .m file, got {path}")
    path.stat()  # a missing file is an OSError
    if not path.is_file():
        raise InputError(f"{path} must be a regular file")
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
        raise InputError(
            "`case` must have baseMVA, bus, gen and branch, as a MATPOWER case has; "
            f"{missing} is missing"
        )
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
