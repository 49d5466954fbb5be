"""What a plan keeps about its arguments for its bound and its covariance.

`Known` is what is known about one of x0, xf and A: its estimate, the exact values behind it where
they are known, and how many realizations were drawn how. `Basis` is B with the three of them. Both
hold arrays of the size of the problem, never the realizations.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from .._base import validation
from .._base.names import Labels
from .._base.records import Count, Dense, Record, require_shapes, trusted
from .._base.types import Axis, Floats
from ..certificates.of_model import ModelBasis
from ..ensembles.ensemble import Counts, Ensemble
from ..exceptions import InputError
from ..rng import Key
from ..system.system import System, in_order
from .fits import Fit

Kind: TypeAlias = Literal["exact", "iid", "systematic", "fitted", "unknown", "estimate"]

# Up to this relative difference the 1-norms of an average of singletons and of its law count as
# equal: far above the rounding of pairwise sums, far below what another law makes of them.
_SAME_NORM = 1e-9
# The fields that must be known, by kind.
_REQUIRED: dict[Kind, tuple[str, ...]] = {
    "exact": ("values",),
    "iid": ("values", "size"),
    "systematic": ("values", "size"),
    "fitted": ("values", "estimate"),
}


class Known(Record):
    """What is known about x0, xf or A: the estimate, and the exact values it stands for.

    Attributes
    ----------
    name : str
        "x0", "xf" or "A".
    kind : str
        "iid", "systematic": the average of `size` realizations that `sample` drew from `values`.
        "exact": `values` itself. "fitted": fitted to `values`, the target. "unknown": the average
        of `size` realizations that the user brought. "estimate": the same, where these are known to
        scatter about an estimate from data.
    estimate : ndarray, shape (n,) or (n, n), or None
        What the control was computed from; None if it is not kept: A, for diagonal fusion.
    values : ndarray, shape (n,) or (n, n), or None
        The exact values that `kind` names; None if they are unknown.
    size : int or None
        Number of realizations.
    axis : str
        "columns" or "rows": which lines of a matrix were drawn independently.
    key : Key or None
        The key of the draw.
    """

    name: str
    kind: Kind
    estimate: Dense | None
    values: Dense | None = None
    size: Count | None = None
    axis: Axis = "columns"
    key: Key | None = None

    def _check(self) -> None:
        for field in _REQUIRED.get(self.kind, ()):
            if getattr(self, field) is None:
                raise InputError(f"`{field} of {self.name}` must be known for kind '{self.kind}'")


class Basis(Record):
    """What is known about x0, xf and A.

    Attributes
    ----------
    B : ndarray, shape (n, m)
        The input matrix.
    x0, xf, A : Known
        What is known about x0, xf and A.
    rounding : tuple of float, default (0, 0)
        How far the control u, in doubles, can be from the exact one of the estimates, v:
        ``||C_K (u - v)||`` for their ``C_K``, and ``||u - v||``.
    """

    B: Annotated[Floats, "state input"]
    x0: Known
    xf: Known
    A: Known
    rounding: tuple[float, float] = (0.0, 0.0)

    def _check(self) -> None:
        if not min(self.rounding) >= 0.0:
            raise InputError(f"`rounding` must be two numbers >= 0, got {self.rounding}")
        n = len(self.B)
        for name, shape in (("x0", (n,)), ("xf", (n,)), ("A", (n, n))):
            one = getattr(self, name)
            if one.name != name:
                raise InputError(f"`{name}` must be what is known of {name}, got {one.name!r:.40}")
            require_shapes(one, estimate=shape, values=shape)

    @property
    def entities(self) -> tuple[Known, Known, Known]:
        """In the order of the sizes ``(N0, Nf, NA)``."""
        return self.x0, self.xf, self.A

    @property
    def values(self) -> tuple[Floats, Floats, Floats]:
        """The exact values of x0, xf and A; all three must be known, as `completed` makes sure."""
        x0, xf, A = (entity.values for entity in self.entities if entity.values is not None)
        return x0, xf, A

    @property
    def estimates(self) -> tuple[Floats, Floats, Floats]:
        """The estimates of x0, xf and A, as product fusion has them."""
        x0, xf, A = (entity.estimate for entity in self.entities if entity.estimate is not None)
        return x0, xf, A

    @property
    def sizes(self) -> tuple[int | None, int | None, int | None]:
        """Numbers of realizations ``(N0, Nf, NA)``; None for what is exact."""
        N0, Nf, NA = (None if e.kind == "exact" else e.size for e in self.entities)
        return N0, Nf, NA


def known(name: str, value: Fit | Ensemble | Counts | Floats, estimate: Floats | None) -> Known:
    """Collect what is known about an argument of `control`; `estimate` is what it used."""
    if isinstance(value, Ensemble | Counts):
        return _drawn(name, value, estimate)
    if isinstance(value, Fit):
        if value.method == "uniform" and value.ensemble is not None:
            drawn = _drawn(name, value.ensemble, estimate)
            if drawn.kind != "unknown" or value.target is None:
                return drawn
        if value.target is not None:
            key = None if value.ensemble is None else value.ensemble.key
            return trusted(Known, name, "fitted", value.estimate, value.target, key=key)
        size = None if value.method in ("weighted", "precision") else len(value.weights)
        return trusted(Known, name, "unknown", value.estimate, size=size)
    return trusted(Known, name, "exact", estimate, value)


def _drawn(name: str, value: Ensemble | Counts, estimate: Floats | None) -> Known:
    law = value.law
    if law is not None:
        return trusted(
            Known, name, law.scheme, estimate, law.values, value.size, law.axis, value.key
        )
    if isinstance(value, Counts):
        return trusted(Known, name, "unknown", value.estimate, size=value.size)
    mean = value.mean() if estimate is None else estimate
    kind: Kind = "estimate" if value.centre == "estimate" else "unknown"
    return trusted(Known, name, kind, mean, size=value.size, axis=value.axis)


def completed(basis: Any, declared: tuple[Any, ...], what: str, labels: Labels | None) -> Basis:
    """The basis of a plan, in which the given exact values complete the unknown laws."""
    system, x0, xf = declared
    if basis is None:
        raise InputError(f"this plan was not made by `control`: it has no {what}")
    if isinstance(basis, ModelBasis):
        raise InputError(f"no {what} over draws is known for a model from data: use plan.bound()")
    n = len(basis.B)
    names = None if labels is None else labels.states
    values: dict[str, Floats] = {
        name: validation.vector(name, value, length=n, labels=names)
        for name, value in (("x0", x0), ("xf", xf))
        if value is not None
    }
    if system is not None:
        checked = System.from_any(system)
        checked = in_order("system", checked, labels)
        if not np.array_equal(checked.B, basis.B):
            raise InputError("`system.B` differs from the `B` of this plan")
        values["A"] = np.asarray(checked.A)
    entities = [_declare(one, values.get(one.name), what) for one in basis.entities]
    for one, other in itertools.combinations(entities, 2):
        if one.key is not None and one.key == other.key:
            raise InputError(f"`{one.name}` and `{other.name}` have one key: use key.child(name)")
    x0_known, xf_known, A_known = entities
    return trusted(Basis, basis.B, x0_known, xf_known, A_known, basis.rounding)


def _declare(entity: Known, values: Floats | None, what: str) -> Known:
    """Replace an unknown law by the declared one; refuse values that contradict the plan."""
    label = "system.A" if entity.name == "A" else entity.name
    argument = "system" if entity.name == "A" else entity.name
    if entity.kind == "estimate":
        raise InputError(
            f"the realizations of `{entity.name}` scatter about an estimate from data, not about "
            f"the truth, so no {what} follows from them: use the region of the model"
        )
    if entity.kind == "unknown":
        if values is None:
            raise InputError(
                f"the law of `{entity.name}` is unknown (realizations brought by the user), and "
                f"the {what} depends on it: pass `{argument}=` if they are independent singletons "
                "of a known mean; for other laws see plan.validate(fresh)"
            )
        if entity.size is None:
            raise InputError(f"`{entity.name}` is a fit with its own weights: no {what} is known")
        if why := _refused(entity, values):
            raise InputError(
                f"`{label}` cannot be what the realizations of `{entity.name}` were drawn from as "
                f"singletons, with one nonzero entry in every line: {why}; see plan.validate(fresh)"
            )
        return replace(entity, kind="iid", values=values)
    if values is None:
        return entity
    if entity.kind == "fitted":
        raise InputError(f"`{argument}` must be left out: the fit {entity.name} has its own")
    if entity.values is None or not np.array_equal(values, entity.values):
        raise InputError(f"`{label}` differs from what this plan knows of `{entity.name}`")
    return entity


def _refused(entity: Known, values: Floats) -> str:
    """Why the estimate cannot be an average of singletons drawn from `values`; empty if it can.

    ``size |estimate_ij| / ||values_j||_1`` is how often an entry was drawn, an integer up to
    rounding, which leaves nothing to see of a billion realizations.
    """
    if (estimate := entity.estimate) is None:
        return "their average is not kept"
    along = 0 if values.ndim == 1 or entity.axis == "columns" else 1
    found, wanted = (np.abs(one).sum(axis=along, keepdims=True) for one in (estimate, values))
    signs = (estimate == 0.0) | (np.sign(estimate) == np.sign(values))
    if not signs.all() or not (np.abs(found - wanted) <= _SAME_NORM * wanted).all():
        return "their average has other signs, zeros or 1-norms"
    size, norms = entity.size or 0, np.broadcast_to(wanted, values.shape)
    counts = size * np.divide(np.abs(estimate), norms, out=np.zeros(values.shape), where=norms > 0)
    if not (np.abs(counts - np.rint(counts)) <= _SAME_NORM * size).all():
        return "their average is none of such entries"
    return ""
