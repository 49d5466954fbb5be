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
from . import rationals as exact
from .comparison import Comparison
from .records import Claim, Evidence

_GAP = 1e-8  # of ||A||^2: ten times the default `tol` of `fuse`


def lemma_44() -> Claim:
    """The closed form is neither feasible nor optimal."""
    w = exact.vector(3, 4)
    g = sum(w, exact.ZERO)
    (_, first), (_, second) = exact.atoms(w)
    printed = exact.distance(exact.combine(w[0], first, w[1], second), w)
    corrected = exact.distance(exact.combine(w[0] / g, first, w[1] / g, second), w)
    ones = exact.vector(1, 1)
    # one sample: the only weight on the simplex is 1
    least, unseen = exact.distance(exact.atoms(ones)[0][1], ones), ones[1] ** 2
    texts = (
        f"w = (3, 4), each entry drawn once: the printed weights sum to {g} and give "
        f"||S y - w||^2 = {printed}, the corrected {corrected}.",
        f"w = (1, 1), one sample: the printed minimum is {unseen}, that of weights on the simplex "
        f"{least}.",
    )
    return Claim(
        "Lemma 4.4",
        "A minimiser of ||S y - w||^2 on the simplex is y_j = |w_k| / n_k, where sample j has hit "
        "entry k and n_k samples have; the minimum is the sum of w_i^2 over the entries not hit.",
        "false",
        "y_j = Y_k / n_k with Y_k = |w_k| / g + d / #hit, d = sum of |w_i| / g over the entries "
        "not hit; the minimum is sum w_i^2 over those + (g d)^2 / #hit. The printed minimum is "
        "that of weights with a sum of at most one.",
        (
            Evidence("exact", texts[0], g != 1 and printed > corrected == 0),
            Evidence("exact", texts[1], least > unseen),
        ),
    )


def exact_recovery(key: Key) -> Claim:
    """Matrices are recovered exactly, too, from a finite number of realizations."""
    n = 5
    A = np.ones((n, n))
    ensemble = sample(A, 400, rng=key)
    fits = {k: fuse(ensemble.prefix(k), "alse", target=A) for k in (10, 20, 40, 80, 160, 400)}
    first = next((k for k, fit in fits.items() if fit.exact), None)
    errors = ", ".join(f"{fit.error:.1e} (N = {k})" for k, fit in fits.items())
    # both entries of both columns are hit, but always together: [[1, 2], [2, 1]], by rows
    together = [exact.vector(3, 3, 0, 0), exact.vector(0, 0, 3, 3)]
    left = exact.slse(together, exact.vector(1, 2, 2, 1))[-1]  # two: the optimum of the segment
    apart = (
        "A = [[1, 2], [2, 1]], realizations [[3, 3], [0, 0]] and [[0, 0], [3, 3]]: every entry was "
        f"hit, but the least squared error of weights on the simplex is {left}."
    )
    text = (
        f"A = ones of order {n}, a hull of dimension d = {n * (n - 1)}: errors {errors}; the "
        f"target is in the hull from N = {first} on."
    )
    return Claim(
        "Remark after Lemma 4.4",
        "That the target is recovered exactly once every entry was hit does not translate to "
        "matrices.",
        "holds with a correction",
        "Hitting every entry is not enough, but a matrix is recovered exactly as well, at a finite "
        "N: as soon as it lies in the convex hull of the realizations, which for symmetric columns "
        "happens near N = 2 d (Wendel). With weights for every column it is the vector case.",
        (
            Evidence("exact", apart, left > 0),
            Evidence("Monte Carlo", text, first is not None and not fits[10].exact),
        ),
    )


def recursion() -> Claim:
    """As printed, no realization after the second one enters."""
    w = exact.vector(1, 1, 1)
    three = [atom for _, atom in exact.atoms(w)]
    printed = exact.distance(exact.towards(three[1], three[0], w), w)
    corrected, plain = exact.slse(three, w)[-1], exact.distance(exact.mean(three), w)
    hidden = exact.vector(2, 1, 1)
    V = sum(hidden, exact.ZERO) ** 2 - exact.dot(hidden, hidden)
    least = exact.ZERO  # the mean square error of the best point of each first segment
    squares = exact.ZERO  # that of SLSE after three realizations
    for p, samples in exact.sequences(hidden, 3):
        nearest = exact.towards(samples[1], samples[0], hidden)
        least += p * exact.distance(nearest, hidden)
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
    return Claim(
        "Lemma 4.5, recursion",
        '"F(n) = v1* F(n-1) + v2* F(n-2) starting from F(1) = E_1, F(2) = E_2".',
        "false",
        "F(n) = v1 F(n-1) + v2 E_n from F(1) = E_1 on, with the weights of the line search from "
        "F(n-1) to E_n.",
        (
            Evidence("exact", texts[0], printed > corrected == plain == 0),
            Evidence("enumeration", texts[1], least > V / 3 >= squares),
        ),
    )


def first_inequality(key: Key) -> Claim:
    """ALSE is never worse than SLSE and uniform weights, and mostly better."""
    w = exact.vector(2, 1, 1)
    target = np.array(w, dtype=float)
    apart = excess = 0.0
    optimal, worse, better = True, False, exact.ZERO
    for p, samples in exact.sequences(w, 4):
        best = exact.alse(samples, w)
        square = exact.distance(best, w)
        # <F - w, E - F> >= 0 for all realizations E: no weights on the simplex do better
        off = exact.combine(exact.ONE, best, -exact.ONE, w)
        optimal &= all(exact.dot(off, E) >= exact.dot(off, best) for E in samples)
        slse, mean = exact.slse(samples, w)[-1], exact.distance(exact.mean(samples), w)
        worse |= square > min(slse, mean)
        better += p * (square < min(slse, mean))
        fit = fuse(Ensemble.from_samples(np.array(samples, dtype=float)), "alse", target=target)
        apart = max(apart, abs(_square(fit) - float(square)))
    gen = key.generator()
    A = gen.standard_normal((4, 4))
    scale = float((A**2).sum())
    strict, feasible, cases = 0, True, 200
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
    texts = (
        "w = (2, 1, 1), all sequences of N = 4: the corrected Lemma 4.4 gives the best weights on "
        "the simplex (it meets the condition of optimality), its squared error is never above "
        f"those of SLSE and uniform weights, and below both with probability {better}. The squared "
        f"error of `fuse` differs by at most {apart:.0e}.",
        f"{cases} ensembles of a random 4 x 4 matrix: the weights are on the simplex; by at most "
        f"{excess / scale:.0e} of ||A||^2 the squared error exceeds the least one (gap recomputed "
        "from the weights) or the smaller one of SLSE and uniform weights; it is smaller than both "
        f"by 1 % or more on {strict} of them.",
    )
    return Claim(
        "Lemma 4.5, first inequality",
        "||E* - F_ALSE|| <= ||E* - F_SLSE||.",
        "holds",
        "",
        (
            Evidence(
                "enumeration", texts[0], optimal and not worse and better > 0 and apart <= ROUNDING
            ),
            Evidence(
                "Monte Carlo", texts[1], feasible and excess <= _GAP * scale and 2 * strict > cases
            ),
        ),
    )


def second_inequality(comparison: Comparison) -> Claim:
    """SLSE is better than uniform weights in the mean square, not on every run."""
    w = exact.vector(2, 1, 1)
    worse = exact.ZERO
    for p, samples in exact.sequences(w, 4):
        if exact.slse(samples, w)[-1] > exact.distance(exact.mean(samples), w):
            worse += p
    squares = [exact.ZERO] * 3
    for p, samples in exact.sequences(w, 3):
        for k, error in enumerate(exact.slse(samples, w)):
            squares[k] += p * error
    V = exact.dot(w, w) * -1 + sum(w, exact.ZERO) ** 2
    A = exact.vector(1, 1, 2, 2)  # by rows; three of its realizations
    three = [exact.vector(*s) for s in ((0, 0, 3, 3), (3, 0, 0, 3), (0, 3, 3, 0))]
    greedy, plain = exact.slse(three, A)[-1], exact.distance(exact.mean(three), A)
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
    return Claim(
        "Lemma 4.5, second inequality",
        "||E* - F_SLSE|| <= ||E* - F_uniform|| for every sequence of realizations.",
        "false",
        "In the mean square: E d_n^2 <= V/n for every n, V the variance of one realization, and "
        "E d_n^2 <= V q^(n-1) with a q < 1 that depends on E*. For every sequence: N <= 2; or with "
        'one more line search towards the running average ("slse-safeguarded").',
        (
            Evidence("exact", texts[0], greedy > plain == 0),
            Evidence(
                "enumeration",
                texts[1],
                worse == Fraction(5, 32) and all(s <= V / (k + 1) for k, s in enumerate(squares)),
            ),
            Evidence("Monte Carlo", texts[2], bool(np.all(z[1:] <= 4.0))),
        ),
    )


def _square(fit: Fit) -> float:
    assert fit.error is not None  # a target was given
    return fit.error**2


def norms() -> Claim:
    """The order of least-squares errors is one of Frobenius norms."""
    A = exact.vector(4, -2, 1, 2)  # by rows, as are its realizations
    good, other = exact.vector(0, -4, 5, 0), exact.vector(5, 0, 0, 4)
    best = exact.towards(good, other, A)  # two different realizations: the optimum of the segment
    mean = exact.mean([good, other, other])
    frobenius = [exact.distance(one, A) for one in (best, mean)]
    errors = [_square_matrix(exact.combine(exact.ONE, one, -exact.ONE, A)) for one in (best, mean)]
    below = [exact.spectral_at_most(error, exact.ONE) for error in errors]
    w = exact.vector(3, -1, 1)
    violated, smaller, count = 0, 0, 0
    for _, samples in exact.sequences(w, 4):
        alse = exact.combine(exact.ONE, exact.alse(samples, w), -exact.ONE, w)
        for estimate in (exact.slse_path(samples, w)[-1], exact.mean(samples)):
            off = exact.combine(exact.ONE, estimate, -exact.ONE, w)
            for norm in (_one_norm, _largest):
                violated += norm(alse) > norm(off)
                smaller += norm(alse) < norm(off)
                count += 1
    texts = (
        "A = [[4, -2], [1, 2]], realizations [[0, -4], [5, 0]] once and [[5, 0], [0, 4]] twice: "
        f"squared Frobenius errors {frobenius[0]} (ALSE and SLSE) and {frobenius[1]} (uniform), "
        f"2-norms {_spectral(errors[0]):.3f} and {_spectral(errors[1]):.3f}.",
        "w = (3, -1, 1), all sequences of N = 4, against SLSE and uniform weights, in the 1-norm "
        f"and the largest entry: ALSE is worse in {violated} of {count} comparisons, better in "
        f"{smaller}.",
    )
    return Claim(
        "Lemma 4.5, norm",
        "The order ||E* - F_ALSE|| <= ||E* - F_SLSE|| <= ||E* - F_uniform||, for x0, xf and A in "
        "one norm that is not named; the weights minimise || ||_2^2.",
        "holds with a correction",
        "For matrices || || is the Frobenius norm, which least-squares weights minimise; in the "
        "2-norm ALSE and SLSE can both be worse than uniform weights. For realizations of a vector "
        "ALSE is best in every p-norm at once.",
        (
            Evidence("exact", texts[0], frobenius[0] < frobenius[1] and below[1] and not below[0]),
            Evidence("enumeration", texts[1], violated == 0 < smaller),
        ),
    )


def _square_matrix(rows: exact.Vector) -> exact.Matrix:
    return rows[:2], rows[2:]


def _spectral(M: exact.Matrix) -> float:
    return float(np.linalg.norm(np.array(M, dtype=float), 2))


def _one_norm(x: exact.Vector) -> Fraction:
    return sum((abs(v) for v in x), exact.ZERO)


def _largest(x: exact.Vector) -> Fraction:
    return max(abs(v) for v in x)
