"""A control problem from a file: matrices and, where the file has them, the two states."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _gate
from .._state import checked_path
from ..exceptions import InputError
from ..system import System

_NAMES = ("A", "B", "x0", "xf", "dt")


@dataclass(frozen=True, eq=False)
class Problem:
    """A system with the states that were in the same file.

    Attributes
    ----------
    system : System
        ``A``, ``B`` and ``dt``.
    x0, xf : ndarray, shape (n,), or None
        Initial state and target; None where the file has none.
    """

    system: System
    x0: NDArray[np.float64] | None
    xf: NDArray[np.float64] | None


def from_file(path: str | os.PathLike[str]) -> Problem:
    """Read a problem from NumPy's ``.npz`` or from JSON.

    Parameters
    ----------
    path : path
        A ``.npz`` file, or any other name for a JSON object. Entries: ``A`` (n, n), ``B`` (n, m),
        and, if there are any, ``x0`` (n,), ``xf`` (n,) and the sampling time ``dt``.

    Returns
    -------
    Problem
        The system, and the states or None.

    Raises
    ------
    InputError
        The file is not of this kind, an entry is missing, unknown or cannot be used.
    InputTypeError
        `path` is none.
    OSError
        The file cannot be read.

    Notes
    -----
    Nothing in the file is executed: arrays of Python objects are refused.

    Examples
    --------
    >>> import json, tempfile, pathlib, stochens_rs as se
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "problem.json"
    >>> _ = path.write_text(json.dumps({"A": [[0.5]], "B": [[1.0]], "x0": [2.0]}))
    >>> se.cases.from_file(path).system
    <System: n=1 m=1 dt=None>
    """
    path = Path(checked_path("path", path))
    found = _npz(path) if path.suffix.lower() == ".npz" else _json(path)
    unknown = sorted(set(found) - set(_NAMES))
    if unknown:
        raise InputError(
            f"{path.name} must have the entries A, B and, if there are any, x0, xf, dt; "
            f"got also {unknown[0]!r}"
        )
    missing = [name for name in ("A", "B") if name not in found]
    if missing:
        raise InputError(f"{path.name} must have the entries A and B, {missing[0]} is missing")
    dt: Any = found.get("dt")
    if isinstance(dt, np.ndarray):
        dt = dt.item() if dt.size == 1 else dt
    system = System(found["A"], found["B"], dt=dt)
    x0, xf = (
        None if found.get(name) is None else _gate.vector(name, found[name], length=system.n)
        for name in ("x0", "xf")
    )
    return Problem(system, x0, xf)


def _npz(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except OSError:
        raise
    except Exception as error:  # a damaged archive raises anything from three libraries
        raise InputError(f"{path.name} must be an archive of numeric arrays: {error}") from error


def _json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:  # not text, not JSON, or numbers without end
        raise InputError(f"{path.name} must be a .npz archive or JSON: {error}") from error
    if not isinstance(found, dict):
        raise InputError(f"{path.name} must be a JSON object, got {type(found).__name__}")
    return found
