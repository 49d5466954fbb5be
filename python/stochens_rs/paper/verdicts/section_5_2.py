"""Section 5.2 of the paper: what its text says of several steps, of the states, of their order."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from ...cases import random_system
from ...controls.fused import control
from ...ensembles.sampling import sample_counts
from ...rng import Key
from ...theory import dynamics
from .. import reachability
from . import rationals as exact
from .records import Claim, Evidence

if TYPE_CHECKING:
    from ...studies import Experiment

    Law = dict[exact.Vector, Fraction]


def one_step_only(key: Key) -> Claim:
    """Controls of several steps cannot be averaged, but estimates can be."""
    A, B = (exact.vector(1, 2), exact.vector(1, 1)), exact.vector(1, 1)
    x0, xf = exact.vector(1, 0), exact.vector(0, 1)
    mean = exact.vector(0, 0)
    one = exact.ZERO  # mean of the one-step controls B^+ (xf - A(s) x0), B^+ = B' / 2
    for p, first in exact.matrix_atoms(A):
        start = exact.apply(first, x0)
        one += p * exact.dot(B, exact.combine(exact.ONE, xf, -exact.ONE, start)) / 2
        for q, second in exact.matrix_atoms(A):
            u = _solve(exact.apply(second, B), B, xf, exact.apply(second, start))
            mean = exact.combine(exact.ONE, mean, p * q, u)
    free = exact.apply(A, exact.apply(A, x0))
    steered = exact.combine(mean[0], exact.apply(A, B), mean[1], B)
    state = exact.combine(exact.ONE, free, exact.ONE, steered)
    v = exact.dot(B, exact.combine(exact.ONE, xf, -exact.ONE, exact.apply(A, x0))) / 2
    text = (
        "A = [[1, 2], [1, 1]], B = (1, 1), x0 = (1, 0), xf = (0, 1), A drawn afresh for every run "
        f"and step: the mean of the least-squares controls of one step is {one}, v = {v}; the mean "
        f"of the controls that take the runs to xf in two steps takes the system to ({state[0]}, "
        f"{state[1]}), whatever the number of runs."
    )
    sizes, misses = (100, 10_000), []
    for N in sizes:
        relative = []
        for r in range(25):
            child = key.child(f"{r}")
            system = random_system(4, 2, rng=child.child("system"))
            ends = child.child("ends").generator().standard_normal((2, 4))
            A_hat = sample_counts(system.A, N, rng=child.child(f"A {N}"))
            plan = control((A_hat, system.B), ends[0], ends[1], steps=3)
            last = dynamics.states(system.A, system.B, ends[0], plan.u)[-1]
            relative.append(float(np.linalg.norm(last - ends[1]) / np.linalg.norm(ends[1])))
        misses.append(float(np.median(relative)))
    fused = (
        f"25 random systems with n = 4, m = 2, three steps, the control computed from one average "
        f"of N = {sizes[0]} and {sizes[1]} realizations of A: the relative miss is "
        f"{misses[0]:.2g} and {misses[1]:.2g} in the median."
    )
    return Claim(
        "Section 5.2, one step",
        '"the sample averaging method works for one time step controls only".',
        "holds with a correction",
        "True of averages of controls: those of several steps are not linear in A, and their mean "
        "is not the control, however many there are. Averages of realizations work for any number "
        "of steps: u = C_K(A_hat, B)^+ (xf_hat - A_hat^K x0_hat).",
        (
            Evidence("enumeration", text, one == v and exact.distance(state, xf) > 0),
            # 100 times the realizations: a tenth of the miss, were there no spread
            Evidence("Monte Carlo", fused, misses[1] < 0.3 * misses[0]),
        ),
    )


def _solve(a: exact.Vector, b: exact.Vector, xf: exact.Vector, free: exact.Vector) -> exact.Vector:
    """``(s, t)`` with ``s a + t b = xf - free``, by Cramer's rule."""
    y = exact.combine(exact.ONE, xf, -exact.ONE, free)
    det = a[0] * b[1] - a[1] * b[0]
    return (y[0] * b[1] - y[1] * b[0]) / det, (a[0] * y[1] - a[1] * y[0]) / det


def ordering(large: Experiment) -> Claim:
    """A better estimate can give a worse state."""
    w = exact.vector(2, 1, 1)
    a = exact.vector(1, 3, 3)  # A = diag(1, 3, 3), every realization of which is A
    reversed_share = exact.ZERO
    for p, samples in exact.sequences(w, 3):
        better = exact.combine(exact.ONE, exact.alse(samples, w), -exact.ONE, w)
        worse = exact.combine(exact.ONE, exact.mean(samples), -exact.ONE, w)
        states = [exact.dot(e, e) for e in (_scaled(a, better), _scaled(a, worse))]
        nearer = exact.dot(better, better) < exact.dot(worse, worse)
        reversed_share += p * (nearer and states[0] > states[1])
    text = (
        "x0 = (2, 1, 1), A = diag(1, 3, 3), B = I, all sequences of N = 3: with probability "
        f"{reversed_share} ALSE has the better estimate of x0 and the worse state."
    )
    orders = [large.facts["ordering"][panel] for panel in ("3a", "3b")]
    shares = [max(order["alse_above_slse"], order["slse_above_uniform"]) for order in orders]
    many = (
        f"n = {large.settings['n']}, m = {large.settings['m']}, {large.replicates} replicates: in "
        f"x(1) ALSE is above SLSE in {100 * orders[0]['alse_above_slse']:.2g} % of all pairs of a "
        f"replicate and a size, SLSE above uniform weights in "
        f"{100 * orders[0]['slse_above_uniform']:.2g} %; in x(2) it is "
        f"{100 * orders[1]['alse_above_slse']:.2g} % and "
        f"{100 * orders[1]['slse_above_uniform']:.2g} %."
    )
    return Claim(
        "Figure 3, order",
        '"the ordering given in Lemma 4.5 that holds for the estimation errors for the initial '
        'condition and the system matrix, may not hold for the computed states".',
        "holds with a correction",
        "It may not. For the estimation errors, too, SLSE <= uniform holds in the mean square "
        "only.",
        (
            Evidence("enumeration", text, reversed_share > 0),
            Evidence("experiment", many, min(shares) > 0.0),
        ),
    )


def _scaled(a: exact.Vector, e: exact.Vector) -> exact.Vector:
    return tuple(x * y for x, y in zip(a, e, strict=True))


def computed_states() -> Claim:
    """What Lemma 3.2 as printed would give is false; without bias the states do converge."""
    found = [reachability.lemma_3_2(N) for N in (2, 10, 1000)]
    missed = min(one.claim for one in found)
    text = (
        "The scalars of Lemma 3.2: every realization is taken to xf, and the averaged control "
        f"takes the system to A x0 + B u, which is {missed} from xf for N = 2, 10, 1000."
    )
    A = (exact.vector(1, 1), exact.vector(0, 1))
    x = exact.vector(1, 1), exact.vector(2, -1), exact.vector(1, 2)
    steps = [_errors(A, *ends) for ends in (x[:2], x[1:])]
    one = [_mean_square(law) for law in steps]
    carried = _mean_square({exact.apply(A, e): p for e, p in steps[0].items()})  # A is invertible
    squares = []
    for laws in (steps, [_average_of_two(law) for law in steps]):
        first, second = laws
        rolled = sum(
            p * q * exact.dot(e, e)
            for (d, p), (f, q) in product(first.items(), second.items())
            for e in [exact.combine(exact.ONE, exact.apply(A, d), exact.ONE, f)]
        )
        squares.append((_mean_square(first), rolled))
    expected = [(one[0] / N, (carried + one[1]) / N) for N in (1, 2)]
    unbiased = (
        "A = [[1, 1], [0, 1]], B = I, x(0), x(1), x(2) = (1, 1), (2, -1), (1, 2), all realizations "
        f"for N = 1 and 2: mean square errors of x(1) {squares[0][0]} and {squares[1][0]}, of x(2) "
        f"{squares[0][1]} and {squares[1][1]}, that is tr C_0 / N and tr(A C_0 A^T + C_1) / N."
    )
    return Claim(
        "Section 5.2, computed states",
        '"Using the idea of convergence of the computed control in Lemma 3.2, we can give similar '
        'results for the convergence of computed states".',
        "holds with a correction",
        "Not from Lemma 3.2, which is false. For realizations without bias the error that one step "
        "adds is e(t) = B (u(t) - v(t)), with mean 0 and covariance C_t / N, and e(t+1) + A e(t) "
        "after two: mean squares of order 1 / N.",
        (
            Evidence("exact", text, missed >= 1),
            Evidence(
                "enumeration", unbiased, squares == expected and one[0] == _formula(A, *x[:2])
            ),
        ),
    )


def _errors(A: exact.Matrix, start: exact.Vector, end: exact.Vector) -> Law:
    """Law of ``(x(t+1)(s) - A(s) x(t)(s)) - (x(t+1) - A x(t))`` of one realization, B = I."""
    law: Law = {}
    mu = exact.combine(exact.ONE, end, -exact.ONE, exact.apply(A, start))
    for (p, x), (q, M), (r, goal) in product(
        exact.atoms(start), exact.matrix_atoms(A), exact.atoms(end)
    ):
        y = exact.combine(exact.ONE, goal, -exact.ONE, exact.apply(M, x))
        e = exact.combine(exact.ONE, y, -exact.ONE, mu)
        law[e] = law.get(e, exact.ZERO) + p * q * r
    return law


def _average_of_two(law: Law) -> Law:
    """Law of the mean of two independent errors."""
    found: Law = {}
    for (d, p), (e, q) in product(law.items(), repeat=2):
        middle = exact.mean([d, e])
        found[middle] = found.get(middle, exact.ZERO) + p * q
    return found


def _mean_square(law: Law) -> Fraction:
    return sum((p * exact.dot(e, e) for e, p in law.items()), exact.ZERO)


def _formula(A: exact.Matrix, x0: exact.Vector, xf: exact.Vector) -> Fraction:
    """``tr C_0 = g(xf)^2 - ||xf||^2 + g(x0) sum_j |x0_j| g_j^2 - ||A x0||^2``."""
    gf, g0 = (sum((abs(v) for v in x), exact.ZERO) for x in (xf, x0))
    g = [sum((abs(v) for v in column), exact.ZERO) for column in zip(*A, strict=True)]
    moved = exact.apply(A, x0)
    drift = g0 * sum(abs(v) * h * h for v, h in zip(x0, g, strict=True)) - exact.dot(moved, moved)
    return gf**2 - exact.dot(xf, xf) + drift
