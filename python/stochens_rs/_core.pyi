import os
from typing import Literal, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Draws",
    "alse",
    "alse_path",
    "alse_prefixes",
    "closed_form",
    "mean_difference",
    "pseudoinverse",
    "realization_controls",
    "sample_counts",
    "slse",
    "storage_load",
    "storage_save",
    "uniform_path",
    "version",
]

_Floats: TypeAlias = NDArray[np.float64]
_Section: TypeAlias = NDArray[np.uint8] | NDArray[np.uint64] | NDArray[np.float64]

@final
class Draws:
    @staticmethod
    def sample(values: _Floats, size: int, scheme: str, key: bytes, threads: int) -> Draws: ...
    @staticmethod
    def from_indices(values: _Floats, indices: NDArray[np.uint32]) -> Draws: ...
    @property
    def size(self) -> int: ...
    @property
    def lines(self) -> int: ...
    @property
    def length(self) -> int: ...
    @property
    def nbytes(self) -> int: ...
    def values(self) -> _Floats: ...
    def atoms(self) -> _Floats: ...
    def gamma(self) -> _Floats: ...
    def indices(self) -> NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.uint32]: ...
    def prefix(self, size: int) -> Draws: ...
    def counts(self) -> NDArray[np.int64]: ...
    def combine(self, weights: _Floats) -> _Floats: ...

def sample_counts(values: _Floats, size: int, scheme: str, key: bytes) -> NDArray[np.int64]: ...
def closed_form(
    draws: Draws, target: _Floats, subsimplex: bool
) -> tuple[_Floats, _Floats, float, float, float]: ...
def alse(
    realizations: Draws | _Floats, target: _Floats, subsimplex: bool, tol: float, threads: int
) -> tuple[
    _Floats, _Floats, float, float, Literal["optimal", "optimal_inaccurate"], str, int, bool
]: ...
def slse(
    realizations: Draws | _Floats,
    target: _Floats,
    safeguard: bool,
    sizes: list[int],
    keep_estimates: bool,
) -> tuple[_Floats, _Floats, _Floats, _Floats]: ...
def uniform_path(
    draws: Draws, target: _Floats, sizes: list[int], keep_estimates: bool
) -> tuple[_Floats, _Floats]: ...
def alse_path(
    draws: Draws, target: _Floats, subsimplex: bool, sizes: list[int], keep_estimates: bool
) -> tuple[_Floats, _Floats, _Floats, _Floats]: ...
def alse_prefixes(
    draws: Draws,
    target: _Floats,
    subsimplex: bool,
    tol: float,
    threads: int,
    sizes: list[int],
    keep_estimates: bool,
) -> tuple[_Floats, _Floats, list[Literal["optimal", "optimal_inaccurate"]], _Floats]: ...
def pseudoinverse(b: _Floats) -> tuple[_Floats, int, _Floats, float]: ...
def realization_controls(
    pinv: _Floats,
    x0: Draws | _Floats,
    xf: Draws | _Floats,
    a: Draws | _Floats,
    rows: bool,
    threads: int,
) -> _Floats: ...
def mean_difference(
    n: int, x0: Draws | _Floats, xf: Draws | _Floats, a: Draws | _Floats, rows: bool
) -> _Floats: ...
def storage_save(
    path: str | os.PathLike[str], kind: str, sections: list[tuple[str, _Section]]
) -> int: ...
def storage_load(
    path: str | os.PathLike[str], kind: str
) -> tuple[int, dict[str, _Section], str | None]: ...
def version() -> str: ...
