"""The numbers of a run that is not finished, beside its results to be."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from .._base import state_file
from .._base.files import write_text
from ..exceptions import InputError, StateError
from ..studies.study_file import read_blocks
from ..studies.worker import DONE
from ._output import note

_INDEX = "options.json"


@contextmanager
def unfinished(
    directory: Path, options: Mapping[str, Any], *, resume: bool, force: bool
) -> Iterator[Path]:
    """Give the folder for the files of studies, which are removed if the run gets to its end.

    It is removed as well after an error before there are any numbers. Raises if it has those of
    another run, or, without `resume`, of any; `force` removes them.
    """
    folder = directory / "unfinished"
    folder.mkdir(exist_ok=True)
    index = folder / _INDEX
    lock = state_file.lock(str(folder / "run"))
    try:
        if index.exists():
            _require_use(index, options, resume=resume, force=force)
        write_text(index, json.dumps(dict(options)) + "\n")
        try:
            yield folder
        except Exception:
            if not _has_numbers(folder):
                _remove(folder)
            raise
        except KeyboardInterrupt:
            if _has_numbers(folder):
                note("what was computed is kept: the same command with --resume continues")
            raise
        _remove(folder)
    finally:
        lock.release()
        if not index.exists():
            (folder / "run.lock").unlink(missing_ok=True)
            for emptied in (folder / "claims", folder):
                with suppress(OSError):  # something of the user's is there
                    emptied.rmdir()


def _has_numbers(folder: Path) -> bool:
    """Whether a study keeps numbers, not only failures; or cannot be read."""
    try:
        kept = (block for path in folder.rglob("*.study") for block in read_blocks(str(path)))
        return any((block.states == DONE).any() for block in kept)
    except (OSError, StateError):
        return True


def _require_use(index: Path, options: Mapping[str, Any], *, resume: bool, force: bool) -> None:
    """Raise unless the run that is there may be continued, or was removed."""
    folder = index.parent
    if force and not resume:
        note(f"starting afresh: the unfinished run in {folder} is removed")
        _remove(folder)
        return
    if not resume:
        raise InputError(
            f"{folder} has an unfinished run: --resume continues it, --force starts afresh"
        )
    try:
        before = dict(json.loads(index.read_bytes()))
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"{index} is damaged: --force without --resume starts afresh") from error
    for name, value in options.items():
        if before.get(name) != value:
            raise InputError(
                f"--{name} of the unfinished run in {folder} is {before.get(name)}, got {value}: "
                "continue it with the same, or give --force without --resume to start afresh"
            )
    note(f"continuing the run in {folder}")


def _remove(folder: Path) -> None:
    """Remove the files of studies, and at last the index."""
    for path in folder.rglob("*.study*"):
        path.unlink(missing_ok=True)
    (folder / _INDEX).unlink(missing_ok=True)
