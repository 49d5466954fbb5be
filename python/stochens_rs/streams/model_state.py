"""Saved state of a `ModelStream`: named arrays, and their checks."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base import validation
from .._base.signal_names import checked_names
from ..exceptions import InputError
from ..identification.assumptions import (
    COVARIANCES,
    DESIGNS,
    NOISES,
    Assumptions,
    checked_assumptions,
    checked_scale,
)
from ..identification.files import exact_states
from .snapshot import Snapshot

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats

VERSION = 2  # of the arrays
# The event of a stream refers to these: a stream must not go on with others.
MIXTURES = _core.mixtures()


def refuse(assumed: Assumptions) -> None:
    """Refuse assumptions whose regions do not hold while data arrive."""
    if assumed.noise == "symmetric":
        raise InputError("`noise` must not be 'symmetric': its regions are for one set of pairs")
    if assumed.design == "independent" and assumed.noise != "gaussian":
        raise InputError(
            f"`design` must be 'adaptive' for noise='{assumed.noise}': the region is the same, "
            "and may be looked at any time"
        )


def to_sections(model: Snapshot, end: Floats) -> dict[str, Any]:
    """Return the state as named arrays; `end` is the last x_next."""
    assumed = model.assumptions
    numbers = (
        VERSION,
        model.n,
        model.m,
        model.intercept,
        DESIGNS.index(assumed.design),
        NOISES.index(assumed.noise),
        COVARIANCES.index(assumed.covariance),
        model.first,
        model.size,
    )
    names = json.dumps([model.state_names, model.input_names]).encode()
    known = np.zeros((model.n, model.n)) if assumed.known is None else assumed.known
    return {
        "format": np.array(numbers, dtype=np.uint64),
        "triangle": model.triangle.ravel(),
        "known": known.ravel(),
        "scale": model.scale,
        "delta": np.array([model.delta]),
        "dt": np.array([model.dt or 0.0]),
        "mixtures": MIXTURES,
        "names": np.frombuffer(names, dtype=np.uint8),
        "exact": np.array(assumed.exact, dtype=np.uint64),
        "runs": np.array([model.runs], dtype=np.uint64),
        "end": end,
    }


def from_sections(sections: dict[str, Any]) -> tuple[Snapshot, Floats]:
    """Check the arrays of `to_sections`, which may be from anywhere, and return its arguments."""
    numbers = [int(v) for v in _part(sections, "format", np.uint64, 9)]
    version, n, m, offset, design, noise, covariance, first, size = numbers
    if version != VERSION:
        raise InputError(f"`state` must have version {VERSION} of its arrays, got {version}")
    scale = _part(sections, "scale", np.float64)
    d = len(scale)
    if offset > 1 or n < 1 or m < 1 or n + m + offset != d:
        raise InputError("`state` must have sizes that fit together")
    known = _part(sections, "known", np.float64, n * n).reshape(n, n)
    triangle = _part(sections, "triangle", np.float64, (d + n) ** 2).reshape(d + n, d + n)
    _check_triangle(triangle, size, d if offset else 0)
    if not np.array_equal(checked_scale(scale[: n + m], n + m, bool(offset)), scale):
        raise InputError("`state` must have the scale 1 for an offset")
    if not np.array_equal(_part(sections, "mixtures", np.float64), MIXTURES):
        raise InputError("`state` must have the mixtures of this version: its event is another")
    delta, dt = (float(_part(sections, name, np.float64, 1)[0]) for name in ("delta", "dt"))
    names = _names(_part(sections, "names", np.uint8).tobytes())
    states, inputs = checked_names(n, m, *names)
    runs = int(_part(sections, "runs", np.uint64, 1)[0])
    end = _part(sections, "end", np.float64, n)
    if not (min(size, 1) <= runs <= size and np.isfinite(end).all()):
        raise InputError(
            "`state` must have 1 run to as many as pairs, with a finite end"
        )
    model = Snapshot(
        triangle=validation.frozen(triangle),
        size=size,
        n=n,
        m=m,
        assumptions=replace(
            _assumptions(n, design, noise, covariance, known), exact=exact_states(sections, n)
        ),
        scale=validation.frozen(scale),
        intercept=bool(offset),
        delta=delta,
        first=first,
        dt=None if dt == 0.0 else dt,
        state_names=states,
        input_names=inputs,
        runs=runs,
    )
    return model, end


def _part(
    sections: dict[str, Any], name: str, kind: type[np.generic], size: int | None = None
) -> NDArray[Any]:
    array: Any = sections.get(name)
    flat = isinstance(array, np.ndarray) and array.dtype == kind and array.ndim == 1
    if flat and size in (None, len(array)):
        return np.asarray(array)
    count = "" if size is None else f"{size} "
    raise InputError(f"`state` must have {count}entries of type {kind.__name__} in '{name}'")


def _check_triangle(R: Floats, size: int, offset: int) -> None:
    """Check a triangle of `size` pairs; `offset`: how many columns there are up to that of 1."""
    if not np.isfinite(R).all() or np.tril(R, -1).any() or (np.diag(R) < 0.0).any():
        raise InputError("`state` must have a triangle of finite numbers with a diagonal >= 0")
    ones = float(np.sum(R[:, offset - 1] ** 2)) if offset else float(size)
    if (size == 0 and R.any()) or abs(ones - size) > 1e-6 * size:
        raise InputError("`state` must have a triangle of as many pairs as it says")


def _names(text: bytes) -> list[Any]:
    try:
        names = json.loads(text)
    except (ValueError, RecursionError):
        names = None
    if not isinstance(names, list) or len(names) != 2:
        raise InputError("`state` must have the names of states and inputs")
    return names


def _assumptions(n: int, design: int, noise: int, covariance: int, known: Floats) -> Assumptions:
    if design >= len(DESIGNS) or noise >= len(NOISES) or covariance >= len(COVARIANCES):
        raise InputError("`state` must have options that exist")
    plan, law, word = DESIGNS[design], NOISES[noise], COVARIANCES[covariance]
    if word == "known":  # of any law: the constructor takes sigma for some, whose square this is
        matrix = checked_assumptions(n, plan, "gaussian", known, None, "none").known
        assumed = Assumptions(plan, law, word, matrix)
    else:
        assumed = checked_assumptions(n, plan, law, word, None, "none")
    refuse(assumed)
    return assumed
