"""The arguments of a control problem: arrays, fits, ensembles and counts, checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from .. import _core
from .._base import validation
from .._base.names import Labels, default_labels
from .._base.types import FUSIONS, Floats, Fusion, Status
from ..ensembles.ensemble import Ensemble
from ..ensembles.law import Counts
from ..ensembles.systems import SystemEnsemble
from ..exceptions import InputError, InputTypeError, ShapeError
from ..fusion.fits import Fit
from ..system.system import System
from ..theory.exact import Best, checked_steps, controllability, factors, matrix_powers

if TYPE_CHECKING:
    from typing import TypeGuard

    from numpy.typing import ArrayLike

    EntityLike: TypeAlias = Fit | Ensemble | Counts | ArrayLike
    SystemLike: TypeAlias = System | tuple[EntityLike, ArrayLike] | Any


@dataclass(frozen=True)
class Entity:
    """x0, xf or A: a fit, an ensemble, counts, or a copy of exact values."""

    name: str
    value: Fit | Ensemble | Counts | Floats

    def estimate(self) -> Floats:
        """What product fusion uses; a copy if the value belongs to the user."""
        if isinstance(self.value, Fit | Counts):
            return self.value.estimate.copy("K")  # in the same memory order: the same last bits
        return self.value.mean() if isinstance(self.value, Ensemble) else self.value

    def _ensemble(self) -> Ensemble | None:
        if isinstance(self.value, Counts):
            raise InputTypeError(
                f"`{self.name}` must be an Ensemble or an array here: counts have no realizations"
            )
        if isinstance(self.value, Fit):
            if self.value.method != "uniform" or self.value.ensemble is None:
                raise InputError(
                    f"`{self.name}` must be an Ensemble or an array here, got a fit by "
                    f"'{self.value.method}': paired realizations share one weight vector, so "
                    "weights of their own go with fusion='product'"
                )
            return self.value.ensemble
        return self.value if isinstance(self.value, Ensemble) else None

    def realizations(self) -> _core.Draws | Floats:
        """For the core: draws, rows of dense realizations, or a flat exact value."""
        ensemble = self._ensemble()
        if ensemble is not None:
            return ensemble._core_realizations()
        return self.estimate().ravel()

    @property
    def by_rows(self) -> bool:
        """Whether the realizations of a matrix were drawn row by row."""
        ensemble = self._ensemble()
        return ensemble is not None and ensemble.axis == "rows"

    @property
    def size(self) -> int | None:
        """Number of realizations; None for exact values."""
        if isinstance(self.value, Fit):
            return len(self.value.weights)
        return self.value.size if isinstance(self.value, Ensemble | Counts) else None

    @property
    def status(self) -> Status:
        """How the fit ended."""
        return self.value.status if isinstance(self.value, Fit) else "completed"

    @property
    def description(self) -> dict[str, Any]:
        """The entry of the plan's `info`."""
        if isinstance(self.value, Fit):
            fit = self.value
            return {"method": fit.method, "size": self.size, "status": fit.status, "gap": fit.gap}
        if isinstance(self.value, Ensemble | Counts):
            return {"method": "uniform", "size": self.size}
        return {"method": "exact", "size": None}


def problem(
    system: SystemLike, x0: EntityLike, xf: EntityLike | None, reference: Any = None
) -> tuple[Floats, tuple[Entity, Entity, Entity], Labels, float | None]:
    """Check all arguments of a control problem: B, the entities x0, xf and A, the names, and dt.

    `system` is a system, or (A, B) or (A, B, dt) whose A may be a Fit, an Ensemble, Counts or a
    SystemEnsemble; in place of B, a nominal System gives its B, names and dt. The last row of a
    `reference` takes the place of `xf`.
    """
    pair: tuple[Any, ...] = system if isinstance(system, tuple) else ()
    A, models = (pair[0] if pair else None), None
    if isinstance(A, SystemEnsemble):  # realizations of A, with its names and step
        models, A = A, Ensemble.from_samples(A.A, centre=A.centre)
        if models.c is not None:
            raise InputError("`A` must be models without offsets here: see control_fleet")
    if _estimated(A):
        if len(pair) not in (2, 3):
            raise InputTypeError(
                f"`system` must be a pair (A, B) or (A, B, dt) when A is "
                f"{validation.article(type(A))}, got {len(pair)} items"
            )
        n = A.shape[0]
        if A.shape != (n, n):
            raise ShapeError(f"`A` must have shape (n, n), got {A.shape}")
        matrix = Entity("A", A)
        if isinstance(pair[1], System):  # B, names and step of a nominal system
            B, labels, given = pair[1].B, pair[1].labels, pair[1].dt
            validation.matrix("B", B, rows=n)
        else:
            B, given = validation.matrix("B", pair[1], rows=n).copy(), None
            labels = default_labels(n, B.shape[1])
        if models is not None and B.shape[1] == models.m:
            labels, given = models.labels or labels, models.dt or given
        dt = validation.positive("dt", pair[2]) if len(pair) == 3 else given
        dt = dt if isinstance(dt, float) else None
    else:
        exact = System.from_any(system)
        n, B, matrix, labels = exact.n, exact.B, Entity("A", exact.A), exact.labels
        dt = exact.dt if isinstance(exact.dt, float) else None
    goal = ending(reference, xf, labels.states)
    ends = _end("x0", x0, labels.states), _end("xf", goal, labels.states)
    return B, (*ends, matrix), labels, dt


def ending(reference: Any, xf: Any, names: tuple[str, ...]) -> Any:
    """The target: xf, or the last row of a reference."""
    if reference is None and xf is None:
        raise InputError("`xf` must be given without `reference`")
    if reference is None:
        return xf
    if xf is not None:
        raise InputError("`xf` must be None with `reference`, whose last row takes its place")
    return validation.matrix("reference", reference, cols=len(names), labels=names)[-1]


def _end(name: str, value: object, names: tuple[str, ...]) -> Entity:
    n = len(names)
    if not _estimated(value):
        return Entity(name, validation.vector(name, value, length=n, labels=names).copy())
    if value.shape != (n,):
        raise ShapeError(f"`{name}` must have shape ({n},), got {value.shape}")
    return Entity(name, value)


def _estimated(value: object) -> TypeGuard[Fit | Ensemble | Counts]:
    return isinstance(value, Fit | Ensemble | Counts)


def fusion_over(steps: object, fusion: object, n: int, m: int) -> tuple[int, Fusion]:
    """Check the number of steps, and that the fusion is possible over so many."""
    K = validation.size("steps", steps)
    if validation.choice("fusion", fusion, FUSIONS) == "product":
        # one step needs no powers of A
        return K if K == 1 else checked_steps(K, n, m), "product"
    if K > 1:
        raise InputError(
            f"`fusion` must be 'product' with steps={K}, got 'diagonal': the control over K >= 2 "
            "steps is not linear in A, so the average of the controls of the realizations is "
            "biased, and more of them do not help"
        )
    return K, "diagonal"


def step_warnings(found: Best, *, exact: bool) -> tuple[str, ...]:
    """Warnings about an estimated C_K; for one step it is B, which is exact.

    C_K has the rank of C_n for K > n (Cayley and Hamilton); rounding hides it where A grows.
    """
    (n, m), K, rank = found.B.shape, found.steps, len(found.factors.s)
    if rank < n < K:
        C = controllability(matrix_powers(found.A, n - 1), found.B)
        rank = max(rank, len(factors(C).s))
    if rank < n and K > 1:
        return (
            f"C_K has rank {rank} < n = {n}: only targets in its range can be reached, and the "
            "estimate need not be consistent",
        )
    if m * K == n and K > 1 and not exact:
        return (
            f"m K = n = {n}: the inverse of the estimated C_K has heavy tails; take more than "
            f"{K} steps, or regularise",
        )
    return ()


def mean_warnings(system: SystemLike) -> tuple[str, ...]:
    """A warning where A or B are those of the mean of several models."""
    nominal = system[1] if isinstance(system, tuple) and len(system) > 1 else system
    if not isinstance(nominal, System) or (nominal._mean_of or 1) == 1:
        return ()
    return (
        f"the system is the mean of {nominal._mean_of} models, and all numbers are about this "
        "mean; how far a fresh model misses: plan.validate(fresh)",
    )
