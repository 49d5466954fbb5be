"""`studies.templates` return what the package computes, and guarantees hold.

Rates are judged as in `coverage_study`: a false alarm of 1e-5 for each count.
"""

from __future__ import annotations

import pickle
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import at_most, exactly, failures
from identification_data import SKEWED
from stochens_rs.exceptions import InputError, InputTypeError
from stochens_rs.rng import as_key
from stochens_rs.studies.digest import digest
from stochens_rs.studies.templates.runs import RunDesign, Truth

A = np.array([[0.9, 0.2], [-0.1, 0.8]])
B = np.array([[0.0], [1.0]])
KEY = as_key(7)


def uneven() -> se.Trajectories:
    """Three runs of 4, 9 and 2 steps."""
    gen, states, inputs = np.random.default_rng(3), [], []
    for T in (4, 9, 2):
        u, x = gen.standard_normal((T, 1)), [gen.standard_normal(2)]
        for acting in u:
            x.append(A @ x[-1] + B @ acting + 0.01 * gen.standard_normal(2))
        states.append(np.array(x))
        inputs.append(u)
    return se.Trajectories(states, inputs)


def ready() -> dict[str, Any]:
    return {
        "error": se.studies.error((A, B), [1, 1], [0.5, 0]),
        "coverage": se.studies.coverage((A, B), [1, 0], [0, 0], noise=0.1, steps=2),
        "own runs": se.studies.coverage((A, B), [1, 0], [0, 0], noise=0.1, runs=uneven()),
    }


GRIDS = {"error": {"size": [10], "method": ["uniform"]}}


@pytest.mark.parametrize("name", ready())
def test_functions_are_pickled_and_depend_on_their_key_alone(name: str) -> None:
    function, grid = ready()[name], GRIDS.get(name, {})
    again = pickle.loads(pickle.dumps(function))
    assert digest("function", again) == digest("function", function)
    given = {axis: values[0] for axis, values in grid.items()}
    first, other = function(KEY, **given), function(as_key(8), **given)
    repeated = again(KEY, **given)
    assert all(np.array_equal(first[key], repeated[key]) for key in first)
    assert any(not np.array_equal(first[key], other[key]) for key in first)
    axes = ("size", "steps", "delta", "beta")
    assert set(function.units) <= {*first, *axes}


def test_other_processes_find_the_same() -> None:
    names = ("coverage", "own runs")
    made = [se.Study(ready()[name], {}, replicates=4, rng=1) for name in names]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
        found = [study.run(processes).digest for study in made]
    again = [se.Study(ready()[name], {}, replicates=4, rng=1) for name in names]
    assert found == [study.run().digest for study in again]


# -- certificates from runs ------------------------------------------------------------------------


def test_runs_follow_the_truth_and_the_design() -> None:
    F = np.array([[-0.2, -0.5]])
    function = se.studies.coverage(
        (A, B), [1, 0], [0, 0], noise=[0.1, 0.3], starts=[2, 0], excitation=0.5, feedback=F
    )
    data = function.keywords["design"].draw(function.keywords["truth"], 4000, KEY)
    assert data.lengths.tolist() == [10] * 4000
    x, u, y = data.pairs()
    w, v = y - x @ A.T - u @ B.T, u - x @ F.T
    assert np.allclose(w.T @ w / len(w), np.diag([0.01, 0.09]), atol=2e-3)
    assert np.allclose(v.std(), 0.5, rtol=0.02)
    assert abs(np.mean(v * w)) < 2e-3
    first = x[::10]
    assert np.allclose(first.std(axis=0), [2.0, 0.0], rtol=0.05)


@pytest.mark.parametrize("own", [False, True])
def test_no_noise_is_used_twice(own: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither by two runs, nor in the runs and behind them, nor in another replicate."""
    drawn: list[np.ndarray] = []
    draw, declared = Truth.noise, {"identify": {"sigma": 0.1}, "bound": {"noise": True}}

    def noise(truth: Truth, *args: Any, **options: Any) -> np.ndarray:
        drawn.append(draw(truth, *args, **options))
        return drawn[-1]

    monkeypatch.setattr(Truth, "noise", noise)
    runs = uneven() if own else None
    function = se.studies.coverage(
        (A, B), [1, 0], [0, 0], noise=0.1, size=12, steps=5, runs=runs, **declared
    )
    data: list[se.Trajectories] = []
    made = RunDesign.draw
    monkeypatch.setattr(RunDesign, "draw", lambda *args: data.append(made(*args)) or data[-1])
    for r in range(3):
        function(KEY.child(f"replicate {r}"))
    found = np.concatenate([w.ravel() for w in drawn])
    assert len(drawn) == 6
    assert np.unique(found).size == found.size == 3 * 2 * (12 * (9 if own else 10) + 5)
    for one in data:  # and what is drawn is what the runs have
        x, u, y = one.pairs()
        assert np.unique((y - x @ A.T - u @ B.T).round(12)).size == 2 * len(x)


def test_numbers_are_those_of_the_package() -> None:
    function = se.studies.coverage(
        (A, B), [1, 0], [0.5, 0], noise=0.1, steps=3, size=12, identify={"sigma": 0.1}
    )
    data = function.keywords["design"].draw(function.keywords["truth"], 12, KEY.child("runs"))
    model = se.identify(data, sigma=0.1)
    plan = se.control(model, [1, 0], [0.5, 0], steps=3)
    x = se.simulate((A, B), [1, 0], plan.u).states[-1]
    found, bound = function(KEY), plan.bound(0.05).target
    assert found["bound"] == bound
    assert found["error"] == pytest.approx(np.linalg.norm(x - [0.5, 0]), rel=1e-12)
    assert found["ratio"] == pytest.approx(bound / found["error"])
    assert found["inside"] == model.region(0.05).contains(A, B)
    assert function(KEY, size=12, steps=3, delta=0.05) == found
    assert function(KEY, delta=0.5)["bound"] < bound


def test_exact_regions_contain_the_truth_at_their_level() -> None:
    """1500 sets of 15 runs with feedback, of which the last pairs are taken."""
    function = se.studies.coverage(
        (A, B), [1, 0], [0, 0], noise=0.1, size=15, length=3, feedback=[[-0.2, -0.5]],
        identify={"design": "independent"},
    )  # fmt: skip
    found = se.Study(function, {}, replicates=1500, rng=1).run()
    exactly(1500 - found.values["inside"].sum(), 1500)
    at_most(1500 - found.values["covered"].sum(), 1500)


def test_noise_that_is_larger_than_declared_shows() -> None:
    function = se.studies.coverage(
        (A, B),
        [1, 0],
        [0, 0],
        noise=0.1,
        identify={"sigma": 0.1, "accept": "noise size"},
        bound={"noise": True},
    )
    found = se.Study(function, {"noise": [0.1, 0.5]}, replicates=200, rng=1).run()
    fair, wrong = found.values["inside"].sum(axis=1)
    at_most(200 - fair, 200)
    assert wrong < 100
    covered = found.values["covered"].sum(axis=1)
    at_most(200 - covered[0], 200)


def test_a_model_is_taken_as_the_truth_with_its_runs() -> None:
    gen = np.random.default_rng(5)
    x, u = gen.standard_normal((40, 4)), gen.standard_normal((40, 1))
    true = gen.standard_normal((4, 5))
    y = np.hstack([x, u]) @ true.T + 1.0 + gen.standard_normal((40, 4)) @ SKEWED.T
    data = se.Trajectories.from_pairs(x, u, y)
    model = se.identify(data, design="independent", intercept=True, checks=False)
    function = se.studies.coverage(model, np.ones(4), np.zeros(4))
    drawn = function.keywords["design"].draw(function.keywords["truth"], 40, KEY)
    assert np.array_equal(drawn.pairs()[0], x)
    assert np.array_equal(drawn.pairs()[1], u)
    truth = function.keywords["truth"]
    assert np.allclose(truth.root @ truth.root.T, model.covariance)
    far = truth.step(x, u) - x @ model.A.T - u @ model.B.T
    assert np.allclose(far, model.c)
    found = se.Study(function, {}, replicates=500, rng=2).run()
    exactly(500 - found.values["inside"].sum(), 500)
    at_most(500 - found.values["covered"].sum(), 500)


def test_runs_of_ones_own_are_repeated_in_turn() -> None:
    own = uneven()
    function = se.studies.coverage((A, B), [1, 0], [0, 0], noise=0.1, runs=own)
    assert function.keywords["size"] == 3
    drawn = function.keywords["design"].draw(function.keywords["truth"], 5, KEY)
    assert drawn.lengths.tolist() == [4, 9, 2, 4, 9]
    for (x, u), (x2, u2) in zip([*own.runs, *own.runs], drawn.runs, strict=False):
        assert np.array_equal(u, u2)
        assert np.array_equal(x[0], x2[0])
    assert not np.array_equal(drawn.runs[0][0], drawn.runs[3][0])  # new noise in each


# -- how coverage is counted -----------------------------------------------------------------------


def test_counts_of_coverage_see_what_is_wrong() -> None:
    count = failures(lambda gen: gen.random(3) < [0.05, 0.1, 0.01], 1500, 1)
    exactly(count[0], 1500)
    at_most(count[[0, 2]], 1500)
    for judge in (exactly, at_most):
        with pytest.raises(AssertionError, match="of 1500, expected"):
            judge(count[[0, 1]], 1500)
    with pytest.raises(AssertionError, match="of 1500, expected"):
        exactly(count[2], 1500)

    def broken(gen: np.random.Generator) -> bool:
        if gen.random() < 0.1:
            raise ValueError("lost")
        return False

    with pytest.raises(AssertionError, match="ValueError: lost"):
        failures(broken, 200, 1)


# -- units -----------------------------------------------------------------------------------------


def test_units_are_in_data_sets_and_figures() -> None:
    xarray = pytest.importorskip("xarray")

    def fall(key: se.Key, time: float) -> dict[str, Any]:
        return {"height": [5.0 * time**2, 1.0], "count": 3}

    fall.units = {"height": "m", "time": "s", "count": "1"}  # type: ignore[attr-defined]
    results = se.Study(fall, {"time": [1.0, 2.0]}, replicates=3, rng=1).run()
    assert results.units == fall.units  # type: ignore[attr-defined]
    data = results.to_xarray()
    assert isinstance(data, xarray.Dataset)
    assert data["height"].attrs == {"units": "m"}
    assert data["time"].attrs == {"units": "s"}
    assert data["count"].attrs == {"units": "1"}
    assert data.attrs["key"] == results.about["key"]
    assert results.select(time=1.0).to_xarray()["height"].attrs == {"units": "m"}
    assert results.to_dict()["units"]["height"] == "m"
    pytest.importorskip("matplotlib")
    ax = results.plot("time", "height[0]")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time [s]", "height[0] [m]")
    assert results.plot("time", "count").get_ylabel() == "count"

    def both(key: se.Key, time: float, place: int) -> dict[str, float]:
        return {"height": time * place}

    both.units = {"place": "m", "time": ""}  # type: ignore[attr-defined]
    ax = (
        se.Study(both, {"time": [1, 2], "place": [3, 4]}, replicates=2, rng=1)
        .run()
        .plot("time", "height", "place")
    )
    assert [text.get_text() for text in ax.texts] == [
        "place = 3 m",
        "place = 4 m",
    ]
    plain = se.Study(lambda key: {"x": 1.0}, {}, replicates=1, rng=1).run()
    assert plain.units == {}


# -- bad input -------------------------------------------------------------------------------------

START = ([1, 0], [0, 0])
WRONG = {
    "`noise` must be given": lambda s: s.coverage((A, B), *START),
    "`noise` must be standard deviations >= 0": lambda s: s.coverage(
        (A, B), *START, noise=[0.1, -1]
    ),
    r"`starts` must have shape \(2,\)": lambda s: s.coverage((A, B), *START, noise=1, starts=[1]),
    "did you mean 'sigma'": lambda s: s.coverage((A, B), *START, noise=1, identify={"sigm": 1}),
    "`identify argument` must be": lambda s: s.coverage(
        (A, B), *START, noise=1, identify={"rng": 1}
    ),
    "must not have noise='bounded'": lambda s: s.coverage(
        (A, B), *START, noise=1, identify={"noise": "bounded", "sigma": 1}
    ),
    "`bound` must be a mapping": lambda s: s.coverage((A, B), *START, noise=1, bound=0.1),
    "`runs` must have n=1": lambda s: s.coverage(
        ([[1.0]], [[1.0]]), [1], [0], noise=1, runs=uneven()
    ),
    r"`delta` must be in \(0, 1\)": lambda s: s.coverage((A, B), *START, noise=1, delta=2),
    "`size` must be": lambda s: s.coverage((A, B), *START, noise=1, size=0),
    "`axis` must be one of": lambda s: s.coverage((A, B), *START, noise=1)(KEY, length=3),
    "function.units": lambda s: s.Study(Unfit(), {}, replicates=1),
}


class Unfit:
    units = "m"

    def __call__(self, key: se.Key) -> dict[str, float]:
        return {"x": 1.0}


@pytest.mark.parametrize("text", WRONG)
def test_bad_input_is_named(text: str) -> None:
    with pytest.raises((InputError, InputTypeError), match=text):
        WRONG[text](se.studies)


def test_distances_have_the_unit_that_all_states_share():
    A, B, units = [[1.0, 0.1], [0.0, 1.0]], [[0.0], [1.0]], {"p": "m", "q": "m", "f": "N"}
    made = {
        unit: se.System(A, B, states=["p", "q"], inputs=["f"], units={**units, "q": unit})
        for unit in ("m", "m/s")
    }
    ends = [1.0, 0.0], [0.0, 0.0]
    runs = se.studies.coverage(made["m"], *ends, noise=0.01)
    assert [runs.units[name] for name in ("bound", "error", "noise", "ratio")] == [*"mmm1"]
    assert "bound" not in se.studies.coverage(made["m/s"], *ends, noise=0.01).units
