"""A control problem from a file: A, B and, if the file has them, x0 and xf."""

from __future__ import annotations

import json
import os
import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._base import running, validation
from .._base.files import checked_path, is_state, regular_file
from .._base.tables import extra
from .._base.types import NDArray
from ..exceptions import InputError, ResourceError, ShapeError
from ..system.system import System

_NAMES = ("A", "B", "x0", "xf", "dt", "states", "inputs", "units")
# Bytes of memory per byte of JSON in the worst case: the 3 bytes "{}," become a dict of 80 bytes
# and a pointer of 8, 29 per byte; the text itself is in memory too.
_PARSED = 36
_MEMORY = {".npz": 1, ".mat": 1}  # their readers look at what is in them


@dataclass(frozen=True, eq=False)
class Problem:
    """A system, with x0 and xf if the file has them.

    Attributes
    ----------
    system : System
        ``A``, ``B`` and ``dt``, and names and units.
    x0, xf : ndarray, shape (n,), or None
        Initial state and target; None if the file does not have it.
    """

    system: System
    x0: NDArray[np.float64] | None
    xf: NDArray[np.float64] | None


def from_file(path: str | os.PathLike[str]) -> Problem:
    """Read a problem from NumPy's ``.npz``, MATLAB's ``.mat`` or JSON.

    Parameters
    ----------
    path : path
        A ``.npz`` or ``.mat`` file; a file with any other name is read as JSON. Entries:
        ``A`` (n, n), ``B`` (n, m), and optionally ``x0`` (n,), ``xf`` (n,), the step ``dt`` [s],
        the names ``states`` (n) and ``inputs`` (m), and their ``units``: in JSON an object with
        the units of some names, elsewhere texts in the order of states and inputs, "" for none.

    Returns
    -------
    Problem
        The system, and the states or None.

    Raises
    ------
    InputError
        If the file has another format, or an entry is missing, unknown, duplicate or not usable;
        or `path` is a directory, a pipe or a device.
    InputTypeError
        If `path` is not a path.
    ImportError
        If it is a ``.mat`` file and SciPy is not installed.
    ResourceError
        If the content does not fit into the memory this process may use.
    OSError
        If the file cannot be read.

    Notes
    -----
    Reading executes nothing: arrays of Python objects are refused.

    SciPy (extra ``mat``) reads MATLAB files up to version 7.2, ``save(name, 'A', 'B', '-v7')``; the
    step may be called ``Ts``. Texts are cells or rows of characters. A damaged file that is not
    compressed (version 6) can end the process in SciPy: read files of others in a process apart.

    Examples
    --------
    >>> import json, tempfile, pathlib, stochens_rs as se
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "problem.json"
    >>> _ = path.write_text(json.dumps({"A": [[0.5]], "B": [[1.0]], "x0": [2.0]}))
    >>> se.cases.from_file(path).system
    <System: n=1 m=1 dt=None>
    """
    path = Path(checked_path("path", path))
    size = regular_file(path).st_size
    kind = path.suffix.lower()
    if is_state(path):
        raise InputError(f"{path} must be a problem, got a saved object: Model.load reads a model")
    running.need(f"to read {path}", size * _MEMORY.get(kind, _PARSED))
    found = {".mat": _mat, ".npz": _npz}.get(kind, _json)(path)
    unknown = sorted(set(found) - set(_NAMES))
    if unknown:
        raise InputError(
            f"{path} must have the entries A and B, and optionally x0, xf, dt, states, inputs and "
            f"units, got also {unknown[0][:40]!r}{validation.nearest(unknown[0], _NAMES)}"
        )
    missing = next((name for name in ("A", "B") if name not in found), None)
    if missing is not None:
        raise InputError(f"{path} must have the entries A and B, {missing} is missing")
    about: dict[str, Any] = {name: found.get(name) for name in ("dt", "states", "inputs", "units")}
    for name, value in about.items():
        if isinstance(value, np.ndarray) and (name != "dt" or value.size == 1):
            about[name] = value.item() if name == "dt" else value.tolist()
    units = about.pop("units")
    system = System(found["A"], found["B"], **about)
    if not isinstance(units, dict) and units is not None:  # in the order of states and inputs
        names, units = system.state_names + system.input_names, validation.items("units", units)
        if len(units) != len(names):
            raise ShapeError(f"`units` must have a text for each of {len(names)}, got {len(units)}")
        units = {name: unit for name, unit in zip(names, units, strict=True) if unit != ""}
    if units:
        system = System(system.A, system.B, **about, units=units)
    x0, xf = (
        None if found.get(name) is None else validation.vector(name, found[name], length=system.n)
        for name in ("x0", "xf")
    )
    return Problem(system, x0, xf)


def _npz(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                unpacked = sum(entry.file_size for entry in archive.zip.infolist())
                running.need(f"{path}, unpacked,", unpacked)
                return _once([(name, archive[name]) for name in archive.files])
        except ResourceError:
            raise
        except Exception as error:  # a damaged archive raises anything from three libraries
            raise InputError(f"{path} must be an archive of numeric arrays: {error}") from error


def _mat(path: Path) -> dict[str, Any]:
    with extra("SciPy reads .mat files", "mat"):
        from scipy.io import loadmat
    try:
        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("error")  # a variable that is there twice
            loaded = loadmat(file)
    except NotImplementedError:  # HDF5
        raise InputError(
            f"{path} must be a MATLAB file up to version 7.2, got 7.3: save it again with "
            "save(name, 'A', 'B', '-v7')"
        ) from None
    except Exception as error:  # a damaged file raises anything
        reason = " ".join(f"{error}".split())[:120]
        raise InputError(f"{path} must be a whole MATLAB file: {reason}") from None
    found: dict[str, Any] = {}
    for name, value in loaded.items():
        if name.startswith("__") and isinstance(value, (bytes, str, list)):  # about the file
            continue
        if not isinstance(value, np.ndarray) or value.dtype.names:
            raise InputError(
                f"{path} must have arrays of numbers and cells of text, got another kind in "
                f"{name[:40]}: save full(A) of a sparse matrix, the fields of a struct, and of an "
                f"ss object [A, B] = ssdata({name[:40]}) and dt"
            )
        if value.dtype.kind in "OU":  # cells, each with one row of text or none; rows of characters
            cells = [np.asarray(one).ravel() for one in value.ravel()]
            if all(one.dtype.kind == "U" and len(one) < 2 for one in cells):
                value = ["".join(one).rstrip() for one in cells]
        elif name in ("x0", "xf") and 1 in value.shape:  # MATLAB has no vectors
            value = value.ravel()
        found["dt" if name == "Ts" else name] = value
    return found


def _json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_bytes().decode("utf-8"), object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:  # not text, not JSON, or nested too deeply
        meant = validation.nearest(path.suffix, _MEMORY)
        meant += "; measured runs become a model by identify" * (path.suffix == ".csv")
        raise InputError(f"{path} must be JSON, or end in .npz or .mat: {error}{meant}") from error
    if not isinstance(found, dict):
        raise InputError(f"{path} must be a JSON object, got {type(found).__name__}")
    return found


def _once(entries: list[tuple[str, Any]]) -> dict[str, Any]:
    """The entries, of which each has a name of its own."""
    name, count = Counter(name for name, _ in entries).most_common(1)[0] if entries else ("", 0)
    if count > 1:
        raise ValueError(f"the entry {name!r} appears twice")
    return dict(entries)
