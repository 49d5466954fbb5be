import os
from typing import Literal, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Alse",
    "DataStream",
    "Draws",
    "StateLock",
    "Stream",
    "alse",
    "alse_path",
    "alse_prefixes",
    "bootstrap",
    "chi2_quantile",
    "chi2_upper",
    "closed_form",
    "diagonal_quantile",
    "f_upper",
    "joint_radii",
    "least_squares_level",
    "log_multigamma",
    "mean_difference",
    "noncentrality_limit",
    "one_noise",
    "pseudoinverse",
    "realization_controls",
    "region_draws",
    "residual_p_values",
    "residuals",
    "robust_control",
    "row_quantile",
    "roy_quantile",
    "sample_counts",
    "scalar_quantile",
    "several_steps",
    "sign_radii",
    "sign_statistics",
    "simulate_estimates",
    "simulate_mean_field",
    "simulate_plans",
    "simulate_runs",
    "simulate_systems",
    "slse",
    "smallest_quantile",
    "sphere_level",
    "storage_decode",
    "storage_encode",
    "storage_load",
    "storage_save",
    "trace_quantile",
    "track",
    "trajectory",
    "triangle",
    "triangle_update",
    "uniform_path",
    "version",
    "wishart_quantile",
]

_Floats: TypeAlias = NDArray[np.float64]
_Status: TypeAlias = Literal["optimal", "optimal_inaccurate", "user_limit", "interrupted"]
# lines and, for an average that is drawn anew in every run, (size, scheme)
_Estimate: TypeAlias = tuple[_Floats, tuple[int, str] | None]
# subsimplex, tol, time_limit in seconds, max_passes, threads
_Limits: TypeAlias = tuple[bool, float, float | None, int | None, int]
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

_Plain: TypeAlias = NDArray[np.uint8] | NDArray[np.uint64] | _Floats
_Sections: TypeAlias = list[tuple[str, _Plain]]

@final
class Stream:
    def __new__(
        cls,
        b: _Floats,
        x0: _Floats,
        xf: _Floats,
        a: _Floats,
        keys: list[bytes],
        variant: str,
        safeguard: bool,
        slots: str,
    ) -> Stream: ...
    def advance(
        self, steps: int, rule: str | None, tol: float, seconds: float | None
    ) -> Literal["converged", "max_steps", "time_limit"]: ...
    def control(self) -> _Floats: ...
    def estimates(self) -> tuple[_Floats, _Floats, _Floats]: ...
    def counts(self) -> tuple[int, list[int]]: ...
    def residuals(self) -> list[float]: ...
    def certificate(self) -> tuple[float, float]: ...
    def drift(self) -> float: ...
    def trace(self) -> tuple[NDArray[np.uint64], _Floats]: ...
    def to_sections(self) -> _Sections: ...
    @staticmethod
    def from_sections(sections: _Sections) -> Stream: ...

@final
class DataStream:
    def __new__(
        cls, b: _Floats, x0: _Floats | None, xf: _Floats | None, a: _Floats | None
    ) -> DataStream: ...
    def update(self, entity: int, samples: _Floats) -> None: ...
    def control(self) -> _Floats: ...
    def estimates(self) -> tuple[_Floats, _Floats, _Floats]: ...
    def statistics(self) -> tuple[list[int], list[float], list[float], list[float]]: ...
    def evidence(self) -> tuple[list[float], list[float]]: ...
    def certificate(self) -> tuple[float, float] | None: ...
    def to_sections(self) -> _Sections: ...
    @staticmethod
    def from_sections(sections: _Sections) -> DataStream: ...

def sample_counts(values: _Floats, size: int, scheme: str, key: bytes) -> NDArray[np.int64]: ...
def closed_form(
    draws: Draws, target: _Floats, subsimplex: bool
) -> tuple[_Floats, _Floats, float, float, float, int]: ...

@final
class Alse:
    @property
    def weights(self) -> _Floats: ...
    @property
    def estimate(self) -> _Floats: ...
    @property
    def error(self) -> float: ...
    @property
    def gap(self) -> float: ...
    @property
    def lower_bound(self) -> float: ...
    @property
    def unseen(self) -> int: ...
    @property
    def exact(self) -> bool: ...
    @property
    def status(self) -> _Status: ...
    @property
    def solver(self) -> str: ...
    @property
    def iterations(self) -> int: ...

def alse(realizations: Draws | _Floats, target: _Floats, limits: _Limits) -> Alse: ...
def slse(
    realizations: Draws | _Floats,
    target: _Floats,
    method: str,
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
    limits: _Limits,
    sizes: list[int],
    keep_estimates: bool,
) -> tuple[_Floats, _Floats, list[_Status], _Floats]: ...
def pseudoinverse(b: _Floats) -> tuple[_Floats, _Floats, _Floats, float, _Floats]: ...
def realization_controls(
    out: _Floats,
    fresh: bool,
    pinv: _Floats,
    x0: Draws | _Floats,
    xf: Draws | _Floats,
    a: Draws | _Floats,
    rows: bool,
    threads: int,
) -> None: ...
def mean_difference(
    n: int, x0: Draws | _Floats, xf: Draws | _Floats, a: Draws | _Floats, rows: bool
) -> _Floats: ...
def trajectory(a: _Floats, b: _Floats, x0: _Floats, u: _Floats) -> _Floats: ...
def simulate_runs(
    a: _Floats,
    b: _Floats,
    x0: _Floats,
    u: _Floats,
    drawn: tuple[bool, bool, bool],
    size: int,
    full: bool,
    keep: bool,
    key: bytes,
    threads: int,
) -> tuple[_Floats, _Floats | None, _Floats | None, _Floats]: ...
def simulate_mean_field(
    a: _Floats,
    b: _Floats,
    x0: _Floats,
    u: _Floats,
    drawn: tuple[bool, bool, bool],
    size: int,
    replicates: int,
    full: bool,
    keep: bool,
    key: bytes,
    threads: int,
) -> tuple[_Floats, _Floats | None, _Floats | None, _Floats]: ...
def simulate_systems(
    a: _Floats,
    b: _Floats,
    c: _Floats | None,
    x0: _Floats,
    u: _Floats,
    full: bool,
    keep: bool,
    threads: int,
) -> tuple[_Floats, _Floats | None, _Floats | None, _Floats]: ...
def track(
    a: _Floats,
    b: _Floats,
    x0: _Floats,
    reference: _Floats,
    factors: tuple[_Floats, _Floats, _Floats],
    size: int,
    method: str,
    feedback: bool,
    sample_states: bool,
    runs: int,
    key: bytes,
    threads: int,
) -> tuple[_Floats, _Floats, bool]: ...
def simulate_plans(
    x0: _Estimate,
    xf: _Estimate,
    a: _Estimate,
    rows: bool,
    paired: bool,
    exact: tuple[_Floats, _Floats, _Floats],
    several: bool,
    runs: int,
    cost: float,
    key: bytes,
    threads: int,
) -> _Floats: ...
def simulate_estimates(
    values: _Floats,
    size: int,
    scheme: str,
    norm: str,
    runs: int,
    cost: float,
    key: bytes,
    threads: int,
) -> _Floats: ...

@final
class StateLock:
    def __new__(cls, path: str | os.PathLike[str]) -> StateLock: ...
    def release(self) -> None: ...

def storage_save(
    path: str | os.PathLike[str],
    kind: str,
    sections: list[tuple[str, _Section]],
    held: StateLock | None = None,
) -> int: ...
def storage_load(
    path: str | os.PathLike[str], kind: str
) -> tuple[int, dict[str, _Section], str | None]: ...
def storage_encode(kind: str, generation: int, sections: list[tuple[str, _Section]]) -> bytes: ...
def storage_decode(
    source: str | os.PathLike[str], bytes: bytes, kind: str
) -> tuple[int, dict[str, _Section]]: ...
def version() -> str: ...

# identification from measured pairs: `q` = whitened regressors (N, rank), `e` = residuals (N, n)

def triangle(rows: _Floats, threads: int) -> _Floats: ...
def triangle_update(r: _Floats, rows: _Floats) -> None: ...
def roy_quantile(n: int, d: int, nu: int, delta: float, threads: int) -> float: ...
def wishart_quantile(n: int, d: int, delta: float, threads: int) -> float: ...
def smallest_quantile(n: int, size: int, delta: float, threads: int) -> float: ...
def scalar_quantile(n: int, d: int, nu: int, delta: float, threads: int) -> float: ...
def row_quantile(n: int, d: int, nu: int, delta: float) -> float: ...
def diagonal_quantile(n: int, d: int, nu: int, delta: float, threads: int) -> float: ...
def trace_quantile(n: int, d: int, nu: int, delta: float, threads: int) -> float: ...
def joint_radii(n: int, d: int, nu: int, delta: float, threads: int) -> tuple[float, float]: ...
def chi2_quantile(probability: float, degrees: float) -> float: ...
def chi2_upper(delta: float, degrees: float) -> float: ...
def f_upper(delta: float, a: float, b: float) -> float: ...
def noncentrality_limit(x: float, degrees: float, delta: float) -> float: ...
def sphere_level(n: int, ld: float, delta: float) -> float: ...
def least_squares_level(
    n: int, ld: _Floats, wider: _Floats, delta: float, frobenius: bool
) -> float: ...
def one_noise(n: int, delta: float) -> float: ...
def log_multigamma(a: float, n: int) -> float: ...
def several_steps(
    h: _Floats,
    white: _Floats,
    root: _Floats,
    missing: _Floats,
    ratio: float,
    x0: _Floats,
    inputs: _Floats,
    offset: bool,
    radii: tuple[float, float, float, bool],  # spectral, frobenius, rho0, noise of the run
) -> tuple[_Floats, _Floats, _Floats, _Floats, _Floats]: ...
def robust_control(
    h: _Floats, white: _Floats, x0: _Floats, xf: _Floats, offset: bool, beta: float
) -> _Floats: ...
def bootstrap(
    rows: _Floats,
    h: _Floats,
    white: _Floats,
    runs: NDArray[np.uint32] | None,
    kind: str,
    size: int,
    key: bytes,
    weights: _Floats | None,
    threads: int,
) -> _Floats: ...
def region_draws(
    h: _Floats,
    white: _Floats,
    root: _Floats,
    nu: int,
    size: int,
    key: bytes,
    threads: int,
) -> _Floats: ...
def residuals(z: _Floats, y: _Floats, white: _Floats) -> tuple[_Floats, _Floats, _Floats]: ...
def residual_p_values(
    z: _Floats, y: _Floats, white: _Floats, draws: int, key: bytes, threads: int
) -> _Floats: ...
def sign_radii(
    rows: _Floats, n: int, size: int, key: bytes, signs: _Floats | None, threads: int
) -> _Floats: ...
def sign_statistics(
    rows: _Floats, n: int, size: int, key: bytes, signs: _Floats | None, threads: int
) -> _Floats: ...
