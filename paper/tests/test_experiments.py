"""The two experiments: orderings that are theorems, exact second moments, and repeatability."""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import signal
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

import paper
import stochens_rs as se
from paper import Curve, Experiment, power, tracking
from paper.experiments.recording import log_grid
from paper.experiments.replicate import Step
from stochens_rs.rng import as_key

SMALL_POWER = {"rng": 5, "replicates": 6, "samples": 120}
SMALL_TRACKING = {"rng": 5, "replicates": 3, "samples": 40, "n": 12, "m": 9}

# |z| <= 5 for a mean over many replicates: were it normal, a false alarm had probability 6e-7 per
# comparison, so below 1e-5 for the twelve of one test. Squared errors are skewed to the right,
# which makes positive z somewhat larger; sizes below 10, where that matters, are not compared.
Z_MAX = 5.0


@pytest.fixture(scope="module")
def small_power():
    return power(**SMALL_POWER)


@pytest.fixture(scope="module")
def small_tracking():
    return tracking(**SMALL_TRACKING)


@pytest.fixture(scope="module", params=["power", "tracking"])
def experiment(request, small_power, small_tracking):
    return small_power if request.param == "power" else small_tracking


# -- orderings -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["1a", "1b"])
@pytest.mark.parametrize("other", ["slse", "slse-safeguarded", "uniform"])
def test_alse_is_never_above_another_estimate(small_power, name, other):
    # The solver's certificate: err^2 <= (best possible err)^2 + gap, errors relative.
    panel = small_power.panel(name)
    alse, above = panel.curve("alse").errors, panel.curve(other).errors
    gap = small_power.facts["alse"][{"1a": "x0", "1b": "A"}[name]]["worst_relative_gap"]
    assert np.all(alse**2 <= above**2 * (1 + 1e-9) + gap + 1e-26)
    assert np.any(alse < 0.9 * above)


@pytest.mark.parametrize("name", ["1a", "1b"])
def test_safeguarded_slse_is_never_above_uniform(small_power, name):
    panel = small_power.panel(name)
    safeguarded, uniform = (panel.curve(m).errors for m in ("slse-safeguarded", "uniform"))
    assert np.all(safeguarded <= uniform * (1 + 1e-9) + 1e-13)
    assert np.any(safeguarded < 0.9 * uniform)


def test_slse_errors_do_not_increase(small_power):
    for name in ("1a", "1b"):
        errors = small_power.panel(name).curve("slse").errors
        assert np.all(np.diff(errors, axis=1) <= 1e-12)


def test_alse_finds_x0_exactly_and_from_then_on():
    result = power(rng=2, replicates=4, samples=4000, sizes=[1, 4000], angle_std=1.0)
    errors = result.panel("1a").curve("alse").errors
    assert np.all(errors[:, 0] > 0.1)
    assert np.all(errors[:, 1] <= 1e-13)
    assert result.facts["zero_from"]["1a"] == 4000


def test_ordering_facts_count_what_they_say(small_power):
    panel = small_power.panel("2a")
    a, b = panel.curve("slse").errors, panel.curve("uniform").errors
    share = np.mean(a > b * (1 + 1e-9) + panel.zero_level)
    assert small_power.facts["ordering"]["2a"]["slse_above_uniform"] == share
    assert 0 < share < 1


# -- against the exact moments -------------------------------------------------------------------


@pytest.fixture(scope="module")
def many_replicates():
    return power(rng=11, replicates=200, samples=50, sizes=[10, 50])


def test_uniform_weights_follow_their_exact_moments_in_power(many_replicates):
    for panel in many_replicates.panels:
        for curve in panel.curves:
            assert (curve.z is None) == (curve.method != "uniform")
            if curve.z is not None:
                assert np.all(np.abs(curve.z) <= Z_MAX), (panel.name, curve.name, curve.z)
    theory = many_replicates.facts["theory"]
    assert theory["comparisons"] == 2 * (1 + 1 + 2 + 2)
    assert 0 < theory["largest_abs_z"] <= Z_MAX


def test_uniform_weights_follow_their_exact_moments_in_tracking():
    result = tracking(rng=12, replicates=150, samples=30, sizes=[10, 30], n=6, m=4)
    for panel in result.panels:
        for fusion in ("product", "diagonal"):
            z = panel.curve("uniform", fusion).z
            assert np.all(np.abs(z) <= Z_MAX), (panel.name, fusion, z)


@pytest.mark.parametrize("factor", [0.75, 1.3])
def test_the_comparison_would_notice_a_wrong_scale(many_replicates, factor):
    for name, fusion in (("1a", None), ("1b", None), ("2b", "product"), ("2b", "diagonal")):
        curve = many_replicates.panel(name).curve("uniform", fusion)
        wrong = Curve("uniform", fusion, curve.errors, factor * curve.exact_rms, curve.exact_spread)
        assert np.min(np.abs(wrong.z)) > Z_MAX, (name, fusion)


def test_the_comparison_would_notice_the_wrong_fusion(many_replicates):
    panel = many_replicates.panel("2b")
    product, diagonal = panel.curve("uniform", "product"), panel.curve("uniform", "diagonal")
    wrong = Curve("uniform", "product", product.errors, diagonal.exact_rms, diagonal.exact_spread)
    assert np.max(np.abs(wrong.z)) > Z_MAX


def test_mean_square_of_slse_is_below_that_of_uniform(many_replicates):
    # E d_N^2 <= V / N; here far below, so that chance plays no part.
    for name in ("1a", "1b"):
        panel = many_replicates.panel(name)
        assert panel.curve("slse").rms[-1] < 0.8 * panel.curve("uniform").exact_rms[-1]
        assert many_replicates.facts["slse_mean_square_over_bound"][name] < 1


def test_exact_rms_is_the_theory_module(small_power):
    system = se.cases.ieee14()
    x0 = np.array(small_power.settings["x0"])
    moments = se.theory.moments
    sizes = small_power.sizes
    curve = small_power.panel("1b").curve("uniform")
    expected = [np.sqrt(moments.mse(system.A, int(N))) for N in sizes]
    assert curve.exact_rms == pytest.approx(
        np.array(expected) / np.linalg.norm(system.A), rel=1e-12
    )
    for fusion in ("product", "diagonal"):
        exact = small_power.panel("2a").curve("uniform", fusion).exact_rms
        rms = [moments.control_rms(system, x0, np.zeros(10), int(N), fusion=fusion) for N in sizes]
        v = np.linalg.pinv(system.B) @ (-system.A @ x0)
        assert exact == pytest.approx(np.array(rms) / np.linalg.norm(v), rel=1e-9)


def test_ten_percent_is_the_first_size_that_suffices():
    result = tracking(rng=3, replicates=1, samples=10, n=8, m=6)
    for fusion in ("product", "diagonal"):
        N = result.facts["samples_for_ten_percent"][fusion]
        around = tracking(rng=3, replicates=1, samples=N, n=8, m=6, sizes=[N - 1, N], tol=0.1)
        below, at = around.panel("3a").curve("uniform", fusion).exact_rms
        assert at <= 0.1 < below


def test_rolled_step_two_carries_the_first_error(small_tracking):
    # Var(rolled) = tr(A C_0 A^T) + tr C_1 exceeds Var(reference) = tr C_1, in absolute terms.
    rolled, reference = small_tracking.panel("3b"), small_tracking.panel("3b-alternative")
    absolute = [p.curve("uniform").exact_rms * p.norm for p in (rolled, reference)]
    assert np.all(absolute[0] > absolute[1])
    swapped = tracking(**SMALL_TRACKING, step_two="reference")
    assert np.array_equal(swapped.panel("3b").curve("alse").errors, reference.curve("alse").errors)


# -- the pieces are the library's ----------------------------------------------------------------


def test_errors_are_those_of_the_public_functions(small_power):
    """Replicate 2, all samples, once more through sample, fuse and control."""
    system = se.cases.ieee14()
    x0, xf = np.array(small_power.settings["x0"]), np.zeros(10)
    key = se.Key.from_hex(small_power.key).child("{}").child("replicate 2")
    sampled = {
        name: se.sample(target, 120, rng=key.child(name))
        for name, target in (("x0", x0), ("xf", xf), ("A", system.A))
    }
    v = np.linalg.pinv(system.B) @ (xf - system.A @ x0)
    fits = {
        "x0": se.fuse(sampled["x0"], "slse", target=x0),
        "xf": se.fuse(sampled["xf"], "slse", target=xf),
        "A": se.fuse(sampled["A"], "slse", target=system.A),
    }
    plan = se.control((fits["A"], system.B), fits["x0"], fits["xf"])
    error = np.linalg.norm(plan.u[0] - v) / np.linalg.norm(v)
    assert small_power.panel("2a").curve("slse").errors[2, -1] == pytest.approx(error, rel=1e-8)
    u = se.realization_controls((sampled["A"], system.B), sampled["x0"], sampled["xf"]).mean(axis=0)
    error = np.linalg.norm(u - v) / np.linalg.norm(v)
    curve = small_power.panel("2a").curve("uniform", "diagonal")
    assert curve.errors[2, -1] == pytest.approx(error, rel=1e-8)
    # With one sample there is nothing to fuse: both fusions and all methods agree.
    first = [c.errors[:, 0] for c in small_power.panel("2b").curves]
    assert all(errors == pytest.approx(first[0], rel=1e-9) for errors in first)


def test_every_alse_solve_is_kept(small_power):
    alse = small_power.facts["alse"]
    assert alse["A"]["solves"] == 6 * small_power.sizes.size
    assert sum(alse["A"]["statuses"].values()) == alse["A"]["solves"]
    if set(alse["A"]["statuses"]) == {"optimal"}:
        assert 0 <= alse["A"]["worst_relative_gap"] <= small_power.settings["tol"]


def test_the_printed_stopping_rule_stops_far_away(small_power):
    rule = small_power.facts["stopping_rule"]
    assert rule["stopped"] > 0.5
    assert rule["median_relative_error"] > 0.1


def test_unreachable_target(small_power):
    reach = small_power.facts["reachability"]
    assert reach["rank"] == 5
    assert 0 < reach["relative"] < 1
    assert small_power.panel("2b").norm == pytest.approx(reach["residual"], rel=1e-12)  # xf = 0


# -- repeatability and data ----------------------------------------------------------------------


def test_same_key_same_results(small_power):
    for rng in (5, as_key(5), se.Key.from_hex(small_power.key)):
        again = power(**{**SMALL_POWER, "rng": rng})
        assert again.key == small_power.key
        assert errors_of(again) == errors_of(small_power)
    other = power(**{**SMALL_POWER, "rng": 6})
    assert errors_of(other) != errors_of(small_power)


def test_first_replicates_do_not_depend_on_their_number(small_power):
    fewer = power(**{**SMALL_POWER, "replicates": 2})
    for a, b in zip(fewer.panels, small_power.panels, strict=True):
        for one, more in zip(a.curves, b.curves, strict=True):
            assert np.array_equal(one.errors, more.errors[:2])


@pytest.mark.parametrize("run", ["power", "tracking"])
def test_executors_and_files_change_no_bit(run, small_power, small_tracking, tmp_path):
    function, options, whole = {
        "power": (power, SMALL_POWER, small_power),
        "tracking": (tracking, SMALL_TRACKING, small_tracking),
    }[run]
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as processes:
        for executor in (processes, ThreadPoolExecutor(3)):
            again = function(**options, executor=executor)
            assert errors_of(again) == errors_of(whole)
            assert again.facts == whole.facts
    path = tmp_path / "a.study"
    fewer = {**options, "replicates": 2}
    assert errors_of(function(**fewer, path=path)) == errors_of(function(**fewer))
    again = function(**options, path=path)  # the first two are in the file
    assert errors_of(again) == errors_of(whole)
    assert again.facts == whole.facts
    with pytest.raises(se.exceptions.StateError, match=r"`grid` of .*a.study is"):
        function(**{**options, "samples": 20}, path=path)
    with pytest.raises(se.exceptions.StateError, match="`function_digest` of"):
        function(**options, tol=1e-6, path=path)


@pytest.mark.skipif(sys.platform == "win32", reason="signals differ")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_experiment_goes_on(number, tmp_path):
    path = tmp_path / "a.study"

    def interrupt(done, _):
        if done >= 3:
            os.kill(os.getpid(), number)

    options = {"rng": 5, "replicates": 40, "samples": 30}
    with pytest.raises(KeyboardInterrupt):
        power(**options, path=path, progress=interrupt)
    kept = se.Study.resume(path).results
    assert 3 <= kept.done.all(axis=0).sum() < 40
    assert signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler)
    assert errors_of(power(**options, path=path)) == errors_of(power(**options))


def test_lost_workers_and_failures_are_told(monkeypatch, tmp_path):
    with pytest.raises(se.exceptions.InputError, match=r"`function` failed .* needs .* GiB"):
        power(rng=1, replicates=2, samples=10**13)
    honest, failing = Step.draw, as_key(1).child("{}").child("replicate 1")

    def sometimes(self, key, *more):
        if key == failing:
            raise ZeroDivisionError("never")
        return honest(self, key, *more)

    monkeypatch.setattr(Step, "draw", sometimes)
    with pytest.raises(se.exceptions.InputError, match="replicate 1 failed: ZeroDivisionError"):
        power(rng=1, replicates=3, samples=10, path=tmp_path / "a.study")
    monkeypatch.undo()
    again = power(rng=1, replicates=3, samples=10, path=tmp_path / "a.study")
    assert errors_of(again) == errors_of(power(rng=1, replicates=3, samples=10))
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as processes:
        processes.submit(os.getpid).result()
        for one in processes._processes.values():
            one.kill()
        with pytest.raises(se.exceptions.InputError, match="`executor` has lost its workers"):
            power(rng=1, replicates=3, samples=10, executor=processes)


def test_round_trip_through_json(experiment):
    text = json.dumps(experiment.to_dict(), allow_nan=False)
    again = Experiment.from_dict(json.loads(text))
    assert json.dumps(again.to_dict(), allow_nan=False) == text
    assert errors_of(again) == errors_of(experiment)
    assert again.sizes.dtype == np.int64
    with pytest.raises(ValueError, match="schema"):
        Experiment.from_dict({**experiment.to_dict(), "schema": "other"})


def test_statistics_are_those_of_the_errors(experiment):
    curve = experiment.panels[0].curves[0]
    low, high = curve.band
    assert curve.median == pytest.approx(np.median(curve.errors, axis=0))
    assert curve.rms == pytest.approx(np.sqrt((curve.errors**2).mean(axis=0)))
    assert np.all((low <= curve.median) & (curve.median <= high))
    assert np.array_equal(curve.single, curve.errors[0])


def test_progress_and_sizes():
    seen = []
    sizes = [1, 2, 7]
    result = tracking(
        rng=1, replicates=3, samples=9, n=4, m=2, sizes=sizes, progress=lambda *x: seen.append(x)
    )
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert result.sizes.tolist() == sizes
    assert result.replicates == 3
    assert "tracking" in repr(result)


@pytest.mark.parametrize("samples", [1, 2, 17, 1000])
def test_default_grid(samples):
    grid = log_grid(samples)
    assert grid[0] == 1
    assert grid[-1] == samples
    assert np.all(np.diff(grid) > 0)
    assert grid.size <= 16


def test_other_cases_run():
    euler = power(rng=1, replicates=1, samples=10, method="euler", data="andes", base="machine")
    assert "euler" in euler.settings["system"]
    large = power(rng=1, replicates=1, samples=10, case="ieee39")
    assert (large.settings["n"], large.settings["m"]) == (20, 10)


def test_a_case_of_the_table_can_be_run(monkeypatch):
    def slow(*, dt=1.0):
        return se.cases.ieee14(dt=dt)

    monkeypatch.setitem(se.cases.CASES, "slow", slow)
    made = power(rng=1, replicates=1, samples=10, case="slow", dt=0.5)
    same = power(rng=1, replicates=1, samples=10, dt=0.5)
    assert made.settings["case"] == "slow"
    assert errors_of(made) == errors_of(same)
    with pytest.raises(
        se.exceptions.InputError, match="`method` must be left out with case 'slow'"
    ):
        power(rng=1, case="slow", method="euler")


@pytest.mark.parametrize(
    ("run", "options", "word"),
    [
        (power, {"replicates": 0}, "replicates"),
        (power, {"samples": 0}, "samples"),
        (power, {"case": "ieee15"}, "case"),
        (power, {"case": "ieee39", "data": "andes"}, "data"),
        (power, {"sizes": [3, 2]}, "sizes"),
        (power, {"sizes": [5000]}, "sizes"),
        (power, {"angle_std": 0.0}, "angle_std"),
        (tracking, {"step_two": "both"}, "step_two"),
        (tracking, {"n": 0}, "n"),
        (tracking, {"tol": -1.0}, "tol"),
    ],
)
def test_wrong_options_are_named(run, options, word):
    with pytest.raises(se.exceptions.InputError, match=re.escape(f"`{word}`")):
        run(rng=1, **options)


def errors_of(experiment):
    """Every error of every curve, in a form that can be compared."""
    return [c.errors.tolist() for p in experiment.panels for c in p.curves]


def test_a_system_of_ones_own_takes_the_place_of_the_network(tmp_path):
    own = se.System([[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.1]], dt=0.1, name="cart")
    found = paper.power(own, rng=1, replicates=2, samples=20)
    assert found.settings["system"] == "cart"
    assert (found.settings["n"], found.settings["x0_std"]) == (2, 0.1)
    assert found.replicates == 2
