"""What a study has found: arrays with named axes."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._base import files, html, serialize, validation
from .._base.cached import cached_property
from .._base.extras import extra
from .._base.files import PathLike
from .._base.types import Floats, Status
from ..exceptions import InputError
from ..plots.bands import Line, draw_bands
from .grid import Label, label_text, plain_label
from .summary import Summary, summarized
from .units import labelled, suffix

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes

SCHEMA = "stochens-results/1"
SUFFIXES = (".parquet", ".csv", ".nc", ".json", ".tex")
BAND = (0.1, 0.9)  # quantiles: the middle 80 % of the replicates


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


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """The numbers of a study. Made by `Study.run`; see also `Study.results`.

    Attributes
    ----------
    status : str
        "completed"; "time_limit"; "interrupted" by Ctrl-C or SIGTERM; "workers_lost": the workers
        of the executor died or could not be started. All but the first can be run on.
    grid : dict of str to tuple
        The labels of each axis.
    replicates : range
        Their numbers.
    values : dict of str to ndarray
        By name. Axes: those of `grid` in their order, the replicates, then those of what the
        function returned. nan where a replicate failed or has not run. Read-only; a study that is
        run on fills in what is missing.
    done, failed : ndarray of bool
        Whether a replicate has run, and how; axes of `grid`, then replicates.
    failures : list of Failure
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
    replicates: range
    values: dict[str, Floats]
    done: NDArray[np.bool_]
    failed: NDArray[np.bool_]
    failures: list[Failure]
    about: dict[str, str]
    seconds: float
    units: dict[str, str] = field(default_factory=dict)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all numbers: equal if and only if they are the same bits."""
        found = hashlib.sha256(self.done.tobytes() + self.failed.tobytes())
        for name in sorted(self.values):
            found.update(name.encode())
            found.update(self.values[name].tobytes())
        return found.hexdigest()

    def select(self, **labels: Label) -> Results:
        """Fix labels of some axes, which then are gone.

        Parameters
        ----------
        **labels : label
            One for each axis to be fixed.

        Returns
        -------
        Results
            Its `about` names them as well.

        Raises
        ------
        InputError, InputTypeError
            If there is no such axis or label.

        Examples
        --------
        >>> import stochens_rs as se
        >>> def noise(key, scale):
        ...     return {"x": scale * key.generator().normal()}
        >>> results = se.Study(noise, {"scale": [1.0, 2.0]}, replicates=3, rng=1).run()
        >>> results.select(scale=2.0).values["x"].shape
        (3,)
        """
        values, grid, about, failures = self.values, dict(self.grid), self.about, self.failures
        done, failed = self.done, self.failed
        for name, label in labels.items():
            validation.choice("axis", name, tuple(grid))
            texts = [label_text(one) for one in grid[name]]
            wanted = label_text(plain_label(name, label))
            if wanted not in texts:
                listed = ", ".join(texts)[:120]
                raise InputError(f"`{name}` must be one of {listed}, got {validation.show(label)}")
            at, axis = texts.index(wanted), list(grid).index(name)
            values = {key: np.take(rows, at, axis=axis) for key, rows in values.items()}
            done, failed = np.take(done, at, axis=axis), np.take(failed, at, axis=axis)
            own = grid.pop(name)[at]
            failures = [one for one in failures if one.configuration.get(name, own) == own]
            about = {**about, name: str(label)}
        rest = (values, done, failed, failures, about, self.seconds, self.units)
        return Results(self.status, grid, self.replicates, *rest)

    def summary(self) -> Summary:
        """Mean, standard error, median and band of each number, for each configuration.

        Returns
        -------
        Summary
            A table; failed replicates are left out, and counted.

        Examples
        --------
        >>> import stochens_rs as se
        >>> study = se.Study(lambda key: {"x": key.generator().normal()}, {}, replicates=99, rng=1)
        >>> print(study.run().summary())
        name  done  failed  infinite     mean  standard_error     q10   median     q90
        x       99       0         0  ...
        """
        return summarized(self.grid, self.entries(), self.done, self.failed)

    def plot(self, x: str, y: str, hue: str | None = None, *, ax: Axes | None = None) -> Axes:
        """Draw the median over the replicates, and the band from their 10 % to their 90 % quantile.

        Parameters
        ----------
        x : str
            The axis across.
        y : str
            The number, such as "error", or "u[0]" for an entry of an array.
        hue : str, optional
            The axis with a line for each label. All other axes must have one label: see `select`.
        ax : matplotlib Axes, optional
            Where to draw; default: new axes.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        InputError, InputTypeError
            If there is no such axis or number, or another axis has more than one label.
        ImportError
            If matplotlib is not installed.
        """
        validation.choice("x", x, tuple(self.grid))
        if hue is not None:
            validation.choice("hue", hue, tuple(name for name in self.grid if name != x))
        entries = dict(self.entries())
        rows = entries[validation.choice("y", y, tuple(entries))]
        for name, labels in self.grid.items():
            if name not in (x, hue) and len(labels) > 1:
                raise InputError(
                    f"`x` and `hue` leave the axis {name!r} with {len(labels)} labels: fix one by "
                    f"select({name}=...)"
                )
        names = [*self.grid, "replicate"]
        first = [name for name in (hue, x, "replicate") if name is not None]
        order = [names.index(name) for name in (*first, *(n for n in names if n not in first))]
        cube = rows.transpose(order).reshape(
            1 if hue is None else len(self.grid[hue]), len(self.grid[x]), len(self.replicates)
        )
        unit = suffix(hue or "", self.units)
        lines = []
        for label, own in zip((None,) if hue is None else self.grid[hue], cube, strict=True):
            band = np.array([_quantiles(one) for one in own]).T
            named = None if hue is None else f"{hue} = {label}{unit}"
            lines.append(Line(named, band[0], band[1], band[2], {}))
        said = f"10-90 % of {_counted(np.sum(~np.isnan(cube), axis=2), len(self.replicates))}"
        of_x, of_y = (labelled(name, self.units) for name in (x, y))
        return draw_bands(self.grid[x], lines, of_x, of_y, said, ax)

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
            "values": {name: serialize.listed(rows) for name, rows in self.values.items()},
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
            Ends in ``.parquet`` or ``.csv`` (as `to_pandas`), ``.nc`` (netCDF, as `to_xarray`),
            ``.json`` (as `to_dict`) or ``.tex`` (`summary` as a tabular of the package booktabs).
            An existing file is replaced in one piece.

        Raises
        ------
        InputError, InputTypeError
            If it is no path, or has another ending.
        ImportError
            If the packages for it are not installed (extra ``tables``).
        """
        checked = Path(files.checked_path("path", path))
        suffix = validation.choice("path suffix", checked.suffix, SUFFIXES)
        if suffix == ".json":
            files.write_text(checked, json.dumps(self.to_dict(), allow_nan=False) + "\n")
            return
        if suffix == ".tex":
            files.write_text(checked, self.summary().to_latex())
            return
        if suffix == ".csv":
            files.write_text(checked, self.to_pandas().to_csv(index=False))
            return
        if suffix == ".parquet":
            table = self.to_pandas()
            with extra("Parquet files need pyarrow", "tables"):
                import pyarrow  # noqa: F401
            with files.replaced(checked) as part:
                table.to_parquet(part, engine="pyarrow", index=False)
            return
        data = self.to_xarray()
        with extra("netCDF files need h5netcdf", "tables"):
            import h5netcdf  # noqa: F401
        with files.replaced(checked) as part:
            data.to_netcdf(part, engine="h5netcdf")

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

    def __repr__(self) -> str:
        axes = " x ".join(f"{len(labels)} {name}" for name, labels in self.grid.items())
        failed = f", {len(self.failures)} failed" if self.failures else ""
        ran = int((self.done | self.failed).sum())
        numbers = ", ".join(self.values) or "no numbers"
        return (
            f"<Results: {numbers} of {axes + ' x ' if axes else ''}{len(self.replicates)} "
            f"replicates, {self.status}: {ran} of {self.done.size} ran{failed}>"
        )

    def _repr_html_(self) -> str:
        table = self.summary()
        rows = [*self.about.items(), ("digest", self.digest[:16])]
        body = table.texts()[1:41]
        return html.card(self, rows, html.grid(table.texts()[0], body) if body else "")


def _counted(drawn: NDArray[np.int64], replicates: int) -> str:
    """How many replicates each point of a figure stands for, of all."""
    least, most = int(drawn.min()), int(drawn.max())
    if least == replicates:
        return f"{replicates} replicates"
    return f"{most if least == most else f'{least} to {most}'} of {replicates} replicates"


def _quantiles(values: Floats) -> tuple[float, float, float]:
    seen = values[~np.isnan(values)]
    if not seen.size:
        return np.nan, np.nan, np.nan
    low, middle, high = np.quantile(seen, (BAND[0], 0.5, BAND[1]))
    return float(low), float(middle), float(high)


def _coordinate(labels: tuple[Label, ...]) -> NDArray[Any]:
    """Numbers as numbers, all else as text."""
    numbers = all(validation.is_real(label) for label in labels)
    return np.array(labels if numbers else [str(label) for label in labels])
