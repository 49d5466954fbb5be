"""Sections 4.1 and 4.2 of the paper: least-squares weights, Lemmas 4.4 and 4.5."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from stochens_rs import Ensemble, Fit, Key, fuse, sample

from .. import rationals as exact
from ..common import ROUNDING, TINY
from .comparison import Comparison
from .records import Claim, Outcome, claim, outcome

_GAP = 1e-8  # of ||A||^2: ten times the default `tol` of `fuse`


def lemma_44() -> Claim:
    """The closed form is neither feasible nor optimal."""
    w, ones = exact.array([3, 4]), exact.array([1, 1])
    g = w.sum()
    S = sum(atom for _, atom in exact.atoms(w))  # each entry drawn once: column k is g e_k
    printed, corrected = (exact.square(S * y - w) for y in (w, w / g))
    # one sample: the only weight on the simplex is 1
    least, unseen = exact.square(exact.atoms(ones)[0][1] - ones), ones[1] ** 2
    return claim(
        "Lemma 4.4",
        outcome(g != 1 and printed > corrected == 0, g=g, printed=printed, corrected=corrected),
        outcome(least > unseen, unseen=unseen, least=least),
    )


def exact_recovery(key: Key) -> Claim:
    """Matrices, too, are recovered exactly from a finite number of realizations."""
    n = 5
    A = np.ones((n, n))
    ensemble = sample(A, 400, rng=key)
    fits = {k: fuse(ensemble.prefix(k), "alse", target=A) for k in (10, 20, 40, 80, 160, 400)}
    first = next((k for k, fit in fits.items() if fit.exact), None)
    errors = ", ".join(
        f"{'0 to rounding' if fit.exact else f'{fit.error:.2g}'} (N = {k})"
        for k, fit in fits.items()
    )
    # both entries of both columns are hit, but always together
    together = [exact.array([[3, 3], [0, 0]]), exact.array([[0, 0], [3, 3]])]
    # two realizations: SLSE is the optimum of the segment
    left = exact.slse(together, exact.array([[1, 2], [2, 1]]))[-1]
    return claim(
        "Remark after Lemma 4.4",
        outcome(left > 0, left=left),
        outcome(
            first is not None and not fits[10].exact, n=n, d=n * (n - 1), errors=errors, first=first
        ),
    )


def recursion() -> Claim:
    """As printed, no realization after the second one enters."""
    w = exact.array([1, 1, 1])
    three = [atom for _, atom in exact.atoms(w)]
    printed = exact.square(exact.towards(three[1], three[0], w) - w)
    corrected, plain = exact.slse(three, w)[-1], exact.square(exact.mean(three) - w)
    hidden = exact.array([2, 1, 1])
    V = hidden.sum() ** 2 - exact.square(hidden)
    least = squares = exact.ZERO  # of the best point of each first segment; of SLSE after three
    for p, samples in exact.sequences(hidden, 3):
        least += p * exact.square(exact.towards(samples[1], samples[0], hidden) - hidden)
        squares += p * exact.slse(samples, hidden)[-1]
    return claim(
        "Lemma 4.5, recursion",
        outcome(
            printed > corrected == plain == 0, printed=printed, corrected=corrected, plain=plain
        ),
        outcome(least > V / 3 >= squares, least=least, third=V / 3, squares=squares),
    )


def first_inequality(key: Key) -> Claim:
    """ALSE is never worse than SLSE and uniform weights, and mostly better."""
    return claim("Lemma 4.5, first inequality", _every_sequence(), _random_ensembles(key))


def _every_sequence() -> Outcome:
    """The closed form of Lemma 4.4, corrected, for all sequences of a vector."""
    w = exact.array([2, 1, 1])
    apart, optimal, worse, better = 0.0, True, False, exact.ZERO
    for p, samples in exact.sequences(w, 4):
        best = exact.alse(samples, w)
        square = exact.square(best - w)
        # <F - w, E - F> >= 0 for all realizations E: no weights on the simplex do better
        optimal &= all((best - w) @ (E - best) >= 0 for E in samples)
        other = min(exact.slse(samples, w)[-1], exact.square(exact.mean(samples) - w))
        worse |= square > other
        better += p * (square < other)
        fit = fuse(Ensemble.from_samples(exact.floats(samples)), "alse", target=exact.floats(w))
        apart = max(apart, abs(_square(fit) - float(square)))
    return outcome(
        optimal and not worse and better > 0 and apart <= ROUNDING, better=better, apart=apart
    )


def _random_ensembles(key: Key) -> Outcome:
    """The weights of `fuse` for ensembles of a random matrix."""
    gen = key.generator()
    A = gen.standard_normal((4, 4))
    scale = float((A**2).sum())
    excess, strict, feasible, cases = 0.0, 0, True, 200
    for r in range(cases):
        ensemble = sample(A, int(gen.integers(1, 60)), rng=key.child(str(r)))
        y = fuse(ensemble, "alse", target=A).weights
        others = min(_square(fuse(ensemble, m, target=A)) for m in ("slse", "uniform"))
        # from the weights alone; gap = max of <gradient, y - z> over the simplex
        feasible &= bool(y.min() >= 0.0 and abs(y.sum() - 1.0) <= ROUNDING)
        S = ensemble.dense().reshape(len(y), -1)
        error = y @ S - A.ravel()
        found, inner = float(error @ error), S @ error
        excess = max(excess, 2.0 * float(y @ inner - inner.min()), found - others)
        strict += found < 0.99 * others
    return outcome(
        feasible and excess <= _GAP * scale and 2 * strict > cases,
        cases=cases,
        excess=excess / scale,
        strict=strict,
    )


def second_inequality(comparison: Comparison) -> Claim:
    """SLSE is better than uniform weights in the mean square, not on every run."""
    w = exact.array([2, 1, 1])
    V = w.sum() ** 2 - exact.square(w)
    worse = exact.ZERO
    for p, samples in exact.sequences(w, 4):
        worse += p * (exact.slse(samples, w)[-1] > exact.square(exact.mean(samples) - w))
    # mean squares after 1, 2, 3 realizations
    squares = exact.expectation(
        (p, exact.array(exact.slse(s, w))) for p, s in exact.sequences(w, 3)
    )
    A = exact.array([[1, 1], [2, 2]])
    three = exact.array([[[0, 0], [3, 3]], [[3, 0], [0, 3]], [[0, 3], [3, 0]]])
    greedy, plain = exact.slse(three, A)[-1], exact.square(exact.mean(three) - A)
    z = (comparison.mean_square - comparison.bound) / comparison.standard_error.clip(TINY)
    below = all(s <= V / n for n, s in enumerate(squares, start=1))
    return claim(
        "Lemma 4.5, second inequality",
        outcome(greedy > plain == 0, greedy=greedy, plain=plain),
        outcome(
            worse == Fraction(5, 32) and below,
            worse=worse,
            squares=squares,
            V=V,
            half=V / 2,
            third=V / 3,
        ),
        outcome(
            np.all(z[1:] <= 4.0),
            runs=len(comparison.slse),
            last=comparison.sizes[-1],
            worse=100 * comparison.worse.max(),
            square=comparison.mean_square[-1],
            bound=comparison.bound[-1],
        ),
    )


def _square(fit: Fit) -> float:
    assert fit.error is not None  # a target was given
    return fit.error**2


def norms() -> Claim:
    """The order of least-squares errors is one of Frobenius norms."""
    A = exact.array([[4, -2], [1, 2]])
    good, other = exact.array([[0, -4], [5, 0]]), exact.array([[5, 0], [0, 4]])
    best = exact.towards(good, other, A)  # two different realizations: the optimum of the segment
    errors = [one - A for one in (best, exact.mean([good, other, other]))]
    frobenius = [exact.square(error) for error in errors]
    spectral = [float(np.linalg.norm(exact.floats(error), 2)) for error in errors]
    below = [exact.spectral_at_most(error, exact.ONE) for error in errors]
    w = exact.array([3, -1, 1])
    violated, smaller, count = 0, 0, 0
    for _, samples in exact.sequences(w, 4):
        alse = abs(exact.alse(samples, w) - w)
        for estimate in (exact.slse_path(samples, w)[-1], exact.mean(samples)):
            off = abs(estimate - w)
            for a, b in ((alse.sum(), off.sum()), (alse.max(), off.max())):
                violated, smaller, count = violated + (a > b), smaller + (a < b), count + 1
    return claim(
        "Lemma 4.5, norm",
        outcome(
            frobenius[0] < frobenius[1] and below[1] and not below[0],
            frobenius=frobenius,
            spectral=spectral,
        ),
        outcome(violated == 0 < smaller, violated=violated, count=count, smaller=smaller),
    )
