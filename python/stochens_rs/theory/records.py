"""The records `Reachability` and `PlanError`."""

from __future__ import annotations

from dataclasses import dataclass

from .._base import html
from .._base.records import Record

# The vectors that errors are relative to, by their names in `PlanError`.
RELATIVE_TO = {
    "x_actual": "the state that the exact control leads to",
    "x0": "x0, as the exact control leads to the origin",
    "v": "the exact control",
    "B^+ A x0": "the control that takes x0 to the origin, as the exact one is zero",
}


@dataclass(frozen=True)
class Reachability(Record):
    """Whether a control over K steps can reach the (estimated) target.

    ``C_K = [B, A B, ..., A^{K-1} B]``; one step: ``C_1 = B``.

    Attributes
    ----------
    residual : float
        ``||(I - C_K C_K^+)(xf - A^K x0)||``: the distance to the target that no control can remove.
    relative : float
        `residual` over ``||xf - A^K x0||``; 0 if that is 0.
    rank : int
        Rank of ``C_K``: singular values up to ``eta sigma_max``, ``eta = max(n, m K) eps``, count
        as 0.
    condition : float
        Largest over smallest singular value of ``C_K`` above the rank cut-off.
    reachable : bool
        Whether `relative` is at most 1.5e-8, the square root of the rounding unit ``eps``, or
        `residual` at most `rounding`.
    rounding : float
        The largest `residual` that rounding can cause for a target within reach,
        ``(n + 1) eps || |A| |x0| + |xf| || + theta ||B|| ||u||`` with the control u for it and
        ``theta = (2 max(n, m) + 4) eps``. A smaller `residual` has no meaning. (Over several steps
        it includes the rounding of ``A^K x0`` and ``C_K``. For fusion="diagonal" the averages count
        as exact.)
    """

    residual: float
    relative: float
    rank: int
    condition: float
    reachable: bool
    rounding: float

    def _repr_html_(self) -> str:
        return html.record(self)


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

    Rounding without limits: the factors of B are exact for a matrix ``B + E``,
    ``||E|| <= theta ||B||``, ``theta = (2 max(n, m) + 4) eps`` (LAPACK Users' Guide, 4.9, and
    measured); ``xf - A x0`` is off by ``rho = (n + 1) eps || |A| |x0| + |xf| ||`` at most. To first
    order in ``theta condition(B)`` (Wedin, BIT 13 (1973) 217-232), with r the residual,
    ``g = sigma_min(B) - theta ||B||``, ``t = theta ||B|| ||r|| / g``, ``eta = max(n, m) eps``, and
    B of the rank that the rule of `Reachability` finds:

    - `control_rounding` = ``(rho + 2 theta ||B|| ||v|| + t) / g + eps (||u - v|| + ||v||)``;
    - `state_rounding` = ``rho + theta ||B|| ||v|| + t + eta ||B||_F (||v|| + ||u - v||)``.

    Over several steps ``C_K`` and ``A^K x0`` take the places of B and ``A x0``; their rounding
    errors are added to ``theta ||B||`` and ``rho``.
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
        return html.card(self, rows)


def _share(value: float, relative: float, relative_to: str) -> str:
    words = RELATIVE_TO.get(relative_to)
    share = "" if words is None else f" ({100 * relative:.3g} % of the norm of {words})"
    return f"{value:.4g}{share}"
