"""Models of outputs: windows against their definition, oracles, the model, and what is refused."""

from __future__ import annotations

import re

import numpy as np
import pytest

import stochens_rs as se
from declarations import opts
from hidden_outputs import Rig
from stochens_rs import _core
from stochens_rs.exceptions import InputError
from stochens_rs.identification import Regressors
from stochens_rs.identification.window import rows_of
from twin import windows as twin


def one_run(**options):
    return se.Trajectories(*twin.d1(), outputs=True, **options)


def arx(gen, runs=12, steps=60, sensor=0.0):
    """Runs of y+ = 1.2 y - .5 y_- + u + .4 u_- + w with feedback from what was read."""
    outputs, inputs = [], []
    for _ in range(runs):
        y, u = [0.0, 0.0], [0.0]
        for _ in range(steps):
            u.append(gen.standard_normal() - 0.3 * y[-1])
            y.append(1.2 * y[-1] - 0.5 * y[-2] + u[-1] + 0.4 * u[-2] + 0.1 * gen.standard_normal())
        noisy = np.array(y)[:, None] + sensor * gen.standard_normal((steps + 2, 1))
        outputs.append(noisy)
        inputs.append(np.array(u)[:, None])
    return se.Trajectories(outputs, inputs, outputs=True)


KINDS = [
    {"lags": 1},
    {"lags": 3},
    {"lags": 2, "delay": 2},
    {"lags": 1, "delay": 1, "intercept": True},
    {"filters": (0.5, 1)},
    {"filters": (0.8, 3), "intercept": True},
    {"filters": (0.3, 2), "delay": 2},
]


def window_of(kind, outputs, inputs):
    pole, count = kind.get("filters", (None, kind.get("lags")))
    names = tuple(f"y{i}" for i in range(outputs)), tuple(f"u{j}" for j in range(inputs))
    burn = 4 if pole is not None else 0
    return Regressors(*names, count, pole, kind.get("delay", 0), kind.get("intercept", False), burn)


@pytest.mark.parametrize("sizes", [(1, 1), (2, 1), (1, 2), (3, 2)])
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_windows_are_what_their_definition_says(kind, sizes):
    gen = np.random.default_rng(1)
    runs = [
        (gen.standard_normal((T + 1, sizes[0])), gen.standard_normal((T, sizes[1])))
        for T in (17, 3, 25)
    ]
    data = se.Trajectories(*map(list, zip(*runs, strict=True)), outputs=True)
    window = window_of(kind, *sizes)
    expected = [
        np.concatenate([twin.rows(y, u, t, **kind), y[t + 1]])
        for y, u in runs
        for t in range(window.fill, len(u))
    ]
    np.testing.assert_allclose(rows_of(window, data)[1], expected, atol=1e-13)
    assert window.length == len(window.regressor_names) == len(expected[0]) - sizes[0]


@pytest.mark.parametrize("sizes", [(1, 1), (2, 1), (3, 2)])
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_the_loop_predicts_as_the_window_does(kind, sizes):
    gen = np.random.default_rng(2)
    window = window_of(kind, *sizes)
    Theta = 0.3 * gen.standard_normal((sizes[0], window.length))
    J, ABc, G = window.loop(Theta)
    T, one = window.fill + 9, np.ones(int(window.intercept))
    y, u = gen.standard_normal((T + 1, sizes[0])), gen.standard_normal((T, sizes[1]))
    x = window.state_of(y[: window.fill + 1], u[: window.fill])
    assert len(x) == len(window.state_names) == len(ABc)
    for t in range(window.fill, T):
        v = np.concatenate([x, u[t], one])
        np.testing.assert_allclose(J @ v, twin.rows(y, u, t, **kind), atol=1e-12)
        after = window.core.advance(x, y[t + 1], u[t])
        x = ABc @ v + G @ (y[t + 1] - Theta @ (J @ v))
        np.testing.assert_allclose(x, after, atol=1e-12)
    np.testing.assert_allclose(x, window.state_of(y, u), atol=1e-12)


def test_oracle_of_lags():
    model = se.identify(one_run(), scale=1.0, checks=False, window=se.Window(lags=2))
    block = model.blocks[0]
    H = [1.204062117397, -0.4862093371455, 1.018049204415, 0.4159845872933]
    np.testing.assert_allclose(model.coefficients[0], H, rtol=1e-10)
    np.testing.assert_allclose(block.S, 1.150019091501, rtol=1e-10)
    log_det = 2.0 * np.log(np.linalg.svd(block.root)[1]).sum()
    np.testing.assert_allclose(log_det, 15.84459596928, rtol=1e-10)
    assert model.size == 59


@pytest.mark.filterwarnings("ignore:the residuals of")
def test_oracle_of_a_finite_difference():
    y, u = twin.d1()
    speed = np.diff(y, axis=0, prepend=y[:1]) / 0.1
    data = se.Trajectories(np.hstack([y, speed])[1:], u[1:])
    model = se.identify(data, checks=False)
    S = model.blocks[0].S
    scale = np.sqrt(np.diag(S))
    assert np.linalg.eigvalsh(S / scale / scale[:, None])[0] < 1e-12
    assert re.search("tied exactly.*outputs=.*Noise\\(exact=", model.doubts[0])
    # readings are no states: neither cure can be had there
    read = se.Trajectories(np.hstack([y, speed])[1:], u[1:], outputs=True)
    model = se.identify(read, window=se.Window(lags=1), checks=False)
    tied = [text for text in model.doubts if "tied exactly" in text]
    assert tied
    assert not any("exact=" in text or "outputs=" in text for text in tied)


def test_oracle_of_lost_rows():
    y, u = twin.d1()
    table = {"y": y[:, 0].copy(), "u": np.append(u[:, 0], np.nan), "t": 0.5 * np.arange(61)}
    keep = np.setdiff1d(np.arange(61), [10, 11, 30])
    table = {name: column[keep] for name, column in table.items()}
    data = se.Trajectories.from_table(table, outputs=["y"], inputs=["u"], time="t")
    model = se.identify(data, scale=1.0, checks=False, window=se.Window(lags=2))
    H = [1.18569387532, -0.4779681122702, 1.034331191496, 0.4330868101888]
    np.testing.assert_allclose(model.coefficients[0], H, rtol=1e-10)
    np.testing.assert_allclose(model.blocks[0].S, 0.957983156482, rtol=1e-10)
    assert model.size == 52


def test_oracle_of_filters():
    window = Regressors(("y",), ("u",), 2, 0.5, 0, False, 5)
    rows = rows_of(window, one_run())[1]
    first = [-0.1426266666667, 0.01380833333333, -0.53125, -0.25]
    np.testing.assert_allclose(rows[0, :4], first, rtol=1e-11)
    f = _core.fit(rows, 4, len(rows), 1)
    H = [0.4968423224089, -0.5599124900268, 2.098924685118, 3.349543949936]
    np.testing.assert_allclose(f.H[0], H, rtol=1e-9)
    np.testing.assert_allclose(f.S, 2.913740359592, rtol=1e-10)
    assert len(rows) == 55


def test_model_of_outputs_has_the_matrices_of_its_window():
    model = se.identify(arx(np.random.default_rng(1)), window=se.Window(lags=2))
    a, b, c, d = model.coefficients[0]
    np.testing.assert_array_equal(model.A, [[a, b, d], [1, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(model.B, [[c], [0], [1]])
    assert (model.n, model.m, model.n_outputs, model.outputs) == (3, 1, 1, ("y[0]",))
    assert model.state_names == ("y[0]", "y[0](-1)", "u[0](-1)")
    region = model.region(0.05)
    assert region.centre.shape == (1, 4)
    assert region.contains([[1.2]], [[-0.5, 1.0, 0.4]])
    assert region.contains([[1.2, -0.5, 1.0, 0.4]])
    assert not region.contains([[0.2, -0.5, 1.0, 0.4]])
    assert "inputs from logged signals only" in region.assumption


def test_oracle_of_a_tail():
    """rho^2 = 18.92955190225, a = 26.78537416554, N = 43, tail .05: 13.6045151291."""
    rows = rows_of(Regressors(("y",), ("u",), 2), one_run())[1]
    first, later = (
        _core.Estimate(_core.triangle(np.ascontiguousarray(part), 1), len(part), 1, 3, False)
        for part in (rows[:16], rows[16:])
    )
    H = [1.179264636598, -0.4648315778423, 1.034497377411, 0.4284450902335]
    np.testing.assert_allclose(later.Theta[0], H, rtol=1e-9)
    a = _core.smallest_quantile(1, 43, 0.025, 1)
    np.testing.assert_allclose(a, 26.78537416554, rtol=1e-9)

    def widened(rho2, tail):
        more = tail * np.sqrt(43)
        rho, left = np.sqrt(rho2) + more, np.sqrt(a) - more
        return rho**2 / (left**2 - rho**2)

    np.testing.assert_allclose(widened(18.92955190225, 0.05), 13.6045151291, rtol=1e-9)
    law, how = ("adaptive", "gaussian", "full", None), (False, None, 0, False, "mixture", False, 1)
    plain, wide, lost = (
        later.region(law, first, 0.05, *how, tail).parts[0].factor for tail in (0.0, 0.05, 0.5)
    )
    np.testing.assert_allclose(wide, widened(a * plain / (1.0 + plain), 0.05), rtol=1e-9)
    assert lost == np.inf


def test_a_declared_tail_widens_the_region_and_is_printed(tmp_path):
    data = arx(np.random.default_rng(1))
    regions = []
    for tail in (0.0, 0.05):
        model = se.identify(data, window=se.Window(lags=2, tail=tail))
        model.save(tmp_path / f"{tail}.safetensors")
        assert se.Model.load(tmp_path / f"{tail}.safetensors").assumptions.tail == tail
        regions.append(model.region(0.05))
    assert regions[0].radius < regions[1].radius < np.inf
    assert "tail of 0.05" in regions[1].assumption
    assert "tail" not in regions[0].assumption
    for bad in (-1.0, np.nan, np.inf, "much"):
        with pytest.raises(se.exceptions.StochensError, match="tail"):
            se.identify(data, window=se.Window(lags=2, tail=bad))
    pairs = se.Trajectories.from_pairs([[1.0], [2.0]], [[1.0], [0.0]], [[0.0], [1.0]])
    with pytest.raises(InputError, match="`tail` must be 0"):
        se.identify(pairs, noise=se.Noise(design="independent"), window=se.Window(tail=0.1))


# -- which window --------------------------------------------------------------------------------


def test_the_first_part_alone_chooses():
    """Other readings behind it change nothing but the model."""
    gen = np.random.default_rng(3)
    one, other = arx(gen, runs=12), arx(gen, runs=12)
    runs = [*one.runs[:4], *other.runs[4:]]
    mixed = se.Trajectories(*map(list, zip(*runs, strict=True)), outputs=True)
    models = [se.identify(data, checks=False) for data in (one, mixed)]
    assert models[0].window == models[1].window
    assert models[0].first == models[1].first == -(-one.size // 4)


@pytest.mark.filterwarnings("ignore:accepted")
@pytest.mark.parametrize(("runs", "steps", "filters"), [(10, 150, False), (8, 1000, True)])
def test_filters_that_use_up_the_pieces_give_way_to_lags(runs, steps, filters):
    """Of a rig with small errors of reading filters take 90 rows and more to fill."""
    data = Rig().data(runs, np.random.default_rng(runs), steps)
    model = se.identify(data, accept="change", checks=False)
    assert (model.window.pole is not None) == filters
    assert 4 * model.window.burn <= steps
    assert model.size > 0.5 * data.size


def rooms(seed, steps=1500):
    """Two rooms, read every five minutes to 0.1 degrees, their heaters and the air outside."""
    gen = np.random.default_rng(seed)
    A = np.array([[0.90, 0.06], [0.07, 0.88]])
    T, heat, felt, air, rows = np.full(2, 18.0), np.zeros(2), np.zeros(2), 0.0, []
    for k in range(steps):
        if k % 4 == 0:
            heat = gen.integers(0, 100, 2).astype(float)
        air = 0.995 * air + 0.13 * gen.standard_normal()
        out = round(3.0 - 4.0 * np.cos(2.0 * np.pi * k / 288) + air, 1)
        rows.append([*np.round(T + 0.03 * gen.standard_normal(2), 1), *heat, out])
        felt += 0.8 * (heat - felt)
        T = A @ T + 0.016 * felt + 0.04 * out + 0.045 * gen.standard_normal(2)
    read = np.array(rows)
    return se.Trajectories([read[:, :2]], [read[:-1, 2:]], outputs=True)


@pytest.mark.parametrize("seed", range(4))
def test_filters_that_follow_a_short_log_give_way_to_lags(seed):
    """Akaike's criterion takes 10 filters of pole 0.9 there, and four tests of the log fail."""
    model = se.identify(rooms(seed), intercept=True, checks=False)
    assert model.window.pole is None
    assert model.doubts == ()


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
def test_doubts_of_slow_filters_name_faster_ones():
    runs = rooms(0)
    slow = se.Window(filters=(0.9, 10))
    model = se.identify(runs, intercept=True, window=slow, checks=False)
    by_test = model._faults
    assert {"memory", "change", "drift"} <= set(by_test)
    assert "take more filters, a smaller pole, or Window(lags='auto'), or" in by_test["memory"]
    for name in ("change", "drift"):
        assert "or filters of pole 0.9 are too slow: take a smaller pole" in by_test[name]
    few = se.identify(runs, intercept=True, window=se.Window(lags=1), checks=False)
    assert "leave `window` out, take more lags, or declare Window(tail=)" in few._faults["memory"]


def chain(gen, delay, runs=10):
    """Readings of three lags in a row, whose input acts `delay` + 2 steps after it is logged."""
    read = []
    for _ in range(runs):
        x, y, u = np.zeros(3), [0.0], gen.standard_normal(150)
        for k in range(150):
            acting = u[k - delay] if k >= delay else 0.0
            x = np.array([0.3 * x[0] + acting, 0.6 * x[1] + x[0], 0.8 * x[2] + x[1]])
            x += 0.02 * gen.standard_normal(3)
            y.append(x[2] + 0.02 * gen.standard_normal())
        read.append((np.array(y)[:, None], u[:, None]))
    return se.Trajectories(*zip(*read, strict=True), outputs=True)


@pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
def test_no_delay_is_offered_where_the_window_is_short_and_nothing_is_late():
    gen = np.random.default_rng(7)
    short = se.identify(chain(gen, 0), window=se.Window(lags=3), checks=False)
    assert re.match(
        r"inputs \d+ steps earlier explain .*: the window is too short; pass Window\(lags=\d+\)",
        short._faults["dead time"],
    )
    late = se.identify(chain(gen, 6), window=se.Window(lags=3), checks=False)
    assert "a dead time; pass Window(delay=8), or a longer window:" in late._faults["dead time"]


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_delays_are_found(delay):
    gen = np.random.default_rng(delay)
    outputs, inputs = [], []
    for _ in range(10):
        y, u = [0.0], gen.standard_normal(60)
        for k in range(60):
            acting = u[k - delay] if k >= delay else 0.0
            y.append(0.8 * y[-1] + acting + 0.1 * gen.standard_normal())
        outputs.append(np.array(y)[:, None])
        inputs.append(u[:, None])
    data = se.Trajectories(outputs, inputs, outputs=True)
    model = se.identify(data, checks=False, window=se.Window(delay=(0, 4)))
    assert model.window.delay == delay
    assert model.window.count == np.ceil(1.5 * model.window.found) + 1


def test_too_little_for_a_choice_is_said():
    data = se.Trajectories(np.eye(3)[:, :1], np.ones((2, 1)), outputs=True)
    with pytest.raises(InputError, match=r"`data` must be longer"):
        se.identify(data)


@pytest.mark.parametrize("scale", [1e-100, 1e-30, 1e30, 1e100])
def test_units_of_readings_make_no_difference(scale):
    gen = np.random.default_rng(5)
    data = arx(gen)
    other = se.Trajectories(
        *(
            [f * one for one in some]
            for f, some in zip((scale, 1.0), zip(*data.runs, strict=True), strict=True)
        ),
        outputs=True,
    )
    plain, scaled = (
        se.identify(one, checks=False, window=se.Window(lags=3)) for one in (data, other)
    )
    bounds = [one.region(0.05).entry_bounds[0] for one in (plain, scaled)]
    units = np.array([1, 1, 1, scale, scale, scale])
    np.testing.assert_allclose(bounds[1] / units, bounds[0], rtol=1e-6)


def late(gen, delay, runs=8, steps=40):
    """Runs of two states whose input acts `delay` steps late, its own matrices, and what acts."""
    A, B = np.array([[1.0, 0.1], [0.05, 1.02]]), np.array([[0.005], [0.1]])
    states, inputs = [], []
    for _ in range(runs):
        x, u = [gen.standard_normal(2)], 5.0 * gen.standard_normal((steps + delay, 1))
        for k in range(steps):
            x.append(A @ x[-1] + B @ (u[k] + 3.0) + 0.01 * gen.standard_normal(2))
        states.append(np.array(x))
        inputs.append(u[delay:])  # u[k] acts at k, and was asked for `delay` steps earlier
    return A, B, se.Trajectories(states, inputs, state_names=["p", "v"], input_names=["F"])


@pytest.mark.parametrize("delay", [1, 3])
@pytest.mark.parametrize("noise", [{}, {"sigma": 0.01}, {"covariance": "diagonal"}], ids=str)
def test_states_with_a_dead_time(delay, noise):
    """All verbs on the states now and the inputs under way; the twin is least squares."""
    gen = np.random.default_rng(delay)
    A, B, data = late(gen, delay)
    model = se.identify(data, **opts(delay=delay, intercept=True, scale=[1.0, 1.0, 5.0], **noise))
    assert model.state_names == ("p", "v", *(f"F(-{k})" for k in range(1, delay + 1)))
    assert not model.doubts
    assert model.region(0.05).contains(A, B, 3.0 * B[:, 0])
    Z, Y = [], []
    for x, u in data.runs:
        ones = np.ones((len(u) - delay, 1))
        Z.append(np.hstack([x[delay:-1], u[: len(u) - delay], ones]))
        Y.append(x[delay + 1 :])
    H = np.linalg.lstsq(np.vstack(Z), np.vstack(Y), rcond=None)[0].T
    np.testing.assert_allclose(model.coefficients, H, rtol=1e-8, atol=1e-10)
    assert (
        se.identify(data, intercept=True, checks=False, window=se.Window(delay=(0, 5))).window.delay
        == delay
    )
    loop = se.gain(model, 1.0, 1.0)
    assert loop.certificate(0.05).status == "certified"
    record = data.last_record()
    plan = se.control(model, record=record, steps=20, limits=(-50.0, 50.0))
    assert np.isfinite(plan.bound(0.05).target)
    ahead = se.predict(model, inputs=plan.u, record=record)
    np.testing.assert_allclose(ahead.predicted_states, plan.predicted_states, atol=1e-9)
    regulator, u = se.regulate(model, 15, limits=(-50.0, 50.0), offset_free=False), []
    x = np.array([0.1, 0.0])
    for k in range(60):
        u.append(regulator(x))
        x = A @ x + B @ ((u[k - delay] if k >= delay else 0.0) + np.array([3.0]))
    assert np.abs(x).max() < 0.05
    with pytest.raises(InputError, match="`known` must be left out with `delay`"):
        se.identify(data, known=(A, None), window=se.Window(delay=1))
    with pytest.raises(InputError, match="`pilot` must be left out with `delay`"):
        se.identify(data, window=se.Window(delay=1), pilot=0.5)


def test_rows_that_hold_the_state_after_its_input():
    """delay=-1 is the same data with each input one row further on, one pair of a piece less."""
    _, _, data = late(np.random.default_rng(4), 0)
    moved = se.Trajectories(
        [x[1:] for x, _ in data.runs], [u[:-1] for _, u in data.runs],
        state_names=["p", "v"], input_names=["F"],
    )  # fmt: skip
    model = se.identify(moved, intercept=True, checks=False, window=se.Window(delay=-1))
    for (x, u), (before, acted) in zip(model.data.runs, data.runs, strict=True):
        np.testing.assert_array_equal(x, before[1:-1])
        np.testing.assert_array_equal(u, acted[1:-1])
    assert model.window is None
    with pytest.raises(InputError, match="`delay` of -1 needs runs of two steps"):
        se.identify(data.last_pairs(), window=se.Window(delay=-1))
