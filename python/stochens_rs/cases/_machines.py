"""Data of synchronous machines from a mapping, a DataFrame or a CSV file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

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


@dataclass(frozen=True, eq=False)
class Machines:
    """One entry per machine, in per unit on the rating `mva`, or on the system base without it."""

    bus: NDArray[np.int64]
    H: Floats
    D: Floats
    xd1: Floats
    mva: Floats | None

    def take(self, rows: list[int]) -> Machines:
        """These rows, in this order."""
        mva = None if self.mva is None else self.mva[rows]
        return Machines(self.bus[rows], self.H[rows], self.D[rows], self.xd1[rows], mva)

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
            bus = self.bus[int(np.argmin(mva > 0.0))]
            raise InputError(
                f"the rating of the machine at bus {bus} must be > 0 MVA, got {mva.min():g}: "
                "give `machines` a column mva"
            )
        # Reactances shrink and inertia and damping grow with the rating of the machine.
        ratio = mva / system_mva
        return Machines(self.bus, self.H * ratio, self.D * ratio, self.xd1 / ratio, None)


def read_machines(machines: object) -> Machines:
    """Return the machines, checked: whole bus numbers, H and xd1 > 0, D >= 0."""
    columns = _columns(machines)
    if "xd1" not in columns and "x'd" in columns:
        columns["xd1"] = columns["x'd"]
    missing = [name for name in _NEEDED if name not in columns]
    if missing:
        hint = (
            "; xd is the synchronous reactance, xd1 the transient one"
            if missing == ["xd1"] and "xd" in columns
            else ""
        )
        raise InputError(f"`machines` must have {_WANTED}; {missing[0]} is missing{hint}")
    bus = validation.vector("machines['bus']", columns["bus"])
    if not (np.floor(bus) == bus).all() or not (np.abs(bus) <= validation.EXACT).all():
        raise InputError("`machines['bus']` must hold whole numbers, the numbers of the buses")
    found = {
        name: validation.vector(f"machines['{name}']", columns[name], length=len(bus))
        for name in ("H", "D", "xd1", "mva")
        if name in columns
    }
    for name, values in found.items():
        wrong = values < 0.0 if name == "D" else values <= 0.0
        if wrong.any():
            k = int(np.argmax(wrong))
            raise InputError(
                f"`machines['{name}']` must be {'>= 0' if name == 'D' else '> 0'}, "
                f"got {values[k]:g} at bus {bus[k]:.0f}"
            )
    return Machines(bus.astype(np.int64), found["H"], found["D"], found["xd1"], found.get("mva"))


def _columns(machines: object) -> dict[str, Any]:
    if isinstance(machines, (str, os.PathLike)):
        return _csv(checked_path("machines", machines))
    if isinstance(machines, Mapping):
        if any(name in machines for name in _NEEDED):
            return {str(name): column for name, column in machines.items()}
        return _of_rows(machines)
    frame: Any = machines
    try:
        columns = {str(name): np.asarray(frame[name]) for name in frame.columns}
        if "bus" not in columns and frame.index.name == "bus":
            columns["bus"] = np.asarray(frame.index)
    except Exception:  # not a DataFrame; anything a foreign object raises
        raise InputTypeError(
            "`machines` must be a mapping, a DataFrame or the path of a CSV file with "
            f"{_WANTED}, got {validation.show(machines)}"
        ) from None
    return columns


def _of_rows(machines: Mapping[Any, Any]) -> dict[str, Any]:
    """Columns of {bus: {"H": ..., "D": ..., "xd1": ...}}."""
    columns: dict[str, list[Any]] = {"bus": list(machines)}
    for bus, row in machines.items():
        if not isinstance(row, Mapping):
            raise InputTypeError(
                f"`machines[{validation.show(bus)}]` must be a mapping with H, D and xd1, "
                f"got {validation.show(row)}"
            )
        for name, value in row.items():
            columns.setdefault(str(name), []).append(value)
    uneven = [name for name, column in columns.items() if len(column) != len(machines)]
    if uneven or len(columns) == 1:
        raise InputError(
            "`machines` must give H, D and xd1 for every bus, "
            f"got {uneven[0] if uneven else 'nothing'} for some only"
        )
    return columns


def _csv(path: str) -> dict[str, Any]:
    table, known = Table.of_file(path), {*_NEEDED, "x'd", "mva"}
    read = {k: table.numbers("machines", k, whole=True) for k in table.names if k in known}
    return dict.fromkeys(table.names) | read
