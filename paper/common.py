"""What files of this program share: types, rounding, checks of arguments, plain data, files."""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import secrets
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

import stochens_rs
from stochens_rs.exceptions import InputError

Floats: TypeAlias = NDArray[np.float64]
Fusion: TypeAlias = Literal["product", "diagonal"]
Method: TypeAlias = Literal["uniform", "slse", "slse-safeguarded", "alse"]
PathLike: TypeAlias = "str | os.PathLike[str]"
Progress: TypeAlias = bool | Callable[[int, int | None], object] | None
RngLike: TypeAlias = Any  # what `stochens_rs.sample` takes as `rng`
FUSIONS: tuple[Fusion, ...] = ("product", "diagonal")
# how a solve for weights may end, as numbers of a study
STATUSES = ("completed", "optimal", "converged", "optimal_inaccurate", "user_limit")
# Relative differences up to 4 500 eps are rounding: sums of n terms in pairs lose log2(n) eps
# (Higham, Accuracy and Stability of Numerical Algorithms (2002), 4.2), sampling errors are larger.
ROUNDING = 1e-12
TINY = 1e-300  # in place of 0 below a fraction or in a logarithm; its inverse is finite
REACHABLE = math.sqrt(np.finfo(np.float64).eps)  # relative residuals up to here count as 0


def size(name: str, value: Any, minimum: int = 1, maximum: int = 2**53) -> int:
    """A checked count."""
    if isinstance(value, bool) or value != int(value) or not minimum <= value <= maximum:
        raise InputError(f"`{name}` must be a whole number in [{minimum}, {maximum}], got {value}")
    return int(value)


def positive(name: str, value: Any, maximum: float = math.inf) -> float:
    """A checked number > 0."""
    if not (math.isfinite(value) and 0.0 < value <= maximum):
        raise InputError(f"`{name}` must be > 0 and at most {maximum:g}, got {value}")
    return float(value)


def choice(name: str, value: Any, allowed: Sequence[str]) -> str:
    """A checked word."""
    if value not in allowed:
        raise InputError(f"`{name}` must be one of {', '.join(allowed)}, got {value!r}")
    return str(value)


def vector(name: str, value: ArrayLike, length: int | None = None) -> Floats:
    """A checked vector of finite numbers."""
    found = np.asarray(value, dtype=np.float64)
    if found.ndim != 1 or len(found) != (length or len(found)) or not np.isfinite(found).all():
        raise InputError(f"`{name}` must be {length or 'some'} finite numbers, got {value!r}")
    return found


@contextmanager
def progress_bar(progress: Progress, total: int, what: str) -> Iterator[Callable[[int], object]]:
    """Give a function of what is done: of the caller, of a bar on a terminal, or a silent one."""
    if callable(progress):
        call = progress
        yield lambda done: call(done, total)
    elif progress and sys.stderr is not None and sys.stderr.isatty():
        from tqdm import tqdm

        with tqdm(total=total, desc=what, leave=False) as bar:
            yield lambda done: bar.update(done - bar.n)
    else:
        yield lambda _: None


def plain(value: Any) -> Any:
    """Plain data for JSON: arrays as lists, nan as None, records as dicts of their fields."""
    if is_dataclass(value) and not isinstance(value, type):
        return {
            "type": type(value).__name__,
            **{one.name: plain(getattr(value, one.name)) for one in fields(value)},
        }
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def versions() -> dict[str, str]:
    """Versions of the package, Python, NumPy and the platform."""
    return {
        "stochens_rs": stochens_rs.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": f"{platform.system()} {platform.machine()}",
    }


def write_text(path: Path, text: str) -> None:
    """Write a file so that a reader sees either the old or the whole new one."""
    part = path.with_name(f"{path.name}.{secrets.token_hex(8)}.tmp")
    with part.open(
        "x", encoding="utf-8"
    ) as file:  # a new file: no link that stands there is followed
        file.write(text)
    part.replace(path)


def write_listed(
    directory: Path, index: str, facts: dict[str, Any], made: list[Path]
) -> list[Path]:
    """Write an index with the SHA-256 of each file made elsewhere, then move these beside it."""
    digests = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in made}
    listed = {**facts, "files": {index: None, **digests}}
    write_text(directory / index, json.dumps(listed, allow_nan=False) + "\n")
    return [directory / index, *(path.replace(directory / path.name) for path in made)]
