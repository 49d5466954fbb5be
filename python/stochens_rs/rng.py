r"""Keys of random streams: every `rng` argument is converted to one 256-bit key.

The Rust core draws from the key or a named child of it; draw i of line j is a function of
(key, j, i). A result is therefore the same with any number of threads, and can be repeated with its
key. The derivation of keys is fixed as stream version 1::

    root  = sha256(b"stochens key v1\0" + tag + b"\0" + payload)
    child = sha256(b"stochens child v1\0" + key + utf8(name))
"""

from __future__ import annotations

import hashlib
import operator
import os
from collections.abc import Iterable
from typing import Any, TypeAlias

import numpy as np

from ._base.records import Record
from ._base.validation import show, text
from .exceptions import InputTypeError, SeedError

__all__ = ["Key", "RngLike", "as_key"]

# Larger integers are refused: their decimal digits are hashed, and Python limits the conversion to
# 4300 digits.
_SEED_LIMIT = 2**4096


class Key(Record, eq=True):
    """The 256-bit key of a random stream; immutable and hashable.

    Parameters
    ----------
    bytes32 : bytes
        Exactly 32 bytes.

    Raises
    ------
    InputTypeError
        If `bytes32` is not ``bytes``.
    SeedError
        If it does not have 32 bytes.

    Examples
    --------
    >>> key = as_key(42)
    >>> key == as_key(42), key == as_key(43)
    (True, False)
    >>> Key.from_hex(key.hex) == key
    True
    """

    bytes32: bytes

    def __post_init__(self) -> None:
        if not isinstance(self.bytes32, bytes):
            raise InputTypeError(f"`bytes32` must be bytes, got {show(self.bytes32)}")
        if len(self.bytes32) != 32:
            raise SeedError(f"`bytes32` must have 32 bytes, got {len(self.bytes32)}")

    @property
    def hex(self) -> str:
        """The key as 64 hexadecimal digits."""
        return self.bytes32.hex()

    @classmethod
    def from_hex(cls, digits: str) -> Key:
        """Return the key with these hexadecimal digits.

        Parameters
        ----------
        digits : str
            64 hexadecimal digits, upper or lower case.

        Returns
        -------
        Key
            The key.

        Raises
        ------
        InputTypeError
            If `digits` is not a string.
        SeedError
            If it is not 64 hexadecimal digits.

        Examples
        --------
        >>> Key.from_hex("00" * 32)
        Key('0000000000000000...')
        """
        if not isinstance(digits, str):
            raise InputTypeError(f"`digits` must be a string, got {show(digits)}")
        if len(digits) != 64 or not set(digits) <= set("0123456789abcdefABCDEF"):
            raise SeedError(f"`digits` must be 64 hexadecimal digits, got {show(digits)}")
        return cls(bytes.fromhex(digits))

    def child(self, name: str) -> Key:
        r"""Return the key of the independent stream called `name`.

        Parameters
        ----------
        name : str
            Any text; different names give different keys.

        Returns
        -------
        Key
            ``sha256(b"stochens child v1\0" + key + utf8(name))``.

        Raises
        ------
        InputError, InputTypeError
            If `name` is not a string, or cannot be encoded as UTF-8.

        Examples
        --------
        >>> as_key(42).child("A") == as_key(42).child("x0")
        False
        """
        utf8 = text("name", name).encode()
        return Key(_sha256(b"stochens child v1\0", self.bytes32, utf8))

    def generator(self) -> np.random.Generator:
        """Return a NumPy generator with this key, for example for normal variates.

        Returns
        -------
        numpy.random.Generator
            Philox with the first 16 bytes of the key, little endian. Other versions of NumPy may
            draw other numbers.

        Examples
        --------
        >>> as_key(42).generator().normal() == as_key(42).generator().normal()
        True
        """
        seed = int.from_bytes(self.bytes32[:16], "little")
        return np.random.Generator(np.random.Philox(key=seed))

    def __bytes__(self) -> bytes:
        """Return the 32 bytes."""
        return self.bytes32

    def __repr__(self) -> str:
        """Return the first 16 hexadecimal digits."""
        return f"Key('{self.hex[:16]}...')"


RngLike: TypeAlias = (
    int
    | np.integer[Any]
    | np.random.SeedSequence
    | np.random.Generator
    | np.random.BitGenerator
    | Key
    | None
)


def as_key(rng: RngLike) -> Key:
    """Convert an `rng` argument to a key.

    Parameters
    ----------
    rng : None, int, SeedSequence, Generator, BitGenerator or Key
        None: 32 bytes from the operating system. An integer, 0 <= rng < 2**4096, or a
        ``SeedSequence`` (which is not modified): the same key every time. A ``Generator`` or
        ``BitGenerator``: its next 32 bytes, so that two calls give two keys. A `Key` is returned
        as it is.

    Returns
    -------
    Key
        The key. 0, ``SeedSequence(0)`` and ``SeedSequence([0])`` give three different keys.

    Raises
    ------
    InputTypeError
        If `rng` has another type, such as bool, float, str, bytes, list or ``RandomState``.
    SeedError
        If an integer is negative or too large.

    Examples
    --------
    >>> import numpy as np
    >>> as_key(7) == as_key(np.int64(7))
    True
    >>> generator = np.random.default_rng(7)
    >>> as_key(generator) == as_key(generator)
    False
    """
    if isinstance(rng, Key):
        return rng
    if rng is None:
        return _root(b"bytes", os.urandom(32))
    if isinstance(rng, (int, np.integer)) and not isinstance(rng, (bool, np.timedelta64)):
        seed = int(rng)
        if not 0 <= seed < _SEED_LIMIT:
            raise SeedError(f"`rng` must be an integer in [0, 2**4096), got {show(seed)}")
        return _root(b"int", str(seed).encode())
    if isinstance(rng, np.random.SeedSequence):
        entropy = _plain(rng.entropy)
        spawn_key = _plain(list(rng.spawn_key))
        return _root(b"seedseq", f"{entropy}|{spawn_key}|{int(rng.pool_size)}".encode())
    if isinstance(rng, np.random.BitGenerator):
        rng = np.random.Generator(rng)
    if isinstance(rng, np.random.Generator):
        return _root(b"bytes", rng.bytes(32))
    wanted = "None, an integer >= 0, a Key, or a SeedSequence, Generator or BitGenerator"
    raise InputTypeError(f"`rng` must be {wanted}, got {show(rng)}")


def _root(tag: bytes, payload: bytes) -> Key:
    # The zero byte separates tag and payload: different inputs give different hashed texts.
    return Key(_sha256(b"stochens key v1\0", tag, b"\0", payload))


def _sha256(*parts: bytes) -> bytes:
    return hashlib.sha256(b"".join(parts)).digest()


def _plain(entropy: object) -> str:
    """Return the numbers of a SeedSequence as text: ``5`` or ``[1,2,3]``."""
    if isinstance(entropy, str):  # NumPy also takes "17" and "0x11" inside a list
        return str(int(entropy, 16 if entropy.startswith("0x") else 10))
    if isinstance(entropy, Iterable):
        return "[" + ",".join(_plain(item) for item in entropy) + "]"
    return str(operator.index(entropy))  # type: ignore[arg-type]
