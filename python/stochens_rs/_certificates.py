"""What a plan knows of its entities, and what follows for the error of its control.

`control` keeps, of every entity, the small arrays only: the vector or matrix that the
realizations were drawn from, never the realizations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from . import _gate
from .ensembles import Counts, Ensemble
from .exceptions import InputError, ShapeError
from .results import Fit, Plan, PlanBound
from .system import System

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ._lines import Axis
    from .rng import Key
    from .theory.bounds import Best

    Floats: TypeAlias = NDArray[np.float64]

Kind: TypeAlias = Literal["exact", "iid", "systematic", "fitted", "unknown"]


@dataclass(frozen=True, eq=False)
class Known:
    """One entity: its estimate and how far that is from what.

    "iid", "systematic": the average of `size` realizations that `sample` drew from `values`.
    "exact": `values` itself. "fitted": at the distance `error` from the target of a fit.
    "unknown": the average of realizations that the user brought.
    """

    name: str
    kind: Kind
    estimate: Floats | None  # None where no formula needs it
    values: Floats | None = None
    size: int | None = None
    axis: Axis = "columns"
    error: float | None = None
    key: Key | None = None


@dataclass(frozen=True, eq=False)
class Basis:
    """Everything that a bound on the control needs."""

    B: Floats
    x0: Known
    xf: Known
    A: Known

    @property
    def entities(self) -> tuple[Known, Known, Known]:
        """In the order of the sizes ``(N0, Nf, NA)``."""
        return self.x0, self.xf, self.A


def known(name: str, value: Fit | Ensemble | Counts | Floats, estimate: Floats | None) -> Known:
    """Write down what an argument of `control` knows of itself."""
    if isinstance(value, Counts):
        if value._law is None:
            return Known(name, "unknown", value.estimate, size=value.size)
        values, axis, scheme = value._law
        return Known(name, scheme, estimate, values, value.size, axis, key=value.key)
    if isinstance(value, Ensemble):
        return _of_ensemble(name, value, estimate)
    if isinstance(value, Fit):
        if value.method == "uniform" and value.ensemble is not None:
            drawn = _of_ensemble(name, value.ensemble, estimate)
            if drawn.kind != "unknown" or value.error is None:
                return drawn
        if value.error is not None:
            return Known(name, "fitted", value.estimate, error=value.error)
        return Known(name, "unknown", value.estimate, size=len(value.weights))
    return Known(name, "exact", estimate, value.copy())


def _of_ensemble(name: str, ensemble: Ensemble, estimate: Floats | None) -> Known:
    values, scheme = ensemble._law(), ensemble.scheme
    if values is None or scheme is None:
        mean = ensemble.mean() if estimate is None else estimate
        return Known(name, "unknown", mean, size=ensemble.size, axis=ensemble.axis)
    return Known(name, scheme, estimate, values, ensemble.size, ensemble.axis, key=ensemble.key)


# -- the bound and the covariance -----------------------------------------------------------------


def plan_bound(
    plan: Plan,
    delta: float,
    system: System | None,
    x0: ArrayLike | None,
    xf: ArrayLike | None,
) -> PlanBound:
    """Bound the error of a plan (see `Plan.bound`)."""
    from .theory.bounds._base import level_of

    level_of(delta)  # refuses it here, before anything is computed
    basis = _completed(plan, system, x0, xf, "bound")
    if all(entity.kind in ("exact", "iid") for entity in basis.entities):
        state, control = (_best(basis, quantity, plan.fusion, delta) for quantity in _QUANTITIES)
        return PlanBound(
            state=state.radius,
            control=control.radius,
            delta=delta,
            state_bound=state.bound.name,
            control_bound=control.bound.name,
            relative_to="laws",
            certain=all(entity.kind == "exact" for entity in basis.entities),
        )
    if plan.fusion == "diagonal":
        raise InputError(
            "no bound is known for paired systematic realizations, which are dependent: use "
            "fusion='product'"
        )
    return _from_errors(basis, delta)


def plan_covariance(
    plan: Plan, system: System | None, x0: ArrayLike | None, xf: ArrayLike | None
) -> Floats:
    """Compute the covariance of a control (see `Plan.covariance`)."""
    from .theory import moments

    basis = _completed(plan, system, x0, xf, "covariance")
    for entity in basis.entities:
        if entity.kind == "fitted":
            raise InputError(
                f"no formula is known for the covariance: the weights of `{entity.name}` depend "
                "on the realizations"
            )
    schemes = {entity.kind for entity in basis.entities} - {"exact"}
    if len(schemes) > 1:
        raise InputError(
            "no formula is known for the covariance of iid and systematic samples together"
        )
    return moments.control_covariance(
        basis.B,
        *_values(basis),
        _sizes(basis),
        fusion="diagonal" if plan.fusion == "diagonal" else "product",
        axis=basis.A.axis,
        scheme="systematic" if "systematic" in schemes else "iid",
    )


_QUANTITIES: tuple[Literal["state"], Literal["control"]] = ("state", "control")


def _best(basis: Basis, quantity: Literal["state", "control"], fusion: str, delta: float) -> Best:
    from .theory import bounds

    return bounds.best(
        quantity,
        basis.B,
        *_values(basis),
        size=_sizes(basis),
        delta=delta,
        fusion="diagonal" if fusion == "diagonal" else "product",
        axis=basis.A.axis,
    )


def _from_errors(basis: Basis, delta: float) -> PlanBound:
    """Add the errors of the entities; those with iid realizations share delta."""
    from .theory import bounds

    random = sum(entity.kind == "iid" for entity in basis.entities)
    errors = {}
    for entity in basis.entities:
        if entity.kind == "fitted":
            assert entity.error is not None
            errors[entity.name] = entity.error
        elif entity.kind == "exact":
            errors[entity.name] = 0.0
        else:
            assert entity.values is not None
            if entity.kind == "systematic":
                sure = bounds.Systematic(entity.values, axis=entity.axis)
                errors[entity.name] = sure.radius(entity.size, delta)
            else:
                errors[entity.name] = bounds.best(
                    "matrix" if entity.name == "A" else "vector",
                    entity.values,
                    size=entity.size,
                    delta=delta / random,
                    axis=entity.axis,
                ).radius
    assert basis.x0.estimate is not None
    assert basis.A.estimate is not None  # product fusion
    state, control = bounds.from_errors(
        basis.B,
        basis.x0.estimate,
        basis.A.estimate,
        x0_error=errors["x0"],
        xf_error=errors["xf"],
        A_error=errors["A"],
    )
    fitted = any(entity.kind == "fitted" for entity in basis.entities)
    return PlanBound(
        state=state,
        control=control,
        delta=delta,
        state_bound="sum of errors",
        control_bound="sum of errors",
        relative_to="targets" if fitted else "laws",
        certain=random == 0,
    )


def _values(basis: Basis) -> tuple[Floats, Floats, Floats]:
    values = [entity.values for entity in basis.entities if entity.values is not None]
    x0, xf, A = values
    return x0, xf, A


def _sizes(basis: Basis) -> tuple[int | None, int | None, int | None]:
    N0, Nf, NA = (None if e.kind == "exact" else e.size for e in basis.entities)
    return N0, Nf, NA


# -- what the user adds ------------------------------------------------------------------------


def _completed(
    plan: Plan, system: System | None, x0: ArrayLike | None, xf: ArrayLike | None, what: str
) -> Basis:
    """The basis of a plan with the declared laws in place of unknown ones."""
    basis = plan._basis
    if basis is None:
        raise InputError(f"this Plan was not made by `control`: it has no {what}")
    n = len(basis.B)
    declared: dict[str, Floats] = {}
    if x0 is not None:
        declared["x0"] = _gate.vector("x0", x0, length=n)
    if xf is not None:
        declared["xf"] = _gate.vector("xf", xf, length=n)
    if system is not None:
        checked = System.from_any(system)
        if checked.B.shape != basis.B.shape:
            raise ShapeError(f"`system.B` must have shape {basis.B.shape}, got {checked.B.shape}")
        if not np.array_equal(checked.B, basis.B):
            raise InputError("`system.B` differs from the `B` of this plan")
        declared["A"] = np.asarray(checked.A)
    entities = {e.name: _declare(e, declared.get(e.name), what) for e in basis.entities}
    seen: dict[Key, str] = {}
    for entity in entities.values():
        if entity.key is None or entity.kind not in ("iid", "systematic"):
            continue
        if entity.key in seen:
            raise InputError(
                f"`{seen[entity.key]}` and `{entity.name}` were drawn with the same key, so they "
                "are not independent: draw with key.child(name), or with one Generator"
            )
        seen[entity.key] = entity.name
    return Basis(basis.B, entities["x0"], entities["xf"], entities["A"])


def _declare(entity: Known, values: Floats | None, what: str) -> Known:
    """Replace an unknown law by the declared one; refuse what contradicts the plan."""
    label = "system.A" if entity.name == "A" else entity.name
    argument = "system" if entity.name == "A" else entity.name
    if entity.kind == "unknown":
        if values is None:
            raise InputError(
                f"the law of `{entity.name}` is unknown (realizations brought by the user), and "
                f"the {what} depends on it: pass `{argument}=` if they are independent singletons "
                "of a known mean; for other realizations see DataStream.confidence"
            )
        assert entity.estimate is not None
        if not _possible(entity.estimate, values, entity.axis):
            raise InputError(
                f"`{label}` cannot be what the realizations of `{entity.name}` were drawn from: "
                "their average has other signs, zeros or 1-norms"
            )
        return replace(entity, kind="iid", values=values)
    if values is None:
        return entity
    if entity.values is None:
        raise InputError(
            f"`{argument}` must not be given: `{entity.name}` is a fit, bounded by its own error"
        )
    if not np.array_equal(values, entity.values):
        raise InputError(f"`{label}` differs from what this plan knows of `{entity.name}`")
    return entity


def _possible(estimate: Floats, values: Floats, axis: Axis) -> bool:
    """Say whether an average of singletons drawn from `values` can be `estimate`."""
    along = 0 if values.ndim == 1 or axis == "columns" else 1
    found, wanted = np.abs(estimate).sum(axis=along), np.abs(values).sum(axis=along)
    signs = (estimate == 0.0) | (np.sign(estimate) == np.sign(values))
    return bool(signs.all() and (np.abs(found - wanted) <= 1e-9 * wanted).all())
