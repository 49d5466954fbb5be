"""A study of one command for a fleet: its misses on units that had no part in the design."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..._base import validation
from ..._base.signal_names import default_labels
from ..._base.types import Floats
from ..._base.weights import weight
from ...controls.constraints import sides
from ...controls.cost import Cost, as_cost
from ...controls.fleet import control_fleet
from ...controls.fleet_plan import RISKS, Risk
from ...controls.fleet_units import Units, read_systems, read_units
from ...controls.limits import LimitsLike, as_limits
from ...ensembles import SystemEnsemble
from ...exceptions import InputError
from ...rng import Key
from ...system import System
from .template import Template, template


def fleet(
    units: Any,
    x0: ArrayLike,
    xf: ArrayLike,
    steps: int,
    *,
    spread: float | None = None,
    size: int = 100,
    held_out: int = 1000,
    risk: Risk = "worst",
    beta: float = 1e-3,
    limits: LimitsLike = None,
    cost: Cost | None = None,
) -> Template:
    """Return the function of a study of one command for a fleet, against the units it is made for.

    Parameters
    ----------
    units : SystemEnsemble, sequence of System, System or (A, B)
        The law of a unit: each unit of the ensemble is as likely, and drawn with replacement; or
        the entries of one nominal system, each with a Gaussian factor of mean 1.
    x0, xf : array_like, shape (n,)
        Initial state and target of all units.
    steps : int
        Number of steps K.
    spread : float, optional
        For a nominal system: the standard deviation of the factors.
    size : int, default 100
        Number of units for the design.
    held_out : int, default 1000
        For a nominal system: number of fresh units that tell the misses. Of an ensemble all units
        do, exactly.
    risk : {"mean", "worst"}, default "worst"
        As in `control_fleet`.
    beta : float, default 1e-3
        Probability that the certificate fails: `FleetPlan.certify`; for the mean
        `FleetPlan.validate` on `size` more units.
    limits, cost
        As in `control_fleet`.

    Returns
    -------
    Template
        ``function(key, size, steps, risk, beta)``, for a grid of any of these. It returns the
        "value" that was minimised; "miss", "miss90" and "miss_most", the median, the 90 % quantile
        and the largest miss over the law; "epsilon", the certified share of the law that misses
        more than the units of the design; "share", how many do; "held", whether that is at most
        epsilon (0 or 1). For a nominal system misses and share are estimates from fresh units: a
        share near epsilon can be larger by chance.

    Raises
    ------
    InputError, InputTypeError
        If the arguments do not fit together.

    Examples
    --------
    >>> import stochens_rs as se
    >>> cart = ([[1.0, 0.1], [0.0, 0.95]], [[0.0], [0.1]])
    >>> function = se.studies.fleet(cart, [0, 0], [1, 0], 20, spread=0.02, limits=(-2, 2))
    >>> results = se.Study(function, {"size": [50, 200]}, replicates=5, rng=1).run()
    >>> results.values["held"].mean(axis=1)
    array([1., 1.])
    """
    nominal = isinstance(units, (System, tuple)) or not hasattr(units, "__len__")
    if nominal != (spread is not None):
        raise InputError("`spread` must be given for one nominal system, and only there")
    law = SystemEnsemble.from_systems([units]) if nominal else read_systems(units)
    within, weights = as_limits(limits).only("u"), as_cost(cost).only("Qf", "R")
    K, labels = validation.size("steps", steps), law.labels or default_labels(law.n, law.m)
    ends = {"x0": x0, "xf": xf}
    start, goal = (
        validation.vector(name, end, length=law.n, labels=labels.states)
        for name, end in ends.items()
    )
    read_units(law, start, goal, K, weights.Qf)
    sides("limits", within.u, K, labels)
    if weights.R is not None:
        weight("R", weights.R, law.m)
    return template(
        _numbers,
        ("size", "steps", "risk", "beta"),
        ("epsilon", "share", "held", "size", "steps", "beta"),
        {},
        law=law,
        x0=start,
        xf=goal,
        steps=K,
        spread=None if spread is None else validation.nonnegative("spread", spread),
        size=validation.size("size", size),
        held_out=validation.size("held_out", held_out),
        risk=validation.choice("risk", risk, RISKS),
        beta=validation.probability("beta", beta),
        limits=within,
        cost=weights,
    )


def _numbers(
    key: Key,
    *,
    law: SystemEnsemble,
    x0: Floats,
    xf: Floats,
    steps: int,
    spread: float | None,
    size: int,
    held_out: int,
    risk: Risk,
    beta: float,
    **how: Any,
) -> dict[str, float]:
    count = validation.size("size", size)
    design = drawn_units(law, spread, key.child("design"), count)
    plan = control_fleet(design, x0, xf, steps, risk=risk, **how)
    if risk == "worst":
        certified = plan.certify(beta)
    else:  # no bound of a mean follows from its own units
        certified = plan.validate(drawn_units(law, spread, key.child("more"), count), beta)
    if spread is not None:
        law = drawn_units(law, spread, key.child("fresh"), held_out)
    misses = Units(law, plan.units.x0, plan.units.xf, plan.units.Q, steps).misses(plan.u)
    share = float(np.mean(misses > certified.threshold))
    return {
        "value": plan.value,
        "miss": float(np.median(misses)),
        "miss90": float(np.quantile(misses, 0.9)),
        "miss_most": float(misses.max()),
        "epsilon": certified.epsilon,
        "share": share,
        "held": float(share <= certified.epsilon),
    }


def drawn_units(law: SystemEnsemble, spread: float | None, key: Key, count: int) -> SystemEnsemble:
    """Units of the law; with `spread` of the nominal one."""
    gen = key.generator()
    if spread is None:
        s = gen.integers(0, law.size, count)
        return replace(law, A=law.A[s], B=law.B[s], c=None if law.c is None else law.c[s])
    A, B = (M * (1.0 + spread * gen.standard_normal((count, *M.shape[1:]))) for M in (law.A, law.B))
    return SystemEnsemble(A, B, labels=law.labels)
