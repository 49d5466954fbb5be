"""Identity and saved state of a stream: keys, digest, named arrays."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np

from .. import _core
from .._base.types import Floats
from ..exceptions import InputError
from ..rng import Key

if TYPE_CHECKING:
    from numpy.typing import NDArray

Slots: TypeAlias = Literal["random", "round-robin", "gain"]

SLOTS: tuple[Slots, ...] = get_args(Slots)
ENTITIES = ("x0", "xf", "A")


@dataclass(frozen=True)
class Identity:
    """Key, options and shape of a stream."""

    key: Key
    safeguard: bool
    slots: Slots
    n: int
    m: int

    def keys(self) -> list[bytes]:
        """Return the keys of the realizations of x0, xf and A, and of the choice of slots."""
        return [bytes(self.key.child(name)) for name in (*ENTITIES, "slots")]

    def digest(self, *arrays: Floats) -> str:
        """Return the SHA-256 of the key, the options, and the shapes and entries of the arrays."""
        options = (self.safeguard, str(self.slots))
        text = f"{options}{[array.shape for array in arrays]}"
        made = hashlib.sha256(b"stochens stream v3\0" + bytes(self.key) + text.encode() + b"\0")
        for array in arrays:
            made.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return made.hexdigest()


def to_sections(identity: Identity, digest: str, core: _core.Stream) -> dict[str, Any]:
    """Return the state as named arrays."""
    own = {"key": _bytes(bytes(identity.key)), "digest": _bytes(bytes.fromhex(digest))}
    return own | dict(core.to_sections())


def from_sections(sections: dict[str, Any]) -> tuple[Identity, str, _core.Stream]:
    """Check the arrays of `to_sections`, and return its arguments."""
    state = dict(sections)
    own = {name: np.asarray(state.pop(name, ())) for name in ("key", "digest")}
    for name, array in own.items():
        if array.dtype != np.uint8 or array.shape != (32,):
            raise InputError(f"`state` must have 32 bytes in '{name}'")
    core = _core.Stream.from_sections(list(state.items()))
    n, m, safeguard, order = (int(v) for v in state["format"][1:])
    key = Key(own["key"].tobytes())
    identity = Identity(key, bool(safeguard), SLOTS[order], n, m)
    if state["keys"].tobytes() != b"".join(identity.keys()):
        raise InputError("`state` must have the keys that follow from its key")
    arrays = (state["B"].reshape(n, m), state["x0"], state["xf"], state["A"].reshape(n, n))
    digest = identity.digest(*arrays)
    if own["digest"].tobytes().hex() != digest:
        raise InputError("`state` must have the digest of its problem")
    return identity, digest, core


def _bytes(value: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(value, dtype=np.uint8).copy()
