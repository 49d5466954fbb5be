"""Section 2 of the paper: the ensemble system and its definitions."""

from __future__ import annotations

from fractions import Fraction

from ...cases import random_system
from ...rng import Key
from ...theory.exact import best_control
from .. import reachability
from . import rationals as exact
from .records import Claim, Evidence


def solution_formula() -> Claim:
    """Equation (3): products over one factor too many."""
    F = [exact.vector(1, 2), exact.vector(3, -1)], [exact.vector(0, 1), exact.vector(1, 1)]
    A = [tuple(F[0]), tuple(F[1]), (exact.vector(2, 0), exact.vector(1, -1))]
    x = exact.vector(1, -2)
    K = 2
    state = x
    for k in range(K):
        state = exact.apply(A[k], state)
    right, printed = A[0], A[0]
    for k in range(1, K):
        right = exact.matmul(A[k], right)
    for k in range(1, K + 1):
        printed = exact.matmul(A[k], printed)
    by = [exact.apply(product, x) for product in (right, printed)]
    text = (
        f"K = {K}, three integer matrices, u = 0: the recursion gives {_show(state)}, the product "
        f"of K factors {_show(by[0])}, the printed product of K + 1 factors {_show(by[1])}."
    )
    return Claim(
        "Definition 2.1, eq. (3)",
        "The state after K steps is prod_{k=0}^{K} A(k) x(0) + sum_k [prod_{i=k+1}^{K} A(i)] B(k) "
        "u(k).",
        "holds with a correction",
        "K steps have K factors: A(K-1) .. A(0) x(0) + sum_{k<K} A(K-1) .. A(k+1) B(k) u(k).",
        (Evidence("exact", text, state == by[0] and state != by[1]),),
    )


def index_maps() -> Claim:
    """Definition 2.2: a realization may be used once only."""
    A = (exact.vector(1, 2), exact.vector(-1, 1))
    square = exact.matmul(A, A)
    reused = [[exact.ZERO] * 2 for _ in range(2)]
    fresh = [[exact.ZERO] * 2 for _ in range(2)]
    realizations = exact.matrix_atoms(A)
    for p, one in realizations:
        _add(reused, p, exact.matmul(one, one))
        for q, other in realizations:
            _add(fresh, p * q, exact.matmul(other, one))
    bias = [[reused[i][j] - square[i][j] for j in range(2)] for i in range(2)]
    g = [sum(abs(A[i][j]) for i in range(2)) for j in range(2)]
    formula = [
        [(g[j] * abs(A[j][j]) if i == j else 0) - A[i][j] * A[j][j] for j in range(2)]
        for i in range(2)
    ]
    holds = tuple(map(tuple, fresh)) == square and bias == formula and any(map(any, bias))
    text = (
        f"A = [[1, 2], [-1, 1]]: over all realizations E[A(s) A(s)] - A^2 = {_rows(bias)} if one "
        "realization is used twice, and 0 if two are drawn."
    )
    return Claim(
        "Definition 2.2",
        "{M(s)} is a stochastic ensemble approximation of M if it is independent, bounded, and "
        "some weights on the simplex make its weighted sums converge to M in probability.",
        "holds with a correction",
        "The states of the runs are independent only if every index map is injective, s_A in run "
        "and time together; and convergence of a plain average needs realizations without bias, "
        "which the definition does not ask for. One realization used at two times has the bias "
        "diag(g_j |a_jj|) - A diag(a_jj).",
        (Evidence("enumeration", text, holds),),
    )


def approximate_reachability(key: Key) -> Claim:
    """Definition 2.3 as an experiment."""
    system = random_system(4, 4, rng=key.child("system"))
    gen = key.child("states").generator()
    x0, xf = gen.standard_normal(4), gen.standard_normal(4)
    found = reachability.approximately(system, x0, xf, 2, rng=key.child("runs"))
    errors = ", ".join(f"{error:.2g}" for error in found.errors)
    allowed = ", ".join(f"{radius:.2g}" for radius in found.radii)
    text = (
        f"Random system, n = m = 4, two steps, one open-loop control: the averages of "
        f"{', '.join(map(str, found.sizes))} runs miss xf by {errors}; allowed at 99 %: {allowed}. "
        f"Verdict: {found.verdict}."
    )
    return Claim(
        "Definition 2.3",
        "xf is approximately reachable if controls exist that drive every realization through "
        "its trajectory and the states after K steps are an ensemble approximation of xf.",
        "holds with a correction",
        "Every control drives a realization through some trajectory, so that the first condition "
        "excludes nothing. Meant is: controls can be chosen such that the weighted states after K "
        "steps converge to xf.",
        (Evidence("Monte Carlo", text, found.verdict == "approximately reachable"),),
    )


def sample_reachability(key: Key) -> Claim:
    """Definition 2.4 is much stronger than reachability."""
    n, m = 10, 5
    gen = key.generator()
    A, B, x0 = gen.standard_normal((n, n)), gen.standard_normal((n, m)), gen.standard_normal(n)
    xf = A @ x0 + B @ gen.standard_normal(m)
    one = best_control(A, B, x0, xf).reachability()
    every = reachability.sample_reachability((A, B), x0, xf)
    text = (
        f"Random system, n = {n}, m = {m}, xf = A x0 + B u: reachable (relative residual "
        f"{one.relative:.0e}), but {every.reachable_atoms} of {every.atoms} different realizations "
        f"are; what they miss has the root mean square {every.rms_residual:.3g}."
    )
    return Claim(
        "Definition 2.4",
        "xf is sample reachable in unit time if for every realization a control leads from x0(s) "
        "to xf(s).",
        "holds with a correction",
        "With m < n almost no realization is reachable even if xf is. The results on "
        "controls hold for least-squares controls.",
        (Evidence("enumeration", text, one.reachable and every.reachable_atoms == 0),),
    )


def _add(total: list[list[Fraction]], p: Fraction, matrix: exact.Matrix) -> None:
    for i, row in enumerate(matrix):
        for j, entry in enumerate(row):
            total[i][j] += p * entry


def _show(values: exact.Vector) -> str:
    return "(" + ", ".join(map(str, values)) + ")"


def _rows(matrix: list[list[Fraction]]) -> str:
    return "[" + ", ".join("[" + ", ".join(map(str, row)) + "]" for row in matrix) + "]"
