"""Section 3 of the paper: Lemmas 3.1 and 3.2, and what it says after each."""

from __future__ import annotations

from fractions import Fraction
from itertools import product

from .. import reachability
from . import rationals as exact
from .records import Claim, Evidence


def lemma_31() -> Claim:
    """Reachability does not imply approximate reachability as defined."""
    found = [reachability.lemma_3_1(N) for N in (3, 10, 1000)]
    found.append(reachability.lemma_3_1(5, weights=[1, 0, 2, 0, 7], controls=[1, 2, 3, 4, 5]))
    text = (
        "n = 2, m = 1, one good realization each of x0, A and B, zeros otherwise; xf is reached by "
        f"the exact system. Every weighted final state misses it by at least {_least(found)}, for "
        f"{len(found)} choices of N, weights and controls."
    )
    return Claim(
        "Lemma 3.1",
        "If xf is reachable in K steps, it is approximately reachable under every stochastic "
        "ensemble approximation of x0, A and B.",
        "false",
        "True for independent, bounded realizations without bias: then the average of N runs has "
        "the mean x(K) and the mean square error tr(S_K) / N. For approximations in general, "
        "weights of their own for every step are needed: F(k+1) = A_hat F(k) + B_hat u(k).",
        (Evidence("exact", text, _refutes(found)),),
    )


def remark_31() -> Claim:
    """Reachability does not require approximate reachability."""
    N = 10
    found = [
        reachability.lemma_3_1(N, weights=[int(k == s) for k in range(N)], controls=[u] * N)
        for s in range(N)
        for u in (-1, 0, 1)
    ]
    found.append(reachability.lemma_3_1(N))
    text = (
        f"The system of Lemma 3.1, N = {N}: each run alone, with the controls -1, 0 and 1, and "
        f"the mean of all end at least {_least(found)} from xf. A control moves a run only "
        "along the line of B, and weighted sums are convex, so the same is true for all weights "
        "and controls. xf is reached by u = 0."
    )
    return Claim(
        "Remark after Lemma 3.1",
        '"the desired state xf is reachable from x0 only if xf is approximately reachable from '
        'x0".',
        "false",
        "Approximate reachability is not necessary for reachability, under Definition 2.2. It is "
        "for independent realizations without bias: the same controls take the mean of the runs "
        "to xf.",
        (Evidence("exact", text, _refutes(found)),),
    )


def lemma_32() -> Claim:
    """Averaged controls need not approach the control."""
    found = [reachability.lemma_3_2(N) for N in (2, 10, 1000)]
    found.append(reachability.lemma_3_2(5, weights=[1, 0, 2, 0, 7]))
    text = (
        "Scalars x0 = A = B = 1, xf = 0, so that v = -1; one good realization each, zeros "
        f"otherwise. u(s) = 0 takes every realization to xf; the weighted sum of these controls is "
        f"off by {_least(found)}, for {len(found)} choices of N and weights."
    )
    return Claim(
        "Lemma 3.2",
        "If xf is sample reachable, some weighted sums of the controls converge to the control v "
        "in probability (as B v).",
        "false",
        "True with product weights: u = B^+ (xf_hat - A_hat x0_hat), each estimate with weights of "
        "its own, for which B (v - u) = P [(xf - xf_hat) - A (x0 - x0_hat) - (A - A_hat) x0_hat]; "
        "and with uniform weights for realizations without bias. The three weight vectors of the "
        "proof cannot share one index, and its last inequality must read P1 + P2 + P3 - 2.",
        (Evidence("exact", text, _refutes(found)),),
    )


def remark_32_reachable() -> Claim:
    """Sample reachable implies reachable only for realizations without bias."""
    found = [reachability.remark_3_2(N) for N in (2, 10, 1000)]
    text = (
        "Scalars x0 = A = 1, xf = 0, B = 0; one good realization each of x0 and A, zeros "
        "otherwise. A(s) x0(s) = 0 = xf(s) for every s, with any control; the only state in reach "
        f"is A x0, and it is {_least(found)} from xf."
    )
    reached, missed = _sample_reachable()
    unbiased = (
        "The realizations of Lemma 4.1, all A, x0, xf with n = 2 and entries -1, 0, 1, B = (1, 0) "
        f"and B = (1, 1): {reached + missed} targets are sample reachable, {missed} of them not "
        "reachable."
    )
    return Claim(
        "Remark after Lemma 3.2, reachable",
        '"if xf is sample reachable from x0 in unit time, xf is also reachable".',
        "false",
        "True for independent realizations without bias: xf - A x0 is the mean of vectors in the "
        "range of B, which is closed and convex. Definition 2.2 does not ask for that.",
        (
            Evidence("exact", text, _refutes(found)),
            Evidence("enumeration", unbiased, reached > 0 and missed == 0),
        ),
    )


def _sample_reachable() -> tuple[int, int]:
    """Of all small targets that are sample reachable: how many are reachable, and how many not."""
    vectors = [exact.vector(*x) for x in product((-1, 0, 1), repeat=2)]
    atoms = {x: [atom for _, atom in exact.atoms(x)] for x in vectors}
    reached = missed = 0
    # what no control moves: the second entry for B = (1, 0), the difference for B = (1, 1)
    for normal in (exact.vector(0, 1), exact.vector(1, -1)):
        goals = [(exact.dot(normal, x), {exact.dot(normal, y) for y in atoms[x]}) for x in vectors]
        for columns, x0 in product(product(vectors, repeat=2), vectors):
            # normal' A(s) x0(s), over the atoms of the columns that the entries of x0(s) meet
            heights = {
                exact.dot(normal, atom) * hit
                for x in atoms[x0]
                for column, hit in zip(columns, x, strict=True)
                for atom in atoms[column]
                if hit or not any(x)
            }
            A = tuple(zip(*columns, strict=True))
            mean = exact.dot(normal, exact.apply(A, x0))
            for height, all_of_them in goals:
                if heights == all_of_them and len(heights) == 1:
                    reached, missed = reached + (height == mean), missed + (height != mean)
    return reached, missed


def remark_32_any() -> Claim:
    """Not even plain averages of independent realizations are enough."""
    x0 = A = exact.ONE
    sizes = (2, 10, 1000)
    least: list[Fraction] = []
    averages: list[Fraction] = []
    for N in sizes:
        starts, matrices = _alternating(N)
        averages += [abs(sum(s, exact.ZERO) / N - 1) for s in (starts, matrices)]
        # B = 1, xf = xf(s) = 0: u(s) = -A(s) x0(s) for each s, and v = -A x0; a convex sum of the
        # u(s) is no nearer to v than the nearest of them, if all are on one side of it
        controls = [-a * x for a, x in zip(matrices, starts, strict=True)]
        least.append(min(controls) - (-A * x0))
    text = (
        "Scalars x0 = A = B = 1, xf = 0; x0(s) = 2, 0, 2, 0, .. and A(s) = 0, 2, 0, 2, .. are "
        "bounded and independent, as constants are, and their plain averages over N = "
        f"{', '.join(map(str, sizes))} are off by {max(averages)}. Every weighted "
        f"sum of the controls is off by at least {min(least)}."
    )
    return Claim(
        "Remark after Lemma 3.2, any sequence",
        '"the claim in Lemma 3.2 works for any sequence of random variables that form stochastic '
        'ensemble approximations as defined in Definition 2.2".',
        "false",
        "Not even where plain averages approximate x0, A and xf. Each realization has to be "
        "without bias, or the estimates have to be averaged before they are multiplied.",
        (Evidence("exact", text, not any(averages) and min(least) >= 1),),
    )


def _alternating(N: int) -> tuple[list[Fraction], list[Fraction]]:
    """x0(s) and A(s): never both different from 0."""
    return [Fraction(2 * (s % 2 == 0)) for s in range(N)], [Fraction(2 * (s % 2)) for s in range(N)]


def _least(found: list[reachability.Counterexample]) -> Fraction:
    return min(one.claim for one in found)


def _refutes(found: list[reachability.Counterexample]) -> bool:
    """All that the lemma assumes holds exactly, and its claim fails by 1 or more."""
    assumed = [x for one in found for x in (one.hypothesis, *one.approximation_errors.values())]
    return not any(assumed) and _least(found) >= 1
