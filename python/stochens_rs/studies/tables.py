"""Results of a study as tables, data sets and files."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._base import files, gate, plain
from .._base.extras import extra
from .._base.files import PathLike
from .._base.types import Floats, Status
from .grid import Label

if TYPE_CHECKING:
    import pandas
    import xarray

SCHEMA = "stochens-results/1"
SUFFIXES = (".parquet", ".nc", ".json")


@dataclass(frozen=True)
class Failure:
    """A replicate that raised.

    Attributes
    ----------
    configuration : dict
        The label on each axis, but for the nested one.
    replicate : int
    error : str
        Type and message.
    """

    configuration: dict[str, Label]
    replicate: int
    error: str


class Tabled:
    """Base of `Results`: what they are turned into."""

    status: Status
    grid: dict[str, tuple[Label, ...]]
    replicates: range
    values: dict[str, Floats]
    done: NDArray[np.bool_]
    failed: NDArray[np.bool_]
    failures: list[Failure]
    about: dict[str, str]
    seconds: float
    units: dict[str, str]

    def to_dict(self) -> dict[str, Any]:
        """Plain lists and numbers, ready for ``json.dumps``.

        Returns
        -------
        dict
            nan as None, infinite numbers as the texts "inf" and "-inf".
        """
        return {
            "schema": SCHEMA,
            "status": self.status,
            **self.about,
            "grid": {name: list(labels) for name, labels in self.grid.items()},
            "replicates": [self.replicates.start, self.replicates.stop],
            "values": {name: plain.listed(rows) for name, rows in self.values.items()},
            "units": self.units,
            "failures": [asdict(one) for one in self.failures],
            "seconds": self.seconds,
        }

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each replicate that has run, and for each value of a nested axis.

        Returns
        -------
        pandas.DataFrame
            Columns: the axes, "replicate", then the numbers; an array has a column for each of its
            entries, ``u[0]``, ``u[1]``, ... Its ``attrs`` have `about` and the units.

        Raises
        ------
        ImportError
            If pandas is not installed (extra ``tables``).
        """
        with extra("tables need pandas", "tables"):
            import pandas
        ran, shape = self.done | self.failed, (*map(len, self.grid.values()), len(self.replicates))
        columns: dict[str, Any] = {}
        axes = [*self.grid.items(), ("replicate", tuple(self.replicates))]
        for axis, (name, labels) in enumerate(axes):
            where = np.broadcast_to(
                np.arange(shape[axis]).reshape([-1 if k == axis else 1 for k in range(len(shape))]),
                shape,
            )[ran]
            columns[name] = pandas.Series(list(labels)).to_numpy()[where]
        columns |= {name: rows[ran] for name, rows in self.entries()}
        found = pandas.DataFrame(columns)
        found.attrs = {**self.about, "status": self.status, "units": dict(self.units)}
        return found

    def to_xarray(self) -> xarray.Dataset:
        """The numbers with named dimensions.

        Returns
        -------
        xarray.Dataset
            Dimensions: the axes, "replicate", and ``u_0``, ``u_1``, ... of an array ``u``. Its
            ``attrs`` have what is in `about`, those of numbers and axes their "units".

        Raises
        ------
        ImportError
            If xarray is not installed (extra ``tables``).
        """
        with extra("data sets need xarray", "tables"):
            import xarray
        dims = (*self.grid, "replicate")
        coordinates: dict[str, Any] = {name: _coordinate(own) for name, own in self.grid.items()}
        coordinates["replicate"] = np.array(self.replicates, dtype=np.int64)
        named = {
            name: ((*dims, *(f"{name}_{k}" for k in range(rows.ndim - len(dims)))), rows)
            for name, rows in self.values.items()
        }
        attrs = {**self.about, "status": self.status, "failed": len(self.failures)}
        found = xarray.Dataset(named, coordinates, attrs)
        for name, unit in self.units.items():
            if name in found.variables:
                found[name].attrs["units"] = unit
        return found

    def save(self, path: PathLike) -> None:
        """Save as a table or data set, for other programs.

        Parameters
        ----------
        path : path
            Ends in ``.parquet`` (as `to_pandas`), ``.nc`` (netCDF, as `to_xarray`) or ``.json`` (as
            `to_dict`). An existing file is replaced in one piece.

        Raises
        ------
        InputError, InputTypeError
            If it is no path, or has another ending.
        ImportError
            If the packages for it are not installed (extra ``tables``).
        """
        checked = Path(files.checked_path("path", path))
        suffix = gate.choice("path suffix", checked.suffix, SUFFIXES)
        part = checked.with_name(checked.name + ".part")
        if suffix == ".json":
            files.write_text(checked, json.dumps(self.to_dict(), allow_nan=False) + "\n")
            return
        if suffix == ".parquet":
            table = self.to_pandas()
            with extra("Parquet files need pyarrow", "tables"):
                import pyarrow  # noqa: F401
            table.to_parquet(part, engine="pyarrow", index=False)
        else:
            data = self.to_xarray()
            with extra("netCDF files need h5netcdf", "tables"):
                import h5netcdf  # noqa: F401
            data.to_netcdf(part, engine="h5netcdf")
        os.replace(part, checked)

    def entries(self) -> Iterator[tuple[str, Floats]]:
        """Each number and each entry of an array, over the axes and the replicates.

        Yields
        ------
        name : str
            "error", "u[0]", "X[1,2]".
        values : ndarray
        """
        own = len(self.grid) + 1
        for name, rows in self.values.items():
            for where in itertools.product(*map(range, rows.shape[own:])):
                text = f"{name}[{','.join(map(str, where))}]" if where else name
                yield text, rows[(slice(None),) * own + where]


def _coordinate(labels: tuple[Label, ...]) -> NDArray[Any]:
    """Numbers as numbers, all else as text."""
    numbers = all(gate.is_real(label) for label in labels)
    return np.array(labels if numbers else [str(label) for label in labels])
