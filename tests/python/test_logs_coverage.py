"""Regions of logs hold where rows are lost by chance, and fail where they are chosen."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import stochens_rs as se
from coverage_study import ALARM, DELTA, at_most, exactly, failures, sets
from declarations import opts
from identification_data import tuned
from stochens_rs.exceptions import DataWarning, InputError

nan = np.nan


def read(runs, gen, share):
    """Runs of two states as a table, each cell of a state lost with this probability.

    Lost again where a run is left without a pair: that looks at the loss, not at what is read.
    """
    cells = [np.column_stack([np.full(len(x), r), x, np.append(u, nan)]) for r, (x, u) in runs]
    run, a, b, u = np.vstack(cells).T
    a, b = (np.where(gen.random(len(run)) < share, nan, one) for one in (a, b))
    table = {"run": run, "a": a, "b": b, "u": u}
    try:
        return se.Trajectories.from_table(table, states=["a", "b"], inputs=["u"], by="run")
    except InputError:
        return read(runs, gen, share)


def missed(model, Theta):
    return not model.region(DELTA).contains(Theta[:, :2], Theta[:, 2:])


def test_adaptive_regions_hold_with_rows_lost_by_chance():
    """Feedback tuned by past noise, about 36 % of the pairs lost."""
    runs = sets(250, 60)

    def case(gen):
        Theta, run = tuned(gen, 150)
        data = read([(0, run)], gen, 0.1)
        assert len(data.pieces) > 5
        return [
            missed(se.identify(data, checks=False, noise=se.Noise(sigma=1.0)), Theta),
            missed(se.identify(data, checks=False), Theta),
        ]

    at_most(failures(case, runs, 301), runs)


def test_last_pairs_of_runs_with_gaps_have_the_exact_region():
    runs = sets(800, 100)

    def failed(gen):
        made = [tuned(gen, 8) for _ in range(12)]
        data = read([(r, run) for r, (_, run) in enumerate(made)], gen, 0.1)
        model = se.identify(data.last_pairs(), checks=False, noise=se.Noise(design="independent"))
        return missed(model, made[0][0])

    exactly(failures(failed, runs, 302), runs)


def test_pieces_taken_for_runs_have_no_exact_region():
    """One walk in 50 pieces of one pair each, as if these were independent."""
    runs, n, T = 300, 8, 100
    B = np.full((n, 1), 0.1)

    def failed(gen):
        x, u = np.zeros((T + 1, n)), gen.standard_normal((T + 1, 1))
        for k in range(T):
            x[k + 1] = x[k] + B[:, 0] * u[k] + gen.standard_normal(n)
        u[1::2] = nan
        table = {f"x{i}": x[:, i] for i in range(n)} | {"u": u[:, 0]}
        data = se.Trajectories.from_table(table, states=list(table)[:n], inputs=["u"])
        ends = np.cumsum(data.pieces) - 1
        assert data.pieces.tolist() == [1] * 50
        with pytest.raises(InputError, match="`design` must be 'adaptive'"):
            se.identify(data, noise=se.Noise(design="independent"))
        pairs = se.Trajectories.from_pairs(*(one[ends] for one in data.pairs()))
        model = se.identify(
            pairs, intercept=True, checks=False, noise=se.Noise(design="independent")
        )
        return not model.region(DELTA).contains(np.eye(n), B, np.zeros(n))

    assert failures(failed, runs, 304) > stats.binom.ppf(1 - ALARM, runs, 2 * DELTA)


def test_rows_lost_for_what_they_read_make_the_region_miss():
    """y(k+1) = 1.2 y(k) - 0.5 y(k-1) + u(k) + w(k): the log is split where |y| > 1.5."""
    runs, N = sets(100, 40), 3000
    A, B = np.array([[1.2, -0.5], [1.0, 0.0]]), np.array([[1.0], [0.0]])
    known = {"known": ([[nan, nan], [1.0, 0.0]], [[nan], [0.0]])}

    def case(gen):
        y, u, w = np.zeros(N + 2), 0.3 * gen.standard_normal(N + 2), 0.5 * gen.standard_normal(N)
        for k in range(1, N + 1):
            y[k + 1] = 1.2 * y[k] - 0.5 * y[k - 1] + u[k] + w[k - 1]
        found = []
        for lost in (gen.random(N + 2) < 0.1, np.abs(y) > 1.5):
            read = np.where(lost, nan, y)
            table = {"y": read[1:], "before": read[:-1], "u": u[1:]}
            data = se.Trajectories.from_table(table, states=["y", "before"], inputs=["u"])
            model = se.identify(data, **opts(**known, checks=False))
            found.append(not model.region(DELTA).contains(A, B))
        clipped = np.clip(y, -1.5, 1.5)
        table = {"y": clipped[1:], "before": clipped[:-1], "u": u[1:]}
        with pytest.warns(DataWarning, match=r"`y` reads -?1.5, its (largest|least) value, in"):
            se.Trajectories.from_table(table, states=["y", "before"], inputs=["u"])
        return found

    by_chance, chosen = failures(case, runs, 305)
    at_most(by_chance, runs)
    assert chosen > runs / 2
