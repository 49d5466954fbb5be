"""Arrays of numbers, and text, from MATLAB files of versions 5 to 7.2.

SciPy's reader ends the process on some damaged files, so the few kinds of elements that a problem
has are read here (MathWorks, *MAT-File Format*, chapter 1). All others are refused by name.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Collection, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .._base import memory
from ..exceptions import InputError

_TEXTS = ("states", "inputs", "units")
_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
_ENCODED = {2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_CELL, _STRUCT, _CHAR, _SPARSE = 1, 2, 4, 5
_OBJECTS = (3, 17)  # of older classes, and of classdef
_LOGS = ("y", "u", "t", "OutputData", "InputData", "SamplingInstants", "time")
_OF_LOGS = (
    "write it as a table, writetable(table(t, u, y), 'log.csv') with a column for each signal, and "
    "read it with Trajectories.from_csv"
)
_CLASSES = {
    1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 16: "function", 17: "object",
}  # fmt: skip
_NUMERIC = range(6, 16)  # double, single, and integers
_COMPLEX = 0x800
_DIMENSIONS = 32  # all have two; more than NumPy's 32 to 64 are an error there


class _Broken(Exception):
    """The bytes are not what the format says."""


class _Element(NamedTuple):
    kind: int
    data: memoryview


def read_mat(path: Path, known: Collection[str]) -> dict[str, Any]:
    """The variables by name, all of them `known`: arrays of numbers, and lists of text."""
    whole = memoryview(path.read_bytes())
    if bytes(whole[:10]) == b"MATLAB 7.3" or bytes(whole[:4]) == b"\x89HDF":
        raise InputError(_VERSION.format(path, "got 7.3 (HDF5)"))
    order = {b"IM": "<", b"MI": ">"}.get(bytes(whole[126:_HEADER]))
    if order is None:
        raise InputError(_VERSION.format(path, "got another file"))
    found: dict[str, Any] = {}
    try:
        for element in _elements(whole[_HEADER:], order):
            if element.kind == _COMPRESSED:
                element = _unpacked(path, element.data, order)
            name, value = _variable(path, element, order, known)
            if name in found:
                raise InputError(f"{path} must have the variable {name!r} once")
            found[name] = value
    except (_Broken, zlib.error, UnicodeDecodeError) as error:
        raise InputError(f"{path} is a damaged MATLAB file: {error}") from None
    return found


_VERSION = (
    "{} must be a MATLAB file of version 5 to 7.2, {}: save it again with save(name, 'A', 'B', "
    "'-v7')"
)


def _elements(data: memoryview, order: str) -> Iterator[_Element]:
    at = 0
    while at < len(data):
        element, at = _next(data, at, order)
        yield element


def _next(data: memoryview, at: int, order: str) -> tuple[_Element, int]:
    """The element that begins at a place, and where the next one begins."""
    if len(data) - at < 8:
        raise _Broken("it is cut off")
    kind, size = (int(word) for word in np.frombuffer(data[at : at + 8], f"{order}u4"))
    first, end = at + 8, at + 8 + size
    if kind >> 16:  # a small element: 2 bytes for the size, 2 for the kind, 4 for the data
        kind, size = kind & 0xFFFF, kind >> 16
        first, end = at + 4, at + 4 + size
        if size > 4:
            raise _Broken(f"a small element has {size} bytes")
    if end > len(data):
        raise _Broken("it is cut off")
    after = at + 8 if first == at + 4 else end
    if kind != _COMPRESSED:
        after += -after % 8
    return _Element(kind, data[first:end]), after


def _unpacked(path: Path, data: memoryview, order: str) -> _Element:
    """The one element in a compressed one, unpacked to the size that it states and no more."""
    unpack = zlib.decompressobj()
    head = unpack.decompress(data, 8)
    if len(head) < 8:
        raise _Broken("a compressed element is cut off")
    size = int(np.frombuffer(head, f"{order}u4")[1])
    memory.need(f"{path}, unpacked,", 2 * size)
    body = unpack.decompress(unpack.unconsumed_tail, size + 1)
    if len(body) != size or not (unpack.eof or not unpack.decompress(unpack.unconsumed_tail, 1)):
        raise _Broken("a compressed element has another size than it states")
    if not unpack.eof:
        raise _Broken("a compressed element is cut off")
    return _Element(int(np.frombuffer(head, f"{order}u4")[0]), memoryview(body))


def _variable(path: Path, element: _Element, order: str, known: Collection[str]) -> tuple[str, Any]:
    kind, dims, name, flags, rest = _array(element, order)
    if kind in _OBJECTS:
        what = _object_of(rest)
        raise InputError(f"{path} must have arrays, got {what} in {name[:40]}: {_cure(what, name)}")
    if kind == _STRUCT and name not in known:
        raise InputError(
            f"{path} must have arrays, got a struct in {name[:40]}: save its fields, with "
            f"save(file, '-struct', '{name[:40]}', '-v7')"
        )
    name = "dt" if name == "Ts" else name
    if name in ("C", "D"):
        raise InputError(
            f"{path} must have no variable {name}: a problem has states and inputs, no outputs; "
            "save it without C and D, and identify from readings with Trajectories(outputs=)"
        )
    if name in _LOGS:
        raise InputError(f"{path} must be a problem, got also {name!r}, as a log has: {_OF_LOGS}")
    if name not in known:
        raise InputError(
            f"{path} must have the variables A and B, and optionally {', '.join(sorted(known))}, "
            f"got also {name[:40]!r}"
        )
    if not (kind in (_CELL, _CHAR) if name in _TEXTS else kind in _NUMERIC):
        wanted = "a cell of text" if name in _TEXTS else "an array of numbers"
        cure = f": save full({name})" if kind == _SPARSE else ""
        got = _CLASSES.get(kind, "numbers" if kind in _NUMERIC else f"class {kind}")
        raise InputError(f"{path} must have {name} as {wanted}, got {got}{cure}")
    if kind == _CELL:
        return name, [_cell(path, name, item, order) for item in _cells(rest, order, dims)]
    part = next(rest, None)
    if part is None:
        raise _Broken(f"{name} has no values")
    if kind == _CHAR:
        return name, _rows(part, order, dims)
    if flags & _COMPLEX:
        raise InputError(f"{path} must have real numbers in {name}, got complex ones")
    values = _numbers(part, order)
    if len(values) != math.prod(dims):
        raise _Broken(f"{name} has {len(values)} values for its shape {dims[:4]}")
    if not len(values):
        raise InputError(f"{path} must have numbers in {name}, got shape {dims[:4]}")
    memory.need(f"{name} in {path}", 8 * len(values))
    if name in ("x0", "xf") and len(dims) == 2 and 1 in dims:  # MATLAB has no vectors
        dims = (len(values),)
    return name, np.asarray(values, dtype=values.dtype.newbyteorder("=")).reshape(dims, order="F")


def _object_of(parts: Iterator[_Element]) -> str:
    """The class of a MATLAB object: text between its name and its data, as in "an object ss"."""
    for part in islice(parts, 3):
        text = bytes(part.data[:64])
        if part.kind in (1, 2, 16) and text.isalnum() and text not in (b"MCOS", b"java"):
            return f"an object {text.decode('ascii')}"
    return "an object"


def _cure(what: str, name: str) -> str:
    name = name[:40]
    if what == "an object iddata":
        return f"t = {name}.SamplingInstants; u = {name}.u; y = {name}.y; {_OF_LOGS}"
    return (
        f"of an ss object save its matrices, [A, B] = ssdata({name}); dt = {name}.Ts; save(file, "
        "'A', 'B', 'dt', '-v7') (c2d first where Ts is 0); of iddata its signals, as a table"
    )


def _array(
    element: _Element, order: str
) -> tuple[int, tuple[int, ...], str, int, Iterator[_Element]]:
    """Class, shape, name and flags of an array, and the elements that follow."""
    if element.kind != _MATRIX:
        raise _Broken(f"it has an element of kind {element.kind} where an array is expected")
    parts = _elements(element.data, order)
    head = list(islice(parts, 3))
    kinds = [part.kind for part in head]
    if kinds[:2] == [6, 1] and len(head[0].data) == 8:  # an object of a classdef has no shape
        named = bytes(head[1].data).decode("ascii")
        return _OBJECTS[1], (), named, 0, iter([*head[2:], *islice(parts, 2)])
    if len(head) < 3 or kinds != [6, 5, 1] or len(head[0].data) != 8:
        raise _Broken("an array has no flags, shape and name")
    flags = int(_numbers(head[0], order)[0])
    sizes = _numbers(head[1], order)
    if len(sizes) > _DIMENSIONS:
        raise _Broken(f"an array has {len(sizes)} dimensions")
    dims = tuple(int(size) for size in sizes)
    if min(dims, default=-1) < 0:
        raise _Broken(f"an array has the shape {dims[:4]}")
    return flags & 0xFF, dims, bytes(head[2].data).decode("ascii"), flags, parts


def _numbers(part: _Element, order: str) -> Any:
    if part.kind not in _NUMBERS:
        raise _Broken(f"numbers have kind {part.kind}")
    dtype = np.dtype(f"{order}{_NUMBERS[part.kind]}")
    if len(part.data) % dtype.itemsize:
        raise _Broken("numbers are cut off")
    return np.frombuffer(part.data, dtype)


def _cells(parts: Iterator[_Element], order: str, dims: tuple[int, ...]) -> list[_Element]:
    found = list(parts)
    if len(found) != math.prod(dims):
        raise _Broken(f"a cell array has {len(found)} cells for its shape {dims[:4]}")
    return found


def _cell(path: Path, name: str, item: _Element, order: str) -> str:
    kind, dims, _, _, rest = _array(item, order)
    part = next(rest, None)
    rows = _rows(part, order, dims) if kind == _CHAR and part is not None else ["", ""]
    if len(rows) > 1:
        raise InputError(f"{path} must have text in all cells of {name}")
    return rows[0] if rows else ""


def _rows(part: _Element, order: str, dims: tuple[int, ...]) -> list[str]:
    """The rows of an array of characters, which are stored by columns and padded with blanks."""
    if part.kind not in _ENCODED:
        raise _Broken(f"text has kind {part.kind}")
    coding = _ENCODED[part.kind]
    if coding in ("utf-16", "utf-32"):
        coding += "-le" if order == "<" else "-be"
    text = bytes(part.data).decode(coding)
    if len(dims) != 2 or len(text) != math.prod(dims):
        raise _Broken(f"text of {len(text)} characters has the shape {dims[:4]}")
    if not text and dims[0] > 1:  # as many as the file says, from no bytes
        raise _Broken(f"text without characters has {dims[0]} rows")
    return [text[row :: dims[0]].rstrip() for row in range(dims[0])]
