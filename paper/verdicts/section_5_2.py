"""Section 5.2 of the paper: its statements on several steps, on the states and on their order."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np

from stochens_rs import Key, Study, control, sample_counts, simulate
from stochens_rs.cases import random_system

from .. import rationals as exact
from .. import reachability
from ..common import ROUNDING
from ..repeating import HERE, Where, complete
from .records import Claim, claim, outcome

if TYPE_CHECKING:
    from ..experiment import Experiment

    Law = list[tuple[Fraction, exact.Array]]


# A = diag(1, 3, 3) in `ordering`; it has no other realization.
_GAINS = (1, 3, 3)
_ORDERS = ("alse_above_slse", "slse_above_uniform")


def one_step_only(key: Key, where: Where = HERE) -> Claim:
    """Controls of several steps cannot be averaged, but estimates can be."""
    A, B = exact.array([[1, 2], [1, 1]]), exact.array([1, 1])
    x0, xf = exact.array([1, 0]), exact.array([0, 1])
    one = exact.ZERO  # mean of the one-step controls B^+ (xf - A(s) x0), B^+ = B' / 2
    mean = exact.array([0, 0])  # of the two-step controls
    law = exact.matrix_atoms(A)
    for p, first in law:
        one += p * B @ (xf - first @ x0) / 2
        for q, second in law:
            mean += p * q * _solve(second @ B, B, xf - second @ first @ x0)
    state = A @ (A @ x0 + mean[0] * B) + mean[1] * B
    v = B @ (xf - A @ x0) / 2
    two = _solve(A @ B, B, xf - A @ A @ x0)  # u(0), u(1)
    given = [exact.floats(x) for x in (A, B[:, None], x0, xf)]
    computed = control((given[0], given[1]), given[2], given[3], steps=2).u.ravel()
    apart = float(np.abs(computed - exact.floats(two)).max())
    sizes = (100, 10_000)
    study = Study(_miss, {"size": sizes}, replicates=25, rng=key, shared=["size"])
    misses = np.median(complete(study, **where.of("one-step"))["miss"], axis=1)
    return claim(
        "Section 5.2, one step",
        outcome(
            one == v and exact.square(state - xf) > 0 and apart <= ROUNDING,
            one=one,
            v=v,
            state=state,
            two=two,
            apart=apart,
        ),
        outcome(misses[1] < 0.3 * misses[0], sizes=sizes, misses=misses),
    )


def _miss(key: Key, size: int) -> dict[str, float]:
    """How far three steps with one average end from the target, relative to its norm."""
    system = random_system(4, 2, rng=key.child("system"))
    ends = key.child("ends").generator().standard_normal((2, 4))
    A_hat = sample_counts(system.A, size, rng=key.child(f"A {size}"))
    plan = control((A_hat, system.B), ends[0], ends[1], steps=3)
    last = simulate(system, ends[0], plan.u).states[-1]
    return {"miss": float(np.linalg.norm(last - ends[1]) / np.linalg.norm(ends[1]))}


def _solve(a: exact.Array, b: exact.Array, y: exact.Array) -> exact.Array:
    """``(s, t)`` with ``s a + t b = y``, by Cramer's rule."""
    return exact.array([y[0] * b[1] - y[1] * b[0], a[0] * y[1] - a[1] * y[0]]) / (
        a[0] * b[1] - a[1] * b[0]
    )


def ordering(large: Experiment) -> Claim:
    """A better estimate can give a worse state."""
    w, A = exact.array([2, 1, 1]), np.diag(_GAINS)
    reversed_share = exact.ZERO
    for p, samples in exact.sequences(w, 3):
        better, worse = exact.alse(samples, w) - w, exact.mean(samples) - w
        nearer = exact.square(better) < exact.square(worse)
        reversed_share += p * (nearer and exact.square(A @ better) > exact.square(A @ worse))
    orders = [large.facts["ordering"][panel] for panel in ("3a", "3b")]
    shares = [max(order[name] for name in _ORDERS) for order in orders]
    return claim(
        "Figure 3, order",
        outcome(reversed_share > 0, reversed_share=reversed_share),
        outcome(
            min(shares) > 0.0,
            large=large,
            percent=[100 * order[name] for order in orders for name in _ORDERS],
        ),
    )


def computed_states() -> Claim:
    """What Lemma 3.2 as printed would give is false; unbiased realizations make them converge."""
    found = [reachability.lemma_3_2(N) for N in (2, 10, 1000)]
    missed = min(one.claim for one in found)
    A, x = exact.array([[1, 1], [0, 1]]), exact.array([[1, 1], [2, -1], [1, 2]])
    steps = [_errors(A, *ends) for ends in pairwise(x)]
    # x(1) is off by e(0), x(2) by A e(0) + e(1)
    squares = []
    for first, second in (steps, [_average_of_two(law) for law in steps]):
        moved = [(p, A @ e) for p, e in first]
        both = [(p * q, d + e) for (p, d), (q, e) in product(moved, second)]
        squares.append((_mean_square(first), _mean_square(both)))
    one = [_mean_square(law) for law in steps]
    carried = _mean_square([(p, A @ e) for p, e in steps[0]])
    expected = [(one[0] / N, (carried + one[1]) / N) for N in (1, 2)]
    return claim(
        "Section 5.2, computed states",
        outcome(missed >= 1, missed=missed),
        outcome(squares == expected and one[0] == _formula(A, x[0], x[1]), squares=squares),
    )


def _errors(A: exact.Array, start: exact.Array, end: exact.Array) -> Law:
    """Law of ``(x(t+1)(s) - A(s) x(t)(s)) - (x(t+1) - A x(t))`` of one realization, B = I."""
    drawn = product(exact.atoms(start), exact.matrix_atoms(A), exact.atoms(end))
    return [(p * q * r, goal - M @ x - (end - A @ start)) for (p, x), (q, M), (r, goal) in drawn]


def _average_of_two(law: Law) -> Law:
    """Law of the mean of two independent errors."""
    return [(p * q, (d + e) / 2) for (p, d), (q, e) in product(law, repeat=2)]


def _mean_square(law: Law) -> Fraction:
    return sum((p * exact.square(e) for p, e in law), exact.ZERO)


def _formula(A: exact.Array, x0: exact.Array, xf: exact.Array) -> Fraction:
    """``tr C_0 = g(xf)^2 - ||xf||^2 + g(x0) sum_j |x0_j| g_j^2 - ||A x0||^2``."""
    drift = abs(x0).sum() * (abs(x0) @ abs(A).sum(axis=0) ** 2) - exact.square(A @ x0)
    return Fraction(abs(xf).sum() ** 2 - exact.square(xf) + drift)
