"""Tasks of a study: axes of values, blocks of tasks, their table, the file that keeps the blocks.

Task t is replicate ``t // size`` of configuration ``t % size``. Its key depends on the labels of
the configuration and on the number of the replicate, so no block depends on another one.

A file begins with the length up to which it is on the disk, and the complement of that length. Then
come records, which are only ever appended: the length of a state file of `docs/files.md`, and the
state file with a block, numbered by its generation. The first block says what the study is; a later
one may say so again, with more replicates.
What cannot be read is damaged below that length, and behind it was cut short with its writer.
"""

from __future__ import annotations

import functools
import glob
import hashlib
import inspect
import io
import json
import keyword
import math
import os
import pickle
import platform
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, BinaryIO, TypeAlias

import numpy as np

from .._base import files, running, validation
from .._base.records import Record, SavedRecord
from .._base.types import Floats, NDArray, Self
from .._base.validation import show
from .._core import version
from ..exceptions import (
    InputError,
    InputTypeError,
    ShapeError,
    StateError,
    StateIOError,
    StateNotFoundError,
)
from ..rng import Key

Label: TypeAlias = bool | int | float | str | None
OWN = ("key", "self", "replicate")  # names of arguments and columns that every study has


@dataclass(frozen=True)
class Grid:
    """The axes: for each name its labels, and the values that the function gets for them."""

    labels: dict[str, tuple[Label, ...]]
    values: dict[str, tuple[Any, ...]]
    nested: str | None
    shared: tuple[str, ...]

    @property
    def outer(self) -> tuple[str, ...]:
        """The axes with one value in each call."""
        return tuple(name for name in self.labels if name != self.nested)

    @property
    def shape(self) -> tuple[int, ...]:
        """The lengths of these axes."""
        return tuple(len(self.labels[name]) for name in self.outer)

    @property
    def size(self) -> int:
        """The number of configurations."""
        return math.prod(self.shape)

    def positions(self, number: int) -> dict[str, int]:
        """Where a configuration lies on each axis; the last axis runs fastest."""
        places = np.unravel_index(number, self.shape) if self.shape else ()
        return {name: int(at) for name, at in zip(self.outer, places, strict=True)}

    def configuration(self, number: int) -> dict[str, Any]:
        """What the function gets: a value of each axis, and all values of the nested one, which
        are an array if they are numbers.
        """
        chosen = {name: self.values[name][at] for name, at in self.positions(number).items()}
        if self.nested is not None:
            every = self.values[self.nested]
            numbers = all(validation.is_real(value) for value in every)
            chosen[self.nested] = np.array(every) if numbers else every
        return chosen

    def text(self, number: int) -> str:
        """The labels of a configuration as JSON, in the order of the names; not those of the nested
        axis and of shared ones.
        """
        places = self.positions(number).items()
        labels = {k: _whole(self.labels[k][at]) for k, at in places if k not in self.shared}
        return json.dumps(labels, sort_keys=True, separators=(",", ":"))

    def digests(self) -> dict[str, tuple[str | None, ...]]:
        """Those of the values, by axis; None for a value that is its own label."""
        return {
            name: tuple(
                None if value is label else digest(f"grid[{name!r}]", value)
                for label, value in zip(labels, self.values[name], strict=True)
            )
            for name, labels in self.labels.items()
        }


def checked_grid(grid: object, nested: object = None, shared: object = ()) -> Grid:
    """Check the axes of a study."""
    if not isinstance(grid, Mapping):
        raise InputTypeError(f"`grid` must be a mapping of axes to values, got {show(grid)}")
    labels: dict[str, tuple[Label, ...]] = {}
    values: dict[str, tuple[Any, ...]] = {}
    for name, given in grid.items():
        validation.text("grid", name)
        if not name.isidentifier() or keyword.iskeyword(name):
            raise InputError(f"`grid` must name its axes as arguments of a function, got {name!r}")
        if name in OWN:
            raise InputError(f"`grid` must not have an axis {name!r}, which every study has")
        labels[name], values[name] = _axis(f"grid[{name!r}]", given)
    names = tuple(labels)
    if nested is not None:
        nested = validation.choice("nested", nested, names)
    listed = validation.items("shared", shared)
    axes = tuple(validation.choice("shared", name, names) for name in listed)
    if nested in axes:
        raise InputError(f"`shared` must not contain the nested axis {nested!r}")
    return Grid(labels, values, nested, axes)


def _axis(name: str, given: object) -> tuple[tuple[Label, ...], tuple[Any, ...]]:
    """The labels and the values of one axis."""
    if isinstance(given, Mapping):
        labels: tuple[Label, ...] = tuple(validation.text(f"{name} label", one) for one in given)
        values = tuple(given.values())
    else:
        values = labels = tuple(_plain(name, value) for value in validation.items(name, given))
    if not labels:
        raise InputError(f"`{name}` must have at least one value, got none")
    texts = [json.dumps(_whole(label)) for label in labels]  # equal numbers have one text
    if len(set(texts)) < len(texts):
        twice = next(text for text in texts if texts.count(text) > 1)
        raise InputError(f"`{name}` must have different values, got {twice} twice")
    return labels, values


def _plain(name: str, value: object) -> Label:
    """A number, a text or None, as Python has it."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, int) and abs(value) >= 2**1023:
        raise InputError(f"`{name}` must be numbers that a float holds, got {show(value)}")
    if value is None or type(value) in (bool, int):
        return value  # type: ignore[return-value]
    if isinstance(value, str):
        return validation.text(name, value)
    if isinstance(value, float):
        if math.isnan(value):
            raise InputError(f"`{name}` must not contain nan")
        return float(value)
    raise InputTypeError(
        f"`{name}` must contain numbers, texts or None, got {show(value)}: give other values "
        "names, as in {'a': ..., 'b': ...}"
    )


def _whole(label: Label) -> Label:
    """10 for 10.0."""
    whole = isinstance(label, float) and label.is_integer() and abs(label) < validation.EXACT
    return int(label) if whole else label  # type: ignore[arg-type]


def full_name(function: object) -> str:
    """Module and qualified name of what is called."""
    while isinstance(function, functools.partial):
        function = function.func
    named: Any = function if hasattr(function, "__qualname__") else type(function)
    return f"{named.__module__}.{named.__qualname__}"


def function_digest(function: Any, version: str | None) -> str:
    """SHA-256 of the name and the source text of a function, of `version`, and of what a partial
    function, a method or an object that is called holds.
    """
    parts: list[Any] = [full_name(function), version]
    while isinstance(function, functools.partial):
        parts += [function.args, sorted(function.keywords.items())]
        function = function.func
    if inspect.ismethod(function):
        parts.append(function.__self__)
    elif not hasattr(function, "__qualname__"):
        parts.append(function)
        function = type(function)
    try:
        parts.append(inspect.getsource(function))
    except (OSError, TypeError) as error:
        if version is None:
            raise InputError(f"`version` must be given: {parts[0]} has no source") from error
    return digest("function", parts)


def digest(name: str, value: object) -> str:
    """SHA-256 of what a value is pickled as; `name` is for messages."""
    file = io.BytesIO()
    pickler = pickle.Pickler(file, 4)
    pickler.fast = True  # the same bytes for equal values, whatever objects they share
    try:
        pickler.dump(value)
    except Exception as error:  # whatever a foreign object raises
        reason = " ".join(str(error).split())[:120]
        raise InputError(
            f"`{name}` holds what cannot be kept with the study ({reason}): name it in an axis "
            "{name: value}, or make it inside the function"
        ) from error
    return hashlib.sha256(file.getvalue()).hexdigest()


Layout: TypeAlias = dict[str, tuple[int, ...]]  # names of what a task returns, and their shapes

WAITING, DONE, FAILED = 0, 1, 2  # the state of a task
MOST = 2**40  # tasks


class Manifest(Record, eq=True):
    """What must agree for a study to be continued, but for more replicates and other units."""

    stochens_rs: str
    key: Key
    grid: dict[str, tuple[Any, ...]]  # the labels on each axis
    digests: dict[str, tuple[str | None, ...]]  # of values that are not their own labels
    nested: str | None
    shared: tuple[str, ...]
    replicates: tuple[int, int]  # the first, and the one behind the last
    function: str
    version: str | None
    function_digest: str
    units: dict[str, str]

    def _check(self) -> None:
        if not 0 <= self.replicates[0] < self.replicates[1] <= MOST:
            raise InputError(f"`replicates` must be the first and the end, got {self.replicates}")


class Block(SavedRecord):
    """Some tasks and what became of them: numbers by name, a row for each task; one text for each
    that failed, in their order; and where they ran. Or what the study is.
    """

    _kind = "study"

    tasks: Annotated[NDArray[np.int64], "task"]
    states: Annotated[NDArray[np.int8], "task"]
    values: dict[str, Floats]
    errors: tuple[str, ...]
    platform: dict[str, str]
    seconds: float = 0.0
    study: Manifest | None = None

    def _check(self) -> None:
        if not np.isin(self.states, (WAITING, DONE, FAILED)).all():
            raise InputError(f"`states` must be in 0 to {FAILED}")
        if np.count_nonzero(self.states == FAILED) != len(self.errors):
            raise InputError("`errors` must be one text for each task that failed")
        if any(rows.shape[:1] != self.tasks.shape for rows in self.values.values()):
            raise ShapeError(f"`values` must have {len(self.tasks)} rows")
        if not self.values and np.any(self.states == DONE):
            raise InputError("`states` must not be done without numbers")

    @classmethod
    def of(cls, study: Manifest) -> Self:
        """The block that says what a study is."""
        return cls(np.zeros(0, np.int64), np.zeros(0, np.int8), {}, (), {}, study=study)

    @property
    def layout(self) -> Layout:
        """Names and shapes of the numbers."""
        return {name: rows.shape[1:] for name, rows in self.values.items()}


def room(layout: Layout, count: int) -> dict[str, Floats]:
    """Arrays for the numbers of so many tasks."""
    entries = sum(math.prod(shape) for shape in layout.values())
    running.need("the numbers of the replicates", 8 * count * entries)
    return {name: np.full((count, *shape), np.nan) for name, shape in layout.items()}


class Table:
    """States and numbers of the tasks from `first` on, filled by blocks in any order."""

    def __init__(self, first: int, count: int) -> None:
        self.first = first
        running.need("the states of the replicates", count)
        self.states: NDArray[np.int8] = np.zeros(count, np.int8)
        self.layout: Layout = {}
        self.values: dict[str, Floats] = {}
        self.errors: dict[int, str] = {}
        self.platforms: list[dict[str, str]] = []

    def add(self, block: Block, source: str = "this study") -> None:
        """Enter a block; numbers that are there must be the same, a failure may be replaced."""
        at = block.tasks - self.first
        if len(at) and not 0 <= at.min() <= at.max() < len(self.states):
            raise StateError(f"{source}: `replicates` reach beyond those of this study")
        if block.layout and not self.layout:
            self.layout, self.values = block.layout, room(block.layout, len(self.states))
        if block.layout and block.layout != self.layout:
            raise StateError(f"{source}: two blocks differ in the names or shapes of their numbers")
        old, new = self.states[at], block.states
        twice = (old == DONE) & (new == DONE)
        for name, rows in block.values.items():
            if rows[twice].tobytes() != self.values[name][at[twice]].tobytes():
                raise StateError(f"{source}: two blocks differ in `{name}` of the same replicates")
        fresh = (new != WAITING) & (old != DONE)
        for name, rows in block.values.items():
            self.values[name][at[fresh]] = rows[fresh]
        for task in block.tasks[fresh & (old == FAILED)].tolist():
            self.errors.pop(task, None)
        self.states[at[fresh]] = new[fresh]
        for task, text in zip(block.tasks[new == FAILED].tolist(), block.errors, strict=True):
            if self.states[task - self.first] == FAILED:
                self.errors[task] = sys.intern(text)  # one that occurs often is kept once
        if block.platform and block.platform not in self.platforms:
            self.platforms.append(block.platform)

    def forget_failures(self) -> None:
        """Let failed tasks run again."""
        self.states[self.states == FAILED] = WAITING
        self.errors.clear()

    def block(self, chosen: NDArray[np.bool_]) -> Block:
        """The chosen tasks, which are of one platform."""
        tasks = np.flatnonzero(chosen) + self.first
        states = self.states[chosen]
        values = {name: rows[chosen] for name, rows in self.values.items()}
        errors = tuple(self.errors[task] for task in tasks[states == FAILED].tolist())
        return Block(tasks, states, values, errors, self.platforms[0] if self.platforms else {})

    def count(self, state: int) -> int:
        """How many tasks are in this state."""
        return int(np.count_nonzero(self.states == state))


_HEAD = 24  # bytes of what stands before the records
_BEGIN = b"\x89STUDY\r\n"


class StudyFile:
    """A file that is locked by this process, to which blocks are appended."""

    def __init__(self, path: str) -> None:
        self.path = path
        self._lock = files.lock(path)
        self._file: Any = None
        self._records, self._end = 1, 0

    def create(self, study: Manifest) -> None:
        """Begin a new file, which appears with its first block in it."""
        record = framed(Block.of(study), 1)
        with usable(self.path):
            for left in glob.glob(f"{glob.escape(self.path)}.{'[0-9a-f]' * 16}.tmp"):
                os.remove(left)  # its writer was killed: this process has the lock
            with files.replaced(self.path) as part, open(part, "wb") as file:
                file.write(head(_HEAD + len(record)) + record)
        self.extend(1, _HEAD + len(record))

    def extend(self, records: int, end: int) -> None:
        """Go on behind the last record that can be read."""
        self._records = records
        with usable(self.path):
            self._file = open(self.path, "r+b", buffering=0)  # noqa: SIM115
            self._file.truncate(end)
            self._commit(end)

    def append(self, block: Block) -> None:
        """Write a block; it is on the disk when this returns."""
        record = framed(block, self._records + 1)
        with usable(self.path):
            try:
                self._write(self._end, record)
                self._commit(self._end + len(record))
            except OSError:
                with suppress(OSError):  # nothing may be appended to a part of a record
                    self._file.truncate(self._end)
                raise
        self._records += 1

    def _commit(self, end: int) -> None:
        """Say that all up to here is on the disk, once it is."""
        os.fsync(self._file.fileno())
        self._write(0, head(end))
        self._end = end

    def _write(self, at: int, content: bytes) -> None:
        self._file.seek(at)
        while content:
            content = content[self._file.write(content) :]

    def close(self) -> None:
        """Give the file free."""
        if self._file is not None:
            self._file.close()
        self._lock.release()


def head(end: int) -> bytes:
    """The beginning of a file that is on the disk up to this length."""
    length = end.to_bytes(8, "little")
    return _BEGIN + length + bytes(255 - byte for byte in length)


def framed(block: Block, number: int) -> bytes:
    """A record: a state file behind its length."""
    content = files.encode(block._kind, number, block._to_sections())
    return len(content).to_bytes(8, "little") + content


def read(path: str) -> tuple[Manifest, list[Block], int]:
    """What the study in a file is, its blocks, and where the last one ends.

    Raises `StateError` if a record that was once on the disk cannot be read.
    """
    with usable(path):
        files.regular_file(path)
        with open(path, "rb") as file:
            blocks, end = _read(path, file)
    studies = [block.study for block in blocks if block.study is not None]
    if not studies:
        raise StateError(f"{path} is not the file of a study: no block says what it is")
    return studies[-1], blocks, end


def _read(path: str, file: BinaryIO) -> tuple[list[Block], int]:
    begin = file.read(_HEAD)
    size = os.fstat(file.fileno()).st_size  # afterwards: a writer may append meanwhile
    if not begin.startswith(_BEGIN):
        raise InputError("it does not begin as one")
    end = int.from_bytes(begin[8:16], "little")
    # the length itself may be damaged: then all that can be read counts
    end = end if begin == head(end) else _HEAD + 1
    at = _HEAD
    blocks: list[Block] = []
    while at < max(size, end):
        try:
            length = int.from_bytes(file.read(8), "little")
            if not 9 <= length <= size - at - 8:
                raise StateError("the file ends within a record")
            content = file.read(9)  # of a state file: the length of its JSON, and that
            if content[8:] != b"{":
                raise StateError("there is no record")
            running.need("a block of a study", 4 * length)
            content += file.read(length - 9)
            number, sections = files.decode(path, content, Block._kind)
        except StateError as error:
            if at < end:
                raise StateError(f"{path} is damaged at byte {at}: {error}") from error
            break
        try:
            if number != len(blocks) + 1:
                raise InputError(f"it must be record {len(blocks) + 1}, got {number}")
            blocks.append(Block._from_sections(sections))
        except (KeyError, InputError, InputTypeError) as error:
            raise StateError(f"{path} has no block of a study at byte {at}: {error}") from error
        at += 8 + length
    return blocks, at


@contextmanager
def usable(path: str) -> Iterator[None]:
    """Say what is wrong with the file of a study."""
    try:
        yield
    except FileNotFoundError as error:
        raise StateNotFoundError(error.errno, "there is no such study or folder", path) from error
    except OSError as error:
        text = f"cannot use the file of a study: {error.strerror}"
        raise StateIOError(error.errno, text, path) from error
    except InputError as error:
        raise StateError(f"{path} is not the file of a study: {error}") from error


@cache
def fingerprint() -> dict[str, str]:
    """What the bits of a number may depend on, beside the study: see `stochens_rs.Study`."""
    found = np.show_config(mode="dicts")["SIMD Extensions"]
    return {
        "stochens_rs": version(),
        "python": ".".join(platform.python_version_tuple()[:2]),
        "numpy": np.__version__,
        "platform": f"{platform.system()} {platform.machine()}",
        "processor": " ".join([*found.get("baseline", []), *found.get("found", [])]),
    }
