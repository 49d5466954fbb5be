"""A study of one command for a fleet: its misses on units that had no part in the design."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._base import validation
from .._base.records import Record
from .._base.signal_names import default_labels
from .._base.types import Floats
from ..controls.constraints import sides, weight
from ..controls.fleet import control_fleet
from ..controls.fleet_plan import RISKS, Risk
from ..controls.fleet_units import Units, read_systems, read_units
from ..ensembles import SystemEnsemble
from ..exceptions import InputError
from ..rng import Key
from ..system import System
from .ready_runs import changed
from .units import PURE


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
    limits: Any = None,
    Q: Any = None,
    R: Any = None,
) -> Fleet:
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
    limits, Q, R
        As in `control_fleet`.

    Returns
    -------
    Fleet
        ``function(key, size, steps, risk, beta)``, for a grid of any of these.

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
    read_units(law, validation.vector("x0", x0), xf, steps, Q)
    sides(
        "limits",
        limits,
        validation.size("steps", steps),
        law.labels or default_labels(law.n, law.m),
    )
    if R is not None:
        weight("R", R, law.m)
    return Fleet(
        law=law,
        x0=validation.vector("x0", x0, length=law.n).copy(),
        xf=validation.vector("xf", xf, length=law.n).copy(),
        steps=steps,
        spread=None if spread is None else validation.nonnegative("spread", spread),
        size=size,
        held_out=validation.size("held_out", held_out),
        risk=risk,
        beta=beta,
        limits=limits,
        Q=Q,
        R=R,
    )


@dataclass(frozen=True, eq=False)
class Fleet(Record, listed=False):
    """One command for units that are drawn, and what becomes of others.

    Calling it with a key, and `size`, `steps`, `risk` or `beta` in place of those here, returns the
    "value" that was minimised; "miss", "miss90" and "miss_most", the median, the 90 % quantile and
    the largest miss over the law; "epsilon", the certified share of the law that misses more than
    the units of the design; "share", how many do; "held", whether that is at most epsilon (0 or 1).

    For a nominal system misses and share are estimates from fresh units: a share near epsilon can
    be larger by chance.

    Attributes
    ----------
    law : SystemEnsemble
        The units that are drawn from, or the nominal one.
    x0, xf, steps, spread, size, held_out, risk, beta, limits, Q, R
        As in `fleet`.
    """

    law: SystemEnsemble
    x0: Floats
    xf: Floats
    steps: int
    spread: float | None
    size: int
    held_out: int
    risk: Risk
    beta: float
    limits: Any
    Q: Any
    R: Any

    def __post_init__(self) -> None:
        validation.size("size", self.size)
        validation.size("steps", self.steps)
        validation.choice("risk", self.risk, RISKS)
        validation.probability("beta", self.beta)

    @property
    def units(self) -> dict[str, str]:
        """Of its numbers."""
        return dict.fromkeys(("epsilon", "share", "held", "size", "steps", "beta"), PURE)

    def __call__(
        self,
        key: Key,
        size: int | None = None,
        steps: int | None = None,
        risk: Risk | None = None,
        beta: float | None = None,
    ) -> dict[str, float]:
        """Return the numbers of one replicate."""
        now = changed(self, size=size, steps=steps, risk=risk, beta=beta)
        ends = self.x0, self.xf
        plan = control_fleet(
            self._drawn(key.child("design"), now.size),
            *ends,
            now.steps,
            limits=self.limits,
            Q=self.Q,
            R=self.R,
            risk=now.risk,
        )
        if now.risk == "worst":
            certified = plan.certify(now.beta)
        else:  # no bound of a mean follows from its own units
            certified = plan.validate(self._drawn(key.child("more"), now.size), now.beta)
        law = self.law
        if self.spread is not None:
            law = self._drawn(key.child("fresh"), self.held_out)
        units = Units(law, plan.units.x0, plan.units.xf, plan.units.Q, now.steps)
        misses = units.misses(plan.u)
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

    def _drawn(self, key: Key, count: int) -> SystemEnsemble:
        """Units of the law."""
        gen, law = key.generator(), self.law
        if self.spread is None:
            s = gen.integers(0, law.size, count)
            return replace(law, A=law.A[s], B=law.B[s], c=None if law.c is None else law.c[s])
        draw, scale = gen.standard_normal, self.spread
        A, B = (M * (1.0 + scale * draw((count, *M.shape[1:]))) for M in (law.A, law.B))
        return SystemEnsemble(A, B, labels=law.labels)
