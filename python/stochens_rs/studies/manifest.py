"""What must agree for a study to be continued: the first record of its file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .._base import validation
from .._core import version
from ..exceptions import InputError, StateError
from ..rng import Key
from .digest import digest, full_name, home_of
from .grid import Grid
from .units import units_of
from .worker import Block, Function

SCHEMA = "stochens-study/2"
MOST = 2**40  # tasks

Manifest = dict[str, Any]


def described(function: Function, grid: Grid, key: Key, replicates: range) -> Manifest:
    """The manifest of a study."""
    home = home_of(function)
    return {
        "schema": SCHEMA,
        "stochens_rs": version(),
        "key": key.hex,
        **grid.described(home),
        "replicates": [replicates.start, replicates.stop],
        "function": full_name(function),
        "function_digest": digest("function", function, home),
        "units": units_of(function),
    }


def require_same(path: str, found: Manifest, ours: Manifest) -> None:
    """Raise if a manifest is not that of this study, which may have more replicates.

    It may also have other texts for its units.
    """
    theirs, span = {**found, "units": ours["units"]}, replicates_in(path, found)
    first, stop = ours["replicates"]
    if first <= span.start and span.stop <= stop:
        theirs["replicates"] = ours["replicates"]
    if differs := different(ours, theirs):
        raise StateError(
            f"`{differs}` of {path} is {shown(theirs.get(differs))}, of this study "
            f"{shown(ours.get(differs))}: continue it with the same, or choose another path"
        )


def required_parts(paths: list[str], manifests: list[Manifest]) -> Manifest:
    """The manifest of the whole; raises if those of the parts differ in more than replicates."""
    first = {**manifests[0], "replicates": None}
    for path, found in zip(paths, manifests, strict=True):
        if differs := different(first, {**found, "replicates": None}):
            raise StateError(f"`{differs}` of {path} differs from that of {paths[0]}")
    spans = [replicates_in(*pair) for pair in zip(paths, manifests, strict=True)]
    whole = [min(span.start for span in spans), max(span.stop for span in spans)]
    return {**manifests[0], "replicates": whole}


def reached(path: str, manifest: Manifest, blocks: list[Block], size: int) -> range:
    """The replicates of a manifest, and of blocks that were added when there were more."""
    span = replicates_in(path, manifest)
    first = min([span.start, *(block.start // size for block in blocks)])
    return range(first, max([span.stop, *(-(-block.stop // size) for block in blocks)]))


def replicates_in(path: str, manifest: Manifest) -> range:
    """The replicates that a manifest names."""
    if manifest.get("schema") != SCHEMA:
        found = shown(manifest.get("schema"))
        raise StateError(f"`schema` of {path} must be '{SCHEMA}', got {found}")
    given: Any = manifest.get("replicates")
    whole = isinstance(given, list) and len(given) == 2 and all(type(k) is int for k in given)
    if not whole or not 0 <= given[0] < given[1] <= MOST:
        raise StateError(f"`replicates` of {path} must be two numbers, got {shown(given)}")
    return range(*given)


def checked_replicates(given: object, size: int) -> range:
    """The replicates that a user asked for, of `size` configurations."""
    most = MOST // size
    if isinstance(given, range):
        if given.step != 1 or given.start < 0 or not given:
            raise InputError(f"`replicates` must be a range(first, stop) from 0 on, got {given}")
        validation.size("replicates", given.stop, maximum=most)
        return given
    return range(validation.size("replicates", given, maximum=most))


def different(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> str | None:
    """The first name under which two mappings differ, or None."""
    names = dict.fromkeys([*ours, *theirs])
    return next((name for name in names if ours.get(name) != theirs.get(name)), None)


def shown(value: object) -> str:
    """A value of a manifest, shortened for a message."""
    text = " ".join(str(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
