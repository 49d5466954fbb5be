"""Counts instead of realizations: the same distribution, at a cost independent of N.

The laws compared have few outcomes, so that whole distributions can be compared and not only their
moments. Seeds are fixed; each test names its sample size and the probability of a false alarm, and
is shown counts of another distribution that it must refuse.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import product
from math import factorial, prod

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from stochens_rs import theory

W = np.array([3.0, -1.0, 0.0, 2.0])
SIZE, REPLICATES = 6, sets(5000, 2000)
QUANTILE = 77.2  # of chi-square, 27 degrees of freedom (the 28 outcomes) or fewer, at 1e-6

Outcome = tuple[int, ...]


def multinomial() -> dict[Outcome, float]:
    """The exact law of the counts of SIZE draws: 28 outcomes."""
    p = np.abs(W) / np.abs(W).sum()
    outcomes = [k for k in product(range(SIZE + 1), repeat=4) if sum(k) == SIZE and k[2] == 0]
    return {
        k: factorial(SIZE) / prod(map(factorial, k)) * float(np.prod(p ** np.array(k)))
        for k in outcomes
    }


def drawn(seed: int) -> Outcome:
    return tuple(se.sample(W, SIZE, rng=seed).counts().tolist())


def counted(seed: int, scheme: str = "iid") -> Outcome:
    return tuple(se.sample_counts(W, SIZE, rng=seed, scheme=scheme).counts.tolist())


def test_counts_have_the_exact_multinomial_law() -> None:
    seen = Counter(counted(seed) for seed in range(REPLICATES))
    law = multinomial()
    assert set(seen) <= set(law)
    rare = sum(p for p in law.values() if p * REPLICATES < 5)
    cells = [(seen[k], p) for k, p in law.items() if p * REPLICATES >= 5]
    cells.append((REPLICATES - sum(n for n, _ in cells), rare))
    statistic = sum((n - REPLICATES * p) ** 2 / (REPLICATES * p) for n, p in cells)
    assert statistic < QUANTILE  # false alarm 1e-6


# --- controls -------------------------------------------------------------------------------------

A = np.array([[0.9, 0.2], [-0.1, 0.8]])
B = np.array([[1.0, 0.0], [0.5, 1.0]])
X0, XF = np.array([1.0, 2.0]), np.array([0.5, -1.0])
EXACT = np.linalg.solve(B, XF - A @ X0)
Draw = Callable[..., "se.Ensemble | se.Counts"]


def squared_error(draw: Draw, size: int, seed: int) -> float:
    """Squared error of the product fusion of x0, xf and A, drawn with three different seeds."""
    x0, xf, fused = (draw(target, size, rng=3 * seed + k) for k, target in enumerate((X0, XF, A)))
    error = se.control((fused, B), x0, xf).u[0] - EXACT
    return float(error @ error)


@pytest.mark.parametrize("size", [1000, 10**12])
def test_controls_of_a_trillion_realizations_have_the_exact_mean_square(size: int) -> None:
    # 1000 controls, in `make test` 700, six standard errors of their mean square: a false alarm has
    # probability < 1e-7; two thirds of the size have a mean square larger by a half
    expected = theory.moments.control_rms((A, B), X0, XF, size) ** 2

    def excess(drawn: int) -> float:
        ratios = [
            squared_error(se.sample_counts, drawn, s) / expected for s in range(sets(1000, 700))
        ]
        return float(abs(np.mean(ratios) - 1.0) / (6 * np.std(ratios) / np.sqrt(len(ratios))))

    assert excess(size) < 1.0
    assert excess(size * 2 // 3) > 1.0
