"""Logs with ordinary faults: what is certified of them, and false; and that clean logs are read."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from broken_logs import DELTA, FAULTS, PLANTS, clean, counted, outcome
from coverage_study import at_most, most, sets

pytestmark = pytest.mark.slow

UNSEEN = [(kind, name) for kind, about in FAULTS.items() for name in about.unseen]


def outcomes(kind, name, count):
    """Of the two sizes that matter."""
    return counted(kind, name, 1, count) + counted(kind, name, 2, count)


@pytest.mark.parametrize("kind", FAULTS)
def test_what_is_certified_of_broken_logs_is_true(kind):
    """Wrong and finite at most as often as at 95 %, of each plant and of all; alarm 1e-4 each."""
    about, every = FAULTS[kind], Counter()
    for name in about.plants:
        if name in about.unseen:
            continue
        found = outcomes(kind, name, sets(10, 1))
        assert found["wrong"] <= most(found.total(), DELTA), (name, found)
        every += found
    assert every["wrong"] <= most(every.total(), DELTA), every


@pytest.mark.parametrize(("kind", "name"), UNSEEN)
def test_faults_that_no_log_shows_are_known(kind, name):
    """One that is seen by now must leave its list."""
    found = outcomes(kind, name, 4)
    assert found["wrong"] > most(found.total(), DELTA), found


@pytest.mark.parametrize("name", PLANTS)
def test_clean_logs_are_not_refused(name):
    """At most 1 % refused, 5 % wrong."""
    runs, found = sets(200, 6), Counter()
    for seed in range(runs):
        found[outcome(PLANTS[name], clean(PLANTS[name], np.random.default_rng([39, seed])))[0]] += 1
    at_most(found["refused"], runs, 0.01)
    at_most(found["wrong"], runs, DELTA)
    assert found["right"] >= 0.8 * runs


def test_the_bench_finds_what_is_false():
    """A clean log of another plant than the one it is judged by is wrong."""
    gen, plant = np.random.default_rng(1), PLANTS["oven"]
    other = plant._replace(A=0.9 * plant.A)
    assert outcome(plant, clean(plant, gen))[0] != "wrong"
    assert outcome(other, clean(plant, gen))[0] == "wrong"
