"""Guarantees that are counted by `se.Study`, and how the counts are judged.

With R runs at level 5 % the number of failures is binomial. An exact statement is accepted between
the quantiles of 0.5e-5 and 1 - 0.5e-5, a conservative one below the quantile of 1 - 1e-5: a false
alarm of 1e-5 for each of the about 150 counts, once and for all, as keys are fixed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy import stats

import stochens_rs as se

DELTA = 0.05
ALARM = 1e-5


def sets(soak: int, test: int) -> int:
    """How many data sets a study takes: in `make soak`, and in `make test`."""
    return soak if os.environ.get("SOAK") else test


# The levels of a study; `make test` takes the two ends, as the one between is computed alike.
LEVELS = (0.5, 0.2, 0.05) if os.environ.get("SOAK") else (0.5, 0.05)


def most(sets: int, delta: float) -> int:
    """Failures of so many sets that a correct level exceeds with probability 1e-4."""
    return int(stats.binom.isf(1e-4, sets, delta))


def repeated(case: Callable[[np.random.Generator], Any], runs: int, seed: Any) -> dict[str, Any]:
    """Return what case(gen) returned in each run: for each of its names an array, runs first.

    Without names it is "failed". Run r draws from its own key, ``rng=seed`` of the study.
    """

    def function(key: se.Key) -> Mapping[str, Any]:
        found = case(key.generator())
        return found if isinstance(found, Mapping) else {"failed": found}

    results = se.Study(function, {}, replicates=runs, rng=seed).run()
    assert not results.failures, results.failures[0]
    assert results.status == "completed"
    return dict(results.values)


def failures(case: Callable[[np.random.Generator], Any], runs: int, seed: Any) -> Any:
    """Count how often case(gen) is true; of an array each entry."""
    return repeated(case, runs, seed)["failed"].sum(axis=0).astype(int)


def exactly(failures: Any, runs: int, rate: float = DELTA) -> None:
    """Accept a count, or each of several, of a statement with this rate of failure."""
    low, high = stats.binom.ppf([ALARM / 2, 1 - ALARM / 2], runs, rate)
    for count in np.ravel(failures):
        assert low <= count <= high, f"{count} of {runs}, expected {rate * runs:g}"


def at_most(failures: Any, runs: int, rate: float = DELTA) -> None:
    """Accept a count, or each of several, of a statement that fails at most so often."""
    high = stats.binom.ppf(1 - ALARM, runs, rate)
    for count in np.ravel(failures):
        assert count <= high, f"{count} of {runs}, expected at most {rate * runs:g}"


def coverage(failures: Any, runs: int) -> Any:
    """The share of runs in which it holds."""
    return 1.0 - failures / runs
