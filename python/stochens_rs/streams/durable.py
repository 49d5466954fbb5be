"""`save` and `load` of streams, and checkpoints during a run."""

from __future__ import annotations

import os
import time
import weakref
from typing import TYPE_CHECKING, Any, ClassVar

from .. import _core
from .._base import files, gate
from .._base.files import PathLike
from ..exceptions import InputError, InputTypeError, StateError
from . import state_file

if TYPE_CHECKING:
    from typing_extensions import Self

_held: weakref.WeakSet[_core.StateLock] = weakref.WeakSet()


def _let_go() -> None:
    """Release the locks in a forked child: its copies would outlive those of the parent."""
    for lock in list(_held):
        lock.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)


class Durable:
    """Base of the classes whose state can be saved as named arrays and loaded again."""

    _kind: ClassVar[str]

    def _to_sections(self) -> dict[str, Any]:
        raise NotImplementedError

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Self:
        raise NotImplementedError

    def save(self, path: PathLike) -> int:
        """Save the state to a file.

        Parameters
        ----------
        path : path
            The file; the previous state is kept as ``<path>.prev``.

        Returns
        -------
        int
            The generation: 1 for the first state at this path, then one more each time. The state
            is on the disk when this returns.

        Raises
        ------
        StateError
            If the file at `path` is not a state of a stream of this kind.
        StateLockedError
            If another thread or process is saving there, or a run has it as its checkpoint.
        StateIOError
            If writing fails, for example for lack of space or permission. The previous states are
            not changed.
        InputError, InputTypeError
            If `path` is not a path.

        Notes
        -----
        The format is safetensors, with a version and a SHA-256 digest; loading executes nothing
        (``docs/state-format.md``). The file is written under another name, synced and renamed, and
        the directory is synced: a complete state is on the disk at any time.

        Examples
        --------
        >>> import tempfile, pathlib, stochens_rs as se
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "a.state"
        >>> stream = se.Stream(([[2.0]], [[1.0]]), [1.0], [0.0], rng=1)
        >>> stream.step(1000)
        >>> stream.save(path)
        1
        >>> se.Stream.load(path).steps
        1000
        """
        return state_file.save(path, self._kind, self._to_sections())

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Load a saved state.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        Stream, DataStream or ModelStream
            It continues exactly as the saved one, bit for bit.

        Raises
        ------
        StateError
            If neither the file nor the previous generation can be used: damaged, of another kind,
            of a newer version, or not a state of a stream.
        StateNotFoundError
            If neither exists.
        StateIOError
            If reading fails.
        InputError, InputTypeError
            If `path` is not a path.

        Warns
        -----
        StateRecoveredWarning
            If the file is missing or damaged and the previous generation was loaded.

        Notes
        -----
        Nothing is written. Checked are the sizes (before memory is allocated), the digest, and the
        numbers: finite; for realizations estimates in their hull, and the key and the problem those
        of the digest; for a model a triangle of as many pairs.

        Examples
        --------
        See `save`.
        """
        _, sections = state_file.load(path, cls._kind)
        try:
            return cls._from_sections(sections)
        except (InputError, InputTypeError, KeyError) as error:
            raise StateError(f"{os.fspath(path)}: {error}") from error


class Checkpoints:
    """Saves a stream during a run; locks the file from the start of the run to its end."""

    def __init__(self, stream: Durable, path: PathLike | None, every: float) -> None:
        self._stream = stream
        self._path = None if path is None else files.checked_path("checkpoint", path)
        self._every = gate.positive("every", every)
        self._lock: _core.StateLock | None = None
        self._last = time.monotonic()

    def __enter__(self) -> Self:
        if self._path is not None:
            self._lock = _core.StateLock(self._path)
            _held.add(self._lock)
            try:
                self._check_earlier(self._path)
            except BaseException:  # the caller may handle it and use the file again
                self._lock.release()
                raise
        return self

    def __exit__(self, *_: object) -> None:
        if self._lock is not None:
            self._lock.release()

    def _check_earlier(self, path: str) -> None:
        """Raise if the file is anything else than an earlier state of the same stream."""
        previous = path + ".prev"
        if not (os.path.lexists(path) or os.path.lexists(previous)):
            return
        _, theirs = state_file.load(path, self._stream._kind)
        ours = self._stream._to_sections()
        if "digest" not in theirs or theirs["digest"].tobytes() != ours["digest"].tobytes():
            raise StateError(
                f"{path} must be a state of this problem, key and options, got another"
            )
        there, here = int(theirs["steps"][0]), int(ours["steps"][0])
        if there > here:
            raise StateError(
                f"{path} is at step {there}, ahead of this stream at step {here}: load it "
                "(`Stream.load`, `stochens stream --resume`), choose another path, or remove it "
                f"and {previous}"
            )

    def due(self) -> None:
        """Save if the time between two checkpoints has passed."""
        if self._path is not None and time.monotonic() - self._last >= self._every:
            self.save()

    def save(self) -> None:
        """Save now."""
        if self._path is not None:
            sections = self._stream._to_sections()
            state_file.save(self._path, self._stream._kind, sections, self._lock)
            self._last = time.monotonic()
