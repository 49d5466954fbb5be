"""What a study has found: arrays with named axes."""

from __future__ import annotations

import csv
import hashlib
import io
import itertools
import json
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import files, show, validation
from .._base.files import PathLike
from .._base.records import Record, cached_property, require_shapes
from .._base.tables import columns, extra
from .._base.types import Floats, NDArray, Status
from .tasks import Label

if TYPE_CHECKING:
    import xarray

SUFFIXES = (".csv", ".nc", ".json")
_MOST = 6  # numbers of a table


class Failure(Record, eq=True):
    """A replicate that raised an error.

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


class Results(Record):
    """The numbers of a study. Made by `Study.run`; see also `Study.results`.

    As text it is a table of medians.

    Attributes
    ----------
    status : str
        "completed"; "time_limit"; "interrupted" by Ctrl-C or SIGTERM. All but the first can be run
        on.
    grid : dict of str to tuple
        The labels of each axis.
    replicates : ndarray of int64
        Their numbers.
    values : dict of str to ndarray
        By name. Axes: those of `grid` in their order, the replicates, then those of what the
        function returned. nan where a replicate failed or has not run. Read-only; a study that is
        run on fills in what is missing.
    done, failed : ndarray of bool
        Whether a replicate has run, and how; axes of `grid`, then replicates.
    failures : tuple of Failure
        In the order of the replicates.
    about : dict of str to str
        The key of the study, the name of its function, and where it ran: versions, platform,
        processor. Numbers of equal studies are the same bits if these agree.
    seconds : float
        Time of the last run.
    units : dict of str to str
        Of numbers and axes, as the function names them; "1" for pure numbers.
    """

    status: Status
    grid: dict[str, tuple[Label, ...]]
    replicates: NDArray[np.int64]
    values: dict[str, Floats]
    done: NDArray[np.bool_]
    failed: NDArray[np.bool_]
    failures: tuple[Failure, ...]
    about: dict[str, str]
    seconds: float
    units: dict[str, str] = field(default_factory=dict)

    def _check(self) -> None:
        shape = (*map(len, self.grid.values()), len(self.replicates))
        require_shapes(self, done=shape, failed=shape)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all numbers: equal if and only if they are the same bits."""
        found = hashlib.sha256(self.done.tobytes() + self.failed.tobytes())
        for name in sorted(self.values):
            found.update(name.encode())
            found.update(self.values[name].tobytes())
        return found.hexdigest()

    def columns(self) -> dict[str, NDArray[Any]]:
        """The numbers as a table, with a row for each replicate that has run.

        Returns
        -------
        dict of str to ndarray
            The axes, "replicate", then the numbers; an array has a column for each of its entries,
            ``u[0]``, ``u[1]``, ... A nested axis has a row for each of its values.

        Examples
        --------
        >>> import stochens_rs as se
        >>> study = se.Study(lambda key, a: {"x": 2.0 * a}, {"a": [1, 2]}, replicates=2, rng=1)
        >>> study.run().columns()["x"]
        array([2., 2., 4., 4.])
        """
        ran = self.done | self.failed
        axes = [_numbers(labels) for labels in self.grid.values()]
        axes.append(self.replicates)
        names = (*self.grid, "replicate")
        where = np.nonzero(ran)
        found = {k: own[at] for k, own, at in zip(names, axes, where, strict=True)}
        return found | {name: rows[ran] for name, rows in self._entries().items()}

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

        Examples
        --------
        >>> import stochens_rs as se
        >>> study = se.Study(lambda key, a: {"x": 2.0 * a}, {"a": [1, 2]}, replicates=2, rng=1)
        >>> dict(study.run().to_xarray().sizes)
        {'a': 2, 'replicate': 2}
        """
        with extra("data sets need xarray", "tables"):
            import xarray
        dims = (*self.grid, "replicate")
        coordinates: dict[str, Any] = {name: _numbers(own) for name, own in self.grid.items()}
        coordinates["replicate"] = self.replicates
        named = {
            name: ((*dims, *(f"{name}_{k}" for k in range(rows.ndim - len(dims)))), rows)
            for name, rows in self.values.items()
        }
        attrs = {**self.about, "status": self.status, "failed": len(self.failures)}
        found = xarray.Dataset(named, coordinates, attrs)
        for name in found.variables:
            if name in self.units:
                found[name].attrs["units"] = self.units[str(name)]
        return found

    def save(self, path: PathLike) -> None:
        """Save as a table or data set, for other programs.

        Parameters
        ----------
        path : path
            Ends in ``.csv`` (as `columns`), ``.nc`` (netCDF, as `to_xarray`) or ``.json`` (as
            `to_dict`). An existing file is replaced in one piece.

        Raises
        ------
        InputError, InputTypeError
            If it is no path, or has another ending.
        ImportError
            If the packages for netCDF are not installed (extra ``tables``).

        Examples
        --------
        >>> import pathlib, tempfile, stochens_rs as se
        >>> study = se.Study(lambda key, a: {"x": 2.0 * a}, {"a": [1, 2]}, replicates=2, rng=1)
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "table.csv"
        >>> study.run().save(path)
        >>> path.read_text().split()[:2]
        ['a,replicate,x', '1,0,2.0']
        """
        checked = Path(files.checked_path("path", path))
        suffix = validation.choice("path suffix", checked.suffix, SUFFIXES)
        if suffix == ".nc":
            data = self.to_xarray()
            with extra("netCDF files need h5netcdf", "tables"):
                import h5netcdf  # noqa: F401
            with files.replaced(checked) as part:
                data.to_netcdf(part, engine="h5netcdf")
        elif suffix == ".json":
            files.write_text(checked, json.dumps(self.to_dict(), allow_nan=False) + "\n")
        else:
            table, text = self.columns(), io.StringIO()
            rows = zip(*(column.tolist() for column in table.values()), strict=True)
            csv.writer(text, lineterminator="\n").writerows([list(table), *rows])
            files.write_text(checked, text.getvalue())

    def _entries(self) -> dict[str, Floats]:
        """Each number and each entry of an array, "error", "u[0]", "X[1,2]", over the axes and the
        replicates.
        """
        own, found = len(self.grid) + 1, {}
        for name, rows in self.values.items():
            for where in itertools.product(*map(range, rows.shape[own:])):
                text = f"{name}[{','.join(map(str, where))}]" if where else name
                found[text] = rows[(slice(None),) * own + where]
        return found

    def __repr__(self) -> str:
        axes = "".join(f"{len(labels)} {name} x " for name, labels in self.grid.items())
        failed = f", {len(self.failures)} failed" if self.failures else ""
        ran = int((self.done | self.failed).sum())
        return (
            f"<Results: {', '.join(self.values) or 'no numbers'} of {axes}{len(self.replicates)} "
            f"replicates, {self.status}: {ran} of {self.done.size} ran{failed}>"
        )

    def _medians(self) -> list[list[str]]:
        """A head, and a row of medians for each configuration."""
        entries = dict(itertools.islice(self._entries().items(), _MOST))
        rows = [[*self.grid, "done", "failed", *(f"median {name}" for name in entries)]]
        for where in np.ndindex(self.done.shape[:-1]):
            ran = self.done[where]
            labels = [own[k] for own, k in zip(self.grid.values(), where, strict=True)]
            middles = [
                np.median(own[where][ran]) if ran.any() else np.nan for own in entries.values()
            ]
            cells = [*labels, int(ran.sum()), int(self.failed[where].sum()), *map(float, middles)]
            rows.append([show.text(cell) for cell in cells])
        return rows

    def __str__(self) -> str:
        return "\n".join([repr(self), *columns(self._medians(), 1000)])

    def _repr_html_(self) -> str:
        head, *body = self._medians()
        return show.card(self, list(self.about.items()), show.grid(head, body[:40]))


def _numbers(labels: tuple[Label, ...]) -> NDArray[Any]:
    """Numbers as numbers, all else as text."""
    numbers = all(validation.is_real(label) for label in labels)
    return np.array(labels if numbers else [str(label) for label in labels])
