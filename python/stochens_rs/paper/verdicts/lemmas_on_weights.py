"""Sections 4.1 and 4.2 of the paper: least-squares weights, Lemmas 4.4 and 4.5."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from ..._base.numbers import ROUNDING, TINY
from ...ensembles.ensemble import Ensemble
from ...ensembles.sampling import sample
from ...fusion.fits import Fit
from ...fusion.fusing import fuse
from ...rng import Key
from .. import rationals as exact
from .comparison import Comparison
from .records import Claim, claim

_GAP = 1e-8  # of ||A||^2: ten times the default `tol` of `fuse`


def lemma_44() -> Claim:
    """The closed form is neither feasible nor optimal."""
    w, ones = exact.array([3, 4]), exact.array([1, 1])
    g = w.sum()
    S = sum(atom for _, atom in exact.atoms(w))  # each entry drawn once: column k is g e_k
    printed, corrected = (exact.square(S * y - w) for y in (w, w / g))
    # one sample: the only weight on the simplex is 1
    least, unseen = exact.square(exact.atoms(ones)[0][1] - ones), ones[1] ** 2
    texts = (
        f"w = (3, 4), each entry drawn once: the printed weights sum to {g} and give "
        f"||S y - w||^2 = {printed}, the corrected {corrected}.",
        f"w = (1, 1), one sample: the printed minimum is {unseen}, that of weights on the simplex "
        f"{least}.",
    )
    return claim(
        "Lemma 4.4",
        ("exact", texts[0], g != 1 and printed > corrected == 0),
        ("exact", texts[1], least > unseen),
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
    texts = (
        "A = [[1, 2], [2, 1]], realizations [[3, 3], [0, 0]] and [[0, 0], [3, 3]]: every entry was "
        f"hit, but the least squared error of weights on the simplex is {left}.",
        f"A = ones of order {n}, a hull of dimension d = {n * (n - 1)}: errors {errors}; the "
        f"target is in the hull from N = {first} on.",
    )
    return claim(
        "Remark after Lemma 4.4",
        ("exact", texts[0], left > 0),
        ("Monte Carlo", texts[1], first is not None and not fits[10].exact),
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
    texts = (
        "w = (1, 1, 1), each entry drawn once: F(1) = E_1, F(2) = E_2 and weights on the simplex "
        "keep the printed F(n) on the segment from E_1 to E_2 for every n, at a squared error of "
        f"{printed} or more. After three realizations it is {corrected} with "
        f"F(n) = v1 F(n-1) + v2 E_n, and {plain} with uniform weights.",
        "w = (2, 1, 1), all sequences: the mean square error of the printed F(n) is at least "
        f"{least} for every n, that of uniform weights V/3 = {V / 3} from n = 3 on at most; the "
        f"corrected F(3) has {squares}.",
    )
    return claim(
        "Lemma 4.5, recursion",
        ("exact", texts[0], printed > corrected == plain == 0),
        ("enumeration", texts[1], least > V / 3 >= squares),
    )


def first_inequality(key: Key) -> Claim:
    """ALSE is never worse than SLSE and uniform weights, and mostly better."""
    return claim(
        "Lemma 4.5, first inequality",
        ("enumeration", *_every_sequence()),
        ("Monte Carlo", *_random_ensembles(key)),
    )


def _every_sequence() -> tuple[str, bool]:
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
    text = (
        "w = (2, 1, 1), all sequences of N = 4: the corrected Lemma 4.4 gives the best weights on "
        "the simplex (it meets the condition of optimality), its squared error is never above "
        f"those of SLSE and uniform weights, and below both with probability {better}. The squared "
        f"error of `fuse` differs by at most {apart:.0e}."
    )
    return text, optimal and not worse and better > 0 and apart <= ROUNDING


def _random_ensembles(key: Key) -> tuple[str, bool]:
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
    text = (
        f"{cases} ensembles of a random 4 x 4 matrix: the weights are on the simplex; by at most "
        f"{excess / scale:.0e} of ||A||^2 the squared error exceeds the least one (gap recomputed "
        "from the weights) or the smaller one of SLSE and uniform weights; it is smaller than both "
        f"by 1 % or more on {strict} of them."
    )
    return text, feasible and excess <= _GAP * scale and 2 * strict > cases


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
    texts = (
        "Three realizations of [[1, 1], [2, 2]] whose plain mean is exact: SLSE ends at the "
        f"squared error {greedy}, uniform weights at {plain}.",
        f"w = (2, 1, 1), all sequences of N = 4: SLSE is worse than uniform weights with "
        f"probability {worse}. Mean squares after 1, 2, 3 realizations: "
        f"{', '.join(map(str, squares))}, at most V/n = {V}, {V / 2}, {V / 3}.",
        f"{len(comparison.slse)} runs up to N = {comparison.sizes[-1]}: SLSE is worse than uniform "
        f"weights on at most {100 * float(comparison.worse.max()):.2g} % of them at any N; its "
        f"mean square at the last N is {float(comparison.mean_square[-1]):.1e}, V/n is "
        f"{float(comparison.bound[-1]):.1e}.",
    )
    below = all(s <= V / n for n, s in enumerate(squares, start=1))
    return claim(
        "Lemma 4.5, second inequality",
        ("exact", texts[0], greedy > plain == 0),
        ("enumeration", texts[1], worse == Fraction(5, 32) and below),
        ("Monte Carlo", texts[2], np.all(z[1:] <= 4.0)),
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
    texts = (
        "A = [[4, -2], [1, 2]], realizations [[0, -4], [5, 0]] once and [[5, 0], [0, 4]] twice: "
        f"squared Frobenius errors {frobenius[0]} (ALSE and SLSE) and {frobenius[1]} (uniform), "
        f"2-norms {spectral[0]:.3f} and {spectral[1]:.3f}.",
        "w = (3, -1, 1), all sequences of N = 4, against SLSE and uniform weights, in the 1-norm "
        f"and the largest entry: ALSE is worse in {violated} of {count} comparisons, better in "
        f"{smaller}.",
    )
    return claim(
        "Lemma 4.5, norm",
        ("exact", texts[0], frobenius[0] < frobenius[1] and below[1] and not below[0]),
        ("enumeration", texts[1], violated == 0 < smaller),
    )
