"""The records `Reachability` and `PlanError`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import inf
from typing import Literal, TypeAlias

import numpy as np

from .._base import show
from .._base.records import Record

EPS = float(np.finfo(np.float64).eps)

Verdict: TypeAlias = Literal["reachable", "not reachable", "undecided"]

# The vectors that errors are relative to, by their names in `PlanError`.
RELATIVE_TO = {
    "x_actual": "the state that the exact control leads to",
    "x0": "x0, as the exact control leads to the origin",
    "v": "the exact control",
    "B^+ A x0": "the control that takes x0 to the origin, as the exact one is zero",
}
_FAR = 1e3  # errors so many times as large as what they are relative to are not printed as shares


@dataclass(frozen=True)
class Reachability(Record):
    """Whether a control over K steps can reach the (estimated) target.

    ``C_K = [B, A B, ..., A^{K-1} B]``; one step: ``C_1 = B``.

    Attributes
    ----------
    verdict : {"reachable", "not reachable", "undecided"}
        "reachable": `upper` is at most 1.5e-8 (the square root of ``eps = 2.2e-16``) of
        ``||xf - A^K x0||``, or at most the rounding of ``xf - A^K x0`` in doubles,
        ``(n + 1) eps || |A| |A^{K-1} x0| + |xf| ||``. "not reachable": `lower` is above both, for
        all controls up to ``1e20 ||xf - A^K x0|| / ||C_K||`` at least. "undecided" otherwise:
        `C_K` is so near to a matrix of smaller rank that doubles do not decide.
    residual : float
        ``||(I - C_K C_K^+)(xf - A^K x0)||``: the distance to the target that no control can remove,
        with the rank below.
    relative : float
        `residual` over ``||xf - A^K x0||``; 0 if that is 0.
    lower, upper : float
        The least distance to the target lies between the two: a control reaches `upper`, and none
        up to `size` comes nearer than `lower`. Rounding is included; A, B, x0 and xf count as
        exact. (For fusion="diagonal" the averages count as exact.)
    size : float
        The norm of the controls that `lower` is about; inf: of all controls.
    rank : int
        Rank of ``C_K``: singular values up to ``eta sigma_max``, ``eta = max(n, m K) eps``, count
        as 0.
    condition : float
        Largest over smallest singular value of ``C_K`` above the rank cut-off.
    """

    verdict: Verdict
    residual: float
    relative: float
    lower: float
    upper: float
    size: float
    rank: int
    condition: float

    @property
    def reachable(self) -> bool | None:
        """Whether the target is within reach; None if that is undecided."""
        return None if self.verdict == "undecided" else self.verdict == "reachable"

    @property
    def text(self) -> str:
        """The verdict in a few words."""
        if self.verdict == "reachable":
            # a relative residual above 1.5e-8 is rounding of xf - A x0
            sure = self.relative * self.relative <= EPS
            return "reachable" if sure else "reachable up to rounding"
        share = f"{100 * self.relative:.3g} %"
        if self.verdict == "not reachable":
            return f"out of reach {share}"
        low = f"{self.lower:.2g}" + (f" (for controls up to {self.size:.1g})" * (self.size < inf))
        return f"undecided whether reachable: {self.upper:.2g} ({share}) away, {low} at least"

    def _repr_html_(self) -> str:
        return show.record(self)


@dataclass(frozen=True)
class PlanError(Record):
    """The error of a control for a system that is known exactly.

    ``v = B^+ (xf - A x0)`` is the best control, ``x_actual = A x0 + B v`` the state it leads to.

    Attributes
    ----------
    control : float
        ``||u - v||``.
    control_relative : float
        `control` over the norm of the vector `control_relative_to`.
    state : float
        ``||B (u - v)||``, the distance between the state reached and `x_actual`.
    state_relative : float
        `state` over the norm of the vector `state_relative_to`.
    residual : float
        ``||(I - B B^+)(xf - A x0)||``: by Pythagoras the distance to `xf` is
        ``sqrt(state^2 + residual^2)``.
    control_rounding : float
        The exact ``||u - v||`` differs from `control` by at most this; inf if rounding leaves no
        correct digit of v.
    state_rounding : float
        The same for `state`, and for `residual`.
    control_relative_to : str
        "v"; or "B^+ A x0", the control that takes x0 to the origin, if v is 0 up to rounding; or
        "nothing", if that is 0, too: `control_relative` is then 0 if `control` is 0, inf otherwise.
    state_relative_to : str
        "x_actual"; or "x0", if `x_actual` is 0 up to rounding; or "nothing", as above.
    objective : float or None
        Within limits ``J(u) - J(v)``, J that of the exact system; None without.

    Notes
    -----
    Within limits v is the best control within them, `state` the distance of the last states, and
    `residual` the distance of the last state under v from its target. Pythagoras does not hold,
    the triangle inequality does: ``state + residual``. The two allowances for rounding are then
    those of the solver of v and of the sums; rounding of ``A^k B`` and ``A^k x0`` is not included.

    Rounding without limits: ``f = y - r - C v``, ``g = C^T r`` and ``h = v - C^T w`` are computed
    in twice the precision, for ``y = xf - A^K x0``, ``C = C_K``, the residual r and some w. With s
    at most the least singular value of C above the rank cut-off of `Reachability`,
    ``||v - v*|| <= ||h|| + ||f|| / s + ||g|| / s^2`` and
    ``||C (v - v*)|| <= ||f|| + ||g|| / s`` for the exact control v*; and v is rounded to doubles.
    """

    control: float
    control_relative: float
    state: float
    state_relative: float
    residual: float
    control_rounding: float
    state_rounding: float
    control_relative_to: str
    state_relative_to: str
    objective: float | None = None

    def __repr__(self) -> str:
        shown = {one.name: getattr(self, one.name) for one in fields(self)}
        for name in ("control_relative", "state_relative"):
            if shown[name] > _FAR:
                del shown[name], shown[f"{name}_to"]
        return f"PlanError({', '.join(f'{name}={value!r}' for name, value in shown.items())})"

    def _repr_html_(self) -> str:
        control = _share(self.control, self.control_relative, self.control_relative_to)
        rounding = (
            f"{self.control_rounding:.1g} of the control, {self.state_rounding:.1g} of the state "
            "at most"
        )
        rows = [
            ("control off by", control),
            ("state off by", _share(self.state, self.state_relative, self.state_relative_to)),
            ("out of reach of any control", self.residual),
            ("objective above the least by", self.objective),
            ("rounding", rounding),
        ]
        return show.card(self, rows)


def _share(value: float, relative: float, relative_to: str) -> str:
    words = RELATIVE_TO.get(relative_to)
    if words is None or relative > _FAR:
        return f"{value:.4g}"
    return f"{value:.4g} ({100 * relative:.3g} % of the norm of {words})"
