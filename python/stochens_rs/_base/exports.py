"""A and B with names and units, as objects of other packages."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from .align_labels import DIMS
from .extras import extra


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
