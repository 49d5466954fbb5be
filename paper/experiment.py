"""The record of a finished experiment: its panels, and all that is needed to repeat it."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stochens_rs.exceptions import InputError
from stochens_rs.plots import save_figures

from . import common as check
from .common import plain, versions, write_text
from .curves import Panel, panel_from
from .figures import figure, panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCHEMA = "stochens-experiment/1"


@dataclass(frozen=True, eq=False, repr=False)
class Experiment:
    """A finished experiment: settings, key, errors of every replicate, and facts derived from them.

    Attributes
    ----------
    name, title : str
    key : str
        The 256-bit key as 64 hex digits; ``Key.from_hex(key)`` passed as `rng` repeats the run
        exactly.
    settings : dict
        Every option by the name it has as an argument, and what it led to (system, n, m, x0).
    sizes : (k,) int64 array
        Sample counts at which the errors were taken.
    panels : tuple of Panel
    facts : dict
        Numbers the report quotes: reachability, solver certificates, orderings, agreement with
        theory.
    versions : dict
        Package, Python, NumPy, platform.
    seconds : float
        Wall time.
    """

    name: str
    title: str
    key: str
    settings: dict[str, Any]
    sizes: NDArray[np.int64]
    panels: tuple[Panel, ...]
    facts: dict[str, Any]
    seconds: float
    versions: dict[str, str] = field(default_factory=versions)

    @property
    def replicates(self) -> int:
        """Number of independent repetitions."""
        return int(self.panels[0].curves[0].errors.shape[0])

    @property
    def figures(self) -> list[str]:
        """Numbers of the figures, in order."""
        return list(dict.fromkeys(p.figure for p in self.panels if p.figure is not None))

    def panel(self, name: str) -> Panel:
        """One panel by name.

        Parameters
        ----------
        name : str
            "1a", "2b", ...

        Returns
        -------
        Panel

        Raises
        ------
        InputError, InputTypeError
            There is no such panel.
        """
        named = {panel.name: panel for panel in self.panels}
        return named[check.choice("name", name, tuple(named))]

    def plot(self) -> dict[str, Figure]:
        """The figures of this experiment, by file name: "power-figure-1", ...

        Returns
        -------
        dict of str to matplotlib Figure

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        return {f"{self.name}-figure-{k}": self.plot_figure(k) for k in self.figures}

    def plot_figure(self, number: str) -> Figure:
        """One figure of the paper, its panels side by side under one title and over one legend.

        Parameters
        ----------
        number : str
            "1" or "2" (power), "3" (tracking).

        Returns
        -------
        matplotlib Figure

        Raises
        ------
        ImportError
            matplotlib is not installed.
        KeyError
            The experiment has no such figure.
        """
        chosen = [p for p in self.panels if p.figure == number]
        if not chosen:
            raise KeyError(f"experiment {self.name!r} has no figure {number!r}")
        s = self.settings
        ran = (
            f"{s['system']}:  n = {s['n']},  m = {s['m']},  N ≤ {s['samples']};  "
            f"thick lines: medians of {self.replicates} replicates"
        )
        return figure(chosen, self.sizes, f"Figure {number}   {self.title}", ran)

    def plot_panel(self, name: str, *, ax: Axes | None = None) -> Axes:
        """Draw one panel: median and 10-90 % band of every method, one single run, and the exact
        values.

        Parameters
        ----------
        name : str
            Which panel ("1a", "2b", ...).
        ax : matplotlib Axes, optional
            Where to draw. Default: new axes on a figure of their own (``ax.figure``), with a
            legend.

        Returns
        -------
        matplotlib Axes

        Raises
        ------
        ImportError
            matplotlib is not installed.
        InputError, InputTypeError
            There is no such panel.

        Notes
        -----
        Both axes are logarithmic. Errors that cannot be told from zero (``panel.zero_level``) have
        no place on a logarithmic axis; they are drawn in a shaded strip below it, on the tick
        labelled 0.
        """
        return panel(self.panel(name), self.sizes, ax=ax)

    def save(self, directory: str | os.PathLike[str]) -> list[Path]:
        """Write ``<name>.json`` and every figure as PNG and SVG; returns the paths written.

        Parameters
        ----------
        directory : path
            Made if it does not exist.

        Returns
        -------
        list of Path
            The data first.

        Raises
        ------
        ImportError
            matplotlib is not installed; the data have been written nevertheless.
        OSError
            The directory cannot be made or written.
        """
        directory = Path(directory)
        directory.mkdir(parents=True, exist_ok=True)
        data = directory / f"{self.name}.json"
        write_text(data, json.dumps(self.to_dict(), allow_nan=False) + "\n")
        return [data, *save_figures(self.plot(), directory)]

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain lists, numbers and text."""
        return {"schema": SCHEMA, **plain(self)}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Experiment:
        """Undo `to_dict`."""
        if data.get("schema") != SCHEMA:
            raise InputError(f"an experiment must have the schema {SCHEMA!r}")
        values = {one.name: data[one.name] for one in fields(cls)}
        values["sizes"] = np.array(values["sizes"], dtype=np.int64)
        values["panels"] = tuple(map(panel_from, values["panels"]))
        return cls(**values)

    def __repr__(self) -> str:
        return (
            f"<Experiment {self.name}: {len(self.panels)} panels, {self.replicates} replicates, "
            f"N={int(self.sizes[-1])}, key={self.key[:16]}>"
        )
