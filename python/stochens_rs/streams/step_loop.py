"""Steps until a stopping rule or a limit is met, with checkpoints."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

from .. import _core
from .._base import files, state_file, validation
from .._base.durable import Durable
from .._base.files import PathLike
from .._base.types import Status
from ..exceptions import InputError, StateError, StateIOError

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


Rule: TypeAlias = Literal["certificate", "printed"]
RULES: tuple[Rule, ...] = get_args(Rule)

_ENDLESS = 2**62  # more steps than any run can take
_SLICE = 0.2  # seconds between two calls of the progress bar


@dataclass(frozen=True)
class Stop:
    """When a run ends; `rule` is None without a tolerance."""

    rule: Rule | None
    tol: float
    max_steps: int | None
    time_limit: float | None


def checked_stop(
    tol: float | None, max_steps: int | None, time_limit: float | None, rule: Rule
) -> Stop:
    """Check the arguments of `Stream.run` that say when it ends."""
    name = validation.choice("rule", rule, RULES)
    limit = None if tol is None else validation.positive("tol", tol)
    most = None if max_steps is None else validation.size("max_steps", max_steps)
    seconds = None if time_limit is None else validation.positive("time_limit", time_limit)
    if limit is None and most is None and seconds is None:
        raise InputError("one of `tol`, `max_steps` and `time_limit` must be given")
    return Stop(None if limit is None else name, limit or 0.0, most, seconds)


def run_until(
    core: _core.Stream,
    stop: Stop,
    bar: AbstractContextManager[Callable[[int], object]],
    checkpoints: Checkpoints,
) -> Status:
    """Take steps until `stop`, and save at the end, also after an exception in a callback."""
    status: Status = "interrupted"
    try:
        with bar as report:
            status = _take_steps(core, stop, report, checkpoints)
    except KeyboardInterrupt:
        pass  # the core stops between two steps
    except (StateError, StateIOError):
        raise  # from a checkpoint
    except BaseException:  # from `bar` or a signal handler
        checkpoints.save()
        raise
    try:
        checkpoints.save()
    except KeyboardInterrupt:
        if status == "interrupted":
            raise  # the second one
        status = "interrupted"
        checkpoints.save()
    return status


def _take_steps(
    core: _core.Stream, stop: Stop, report: Callable[[int], object], checkpoints: Checkpoints
) -> Status:
    def steps() -> int:
        return core.counts()[0]

    def satisfied() -> bool:
        return stop.rule == "certificate" and core.certificate()[0] <= stop.tol

    if satisfied():
        return "converged"
    first, started = steps(), time.monotonic()
    while True:
        left = _ENDLESS if stop.max_steps is None else stop.max_steps - (steps() - first)
        rest = _SLICE
        if stop.time_limit is not None:
            rest = stop.time_limit - (time.monotonic() - started)
        end = core.advance(left, stop.rule, stop.tol, min(_SLICE, max(rest, 0.0)))
        report(steps() - first)
        checkpoints.due()
        if end != "time_limit" or (stop.time_limit is not None and rest <= _SLICE):
            return "converged" if satisfied() else end
