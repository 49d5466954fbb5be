"""Section 4 of the paper: the tail bounds of Lemmas 4.2 and 4.3."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from math import comb, exp, log, sqrt
from typing import TYPE_CHECKING

import numpy as np

from ...rng import Key
from ...simulation.simulating import simulate_ensemble
from ...system import System
from ...theory import bounds
from ...theory.bounds import Bound
from .. import bounds as printed_bounds
from .. import rationals as exact
from .records import Claim, claim
from .tails import Tails, hadamard, hard_system

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


def lemma_42(tails: Tails) -> Claim:
    """The statement is true with other constants; its proof is wrong."""
    N, eps = 200, Fraction(3, 10)
    # n = 2, w = (1/2, 1/2): the error is sqrt(2) |k/N - 1/2|
    tail = _tail(N, eps)
    printed = printed_bounds.OneVector([0.5, 0.5], C=4.0).probability(N, float(eps))
    held = bounds.bound("McDiarmid", "vector", [0.5, 0.5]).probability(N, float(eps))
    one = (
        f"w = (1/2, 1/2), N = {N}: P(error > {float(eps)}) = {float(tail):.2e} exactly; the "
        f"proof's bound with C = n^2 says {printed:.1e}, ours {held:.1e}."
    )
    broken = tails.failures[:, 1] / tails.runs
    worst = int(np.argmax(broken))
    allowed = tails.delta + 4.0 * np.sqrt(tails.delta / tails.runs)
    ours = int(tails.failures[:, 0].max()) / tails.runs
    many = (
        f"A = H/sqrt(n), n = {tails.n}, delta = {tails.delta}, {tails.runs} runs for each of "
        f"{len(tails.sizes)} sizes: with ||A|| in beta and C = n the printed radius is exceeded in "
        f"{100 * broken[worst]:.3g} % of the runs at N = {tails.sizes[worst]}; the {tails.bound} "
        f"bound in at most {100 * ours:.2g} %, and that is "
        f"{float(np.min(tails.ours / tails.empirical)):.2g} to "
        f"{float(np.max(tails.ours / tails.empirical)):.2g} times the empirical quantile."
    )
    A, x0 = hard_system(tails.n)
    corrected = printed_bounds.Lemma42((A, np.eye(tails.n)), x0, np.zeros(tails.n), C=2.0)
    wide = np.array([corrected.radius(N, tails.delta) for N in tails.sizes.tolist()])
    beyond_it = wide / tails.empirical
    third = (
        f"The same runs, with the largest norm {corrected.beta:g} of a realization in beta and "
        f"C = 2: the radius of the lemma is {beyond_it.min():.3g} to {beyond_it.max():.3g} times "
        "the empirical quantile."
    )
    vector = bounds.bound("McDiarmid", "vector", _HALF)
    # A = B = I and xf = 0: the pair (x0(s), A(s)) gives the atoms of x0
    unit = np.eye(2), np.eye(2)
    state = bounds.bound("McDiarmid", "state", unit, _HALF, np.zeros(2), fusion="diagonal")
    return claim(
        "Lemma 4.2",
        ("exact", one, printed < float(tail) <= held),
        ("Monte Carlo", many, broken[worst] > allowed and ours <= allowed),
        ("Monte Carlo", third, beyond_it.min() >= 1.0),
        ("exact", *_exact_tails({"a vector": vector, "the state": state}, N)),
    )


_HALF = np.array([0.5, 0.5])
_DELTAS = (0.1, 0.01, 1e-3, 1e-6)


def _exact_tails(mcdiarmid: dict[str, Bound], size: int) -> tuple[str, bool]:
    """Radii of bounds on ``sqrt(2) |k/N - 1/2|``, k binomial, beside its exact tail."""
    found = {
        name: [_tail(size, Fraction(bound.radius(size, delta))) for delta in _DELTAS]
        for name, bound in mcdiarmid.items()
    }
    shown = "; ".join(
        f"{name} {', '.join(f'{float(p):.1e}' for p in tails)}" for name, tails in found.items()
    )
    text = (
        f"The error sqrt(2) |k/N - 1/2|, k binomial, N = {size}, exceeds the radius of McDiarmid's "
        f"bound for delta = {', '.join(f'{delta:g}' for delta in _DELTAS)} with the exact "
        f"probabilities {shown}."
    )
    pairs = (pair for tails in found.values() for pair in zip(tails, _DELTAS, strict=True))
    return text, all(p <= delta for p, delta in pairs)


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
    text = (
        f"M with a first row of ones and zeros below, n = {n}: ||M||_inf = {by_rows}, the largest "
        f"column sum {by_columns}. For || || = || ||_inf the proof may take mu = 1, and its "
        f"inequality then reads {by_rows} <= {by_columns}. Of all {len(small)} matrices of "
        "order 2 with entries -1, 0, 1 none has a 2-norm above sqrt(2) times the largest column "
        "sum."
    )
    confirms = by_columns < by_rows <= n * by_columns and kept
    return claim("Proof of Lemma 4.2, norm", ("exact", text, confirms))


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
    one = (
        f"A = H/sqrt(n), x0 = (1, .., 1)/sqrt(n), n = {n}, one step: all N runs hit one atom with "
        f"probability (2n - 2)(2n)^-N = {exp(log_probability):.1e} at N = {N}, the bound is "
        f"C {printed:.1e}; per run the exponents are {rate[0]:.3f} and {rate[1]:.3f}, so "
        "that no C is large enough for all N."
    )
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
    many = (
        f"n = 2, {runs} runs: N times the mean square error of the average grows as "
        f"{', '.join(f'{v:.3g}' for v in spread[[0, 1, 2, 4, 8]])} for K = 0, 1, 2, 4, 8, that is "
        "2^(K+1) - 1, while the bound does not depend on K."
    )
    # every entry 1/2, no control: the state after each step is e_1 or e_2, as a coin decides
    coin = System(np.full((2, 2), 0.5), np.zeros((2, 1)))
    several = {
        f"{K} steps": bounds.bound("McDiarmid", "trajectory", coin, [1.0, 0.0], np.zeros((K, 1)))
        for K in (1, 2, 5)
    }
    return claim(
        "Lemma 4.3",
        ("exact", one, log_probability > log(printed) and rate[0] < rate[1]),
        ("Monte Carlo", many, close),
        ("exact", *_exact_tails(several, 200)),
    )


def _one_step(n: int) -> tuple[System, Floats, Floats]:
    """``system, x0, u`` of one step of the hard system without control."""
    A, x0 = hard_system(n)
    return System(A, np.zeros((n, 1))), x0, np.zeros((1, 1))
