"""A bound on the error of a plan."""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, Literal

import numpy as np

from .._base.numbers import norm
from .._base.records import trusted
from .._base.types import QUANTITIES, Floats
from ..certificates.certificate import Certificate
from ..certificates.radius import Radius
from ..exceptions import InputError
from ..rng import as_key
from ..theory.drawn_bounds import (
    Bounded,
    DrawnEntity,
    PlanErrors,
    drawn_bound,
    not_simulated,
    radii,
)
from ..theory.dynamics import matrix_powers, spectral_norms
from ..theory.exact import EPS
from ..theory.formulas import checked_finite
from .provenance import Basis

if TYPE_CHECKING:
    from .._base.types import Fusion


KEY = as_key(0).child("simulated bound")  # of the draws, which are the same in every call
LAWS = "the exact values are those that the realizations were drawn from, independently"
TARGETS = "the targets of the fits are the exact values that were fitted"


def plan_bound(
    basis: Basis, u: Floats, predicted: Floats, fusion: Fusion, delta: float
) -> Certificate:
    """Bound the errors of the control `u`, which leads the model along `predicted`."""
    errors = plan_errors(basis, len(u), fusion)
    found: tuple[float, ...]
    reason = None
    if not errors.random:
        error = errors.best.error(u.ravel(), basis.values[0])
        names = ("exact error",) * 2
        found = error.state + error.state_rounding, error.control + error.control_rounding
    elif drawn := radii(errors, delta, KEY):
        found, names = drawn, ("simulated",) * 2
    else:
        reason = not_simulated(delta, errors.cost)
        found, names = _formulas(basis, u, predicted, errors, delta, fusion)
    state, control = _handed_out(basis, errors, *found) if errors.random else found
    if errors.best.gap > 0.0 and np.isfinite(basis.rounding).all():
        checked_finite(np.array([state, control]), "bound")
    else:
        reason = _DIGITS
    target = float(np.hypot(state, errors.best.upper)) * (1.0 + 4.0 * EPS)
    quantities = {
        "target": (target, "xf", names[0], reason),
        "state": (state, "where the exact control leads", names[0], reason),
        "control": (control, "the exact control", names[1], reason),
    }
    parts = {"estimates": state, "out of reach": errors.best.upper * (1.0 + 4.0 * EPS)}
    return certificate_of_laws(basis, delta, errors.random, quantities, parts)


def certificate_of_laws(
    basis: Basis,
    delta: float,
    random: bool,
    quantities: dict[str, tuple[float, str, str, str | None]],
    parts: dict[str, float],
) -> Certificate:
    """The certificate of a plan of estimates: radius, what it is from, method, reason of each."""
    sure = 1.0 - delta if random else 1.0
    fitted = any(entity.kind == "fitted" for entity in basis.entities)
    each = "control and state each, target with state, over the draws of the realizations"
    return trusted(
        Certificate,
        kind="guaranteed" if random else "certain",
        delta=delta,
        quantities={
            name: trusted(Radius, radius, distance_from, sure, method, reason)
            for name, (radius, distance_from, method, reason) in quantities.items()
        },
        covers=each if random else "nothing was drawn",
        assumption=TARGETS if fitted else LAWS if random else "what was given is exact",
        parts=parts,
    )


_DIGITS = "the condition of C_K is so large that rounding leaves no digit of the control for sure"


def _handed_out(
    basis: Basis, errors: PlanErrors, state: float, control: float
) -> tuple[float, float]:
    """The radii of the exact control of the estimates, with the rounding of that in doubles.

    The one place where it is added, whatever the method. ``||C_K (u - v)||`` is known for the
    estimates, which is all over one step; over several it is at most ``||C_K|| ||u - v||``. The
    averages themselves are rounded like ``xf - A^K x0``.
    """
    best = errors.best
    state, control = state + 2.0 * best.unsure, control + best.amplified(2.0 * best.unsure)
    off_state, off_control = basis.rounding
    if errors.several:
        off_state = float(errors.best.factors.singular_values[0]) * off_control
    return state + off_state, control + off_control


def plan_errors(basis: Basis, steps: int, fusion: Fusion) -> PlanErrors:
    """The law of the errors of a plan whose entities are all known.

    Averages of realizations are random, fits and exact values are not.
    """
    entities = []
    for entity, values in zip(basis.entities, basis.values, strict=True):
        if entity.kind == "iid" or entity.kind == "systematic":
            entities.append(DrawnEntity(values, None, entity.size, entity.kind))
        else:
            entities.append(
                DrawnEntity(values, entity.estimate if entity.kind == "fitted" else None)
            )
    x0, xf, A = entities
    rows = basis.A.axis == "rows"
    if fusion == "diagonal" and basis.A.kind == "systematic" and rows:
        raise InputError(
            "no bound is known for paired systematic realizations of rows: use fusion='product'"
        )
    return PlanErrors(basis.B, x0, xf, A, steps=steps, paired=fusion == "diagonal", rows=rows)


def _formulas(
    basis: Basis, u: Floats, predicted: Floats, errors: PlanErrors, delta: float, fusion: Fusion
) -> tuple[tuple[float, float], tuple[str, str]]:
    """Bounds of the state and of the control for a `delta` that cannot be simulated."""
    if len(u) > 1:
        return _along_trajectory(basis, u, predicted, errors, delta), ("sum of errors",) * 2
    if all(entity.kind in ("exact", "iid") for entity in basis.entities):
        x0, xf, A = basis.values
        state, control = (
            Bounded(quantity, ((A, basis.B), x0, xf), fusion=fusion, axis=basis.A.axis).least(
                basis.sizes, delta
            )
            for quantity in QUANTITIES
        )
        return (state[0], control[0]), (state[1], control[1])
    if fusion == "diagonal":
        raise InputError(
            "no formula bounds paired systematic realizations, which are dependent (use "
            f"fusion='product'), and {not_simulated(delta, errors.cost)}"
        )
    return _sum_of_errors(basis, errors, delta), ("sum of errors",) * 2


def _sum_of_errors(basis: Basis, errors: PlanErrors, delta: float) -> tuple[float, float]:
    """Bounds of ``||B (u - v)||`` and ``||u - v||`` by those of the estimates.

    ``B (v - u) = P [(xf - xf_hat) - A_hat (x0 - x0_hat) - (A - A_hat) x0]`` with ``P = B B^+``, so
    ``||B (u - v)|| <= ef + ||P A_hat|| e0 + eA (||x0_hat|| + e0)`` (the corrected proof of Lemma
    3.2), and with ``B^+`` in place of P for the control.
    """
    e0, ef, eA = distances(basis, delta, "Frobenius")
    x0_hat, _, A_hat = basis.estimates
    U, s = errors.best.factors.U, errors.best.factors.s
    if s.size == 0:
        return 0.0, 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        reached = U.T @ A_hat
        free = ef + eA * (float(np.linalg.norm(x0_hat)) + e0)
        state = free + float(np.linalg.norm(reached, 2)) * e0
        control = free / float(s[-1]) + float(np.linalg.norm(reached / s[:, None], 2)) * e0
    return checked_finite(state, "bound"), checked_finite(control, "bound")


def _along_trajectory(
    basis: Basis, u: Floats, predicted: Floats, errors: PlanErrors, delta: float
) -> tuple[float, float]:
    """``ef + ||A^K|| e0 + eA sum_k ||A^{K-1-k}|| ||xh(k)|| + ||xh(K) - xf_hat||``.

    This bounds ``||x(K) - xf||`` along the predicted states ``xh``; by Pythagoras
    ``||C (u - v)||^2`` is smaller by the squared residual.
    """
    _, xf_hat, _ = basis.estimates
    e0, ef, eA = distances(basis, delta, "spectral")
    norms = spectral_norms(matrix_powers(basis.values[2], len(u)))
    with np.errstate(over="ignore", invalid="ignore"):
        along = float(norms[-2::-1] @ np.linalg.norm(predicted[:-1], axis=1))
        total = ef + norms[-1] * e0 + eA * along + norm(predicted[-1] - xf_hat)
        # A xh + B u is rounded by (n + m) eps (||A||_F ||xh|| + ||B||_F ||u||) at most
        A, B = basis.values[2], basis.B
        sizes = np.linalg.norm(predicted[:-1], axis=1), np.linalg.norm(u, axis=1)
        terms = sum(B.shape) * EPS * ((norm(A) + eA) * sizes[0] + norm(B) * sizes[1])
        total += float(norms[-2::-1] @ terms)
        # total^2 - missed^2, of factors that do not overflow
        missed = max(0.0, norm(errors.best.missed) - errors.best.state_rounding)
        state = sqrt(max(0.0, total - missed)) * sqrt(total + missed)
        # u - v = C^+ C (u - v) + (I - C^+ C) u
        aside, gap = errors.best.aside(u.ravel()), errors.best.gap
        if gap <= 0.0:
            return errors.rounded((state, np.inf))
        # the rows of the factors are turned by at most off / gap
        turned = errors.best.off / gap * norm(u) if errors.best.factors.s.size < u.size else 0.0
        return errors.rounded((state, float(np.hypot(state / gap, norm(aside) + turned))))


def distances(basis: Basis, delta: float, matrix_norm: str) -> tuple[float, float, float]:
    """Bounds on the errors of the three estimates, all valid with probability 1 - delta."""
    shares = sum(entity.kind == "iid" for entity in basis.entities)
    found = []
    for entity, values, estimate in zip(basis.entities, basis.values, basis.estimates, strict=True):
        matrix = entity.name == "A"
        what: Literal["matrix", "vector"] = "matrix" if matrix else "vector"
        axis = entity.axis if matrix else "columns"
        if entity.kind == "exact":
            found.append(0.0)
        elif entity.kind == "fitted":
            found.append(float(np.linalg.norm(estimate - values, 2 if matrix else None)))
        elif entity.kind == "systematic":
            of = Bounded(what, (values,), axis=axis, scheme="systematic")
            found.append(of.least((entity.size,), delta)[0])
        else:
            each, kind = delta / shares, matrix_norm if matrix else "2"
            radius, _ = drawn_bound(
                what, values, size=entity.size, delta=each, norm=kind, axis=axis
            )
            found.append(radius)
    e0, ef, eA = found
    return e0, ef, eA
