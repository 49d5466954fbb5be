"""Trajectories and models as named arrays, as `docs/state-format.md` lists them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np

from .._base import validation
from ..exceptions import InputError
from ..rng import Key
from .assumptions import COVARIANCES, DESIGNS, NOISES, Assumptions
from .checks import NAMES, Checks
from .pieces import Pieces

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .._base.types import Floats

Sections: TypeAlias = "dict[str, NDArray[Any]]"
T = TypeVar("T")

VERSION = 1  # of the contents of both kinds
STATE_NOISES = ("none", "white", "covariance")


def from_runs(runs: Any) -> Sections:
    """Return trajectories as named arrays."""
    names = [name.encode() for name in (*runs.state_names, *runs.input_names)]
    found = {
        "format": _counts(VERSION, runs.n, runs.m, runs.steps),
        "rows": runs._rows.ravel(),
        "lengths": runs.lengths.astype(np.uint64),
        "dt": np.array([] if runs.dt is None else [runs.dt], dtype=np.float64),
        "names": _bytes(b"".join(names)),
        "name_lengths": _counts(*(len(name) for name in names)),
    }
    if runs.outputs:
        found["outputs"] = _counts(1)
    if len(runs._pieces.gaps) or runs.lost:
        found["gaps"] = runs._pieces.gaps.astype(np.uint64).ravel()
        found["lost"] = runs._pieces.lost.astype(np.uint64)
    return found


def to_runs(sections: Sections) -> tuple[Any, ...]:
    """Check the arrays of `from_runs`, and return what `Trajectories._of` takes; they are taken."""
    version, n, m, steps = _whole(sections, "format", 4)
    if version != VERSION:
        raise InputError(f"`format` must be version {VERSION}, got {version}")
    for name, value in (("n", n), ("m", m), ("steps", steps)):
        validation.size(name, value)
    rows = _shaped(sections, "rows", 2 * n + m)
    lengths = _taken(sections, "lengths", np.uint64)
    if not lengths.size or lengths.min() < 1 or lengths.max() > len(rows):
        raise InputError(f"`lengths` must be numbers of steps from 1 to {len(rows)}")
    if int(lengths.sum()) != len(rows):
        raise InputError(f"`lengths` must have the sum {len(rows)}, got {int(lengths.sum())}")
    pieces = Pieces.whole(lengths.astype(np.int64))
    if "gaps" in sections:
        gaps, lost = (_taken(sections, name, np.uint64) for name in ("gaps", "lost"))
        pieces = Pieces.checked(pieces.lengths, gaps, lost)
    dt = _taken(sections, "dt", np.float64)
    if len(dt) > 1:
        raise InputError(f"`dt` must have at most one entry, got {len(dt)}")
    names = _names(sections, n + m)
    step = float(dt[0]) if len(dt) else None
    read = "outputs" in sections and _flag("outputs", *_whole(sections, "outputs", 1))
    return rows, pieces, n, step, names[:n], names[n:], steps, read


def from_model(model: Any) -> Sections:
    """Return all fields of a model as named arrays."""
    assumed, checks = model.assumptions, model.checks
    covariance = assumed.state_noise
    word = covariance if isinstance(covariance, str) else "covariance"
    found = from_runs(model.data) | {
        "assumptions": _counts(
            DESIGNS.index(assumed.design),
            NOISES.index(assumed.noise),
            COVARIANCES.index(assumed.covariance),
            STATE_NOISES.index(word),
        ),
        "intercept": _counts(int(model.intercept)),
        "triangle": model.triangle.ravel(),
    }
    optional = {
        "scale": model.scale,
        "covariance": assumed.known,
        "state_noise": None if isinstance(covariance, str) else covariance,
        "known": model.known,
        "instruments": model.instruments,
    }
    found |= {name: array.ravel() for name, array in optional.items() if array is not None}
    if checks is not None:
        found["p_values"] = np.array([checks.p_values[name] for name in NAMES])
        found["distances"] = np.array([checks.distances[name] for name in NAMES])
        found["draws"] = _counts(checks.draws, int(checks.exact))
    if assumed.tail:
        found["tail"] = np.array([assumed.tail])
    if assumed.exact:
        found["exact"] = _counts(*assumed.exact)
    if model.pilot is not None:
        found |= {f"pilot_{name}": array.ravel() for name, array in _arrays(model.pilot).items()}
        found["pilot_source"] = _bytes(model.pilot.source.encode())
        if (older := model.pilot.older) is not None:
            arrays = {"rows": older.rows, "lengths": older.lengths, "scale": older.scale}
            arrays["numbers"] = np.array([older.eta, older.weight])
            if older.directions is not None:
                arrays["directions"] = older.directions
            found |= {f"older_{name}": array.ravel() for name, array in arrays.items()}
    if model.window is not None:
        window = model.window
        counts = window.count, window.delay, window.burn, window.found or 0, model.first
        found["window"] = _counts(*counts)
        found["pole"] = np.array([] if window.pole is None else [window.pole], dtype=np.float64)
    if model.key is not None:
        found["key"] = _bytes(bytes(model.key))
    return found


def to_model(sections: Sections) -> tuple[tuple[Any, ...], dict[str, Any]]:
    """Check the arrays of `from_model`, and return the data as of `to_runs`, and other fields."""
    data = to_runs(sections)
    n, m = data[2], len(data[5])
    words = _whole(sections, "assumptions", 4)
    (offset,) = _whole(sections, "intercept", 1)
    error = _choice(words[3], STATE_NOISES)
    triangle = _taken(sections, "triangle", np.float64)
    side = int(np.sqrt(len(triangle)))
    if side**2 != len(triangle) or not side:
        raise InputError(f"`triangle` must be square, got {len(triangle)} entries")
    zeta = side - (n + m + _flag("intercept", offset)) - n
    window, first = _window(sections, data[4], data[5], bool(offset))
    known = _square(sections, "covariance", n)
    covariance = _square(sections, "state_noise", n)
    if (covariance is not None) != (error == "covariance"):
        raise InputError("`state_noise` must be there if it is declared, and only then")
    state_noise: Any = error if covariance is None else covariance
    checks = None
    if "draws" in sections:
        tests = []
        for name in ("p_values", "distances"):
            values = _taken(sections, name, np.float64)
            if len(values) != len(NAMES):
                raise InputError(f"`{name}` must have {len(NAMES)} entries, got {len(values)}")
            tests.append(dict(zip(NAMES, values.tolist(), strict=True)))
        draws, exact = _whole(sections, "draws", 2)
        checks = Checks(tests[0], tests[1], draws, _flag("exact", exact))
    key = _taken(sections, "key", np.uint8) if "key" in sections else None
    there = "known" in sections, "instruments" in sections
    return data, {
        "triangle": triangle.reshape(side, side),
        "assumptions": Assumptions(
            _choice(words[0], DESIGNS),
            _choice(words[1], NOISES),
            _choice(words[2], COVARIANCES),
            known,
            state_noise,
            exact_states(sections, n),
            _tail(sections),
        ),
        "scale": _taken(sections, "scale", np.float64) if "scale" in sections else None,
        "intercept": bool(offset),
        "known": _shaped(sections, "known", n + m + offset) if there[0] else None,
        "instruments": _shaped(sections, "instruments", zeta) if there[1] else None,
        "checks": checks,
        "key": None if key is None else Key(key.tobytes()),
        "pilot": _pilot(sections, n, m, n + m + offset),
        "window": window,
        "first": first,
    }


def _arrays(pilot: Any) -> dict[str, Floats]:
    """The arrays that a pilot has."""
    names = "model", "gain", "dither", "start", "inputs"
    return {name: found for name in names if (found := getattr(pilot, name)) is not None}


def _pilot(sections: Sections, n: int, m: int, d: int) -> dict[str, Any] | None:
    """The fields of the pilot of a model, taken from the arrays."""
    if "pilot_source" not in sections:
        return None
    try:
        source = _taken(sections, "pilot_source", np.uint8).tobytes().decode()
    except UnicodeDecodeError:
        raise InputError("`pilot_source` must be UTF-8") from None
    widths = {"model": d, "gain": n, "dither": m, "start": n, "inputs": m}
    arrays: dict[str, Any] = {
        name: _shaped(sections, f"pilot_{name}", width)
        for name, width in widths.items()
        if f"pilot_{name}" in sections
    }
    if "start" in arrays:
        arrays["start"] = arrays["start"][0]
    if "older_rows" in sections:
        widths = {"rows": 2 * n + m, "lengths": 1, "scale": 1, "numbers": 2, "directions": d}
        older = {
            name: _shaped(sections, f"older_{name}", width)
            for name, width in widths.items()
            if f"older_{name}" in sections
        }
        if not {"rows", "lengths", "scale", "numbers"} <= older.keys():
            raise InputError("`older_rows` needs `older_lengths`, `older_scale`, `older_numbers`")
        eta, weight = older.pop("numbers")[0].tolist()
        older["lengths"], older["scale"] = older["lengths"][:, 0], older["scale"][:, 0]
        arrays["older"] = {**older, "eta": eta, "weight": weight}
    return {"source": source, **arrays}


def _window(
    sections: Sections, outputs: list[str], inputs: list[str], offset: bool
) -> tuple[dict[str, Any] | None, int]:
    """The fields of the window of a model, taken from the arrays, and its first pair."""
    if "window" not in sections:
        return None, 0
    count, delay, burn, found, first = _whole(sections, "window", 5)
    pole = _taken(sections, "pole", np.float64)
    if len(pole) > 1:
        raise InputError(f"`pole` must have at most one entry, got {len(pole)}")
    return {
        "outputs": tuple(outputs),
        "inputs": tuple(inputs),
        "count": count,
        "pole": float(pole[0]) if len(pole) else None,
        "delay": delay,
        "intercept": offset,
        "burn": burn,
        "found": found or None,
    }, first


def _tail(sections: Sections) -> float:
    if "tail" not in sections:
        return 0.0
    found = _taken(sections, "tail", np.float64)
    if len(found) != 1:
        raise InputError(f"`tail` must have one entry, got {len(found)}")
    return float(found[0])


def exact_states(sections: Sections, n: int) -> tuple[int, ...]:
    """The states that were declared as exact, taken from the arrays."""
    if "exact" not in sections:
        return ()
    found = _taken(sections, "exact", np.uint64).tolist()
    if any(state >= n for state in found):
        raise InputError(f"`exact` must have numbers of states, below {n}")
    return tuple(found)


def _counts(*values: int) -> NDArray[np.uint64]:
    return np.array(values, dtype=np.uint64)


def _bytes(value: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(value, dtype=np.uint8)


def _taken(sections: Sections, name: str, dtype: type) -> NDArray[Any]:
    """The array of this name; it is then no longer there."""
    found = sections.pop(name)
    if found.dtype != dtype:
        raise InputError(f"`{name}` must be of {np.dtype(dtype).name}, got {found.dtype}")
    return found


def _whole(sections: Sections, name: str, count: int) -> list[int]:
    found = _taken(sections, name, np.uint64)
    if len(found) != count:
        raise InputError(f"`{name}` must have {count} entries, got {len(found)}")
    return [int(value) for value in found]


def _shaped(sections: Sections, name: str, width: int) -> Floats:
    """Rows of this width; whether they are finite is checked by who takes them."""
    found = _taken(sections, name, np.float64)
    if width < 1 or not found.size or found.size % width:
        raise InputError(f"`{name}` must have rows of {width}, got {found.size} entries")
    return found.reshape(-1, width)


def _square(sections: Sections, name: str, n: int) -> Floats | None:
    if name not in sections:
        return None
    return validation.kept(name, _shaped(sections, name, n), shape=(n, n))


def _choice(word: int, choices: Sequence[T]) -> T:
    if word >= len(choices):
        raise InputError(f"`assumptions` must be below {len(choices)}, got {word}")
    return choices[word]


def _flag(name: str, value: int) -> bool:
    if value > 1:
        raise InputError(f"`{name}` must be 0 or 1, got {value}")
    return bool(value)


def _names(sections: Sections, count: int) -> list[str]:
    text = _taken(sections, "names", np.uint8).tobytes()
    lengths = _taken(sections, "name_lengths", np.uint64).tolist()
    if len(lengths) != count or sum(lengths) != len(text):
        raise InputError(f"`name_lengths` must be those of {count} names in `names`")
    ends = np.cumsum([0, *lengths]).tolist()
    try:
        return [text[a:b].decode() for a, b in itertools.pairwise(ends)]
    except UnicodeDecodeError:
        raise InputError("`names` must be UTF-8") from None
