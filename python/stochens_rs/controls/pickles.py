"""Pickles of plans: made again by their constructors, and what they know of entities checked.

A pickle may come from anywhere; what is wrong with it is said when it is loaded, not later by a
bound that means nothing.
"""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

from .._base import gate
from ..rng import Key

if TYPE_CHECKING:
    from .plan import Plan
    from .trajectory_plan import TrajectoryPlan

_KINDS = ("exact", "iid", "systematic", "fitted", "unknown")


def reduced(plan: Plan | TrajectoryPlan) -> tuple[Any, ...]:
    """What `pickle` and `copy` store of a plan."""
    values = {field.name: getattr(plan, field.name) for field in fields(plan) if field.init}
    return _remade, (type(plan), values, plan._basis)


def _remade(kind: type[Any], values: dict[str, Any], basis: object) -> Any:
    plan = kind(**values)
    if basis is not None:
        object.__setattr__(plan, "_basis", _checked(basis))
    return plan


def _checked(basis: object) -> object:
    from .plan_bound import Basis, Known

    found = gate.instance("_basis", basis, Basis)
    n = len(gate.kept("B", found.B, ndim=(2,)))
    for name, shape in (("x0", (n,)), ("xf", (n,)), ("A", (n, n))):
        entity = gate.instance(name, getattr(found, name), Known)
        gate.choice("kind", entity.kind, _KINDS)
        gate.choice("axis", entity.axis, ("columns", "rows"))
        for what in ("estimate", "values"):
            array = getattr(entity, what)
            if array is not None:
                gate.kept(f"{what} of {name}", array, shape=shape)
        if entity.size is not None:
            gate.size("size", entity.size)
        if entity.key is not None:
            gate.instance("key", entity.key, Key)
    return found
