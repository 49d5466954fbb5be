"""Streams in files: `save`, `load`, and checkpoints on the way."""

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
    """In a forked child: its share of a lock would keep that locked after the parent's death."""
    for lock in list(_held):
        lock.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)


class Durable:
    """What can be written down as named arrays of numbers, and made again from them."""

    _kind: ClassVar[str]

    def _to_sections(self) -> dict[str, Any]:
        raise NotImplementedError

    @classmethod
    def _from_sections(cls, sections: dict[str, Any]) -> Self:
        raise NotImplementedError

    def save(self, path: PathLike) -> int:
        """Save the state so that it survives whatever happens next.

        Parameters
        ----------
        path : path
            The file; the state that was there before is kept beside it as ``<path>.prev``.

        Returns
        -------
        int
            The generation: 1 for the first state at this path, then one more each time. When it
            is returned, the state is on the disk.

        Raises
        ------
        StateError
            If something else than a stream's state is at `path`.
        StateLockedError
            If another thread or process is saving there, or a run has it as its checkpoint.
        StateIOError
            If the system refuses: no space, no permission. The states before are untouched.
        InputError, InputTypeError
            If `path` cannot be the name of a file.

        Notes
        -----
        The file is one of safetensors, readable by any tool for that format, with a version and a
        SHA-256 digest; nothing in it is ever executed (``docs/state-format.md``). It is written
        beside its place, synced and renamed, and the directory synced: one complete state is
        there at every moment.

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
        """Load a state that `save` has written.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        Stream or DataStream
            It goes on exactly as the saved one would have, bit for bit.

        Raises
        ------
        StateError
            If neither `path` nor the generation before can be used: damaged, of another kind,
            from a newer version, or numbers that cannot be such a state.
        StateNotFoundError
            If neither exists.
        StateIOError
            If the system refuses to read.
        InputError, InputTypeError
            If `path` cannot be the name of a file.

        Warns
        -----
        StateRecoveredWarning
            If the file is missing or damaged and the generation before was loaded.

        Notes
        -----
        Nothing is written. Sizes are checked before memory is asked for, then the digest, then
        what the numbers mean: finite, within the hull, and of the key and problem that they name.

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
    """Saves a stream now and then while it runs, as the only writer of its file.

    The lock is held from the start of a run to its end; it ends with the process as well.
    """

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
                self._refuse_a_loss(self._path)
            except BaseException:  # which may be answered by a run that goes on from there
                self._lock.release()
                raise
        return self

    def __exit__(self, *_: object) -> None:
        if self._lock is not None:
            self._lock.release()

    def _refuse_a_loss(self, path: str) -> None:
        """A checkpoint replaces an earlier one of the same stream, and nothing else."""
        previous = path + ".prev"
        if not (os.path.lexists(path) or os.path.lexists(previous)):
            return
        _, theirs = state_file.load(path, self._stream._kind)
        ours = self._stream._to_sections()
        if "digest" not in theirs or theirs["digest"].tobytes() != ours["digest"].tobytes():
            raise StateError(
                f"{path} must be a state of this problem, key and options, got another: it would "
                "be replaced"
            )
        there, here = int(theirs["steps"][0]), int(ours["steps"][0])
        if there > here:
            raise StateError(
                f"{path} is at step {there}, ahead of this stream at step {here}: load it to go "
                "on from there (`Stream.load`, `stochens stream --resume`), choose another path, "
                f"or remove it and {previous}"
            )

    def due(self) -> None:
        """Save if it is time to."""
        if self._path is not None and time.monotonic() - self._last >= self._every:
            self.save()

    def save(self) -> None:
        """Save at once."""
        if self._path is not None:
            sections = self._stream._to_sections()
            state_file.save(self._path, self._stream._kind, sections, self._lock)
            self._last = time.monotonic()
