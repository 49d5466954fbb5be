"""What an uncertain A and B do to the best control within limits.

(G, b) is the true problem, (G^, b^) the model's, with the same limits, Q and R; u is the best of
the true one, w a point within the limits, usually close to the best of the model's. With
``alpha >= ||(G - G^) w - (b - b^)||_Q``, ``c = (G - G^)' Q (G^ w - b^)``, ``gamma >= ||c||_{R^-1}``
and ``gap >= <J^'(w), w - v>`` for all v within the limits, the inequality of the best u, tested at
w, is ``p^2 + q^2 <= alpha p + gamma q + gap / 2`` for ``p = ||G (w - u)||_Q``, ``q = ||w - u||_R``:
a disc. ``J(w) - J(u) = <J'(w), w - u> - p^2 - q^2`` is largest at ``(alpha, gamma)``. Soft limits
of the state add ``soft C'C`` to Q in alpha, and their force to ``Q (G^ w - b^)``.
"""

from __future__ import annotations

from math import hypot, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._base.numbers import ROUNDING
from ..theory.dynamics import matrix_powers, spectral_norms
from .limited import Horizon

if TYPE_CHECKING:
    from collections.abc import Callable

    from .._base.types import Floats
    from .constraints import Task


HARD = "with hard limits of the states the best control may move by any multiple of an error"
SMALL = "the inputs have too little weight for what is known of the system: give a larger R"


class Apart(NamedTuple):
    """How far w is from u: infinite where there is no bound.

    ``||G (w - u)||_Q``, ``||w - u||_R``, ``(state^2 + control^2)^(1/2)``, ``||w - u||_2`` and
    ``J(w) - J(u)``.
    """

    state: float
    weighted: float
    distance: float
    control: float
    excess: float


class Model(NamedTuple):
    """The A and B that a control was computed with, and how far the true ones can be from them.

    `radii` are bounds of ``||A - A^||`` and ``||B - B^||``; `along` gives those of
    ``||(A - A^)' p||`` and ``||(B - B^)' p||``.
    """

    A: Floats
    B: Floats
    radii: tuple[float, float]
    along: Callable[[Floats], tuple[float, float]]


class Forces(NamedTuple):
    """Half of the gradient of J, and what it consists of.

    `forces` (K, n) are ``f_k = Q_k (x(k) - r(k))`` with the soft limits' share, `costates` (K, n)
    ``p_K = f_K``, ``p_k = A'p_(k+1) + f_k``, and `slope` (K, m) is ``B'p_(k+1) + R u(k)``.
    """

    forces: Floats
    costates: Floats
    slope: Floats
    objective: float


def weights(task: Task, *, soft: bool) -> Floats:
    """``Q_1, ..., Q_K`` (K, n, n); with `soft` those that bound the curvature with soft limits."""
    found = np.repeat(task.stage[None], task.steps, axis=0)
    found[-1] = task.terminal
    if soft and task.soft is not None and task.state_low is not None:
        assert task.state_high is not None
        limited = np.isfinite(task.state_low) | np.isfinite(task.state_high)
        found = found + task.soft * limited[:, :, None] * np.eye(found.shape[1])
    return found


def farthest(task: Task, u: Floats) -> float:
    """The largest distance of `u` from a control within the limits of single inputs."""
    return float(np.linalg.norm(np.maximum(task.high - u, u - task.low)))


def forces(task: Task, A: Floats, B: Floats, states: Floats, u: Floats) -> Forces:
    """The forces at the states ``x(1), ..., x(K)`` under `u` (K, m)."""
    assert task.R is not None
    R = task.R
    off = states - task.reference
    found = np.einsum("kij,kj->ki", weights(task, soft=False), off)
    value = float(np.sum(off * found) + np.sum(u * (u @ R)))
    if task.soft is not None and task.state_low is not None:
        assert task.state_high is not None
        over = np.maximum(0.0, states - task.state_high) - np.maximum(0.0, task.state_low - states)
        found, value = found + task.soft * over, value + task.soft * float(np.sum(over**2))
    costates = found.copy()
    for k in range(len(u) - 2, -1, -1):
        costates[k] += A.T @ costates[k + 1]
    return Forces(found, costates, costates @ B + u @ R, value)


def optimality(
    task: Task, model: Model, sizes: Floats, slope: Floats, u: Floats, gap: float
) -> tuple[float, float]:
    """A Frank-Wolfe gap over the limits, and the norm of what of `slope` no limit balances.

    With limits of rates or states: ``<J'(w), w - v> <= 2 max(sqrt(gap) reach, gap)`` for `gap` >=
    J(w) - min J and ``reach >= ||w - v||_H``, from ``J(w + t (v - w)) >= J(w) - gap`` at the
    best t.
    """
    if task.rate is None and (task.state_low is None or task.soft is not None):
        side = np.where(slope > 0.0, task.low, task.high)
        bounded = np.isfinite(side)
        steps = np.where(bounded, u - np.where(bounded, side, 0.0), 0.0)
        found = 2.0 * float(np.sum(np.maximum(slope * steps, 0.0)))
        return found, float(np.linalg.norm(np.where(bounded, 0.0, slope)))
    if gap == 0.0:
        return 0.0, 0.0
    # ||G e_i||_Q of the inputs of step j, from the norms of A^p B
    squares = np.sum((matrix_powers(model.A, len(u))[:-1] @ model.B) ** 2, axis=1)
    columns = [sizes[j:] @ squares[: len(u) - j] for j in range(len(u))]
    R = task.R if task.R is not None else np.zeros((u.shape[1],) * 2)
    reach = float(np.sum((task.high - task.low) * np.sqrt(columns + np.diag(R))))
    return 2.0 * max(np.sqrt(gap) * reach, gap), 0.0


def costate_errors(model: Model, costates: Floats) -> float:
    """A bound of ``||c||_2``: block k of c is ``B'p_(k+1) - B^'p^_(k+1)``.

    ``d_k >= ||p_k - p^_k||``: ``d_K = 0``, ``d_k = (||A^|| + a) d_(k+1) + a(p^_(k+1))``, and
    ``||c_k|| <= (||B^|| + b) d_(k+1) + b(p^_(k+1))``.
    """
    norm_A, norm_B = (float(np.linalg.norm(X, 2)) for X in (model.A, model.B))
    delta, total = 0.0, 0.0
    for p in costates[::-1]:
        along_A, along_B = model.along(p)
        total = hypot(total, product(norm_B + model.radii[1], delta) + along_B)
        delta = product(norm_A + model.radii[0], delta) + along_A
    return total


def map_radius(model: Model, sizes: Floats) -> float:
    """A bound of ``||Q^(1/2) (G - G^)||``, with ``sizes = ||Q_1||, ..., ||Q_K||``.

    ``E_p >= ||A^p - A^^p||``: ``E_(p+1) = (||A^|| + a) E_p + a ||A^^p||``, and
    ``||A^p B - A^^p B^|| <= E_p (||B^|| + b) + ||A^^p|| b``; then the Frobenius norm of the norms
    of the blocks.
    """
    a, b = model.radii
    norms = spectral_norms(matrix_powers(model.A, len(sizes)))
    norm_A, norm_B = norms[1], float(np.linalg.norm(model.B, 2))
    E, blocks = 0.0, []
    for size in norms[:-1]:
        block = product(E, norm_B + b) + product(size, b)
        blocks.append(block * block)
        E = product(norm_A + a, E) + product(size, a)
    shares = np.where(sizes > 0.0, np.cumsum(blocks), 0.0)
    return float(np.sqrt(np.sum(np.where(sizes > 0.0, sizes * shares, 0.0))))


@np.errstate(over="ignore")
def apart(task: Task, model: Model, states: Floats, u: Floats, alpha: float, gap: float) -> Apart:
    """Bound how far the control `u`, under which the model has these states, is from the best.

    `task` with its R; `alpha` is that of the head of this file, `gap` bounds J(u) - min J of the
    model.
    """
    assert task.R is not None
    at = forces(task, model.A, model.B, states, u)
    sizes = np.linalg.norm(weights(task, soft=True), 2, axis=(1, 2))
    gap, unbalanced = optimality(task, model, sizes, at.slope, u, gap)
    c = costate_errors(model, at.costates) + unbalanced
    least_R = max(float(np.linalg.eigvalsh(task.R)[0]), 0.0)
    gamma = _over(c, least_R)
    h, slack = hypot(alpha, gamma), sqrt(2.0 * gap)
    rho = hypot(h, slack)
    # ||v||_H^2 >= least ||v||^2 for the true H, without soft limits
    radius, M = map_radius(model, sizes), Horizon(task, model.A, model.B).condensed
    s = np.linalg.svd(M, compute_uv=False)
    smallest = float(s[-1]) - ROUNDING * float(s[0]) if len(M) >= M.shape[1] else 0.0
    sure = max(smallest - radius, 0.0)
    least = sure * sure + least_R
    e = alpha + _over(c, least)
    small = (e + hypot(e, slack)) / 2.0
    weighted, distance = min((gamma + rho) / 2.0, small), min((h + rho) / 2.0, small)
    # N = J^1/2: N(w) <= N^(w) + alpha, N(u) >= N(w) - sqrt(gap) - 2 alpha - ||G - G^|| ||w - u||
    most = sqrt(at.objective) + alpha
    away = farthest(task, u)
    less = sqrt(gap) + 2.0 * alpha + product(radius, away)
    less = most if unbalanced else min(less, most)
    regret = less * (2.0 * most - less) if np.isfinite(most) else np.inf
    return Apart(
        state=float(min((alpha + rho) / 2.0, small)),
        weighted=float(weighted),
        distance=float(distance),
        control=float(min(_over(weighted, least_R), _over(distance, least))),
        excess=float(min(h * h + gap, e * e + gap, regret)),
    )


def product(a: float, b: float) -> float:
    """``a b``, where 0 times infinity is 0: nothing to bound."""
    return 0.0 if a == 0.0 or b == 0.0 else float(a) * float(b)


def _over(size: float, least: float) -> float:
    """``size / sqrt(least)``, infinite over 0."""
    return 0.0 if size == 0.0 else float(size / np.sqrt(least)) if least > 0.0 else np.inf
