"""Section 4 of the paper: the tail bounds of Lemmas 4.2 and 4.3."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from math import comb, exp, log, sqrt

import numpy as np

from stochens_rs import Key, System, simulate_ensemble

from .. import bounds as printed_bounds
from .. import rationals as exact
from ..common import Floats
from .records import Claim, Outcome, claim, outcome
from .tails import Tails, hadamard, hard_system


def lemma_42(tails: Tails) -> Claim:
    """The statement is true with other constants; its proof is wrong."""
    N, eps = 200, Fraction(3, 10)
    # n = 2, w = (1/2, 1/2): the error is sqrt(2) |k/N - 1/2|
    tail = _tail(N, eps)
    printed = printed_bounds.OneVector([0.5, 0.5], C=4.0).probability(N, float(eps))
    # V = 1/2; g = 1, and W = 2 for pairs with A = B = I and xf = 0
    vector, state = (printed_bounds.Corrected(0.5, W) for W in (1.0, 2.0))
    held = vector.probability(N, float(eps))
    broken = tails.failures[:, 1] / tails.runs
    worst = int(np.argmax(broken))
    allowed = tails.delta + 4.0 * np.sqrt(tails.delta / tails.runs)
    ours = int(tails.failures[:, 0].max()) / tails.runs
    A, x0 = hard_system(tails.n)
    wider = printed_bounds.Lemma42((A, np.eye(tails.n)), x0, np.zeros(tails.n), C=2.0)
    wide = np.array([wider.radius(N, tails.delta) for N in tails.sizes.tolist()])
    beyond_it = wide / tails.empirical
    return claim(
        "Lemma 4.2",
        outcome(
            printed < float(tail) <= held,
            N=N,
            eps=float(eps),
            tail=float(tail),
            printed=printed,
            held=held,
        ),
        outcome(
            broken[worst] > allowed and ours <= allowed,
            tails=tails,
            count=len(tails.sizes),
            share=100 * broken[worst],
            at=tails.sizes[worst],
            held=100 * ours,
            low=np.min(tails.ours / tails.empirical),
            high=np.max(tails.ours / tails.empirical),
        ),
        outcome(beyond_it.min() >= 1.0, corrected=wider, low=beyond_it.min(), high=beyond_it.max()),
        _exact_tails({"a vector": vector, "the state": state}, N),
    )


_DELTAS = (0.1, 0.01, 1e-3, 1e-6)


def _exact_tails(mcdiarmid: dict[str, printed_bounds.Corrected], size: int) -> Outcome:
    """Radii of bounds on ``sqrt(2) |k/N - 1/2|``, k binomial, beside its exact tail."""
    found = {
        name: [_tail(size, Fraction(bound.radius(size, delta))) for delta in _DELTAS]
        for name, bound in mcdiarmid.items()
    }
    shown = "; ".join(
        f"{name} {', '.join(f'{float(p):.1e}' for p in tails)}" for name, tails in found.items()
    )
    pairs = (pair for tails in found.values() for pair in zip(tails, _DELTAS, strict=True))
    return outcome(all(p <= delta for p, delta in pairs), size=size, deltas=_DELTAS, shown=shown)


def _tail(size: int, radius: Fraction) -> Fraction:
    """``P(sqrt(2) |k/N - 1/2| > radius)``."""
    half = Fraction(1, 2)
    beyond = (k for k in range(size + 1) if 2 * (Fraction(k, size) - half) ** 2 > radius**2)
    return Fraction(sum(comb(size, k) for k in beyond), 2**size)


def proof_of_lemma_42() -> Claim:
    """The constant of one norm is used with another."""
    n = 4
    M = exact.array([[1] * n] + [[0] * n] * (n - 1))
    by_rows, by_columns = _row_sums(M), _row_sums(M.T)
    small = [exact.array(x).reshape(2, 2) for x in product((-1, 0, 1), repeat=4)]
    # ||M||_2^2 <= n ||M||_1^2, M of order 2
    kept = all(exact.spectral_at_most(A, 2 * _row_sums(A.T) ** 2) for A in small)
    confirms = by_columns < by_rows <= n * by_columns and kept
    return claim(
        "Proof of Lemma 4.2, norm",
        outcome(confirms, n=n, by_rows=by_rows, by_columns=by_columns, count=len(small)),
    )


def _row_sums(M: exact.Array) -> Fraction:
    """``||M||_inf``, the largest sum of absolute values of a row."""
    return Fraction(max(abs(M).sum(axis=1)))


def lemma_43(key: Key) -> Claim:
    """Nothing in the bound depends on K, and its exponent is wrong at K = 1."""
    n, N = 16, 10
    # all N runs hit one and the same atom +-n e_i, i >= 2: deviation^2 = n^2 + 1
    log_probability = log(2 * n - 2) - N * log(2 * n)
    lemma = printed_bounds.Lemma43(*_one_step(n), C=1.0)
    printed, later = (lemma.probability(k, sqrt(n**2 + 1)) for k in (N, 2 * N))
    rate = log(2 * n), log(printed / later) / N
    A, x0 = hadamard(2) / np.sqrt(2.0), np.full(2, np.sqrt(0.5))
    system = System(A, np.zeros((2, 1)))
    runs, steps = 200_000, 8
    ran = simulate_ensemble(system, x0, np.zeros((steps, 1)), runs, rng=key)
    assert ran.variance is not None  # more than one run
    spread = ran.variance.sum(axis=1)
    expected = 2.0 ** (np.arange(steps + 1) + 1) - 1.0
    # tr S_k = 2^(k+1) - 1. As |xhat(k)|^2 = 2^(k+1) on every run, only the error of the mean
    # makes the sample value differ from it.
    close = np.all(np.abs(spread - expected) <= 0.05 * expected)
    # every entry of A 1/2, no control: after each step the state is e_1 or e_2, as a coin decides,
    # so that tr S_K = 1/2 and R_K = 1 for every K
    coin = printed_bounds.Corrected(0.5, 2.0)
    return claim(
        "Lemma 4.3",
        outcome(
            log_probability > log(printed) and rate[0] < rate[1],
            n=n,
            probability=exp(log_probability),
            N=N,
            printed=printed,
            rate=rate,
        ),
        outcome(close, runs=runs, spread=spread[[0, 1, 2, 4, 8]]),
        _exact_tails({"the state": coin}, 200),
    )


def _one_step(n: int) -> tuple[System, Floats, Floats]:
    """``system, x0, u`` of one step of the hard system without control."""
    A, x0 = hard_system(n)
    return System(A, np.zeros((n, 1))), x0, np.zeros((1, 1))
