"""Section 3 of the paper: Lemmas 3.1 and 3.2, and the remarks after each."""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np

from stochens_rs import Ensemble, control, realization_controls

from .. import rationals as exact
from .. import reachability
from ..common import ROUNDING, TINY, Floats
from .records import Claim, Outcome, claim, outcome


def lemma_31() -> Claim:
    """Reachability does not imply approximate reachability as defined."""
    found = [reachability.lemma_3_1(N) for N in (3, 10, 1000)]
    found.append(reachability.lemma_3_1(5, weights=[1, 0, 2, 0, 7], controls=[1, 2, 3, 4, 5]))
    return claim("Lemma 3.1", outcome(_refutes(found), least=_least(found), count=len(found)))


def remark_31() -> Claim:
    """Reachability does not require approximate reachability."""
    N = 10
    found = [
        reachability.lemma_3_1(N, weights=[int(k == s) for k in range(N)], controls=[u] * N)
        for s in range(N)
        for u in (-1, 0, 1)
    ]
    found.append(reachability.lemma_3_1(N))
    return claim("Remark after Lemma 3.1", outcome(_refutes(found), N=N, least=_least(found)))


def lemma_32() -> Claim:
    """Averaged controls need not approach the control."""
    found = [reachability.lemma_3_2(N) for N in (2, 10, 1000)]
    found.append(reachability.lemma_3_2(5, weights=[1, 0, 2, 0, 7]))
    return claim(
        "Lemma 3.2",
        outcome(_refutes(found), least=_least(found), count=len(found)),
        _product_weights(),
    )


def _product_weights() -> Outcome:
    """The corrected control: its identity, its mean, and what the package computes for it."""
    A, b = exact.array([[1, 1], [1, 2]]), exact.array([1, 1])
    x0, xf = exact.array([1, 1]), exact.array([1, 2])
    B = exact.floats(b)[:, None]
    pinv, P = b / (b @ b), np.outer(b, b) / (b @ b)
    v = pinv @ (xf - A @ x0)
    mean, identity, count = exact.ZERO, True, 0
    apart = _apart(control((exact.floats(A), B), exact.floats(x0), exact.floats(xf)).u[0], [v])
    laws = [list(product(law, repeat=2)) for law in map(_law, (x0, A, xf))]
    for starts, matrices, goals in product(*laws):
        count += 1
        (F0, p), (FA, q), (Ff, r) = (
            _weighted(*given)
            for given in ((starts, Fraction(1, 3)), (matrices, Fraction(1, 2)), (goals, exact.ONE))
        )
        u = pinv @ (Ff - FA @ F0)
        identity &= np.array_equal(b * (v - u), P @ ((xf - Ff) - A @ (x0 - F0) - (A - FA) @ F0))
        mean += p * q * r * u
        given = (exact.floats(FA), B), exact.floats(F0), exact.floats(Ff)
        apart = max(apart, _apart(control(*given).u, [u]))
        pairs = [[one for _, one in chosen] for chosen in (starts, matrices, goals)]
        own = [pinv @ (goal - M @ start) for start, M, goal in zip(*pairs, strict=True)]
        x0s, As, xfs = (Ensemble.from_samples(exact.floats(np.stack(one))) for one in pairs)
        each = realization_controls((As, B), x0s, xfs)
        apart = max(apart, _apart(each, own))
    return outcome(
        identity and mean == v and apart <= ROUNDING, count=count, mean=mean, v=v, apart=apart
    )


def _law(x: exact.Array) -> list[tuple[Fraction, exact.Array]]:
    return exact.atoms(x) if x.ndim == 1 else exact.matrix_atoms(x)


def _weighted(
    pair: tuple[tuple[Fraction, exact.Array], ...], w: Fraction
) -> tuple[exact.Array, Fraction]:
    """``w E_1 + (1 - w) E_2``, and the probability of the two."""
    (p, first), (q, second) = pair
    return w * first + (1 - w) * second, p * q


def _apart(found: Floats, expected: list[Fraction]) -> float:
    """The largest difference, relative to the largest of both."""
    right = np.array([float(x) for x in expected])
    size = max(float(np.abs(right).max()), float(np.abs(found).max()), TINY)
    return float(np.abs(found.ravel() - right).max()) / size


def remark_32_reachable() -> Claim:
    """Sample reachable implies reachable only for unbiased realizations."""
    found = [reachability.remark_3_2(N) for N in (2, 10, 1000)]
    reached, missed = _sample_reachable()
    return claim(
        "Remark after Lemma 3.2, reachable",
        outcome(_refutes(found), least=_least(found)),
        outcome(reached > 0 and missed == 0, targets=reached + missed, missed=missed),
    )


def _sample_reachable() -> tuple[int, int]:
    """Of all small targets that are sample reachable: how many are reachable, and how many not."""
    vectors = [exact.array(x) for x in product((-1, 0, 1), repeat=2)]
    reached = missed = 0
    # what no control moves: the second entry for B = (1, 0), the difference for B = (1, 1)
    for normal in (exact.array([0, 1]), exact.array([1, -1])):
        goals = [(normal @ x, {normal @ atom for _, atom in exact.atoms(x)}) for x in vectors]
        for columns in product(vectors, repeat=2):
            A = np.stack(columns, axis=1)
            rows = [normal @ one for _, one in exact.matrix_atoms(A)]
            for x0 in vectors:
                heights = {row @ start for row in rows for _, start in exact.atoms(x0)}
                for height, all_of_them in goals:
                    if heights == all_of_them and len(heights) == 1:
                        reachable = height == normal @ A @ x0
                        reached, missed = reached + reachable, missed + (not reachable)
    return reached, missed


def remark_32_any() -> Claim:
    """Not even plain averages of independent realizations are enough."""
    sizes = (2, 10, 1000)
    averages, least = [], []
    for N in sizes:
        starts, matrices = _alternating(N)
        averages += [abs(exact.mean(s) - 1) for s in (starts, matrices)]
        # B = 1, xf = xf(s) = 0: u(s) = -A(s) x0(s) and v = -A x0 = -1. If all u(s) are on one
        # side of v, no convex sum of them is nearer to v than the nearest.
        least.append(min(-matrices * starts) + 1)
    confirms = not any(averages) and min(least) >= 1
    return claim(
        "Remark after Lemma 3.2, any sequence",
        outcome(confirms, sizes=sizes, off=max(averages), least=min(least)),
    )


def _alternating(N: int) -> tuple[exact.Array, exact.Array]:
    """x0(s) and A(s): never both different from 0."""
    odd = exact.array(np.arange(N) % 2)
    return 2 * (1 - odd), 2 * odd


def _least(found: list[reachability.Counterexample]) -> Fraction:
    return min(one.claim for one in found)


def _refutes(found: list[reachability.Counterexample]) -> bool:
    """All that the lemma assumes holds exactly, and its claim fails by 1 or more."""
    assumed = [x for one in found for x in (one.hypothesis, *one.approximation_errors.values())]
    return not any(assumed) and _least(found) >= 1
