"""What a plan knows of its entities, and what follows for the error of its control.

`control` keeps, of every entity, the small arrays only: the vector or matrix that the
realizations were drawn from, never the realizations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from . import _gate
from ._alse import norm
from .ensembles import Counts, Ensemble
from .exceptions import InputError, NonFiniteError, ShapeError
from .results import Fit, PlanBound
from .rng import RngLike, as_key
from .system import System
from .theory import bounds, moments
from .theory.bounds import _simulation
from .theory.bounds._simulation import Entity, PlanErrors
from .theory.multistep import matrix_powers, spectral_norms

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from ._lines import Axis
    from .rng import Key
    from .theory.bounds import Best
    from .theory.moments._formulas import Fusion

    Floats: TypeAlias = NDArray[np.float64]

Kind: TypeAlias = Literal["exact", "iid", "systematic", "fitted", "unknown"]


@dataclass(frozen=True, eq=False)
class Known:
    """One entity: its estimate and how far that is from what.

    "iid", "systematic": the average of `size` realizations that `sample` drew from `values`.
    "exact": `values` itself. "fitted": fitted to `values`, the target.
    "unknown": the average of realizations that the user brought.
    """

    name: str
    kind: Kind
    estimate: Floats | None  # None where no formula needs it
    values: Floats | None = None
    size: int | None = None
    axis: Axis = "columns"
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
            if drawn.kind != "unknown" or value.target is None:
                return drawn
        if value.target is not None:
            key = None if value.ensemble is None else value.ensemble.key
            return Known(name, "fitted", value.estimate, value.target, key=key)
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
    basis: Basis,
    u: Floats,
    delta: float,
    rng: RngLike,
    *,
    fusion: Fusion = "product",
    predicted: Floats | None = None,
) -> PlanBound:
    """Bound the errors of the control `u` (see `Plan.bound`).

    `predicted` holds the predicted states of a control over several steps; None for one step.
    """
    key = as_key(rng).child("simulated bound")
    errors = plan_errors(basis, None if predicted is None else len(u), fusion)
    fitted = any(entity.kind == "fitted" for entity in basis.entities)
    names = ("exact error",) * 2
    if all(entity.kind == "exact" for entity in basis.entities):
        radii: tuple[float, ...] | None = errors.rounded((0.0, 0.0))
    elif not errors.random:
        wrong = u.ravel() - errors.best.u
        radii = errors.rounded((norm(errors.best.factors.B @ wrong), norm(wrong)))
    else:
        names = ("simulated",) * 2
        radii = _simulation.radii(errors, delta, key)
    if radii is None:
        radii, names = _formulas(basis, u, errors, delta, fusion, predicted)
    if not np.isfinite(radii).all():
        raise NonFiniteError("the bound overflows: scale the problem down")
    state, control = radii
    return PlanBound(
        state=state,
        control=control,
        target=float(np.hypot(state, norm(errors.best.missed))) + errors.best.state_rounding,
        delta=delta,
        state_bound=names[0],
        control_bound=names[1],
        relative_to="targets" if fitted else "laws",
        certain=not errors.random,
    )


def plan_errors(basis: Basis, steps: int | None, fusion: Fusion) -> PlanErrors:
    """The law of the errors of a plan whose entities are all known.

    Fits are what they are: only averages of realizations are random.
    """
    entities = []
    for entity in basis.entities:
        assert entity.values is not None
        if entity.kind == "iid" or entity.kind == "systematic":
            entities.append(Entity(entity.values, None, entity.size, entity.kind))
        else:
            fitted = entity.kind == "fitted"
            entities.append(Entity(entity.values, entity.estimate if fitted else None))
    x0, xf, A = entities
    rows = basis.A.axis == "rows"
    if fusion == "diagonal" and basis.A.kind == "systematic" and rows:
        raise InputError(
            "no bound is known for paired systematic realizations of rows: use fusion='product'"
        )
    return PlanErrors(basis.B, x0, xf, A, steps=steps, paired=fusion == "diagonal", rows=rows)


def _formulas(
    basis: Basis,
    u: Floats,
    errors: PlanErrors,
    delta: float,
    fusion: Fusion,
    predicted: Floats | None,
) -> tuple[tuple[float, float], tuple[str, str]]:
    """Bounds of the state and of the control where a simulation would take too many runs."""
    if predicted is not None:
        return _along_trajectory(basis, u, errors, delta, predicted), ("sum of errors",) * 2
    if all(entity.kind in ("exact", "iid") for entity in basis.entities):
        state, control = (_best(basis, quantity, fusion, delta) for quantity in _QUANTITIES)
        return (state.radius, control.radius), (state.bound.name, control.bound.name)
    if fusion == "diagonal":
        raise InputError(
            "no formula bounds paired systematic realizations, which are dependent, and this "
            "`delta` is too small to simulate: use fusion='product'"
        )
    e0, ef, eA = _distances(basis, delta, "Frobenius")
    assert basis.x0.estimate is not None
    assert basis.A.estimate is not None  # product fusion
    radii = bounds.from_errors(
        basis.B, basis.x0.estimate, basis.A.estimate, x0_error=e0, xf_error=ef, A_error=eA
    )
    return radii, ("sum of errors",) * 2


def _along_trajectory(
    basis: Basis, u: Floats, errors: PlanErrors, delta: float, predicted: Floats
) -> tuple[float, float]:
    """``ef + ||A^K|| e0 + eA sum_k ||A^{K-1-k}|| ||xh(k)|| + ||xh(K) - xf_hat||``.

    This bounds ``||x(K) - xf||`` along the predicted states ``xh``; by Pythagoras
    ``||C (u - v)||^2`` is less by the square of what no control reaches.
    """
    assert basis.A.values is not None
    assert basis.xf.estimate is not None
    e0, ef, eA = _distances(basis, delta, "spectral")
    norms = spectral_norms(matrix_powers(basis.A.values, len(u)))
    with np.errstate(over="ignore", invalid="ignore"):
        along = float(norms[-2::-1] @ np.linalg.norm(predicted[:-1], axis=1))
        total = ef + norms[-1] * e0 + eA * along + norm(predicted[-1] - basis.xf.estimate)
        state = float(np.sqrt(max(0.0, total**2 - norm(errors.best.missed) ** 2)))
        # u - v = C^+ C (u - v) + (I - C^+ C) u
        flat = u.ravel()
        C = errors.best.factors
        aside = norm(flat - C.V @ (C.V.T @ flat))
        return errors.rounded(
            (state, float(np.hypot(state / C.s[-1], aside)) if C.s.size else aside)
        )


def _distances(basis: Basis, delta: float, matrix_norm: str) -> tuple[float, float, float]:
    """How far the three estimates are from their exact values, with probability 1 - delta."""
    random = sum(entity.kind == "iid" for entity in basis.entities)
    found = []
    for entity in basis.entities:
        assert entity.values is not None
        matrix = entity.name == "A"
        if entity.kind == "exact":
            found.append(0.0)
        elif entity.kind == "fitted":
            assert entity.estimate is not None
            wrong = entity.estimate - entity.values
            found.append(float(np.linalg.norm(wrong, 2 if matrix else None)))
        elif entity.kind == "systematic":
            sure = bounds.Systematic(entity.values, axis=entity.axis)
            found.append(sure.radius(entity.size, delta))
        else:
            found.append(
                bounds.best(
                    "matrix" if matrix else "vector",
                    entity.values,
                    size=entity.size,
                    delta=delta / random,
                    norm=matrix_norm if matrix else "2",
                    axis=entity.axis,
                ).radius
            )
    e0, ef, eA = found
    return e0, ef, eA


def plan_covariance(basis: Basis, fusion: Fusion) -> Floats:
    """Compute the covariance of a control (see `Plan.covariance`)."""
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
        fusion=fusion,
        axis=basis.A.axis,
        scheme="systematic" if "systematic" in schemes else "iid",
    )


_QUANTITIES: tuple[Literal["state"], Literal["control"]] = ("state", "control")


def _best(
    basis: Basis, quantity: Literal["state", "control"], fusion: Fusion, delta: float
) -> Best:
    return bounds.best(
        quantity,
        basis.B,
        *_values(basis),
        size=_sizes(basis),
        delta=delta,
        fusion=fusion,
        axis=basis.A.axis,
    )


def _values(basis: Basis) -> tuple[Floats, Floats, Floats]:
    values = [entity.values for entity in basis.entities if entity.values is not None]
    x0, xf, A = values
    return x0, xf, A


def _sizes(basis: Basis) -> tuple[int | None, int | None, int | None]:
    N0, Nf, NA = (None if e.kind == "exact" else e.size for e in basis.entities)
    return N0, Nf, NA


# -- what the user adds ------------------------------------------------------------------------


def completed(
    basis: Basis | None,
    system: System | None,
    x0: ArrayLike | None,
    xf: ArrayLike | None,
    what: str,
) -> Basis:
    """The basis of a plan with the declared laws in place of unknown ones."""
    if basis is None:
        raise InputError(
            f"this plan was not made by `control` or `control_steps`: it has no {what}"
        )
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
        if entity.key is None:
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
    if entity.kind == "fitted":
        raise InputError(
            f"`{argument}` must not be given: `{entity.name}` is a fit, bounded by its own error"
        )
    if entity.values is None or not np.array_equal(values, entity.values):
        raise InputError(f"`{label}` differs from what this plan knows of `{entity.name}`")
    return entity


def _possible(estimate: Floats, values: Floats, axis: Axis) -> bool:
    """Say whether an average of singletons drawn from `values` can be `estimate`."""
    along = 0 if values.ndim == 1 or axis == "columns" else 1
    found, wanted = np.abs(estimate).sum(axis=along), np.abs(values).sum(axis=along)
    signs = (estimate == 0.0) | (np.sign(estimate) == np.sign(values))
    return bool(signs.all() and (np.abs(found - wanted) <= 1e-9 * wanted).all())
