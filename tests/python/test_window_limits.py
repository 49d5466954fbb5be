"""What regions of models of outputs do not survive: each assumption broken, and what is seen."""

from __future__ import annotations

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from stochens_rs import _core
from stochens_rs.identification import Regressors
from stochens_rs.identification.assumptions import ACCEPTED
from stochens_rs.identification.window import rows_of
from test_window_coverage import arx_runs, filter_runs, hidden_arx, missed, padded

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
AR2 = np.array([[1.2, -0.5, 1.0, 0.0]])  # y+ = 1.2 y - .5 y_- + u + w, in two lags


def ar2(gen, steps=1500):
    """One run with inputs of .3 and noise of .5."""
    y, u = [0.0, 0.0], 0.3 * gen.standard_normal(steps)
    for k in range(1, steps):
        y.append(1.2 * y[-1] - 0.5 * y[-2] + u[k] + 0.5 * gen.standard_normal())
    return np.array(y), u


def missed_by(rows, Theta=AR2, sigma=0.5):
    """Whether the region of these rows (z, y one step later) does not contain Theta."""
    estimate = _core.Estimate(_core.triangle(np.ascontiguousarray(rows), 1), len(rows), 1, 3, False)
    law = "adaptive", "gaussian", "known", np.array([[sigma**2]])
    region = estimate.region(law, np.ones(4), 0.05, False, None, 0, False, "auto", False, 1)
    return not region.contains(Theta)


@pytest.mark.parametrize(
    ("mask", "most", "least"),
    [
        (lambda y, rows: abs(rows[:, -1]) < 2.0, 60, 54),  # by the outcome: over 90 % are missed
        (lambda y, rows: abs(rows[:, 0]) < 2.0, 1, 0),  # by what was there before it
        (lambda y, rows: np.random.default_rng(1).random(len(rows)) < 0.7, 1, 0),  # by chance
    ],
    ids=["outcome", "past", "chance"],
)
def test_masks(mask, most, least):
    misses = 0
    for seed in range(60):
        y, u = ar2(np.random.default_rng([11, seed]), 3000)
        data = se.Trajectories(y[:, None], u[: len(y) - 1, None], outputs=True)
        rows = rows_of(Regressors(("y",), ("u",), 2), data)[1]
        misses += missed_by(rows[mask(y, rows)])
    assert least <= misses <= most


def test_runs_cut_before_a_bad_reading():
    """Readings beyond 2 are left out, as if a log were split where its sensor saturates."""
    misses = 0
    for seed in range(60):
        y, u = ar2(np.random.default_rng([12, seed]))
        y[np.abs(y) > 2.0] = np.nan
        table = {"y": y, "u": np.append(u, np.nan)}
        data = se.Trajectories.from_table(table, outputs=["y"], inputs=["u"])
        misses += missed_by(rows_of(Regressors(("y",), ("u",), 2), data)[1])
    assert misses > 0.1 * 60


def test_the_smallest_tube_over_all_lags_is_no_choice():
    """The order with the smallest tube of 10 steps, on the same data that certify it."""
    misses, count = 0, sets(60, 12)
    for seed in range(count):
        gen = np.random.default_rng([13, seed])
        system = hidden_arx(gen)
        data = se.Trajectories(*arx_runs(gen, system, 24, 30), outputs=True)
        y, u = data.last_record()
        found = []
        for lags in range(1, 9):
            model = se.identify(data, accept=ACCEPTED, checks=False, window=se.Window(lags=lags))
            x0 = model.window.state_of(y[:-10], u[:-10])
            around = model.loop.ABc, model.loop.J, model.loop.G, model.m
            core = model.region(0.05).core
            tube = _core.output_tube(core, around, x0, u[-10:].copy(), None, None, None)[2][0]
            found.append((tube[-1], model))
        model = min(found, key=lambda one: one[0])[1]
        lags = max(model.window.count, system[2])
        Theta = padded(system, lags)
        if lags > model.window.count:
            misses += 1  # too short to contain the system
        else:
            misses += missed(model, Theta)
    assert misses > 0.4 * count


def test_filters_need_a_burn_in_units_of_the_noise():
    """Signals 1000 times the noise: a^b <= 1e-3 leaves the start values in the residuals."""
    pole, r, sigma, short, misses = 0.8, 2, 3e-4, 0, 0
    Theta = np.array([[1.2, -0.4, 1.0, 1.0]])
    count = sets(20, 5)
    for seed in range(count):
        gen = np.random.default_rng([14, seed])
        runs = filter_runs(gen, Regressors(("y",), ("u",), r, pole), Theta, 20, 150, sigma)
        # logs that begin inside the runs: the filters are not at rest
        data = se.Trajectories(*([one[20:] for one in some] for some in runs), outputs=True)
        short += missed_by(
            rows_of(Regressors(("y",), ("u",), r, pole, 0, False, 31), data)[1], Theta, sigma
        )
        misses += missed(
            se.identify(
                data, checks=False, noise=se.Noise(sigma=sigma), window=se.Window(filters=(pole, r))
            ),
            Theta,
        )
    assert short > 0.9 * count
    assert misses == 0
