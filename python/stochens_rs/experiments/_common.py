"""What an experiment leaves behind: its panels, and all that is needed to repeat it."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import _gate
from ..exceptions import InputError
from ._curves import Curve, Panel, quantiles, written_by

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Curve", "Experiment", "Panel", "log_grid", "quantiles", "versions", "write_listed"]

SCHEMA = "stochens-experiment/1"


def log_grid(samples: int, points: int = 16) -> NDArray[np.int64]:
    """At most `points` sample counts, evenly spaced on a log axis, from 1 to `samples`."""
    return np.unique(np.rint(np.geomspace(1, samples, points)).astype(np.int64))


@dataclass(frozen=True, eq=False)
class Experiment:
    """One experiment, finished: settings, key, errors of every replicate, and facts derived from
    them.

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
    versions: dict[str, str] = field(default_factory=lambda: versions())

    @property
    def replicates(self) -> int:
        """Number of independent repetitions."""
        return int(self.panels[0].curves[0].errors.shape[0])

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
        return named[_gate.choice("name", name, tuple(named))]

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for ``json.dumps``; `from_dict` restores every number bit for bit."""
        return {
            "schema": SCHEMA,
            "name": self.name,
            "title": self.title,
            "key": self.key,
            "settings": self.settings,
            "sizes": self.sizes.tolist(),
            "panels": [panel.to_dict() for panel in self.panels],
            "facts": self.facts,
            "seconds": self.seconds,
            "versions": self.versions,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Experiment:
        """The inverse of :meth:`to_dict`.

        Parameters
        ----------
        data : mapping
            What `to_dict` returned, possibly written to JSON and read again.

        Raises
        ------
        InputError
            If the data are something else, or were written with another schema.
        """
        with written_by("Experiment"):
            schema = data["schema"]
            if schema != SCHEMA:
                raise InputError(f"`data` must have schema '{SCHEMA}', got {_gate.show(schema)}")
            names = ("name", "title", "key", "settings", "facts", "seconds", "versions")
            return cls(
                **{name: data[name] for name in names},
                sizes=np.asarray(data["sizes"], dtype=np.int64),
                panels=tuple(Panel.from_dict(p) for p in data["panels"]),
            )

    def plot(self) -> dict[str, Figure]:
        """The figures of this experiment, by name ("power-figure-1", ...); needs matplotlib."""
        from .. import plots

        return plots.figures(self)

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
        from .. import plots

        return [data, *plots.save_figures(plots.figures(self, shown=False), directory)]

    def __repr__(self) -> str:
        return (
            f"<Experiment {self.name}: {len(self.panels)} panels, {self.replicates} replicates, "
            f"N={int(self.sizes[-1])}, key={self.key[:16]}>"
        )


def versions() -> dict[str, str]:
    """Versions of the package, Python, NumPy and the platform, as strings."""
    try:
        package = metadata.version("stochens_rs")
    except metadata.PackageNotFoundError:  # run from a source tree that was never installed
        package = "not installed"
    return {
        "stochens_rs": package,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": f"{platform.system()} {platform.machine()}",
    }


def write_text(path: Path, text: str) -> None:
    """Write a file so that a reader sees either the old or the whole new one."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)


def write_listed(
    directory: Path, index: str, facts: dict[str, Any], made: list[Path]
) -> list[Path]:
    """Write an index with the SHA-256 of each file made elsewhere, then move these beside it."""
    digests = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in made}
    listed = {**facts, "files": {index: None, **digests}}
    write_text(directory / index, json.dumps(listed, allow_nan=False) + "\n")
    return [directory / index, *(path.replace(directory / path.name) for path in made)]
