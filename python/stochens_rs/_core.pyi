import os
from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, final, overload

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self, disjoint_base

__all__ = [
    "Alse",
    "Apart",
    "Best",
    "BoxControl",
    "DataStream",
    "Draws",
    "Errors",
    "Estimate",
    "Factors",
    "Feedback",
    "Fitted",
    "Gate",
    "Horizon",
    "HorizonControl",
    "Identified",
    "Keeper",
    "Loop",
    "Pieces",
    "Pilot",
    "Readings",
    "Reference",
    "Region",
    "RegionPart",
    "SetPoint",
    "SetPoints",
    "StateLock",
    "Stream",
    "Table",
    "TailBounds",
    "Watch",
    "Window",
    "alse",
    "alse_path",
    "alse_prefixes",
    "bias_gain",
    "box_batch",
    "box_control",
    "build",
    "certify",
    "closed_form",
    "covariance_root",
    "diagonal_quantile",
    "drawn_bounds",
    "drawn_misses",
    "entered_region",
    "estimate_draws",
    "exceedances",
    "f_upper",
    "feedback_gain",
    "final_covariance",
    "fit",
    "fleet_alone",
    "fleet_mean",
    "fleet_misses",
    "fleet_worst",
    "followed_inputs",
    "fuse_path",
    "fused_covariance",
    "guaranteed_gain",
    "hull_between",
    "hull_explained",
    "hull_position",
    "hull_radius",
    "hull_share",
    "identify",
    "instants",
    "joint_radii",
    "least_squares_level",
    "line_covariances",
    "log_multigamma",
    "loop_eigenvalues",
    "mean_difference",
    "mean_radius",
    "mean_square",
    "mixtures",
    "next_runs",
    "noise_deviations",
    "noise_tests",
    "normal_quantile",
    "one_noise",
    "output_tube",
    "preview",
    "realization_controls",
    "residual_checks",
    "row_quantile",
    "roy_quantile",
    "sample_counts",
    "scalar_quantile",
    "scenario_at_most",
    "scenario_compression",
    "scenario_discarding",
    "scenario_judged",
    "scenario_rank",
    "scenario_relaxed",
    "scenario_required",
    "second_moment",
    "simulate_estimates",
    "simulate_plans",
    "simulate_runs",
    "simulate_systems",
    "smallest_quantile",
    "sphere_level",
    "storage_decode",
    "storage_encode",
    "storage_load",
    "storage_save",
    "test_of_two_logs",
    "trace_quantile",
    "track",
    "trajectory",
    "trajectory_covariances",
    "triangle",
    "triangle_update",
    "unmoved",
    "validation_mean",
    "validation_rank",
    "validation_runs",
    "validation_systems",
    "validation_weighted",
    "version",
    "widest_gain",
    "wishart_quantile",
    "zero_order_hold",
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
    def control(self) -> tuple[_Floats, float]: ...
    def estimates(self) -> tuple[_Floats, _Floats, _Floats]: ...
    def statistics(self) -> tuple[list[int], list[float], list[float], list[float]]: ...
    def evidence(self) -> tuple[list[float], list[float]]: ...
    def certificate(self) -> tuple[float, float] | None: ...
    def misses(
        self, inputs: _Floats, exact: list[bool], size: int, key: bytes
    ) -> NDArray[np.float64]: ...
    def to_sections(self) -> _Sections: ...
    @staticmethod
    def from_sections(sections: _Sections) -> DataStream: ...

# for the root of the sum of squares about the mean, the range, and the size where it is tightest
def mean_radius(
    count: int, deviation: float, diameter: float, delta: float, size: int | None
) -> float: ...
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
def fuse_path(
    realizations: Draws | _Floats,
    target: _Floats,
    method: str,
    sizes: list[int],
    keep_estimates: bool,
) -> tuple[_Floats, _Floats, _Floats, _Floats]: ...
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
def preview(
    model: tuple[_Floats, _Floats, _Floats, _Floats],
    weights: tuple[_Floats, _Floats],
    gain: _Floats,
    path: tuple[_Floats, _Floats, _Floats],
    start: _Floats,
) -> tuple[_Floats, _Floats]: ...
def zero_order_hold(a: _Floats, b: _Floats, dt: float) -> tuple[_Floats, _Floats]: ...
def trajectory(a: _Floats, b: _Floats, x0: _Floats, u: _Floats) -> _Floats: ...
def simulate_runs(
    a: _Floats,
    b: _Floats,
    x0: _Floats,
    u: _Floats,
    drawn: tuple[bool, bool, bool],
    size: int,
    replicates: int | None,
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
    best: Best,
    runs: int,
    cost: float,
    key: bytes,
    threads: int,
) -> _Floats: ...
def exceedances(runs: int, delta: float) -> int | None: ...
def drawn_bounds(errors: _Floats, delta: float) -> list[float]: ...
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
class Factors:
    def __new__(cls, b: _Floats) -> Factors: ...
    @property
    def B(self) -> _Floats: ...
    @property
    def U(self) -> _Floats: ...
    @property
    def s(self) -> _Floats: ...
    @property
    def V(self) -> _Floats: ...
    @property
    def singular_values(self) -> _Floats: ...
    @property
    def rank(self) -> int: ...
    @property
    def inverse(self) -> _Floats: ...
    @property
    def off(self) -> float: ...

@disjoint_base
class Best:
    def __new__(
        cls,
        a: _Floats,
        b: _Floats,
        x0: _Floats,
        xf: _Floats,
        steps: int,
        free: _Floats | None = None,
    ) -> Self: ...
    @property
    def factors(self) -> Factors: ...
    @property
    def u(self) -> _Floats: ...
    @property
    def free(self) -> _Floats: ...
    @property
    def needed(self) -> _Floats: ...
    @property
    def missed(self) -> _Floats: ...
    @property
    def reached(self) -> _Floats: ...
    @property
    def off(self) -> float: ...
    @property
    def gap(self) -> float: ...
    @property
    def unsure(self) -> float: ...
    @property
    def upper(self) -> float: ...
    @property
    def control_rounding(self) -> float: ...
    @property
    def state_rounding(self) -> float: ...
    def amplified(self, state: float) -> float: ...
    def aside(self, u: _Floats) -> _Floats: ...
    # as the fields of `Reachability`
    def reach(self) -> tuple[Any, float, float, float, float, float, int, float]: ...
    def compared(self, quantity: str, x0: _Floats) -> tuple[str, float]: ...
    # error, what it is relative to, the norm of that, rounding: of control and state; residual
    def beside(
        self, u: _Floats, x0: _Floats
    ) -> tuple[tuple[float, str, float, float], tuple[float, str, float, float], float]: ...
    def with_rounding(
        self, state: float, control: float, largest: float
    ) -> tuple[float, float]: ...

def mean_square(lines: _Floats, size: int, systematic: bool) -> float: ...
def line_covariances(of: _Floats, size: int, systematic: bool) -> _Floats: ...
def second_moment(a: _Floats, m: _Floats, rows: bool) -> _Floats: ...
def fused_covariance(
    a: _Floats,
    ends: tuple[_Floats, _Floats],  # x0, xf
    sizes: tuple[int, int, int],
    law: tuple[bool, bool, bool],
    factors: tuple[Factors, bool] | None,
) -> _Floats: ...
def final_covariance(
    a: _Floats, states: _Floats, xf: _Floats, sizes: tuple[int, int, int], rows: bool
) -> _Floats: ...
def trajectory_covariances(
    a: _Floats, b: _Floats, states: _Floats, u: _Floats, sizes: tuple[int, int, int], rows: bool
) -> _Floats: ...

@final
class TailBounds:
    # lines (k, n), norm; or A, B, x0, xf, rows, control, paired
    @overload
    def __new__(cls, lines: _Floats, norm: str, /) -> TailBounds: ...
    @overload
    def __new__(
        cls,
        A: _Floats,
        B: _Floats,
        x0: _Floats,
        xf: _Floats,
        rows: bool,
        control: bool,
        paired: bool,
        /,
    ) -> TailBounds: ...
    @property
    def unit(self) -> float: ...
    def cap(self, rates: Sequence[float]) -> float: ...
    def radius(self, name: str, rates: Sequence[float], level: float) -> float: ...

@final
class Table:
    def __new__(cls, path: str, text: str, skip: int) -> Table: ...
    @property
    def names(self) -> list[str]: ...
    def line(self, row: int) -> int: ...
    def numbers(self, column: int, whole: bool) -> _Floats: ...
    def cells(self, column: int) -> list[str]: ...
    def cure(self, column: int, cell: str) -> str: ...

def instants(texts: list[str]) -> tuple[_Floats, int | None]: ...

@final
class Pieces:
    def __new__(
        cls,
        lengths: NDArray[np.int64],
        gaps: NDArray[np.int64] | None = None,
        lost: NDArray[np.int64] | None = None,
    ) -> Pieces: ...
    @staticmethod
    def joined(parts: list[Pieces]) -> Pieces: ...
    @property
    def lengths(self) -> NDArray[np.int64]: ...
    @property
    def gaps(self) -> NDArray[np.int64]: ...
    @property
    def lost(self) -> NDArray[np.int64]: ...
    def starts(self) -> NDArray[np.int64]: ...
    def runs(self) -> NDArray[np.int64]: ...
    def places(self) -> NDArray[np.int64]: ...
    def skipped(self) -> NDArray[np.int64]: ...
    def chosen(self, kept: NDArray[np.bool_]) -> Pieces: ...
    def __eq__(self, other: object, /) -> bool: ...

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
def build() -> tuple[bool, str]: ...

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

# `hull` and `noise` are read by their attributes, see `fusion.fused_model`
# root root' = S; the rounding of each row is relative to its own size
def covariance_root(covariance: _Floats) -> _Floats: ...
def hull_position(
    models: _Floats, t: _Floats, weights: _Floats
) -> tuple[_Floats, tuple[float, float, float, int, int, int, float]]: ...
def hull_between(b: float, a: float, away: _Floats, share: float, frobenius: bool) -> float: ...
def hull_share(hull: object, noise: object) -> float: ...
def hull_explained(hull: object, noise: object) -> bool | None: ...
def hull_radius(hull: object, noise: object, delta: float, extra: int) -> float: ...
def joint_radii(n: int, d: int, nu: int, delta: float, threads: int) -> tuple[float, float]: ...
def normal_quantile(covariance: _Floats, delta: float) -> float: ...
def f_upper(delta: float, a: float, b: float) -> float: ...
def sphere_level(n: int, ld: float, delta: float) -> float: ...
def least_squares_level(
    n: int, ld: _Floats, wider: _Floats, delta: float, frobenius: bool
) -> float: ...
def one_noise(n: int, delta: float) -> float: ...
def log_multigamma(a: float, n: int) -> float: ...

# least squares of some rows and columns of Theta: white' white = V^+, root' root = V, columns of
# missing: what the data do not determine, rounding (rows,) what it may change
@final
class Fitted:
    @property
    def rows(self) -> NDArray[np.int64]: ...
    @property
    def columns(self) -> NDArray[np.int64]: ...
    @property
    def H(self) -> _Floats: ...
    @property
    def S(self) -> _Floats: ...
    @property
    def white(self) -> _Floats: ...
    @property
    def root(self) -> _Floats: ...
    @property
    def missing(self) -> _Floats: ...
    @property
    def rounding(self) -> _Floats: ...
    @property
    def N(self) -> int: ...
    @property
    def rank(self) -> int: ...
    @property
    def nu(self) -> int: ...
    @property
    def ratio(self) -> float: ...
    # rows without a residual, those that are tied, and the last ones of ties
    def span(self, tested: Sequence[int]) -> tuple[list[int], list[int], list[int]]: ...
    # rows (d - rank, d), each with an entry of its own
    def combinations(self) -> _Floats: ...

# of rows [Z Y] or their triangle, Z of d columns
def fit(rows: _Floats, d: int, size: int, threads: int) -> Fitted: ...

@final
class Estimate:
    def __new__(
        cls,
        triangle: _Floats,
        size: int,
        n: int,
        m: int,
        offset: bool,
        known: _Floats | None = None,
    ) -> Estimate: ...
    @property
    def Theta(self) -> _Floats: ...
    @property
    def rank(self) -> int: ...
    @property
    def size(self) -> int: ...
    @property
    def covariance(self) -> _Floats | None: ...
    @property
    def blocks(self) -> list[Fitted]: ...
    def after(self, size: int, times: float) -> Estimate: ...
    # assumed: design, noise, covariance, the known one
    def region(
        self,
        assumed: tuple[str, str, str, _Floats | None],
        units: _Floats | Estimate,
        delta: float,
        components: bool,
        directions: _Floats | None,
        future: int,
        frobenius: bool,
        method: str,
        anytime: bool,
        threads: int,
        tail: float = 0.0,
    ) -> Region: ...

@final
class Window:
    def __new__(
        cls,
        outputs: int,
        inputs: int,
        count: int,
        pole: float | None = None,
        delay: int = 0,
        intercept: bool = False,
        burn: int = 0,
    ) -> Window: ...
    @property
    def length(self) -> int: ...
    @property
    def count(self) -> int: ...
    @property
    def pole(self) -> float | None: ...
    @property
    def delay(self) -> int: ...
    @property
    def states(self) -> int: ...
    @property
    def fill(self) -> int: ...
    def rows(self, pairs: _Floats, runs: Pieces, first: int) -> tuple[_Floats, _Floats]: ...
    def state_of(self, y: _Floats, u: _Floats) -> _Floats: ...
    def advance(self, x: _Floats, y: _Floats, u: _Floats) -> _Floats: ...
    # x, z, u, states (n, m), outputs (n_y, m), off, rounding
    def rest(
        self, theta: _Floats, outputs: _Floats, inputs: _Floats
    ) -> tuple[_Floats, _Floats, float, float]: ...
    def linear(self, theta: _Floats) -> tuple[_Floats, _Floats, _Floats]: ...

def mixtures() -> _Floats: ...

# (Theta - C) V (Theta - C)' <= S times the factor for some rows and columns of Theta; white' white
# = V^+, root' root = V; columns of missing: what the data do not determine
@final
class RegionPart:
    def __new__(
        cls,
        rows: NDArray[np.int64],
        columns: NDArray[np.int64],
        white: _Floats,
        root: _Floats,
        missing: _Floats,
        ratio: float,
        shape: _Floats,
        factor: float,
    ) -> RegionPart: ...
    # around least squares, widened by its rounding
    @staticmethod
    def around(fitted: Fitted, shape: _Floats, factor: float) -> RegionPart: ...
    def __reduce__(self) -> tuple[type[RegionPart], tuple[object, ...]]: ...
    @property
    def rows(self) -> NDArray[np.int64]: ...
    @property
    def columns(self) -> NDArray[np.int64]: ...
    @property
    def white(self) -> _Floats: ...
    @property
    def root(self) -> _Floats: ...
    @property
    def missing(self) -> _Floats: ...
    @property
    def ratio(self) -> float: ...
    @property
    def S(self) -> _Floats: ...
    @property
    def factor(self) -> float: ...
    @property
    def radius(self) -> float: ...
    # of each row
    @property
    def deviations(self) -> _Floats: ...
    # of z (d,) in the norm of V^-1, and the largest of a unit vector in these columns
    def length(self, z: _Floats) -> float: ...
    def reach(self, first: int, end: int) -> float: ...

# radius and root of noise of known size; or root, level of the last state and of others
_ToCome: TypeAlias = tuple[float, _Floats] | tuple[_Floats, float, float]

# what is known of the covariance of the noise, and the known one
_Known: TypeAlias = tuple[Literal["full", "diagonal", "scalar", "known"], _Floats | None]

@final
class Pilot:
    def __new__(
        cls,
        rows: _Floats,
        lengths: NDArray[np.int64],
        model: _Floats,
        feedback: tuple[_Floats, _Floats] | None,
        threads: int,
    ) -> Pilot: ...
    @staticmethod
    def after(
        rows: _Floats, model: _Floats, root: _Floats, before: int, m: int, threads: int
    ) -> Pilot: ...
    @property
    def centre(self) -> _Floats: ...
    @property
    def white(self) -> _Floats: ...
    @property
    def determined(self) -> bool: ...
    def region(self, known: _Known, delta: float, both: bool) -> Region: ...
    def reference(self, x0: _Floats, inputs: _Floats) -> Reference: ...
    # of the model and of noise, (K + 1, n) each; of a system, x0, inputs and a gain
    def followed(
        self,
        own: tuple[_System, _Floats, _Floats, _Floats | None],
        reference: tuple[_System, _Floats, _Floats, _Floats | None],
        known: _Known,
        delta: float,
        noise: bool,
    ) -> tuple[_Floats, _Floats] | None: ...
    # target, reach, quantile, mismatch, rest, tube (K + 1,), components (n,)
    def near(
        self,
        reference: Reference,
        x0: _Floats,
        xf: _Floats,
        inputs: _Floats,
        predicted: _Floats,
        known: _Known,
        delta: float,
        noise: bool,
    ) -> tuple[float, float, float, float, float, _Floats, _Floats]: ...

@final
class Reference: ...

@final
class Region:
    def __new__(
        cls,
        centre: _Floats,
        m: int,
        parts: tuple[RegionPart, ...],
        frobenius: float | None,
        future: bool,
    ) -> Region: ...
    @property
    def centre(self) -> _Floats: ...
    @property
    def parts(self) -> tuple[RegionPart, ...]: ...
    @property
    def frobenius(self) -> float | None: ...
    @property
    def noise(self) -> _Floats | None: ...
    @property
    def radius(self) -> float: ...
    def bound(self, z: _Floats, noise: bool) -> float: ...
    def component_bounds(self, z: _Floats) -> _Floats: ...
    def entry_bounds(self) -> _Floats: ...
    def spread(self, first: int, end: int) -> float: ...
    def contains(self, theta: _Floats) -> bool: ...
    def projection(self, one: tuple[int, int], other: tuple[int, int]) -> _Floats | None: ...
    def errors(
        self, x0: _Floats, inputs: _Floats, rho0: float, noise: _ToCome | None
    ) -> Errors: ...

# [A B c], J, G of x+ = [A B c] (x, u, 1) + G w with z = J (x, u, 1), and the number of inputs
_System: TypeAlias = tuple[_Floats, _Floats, _Floats, int]

# the region of [A B c], and the bound of the covariance of its noise
def entered_region(
    region: Region, system: _System, covariance: _Floats | None
) -> tuple[Region, _Floats | None]: ...

# windows (K + 1, n), outputs (K, p), radii (K + 1,) and components (K + 1, p) of their mean, and
# those of readings for noise of (covariance, probability)
def output_tube(
    region: Region,
    system: _System,
    x0: _Floats,
    inputs: _Floats,
    gain: _Floats | None,
    noise: tuple[_Floats, float] | None,
    apart: _Floats | None,  # how far inputs may be from the plan, (K, m)
) -> tuple[_Floats, _Floats, tuple[_Floats, _Floats], tuple[_Floats, _Floats] | None]: ...

@final
class Errors:
    # (K + 1, n) of the centre; (K + 1,) of the norm; (n,) of the last state
    @property
    def states(self) -> _Floats: ...
    @property
    def radii(self) -> _Floats: ...
    @property
    def components(self) -> _Floats: ...
    # for one part, (K + 1,): what is of first order in `radii`, and the errors in the norm of V^-1
    @property
    def linear(self) -> _Floats: ...
    @property
    def rest(self) -> _Floats: ...

# best way, target, reach, error of the model, of x0, components (n,), tube (K + 1,), distance of
# the control from the best one, and why that is not known; a way: whether it is asked for that
_Way: TypeAlias = tuple[Region, _Floats, _ToCome | None, bool]

def followed_inputs(
    region: Region, x0: _Floats, inputs: _Floats, planned: _Floats, gain: _Floats
) -> _Floats: ...
def certify(
    start: tuple[_Floats, float],
    xf: _Floats,
    predicted: _Floats,
    ways: list[_Way],
    apart: _Way | None,
    every: bool,
) -> tuple[
    int,
    tuple[float, float, float, float],
    _Floats,
    _Floats,
    _Floats | None,
    float,
    str | None,
]: ...

_LoopStatus: TypeAlias = Literal[
    "certified", "refuted", "not provable", "undetermined", "undecided"
]

@final
class Feedback:
    # of data in doubt nothing is certified
    def __new__(
        cls,
        region: Region,
        gain: _Floats,
        doubted: bool = False,
        misfit: tuple[_Floats, _Floats, float] | None = None,
    ) -> Feedback: ...
    # of more states, which follow those of this one and do not act on them
    def behind(self, region: Region, gain: _Floats) -> Feedback: ...
    @property
    def status(self) -> _LoopStatus: ...
    # proved upper and unproved lower bound of rho g, spectral radius of the centre
    @property
    def sizes(self) -> tuple[float, float, float]: ...
    @property
    def proof(self) -> _Floats | None: ...
    @property
    def multipliers(self) -> _Floats: ...
    @property
    def member(self) -> _Floats | None: ...
    def invariant(
        self, x: _Floats, alpha: float, lambda_: float, slack: float | None = None
    ) -> _Floats | None: ...
    def verified(
        self, root: _Floats, x: _Floats, alpha: float, lambda_: float, multipliers: _Floats
    ) -> bool: ...
    # of the centre, of the model, of the start, each (K + 1, n + m); radii (K + 1,), of noise
    # (n + m,) and its radius; sup of the later norms, and of all rows; x0 from `rest` (xs, us) on
    def tube(
        self,
        x0: _Floats,
        steps: int,
        plan: _Floats,
        start: float,
        noise: tuple[_Floats, float] | None,
        rest: tuple[_Floats, _Floats] | None = None,
    ) -> tuple[_Floats, _Floats, _Floats, _Floats, _Floats, float, _Floats, _Floats]: ...
    # how far states and inputs are at rest from (xs, us), and the 2-norm of the states
    def rest(self, xs: _Floats, us: _Floats) -> tuple[_Floats, float]: ...
    # how large a term in the states E of H (x, u) may be, for all systems and for the centre
    def allows(self, e: _Floats, h: _Floats) -> tuple[float, float]: ...
    # (4 m + 6, 2): least and largest gain, phase, disk of each input; disk, delays, readings,
    # bits, share; the controller has a record c+ = N (c, v) + G y+, and asks for v = K c
    def margins(self, recorder: tuple[_Floats, _Floats] | None = None) -> _Floats: ...
    # what rounding adds to states and inputs, with filters (pole, outputs, count), of a loop that
    # reaches (n + m,) and whose inputs are apart by (m,); and what errors of readings add to states
    # and K x, and to inputs
    def rounded(
        self,
        reach: _Floats,
        apart: _Floats,
        bits: int | None,
        filters: tuple[float | None, int, int] | None,
    ) -> _Floats: ...
    def misread(
        self, recorder: tuple[_Floats, _Floats] | None, sizes: _Floats
    ) -> tuple[_Floats, _Floats]: ...
    # how many times x0 all systems come to rest from with saturated inputs
    def attracted(self, limits: _Floats, x0: _Floats) -> float: ...
    def holds(self, limits: _Floats, x0: _Floats | None) -> tuple[float, float | None]: ...

# estimate, radius, allowed; violations of all, without each group of columns, without each row;
# gains with both radii; white, root and factor
_Looked: TypeAlias = tuple[list[_Floats], _Floats, list[_Floats], tuple[_Floats, _Floats, float]]
# threshold, pairs after the alarm, alarms; of the first: call, part, direction, column, fell
_Now: TypeAlias = tuple[float, float, float, tuple[float, int, int, int, bool] | None]

@final
class Watch:
    # law and whether the plant may move; steps between false alarms, or below 1 their probability
    def __new__(
        cls,
        region: Region,
        noise: _Floats,
        window: Window,
        law: tuple[str, bool],
        promise: float,
        pairs: int,
    ) -> Watch: ...
    def step(self, y: _Floats, acted: _Floats) -> tuple[str, float, int]: ...
    # rows (z, y) as pairs after an alarm
    def take(self, rows: _Floats) -> None: ...
    @property
    def now(self) -> _Now: ...
    # between which calls the change of an alarm began, with `level` left out
    def onset(self, level: float) -> list[float] | None: ...
    # the root mean squares of the inputs in the calls before it
    def acting(self) -> _Floats: ...
    def sights(self, steps: float) -> list[tuple[int, int, float]]: ...
    # sizes and numbers of a controller in C
    def tables(self) -> tuple[list[tuple[str, int]], list[tuple[str, _Floats]]]: ...
    # the readings with noise of their own
    @property
    def rows(self) -> list[int]: ...
    def clear(self) -> None: ...
    def look(self, alpha: float, groups: list[list[int]]) -> _Looked: ...
    def state(self) -> _Floats: ...
    def resume(self, numbers: _Floats) -> None: ...

def test_of_two_logs(
    one: Fitted, other: Fitted, level: float, threads: int
) -> tuple[float, float]: ...

@final
class Gate:
    # None where the noise (n, n) is no bound of a covariance, or the region is unbounded
    @staticmethod
    def of(region: Region, noise: _Floats, false_alarm: float) -> Gate | None: ...
    # how far off readings are, in widths of the gate, behind a known window
    def excess(self, off: _Floats, z: _Floats, seen: list[bool]) -> float: ...

@final
class SetPoints:
    # the sizes of outputs and inputs
    def __new__(cls, window: Window, theta: _Floats, unit: _Floats) -> SetPoints: ...
    @property
    def can_be_held(self) -> bool: ...
    # of a constant input, to the next reading (p, m)
    @property
    def of_inputs(self) -> _Floats: ...
    # nan where an output is free: it stays at `now` if it integrates; and where an input is chosen
    def at(
        self,
        target: _Floats,
        weights: _Floats,
        now: _Floats,
        limits: tuple[_Floats, _Floats],
        given: _Floats,
    ) -> SetPoint: ...
    # f* and the size of its terms: above 0 no system of the region rests there
    def lacking(
        self, region: Region, target: _Floats, limits: tuple[_Floats, _Floats]
    ) -> tuple[float, float]: ...
    # of bias, calls, gain, noise and (y, u) at rest: constants at the inputs, how much more each
    # sensor reads, and whether two of them are wrong; None: nothing is to be explained
    def causes(
        self,
        region: Region,
        learned: tuple[_Floats, int, _Floats, _Floats, _Floats],
        level: float,
    ) -> tuple[list[float] | None, list[float | None], bool] | None: ...
    # directions of the outputs in these sizes (any, p), of which at most `least` leaves in a step
    def integrating(self, sizes: _Floats, least: float) -> _Floats: ...

@final
class SetPoint:
    # outputs and inputs, and what a bias adds to them (p + m, p) and to the states (n, p)
    @property
    def place(self) -> _Floats: ...
    @property
    def of_bias(self) -> _Floats: ...
    @property
    def states_of_bias(self) -> _Floats: ...
    @property
    def at_limit(self) -> list[int]: ...
    @property
    def exact(self) -> list[bool]: ...
    # of all systems of a region: shift and half widths (p + m,), and the norm of B
    def spread(self, region: Region) -> tuple[_Floats, _Floats, float] | None: ...
    # the state and the input that go with a target `step` away that moves by `slope`, and given
    # inputs that are so far away
    def moving(
        self, bias: _Floats, step: _Floats, slope: _Floats, given: _Floats
    ) -> tuple[_Floats, _Floats]: ...
    # of a law (gain, what is added, rate, low, high) about it, with step, slope and given inputs;
    # None: it overflows
    def input(
        self,
        x: _Floats,
        bias: _Floats,
        moves: tuple[_Floats, _Floats, _Floats],
        law: tuple[_Floats, _Floats, _Floats, _Floats, _Floats],
        acted: _Floats,
    ) -> _Floats | None: ...

# L and P (p, p) of a bias that is learned
def bias_gain(of_inputs: _Floats, drift: _Floats, noise: _Floats) -> tuple[_Floats, _Floats]: ...

@final
class Readings:
    # signals: the mean of the outputs, what is not known of outputs and inputs at first, and above
    # which no output can have been measured;
    # bias: its gain, the covariance of its error, and of the noise; aim: as of `aim`
    def __new__(
        cls,
        window: Window,
        theta: _Floats,
        noise: _Floats,
        signals: tuple[_Floats, _Floats, _Floats],
        gate: Gate | None,
        bias: tuple[_Floats, _Floats, _Floats],
        aim: tuple[_Floats, _Floats, _Floats, _Floats],
        max_missing: int,
    ) -> Readings: ...
    # sizes and numbers by their names, for a controller without this core
    def tables(self) -> tuple[list[tuple[str, int]], list[tuple[str, _Floats]]]: ...
    # what a bias adds to the inputs that hold the set point, these inputs, and their limits
    def aim(self, aim: tuple[_Floats, _Floats, _Floats, _Floats]) -> None: ...
    # what was predicted, the bias, how far off in widths of the gate, whether believed; x, and
    # whether all was read
    def step(
        self, y: _Floats, acted: _Floats, bias: _Floats, started: bool
    ) -> tuple[
        _Floats | None, _Floats, float, bool, Literal["lost", "waits", "runs"], _Floats, bool
    ]: ...
    def start(self, x: _Floats) -> None: ...
    # x, whether it is known, excess, complete readings in a row, calls, readings of each output,
    # whether it is stuck
    @property
    def now(self) -> tuple[_Floats, bool, float, int, int, list[int], bool] | None: ...
    # of the window and of those with what was rejected, and the doubt of the first
    def state(self) -> tuple[list[_Floats | None], _Floats]: ...
    def resume(
        self, windows: list[_Floats | None] | None = None, doubt: _Floats | None = None
    ) -> None: ...

@final
class Keeper:
    # limits low, high (n + m + r,) and rows below (r, n + m); None where nothing is proved
    @staticmethod
    def of(
        feedback: Feedback,
        limits: tuple[_Floats, _Floats, _Floats],
        covariance: _Floats,
        eps: float,
        calls: int,
    ) -> Keeper | None: ...
    @property
    def noise(self) -> _Floats: ...
    # what the plan lacks: row, step, amount, what is kept back for model and noise; and what the
    # model adds to each row; `always` by the exact first order
    def judge(
        self, x0: _Floats, plan: _Floats, always: bool
    ) -> tuple[tuple[int, int, float, float, float] | None, _Floats]: ...
    def follow(self, x0: _Floats, plan: _Floats, k: int, x: _Floats) -> _Floats: ...

# gain, cost, multiplier or margin
_Gain: TypeAlias = tuple[_Floats, _Floats | None, float]

def feedback_gain(
    a: _Floats, b: _Floats, q: _Floats, r: _Floats, states: Sequence[str] | None = None
) -> _Gain: ...
def widest_gain(region: Region) -> _Gain: ...

# of the first p rows by data: the largest state of a mode that no input is seen to move, and how
# many times as large it is after a step
def unmoved(region: Region, p: int) -> tuple[int, float] | None: ...
def guaranteed_gain(
    region: Region,
    q: _Floats,
    r: _Floats,
    tau: float | None = None,
    states: Sequence[str] | None = None,
) -> _Gain: ...
def loop_eigenvalues(a: _Floats, b: _Floats, k: _Floats) -> NDArray[np.complex128]: ...

# H (n, d), white (rank, d), S (n, n), "known" or what is to estimate of it, degrees of freedom
_EstimateLaw: TypeAlias = tuple[_Floats, _Floats, _Floats, str, int]

def estimate_draws(law: _EstimateLaw, size: int, key: bytes, threads: int) -> _Floats: ...
def drawn_misses(
    law: _EstimateLaw,
    x0: _Floats,
    inputs: _Floats,
    xf: _Floats,
    noise: bool,
    size: int,
    key: bytes,
    threads: int,
    window: Window | None = None,
    gain: _Floats | None = None,
) -> _Floats: ...

# inputs (runs, steps m); phi before the first run and after each
def next_runs(
    model: _Floats,
    white: _Floats,
    covariance: _Floats,
    x0: _Floats,
    inputs: _Floats,
    starts: _Floats,
    steps: int,
    low: _Floats,
    high: _Floats,
    key: bytes,
) -> tuple[_Floats, _Floats]: ...

# name, p-value, share, where, share of each outcome
_Tested: TypeAlias = tuple[str, float, float, NDArray[np.int64], _Floats]

# rows (x, u, x one step later), the place of each in its piece, and its run
_Log: TypeAlias = tuple[_Floats, Pieces]

# What a log says: window, how many lags or filters its first pairs asked for, how many of these are
# not the model's; estimates of all others, and of those that say the size of the rest and this rest
@final
class Identified:
    @property
    def window(self) -> Window: ...
    @property
    def found(self) -> int | None: ...
    @property
    def first(self) -> int: ...
    @property
    def unit(self) -> bool: ...
    @property
    def size(self) -> int: ...
    @property
    def triangle(self) -> _Floats: ...
    @property
    def estimate(self) -> Estimate: ...
    @property
    def parts(self) -> list[Estimate] | None: ...
    @property
    def plain(self) -> Fitted: ...
    @property
    def tests(self) -> list[_Tested]: ...
    # whether inputs as late as the test "dead time" says leave smaller residuals
    @property
    def later(self) -> bool: ...
    @property
    def checks(self) -> tuple[_Floats, _Floats] | None: ...

# about: least and largest delay; intercept, whether outputs are read, whether z is a window,
# whether its size was expected, whether the error has an exact law, whether there is a pilot;
# simulated: draws, key, most numbers
def identify(
    pairs: _Log,
    whole: _Log | None,
    sizes: tuple[int, int],
    past: tuple[Window, int] | tuple[float, int] | int,
    about: tuple[tuple[int, int], tuple[bool, ...]],
    known: _Floats | None,
    tested: Sequence[int],
    noise: tuple[str, _Floats | None],
    threads: int,
    triangle: _Floats | None = None,
    simulated: tuple[int, bytes, float] | None = None,
) -> Identified: ...
def noise_tests(
    fitted: Fitted, tested: Sequence[int], noise: tuple[str, _Floats | None]
) -> list[_Tested]: ...
def residual_checks(
    rows: _Floats, d: int, tested: Sequence[int], draws: int, key: bytes, threads: int
) -> tuple[_Floats, _Floats] | None: ...

# Least J(u) = ||M u - y||^2 + u' R u over low <= u <= high. M (rows, d), y (rows,), R (d,) or (d,
# d) psd; limits (d,), -inf and inf where there is none, equal where an input is fixed. Weights of
# states are inside: M = Q^(1/2) B.

@final
class BoxControl:
    # (d,), inside the limits
    @property
    def control(self) -> _Floats: ...
    # (d,): -1 at the lower limit, 1 at the upper one, by value; of a fixed input by the sign of
    # its multiplier
    @property
    def active(self) -> NDArray[np.int8]: ...
    # (d,), >= 0: J'_i at the lower limit, -J'_i at the upper one, 0 elsewhere
    @property
    def multipliers(self) -> _Floats: ...
    @property
    def status(self) -> _Status | Literal["infeasible"]: ...
    # J(u) - min J is at most this: the smaller of max <J'(u), u - v> over the limits and the square
    # of the distance by the dual residual
    @property
    def gap(self) -> float: ...
    # D >= (||M (u - u*)||^2 + ||u - u*||_R^2)^(1/2)
    @property
    def distance(self) -> float: ...
    # J(u), and J(0); "optimal": gap <= 1e-9 (J(0) + J(u)), of a horizon with the size of J along
    # the states at u, if that is less than J(0)
    @property
    def objective(self) -> float: ...
    @property
    def at_zero(self) -> float: ...
    # factorizations
    @property
    def iterations(self) -> int: ...
    # the last thing that changed u
    @property
    def method(self) -> Literal["pivoting", "interior point", "refinement"]: ...

# `warm`: `active` of a problem nearby; `time_limit` in seconds, looked at within
# factorizations
def box_control(
    m: _Floats,
    y: _Floats,
    r: _Floats,
    low: _Floats,
    high: _Floats,
    warm: NDArray[np.int8] | None,
    time_limit: float | None,
) -> BoxControl: ...

# K steps of x(k+1) = A x(k) + B u(k) + c and a task: what its best control is, and how far others
# are from it. M (rows, m K), y = target - state x0 for the condensed map. `task` is read by its
# attributes (see `controls.task.Task`); `reference` and `r` take the place of its own.
@final
class Horizon:
    def __new__(
        cls,
        a: _Floats,
        b: _Floats,
        c: _Floats | None,
        task: object,
        reference: _Floats | None = None,
        r: _Floats | None = None,
    ) -> Horizon: ...
    # R (m, m), given or chosen
    @property
    def r(self) -> _Floats: ...
    # the lower triangle of H^-1 row by row, F (m K, n) and g: inputs without limits are F x0 + g;
    # states that have limits follow behind the inputs
    def condensed(self) -> tuple[_Floats, _Floats, _Floats]: ...
    # whether the recursion of Riccati solves it, and the rows of M
    @property
    def long(self) -> bool: ...
    @property
    def rows(self) -> int: ...
    # M, state (rows, n) and target (rows,)
    def weighted(self) -> tuple[_Floats, _Floats, _Floats]: ...
    # F (rank, n) with F'F = Q, of the stages and of the last step
    def roots(self) -> tuple[_Floats, _Floats]: ...
    # A^p B, (K, n m)
    def pushes(self) -> _Floats: ...
    # ||M||_F, ||state||_F, and the same of what xf is multiplied by
    def norms(self) -> tuple[float, float, float]: ...
    # ||Q_k||_2 (K,), with the curvature of soft limits if `soft`
    def weights(self, soft: bool) -> _Floats: ...
    def objective(self, x0: _Floats, u: _Floats) -> float: ...
    # the largest ||u - v|| for v within the limits of single inputs
    def farthest(self, u: _Floats) -> float: ...
    def in_two_norm(self, distance: float) -> tuple[float, float]: ...
    # the best control, and what the limits cost
    def solve(self, x0: _Floats, time_limit: float | None) -> HorizonControl: ...
    # a bound of max <J'(u), u - v>, from gap >= J(u) - min J where there are rates or hard limits
    # of states, and the norm of what no limit balances of J'(u) / 2
    def optimality(self, states: _Floats, u: _Floats, gap: float) -> tuple[float, float]: ...
    # the least eigenvalue of M'M + R, 0 if it is rounding
    def least(self) -> float: ...
    # (state, control, excess, missed) of `given` (u, gap, distance, objective), for what
    # made it differ from the best: nothing random; the distance of the target, with
    # off = r^(k) - x^(k); simulated radii; or a moved map
    def error(
        self,
        x0: _Floats,
        given: object,
        cause: float | tuple[float, ...] | Apart | None = None,
        off: _Floats | None = None,
    ) -> tuple[float, float, float, float]: ...
    # of states in a tube (K,) around these (K, n), in the norm of Q; `sure`: the x0 of one step
    def alpha(
        self, region: Region, tube: _Floats, states: _Floats, u: _Floats, sure: _Floats | None
    ) -> float: ...
    def apart(
        self, region: Region, states: _Floats, u: _Floats, alpha: float, gap: float
    ) -> Apart: ...
    def map_radius(self, radii: tuple[float, float]) -> float: ...
    # for bounds (e0, ef, eA) of the errors of x0, xf and A: of the states (K + 1, n) of an estimate
    # in the norm of Q, and of the target where the map is exact
    def along(self, states: _Floats, errors: tuple[float, float, float]) -> float: ...
    def moved_target(
        self, errors: tuple[float, float, float], a: _Floats, x0: _Floats
    ) -> float: ...
    # (runs,) distances of the target, (runs, 3) errors of the controls of drawn estimates; the
    # entities as for `simulate_plans`
    def moved_targets(
        self,
        entities: tuple[_Estimate, _Estimate, _Estimate],
        rows: bool,
        paired: bool,
        x0: _Floats,
        xf: _Floats,
        runs: int,
        cost: float,
        key: bytes,
        threads: int,
    ) -> _Floats: ...
    def drawn_errors(
        self,
        entities: tuple[_Estimate, _Estimate, _Estimate],
        rows: bool,
        x0: _Floats,
        follows: bool,
        auto: bool,
        runs: int,
        cost: float,
        key: bytes,
        threads: int,
    ) -> _Floats: ...

# The fields of `controls.limited.Limited` that a solver finds.
@final
class HorizonControl:
    @property
    def u(self) -> _Floats: ...
    @property
    def active(self) -> NDArray[np.int8]: ...
    @property
    def multipliers(self) -> _Floats: ...
    @property
    def state_active(self) -> NDArray[np.int8] | None: ...
    @property
    def gap(self) -> float: ...
    @property
    def distance(self) -> float: ...
    @property
    def objective(self) -> float: ...
    @property
    def missed(self) -> float: ...
    @property
    def status(self) -> _Status | Literal["undecided", "infeasible"]: ...
    @property
    def missing(self) -> float: ...
    # states, feedback (K m, n), steps of the inputs alone and their J
    @property
    def followed(self) -> tuple[_Floats, _Floats, int, float] | None: ...

# Bounds of ||G (w - u)||_Q, ||w - u||_R, of both together, ||w - u||_2 and J(w) - J(u).
@final
class Apart:
    @property
    def state(self) -> float: ...
    @property
    def weighted(self) -> float: ...
    @property
    def distance(self) -> float: ...
    @property
    def control(self) -> float: ...
    @property
    def excess(self) -> float: ...

# A horizon for one state after another: each call begins at the active limits of the call before,
# a step later. Nothing changes where a call raises.
@final
class Loop:
    def __new__(cls, a: _Floats, b: _Floats, c: _Floats | None, task: object) -> Loop: ...
    # whether one condensed map serves all states
    @property
    def condensed(self) -> bool: ...
    def solve(self, x: _Floats, time_limit: float | None) -> BoxControl: ...
    # inputs (m,) and states (n,) that the plans are about: all limits less these; with inputs that
    # are not chosen (K, m), nan for the others
    def about(self, inputs: _Floats, states: _Floats, fixed: _Floats | None = None) -> None: ...
    # the states (K, n) that plans follow from now on
    def toward(self, reference: _Floats) -> None: ...
    # factorizations, operations and seconds of a call at most; None where they have no bound
    def most(self) -> tuple[int, float, float] | None: ...
    # the input that is applied now, from which the next change counts
    def follow(self, previous: _Floats) -> None: ...
    # signs of the limits of inputs, rates and states at which the next call begins, before the
    # shift; None: from anew
    def warm(self) -> NDArray[np.int8] | None: ...
    def resume(self, warm: NDArray[np.int8] | None) -> None: ...

# u (N, d) for the rows of y (N, rows), and the gap of each if `gaps`; the same bits for any
# number of threads
def box_batch(
    m: _Floats, y: _Floats, r: _Floats, low: _Floats, high: _Floats, gaps: bool, threads: int
) -> tuple[_Floats, _Floats | None]: ...

# -- fleets: x_s(k+1) = A_s x_s(k) + B_s u(k) + c_s, d = steps m; u is (d,) --

# A (N, n, n), B (N, n, m), c (N, n) or None, x0 (N, n) or (1, n)
_Units: TypeAlias = tuple[_Floats, _Floats, _Floats | None, _Floats]
# u (K, m), its value, a lower bound of the least, by how much limits of states cannot be kept
_Command: TypeAlias = tuple[_Floats, float, float, float, _Status]

# For J(u) = mean_s ||G_s u - b_s||_Q^2 + ||u||_R^2. After Ctrl-C the best so far.
def fleet_mean(units: _Units, task: object, time_limit: float | None, threads: int) -> _Command: ...

# (N,): ||G_s u - b_s||_Q, and by how much the states leave their limits
def fleet_misses(
    units: _Units, task: object, u: _Floats, threads: int
) -> tuple[_Floats, _Floats]: ...

# and support, removed, R (m, m), widest; `tiny`: R is 1e-8 of the largest map's. After Ctrl-C the
# best so far.
def fleet_worst(
    units: _Units,
    task: object,
    tiny: bool,
    discard: int,
    time_limit: float | None,
    threads: int,
) -> tuple[_Command, list[int], list[int], _Floats | None, int | None]: ...

# u (K, m) of a few units alone, as the support gives it
def fleet_alone(
    units: _Units, task: object, tiny: bool, few: list[int], threads: int
) -> _Floats: ...
def scenario_at_most(size: int, most: int, beta: float) -> float: ...
def scenario_compression(size: int, support: int, violations: int, beta: float) -> float: ...
def scenario_discarding(size: int, discarded: int, dimension: int, beta: float) -> float: ...
def scenario_judged(size: int, support: int, beta: float) -> float: ...
def scenario_rank(size: int, delta: float, beta: float) -> int: ...
def scenario_relaxed(size: int, support: int, beta: float) -> tuple[float, float]: ...
def scenario_required(epsilon: float, dimension: int, beta: float) -> int: ...

# path, A, scale, target
_Predicted: TypeAlias = tuple[_Floats, _Floats, _Floats, _Floats]

def noise_deviations(a: _Floats, covariance: _Floats, steps: int) -> _Floats: ...
def validation_mean(ends: _Floats, target: _Floats, delta: float) -> float: ...
def validation_rank(scores: _Floats, rank: int) -> float: ...
def validation_runs(
    predicted: _Predicted, runs: _Floats, threads: int
) -> tuple[_Floats, _Floats]: ...
def validation_systems(
    predicted: _Predicted,
    a: _Floats,
    b: _Floats,
    c: _Floats | None,
    x0: _Floats,
    u: _Floats,
    threads: int,
) -> tuple[_Floats, _Floats]: ...
def validation_weighted(scores: _Floats, weights: _Floats, delta: float) -> float: ...
