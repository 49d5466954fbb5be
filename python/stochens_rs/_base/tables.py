"""Records as objects of xarray, pandas and other packages, and tables of text."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..exceptions import InputError
from . import fields, records, running
from .files import versions
from .names import Labels, default_labels
from .reading import DIMS

if TYPE_CHECKING:
    import pandas
    import xarray
    from numpy.typing import NDArray

    from .types import Floats


@contextmanager
def extra(need: str, name: str = "plot") -> Iterator[None]:
    """Around an import of an optional package: name the extra if it is missing."""
    try:
        yield
    except ImportError as error:
        raise ImportError(
            f"{need}: install the extra with `pip install 'stochens_rs[{name}]'`"
        ) from error


@dataclass(frozen=True, eq=False)
class Cube:
    """Arrays with named dimensions.

    Attributes
    ----------
    variables : mapping of str to (dims, array, unit)
        The unit is a text, or "state" or "input": that of the states or inputs along the last
        dimension. Those whose array is None are left out.
    coordinates : mapping of str to (array, unit)
        Along the dimensions of these names.
    attrs : dict
        Texts and numbers, the key as text; None is left out.
    labels : Labels, optional
        Names along the dimensions "state" and "input".
    """

    variables: Mapping[str, tuple[tuple[str, ...], NDArray[Any] | None, str | None]]
    coordinates: Mapping[str, tuple[NDArray[Any], str | None]]
    attrs: dict[str, Any]
    labels: Labels | None = None

    def there(self) -> dict[str, tuple[tuple[str, ...], NDArray[Any], str | None]]:
        """The variables that are not None."""
        return {
            name: (dims, array, unit)
            for name, (dims, array, unit) in self.variables.items()
            if array is not None
        }

    def names(self, dim: str) -> tuple[str, ...] | None:
        """The names along "state" or "input"."""
        if self.labels is None:
            return None
        return {"state": self.labels.states, "input": self.labels.inputs}.get(dim)

    def about(self) -> dict[str, Any]:
        """The attributes, with the versions."""
        return {name: one for name, one in (self.attrs | versions()).items() if one is not None}


class Tabled:
    """Base of the records that have axes."""

    __slots__ = ()

    def _cube(self) -> Cube:
        """What the declarations of the fields say: arrays with dimensions, numbers and texts."""
        record: Any = self
        own: Any = type(record)
        sizes, rules = records.sizes(record), records.rules(own)
        clock, times = over_time(sizes.get("step", 0), record.dt, getattr(record, "times", None))
        variables: dict[str, Any] = {}
        for name, rule in rules.items():
            array = getattr(record, name)
            if rule.dims and array is not None and name != "times":
                rows = padded(array) if "step" in rule.dims else array
                dims = tuple(clock if dim in ("step", "step+1") else dim for dim in rule.dims)
                unit = None if "own unit" in rule.words else dims[-1]
                variables[name] = (dims, rows, unit if unit in ("state", "input") else None)
        attrs = {name: _plain(getattr(record, name)) for name in fields.declared(own)}
        labels = named(record.labels, sizes.get("state", 0), sizes["input"])
        return Cube(variables, times if "step" in sizes else {}, attrs, labels)

    def to_xarray(self) -> xarray.Dataset:
        """Give the arrays named dimensions, coordinates and units.

        Returns
        -------
        xarray.Dataset
            Along "state" and "input" stand the names of the system; their units, where some are
            known, are the coordinates "state_unit" and "input_unit", and ``attrs["units"]`` of a
            variable whose entries all have the same. "time" [s] where the length of a step is
            known, else "step". Inputs have nan at the last time, where none acts. ``attrs`` has
            the key and the versions.

        Raises
        ------
        ImportError
            If xarray is not installed (extra ``tables``).

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[0.5]], [[1.0]], dt=0.1, states=["T"], units={"T": "K"})
        >>> data = se.simulate(system, [2.0], [[1.0], [0.0]]).to_xarray()
        >>> data["states"].dims, data["states"].attrs
        (('time', 'state'), {'units': 'K'})
        >>> float(data["states"].sel(state="T", time=0.2))
        1.0
        """
        with extra("data sets need xarray", "tables"):
            import xarray
        cube = self._cube()
        there = cube.there()
        running.need("the data set", sum(array.nbytes for _, array, _ in there.values()))
        units = {} if cube.labels is None else dict(cube.labels.units)
        coordinates: dict[str, Any] = {
            name: (name, array, {} if unit is None else {"units": unit})
            for name, (array, unit) in cube.coordinates.items()
        }
        same: dict[str, str] = {}
        used = {dim for dims, _, _ in there.values() for dim in dims}
        for dim in sorted(used):
            names = cube.names(dim.removeprefix("from_").removeprefix("other_"))
            if names is None:
                continue
            coordinates[dim] = (dim, np.array(names, dtype=object))
            own = [units.get(name, "") for name in names]
            if any(own) and dim in ("state", "input"):
                coordinates[f"{dim}_unit"] = (dim, np.array(own, dtype=object))
                if len(set(own)) == 1:
                    same[dim] = own[0]
        variables = {}
        for name, (dims, array, unit) in there.items():
            found = same.get(unit) if unit in ("state", "input") else unit
            variables[name] = (dims, array, {} if found is None else {"units": found})
        return xarray.Dataset(variables, coordinates, cube.about())


class Timed(Tabled):
    """Base of the records over time."""

    __slots__ = ()

    def to_pandas(self) -> pandas.DataFrame:
        """One row for each time.

        Returns
        -------
        pandas.DataFrame
            The index is "time" [s] where the length of a step is known, else "step". The columns
            are the states, then the inputs, by their names, with nan in the last row of the
            inputs, where none acts; then what else is known of each, such as ``variance[p]``.
            ``attrs`` has "units" by name, the key and the versions.

        Raises
        ------
        ImportError
            If pandas is not installed (extra ``tables``).
        InputError
            If a name of yours is that of another column.

        Examples
        --------
        >>> import stochens_rs as se
        >>> system = se.System([[0.5]], [[1.0]], dt=0.1, states=["T"], inputs=["heat"])
        >>> se.simulate(system, [2.0], [[1.0], [0.0]]).to_pandas()
                T  heat
        time
        0.0   2.0   1.0
        0.1   2.0   0.0
        0.2   1.0   NaN
        """
        with extra("tables need pandas", "tables"):
            import pandas
        cube = self._cube()
        clock, (times, _) = next(iter(cube.coordinates.items()))
        columns: dict[str, Any] = {}
        further: dict[str, Any] = {}  # the first array of a dimension has its plain names
        seen: set[str] = set()
        for name, (dims, array, _) in cube.there().items():
            if dims not in ((clock, "state"), (clock, "input")):
                continue
            names = cube.names(dims[1]) or ()
            titles = [f"{name}[{own}]" for own in names] if dims[1] in seen else names
            for title, column in zip(titles, array.T, strict=True):
                if title in columns or title in further:
                    raise InputError(f"two columns would be '{title:.60}': use to_xarray()")
                (further if dims[1] in seen else columns)[title] = column
            seen.add(dims[1])
        found = pandas.DataFrame(columns | further, index=pandas.Index(times, name=clock))
        units = {} if cube.labels is None else dict(cube.labels.units)
        found.attrs = {**cube.about(), "units": units}
        return found


def _plain(value: object) -> object:
    """A number or a text as an attribute; None for what is none."""
    if isinstance(value, tuple) and all(isinstance(one, str) for one in value):
        return ", ".join(value)
    return (
        getattr(value, "hex", None)
        if type(value).__name__ == "Key"
        else (value if isinstance(value, (str, int, float)) else None)
    )


def over_time(
    steps: int, dt: float | None, times: Floats | None = None
) -> tuple[str, dict[str, tuple[NDArray[Any], str | None]]]:
    """The dimension of K + 1 times and its coordinate: "time" [s], or "step"."""
    if dt is None:
        return "step", {"step": (np.arange(steps + 1), None)}
    return "time", {"time": (np.arange(steps + 1) * dt if times is None else times, "s")}


def padded(rows: NDArray[Any] | None, *, first: bool = False) -> Floats | None:
    """Rows of K steps as those of K + 1 times, with nan in the last one, or in the first."""
    if rows is None:
        return None
    missing = np.full((*rows.shape[:-2], 1, rows.shape[-1]), np.nan)
    parts = (missing, rows) if first else (rows, missing)
    found: Floats = np.concatenate(parts, axis=-2, dtype=np.float64)
    return found


def named(labels: Labels | None, n: int, m: int) -> Labels:
    """The labels of n states and m inputs, by default ``x[0]``, ..., ``u[0]``, ...."""
    return default_labels(n, m) if labels is None else labels


class Exported:
    """How a `System` is handed to other packages."""

    __slots__ = ()

    def to_control(self: Any) -> Any:
        """Return a ``control.StateSpace`` with the same names, whose outputs are the states.

        Returns
        -------
        control.StateSpace
            With ``dt=True`` if the step is unspecified, and "_" for "." in its name.

        Raises
        ------
        ImportError
            If python-control is not installed.

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.System([[0.5]], [[1.0]], dt=0.1).to_control().dt  # doctest: +SKIP
        0.1
        """
        with extra("to_control() needs python-control", "bridges"):
            import control
        labels, n = self.labels, self.n
        return control.ss(
            self.A,
            self.B,
            np.eye(n),
            np.zeros((n, self.m)),
            True if self.dt is None else self.dt,
            states=list(labels.states),
            inputs=list(labels.inputs),
            outputs=list(labels.states),
            # python-control splits names at dots
            **({} if self.name is None else {"name": self.name.replace(".", "_")}),
        )

    def to_pandas(self: Any) -> tuple[Any, Any]:
        """Return A and B as DataFrames with the names, without `dt` and the units.

        Returns
        -------
        A : pandas.DataFrame, shape (n, n)
        B : pandas.DataFrame, shape (n, m)

        Raises
        ------
        ImportError
            If pandas is not installed.

        Examples
        --------
        >>> import stochens_rs as se
        >>> A, B = se.System([[0.5]], [[1.0]], states=["T"], inputs=["P"]).to_pandas()
        >>> float(B.loc["T", "P"])
        1.0
        """
        with extra("to_pandas() needs pandas", "tables"):
            import pandas as pd
        rows, cols = list(self.labels.states), list(self.labels.inputs)
        A = pd.DataFrame(self.A.copy(), index=rows, columns=rows)
        return A, pd.DataFrame(self.B.copy(), index=rows, columns=cols)

    def to_xarray(self: Any) -> Any:
        """Return A and B as a Dataset with the names.

        Returns
        -------
        xarray.Dataset
            A (state_next, state) and B (state_next, input); `dt`, `name` and the units, as JSON,
            in its attributes, where they are known. `from_any` reads it.

        Raises
        ------
        ImportError
            If xarray is not installed.

        Examples
        --------
        >>> import stochens_rs as se
        >>> cart = se.System([[0.5]], [[1.0]], dt=0.1, states=["T"], units={"T": "K"})
        >>> se.System.from_any(cart.to_xarray()).units
        {'T': 'K'}
        """
        with extra("to_xarray() needs xarray", "tables"):
            import xarray as xr
        labels, dt = self.labels, self.dt
        states, units = list(labels.states), dict(labels.units)
        known = {
            "dt": dt if isinstance(dt, float) else None,
            "name": self.name,
            # files hold numbers and text
            "units": json.dumps(units, ensure_ascii=False) if units else None,
        }
        return xr.Dataset(
            {"A": (DIMS["A"], self.A.copy()), "B": (DIMS["B"], self.B.copy())},
            coords={"state_next": states, "state": states, "input": list(labels.inputs)},
            attrs={word: value for word, value in known.items() if value is not None},
        )


def columns(rows: list[list[str]], room: int, keys: int = 1) -> list[str]:
    """Lines of cells in columns: the first left-aligned, the others right-aligned.

    Where `room` characters are too few there are several tables, each with the first columns,
    `keys` of them.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    tables = [list(range(keys))]
    for k, width in enumerate(widths[keys:], start=keys):
        if len(tables[-1]) > keys and sum(widths[j] + 2 for j in tables[-1]) + width > room:
            tables.append(list(range(keys)))
        tables[-1].append(k)
    lines: list[str] = []
    for table in tables:
        lines += [""] * bool(lines)
        for row in rows:
            cells = [row[0].ljust(widths[0]), *(row[k].rjust(widths[k]) for k in table[1:])]
            lines.append("  ".join(cells).rstrip())
    return lines
