"""`ModelStream`: equal to the twin and to `identify`, refusals, saved states.

How often its regions hold is tested in `test_model_stream_coverage`.
"""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

import stochens_rs as se
from declarations import opts
from identification_data import SKEWED, check, rolled
from stochens_rs import _core
from stochens_rs._base import files as state_file
from stochens_rs.exceptions import (
    DataWarning,
    InputError,
    NonFiniteError,
    ShapeError,
    StateError,
    StochensError,
)
from stochens_rs.streams.snapshot import look_after, planned
from stream_problems import same
from twin import anytime as at
from twin import certified_control as cc
from twin import triangle as tr


def filled(N=40, n=4, m=2, seed=1, **options):
    """A stream of N pairs, and their z and y."""
    gen = np.random.default_rng(seed)
    Theta, z = 0.5 * gen.standard_normal((n, n + m)), gen.standard_normal((N, n + m))
    y = z @ Theta.T + 0.1 * gen.standard_normal((N, n))
    stream = se.ModelStream(n, m, **opts(**({"sigma": 0.1} | options)))
    stream.update(z[:, :n], z[:, n:], y)
    return stream, z, y


# -- against the twin and `identify` ---------------------------------------------------------------


@pytest.mark.usefixtures("noise_by_formula")
def test_regions_for_more_pairs_are_those_of_the_twin_and_of_identify():
    gen = np.random.default_rng(3)
    z = gen.standard_normal((400, 6))
    y = z @ gen.standard_normal((6, 4)) + gen.standard_normal((400, 4)) @ SKEWED.T
    data, pairs = tr.triangle(z, y), se.Trajectories.from_pairs(z[:, :4], z[:, 4:], y)
    for options in (
        {},
        {"covariance": "scalar"},
        {"sigma": 2.0},
        {"covariance": SKEWED @ SKEWED.T},
    ):
        stream = se.ModelStream(4, 2, **opts(**options))
        stream.update(pairs)
        ours = stream.model.region(0.02, frobenius=True)
        model = se.identify(pairs, **opts(**options, checks=False))
        theirs = model.region(0.02, frobenius=True, anytime=True)
        check(ours.parts[0].factor, theirs.parts[0].factor, rtol=1e-10)
        check(ours.frobenius, theirs.frobenius, rtol=1e-10)
        check(ours.parts[0].S, theirs.parts[0].S, rtol=1e-9)
        check(ours.centre, theirs.centre, rtol=1e-9, atol=1e-12)
    expected = at.gaussian_noise(data, 0.01, at.GRID, anytime=True).factor
    stream = se.ModelStream(4, 2)
    stream.update(pairs)
    check(stream.model.region(0.02).parts[0].factor, expected, rtol=1e-7)  # 1 - 3e-8 is rounded


def test_an_intercept_is_a_column():
    gen = np.random.default_rng(4)
    x, u = gen.standard_normal((30, 2)), gen.standard_normal((30, 1))
    y = 0.5 * x + u + [1.0, -2.0] + 0.1 * gen.standard_normal((30, 2))
    stream = se.ModelStream(2, 1, **opts(sigma=0.1, intercept=True, scale=[2.0, 2.0, 1.0]))
    stream.update(x, u, y)
    data = se.Trajectories.from_pairs(x, u, y)
    model = se.identify(
        data, **opts(sigma=0.1, intercept=True, scale=[2.0, 2.0, 1.0], checks=False)
    )
    check(stream.model.c, model.c)
    check(stream.model.region().radius, model.region().radius)
    # x(2) = A x(1) + B u(1) + c
    look = stream.look([1.0, 0.0], [0.0, 0.5], tol=1.0, steps=2)
    Theta = np.hstack([stream.model.A, stream.model.B, stream.model.c[:, None]])
    end = np.array([1.0, 0.0])
    for k in range(2):
        end = Theta @ np.concatenate([end, look.u[k], [1.0]])
    check(look.certificate.parts["reach"], np.linalg.norm(end - [0.0, 0.5]), atol=1e-9)


def test_a_look_is_that_of_the_twin():
    """One step, known noise: certificate and forecast."""
    stream, z, y = filled(200)
    data, x0, xf = tr.triangle(z, y), np.ones(4), np.full(4, 0.2)
    u = np.linalg.lstsq(stream.model.B, xf - stream.model.A @ x0)[0]
    reach = np.linalg.norm(stream.model.A @ x0 + stream.model.B @ u - xf)
    for tol in (reach + 1.0, reach + 0.03, 0.5 * reach):
        look = stream.look(x0, xf, tol=tol)
        twin = at.look(data, np.concatenate([x0, u]), xf, 0.1, 0.05, tol)
        check(look.u[0], u, rtol=1e-9, atol=1e-12)
        check(look.certificate.target, twin.certificate, rtol=1e-9)
        assert look.stop == (twin.certificate <= tol)
        if look.stop:
            assert look.forecast == 0.0
        elif tol < reach:
            assert look.forecast == twin.enough == np.inf
        else:  # the twin stops after two iterations
            check(look.forecast + 200, twin.enough, rtol=0.03)


@pytest.mark.parametrize("options", [{}, {"sigma": None}, {"sigma": None, "design": "independent"}])
def test_several_steps_are_those_of_the_twin_and_bound_models_of_the_region(options):
    """The worst of models on the edge of the region is below the certificate."""
    stream, z, y = filled(96, first=48 if "design" in options else None, **options)
    x0, xf, K = np.ones(4), np.zeros(4), 4
    look = stream.look(x0, xf, tol=1.0, steps=K)
    region = stream.model.region(frobenius=True)
    part, fitted = region.parts[0], tr.fit(tr.triangle(z, y))
    radii = {"spectral": np.sqrt(part.factor), "frobenius": region.frobenius}
    twin = cc.several_steps(fitted._replace(S=part.S), x0, look.u, **radii)
    check(look.certificate.parts["model error"], twin.radii[-1], rtol=1e-8)
    check(
        look.certificate.target,
        look.certificate.parts["reach"] + look.certificate.parts["model error"],
    )
    end, gen = rolled(fitted.H, x0, look.u), np.random.default_rng(6)
    root, worst = np.linalg.cholesky(part.S), 0.0
    for _ in range(500):
        G = gen.standard_normal((4, 6))
        D = np.sqrt(part.factor) * root @ (G / np.linalg.norm(G, 2)) @ np.linalg.pinv(part.root.T)
        assert region.contains(*np.hsplit(fitted.H + 0.999 * D, [4]))
        worst = max(worst, np.linalg.norm(rolled(fitted.H + D, x0, look.u) - end))
    assert (
        0.1 * look.certificate.parts["model error"] < worst <= look.certificate.parts["model error"]
    )


def test_planned_looks():
    sizes = [planned(10, j) for j in range(9)]
    assert sizes == [10, 15, 20, 29, 40, 57, 80, 114, 160]
    assert [look_after(10, N) for N in (1, 10, 11, 15, 16, 160, 161)] == [0, 0, 1, 1, 2, 8, 9]
    assert planned(2**50, 101) > 2**100  # exact in whole numbers
    stream, z, y = filled(57, sigma=None, design="independent", first=10)
    part = stream.model.region().parts[0]
    share = at.look_shares(6, 0.05)[5]
    check(part.factor, _core.roy_quantile(4, 6, 51, share, 1))
    stream.update(z[0, :4], z[0, 4:], y[0])
    for refused in (stream.model.region, lambda: stream.look(np.ones(4), np.ones(4), tol=1.0)):
        with pytest.raises(InputError, match=r"there are 58, and the next look is at 80$"):
            refused()
    assert stream.model.next_look == 80
    assert stream.model.A.shape == (4, 4)  # the model itself is no look at a region
    assert stream.model._size_after(100.0) == 114
    later = stream.model._after(114).region()
    assert later.delta == at.look_shares(8, 0.05)[7]
    check(later.parts[0].factor, _core.roy_quantile(4, 6, 108, later.delta, 1))


def test_the_covariance_is_bounded_for_any_number_of_pairs():
    """Where its level is too small to be drawn, a closed form takes over."""
    for n, N, delta, drawn in (
        (4, 1000, 1e-9, None),
        (2, 300, 1e-7, 181.83068680716207),
        (10, 100_000, 1e-12, None),
        (12, 40, 1e-8, 1.7617328713667662),
    ):
        found = _core.smallest_quantile(n, N, delta, 1)
        closed = max(0.0, np.sqrt(N) - np.sqrt(n) - np.sqrt(-2.0 * np.log(delta))) ** 2
        assert closed <= found * (1 + 1e-12)
        if drawn is not None:  # by Pfaffians in NumPy; 1 - delta is rounded
            check(found, drawn, rtol=1e-4)
    stream, _, _ = filled(60_000, n=10, m=1, sigma=None)
    model = stream.model
    assert model.region().parts[0].factor < 3.0 * 1.2 * 11 * 10 / model.size


def test_nothing_is_certain_without_data():
    """Neither without pairs, nor along directions that the data do not show."""
    for options in ({"sigma": 0.1}, {}, {"covariance": "scalar"}):
        stream = se.ModelStream(2, 1, **opts(**options))
        look = stream.look([1.0, 0.0], [0.0, 0.0], tol=1.0)
        assert (look.certificate.target, look.forecast, look.stop) == (np.inf, np.inf, False)
        assert "after 0 pairs, tol 1, forecast: unknown" in repr(look)
        assert stream.model.missing == ("x[0]", "x[1]", "u[0]")
        assert stream.model.region().bound([0.0, 1.0], [0.0]) == np.inf
        stream.update([1.0, 0.0], [0.0], [1.0, 0.0])
        assert stream.look([0.0, 1.0], [0.0, 0.0], tol=1.0, steps=3).certificate.target == np.inf
    stream = se.ModelStream(1, 1, **opts(design="independent", first=5))
    stream.update(np.arange(5.0)[:, None], np.zeros((5, 1)), 2.0 * np.arange(5.0)[:, None])
    with pytest.warns(DataWarning, match="certificate is infinite: .* has no residual"):
        look = stream.look([1.0], [2.0], tol=1.0, u=[[0.0]])
    assert look.certificate.target == look.forecast == np.inf
    assert look.certificate["target"].reason == stream.model.doubts[0]
    assert "2 warnings" in repr(look)
    stream = se.ModelStream(1, 1, **opts(design="independent", first=5, exact=[0]))
    stream.update(np.arange(5.0)[:, None], np.zeros((5, 1)), 2.0 * np.arange(5.0)[:, None])
    assert stream.look([1.0], [2.0], tol=1.0, u=[[0.0]]).certificate.target < 1e-9
    assert stream.look([0.0], [1.0], tol=1.0, u=[[1.0]]).certificate.target == np.inf


@pytest.mark.parametrize("options", [{}, {"sigma": None}])
def test_a_far_forecast_grows_with_the_square_of_the_error(options):
    """Beyond 2^30 pairs a tenth of the error takes a hundred times the pairs."""
    stream, _, _ = filled(60, **options)
    x0, xf = np.ones(4), np.full(4, 0.2)
    u = np.linalg.lstsq(stream.model.B, xf - stream.model.A @ x0)[0]
    reach = stream.look(x0, xf, tol=1.0, u=[u]).certificate.parts["reach"]
    near, far, farther = (
        stream.look(x0, xf, tol=reach + room, u=[u]).forecast for room in (2e-4, 1e-7, 1e-8)
    )
    assert near < 2.0**30 < far
    assert farther == pytest.approx(100.0 * far, rel=1e-3)
    # and the two rules meet: logarithms of the law of the noise are all that they differ by
    assert far == pytest.approx(4e6 * near, rel=0.3)


def measured(gen, N, sigma=0.05):
    """N runs of 10 steps of a system of two states, with inputs of [-1, 1]."""
    A, B = np.array([[1.0, 0.2], [-0.1, 0.8]]), np.array([[0.0], [0.3]])
    x, u = np.empty((N, 11, 2)), gen.uniform(-1.0, 1.0, (N, 10, 1))
    x[:, 0] = gen.standard_normal((N, 2))
    for k in range(10):
        x[:, k + 1] = x[:, k] @ A.T + u[:, k] @ B.T + sigma * gen.standard_normal((N, 2))
    return (A, B), se.Trajectories(x, u)


WITHIN = {
    "free": {},
    "inputs": {"limits": (-0.6, 0.6)},
    "states": {"limits": se.Limits(u=(-1.0, 1.0), x=([-1.0, -0.33], [1.2, 0.3]), soft=False)},
    "path": {"limits": (-1.0, 1.0), "cost": se.Cost(reference=np.tile([0.3, 0.1], (13, 1)))},
}


@pytest.mark.parametrize("sigma", [0.05, None])
@pytest.mark.parametrize("kind", WITHIN)
def test_the_forecast_of_runs_is_what_it_takes(kind, sigma):
    """They bring the certificate to .75 to 1.25 of the tolerance, to 1.45 by limits of states."""
    tol, found = 0.12, []
    for seed in range(6):
        gen = np.random.default_rng([seed, 71])
        stream = se.ModelStream(2, 1, **opts(sigma=sigma, delta=0.04))

        task = {"tol": tol, "steps": 12, "xf": None if kind == "path" else [0.3, 0.1]}
        system, data = measured(gen, 20)
        stream.update(data)
        before = stream.look([1.0, 0.0], **task, **WITHIN[kind])
        assert not before.stop
        assert before.runs == before.forecast / 10.0 > 10.0
        assert f"{before.runs:.3g} runs like those so far" in repr(before)
        stream.update(measured(gen, int(np.ceil(before.runs)))[1])
        after = stream.look([1.0, 0.0], **task, **WITHIN[kind])
        assert (after.missing, after.certificate.delta) == (0.0, 0.04)
        if kind == "states":
            x = se.simulate(system, [1.0, 0.0], after.u).states[1:]
            assert (x.min(axis=0) >= [-1.0, -0.33]).all()
            assert (x.max(axis=0) <= [1.2, 0.3]).all()
        found.append((before.missing, after.certificate.target / tol))
    missing, ratios = np.array(found).T
    assert not missing.any()
    assert 0.75 < ratios.min() < 1.1
    assert 0.9 < ratios.max() < (1.45 if kind == "states" else 1.25)


def test_runs_are_told_apart():
    """Whole runs, single pairs of one run, and pairs that have nothing to do with each other."""
    gen = np.random.default_rng(5)
    _, data = measured(gen, 7)
    whole, single = se.ModelStream(2, 1, **opts(sigma=0.1)), se.ModelStream(2, 1, **opts(sigma=0.1))
    whole.update(data)
    for pair in zip(*data.pairs(), strict=True):
        single.update(*pair)
    assert whole.model.runs == single.model.runs == 7
    again = pickle.loads(pickle.dumps(single))
    x = data.pairs()[2][-1]
    again.update(x, [0.0], x)
    assert again.model.runs == 7
    assert filled(40)[0].model.runs == 40
    later = whole.look([1.0, 0.0], [0.3, 0.1], tol=0.01, steps=12)
    assert repr(later).endswith("runs like those so far>")


def test_what_cannot_be_reached_within_limits_has_no_forecast():
    _, data = measured(np.random.default_rng(6), 20)
    stream = se.ModelStream(2, 1, **opts(sigma=0.05))
    stream.update(data)
    options = {"tol": 0.1, "steps": 12}
    far = stream.look([1.0, 0.0], [0.3, 0.1], limits=(-0.01, 0.01), **options)
    assert far.forecast == far.runs == np.inf
    assert repr(far).endswith("forecast: never>")
    above = se.Limits(u=(-1.0, 1.0), x=(0.5, 9.0), soft=False)  # the target is not within
    lost = stream.look([1.0, 0.0], [0.3, 0.1], limits=above, **options)
    assert lost.forecast == np.inf
    with pytest.raises(InputError, match="`limits` must be left out with `u`"):
        stream.look([1.0, 0.0], [0.3, 0.1], u=np.zeros((12, 1)), limits=(-1.0, 1.0), **options)
    with pytest.raises(InputError, match="`cost` must be left out with `gain`"):
        stream.look(gain=[[0.0, 0.0]], cost=se.Cost())


# -- what is refused -------------------------------------------------------------------------------


def test_bad_pairs_are_refused_before_any_is_taken_in():
    stream, z, y = filled()
    before = pickle.dumps(stream)
    bad = y.copy()
    bad[-1, 2] = np.nan
    huge = np.full_like(y, 1.7e308)
    runs = se.Trajectories.from_pairs(z[:, :3], z[:, 3:], y[:, :3])
    run = se.Trajectories(y, z[1:, 4:])
    named = se.Trajectories.from_pairs(z[:, :4], z[:, 4:], y, state_names=list("abcd"))
    timed = se.Trajectories.from_pairs(z[:, :4], z[:, 4:], y, dt=0.1)
    for pairs, error, text in (
        ((z[:, :4], z[:, 4:], bad), NonFiniteError, r"`x_next\[39, 2\]` is nan"),
        ((z[:, :4], z[:, 4:], y[:-1]), ShapeError, r"`x_next` must have shape \(40, 4\)"),
        ((z[:, :3], z[:, 4:], y), ShapeError, r"`x` must have shape \(n, 4\)"),
        ((z[0, :4], z[:, 4:], y), ShapeError, "`u` must have shape"),
        ((z[:, :4], z[:, 4:], huge), StochensError, "overflow"),
        ((z[:, :4],), InputError, "`u` and `x_next` must be given"),
        ((runs,), InputError, "must have n=4 m=2"),
        ((timed,), InputError, r"must have dt=None as ModelStream\(dt=\), got dt=0\.1"),
        ((run, z[:, 4:], y), InputError, "must be left out with Trajectories"),
    ):
        with pytest.raises(error, match=text):
            stream.update(*pairs)
        assert pickle.dumps(stream) == before
    other = se.ModelStream(4, 2, state_names=list("efgh"))
    with pytest.raises(InputError, match=r"the states 'e', .* or none by name, got 'a'"):
        other.update(named)
    independent = se.ModelStream(4, 2, **opts(design="independent"))
    with pytest.raises(InputError, match=r"single pairs for design='independent'"):
        independent.update(run)
    stream.update(run)
    assert stream.size == 79


def test_regions_share_the_delta_of_the_stream():
    stream, _, _ = filled(delta=0.01)
    model = stream.model
    assert model.region(0.001).radius > model.region().radius == model.region(0.01).radius
    with pytest.raises(InputError, match=r"`delta` must be at most 0\.01"):
        model.region(0.05)
    with pytest.raises(InputError, match="`future` must be 0"):
        model.region(future=1)


# -- saved and continued ---------------------------------------------------------------------------

OPTIONS = {
    "known": {"sigma": 0.1, "dt": 0.1, "state_names": ["ü", "v"], "input_names": ["force"]},
    "unknown": {"scale": [1.0, 2.0, 3.0], "delta": 0.1},
    "bounded": {"noise": "bounded", "sigma": 0.3, "intercept": True},
    "matrix": {"noise": "sub-gaussian", "covariance": [[2.0, 1.0], [1.0, 3.0]]},
    "planned": {"design": "independent", "covariance": "diagonal", "first": 7},
}


@pytest.mark.usefixtures("noise_by_formula")
@pytest.mark.parametrize("kind", OPTIONS)
def test_resuming_is_never_having_stopped(tmp_path: Path, kind: str) -> None:
    gen = np.random.default_rng(9)
    whole, part = (se.ModelStream(2, 1, **opts(**OPTIONS[kind])) for _ in range(2))
    assert same(whole, part)
    for count in (1, 4, 300, 1, 14):
        x, u, y = (gen.standard_normal((count, k)) for k in (2, 1, 2))
        whole.update(x, u, y)
        part.update(x, u, y)
        part.save(tmp_path / "a.state")
        part = se.ModelStream.load(tmp_path / "a.state")
        assert same(whole, part)
        assert same(whole, pickle.loads(pickle.dumps(part)))
    assert repr(part) == repr(whole)
    assert part.model.next_look == (320 if kind != "planned" else planned(7, look_after(7, 320)))
    if kind != "planned":
        a, b = (s.look([1.0, 0.0], [0.0, 0.0], tol=1.0, steps=2) for s in (whole, part))
        assert pickle.dumps(a) == pickle.dumps(b) == pickle.dumps(pickle.loads(pickle.dumps(a)))
    again = pickle.loads(pickle.dumps(whole.model))
    assert np.array_equal(again.A, whole.model.A)
    assert again.state_names == whole.model.state_names


@pytest.fixture
def small(tmp_path: Path) -> Path:
    stream = se.ModelStream(1, 1, intercept=True)
    stream.update([[1.0], [2.0]], [[1.0], [0.0]], [[0.5], [1.0]])
    stream.save(tmp_path / "s.state")
    return tmp_path / "s.state"


ARRAYS = [
    ("triangle", lambda a: a * np.nan),
    ("triangle", lambda a: a[:-1]),
    ("triangle", lambda a: 1.1 * a),  # the column of 1 is that of more pairs
    ("scale", lambda a: 0.0 * a),
    ("scale", lambda a: 2.0 * a),  # also for the offset
    ("mixtures", lambda a: a * 2.0),  # another event
    ("end", lambda a: a * np.nan),
    ("record", lambda a: a[:-1]),
]
WRONG = [
    {"size": 3}, {"size": 2**63}, {"size": -2}, {"size": 2.5}, {"runs": 0}, {"runs": 3},
    {"n": 0}, {"m": 0}, {"m": 2}, {"intercept": False}, {"intercept": 1}, {"first": 0},
    {"delta": 0.0}, {"delta": "nan"}, {"delta": 1.05}, {"dt": -1.0}, {"dt": "inf"},
    {"schema": "stochens-record/2"}, {"type": "Region"}, {"state_names": ["u[0]"]},
    {"state_names": [3]}, {"input_names": []}, {"input_names": ["\ud800"]}, {"more": 1},
]  # fmt: skip
DECLARED = [
    {"noise": "bounded"},  # without sigma
    {"covariance": "known"},
    {"design": "independent", "noise": "sub-gaussian"},
    {"exact": [1]},
]


def refused(path: Path, sections: dict) -> None:
    state_file.save(path, "pairs", sections)  # sealed with a correct digest
    with pytest.raises(StateError, match=r"s\.state: ") as caught:
        se.ModelStream.load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("name", "change"), ARRAYS)
def test_arrays_that_cannot_be_a_stream_are_refused(small: Path, name: str, change) -> None:
    sections = se.ModelStream.load(small)._to_sections()
    sections[name] = np.ascontiguousarray(change(sections[name]))
    refused(small, sections)
    del sections[name]
    state_file.save(small, "pairs", sections)
    with pytest.raises(StateError, match=name):
        se.ModelStream.load(small)


@pytest.mark.parametrize("change", [*WRONG, *({"assumptions": one} for one in DECLARED)])
def test_declarations_that_cannot_be_a_stream_are_refused(small: Path, change: dict) -> None:
    sections = se.ModelStream.load(small)._to_sections()
    tree = json.loads(sections["record"].tobytes())
    if isinstance(change.get("assumptions"), dict):
        change = {"assumptions": tree["assumptions"] | change["assumptions"]}
    text = json.dumps(tree | change).encode()
    refused(small, sections | {"record": np.frombuffer(text, np.uint8)})
