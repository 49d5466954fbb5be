"""Section 2 of the paper: the ensemble system and its definitions."""

from __future__ import annotations

from functools import reduce
from itertools import product

import numpy as np

from stochens_rs import Key, control, simulate_ensemble
from stochens_rs.cases import random_system
from stochens_rs.theory.moments import trajectory_rms

from .. import rationals as exact
from ..common import REACHABLE, ROUNDING, Floats
from .records import Claim, Outcome, claim, outcome


def solution_formula() -> Claim:
    """Equation (3): its products have one factor too many."""
    A = [exact.array(M) for M in ([[1, 2], [3, -1]], [[0, 1], [1, 1]], [[2, 0], [1, -1]])]
    x, K = exact.array([1, -2]), 2
    state = x
    for factor in A[:K]:
        state = factor @ state
    right, printed = (_product(A[:factors]) @ x for factors in (K, K + 1))
    confirms = np.array_equal(state, right) and not np.array_equal(state, printed)
    return claim(
        "Definition 2.1, eq. (3)", outcome(confirms, K=K, state=state, right=right, printed=printed)
    )


def _product(factors: list[exact.Array]) -> exact.Array:
    """``A(k) .. A(0)``."""
    return reduce(lambda later, A: A @ later, factors)


def index_maps() -> Claim:
    """Definition 2.2: a realization may be used only once."""
    A = exact.array([[1, 2], [-1, 1]])
    law = exact.matrix_atoms(A)
    reused = exact.expectation((p, one @ one) for p, one in law)
    fresh = exact.expectation((p * q, other @ one) for p, one in law for q, other in law)
    bias = reused - A @ A
    # diag(g_j |a_jj|) - A diag(a_jj)
    formula = np.diag(abs(A).sum(axis=0) * abs(np.diag(A))) - A * np.diag(A)
    rows = ", ".join(f"[{', '.join(map(str, row))}]" for row in bias)
    confirms = np.array_equal(fresh, A @ A) and np.array_equal(bias, formula) and bias.any()
    return claim("Definition 2.2", outcome(confirms, rows=rows))


def approximate_reachability(key: Key) -> Claim:
    """Definition 2.3 as an experiment."""
    system = random_system(4, 4, rng=key.child("system"))
    gen = key.child("states").generator()
    x0, xf = gen.standard_normal(4), gen.standard_normal(4)
    u = control(system, x0, xf, steps=2).u
    # run s depends on (key, s) only: N runs are the first of more
    own, sizes = key.child("runs"), np.array([10, 100, 1000])
    ends = [simulate_ensemble(system, x0, u, int(N), rng=own).mean[-1] for N in sizes]
    errors = np.linalg.norm(np.array(ends) - xf, axis=1)
    rms = trajectory_rms(system, x0, u)[-1] / np.sqrt(sizes)
    return claim(
        "Definition 2.3",
        _any_control(),
        outcome(np.all(errors <= 5.0 * rms), sizes=sizes, errors=errors, rms=rms),
    )


def _any_control() -> Outcome:
    """All realizations of two steps under several controls: only one of them leads to xf."""
    A, b, x0 = exact.array([[1, 2], [-1, 1]]), exact.array([1, -2]), exact.array([1, 1])
    chosen, others = (1, -1), ((0, 0), (1, 1), (-1, 1))
    xf = A @ (A @ x0 + chosen[0] * b) + chosen[1] * b
    matrices, inputs = exact.matrix_atoms(A), exact.atoms(b)
    runs = 0
    means = {u: exact.array([0, 0]) for u in (chosen, *others)}
    for (p, start), (q, M0), (r, b0), (s, M1), (t, b1) in product(
        exact.atoms(x0), matrices, inputs, matrices, inputs
    ):
        runs += 1
        for u in means:
            means[u] = means[u] + p * q * r * s * t * (M1 @ (M0 @ start + u[0] * b0) + u[1] * b1)
    missed = {u: exact.square(mean - xf) for u, mean in means.items()}
    return outcome(
        missed[chosen] == 0 and all(missed[u] > 0 for u in others),
        runs=runs,
        chosen=chosen,
        others=[str(u) for u in others],
        xf=xf,
        missed=list(missed.values()),
    )


def sample_reachability(key: Key) -> Claim:
    """Definition 2.4 is much stronger than reachability."""
    n, m = 10, 5
    gen = key.generator()
    A, B, x0 = gen.standard_normal((n, n)), gen.standard_normal((n, m)), gen.standard_normal(n)
    xf = A @ x0 + B @ gen.standard_normal(m)
    one = control((A, B), x0, xf).reachability
    atoms, reached, rms = _realizations(A, B, x0, xf)
    residual = f"{one.relative:.0e}" if one.relative > ROUNDING else "0 to rounding"
    return claim(
        "Definition 2.4",
        outcome(
            one.reachable and reached == 0,
            n=n, m=m, residual=residual, atoms=atoms, reached=reached, rms=rms,
        ),
    )  # fmt: skip


def _realizations(A: Floats, B: Floats, x0: Floats, xf: Floats) -> tuple[int, int, float]:
    """How many there are of ``xf - A x0``, how many in the range of B, and how far off (rms)."""
    (goals, p), (moved, q) = _atoms_of_vector(xf), _atoms_of_product(A, x0)
    away = goals[:, None] - moved
    out_of_reach = np.linalg.svd(B)[0][:, np.linalg.matrix_rank(B) :]
    off = np.linalg.norm(away @ out_of_reach, axis=2)
    reached = off <= REACHABLE * np.linalg.norm(away, axis=2)
    return off.size, int(reached.sum()), float(np.sqrt(np.outer(p, q).ravel() @ off.ravel() ** 2))


def _atoms_of_vector(w: Floats) -> tuple[Floats, Floats]:
    """Realizations (n, n) of a vector without zeros, and their probabilities."""
    g = np.abs(w).sum()
    return np.diag(g * np.sign(w)), np.abs(w) / g


def _atoms_of_product(A: Floats, x0: Floats) -> tuple[Floats, Floats]:
    """Realizations (n^2, n) of ``A^s x0^s`` without zeros, and their probabilities."""
    columns, chances = zip(*map(_atoms_of_vector, A.T), strict=True)
    scales, p = np.abs(x0).sum() * np.sign(x0), np.abs(x0) / np.abs(x0).sum()
    values = [scale * atoms for scale, atoms in zip(scales, columns, strict=True)]
    return np.vstack(values), np.repeat(p, len(A)) * np.concatenate(chances)
