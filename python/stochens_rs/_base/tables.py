"""Records as objects of xarray, pandas and other packages, and tables of text."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from ..exceptions import InputError
from . import fields, records, running
from .files import versions
from .names import Labels, default_labels
from .reading import DIMS
from .types import NDArray

if TYPE_CHECKING:
    import pandas
    import xarray


@contextmanager
def extra(need: str, name: str = "plot") -> Iterator[None]:
    """Around an import of an optional package: name the extra if it is missing."""
    try:
        yield
    except ImportError as error:
        raise ImportError(f"{need}: install it by `pip install 'stochens_rs[{name}]'`") from error


class Tabled:
    """Base of the records that have axes."""

    __slots__ = ()

    def _parts(self) -> tuple[Any, ...]:
        """The record, and those among its fields whose arrays over the steps are shown with it."""
        return (self,)

    def _facts(self) -> dict[str, Any]:
        """Texts, numbers and keys that no field of the parts has."""
        return {}

    def _cube(self) -> tuple[dict[str, Any], str, NDArray[Any], dict[str, Any], Labels]:
        """What the declarations of the fields say.

        Arrays by name as (dims, array, unit), where the unit is "state" or "input" if it is that
        of the states or inputs along the last dimension; the dimension of K + 1 times, "time" [s]
        or "step", and its coordinate; texts and numbers, the keys as text, and the versions; names
        along the dimensions "state" and "input".
        """
        record: Any = self
        sizes, dt = records.sizes(record), getattr(record, "dt", None)
        clock, times = "step" if dt is None else "time", np.arange(sizes.get("step", 0) + 1)
        if dt is not None:
            times = getattr(record, "times", times * dt)
        variables: dict[str, Any] = {}
        facts = self._facts()
        for part in self._parts():
            kind: Any = type(part)
            facts = {name: getattr(part, name) for name in fields.declared(kind)} | facts
            for name, (dims, words, _) in records.rules(kind).items():
                array, over_steps = getattr(part, name), len(dims) == 2 and dims[0] == "step"
                if array is None or not dims or name == "times":
                    continue
                if part is not self and not over_steps:
                    continue
                dims = dims[len(dims) - array.ndim :]  # without runs
                unit = None if "own unit" in words or array.dtype.kind == "i" else dims[-1]
                if "step" in dims:  # nan at the last time, where no input acts, or at the first
                    axis = dims.index("step")
                    missing = np.full([*array.shape[:axis], 1, *array.shape[axis + 1 :]], np.nan)
                    pair = (array, missing) if dims[-1] == "input" else (missing, array)
                    array = np.concatenate(pair, axis, dtype=np.float64)
                named = tuple(clock if dim.startswith("step") else dim for dim in dims)
                variables.setdefault(name, (named, array, unit))
        attrs = {name: _plain(value) for name, value in facts.items()} | versions()
        attrs = {name: value for name, value in attrs.items() if value is not None}
        labels = getattr(record, "labels", None) or default_labels(
            sizes.get("state", 0), sizes["input"]
        )
        return variables, clock, times, attrs, labels

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
        variables, clock, times, attrs, labels = self._cube()
        running.need("the data set", sum(array.nbytes for _, array, _ in variables.values()))
        used = {dim for dims, _, _ in variables.values() for dim in dims}
        units, same = dict(labels.units), {}
        coordinates: dict[str, Any] = {}
        if clock in used:
            coordinates[clock] = (clock, times, {"units": "s"} if clock == "time" else {})
        for what, names in (("state", labels.states), ("input", labels.inputs)):
            for dim in sorted(used & {what, f"from_{what}", f"other_{what}"}):
                coordinates[dim] = (dim, np.array(names, dtype=object))
            own = [units.get(name, "") for name in names]
            if what in used and any(own):
                coordinates[f"{what}_unit"] = (what, np.array(own, dtype=object))
                if len(set(own)) == 1:
                    same[what] = {"units": own[0]}
        arrays = {
            name: (dims, array, same.get(unit or "", {}))
            for name, (dims, array, unit) in variables.items()
        }
        return xarray.Dataset(arrays, coordinates, attrs)


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
            ``attrs`` has "units" by name, the key and the versions. A `FleetPlan` has the inputs
            alone.

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
        variables, clock, times, attrs, labels = self._cube()
        along: Any = {(clock, "state"): labels.states, (clock, "input"): labels.inputs}
        # the first array of a dimension has its plain names
        first: dict[str, Any] = dict.fromkeys((*labels.states, *labels.inputs))
        further: dict[str, Any] = {}
        for name, (dims, array, _) in variables.items():
            names = along.get(dims, ())
            plain = any(first[own] is None for own in names)
            for own, column in zip(names, array.T, strict=False):
                title = own if plain else f"{name}[{own}]"
                if title in further or first.get(title) is not None:
                    raise InputError(f"two columns would be '{title:.60}': use to_xarray()")
                (first if plain else further)[title] = column
        known = {name: column for name, column in first.items() if column is not None}
        found = pandas.DataFrame(known | further, index=pandas.Index(times, name=clock))
        found.attrs = {**attrs, "units": dict(labels.units)}
        return found


def _plain(value: object) -> object:
    """A number or a text as an attribute; None for what is none."""
    if isinstance(value, tuple) and all(isinstance(one, str) for one in value):
        return ", ".join(value)
    value = getattr(value, "hex", None) if type(value).__name__ == "Key" else value
    return value if isinstance(value, (str, int, float)) and not isinstance(value, bool) else None


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
        labels, states = self.labels, list(self.labels.states)
        # files hold numbers and text
        units = json.dumps(dict(labels.units), ensure_ascii=False) if labels.units else None
        known = {"dt": _plain(self.dt), "name": self.name, "units": units}
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
