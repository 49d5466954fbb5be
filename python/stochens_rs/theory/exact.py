"""The best control of an exact system over K steps, and which states it can reach."""

from __future__ import annotations

from dataclasses import fields
from math import inf
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.records import Record, trusted
from .._base.types import Floats
from ..exceptions import NonFiniteError
from ..system.system import System

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


class Reachability(Record, eq=True):
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
        """Whether the target is within reach; None if undecided."""
        return None if self.verdict == "undecided" else self.verdict == "reachable"

    @property
    def text(self) -> str:
        """The verdict in words."""
        if self.verdict == "reachable":
            # a relative residual above 1.5e-8 is rounding of xf - A x0
            sure = self.relative * self.relative <= EPS
            return "reachable" if sure else "reachable up to rounding"
        share = f"{100 * self.relative:.3g} %"
        if self.verdict == "not reachable":
            return f"out of reach {share}"
        low = f"{self.lower:.2g}" + (f" (for controls up to {self.size:.1g})" * (self.size < inf))
        return f"undecided whether reachable: {self.upper:.2g} ({share}) away, {low} at least"


class PlanError(Record, eq=True):
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


Finite = TypeVar("Finite", float, Floats)
REACHABLE = EPS**0.5  # 1.5e-8: relative residuals up to here, half of the digits, count as 0


def checked_ends(system: object, x0: object, xf: object) -> tuple[System, Floats, Floats]:
    """Check a system, its initial state and its target."""
    checked = System.from_any(system)
    how: Any = {"length": checked.n, "labels": checked.state_names}
    return checked, validation.vector("x0", x0, **how), validation.vector("xf", xf, **how)


def checked_motion(system: object, x0: object, u: object) -> tuple[System, Floats, Floats]:
    """Check a system, its initial state and its inputs."""
    checked = System.from_any(system)
    start = validation.vector("x0", x0, length=checked.n, labels=checked.state_names)
    return checked, start, validation.inputs("u", u, cols=checked.m, labels=checked.input_names)


def checked_steps(steps: object, n: int, m: int) -> int:
    """Check the number of steps against the memory that C_K and the powers of A take."""
    K = validation.size("steps", steps)
    # C_K with the work space of its factors, the powers of A with that of their norms, the states
    # and the control
    running.need(f"a control over {K} steps", (8 * n * m + 3 * n * n + n + m) * K * 8)
    return K


def checked_finite(values: Finite, what: str = "covariance") -> Finite:
    """Refuse values that overflowed."""
    if not np.isfinite(values).all():
        raise NonFiniteError(f"the {what} overflows: scale the problem down")
    return values


def matrix_powers(A: Floats, K: int, name: str = "A") -> Floats:
    """``[I, A, ..., A^K]``, (K + 1, n, n)."""
    powers = np.empty((K + 1, *A.shape))
    powers[0], powers[1:2] = np.eye(len(A)), A
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(1, K):
            powers[k + 1] = powers[k] @ A
            if not np.isfinite(powers[k + 1]).all():
                raise NonFiniteError(f"`{name}` to the power {k + 1} overflows: take fewer steps")
    return powers


def controllability(powers: Floats, B: Floats) -> Floats:
    """``C_K = [B, A B, ..., A^{K-1} B]``, (n, m K), from ``[I, A, ..., A^{K-1}]``.

    Its blocks meet u(K-1), ..., u(0).
    """
    blocks = np.empty((len(powers), *B.shape))
    blocks[0] = B
    with np.errstate(over="ignore", invalid="ignore"):
        np.matmul(powers[1:], B, out=blocks[1:])
    if not np.isfinite(blocks).all():
        raise NonFiniteError("`A` to a power times `B` overflows: take fewer steps")
    return np.ascontiguousarray(blocks.transpose(1, 0, 2).reshape(len(B), -1))


def controllability_matrix(system: System | Any, steps: int) -> Floats:
    """The controllability matrix ``C_K = [B, A B, ..., A^{K-1} B]``.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``.
    steps : int
        Number of steps K, at least 1.

    Returns
    -------
    (n, K m) array
        ``x(K) = A^K x(0) + C_K [u(K-1); ...; u(0)]``: columns ``k m`` to ``(k + 1) m`` are
        ``A^k B``, the effect of u(K - 1 - k) on x(K).

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or a power of A overflows.
    ResourceError
        The matrix, or the powers of A, do not fit into memory.

    Notes
    -----
    (The product printed in the paper has K + 1 factors, one too many.) The range of ``C_K`` grows
    with K up to ``K = n``. As ``xf - A^K x0``, which must lie in it, depends on K, a target within
    reach in K steps may be out of reach in more.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.theory.controllability_matrix(([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]]), 3)
    array([[0., 1., 2.],
           [1., 1., 1.]])
    """
    checked = System.from_any(system)
    K = checked_steps(steps, checked.n, checked.m)
    return controllability(matrix_powers(checked.A, K - 1), checked.B)


def gramian(system: System | Any, steps: int) -> Floats:
    """The reachability Gramian of K steps, ``W = sum_{k<K} A^k B B^T (A^k)^T = C_K C_K^T``.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``.
    steps : int
        Number of steps K, at least 1.

    Returns
    -------
    (n, n) array
        Symmetric and positive semidefinite; ``d^T W+ d`` is the least energy ``sum_k ||u(k)||^2``
        that moves the state by d.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or the Gramian overflows.
    ResourceError
        The controllability matrix, or the powers of A, do not fit into memory.

    Examples
    --------
    >>> import stochens_rs as se
    >>> se.theory.gramian(([[1.0, 1.0], [0.0, 1.0]], [[0.0], [1.0]]), 3)
    array([[5., 3.],
           [3., 3.]])
    """
    C = controllability_matrix(system, steps)
    with np.errstate(over="ignore", invalid="ignore"):
        return checked_finite(C @ C.T, "Gramian")


def states(A: Floats, B: Floats, x0: Floats, u: Floats) -> Floats:
    """``x(k+1) = A x(k) + B u(k)`` from ``x(0) = x0``, (K + 1, n)."""
    x = np.empty((len(u) + 1, x0.size))
    x[0] = x0
    with np.errstate(over="ignore", invalid="ignore"):
        for k, u_k in enumerate(u):
            x[k + 1] = A @ x[k] + B @ u_k
    if not np.isfinite(x).all():
        k = int(np.argwhere(~np.isfinite(x))[0, 0])
        raise NonFiniteError(f"the state overflows at step {k}: scale it down, or take fewer")
    return x


def factors(B: Floats) -> _core.Factors:
    """Factor a matrix, ``B = U diag(s) V^T``; the work space is checked against memory."""
    running.need("the pseudoinverse of B", 8 * B.nbytes)  # factors, inverse and work space
    return _core.Factors(np.ascontiguousarray(B))


class Best(_core.Best):
    """The best control of exact data: `_core.Best`, with the system and its records.

    `u` is in the order of time, (m K,). `off` bounds how far the factors of ``C_K`` can be from the
    exact matrix, `unsure` the rounding of ``xf - A^K x0`` in doubles; `gap` is a lower bound of the
    least singular value of the exact matrix that is not 0, inf for rank 0. `control_rounding` and
    `state_rounding` bound ``||v - v*||`` and ``||C_K (v - v*)||`` for the exact control v*.
    """

    def __init__(
        self, A: Floats, B: Floats, x0: Floats, xf: Floats, steps: int, free: Floats | None = None
    ) -> None:
        self.A, self.B, self.steps = A, B, steps

    def reachability(self) -> Reachability:
        """The part of the target that no control reaches, with bounds."""
        return trusted(Reachability, *self.reach())

    def error(self, u: Floats, x0: Floats) -> PlanError:
        """Compare another control, in the order of time, with this one."""
        of_control, of_state, residual = self.beside(np.ascontiguousarray(u), x0)
        control, control_to, size, control_rounding = of_control
        state, state_to, length, state_rounding = of_state
        shares = control, relative(control, size), state, relative(state, length)
        return PlanError(*shares, residual, control_rounding, state_rounding, control_to, state_to)


def relative(value: float, size: float) -> float:
    """A share of a size; inf of nothing."""
    return value / size if size else np.inf if value else 0.0


def best(B: Floats, free: Floats, needed: Floats) -> Best:
    """Solve ``B v = needed`` for the control that adds `needed` to `free` in one step."""
    return Best(np.zeros((len(B), len(B))), B, np.zeros(len(B)), needed, 1, free)


def best_control(
    A: Floats, B: Floats, x0: Floats, xf: Floats, steps: int = 1, name: str = "A"
) -> Best:
    """Solve ``A^K x0 + C_K v = xf``; `name` is that of `A` in messages."""
    running.need("the pseudoinverse of B", 64 * B.size * steps)
    A, B, x0, xf = (np.ascontiguousarray(values) for values in (A, B, x0, xf))
    try:
        return Best(A, B, x0, xf, steps)
    except NonFiniteError:
        matrix_powers(A, steps, name)  # names a power that overflows
        raise
