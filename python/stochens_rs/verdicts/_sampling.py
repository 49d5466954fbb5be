"""Section 4.1 of the paper: the sampling scheme and the tail bounds of Lemmas 4.2 and 4.3."""

from __future__ import annotations

from fractions import Fraction
from math import comb, exp, log

import numpy as np

from ..rng import Key
from ..simulating import simulate_ensemble
from ..system import System
from ..theory import bounds
from . import _exact as exact
from .records import Claim, Evidence
from .tails import Tails, hadamard, hard_system


def lemma_41() -> Claim:
    """The scheme is unbiased; the printed mean lacks a factor."""
    w = exact.vector(3, -1, 0, 2)
    N = 3
    total = average = exact.vector(0, 0, 0, 0)
    inside = True
    for p, samples in exact.sequences(w, N):
        mean = exact.mean(samples)
        total = exact.combine(exact.ONE, total, p * N, mean)
        average = exact.combine(exact.ONE, average, p, mean)
        inside &= all(x * y >= 0 and (y != 0 or x == 0) for x, y in zip(mean, w, strict=True))
    text = (
        f"w = (3, -1, 0, 2), all sequences of N = {N}: the mean of the sum is "
        f"({', '.join(map(str, total))}) = N w, that of the average w; no average has an entry of "
        "another sign, or one where w has none."
    )
    holds = average == w and total == tuple(N * x for x in w) and inside
    best = min(_second_moment(w, q) for q in _masses(len(w), 12) if _covers(q, w))
    g = sum((abs(x) for x in w), exact.ZERO)
    own = _second_moment(w, [abs(x) / g for x in w])
    optimal = (
        f"Among all masses q in twelfths, realizations w_i / q_i e_i have the least mean square "
        f"norm {best} at q = |w| / g, where it is g^2 = {g**2}."
    )
    return Claim(
        "Lemma 4.1",
        "The mean of the i-th component of the sum of N samples is w_i, and the average converges "
        "to w in probability.",
        "holds with a correction",
        "The mean of the sum is N w, that of the average w. Its covariance is (g diag|w| - w w^T) "
        "/ N. No unbiased realization with one entry has a smaller mean square norm than g^2.",
        (
            Evidence("enumeration", text, holds),
            Evidence("enumeration", optimal, best == own == g**2),
        ),
    )


def lemma_42(tails: Tails) -> Claim:
    """The statement survives with the right constants; its proof does not."""
    N, eps = 200, Fraction(3, 10)
    # n = 2, w = (1/2, 1/2): the error is sqrt(2) |k/N - 1/2|
    beyond = [k for k in range(N + 1) if 2 * (Fraction(k, N) - Fraction(1, 2)) ** 2 > eps**2]
    tail = Fraction(sum(comb(N, k) for k in beyond), 2**N)
    printed = bounds.paper.OneVector([0.5, 0.5], C=4.0).probability(N, float(eps))
    held = bounds.McDiarmid([0.5, 0.5]).probability(N, float(eps))
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
        f"{100 * broken[worst]:.3g} % of the runs at N = {tails.sizes[worst]}; the bound that "
        f"holds in at most {100 * ours:.2g} %, and it is "
        f"{float(np.min(tails.ours / tails.empirical)):.2g} to "
        f"{float(np.max(tails.ours / tails.empirical)):.2g} times the empirical quantile."
    )
    A, x0 = hard_system(tails.n)
    corrected = bounds.paper.Lemma42(x0, np.zeros(tails.n), A, C=2.0)
    wide = np.array([corrected.radius(N, tails.delta) for N in tails.sizes.tolist()])
    beyond_it = wide / tails.empirical
    third = (
        f"The same runs, with the largest norm {corrected.beta:g} of a realization in beta and "
        f"C = 2: the radius of the lemma is {beyond_it.min():.3g} to {beyond_it.max():.3g} times "
        "the empirical quantile."
    )
    return Claim(
        "Lemma 4.2",
        "P(||B (v - mean u(s))|| > eps) <= 2 C [exp(-2 N eps^2 / (9 beta^2 g(xf)^2)) + the same "
        "with g(x0) + the same with g(A)], C dependent on n only.",
        "holds with a correction",
        "The norm constants of the proof belong into the exponent. The statement is nevertheless "
        "true for the average of paired realizations, with C = 2 for every n, if beta = max(B_A, "
        "1, ||x0||) with B_A >= ||A(s)||; with ||A|| in place of B_A it is false. Sharper: "
        "P(error >= sqrt(V/N) + t) <= exp(-N t^2 / (g(xf)^2 + 2 g(x0)^2 g(A)^2)).",
        (
            Evidence("exact", one, printed < float(tail) <= held),
            Evidence("Monte Carlo", many, bool(broken[worst] > allowed and ours <= allowed)),
            Evidence("Monte Carlo", third, bool(beyond_it.min() >= 1.0)),
        ),
    )


def lemma_43(key: Key) -> Claim:
    """Nothing in the bound depends on K, and its exponent is wrong at K = 1."""
    n, N = 16, 10
    # all N runs hit one and the same atom +-n e_i, i >= 2: deviation^2 = n^2 + 1
    log_probability = log(2 * n - 2) - N * log(2 * n)
    log_printed = log(4) - 2 * N * (n**2 + 1) / (9 * n)
    rate = (log(2 * n), 2 * (n**2 + 1) / (9 * n))
    one = (
        f"A = H/sqrt(n), x0 = (1, .., 1)/sqrt(n), n = {n}, one step: all N runs hit one atom with "
        f"probability (2n - 2)(2n)^-N = {exp(log_probability):.1e} at N = {N}, the bound is "
        f"C {exp(log_printed):.1e}; per run the exponents are {rate[0]:.3f} and {rate[1]:.3f}, so "
        "that no C is large enough for all N."
    )
    A, x0 = hadamard(2) / np.sqrt(2.0), np.full(2, np.sqrt(0.5))
    system = System(A, np.zeros((2, 1)))
    runs, steps = 200_000, 8
    ran = simulate_ensemble(system, np.zeros((steps, 1)), x0, runs, rng=key)
    assert ran.variance is not None  # more than one run
    spread = ran.variance.sum(axis=1)
    expected = 2.0 ** (np.arange(steps + 1) + 1) - 1.0
    # tr S_k = 2^(k+1) - 1 and |xhat(k)|^2 = 2^(k+1) on every run: the sample value has an error
    # from the mean only
    close = bool(np.all(np.abs(spread - expected) <= 0.05 * expected))
    many = (
        f"n = 2, {runs} runs: N times the mean square error of the average grows as "
        f"{', '.join(f'{v:.3g}' for v in spread[[0, 1, 2, 4, 8]])} for K = 0, 1, 2, 4, 8, that is "
        "2^(K+1) - 1, while the bound does not depend on K."
    )
    return Claim(
        "Lemma 4.3",
        "P(||x(K) - mean of the runs|| > eps) <= 2 C [exp(..||u||^2 g(B)^2..) + exp(..||A||^2 "
        "g(x0)^2..) + exp(..||x0||^2 g(A)^2..)], the same for every K.",
        "false",
        "For K = 1: P(error > eps) <= 4 [exp(-2 N eps^2 / (9 ||u||^2 g(B)^2)) + exp(-2 N eps^2 / "
        "(9 g(A)^2 g(x0)^2))]. For K steps: P(error >= sqrt(tr S_K / N) + t) <= exp(-N t^2 / (2 "
        "R_K^2)) with R_0 = g(x0), R_{k+1} = g(A) R_k + sum_j |u_j(k)| ||b_j||_1.",
        (
            Evidence("exact", one, log_probability > log_printed and rate[0] < rate[1]),
            Evidence("Monte Carlo", many, close),
        ),
    )


def _second_moment(w: exact.Vector, q: list[Fraction]) -> Fraction:
    """``sum_i w_i^2 / q_i``."""
    return sum((x * x / p for x, p in zip(w, q, strict=True) if x != 0), exact.ZERO)


def _covers(q: list[Fraction], w: exact.Vector) -> bool:
    return all(p > 0 or x == 0 for p, x in zip(q, w, strict=True))


def _masses(n: int, parts: int) -> list[list[Fraction]]:
    """All probability vectors with denominators `parts`."""
    if n == 1:
        return [[Fraction(parts, parts)]]
    found: list[list[Fraction]] = []

    def fill(done: list[int], left: int) -> None:
        if len(done) == n - 1:
            found.append([Fraction(k, parts) for k in (*done, left)])
            return
        for k in range(left + 1):
            fill([*done, k], left - k)

    fill([], parts)
    return found
