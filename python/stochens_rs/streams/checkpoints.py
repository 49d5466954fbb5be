"""Checkpoints of a stream during a run."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING

from .. import _core
from .._base import files, state_file, validation
from .._base.durable import Durable
from .._base.files import PathLike
from ..exceptions import StateError

if TYPE_CHECKING:
    from typing_extensions import Self


class Checkpoints:
    """Saves a stream during a run; locks the file from the start of the run to its end."""

    def __init__(self, stream: Durable, path: PathLike | None, every: float) -> None:
        self._stream = stream
        self._path = None if path is None else files.checked_path("checkpoint", path)
        self._every = validation.positive("every", every)
        self._lock: _core.StateLock | None = None
        self._last = time.monotonic()

    def __enter__(self) -> Self:
        if self._path is not None:
            self._lock = state_file.lock(self._path)
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
