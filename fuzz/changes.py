"""Change files: a few bytes, or arrays of a state file before its digest is computed."""

from __future__ import annotations

import random
import warnings

import numpy as np

import stochens_rs as se
from stochens_rs._base import files as state_file
from stochens_rs.studies.tasks import head

WHOLE = [0, 1, 2, 127, 128, 255, 2**31 - 1, 2**31, 2**32, 2**53, 2**63 - 1, 2**63, 2**64 - 1]
REAL = [0.0, -0.0, 1.0, -1.0, 5e-324, 1e-300, 1e16, 1e154, 1e308, float("inf"), float("nan")]
TEXT = [b"{", b"}", b"[", b"]", b",", b":", b'"', b"-", b"1e999", b"NaN", b"null", b"\0", b"\xff"]
TEXT += [b"\n", b"\r", b"1" * 400, b'"A":', b"[" * 600]


def _bytes(content: bytes, draw: random.Random) -> bytes:
    """Change, remove or repeat a few bytes."""
    found = bytearray(content)
    at, size = draw.randrange(len(found) + 1), draw.choice([0, 1, 2, 8, 40])
    match draw.randrange(5):
        case 0:
            found[at : at + 1] = bytes([draw.randrange(256)])
        case 1:
            found[at : at + 8] = draw.choice(WHOLE).to_bytes(8, "little")
        case 2:
            found[at : at + size] = draw.choice(TEXT)
        case 3:
            del found[at : at + size]
        case _:
            found[at:at] = found[at - size : at]
    return bytes(found)


def _array(found: np.ndarray, draw: random.Random) -> np.ndarray:
    """Change an entry, the length or the type of an array."""
    at = draw.randrange(len(found)) if len(found) else 0
    match draw.randrange(6):
        case 0:
            return found[:at]
        case 1:
            return np.append(found, found[at:])
        case 2:
            return found.astype(draw.choice([np.uint8, np.uint64, np.float64]))
        case 3 if found.dtype == np.uint8:
            return np.frombuffer(_bytes(found.tobytes(), draw), dtype=np.uint8)
        case _ if len(found):
            found = found.copy()
            value = draw.choice(REAL if found.dtype == np.float64 else WHOLE)
            found[at] = value if found.dtype == np.float64 else value % 2 ** (8 * found.itemsize)
    return found


def _sections(kind: str, content: bytes, draw: random.Random) -> bytes:
    """Change an array of a state file, and seal it again."""
    generation, arrays = state_file.decode("", content, kind)
    name = draw.choice([*arrays, *arrays, "more"])
    if draw.randrange(12) == 0:
        arrays.pop(name, None)
    else:
        arrays[name] = _array(arrays.get(name, np.zeros(1)), draw)
    return state_file.encode(kind, generation + (draw.randrange(50) == 0), arrays)


def _study(content: bytes, draw: random.Random) -> bytes:
    """Change a record of the file of a study, behind its head of 24 bytes."""
    at, records = 24, []
    while at < len(content):
        size = int.from_bytes(content[at : at + 8], "little")
        records.append(content[at + 8 : at + 8 + size])
        at += 8 + size
    k = draw.randrange(len(records))
    records[k] = _sections("study", records[k], draw)
    body = b"".join(len(record).to_bytes(8, "little") + record for record in records)
    return head(24 + len(body)) + body


def changed(kind: str, content: bytes, draw: random.Random) -> bytes:
    """Return another file that resembles this one, a state file of this kind or (``""``) any."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _ in range(draw.choice([1, 1, 2, 4])):
            try:
                if not kind or draw.randrange(8) == 0:
                    content = _bytes(content, draw)
                elif kind == "study":
                    content = _study(content, draw)
                else:
                    content = _sections(kind, content, draw)
            except se.StochensError:  # what is no longer a state file has no arrays to change
                content = _bytes(content, draw)
    return content
