"""A control problem from a file: A, B and, if the file has them, x0 and xf."""

from __future__ import annotations

import json
import os
import stat
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._base import gate, memory
from .._base.files import checked_path
from ..exceptions import InputError, ResourceError
from ..system import System

_NAMES = ("A", "B", "x0", "xf", "dt")
_KINDS = {
    stat.S_IFDIR: "directory",
    stat.S_IFIFO: "pipe",
    stat.S_IFCHR: "device",
    stat.S_IFBLK: "device",
    stat.S_IFSOCK: "socket",
}
# Bytes of memory per byte of JSON in the worst case: the 3 bytes "{}," become a dict of 80 bytes
# and a pointer of 8, 29 per byte; the text itself is in memory too.
_PARSED = 36


@dataclass(frozen=True, eq=False)
class Problem:
    """A system, with x0 and xf if the file has them.

    Attributes
    ----------
    system : System
        ``A``, ``B`` and ``dt``.
    x0, xf : ndarray, shape (n,), or None
        Initial state and target; None if the file does not have it.
    """

    system: System
    x0: NDArray[np.float64] | None
    xf: NDArray[np.float64] | None


def from_file(path: str | os.PathLike[str]) -> Problem:
    """Read a problem from NumPy's ``.npz`` or from JSON.

    Parameters
    ----------
    path : path
        A ``.npz`` file; a file with any other name is read as JSON. Entries: ``A`` (n, n),
        ``B`` (n, m), and optionally ``x0`` (n,), ``xf`` (n,) and the step ``dt`` [s].

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
    ResourceError
        If the content does not fit into the memory this process may use.
    OSError
        If the file cannot be read.

    Notes
    -----
    Reading executes nothing: arrays of Python objects are refused.

    Examples
    --------
    >>> import json, tempfile, pathlib, stochens_rs as se
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "problem.json"
    >>> _ = path.write_text(json.dumps({"A": [[0.5]], "B": [[1.0]], "x0": [2.0]}))
    >>> se.cases.from_file(path).system
    <System: n=1 m=1 dt=None>
    """
    path = Path(checked_path("path", path))
    about = path.stat()
    if not stat.S_ISREG(about.st_mode):  # a device or a pipe may block or never end
        kind = _KINDS.get(stat.S_IFMT(about.st_mode), "special file")
        cure = ": save it to a file first" if kind == "pipe" else ""
        raise InputError(f"{path} must be a regular file, got a {kind}{cure}")
    archive = path.suffix.lower() == ".npz"
    memory.need(f"to read {path}", about.st_size * (1 if archive else _PARSED))
    found = _npz(path) if archive else _json(path, about.st_size)
    unknown = sorted(set(found) - set(_NAMES))
    if unknown:
        raise InputError(
            f"{path} must have the entries A and B, and optionally x0, xf and dt, "
            f"got also {unknown[0]!r}"
        )
    missing = [name for name in ("A", "B") if name not in found]
    if missing:
        raise InputError(f"{path} must have the entries A and B, {missing[0]} is missing")
    dt: Any = found.get("dt")
    if isinstance(dt, np.ndarray):
        dt = dt.item() if dt.size == 1 else dt
    system = System(found["A"], found["B"], dt=dt)
    x0, xf = (
        None if found.get(name) is None else gate.vector(name, found[name], length=system.n)
        for name in ("x0", "xf")
    )
    return Problem(system, x0, xf)


def _npz(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                unpacked = sum(entry.file_size for entry in archive.zip.infolist())
                memory.need(f"{path}, unpacked,", unpacked)
                _once(archive.files)
                return {name: archive[name] for name in archive.files}
        except ResourceError:
            raise
        except Exception as error:  # a damaged archive raises anything from three libraries
            raise InputError(f"{path} must be an archive of numeric arrays: {error}") from error


def _json(path: Path, size: int) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            found = json.loads(file.read(size).decode("utf-8"), object_pairs_hook=_object)
    except (ValueError, RecursionError) as error:  # not text, not JSON, or nested too deeply
        raise InputError(f"{path} must be a .npz archive or JSON: {error}") from error
    if not isinstance(found, dict):
        raise InputError(f"{path} must be a JSON object, got {type(found).__name__}")
    return found


def _object(entries: list[tuple[str, Any]]) -> dict[str, Any]:
    _once([name for name, _ in entries])
    return dict(entries)


def _once(names: list[str]) -> None:
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ValueError(f"the entry {twice[0]!r} appears twice")
