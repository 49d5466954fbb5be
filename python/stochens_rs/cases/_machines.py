"""Data of synchronous machines from a mapping, a DataFrame or a CSV file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._base import validation
from .._base.files import checked_path
from .._base.types import Floats
from ..data.table import Table
from ..exceptions import InputError, InputTypeError

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
    if "x'd" in columns:
        columns.setdefault("xd1", columns["x'd"])
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
        table, known = Table.of_file(checked_path("machines", machines)), {*_NEEDED, "x'd", "mva"}
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
