"""The file of a study: what the study is, then blocks of numbers as they are done.

Each record is a state file of `docs/saving.md` with its length (8 bytes, little-endian)
before it, and a mark behind it that is written when the record is on the disk: first the manifest,
then blocks, numbered by their generation. Records are only ever appended. A last one that cannot be
read is replaced by the next if no mark follows: its writer was killed. With a mark it is damaged.
"""

from __future__ import annotations

import errno
import glob
import json
import math
import os
import stat
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from .._base import files, running, saving, validation
from ..exceptions import InputError, InputTypeError, StateError, StateIOError, StateNotFoundError
from .tasks import DONE, FAILED, Block, Layout

MANIFEST, BLOCK = "study", "study-block"  # kinds of records
_MARK = b"\x89STU\r\n\x1a\xff"  # then where its record begins; in no text, and in no plain number
_MARKED = len(_MARK) + 8
EVERY = 1.0  # seconds between two writes
_MOST_BYTES = 2**26  # that wait to be written
_PIECE = 2**20


class StudyFile:
    """A file that is locked by this process, to which blocks are appended."""

    def __init__(self, path: str) -> None:
        self.path = path
        self._lock = saving.lock(path)
        self._file: BinaryIO | None = None
        self._waiting: list[Block] = []
        self._bytes = 0
        self._last = time.monotonic()
        self._records = 0

    def create(self, manifest: dict[str, Any]) -> None:
        """Begin a new file, which appears with its manifest in it."""
        try:
            for left in glob.glob(f"{glob.escape(self.path)}.{'[0-9a-f]' * 16}.tmp"):
                os.remove(left)  # its writer was killed: this process has the lock
            with files.replaced(self.path) as part, open(part, "wb") as file:
                file.write(_framed(MANIFEST, 1, {"manifest": _json(manifest)}) + _mark(0))
            self._file = open(self.path, "r+b", buffering=0)  # noqa: SIM115
            self._file.seek(0, os.SEEK_END)
        except OSError as error:
            raise _failed(error, self.path) from error
        self._records = 1

    def extend(self) -> Iterator[Block]:
        """Return the blocks of an existing file; then more can be appended."""
        start = end = 0
        for at, after, found in records(self.path):
            self._records, start, end = self._records + 1, at, after
            if isinstance(found, list):
                yield from found
        try:
            self._file = open(self.path, "r+b", buffering=0)  # noqa: SIM115
            self._file.seek(end)
            self._write(_mark(start))  # the writer may have been killed before it
            self._file.truncate()
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
        record = _framed(BLOCK, self._records + 1, _sections(self._waiting))
        start = self._file.tell()
        try:
            self._write(record)
            os.fsync(self._file.fileno())
            self._write(_mark(start))
        except OSError as error:
            with suppress(OSError):  # nothing may be appended to a part of a record
                self._file.seek(start)
                self._file.truncate()
            raise _failed(error, self.path) from error
        self._records += 1
        self._waiting, self._bytes = [], 0

    def _write(self, content: bytes) -> None:
        written = 0
        while self._file is not None and written < len(content):
            written += self._file.write(memoryview(content)[written:])

    def close(self) -> None:
        """Give the file free; what waits is not written."""
        if self._file is not None:
            self._file.close()
        self._lock.release()


def read_manifest(path: str) -> dict[str, Any]:
    """Return the first record of a file."""
    for _, _, found in records(path):
        return found  # type: ignore[return-value]
    raise StateError(f"{path} is not the file of a study: it is empty")


def read_blocks(path: str) -> Iterator[Block]:
    """Yield the blocks of a file in their order."""
    for _, _, found in records(path):
        if isinstance(found, list):
            yield from found


def records(path: str) -> Iterator[tuple[int, int, dict[str, Any] | list[Block]]]:
    """Yield the records: where each begins and ends, and the manifest or blocks.

    Stops in front of a last record that was not completed. Raises `StateError` if any other cannot
    be read.
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
                begin = file.read(9)  # of a state file: the length of its JSON, and that
                if begin[8:] != b"{" or int.from_bytes(begin[:8], "little") > length - 8:
                    raise StateError(f"{path} has no record at byte {at}")
                running.need("a block of a study", 4 * length)
                content = begin + file.read(length - 9)
                generation, sections = saving.decode(path, content, kind)
            except StateError as error:
                if not number:
                    raise StateError(f"{path} is not the file of a study: {error}") from error
                if _marked(file, at):
                    raise StateError(f"{path} is damaged at byte {at}: {error}") from error
                return
            start, end, number = at, at + 8 + length, number + 1
            if generation != number:
                raise StateError(f"{path} must have record {number} at {start}, got {generation}")
            try:
                yield start, end, (_blocks if kind == BLOCK else _manifest)(sections)
            except (KeyError, InputError, InputTypeError, ValueError, RecursionError) as error:
                text = f"{path}: record {number} is not one of a study: {error}"
                raise StateError(text) from error
            if file.read(_MARKED) != _mark(start):
                if _marked(file, end):
                    raise StateError(f"{path} is damaged at byte {end}: no mark of record {number}")
                return
            at = end + _MARKED


def _mark(start: int) -> bytes:
    """What stands behind a complete record that begins at `start`."""
    return _MARK + start.to_bytes(8, "little")


def _marked(file: BinaryIO, at: int) -> bool:
    """Whether a record that begins at `at` or behind it was completed: then this one was, too."""
    place = at
    while True:
        try:
            place = file.seek(place, os.SEEK_DATA)  # a mark is not in a hole
        except (OSError, AttributeError) as error:  # no data, or a system that knows no holes
            if getattr(error, "errno", None) == errno.ENXIO:
                return False
        file.seek(place)
        piece = file.read(_PIECE + _MARKED - 1)  # a mark may be split over two pieces
        found = piece.find(_MARK)
        while 0 <= found <= len(piece) - _MARKED:
            start = int.from_bytes(piece[found + len(_MARK) : found + _MARKED], "little")
            if at <= start < place + found:
                return True
            found = piece.find(_MARK, found + 1)
        if len(piece) < _PIECE + _MARKED - 1:
            return False
        place += _PIECE


def _framed(kind: str, number: int, sections: dict[str, NDArray[Any]]) -> bytes:
    content = saving.encode(kind, number, sections)
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
    platform = {k: validation.text(f"platform[{k!r}]", v) for k, v in about["platform"].items()}
    errors = {int(t): validation.text("errors", text) for t, text in about["errors"].items()}
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
        raise InputError(f"`layout[{name!r:.60}]` must be a shape, got {validation.show(shape)}")
    return tuple(validation.size(f"layout[{name!r:.60}]", length, minimum=0) for length in shape)


def _failed(error: OSError, path: str) -> StateIOError:
    return StateIOError(error.errno, f"cannot use the file of a study: {error.strerror}", path)
