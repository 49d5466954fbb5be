"""A bound on the error of a control within limits, relative to the best one within them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .._base.numbers import ROUNDING, norm
from ..exceptions import InputError
from ..rng import RngLike, as_key
from ..theory.bounds.drawn_errors import not_simulated, radii
from ..theory.dynamics import matrix_powers, spectral_norms
from ..theory.exact import EPS
from .constraints import root
from .limited import Horizon
from .limited_errors import LimitedErrors, MovedTarget
from .plan_bound import PlanBound, distances, plan_errors
from .uncertain_map import HARD, SMALL, Model, apart, product, weights

if TYPE_CHECKING:
    from .._base.types import Floats, Fusion
    from ..rng import Key
    from ..theory.bounds.drawn_errors import PlanErrors
    from .limited import Limited
    from .provenance import Basis

FIRM = "limits: firm nonexpansiveness"
_MANY = "without a weight of the inputs more than one control is the best"


class _Radii(NamedTuple):
    """In the norm of Q, of the control in the 2-norm, and of J."""

    state: float
    control: float
    excess: float
    name: str
    reason: str | None = None


def limited_bound(
    basis: Basis,
    limited: Limited,
    predicted: Floats,
    delta: float,
    rng: RngLike,
    fusion: Fusion = "product",
) -> PlanBound:
    """Bound the errors of a control within limits, which leads the model along `predicted`."""
    key = as_key(rng).child("simulated bound")
    errors = plan_errors(basis, len(limited.u), fusion)
    x0, xf, A = basis.values
    task = limited.exact(None if limited.task.follows else xf)
    exact = Horizon(task, A, basis.B)
    if task.state_low is not None and task.soft is None and errors.random:
        found, missed = _Radii(np.inf, np.inf, np.inf, "none", HARD), np.inf
    else:
        best = exact.solve(x0)
        if not errors.random:
            found = _known(exact, limited, best, x0)
        elif task.steps == 1 or basis.A.kind == "exact":
            found = _moved(basis, limited, predicted, exact, errors, delta, key, fusion)
        else:
            found = _uncertain(basis, limited, predicted, exact, errors, delta, key)
        M, state, target = exact.weighted
        missed = float(np.linalg.norm(M @ best.u.ravel() - target + state @ x0)) + best.distance
        off = _rounding(M, limited.u, best.u) + sum(state.shape) * EPS * norm(state) * norm(x0)
        found, missed = (
            _with_rounding(found, off, limited.objective, _least(exact, M)),
            missed + off,
        )
    # in the 2-norm where only the last state counts, with one weight
    scale = float(task.terminal[0, 0])
    plain = not task.stage.any() and np.array_equal(task.terminal, scale * np.eye(len(x0)))
    size = np.sqrt(scale) if plain else 1.0
    return PlanBound(
        state=found.state / size,
        control=found.control,
        target=(found.state + missed) / size,
        delta=delta,
        state_bound=found.name,
        control_bound="none" if np.isinf(found.control) else found.name,
        relative_to="targets" if any(e.kind == "fitted" for e in basis.entities) else "laws",
        certain=not errors.random,
        norm="2-norm" if plain else "Q",
        solver=limited.distance,
        excess=found.excess,
        reason=found.reason,
    )


def _rounding(M: Floats, *controls: Floats) -> float:
    """Rounding of ``M u`` for these u, ``(rows + columns) eps ||M||_F ||u||`` each at most.

    Rounding in ``A^k B`` and ``A^k x0`` themselves is not in it.
    """
    return sum(M.shape) * EPS * norm(M) * sum(norm(u) for u in controls)


def _with_rounding(found: _Radii, off: float, objective: float, least: float) -> _Radii:
    """The radii where every ``M u`` is wrong by `off`; the one place where this is added."""
    if not off:
        return found
    return found._replace(
        state=found.state + off,
        control=found.control + off / np.sqrt(least) if least else found.control,
        excess=found.excess + product(2.0 * np.sqrt(objective) + off, off),
    )


def _known(exact: Horizon, limited: Limited, best: Limited, x0: Floats) -> _Radii:
    """Nothing is random: the error itself, with what the certificate of `best` may add."""
    M = exact.condensed
    wrong, least = (limited.u - best.u).ravel(), _least(exact, M)
    J, J_best = (exact.objective(x0, u) for u in (limited.u, best.u))
    control = norm(wrong) + best.distance / np.sqrt(least) if least else np.inf
    return _Radii(
        state=float(np.linalg.norm(M @ wrong)) + best.distance,
        control=control,
        excess=max(0.0, J - J_best) + best.gap + ROUNDING * J,
        name="exact error",
        reason=None if least else _MANY,
    )


def _moved(
    basis: Basis,
    limited: Limited,
    predicted: Floats,
    exact: Horizon,
    errors: PlanErrors,
    delta: float,
    key: Key,
    fusion: Fusion,
) -> _Radii:
    """The map is exact: ``||du||_H <= d`` and ``||du||_R <= d / 2`` for ``d = ||P_Q (b^ - b)||_Q``.

    The inequalities of the two best controls, each tested at the other, add up to ``||B du||_Q^2 +
    ||du||_R^2 <= <B du, b^ - b>_Q``. With soft limits of the states d is that of `MovedTarget`.
    """
    moved = MovedTarget(errors, exact)
    drawn = radii(moved, delta, key)
    why = None if drawn else not_simulated(delta, moved.cost)
    d = drawn[0] if drawn else _formula(basis, exact, delta, fusion, why)
    D, M = limited.distance, exact.condensed
    least, least_R = _least(exact, M), float(np.linalg.eigvalsh(limited.R)[0])
    control = (d + D) / np.sqrt(least) if least else np.inf
    if least_R > 0.0:
        control = min(control, (d / 2.0 + D) / np.sqrt(least_R))
    if exact.task.boxed:
        control = min(control, _inside(exact, M, limited, predicted, d))
    reason = why if np.isfinite(control) else _MANY
    return _Radii(d + D, control, product(d, d) + limited.gap, FIRM, reason)


def _inside(exact: Horizon, M: Floats, limited: Limited, predicted: Floats, d: float) -> float:
    """Where no limit comes into play for any b within d, ``u = L b``: ``||L|| d``.

    ``L = H^+ M' = [M; R^(1/2)]^+ [I; 0]``: in H a small R would be lost beside a large M.
    """
    stage, terminal = exact.roots
    off = limited.task.reference - predicted[1:]
    rest = np.concatenate([*(stage @ r for r in off[:-1]), terminal @ off[-1]])
    stacked = np.vstack([M, root(_cost(exact))])
    U, s, V = np.linalg.svd(stacked, full_matrices=False)
    tiny = max(stacked.shape) * float(np.finfo(np.float64).eps)
    kept = s > tiny * s[0]
    L = V[kept].T / s[kept] @ U[: len(M), kept].T
    if kept.any():
        d *= 1.0 + tiny * s[0] / s[kept][-1]  # what rounding may add to L
    free = L @ (rest + M @ limited.u.ravel())
    reach = np.linalg.norm(L, axis=1) * d
    low, high = exact.task.low.ravel(), exact.task.high.ravel()
    if not (np.all(free - reach >= low) and np.all(free + reach <= high)):
        return np.inf
    return norm(limited.u.ravel() - free) + float(np.linalg.norm(L, 2)) * d


def _formula(basis: Basis, exact: Horizon, delta: float, fusion: Fusion, why: str | None) -> float:
    """A bound of the d of `MovedTarget` that needs no simulation."""
    task = exact.task
    if fusion == "diagonal":
        raise InputError(
            "no formula bounds a control within limits of paired realizations (use "
            f"fusion='product'), and {why}"
        )
    e0, ef, eA = distances(basis, delta, "Frobenius")
    Q, W = (weights(task, soft=soft) for soft in (False, True))
    goal = float(np.sqrt(np.sum(np.linalg.norm(Q, 2, axis=(1, 2))))) * ef
    x0_hat, _, A_hat = basis.estimates
    if task.steps == 1:
        moved = float(np.linalg.norm(A_hat, 2)) * e0 + eA * (norm(x0_hat) + e0)
        return goal + float(np.sqrt(np.linalg.norm(W[0], 2))) * moved
    tall = np.vstack([root(w) @ P for w, P in zip(W, exact.powers[1:], strict=True)])
    return goal + float(np.linalg.norm(tall, 2)) * e0


def _uncertain(
    basis: Basis,
    limited: Limited,
    predicted: Floats,
    exact: Horizon,
    errors: PlanErrors,
    delta: float,
    key: Key,
) -> _Radii:
    """The map moves with A: errors drawn from the law, or the inequality of `uncertain_map`."""
    follows = basis.xf.kind != "exact" and not limited.task.follows
    law = LimitedErrors(errors, exact, limited, follows)
    drawn = radii(law, delta, key) if limited.task.boxed else None
    if drawn:
        least = _least(exact, exact.condensed)
        state, control, excess = drawn
        return _Radii(
            state, control if least else np.inf, excess, "simulated", None if least else _MANY
        )
    e0, ef, eA = distances(basis, delta, "spectral")
    norms = spectral_norms(matrix_powers(basis.values[2], len(limited.u)))
    sizes = np.linalg.norm(predicted, axis=1)
    # ||x(k) - xh(k)|| <= ||A^k|| e0 + eA sum_j ||A^(k-1-j)|| ||xh(j)||
    along = [norms[k] * e0 + eA * float(norms[:k][::-1] @ sizes[:k]) for k in range(1, len(norms))]
    Q, W = (
        np.linalg.norm(weights(limited.task, soft=soft), 2, axis=(1, 2)) for soft in (False, True)
    )
    alpha = float(np.sqrt(W @ np.square(along)) + np.sqrt(np.sum(Q)) * ef)
    model = Model(basis.estimates[2], basis.B, (eA, 0.0), lambda p: (eA * norm(p), 0.0))
    task = replace(limited.task, R=limited.R)
    found = apart(task, model, predicted[1:], limited.u, alpha, limited.gap)
    why = not_simulated(delta, law.cost) if limited.task.boxed else None
    reason = why if np.isfinite(found.control) else SMALL
    return _Radii(found.state, found.control, found.excess, "uncertain map", reason)


def _cost(exact: Horizon) -> Floats:
    cost = exact.cost()
    return np.diag(cost) if cost.ndim == 1 else cost


def _least(exact: Horizon, M: Floats) -> float:
    """The least eigenvalue of ``H = M'M + R``, 0 where it is not more than rounding."""
    s = np.linalg.svd(np.vstack([M, root(_cost(exact))]), compute_uv=False)
    if len(s) < M.shape[1] or not s[-1] > max(M.shape) * np.finfo(np.float64).eps * s[0]:
        return 0.0
    return product(s[-1], s[-1]) * (1.0 - ROUNDING)
