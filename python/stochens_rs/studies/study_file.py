"""The file of a study: what the study is, then blocks of numbers as they are done.

Each record is a state file of `docs/state-format.md` with its length (8 bytes, little-endian)
before it: first the manifest, then blocks, numbered by their generation. Records are only ever
appended. An incomplete last one, of a writer that was killed, is replaced by the next.
"""

from __future__ import annotations

import json
import math
import os
import stat
import time
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from .._base import gate, memory, state_file
from ..exceptions import InputError, InputTypeError, StateError, StateIOError, StateNotFoundError
from .block import DONE, FAILED, Block, Layout

MANIFEST, BLOCK = "study", "study-block"  # kinds of records
_BEGINNING = b'{"__metadata__":{"format":"stochens"'  # of each record, behind two lengths
_AHEAD = 16
EVERY = 1.0  # seconds between two writes
_MOST_BYTES = 2**26  # that wait to be written
_PIECE = 2**20


class StudyFile:
    """A file that is locked by this process, to which blocks are appended."""

    def __init__(self, path: str) -> None:
        self.path = path
        self._lock = state_file.lock(path)
        self._file: BinaryIO | None = None
        self._waiting: list[Block] = []
        self._bytes = 0
        self._last = time.monotonic()
        self._records = 0

    def create(self, manifest: dict[str, Any]) -> None:
        """Begin a new file, which appears with its manifest in it."""
        part = f"{self.path}.part"
        try:
            with open(part, "wb") as file:
                file.write(_framed(MANIFEST, 1, {"manifest": _json(manifest)}))
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, self.path)
            self._file = open(self.path, "r+b", buffering=0)  # noqa: SIM115
            self._file.seek(0, os.SEEK_END)
            _sync_folder(self.path)
        except OSError as error:
            raise _failed(error, self.path) from error
        self._records = 1

    def extend(self) -> Iterator[Block]:
        """Return the blocks of an existing file; then more can be appended."""
        end = 0
        for at, found in records(self.path):
            self._records, end = self._records + 1, at
            if isinstance(found, list):
                yield from found
        try:
            self._file = open(self.path, "r+b", buffering=0)  # noqa: SIM115
            self._file.truncate(end)
            self._file.seek(end)
        except OSError as error:
            raise _failed(error, self.path) from error

    def append(self, block: Block) -> None:
        """Add a block; blocks are written together, about every second."""
        self._waiting.append(block)
        self._bytes += sum(rows.nbytes for rows in block.values.values())
        if self._bytes > _MOST_BYTES:
            self.flush()
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Write what waits if the last write was some time ago."""
        if self._waiting and time.monotonic() - self._last >= EVERY:
            self.flush()

    def flush(self) -> None:
        """Write what waits; it is on the disk when this returns."""
        self._last = time.monotonic()
        if not self._waiting or self._file is None:
            return
        self._records += 1
        record = _framed(BLOCK, self._records, _sections(self._waiting))
        try:
            written = 0
            while written < len(record):
                written += self._file.write(memoryview(record)[written:])
            os.fsync(self._file.fileno())
        except OSError as error:
            raise _failed(error, self.path) from error
        self._waiting, self._bytes = [], 0

    def close(self) -> None:
        """Give the file free; what waits is not written."""
        if self._file is not None:
            self._file.close()
        self._lock.release()


def read_manifest(path: str) -> dict[str, Any]:
    """Return the first record of a file."""
    for _, found in records(path):
        return found  # type: ignore[return-value]
    raise StateError(f"{path} is not the file of a study: it is empty")


def read_blocks(path: str) -> Iterator[Block]:
    """Yield the blocks of a file in their order."""
    for _, found in records(path):
        if isinstance(found, list):
            yield from found


def records(path: str) -> Iterator[tuple[int, dict[str, Any] | list[Block]]]:
    """Yield the records: where each ends, and the manifest or blocks.

    Stops in front of an incomplete last record. Raises `StateError` if any other is damaged.
    """
    try:
        # without waiting for a writer, should it be a pipe
        how = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        opened = os.open(path, how)
    except FileNotFoundError as error:
        raise StateNotFoundError(error.errno, "there is no such study", path) from error
    except OSError as error:
        raise _failed(error, path) from error
    found = os.fstat(opened)
    if not stat.S_ISREG(found.st_mode):
        os.close(opened)
        raise StateError(f"{path} is not the file of a study: it is no regular file")
    with open(opened, "rb") as file:
        at, number, size = 0, 0, found.st_size
        while at < size:
            head = file.read(8)
            length = int.from_bytes(head, "little")
            kind = BLOCK if number else MANIFEST
            try:
                if len(head) < 8 or length > size - at - 8:
                    raise StateError(f"{path} ends within a record")
                memory.need("a block of a study", 4 * length)
                content = file.read(length)
                generation, sections = state_file.decode(path, content, kind)
            except StateError as error:
                if not number:
                    raise StateError(f"{path} is not the file of a study: {error}") from error
                if _goes_on(file, at):
                    raise StateError(f"{path} is damaged at byte {at}: {error}") from error
                return
            at, number = at + 8 + length, number + 1
            if generation != number:
                raise StateError(f"{path} must have record {number} at {at}, got {generation}")
            try:
                yield at, (_blocks if kind == BLOCK else _manifest)(sections)
            except (KeyError, InputError, InputTypeError, ValueError, RecursionError) as error:
                text = f"{path}: record {number} is not one of a study: {error}"
                raise StateError(text) from error


def _goes_on(file: BinaryIO, at: int) -> bool:
    """Whether another record begins behind the one at `at`, which then is damaged, not cut off."""
    at += _AHEAD + 1
    while True:
        file.seek(at)
        piece = file.read(_PIECE + len(_BEGINNING))
        if _BEGINNING in piece:
            return True
        if len(piece) <= len(_BEGINNING):
            return False
        at += _PIECE


def _framed(kind: str, number: int, sections: dict[str, NDArray[Any]]) -> bytes:
    content = state_file.encode(kind, number, sections)
    return len(content).to_bytes(8, "little") + content


def _json(value: Any) -> NDArray[np.uint8]:
    return np.frombuffer(json.dumps(value).encode(), dtype=np.uint8)


def _sections(blocks: list[Block]) -> dict[str, NDArray[Any]]:
    """Several blocks as one record."""
    layout: Layout = next((block.layout for block in blocks if block.layout), {})
    errors = {str(task): text for block in blocks for task, text in block.errors.items()}
    about = {"layout": layout, "platform": blocks[0].platform, "errors": errors}
    found: dict[str, NDArray[Any]] = {
        "starts": np.array([block.start for block in blocks], dtype=np.uint64),
        "counts": np.array([len(block.states) for block in blocks], dtype=np.uint64),
        "states": np.concatenate([block.states for block in blocks]),
        "about": _json(about),
    }
    for name, shape in layout.items():
        nothing = [np.full((len(block.states), *shape), np.nan) for block in blocks]
        rows = [b.values.get(name, n).ravel() for b, n in zip(blocks, nothing, strict=True)]
        found[f"values.{name}"] = np.concatenate(rows)
    return found


def _manifest(sections: dict[str, Any]) -> dict[str, Any]:
    found = json.loads(sections["manifest"].tobytes())
    if not isinstance(found, dict) or len(sections) != 1:
        raise InputError("the manifest must be one mapping")
    return found


def _blocks(sections: dict[str, Any]) -> list[Block]:
    """The blocks of a record, with all that is said of them checked."""
    starts, counts, states = (sections.pop(name) for name in ("starts", "counts", "states"))
    about = json.loads(sections.pop("about").tobytes())
    if starts.dtype != np.uint64 or counts.dtype != np.uint64 or states.dtype != np.uint8:
        raise InputError("`starts`, `counts` and `states` must be of uint64, uint64 and uint8")
    for name in ("layout", "platform", "errors"):
        if not isinstance(about, dict) or not isinstance(about.get(name), dict):
            raise InputError(f"`{name}` must be a mapping")
    if len(starts) != len(counts) or sum(map(int, counts)) != len(states):
        raise InputError("`counts` must be those of `states`")
    if len(states) and int(states.max()) > FAILED:
        raise InputError(f"`states` must be at most {FAILED}, got {int(states.max())}")
    layout = {name: _shape(name, shape) for name, shape in about["layout"].items()}
    platform = {k: gate.text(f"platform[{k!r}]", v) for k, v in about["platform"].items()}
    errors = {int(t): gate.text("errors", text) for t, text in about["errors"].items()}
    values = {}
    for name, shape in layout.items():
        rows = sections.pop(f"values.{name}")
        if rows.dtype != np.float64 or rows.size != len(states) * math.prod(shape):
            raise InputError(f"`values.{name}` must have {len(states)} rows of shape {shape}")
        values[name] = rows.reshape(len(states), *shape)
    if sections:
        raise InputError(f"a block has no array {min(sections)!r}")
    if not layout and np.any(states == DONE):
        raise InputError("`states` must not be done without numbers")
    blocks, first = [], 0
    for start, count in zip(starts.tolist(), counts.tolist(), strict=True):
        here = slice(first, first + count)
        own = {t: text for t, text in errors.items() if start <= t < start + count}
        rows = {name: of_all[here] for name, of_all in values.items()}
        blocks.append(Block(start, states[here], layout, rows, own, platform))
        first += count
    return blocks


def _shape(name: str, shape: Any) -> tuple[int, ...]:
    if not isinstance(shape, list) or len(shape) > 32:
        raise InputError(f"`layout[{name!r:.60}]` must be a shape, got {gate.show(shape)}")
    return tuple(gate.size(f"layout[{name!r:.60}]", length, minimum=0) for length in shape)


def _sync_folder(path: str) -> None:
    """Let a new name survive a power failure, where folders can be synced."""
    if os.name == "posix":
        folder = os.open(os.path.dirname(os.path.abspath(path)), os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _failed(error: OSError, path: str) -> StateIOError:
    return StateIOError(error.errno, f"cannot use the file of a study: {error.strerror}", path)
