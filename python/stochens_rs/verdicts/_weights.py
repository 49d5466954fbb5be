"""Section 4.2 of the paper: least-squares weights, the streaming algorithm, their comparison."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from .._exact import one_step
from ..fusing import fuse
from ..results import Fit
from ..rng import Key
from ..sampling import sample
from . import _exact as exact
from .comparison import Comparison
from .records import Claim, Evidence


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


def first_inequality(key: Key) -> Claim:
    """ALSE is never worse than SLSE and uniform weights."""
    gen = key.generator()
    A = gen.standard_normal((4, 4))
    worst, cases = -np.inf, 200
    for r in range(cases):
        ensemble = sample(A, int(gen.integers(1, 60)), rng=key.child(str(r)))
        best = fuse(ensemble, "alse", target=A)
        slse = fuse(ensemble, "slse", target=A)
        mean = fuse(ensemble, "uniform", target=A)
        optimum, others = _square(best) - (best.gap or 0.0), min(_square(slse), _square(mean))
        worst = max(worst, optimum - others)
    text = (
        f"{cases} ensembles of a random 4 x 4 matrix: the squared ALSE error less its certified "
        f"gap exceeds the smaller one of SLSE and uniform by at most {worst:.1e}."
    )
    return Claim(
        "Lemma 4.5, first inequality",
        "||E* - F_ALSE|| <= ||E* - F_SLSE||.",
        "holds",
        "",
        (Evidence("Monte Carlo", text, worst <= 1e-12),),
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
    z = (comparison.mean_square - comparison.bound) / comparison.standard_error.clip(1e-300)
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


def algorithm_1(key: Key) -> Claim:
    """The printed loop stops at a useless sample and does not converge."""
    from ..streaming import Stream

    n, m, runs, steps = 10, 5, 40, 2000
    gen = key.generator()
    A, B, x0 = gen.standard_normal((n, n)), gen.standard_normal((n, m)), gen.standard_normal(n)
    A /= np.abs(np.linalg.eigvals(A)).max()
    xf = gen.standard_normal(n)
    v = one_step(A, B, x0, xf).u
    errors: dict[str, list[float]] = {"consistent": [], "literal": []}
    stops: list[tuple[int, float]] = []

    def error(stream: Stream) -> float:
        return float(np.linalg.norm(stream.u - v) / np.linalg.norm(v))

    for r in range(runs):
        for variant, kept in errors.items():
            stream = Stream(
                B,
                x0=x0,
                xf=xf,
                A=A,
                rng=key.child(str(r)),
                variant="consistent" if variant == "consistent" else "literal",
            )
            stream.step(steps)
            kept.append(error(stream))
        printed = Stream(B, x0=x0, xf=xf, A=A, rng=key.child(str(r)), variant="literal")
        if printed.run(tol=1e-9, max_steps=steps, rule="printed").status == "interrupted":
            raise KeyboardInterrupt  # half a run is of no use
        stops.append((printed.steps, error(printed)))
    stop, left = np.median(stops, axis=0)
    literal, consistent = (float(np.median(errors[k])) for k in ("literal", "consistent"))
    texts = (
        f"n = {n}, m = {m}, {runs} runs of {steps} steps: median relative error of the control "
        f"{literal:.2g} as printed (old and new: the last two realizations), {consistent:.2g} with "
        "fused estimates in all slots.",
        f"errorBound 1e-9: the printed rule stops after {stop:g} steps in the median, at a median "
        f"relative error of {left:.2g}.",
    )
    return Claim(
        "Algorithm 1",
        "Replacing one of x0(s), xf(s), A(s) at a time, v <- w1 v + w2 v' with the weights of a "
        "line search, until ||(w1 - 1) v + w2 v'|| falls below errorBound, computes the control.",
        "false",
        "Keep the fused estimates and put the new sample into its slot, with the fused values in "
        "the other two: then v = B^+ (Ff - FA F0) holds exactly after every step, and v "
        "converges. The printed error is the length of the last change, which is 0 after every "
        "sample that does not help; sound is ||P [(Ff - xf) - A (F0 - x0)]|| + ||FA - A|| ||F0||.",
        (
            Evidence("Monte Carlo", texts[0], literal > 0.5 and consistent < 0.2 * literal),
            Evidence("Monte Carlo", texts[1], bool(stop <= 50 and left > 0.5)),
        ),
    )
