"""An alarm of a loop in use: its promise, what it finds, and what it must not be asked."""

import copy
import pickle
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest

import stochens_rs as se
import two_masses
from coverage_study import most, sets
from hidden_outputs import of_lags, one_log
from stochens_rs import _core
from stochens_rs.exceptions import InputError, StochensError
from stochens_rs.feedback import Watch
from stochens_rs.identification.assumptions import ACCEPTED
from stochens_rs.identification.changes import source_of
from twin.watch import evidence, onset

RIG = (
    np.array([[1.0, -0.01, 0.1, 0.0], [0, 1.06, 0, 0.1], [0, -0.2, 1, -0.01], [0, 1.2, 0, 1.06]]),
    np.array([[0.005], [-0.005], [0.1], [-0.1]]),
    np.full(4, 5e-4),
    0.5,
)
ROOM = (np.array([[0.95, 0.03], [0.02, 0.9]]), np.array([[4e-4], [0.0]]), np.full(2, 0.05), 300.0)
UNITS = (
    np.array([[1.05, 2e-4], [0.0, 0.9]]),
    np.array([[1e-3], [0.5]]),
    np.array([1e-4, 100.0]),
    50.0,
)
ONE = (np.array([[1.2]]), np.array([[1.0]]), np.array([0.1]), 0.3)
PLANTS = {"rig": RIG, "room": ROOM, "units": UNITS, "one": ONE}


def noise(rng, shape, law):
    if law == "t(3)":
        return rng.standard_t(3, shape) / np.sqrt(3.0)
    return rng.standard_normal(shape)


def made(name, runs=10, seed=1):
    """A plant, its model from runs in closed loop, and the gain."""
    A, B, sizes, dither = PLANTS[name]
    rng = np.random.default_rng(seed)
    Q, R = np.diag(sizes**-2.0), np.eye(B.shape[1]) / dither**2
    K = se.gain((A, B), Q, R).K
    logs = [follow((A, B), K, sizes, dither, 40, rng) for _ in range(runs)]
    data = se.Trajectories(*zip(*logs, strict=True))
    model = se.identify(data, noise=se.Noise(covariance=np.diag(sizes**2)))
    return (A, B), K, model


def follow(plant, K, sizes, dither, steps, rng, law="gaussian"):
    A, B = plant
    x, u = [sizes * rng.standard_normal(len(A))], []
    w = noise(rng, (steps, len(A)), law) * sizes
    for k in range(steps):
        u.append(K @ x[-1] + dither * rng.standard_normal(B.shape[1]))
        x.append(A @ x[-1] + B @ u[-1] + w[k])
    return np.array(x), np.array(u)


def run(watch, x, u):
    """Readings and the inputs between them; how many alarms there were."""
    before = np.full(u.shape[1], np.nan)
    for k, row in enumerate(x):
        watch.step(row, before)
        before = u[min(k, len(u) - 1)]
    return int(watch.now[2])


def edge(region, rng):
    """A system on the edge of a region of one part."""
    part, L = region.parts[0], np.linalg.cholesky(region.parts[0].S * region.parts[0].factor)
    a, b = rng.standard_normal(len(L)), rng.standard_normal(len(part.white))
    off = np.outer(L @ a, b @ part.white) / np.linalg.norm(a) / np.linalg.norm(b)
    return np.split(region.centre + 0.999 * off, [len(L)], axis=1)


@pytest.mark.parametrize("moving", [False, True])
def test_the_evidence_is_that_of_the_formulas(moving):
    (A, B), K, model = made("units")
    region = model.region(0.05)
    rng = np.random.default_rng(2)
    x, u = follow((A, 0.999 * B), K, *PLANTS["units"][2:], 130, rng)
    watch = source_of(model, region).watch("variance", moving, 1e15)
    watch.step(x[0], u[0])
    found = [watch.step(row, acted)[1] for row, acted in zip(x[1:], u, strict=True)]
    part = region.parts[0]
    V, S = part.root.T @ part.root, np.diag(PLANTS["units"][2] ** 2)
    rows = np.hstack([x[:-1], u, x[1:]])
    twin = evidence(region.centre, V, part.factor * part.S, S, model.size, rows, [2], moving=moving)
    assert watch.now[2] == 0
    assert max(found) > 10.0
    np.testing.assert_allclose(found, twin, rtol=1e-7)


def rough(rng, law, x):
    """Noise of one step with mean 0 and at most variance 1 given the past."""
    n = len(x)
    if law == "t(3)":
        return rng.standard_t(3, n) / np.sqrt(3.0)
    if law == "outliers":  # 7 deviations in 2 % of steps
        return rng.choice([-7.0, 0.0, 7.0], n, p=[0.01, 0.98, 0.01])
    if law == "skewed":
        return rng.exponential(1.0, n) - 1.0
    size = 1.0 if law == "gaussian" else 0.3 + 0.7 * (x.sum() > 0.0)
    return size * rng.standard_normal(n)


class Family:
    """A plant of readings (one lag: of states) under feedback, its model and its gain."""

    def __init__(self, Theta, sizes, dither, law, lags=1, intercept=False, most=np.inf, lost=0.0):
        self.Theta, self.sizes, self.lags = np.array(Theta), np.array(sizes), lags
        self.dither, self.law, self.intercept = np.array(dither), law, intercept
        self.most, self.lost = most, lost
        p, m = len(self.sizes), len(self.dither)
        rest = p * lags
        top = np.hstack([self.Theta[:, :rest], self.Theta[:, rest + m : rest + m * lags]])
        A, B = np.zeros((rest + m * (lags - 1),) * 2), np.zeros((rest + m * (lags - 1), m))
        A[:p], B[:p] = top, self.Theta[:, rest : rest + m]
        A[p:rest, : rest - p] = np.eye(rest - p)
        B[rest : rest + m] = np.eye(m)[: m * (lags - 1)]
        scale = np.concatenate([np.tile(self.sizes, lags), np.tile(self.dither, lags - 1)])
        self.K = se.gain((A, B), np.diag(scale**-2.0), np.diag(self.dither**-2.0)).K
        rng = np.random.default_rng(1)
        y, u = zip(*(self.follow(self.Theta, 60, rng, "gaussian") for _ in range(10)), strict=True)
        data = se.Trajectories(y, u, outputs=lags > 1)
        how = {"window": se.Window(lags=lags)} if lags > 1 else {}
        noise = se.Noise(covariance=np.diag(self.sizes**2))
        self.model = se.identify(data, noise=noise, intercept=intercept, **how)
        self.source = source_of(self.model, self.model.region(0.05))

    def follow(self, Theta, steps, rng, law=None):
        p, m = len(self.sizes), len(self.dither)
        past, acts = np.zeros((self.lags, p)), np.zeros((self.lags, m))
        y, u = [past[0]], []
        for _ in range(steps):
            state = np.concatenate([past.ravel(), acts[: self.lags - 1].ravel()])
            now = self.K @ state + self.dither * rng.standard_normal(m)
            acts = np.vstack([np.clip(now, -self.most, self.most), acts[:-1]])
            z = np.concatenate([past.ravel(), acts.ravel(), [1.0] * self.intercept])
            noise = self.sizes * rough(rng, law or self.law, past[0])
            past = np.vstack([Theta @ z + noise, past[:-1]])
            y.append(past[0])
            u.append(acts[0])
        return np.array(y), np.array(u)

    def on_the_edge(self, rng):
        while True:
            Theta = np.hstack(edge(self.source.region, rng))
            with np.errstate(all="ignore"):
                if np.abs(self.follow(Theta, 300, rng)[0]).max() < 1e4 * self.sizes.max():
                    return Theta


MIXED = np.array(
    [[0.9, 2e-3, 0.0, 1e-2, 0.0], [10.0, 1.05, 0.0, 0.0, 0.3], [0.0, 1e-3, 0.7, 1e-3, 1e-3]]
)
FAMILIES = {
    "rig": lambda: Family(np.hstack(RIG[:2]), RIG[2], [0.5], "gaussian"),
    "rig, cut inputs": lambda: Family(np.hstack(RIG[:2]), RIG[2], [0.5], "skewed", most=2.0),
    "room": lambda: Family(np.hstack(ROOM[:2]), ROOM[2], [300.0], "t(3)"),
    "room, offset, missing": lambda: Family(
        np.hstack([*ROOM[:2], [[1.0], [1.5]]]), ROOM[2], [300.0], "gaussian", 1, True, lost=0.1
    ),
    "units": lambda: Family(np.hstack(UNITS[:2]), UNITS[2], [50.0], "skewed"),
    "one": lambda: Family(np.hstack(ONE[:2]), ONE[2], [0.3], "outliers"),
    "resonance": lambda: Family(
        [[1, 0.1, 0, 0], [0, 0.95, -0.3, 0.1], [0, 0.3, 0.95, 0.2]],
        [0.01, 0.02, 0.02], [1.0], "turns",
    ),
    "mixed": lambda: Family(MIXED, [1e-2, 1.0, 1e-2], [1.0, 3.0], "t(3)"),
    "readings": lambda: Family([[1.2, -0.4, 1.0, 0.3]], [0.1], [0.5], "outliers", lags=2),
    "two readings": lambda: Family(
        [[1.0, 0.1, 0.1, 0.0, 0.5, 0.1], [0.0, 0.9, 0.1, -0.1, 0.2, 0.0]],
        [0.1, 0.2], [0.5], "gaussian", lags=2,
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILIES)
def test_false_alarms_are_as_rare_as_promised(name):
    """At the true plant and on the edge of the region: a million steps in `make soak`."""
    one, rng = FAMILIES[name](), np.random.default_rng([3, list(FAMILIES).index(name)])
    steps, short, level, alarms, rung = sets(50_000, 1000), 500, 0.2, 0, 0
    for Theta in (one.Theta, one.on_the_edge(rng)):
        y, u = one.follow(Theta, steps, rng)
        y[rng.random(y.shape) < one.lost] = np.nan
        alarms += run(one.source.watch("variance", False, 100.0), y, u)
        for at in range(0, steps, short):
            part = y[at : at + short + 1], u[at : at + short]
            rung += run(one.source.watch("variance", False, level), *part) > 0
    assert 0 < alarms <= 2 * (steps + 14) / 100.0
    assert rung <= most(2 * steps // short, level)


def test_without_the_region_or_the_law_it_is_false():
    """The mutants: no penalty for the region, Gaussian bets on heavy tails."""
    _, K, model = made("one", runs=3)
    source, rng = source_of(model, model.region(0.05)), np.random.default_rng(4)
    allowed = 5000 / 1000.0 + 1
    fields = list(source.region.parts[0].__reduce__()[1])
    point = _core.RegionPart(*fields[:-1], 1e-12)
    small = replace(source.region, parts=(point,))
    x, u = follow(edge(source.region, rng), K, *ONE[2:], 5000, rng)
    assert run(source.watch("variance", False, 1000.0), x, u) <= allowed
    assert run(replace(source, region=small).watch("variance", False, 1000.0), x, u) > 3 * allowed
    x, u = follow(ONE[:2], K, *ONE[2:], 5000, rng, "t(3)")
    assert run(source.watch("variance", False, 1000.0), x, u) <= allowed
    assert run(source.watch("gaussian", False, 1000.0), x, u) > 3 * allowed


def test_a_plant_that_moves_needs_the_larger_penalty():
    """The worst member in each step: sums of blocks with the penalty of a constant ring."""
    _, K, model = made("one", runs=3)
    region = model.region(0.05)
    source, rng, part = source_of(model, region), np.random.default_rng(5), region.parts[0]
    size = np.sqrt(part.factor * part.S[0, 0])
    x, u, before = np.zeros(1), np.zeros(1), np.full(1, np.nan)
    watches = [source.watch("gaussian", moving, 1000.0) for moving in (False, True)]
    for _ in range(8000):
        for watch in watches:
            watch.step(x, before)
        u = K @ x + 0.3 * rng.standard_normal(1)
        z = np.concatenate([x, u])
        x = region.centre @ z + size * np.linalg.norm(part.white @ z) + 0.1 * rng.standard_normal(1)
        before = u
    constant, moves = (int(watch.now[2]) for watch in watches)
    assert moves <= 9 < 27 < constant


def test_an_alarm_says_which_part_changed():
    (A, B), K, model = made("rig")
    proof = se.gain(model, np.diag(RIG[2] ** -2), np.eye(1) / RIG[3] ** 2).certificate(0.05)
    rng, right = np.random.default_rng(6), 0
    for fault in range(10):
        watch = proof.watch(every=1e4)
        new = (A, 0.5 * B) if fault % 2 else (A + 0.2 * np.outer([0, 0, 0, 1], [0, 1, 0, 0]), B)
        x, u = follow(new, K, *RIG[2:], 400, rng)
        for row, acts in zip(x, u, strict=False):
            state = watch(row, acts)
        assert state.status == "alarm"
        assert watch.alarm is not None
        changes, true = watch.changes(), np.hstack(new)
        assert changes.status == "refuted"
        wanted = ("u[0]",) if fault % 2 else ("x[1]", "x[3](k+1)")
        assert set(wanted) <= set(changes.explanations)  # the true one is never refuted
        right += set(changes.explanations) == set(wanted)
        assert (np.abs(changes.estimate - true) <= changes.radius).all()
        for (row, column), (low, high) in changes.entries.items():
            j = list(changes.regressors).index(column)
            i = list(changes.outputs).index(row)
            assert not np.isclose(true[i, j], np.hstack((A, B))[i, j])
            assert low <= true[i, j] <= high
        after = watch.hold()
        assert after.status != "certified" or after.region.contains(*new)
    assert right >= 6


def test_quiet_without_dither_proves_nothing():
    """u = K x: all changes with dA = -dB K have the same record, and it is said by name."""
    (A, B), K, model = made("rig")
    source = source_of(model, model.region(0.05))
    rng = [np.random.default_rng(7) for _ in range(2)]
    pair = (A, B), (A + 0.5 * B @ K, 0.5 * B)
    runs = [follow(p, K, RIG[2], 0.0, 300, r) for p, r in zip(pair, rng, strict=True)]
    np.testing.assert_allclose(*(one[0] for one in runs), atol=1e-12)
    proof = se.gain(model, np.diag(RIG[2] ** -2), np.eye(1) / RIG[3] ** 2).certificate(0.05)
    watch = source.watch()
    watch.take(np.hstack([runs[1][0][:-1], runs[1][1], runs[1][0][1:]]))
    changes = source.changes(watch, 0.05)
    assert changes.status == "not refuted" or not changes.outside > 1.0
    assert any("u[0]" in text for text in changes.unseen)
    assert changes.region is None
    assert proof.watch().hold() is proof


def test_it_goes_on_from_a_file(tmp_path):
    (A, B), K, model = made("one")
    proof = se.gain(model, 1.0, 1.0).certificate(0.05)
    watch = proof.watch(level=0.01)
    x, u = follow((A, 0.6 * B), K, *ONE[2:], 300, np.random.default_rng(8))
    x[100] = np.nan
    for row, acts in zip(x[:200], u, strict=False):
        watch(row, acts)
    watch.save(tmp_path / "watch")
    others = [pickle.loads(pickle.dumps(watch)), Watch.load(tmp_path / "watch")]
    for row, acts in zip(x[200:], u[199:], strict=False):
        wanted = watch(row, acts)
        assert all(other(row, acts) == wanted for other in others)
    assert wanted.status == "alarm"
    assert watch.changes() == others[1].changes()
    watch.clear()
    assert watch(x[-1], u[-1]).status == "quiet"
    assert watch.alarm is None
    assert watch([np.nan], [0.0]).status == "skipping"
    assert watch.plot().get_ylabel() == "evidence of a change"


def test_loops_take_it_along(tmp_path):
    rng = np.random.default_rng(9)
    model = of_outputs(rng)
    loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True)
    proof = loop.certificate(0.05)
    loop.watch = proof.watch(every=1e4)
    now, past, gain = 0.0, 0.0, 1.0
    for k in range(700):
        if k == 300:
            gain = 0.4
            loop.save(tmp_path / "loop")
            loop = type(loop).load(tmp_path / "loop")
            assert loop.watch is not None
            assert not loop.log
        target = [float(np.sign(np.sin(k / 9.0)))]
        acts = loop([now if k != 50 else np.nan], target=target)
        now, past = 1.2 * now - 0.4 * past + gain * acts[0] + 0.1 * rng.standard_normal(), now
        if k == 50:
            assert loop.log[-1].watch.status == "skipping"
        if k == 299:
            assert {call.watch.alarms for call in loop.log} == {0}
    assert loop.log[-1].watch.status == "alarm"
    assert "u[0]" in loop.watch.changes().explanations
    held = loop.watch.hold()
    assert held.status == "certified"
    assert held.region.centre.shape == proof.region.centre.shape


def planned(plans_of_readings):
    """A loop that plans, with its watch, and a plant about its model as a step from what acts."""
    rng = np.random.default_rng(1)
    if plans_of_readings:
        model = of_outputs(rng)
        loop = se.regulate(model, 5, [0.5], limits=(-2.0, 2.0), offset_free=False)
        proof = se.regulate(se.gain(model, 1.0, 1.0), offset_free=False).certificate(0.05)
    else:
        _, _, model = made("one")
        loop = se.regulate(model, 5, limits=(-9.0, 9.0))
        proof = se.gain(model, 1.0, 1.0).certificate(0.05)
    loop.watch = proof.watch(every=1e4)
    past = [np.zeros(1), np.zeros(1)]

    def step(u, effect=1.0):
        first = 1.2 * past[0] - (0.4 * past[1] if plans_of_readings else 0.0)
        past[:] = first + effect * u + 0.1 * rng.standard_normal(1), past[0]
        return past[0]

    return loop, step


@pytest.mark.parametrize("of_readings", [False, True])
def test_loops_that_plan_take_it_along(of_readings, tmp_path):
    """Saved and resumed bit by bit; an alarm outlives `reset`, and not `clear`."""
    loop, step = planned(of_readings)
    x, rng, other = np.zeros(1), np.random.default_rng(2), None
    for k in range(160):
        effect = 1.0 if k < 80 else 0.5
        aim = {"target": [float(rng.standard_normal())]} if of_readings else {}
        acts = loop(x, **aim)
        assert loop.log[-1].watch.evidence == loop.watch.history[-1]
        if k == 60:
            loop.save(tmp_path / "loop")
            other = type(loop).load(tmp_path / "loop")
        elif other is not None:
            np.testing.assert_array_equal(other(x, **aim), acts)
            assert other.log[-1].watch == loop.log[-1].watch
        if k == 79:
            assert loop.log[-1].watch.alarms == 0
        x = step(acts, effect)
    assert loop.watch.alarm is not None
    loop.reset()
    loop(x)
    assert loop.log[-1].watch.status == "alarm"
    loop.watch.clear()
    loop(x)
    assert loop.log[-1].watch.status != "alarm"


@pytest.mark.parametrize("name", PLANTS)
def test_models_are_refuted_no_more_often_than_asked(name):
    (A, B), K, model = made(name)
    rng, refuted = np.random.default_rng(10), 0
    for _ in range(60):
        x, u = follow((A, B), K, *PLANTS[name][2:], 60, rng)
        refuted += model.accepts(se.Trajectories([x], [u]), level=0.5).status == "refuted"
    assert refuted <= 40  # of 60 with at most 1 / 2 each: false with 5e-3
    x, u = follow((A, 0.3 * B), K, *PLANTS[name][2:], 400, rng)
    changes = model.accepts(se.Trajectories([x], [u]))
    assert changes.status == "refuted"
    assert "u[0]" in changes.explanations
    assert type(changes).from_dict(changes.to_dict()) == changes


def test_two_logs_in_open_loop_are_tested_exactly():
    rng, design = np.random.default_rng(11), se.Noise(design="independent")
    L, refuted, runs = np.array([[0.3, 0.0], [0.1, 0.2]]), 0, sets(300, 200)

    def pairs(N, B, heating=None):
        x, w = rng.standard_normal((2, N, 2))
        u = rng.standard_normal((N, 1)) if heating is None else np.full((N, 1), heating)
        return se.Trajectories.from_pairs(x, u, x @ [[0.9, 0.2], [-0.1, 0.8]] + u * B + w @ L.T)

    for k in range(runs):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", se.exceptions.DataWarning)  # the tests of 12 pairs
            model = se.identify(pairs(12, [0.0, 1.0]), noise=design, checks=False, accept=ACCEPTED)
        new = pairs(*((4, [0.0, 1.0]), (2, [0.0, 1.0], 0.6))[k % 2])
        refuted += model.accepts(new, level=0.2, design="independent").status == "refuted"
    assert abs(refuted - 0.2 * runs) <= 4.0 * np.sqrt(0.16 * runs)
    model = se.identify(pairs(40, [0.0, 1.0]), noise=design, checks=False)
    changed = pairs(40, [0.0, 0.5])
    assert model.accepts(changed, design="independent").status == "refuted"
    with pytest.raises(InputError, match="`design` must be 'adaptive'"):
        se.identify(pairs(40, [0.0, 1.0]), noise=0.3).accepts(changed, design="independent")


def test_what_a_log_says_nothing_about():
    rng = np.random.default_rng(12)
    x, w = rng.standard_normal((2, 80, 1))
    u = np.hstack([np.full((80, 1), 0.6), rng.standard_normal((80, 1))])
    data = se.Trajectories.from_pairs(
        x, u, 0.5 * x + u @ [[1.0], [1.0]] + 0.1 * w, state_names=["room"],
        input_names=["heating", "window"],
    )  # fmt: skip
    with pytest.warns(se.exceptions.DataWarning):
        model = se.identify(data, noise=0.1, intercept=True)
    (text,) = model.excitation()
    assert text == (
        "heating and the offset: their effects are not determined apart (heating was always 0.6)"
    )


def test_what_it_must_not_be_asked():
    _, _, model = made("one")
    proof = se.gain(model, 1.0, 1.0).certificate(0.05)
    x, u, w = np.random.default_rng(1).standard_normal((3, 60, 1))
    data = se.Trajectories.from_pairs(x, u, 0.5 * x + u + 0.1 * w)
    other = se.regulate((np.eye(2), np.eye(2)), 3)
    unknown = se.gain(se.identify(data), 1.0, 1.0).certificate(0.05)
    assert unknown.watch().threshold > 1e5  # the region bounds its own noise
    for call, message in (
        (lambda: proof.watch(every=1.0), "`every` must be from 2"),
        (lambda: proof.watch(every=9.0, level=0.1), "`every` and `level` must not be given both"),
        (lambda: setattr(other, "watch", proof.watch()), "`watch` must be of"),
        (lambda: replace(proof, source=None).watch(), "`proof` has no model to watch"),
    ):
        with pytest.raises(StochensError, match=message.replace("(", r"\(")):
            call()


def one_state(law="variance", **options):
    rng = np.random.default_rng(1)
    x, u, w = rng.standard_normal((3, 60, 1))
    data = se.Trajectories.from_pairs(x, u, 0.9 * x + u + 0.1 * w)
    model = se.identify(data, noise=0.1)
    return model, se.gain(model, 1.0, 1.0).certificate(0.05).watch(law=law, **options)


def test_a_loop_that_begins_anew_makes_no_alarm():
    """Each episode begins elsewhere: the last reading before the reset is no pair with the next."""
    model, watch = one_state()
    loop, rng = se.regulate(model, 10, limits=(-5.0, 5.0)), np.random.default_rng(5)
    loop.watch = watch
    for _ in range(12):
        x = rng.standard_normal(1)
        for _ in range(40):
            x = 0.9 * x + loop(x) + 0.1 * rng.standard_normal(1)
        loop.reset()
    assert loop.watch.alarm is None


@pytest.mark.parametrize("law", ["gaussian", "bounded", "symmetric"])
def test_a_watch_with_a_lost_bet_is_loaded(law):
    _, watch = one_state(law, moving=True)
    rng, x = np.random.default_rng(1), np.zeros(1)
    for _ in range(256):
        u = watch.proof.K @ x + 30.0
        watch(x, u)
        x = 0.9 * x + u + 0.1 * rng.uniform(-1.0, 1.0, 1)
    other = pickle.loads(pickle.dumps(watch))
    assert other(x, u) == watch(x, u)


def test_what_an_exact_test_refutes_has_explanations():
    rng, found = np.random.default_rng(4), []

    def pairs(effect):
        x, u, w = rng.standard_normal((3, 60, 1))
        return se.Trajectories.from_pairs(x, u, 0.9 * x + effect * u + w)

    for _ in range(10):
        model = se.identify(pairs(1.0), noise=se.Noise(design="independent"), checks=False)
        changes = model.accepts(pairs(0.3), design="independent")
        found += [changes.explanations] if changes.status == "refuted" else []
    assert len(found) > 5
    assert () not in found
    with pytest.raises(InputError, match="`level` must be from 1e-15"):
        one_state(level=0.9)


def test_behind_clear_nothing_is_certified():
    """The pairs after the alarm are forgotten, and the plant is not the old one."""
    _, watch = one_state()
    assert watch.hold().status == "certified"
    rng, x = np.random.default_rng(2), np.zeros(1)
    for _ in range(300):
        u = watch.proof.K @ x + rng.standard_normal(1)
        watch(x, u)
        x = 0.9 * x + 0.3 * u + 0.1 * rng.standard_normal(1)
    assert watch.alarm is not None
    watch.clear()
    held = watch.hold()
    assert (watch.alarm, held.status) == (None, "undetermined")
    assert "an alarm was cleared" in str(held)


def test_a_watch_is_of_one_loop():
    model, watch = one_state()
    first, other = (se.regulate(model, 3) for _ in range(2))
    first.watch = first.watch = watch
    with pytest.raises(InputError, match="`watch` is that of another loop"):
        other.watch = watch
    other.watch = copy.copy(watch)
    first([1.0])
    assert (len(watch.history), len(other.watch.history)) == (1, 0)
    again = pickle.loads(pickle.dumps(first))
    with pytest.raises(InputError, match="`watch` is that of another loop"):
        other.watch = again.watch
    first.watch = None
    other.watch = watch
    assert other.watch is watch


def test_what_no_sensor_reads_is_named():
    _, watch = one_state()
    for y, u, reason in (
        ([0.0], [0.0], None),
        ([np.nan], [0.0], None),  # missing
        ([np.inf], [0.0], "x[0] = inf cannot have been measured"),
        ([0.0], [-np.inf], "u[0] = -inf cannot have been measured"),
        ([1e200], [0.0], "x[0] = 1e+200 cannot have been measured"),
    ):
        assert watch(y, u).reason == reason
    assert watch.alarm is None


@pytest.mark.parametrize("law", ["variance", "gaussian", "bounded", "symmetric"])
@pytest.mark.parametrize("moving", [False, True])
def test_all_numbers_of_a_watch_are_finite(law, moving):
    _, watch = one_state(law, moving=moving)
    rng = np.random.default_rng(3)
    for k in range(300):
        size = 10.0 ** rng.uniform(-320, 150, 2)
        watch(rng.standard_normal(1) * size[0] * (k % 3 > 0), rng.standard_normal(1) * size[1])
    state = watch.__getstate__()["state"]
    own = len(state) - 2 * int(state[14])  # behind them the calls, nan for the first input
    assert np.isfinite(state[:own]).all()
    assert np.isnan(state[own:]).sum() == 1
    state = state[:own]
    assert np.abs(state).max() > 1e100


def test_logs_of_tiny_numbers_say_little():
    model, _ = one_state()
    x, u, w = np.random.default_rng(1).standard_normal((3, 60, 1)) * 1e-170
    runs = se.Trajectories.from_pairs(x, u, 0.9 * x + u + 0.1 * w)
    changes = model.accepts(runs)
    assert (changes.status, changes.region) == ("too few pairs", None)
    assert repr(changes).startswith("<Changes: too few pairs, 60 pairs;")


def exact_row(size):
    """A position that is the sum of speeds, with noise that is rounding beside a real one."""
    rng = np.random.default_rng(1)
    A, B, x, us = np.array([[1.0, 0.1], [0.0, 0.9]]), np.array([[0.0], [0.5]]), [np.zeros(2)], []
    for _ in range(200):
        us.append(rng.standard_normal(1) - x[-1] @ [0.3, 0.5])
        w = rng.standard_normal(2) * [size, 0.1]
        x.append(A @ x[-1] + B @ us[-1] + w)
    data, law = se.Trajectories([np.array(x)], [np.array(us)]), np.diag([size**2, 0.01])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return (A, B), se.identify(data, noise=se.Noise(covariance=law))


def test_a_row_without_noise_is_not_watched_and_the_others_are():
    (A, B), model = exact_row(1e-19)
    source, rng = source_of(model, model.region(0.05)), np.random.default_rng(5)
    K, alarms = np.array([[-0.3, -0.5]]), 0
    assert source.watch().rows == [1]
    for _ in range(2):  # as often as promised
        x, u = follow((A, B), K, np.array([1e-19, 0.1]), 1.0, 4000, rng, "t(3)")
        alarms += run(source.watch("variance", False, 50.0), x, u)
    assert 10 < alarms <= 2 * (8000 + 28) / 50.0
    watch = source.watch()
    x, u = follow((A, 0.5 * B), K, np.array([1e-19, 0.1]), 1.0, 400, rng)
    assert run(watch, x, u) > 0
    changes = source.changes(watch, 0.05)
    assert changes.status == "refuted"
    assert {"u[0]", "x[1](k+1)"} == set(changes.explanations)
    assert np.isinf(changes.radius[0]).all()
    assert changes.region is None
    _, loud = exact_row(0.1)
    assert source_of(loud, loud.region(0.05)).watch().rows == [0, 1]


def test_inputs_in_tiny_units_are_watched():
    rng = np.random.default_rng(1)
    x, u, w = rng.standard_normal((3, 60, 1))
    data = se.Trajectories.from_pairs(x, 1e-30 * u, 0.9 * x + u + 0.1 * w)
    model = se.identify(data, noise=0.1)
    assert source_of(model, model.region()).watch().rows == [0]


def of_outputs(rng, gain=1.0, lags=2):
    y, u = one_log(
        lambda y, u: 1.2 * y[-1] - 0.4 * y[-2] + gain * u[-1], rng, 400, noise=0.1, lags=2
    )
    return of_lags(y, u, lags)


@pytest.mark.parametrize("free", [True, False])
def test_a_gain_is_swapped_without_a_jump(free, tmp_path):
    rng = np.random.default_rng(11)
    old = se.gain(of_outputs(rng), 1.0, 1.0)
    new = se.gain(of_outputs(rng, gain=0.4), 1.0, 20.0)
    assert se.regulate(new, offset_free=free).certificate().status == "certified"
    loop = se.regulate(old, offset_free=free, target=[3.0])
    fresh = se.regulate(new, offset_free=free, target=[3.0])
    y = [np.zeros(2) for _ in range(3)]  # of the loop, of one that jumps, and of the new one

    def run(loop, at, steps):
        for _ in range(steps):
            u = loop([y[at][0]])
            y[at] = np.array([1.2 * y[at][0] - 0.4 * y[at][1] + 0.4 * u[0], y[at][0]])
        return u

    before = run(loop, 0, 400)
    loop.swap(new)
    assert loop.certificate().K.tolist() == fresh.certificate().K.tolist()
    way, along = loop.tube(10), copy.deepcopy(loop)  # of the centre, with what is added
    for k in range(1, 10):
        np.testing.assert_allclose(along([way.states[k, 0]]), way.inputs[k], atol=1e-9)
    loop.save(tmp_path / "loop")
    again, at = type(loop).load(tmp_path / "loop"), y[0].copy()
    after = run(loop, 0, 1)
    y[1] = at
    assert (run(again, 1, 1) == after).all()
    assert abs(after - before) < 1e-6
    jumps, y[1] = pickle.loads(pickle.dumps(again)), at
    jumps.reset()
    jumps.start((at[::-1][:, None], before[None]))
    assert abs(jumps.log[-1].u - before) > 0.01  # without the memory of the old one
    y[2] = at
    fresh.start((at[::-1][:, None], before[None]))
    run(loop, 0, 300)
    run(fresh, 2, 300)
    np.testing.assert_allclose(y[0], y[2], atol=1e-6)  # it dies out
    if free:
        np.testing.assert_allclose(y[0], 3.0, atol=1e-6)


def test_a_swap_that_cannot_be_leaves_the_loop_as_it_was():
    rng = np.random.default_rng(12)
    model = of_outputs(rng)
    loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True, target=[1.0])
    plans = se.regulate(model, 5, offset_free=True)
    loop([0.5]), loop([0.6])
    other = copy.deepcopy(loop)
    unstable = replace(se.gain(model, 1.0, 1.0), K=np.array([[3.0, 0.0, 0.0]]))
    for one, gain, message in (
        (loop, 3, "`gain` must be a Loop"),
        (loop, se.gain(([[1.0]], [[1.0]]), 1.0, 1.0), "`gain` must be of a model"),
        (loop, se.gain(of_outputs(rng, lags=3), 1.0, 1.0), "`gain` must have the signals"),
        (loop, unstable, "`gain` must be stable"),
        (plans, se.gain(model, 1.0, 1.0), "takes the place of a gain, not a plan"),
    ):
        with pytest.raises(StochensError, match=message):
            one.swap(gain)
    assert (loop([0.7]) == other([0.7])).all()


def test_recursive_residuals_are_no_fair_test_under_feedback():
    """Why `accepts` does not use them: known noise, a unit root and an offset that are fitted.

    Bets on residuals that would be independent of the past without feedback: 20 is passed by more
    than 1 in 20; the same bets on the noise itself keep that.
    """
    rng, runs = np.random.default_rng(13), 8000
    x, sums, passed = np.zeros(runs), np.zeros((5, runs)), np.zeros((2, runs), dtype=bool)
    sizes = np.outer([0.1, 0.2, 0.4, 0.8], [1.0, -1.0]).reshape(8, 1)
    evidence = np.ones((2, 8, runs))
    for t in range(200):
        w = rng.standard_normal(runs)
        y, (sx, sxx, sy, sxy, _) = x + w, sums
        if t > 2:
            a = (t * sxy - sx * sy) / (t * sxx - sx * sx)
            leverage = (sxx - 2.0 * x * sx + t * x * x) / (t * sxx - sx * sx)
            residual = (y - a * x - (sy - a * sx) / t) / np.sqrt(1.0 + leverage)
            for k, seen in enumerate((residual, w)):
                bet = sizes * np.sign(x - sx / t) * seen
                evidence[k] *= np.exp(bet - sizes**2 / 2.0)
            passed |= evidence.mean(axis=1) >= 20.0
        sums += [x, x * x, y, x * y, 0.0 * x]
        x = y
    assert passed[0].mean() > 0.06
    assert passed[1].mean() <= 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / runs)


def test_a_constant_that_changed_is_named():
    rng = np.random.default_rng(5)
    x, u, w = rng.standard_normal((3, 300, 1))
    data = se.Trajectories.from_pairs(x, u, 0.9 * x + u + 0.3 + 0.1 * w)
    model = se.identify(data, noise=0.1, intercept=True)
    x, u, w = rng.standard_normal((3, 300, 1))
    changes = model.accepts(se.Trajectories.from_pairs(x, u, 0.9 * x + u + 0.8 + 0.1 * w))
    assert "1" in changes.explanations
    assert "a change of one alone: a constant" in repr(changes)


def _onsets(name, law, louder, runs):
    """Of each run the first call that a change moves, and the interval that the watch says."""
    (A, B), _, model = made(name)
    sizes, dither = PLANTS[name][2:]
    gain = se.gain(model, np.diag(sizes**-2.0), np.eye(B.shape[1]) / dither**2)
    proof, found = gain.certificate(0.05), []
    for seed in range(runs):
        rng, watch, x = np.random.default_rng(seed), proof.watch(every=1e4), np.zeros(len(A))
        at = int(rng.integers(100, 600))
        for k in range(1500):
            u, changed = gain.K @ x + dither * rng.standard_normal(B.shape[1]), k >= at
            assert watch.onset is None
            if watch(x, u).status == "alarm":
                found.append((at + 2, watch.onset))
                break
            size = sizes * (louder if changed else 1.0)
            x = A @ x + (0.6 if changed and louder == 1.0 else 1.0) * B @ u
            x = x + noise(rng, len(A), law) * size
    return np.array([(at, *onset) for at, onset in found])


@pytest.mark.parametrize("name", ["rig", "room", "one"])
@pytest.mark.parametrize(("law", "louder"), [("gaussian", 1.0), ("t(3)", 1.0), ("gaussian", 2.0)])
def test_a_change_began_where_the_onset_says(name, law, louder):
    """Inputs at 60 %, or noise twice as loud, from a call between 102 and 602 on."""
    runs = sets(60, 8)
    at, first, last = _onsets(name, law, louder, runs).T
    assert len(at) >= 0.9 * runs
    assert ((first <= at) & (at <= last)).mean() >= 0.75  # of few runs; 95 % with Gaussian noise
    assert np.median(last - first) <= 120.0


def test_the_onset_of_a_drive_is_not_the_first_full_window():
    hits = []
    for seed in range(sets(8, 3)):
        loop, drive = two_masses.loop(watched=True), two_masses.Drive(np.random.default_rng(seed))
        loop.target = {"load": 60.0 * np.sign(np.sin(np.arange(1200.0) / 95.0))}
        at = 400 + 50 * seed
        two_masses.ride(loop, drive, 1200, lambda drive: setattr(drive, "inertia", 0.06), at)
        first, last = loop.watch.onset
        hits.append(first <= at + 3 and at + 2 <= last)
        assert f"from between calls {first:.0f} and {last:.0f} on (95%)" in str(loop.watch)
        assert first > 17
    assert np.mean(hits) >= 0.6  # the window is not exactly long enough
    assert copy.copy(loop.watch).onset == (first, last)


@pytest.mark.parametrize(
    ("fill", "about"),
    [(0, {"lags": 1}), (2, {"lags": 2, "delay": 1}), (2, {"lags": 3, "intercept": True})],
)
def test_the_onset_is_that_of_the_plain_twin(fill, about):
    """Readings of two outputs, with gaps, from a plant that changes at some call."""
    A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.3], [1.0]])
    delay, offset = about.get("delay", 0), 0.4 * about.get("intercept", False)

    def calls(rng, steps, at=10**9):
        y, acted = np.zeros((steps + 1, 2)), rng.standard_normal((steps + 1, 1))
        for k in range(steps):
            late = acted[k + 1 - delay] if k >= delay else 0.0 * acted[0]
            y[k + 1] = A @ y[k] + (0.5 if k >= at else 1.0) * B @ late + offset
            y[k + 1] += 0.1 * rng.standard_normal(2)
        return y, acted

    rng, found = np.random.default_rng(fill), []
    y, acted = calls(rng, 200)
    data = se.Trajectories([y], [acted[1:]], outputs=True)
    window = se.Window(lags=about["lags"], delay=delay)
    noise, offsets = se.Noise(covariance=0.01 * np.eye(2)), about.get("intercept", False)
    model = se.identify(data, noise=noise, window=window, intercept=offsets, checks=False)
    source = source_of(model, model.region(0.05))
    for length in (300, 1400):
        watch, at = source.watch(promise=1e4), int(rng.integers(length - 150, length - 80))
        rows = np.hstack(calls(rng, length, at))
        rows[tuple(rng.integers(0, rows.shape, (20, 2)).T)] = np.nan
        assert watch.onset(0.05) is None
        k = -1
        while watch.now[3] is None:
            k += 1
            watch.step(rows[k, :2], rows[k, 2:])
        own = rows[: k + 1]
        known = source.region, source.noise, source.pairs
        for level in (0.05, 0.3):
            wanted = onset(own, 2, known, level, fill, **about)
            before = k + 1 - min(k + 1, 1000)
            assert watch.onset(level) == [before + 1.0 + place for place in wanted]
        found.append((watch.onset(0.05)[0] <= at + 2 + delay <= watch.onset(0.05)[1], k > 1000))
        recent = own[-1000:, 2:]
        np.testing.assert_allclose(watch.acting(), np.sqrt(np.nanmean(recent**2, axis=0)))
        other = source.watch(promise=1e4)
        other.resume(watch.state())
        assert other.onset(0.05) == watch.onset(0.05)
        watch.clear()
        assert watch.onset(0.05) is None
    assert found[1] == (True, True)


def test_without_a_pair_the_onset_cannot_be_told():
    """An alarm in the first call after the last one was seen: its pair began before that."""
    model = made("one")[2]
    watch = source_of(model, model.region(0.05)).watch(promise=2.0)
    while watch.now[3] is None:
        watch.step(np.array([50.0]), np.array([0.0]))
    assert watch.onset(0.05) is not None
    watch.clear()
    watch.step(np.array([50.0]), np.array([0.0]))
    assert watch.now[3] is not None
    assert watch.onset(0.05) is None


def test_pairs_at_rest_tell_nothing_of_single_effects():
    """A loop of readings at rest without dither: of a small constant no share of an effect."""
    rng = np.random.default_rng(2)
    y, u = np.zeros((401, 1)), rng.standard_normal((400, 1))
    for k in range(1, 400):
        y[k + 1] = 1.5 * y[k] - 0.55 * y[k - 1] + u[k] + 0.1 * rng.standard_normal(1)
    data = se.Trajectories([y], [u], outputs=True)
    model = se.identify(data, window=se.Window(lags=4), intercept=True, checks=False)
    loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True)
    loop.watch = loop.certificate(0.05).watch(every=1e4)
    now = before = np.zeros(1)
    for k in range(400):
        heat = 0.25 if k > 300 else 0.0
        noise = 0.1 * rng.standard_normal(1)
        now, before = 1.5 * now - 0.55 * before + loop(now) + heat + noise, now
    changes = loop.watch.changes()
    assert changes.pairs > 20
    assert (changes.status, changes.explanations) == ("not refuted", ())
    assert min(changes.detectable.values()) > 1.0
    assert "these pairs tell nothing of single effects" in str(changes)
    assert "%" not in str(changes)


def test_what_is_lost_for_ever_is_said():
    """A sensor that is lost: the watch sees nothing, and nothing is proved of the loop."""
    loop, drive = two_masses.loop(watched=True), two_masses.Drive(np.random.default_rng(1))
    for k in range(150):
        y = drive.read()[0]
        drive.step(loop([y[0], np.nan if k >= 100 else y[1]]))
        if k == 99:
            assert (loop.log[-1].status, loop.log[-1].reason) == ("gain", None)
            assert "missing" not in str(loop.watch)
    lost = "nothing is watched: load is missing for 50 calls"
    assert (loop.log[-1].watch.status, loop.log[-1].watch.reason) == ("skipping", lost)
    assert lost in str(loop.watch)
    assert loop.log[-1].status == "unproved"
    assert "load was not read in the last 50 calls: nothing is proved" in loop.log[-1].reason
    assert str(copy.copy(loop.watch)) == str(loop.watch)
    for _ in range(60):
        drive.step(loop(drive.read()[0]))
    assert (loop.log[-1].status, loop.log[-1].reason) == ("gain", None)
    assert "missing" not in str(loop.watch)


def test_friction_that_no_line_fits_is_said():
    """1 % of the torque, in logs and loop alike: slow turns, where the logs were fast."""
    loop = two_masses.loop(0.02, watched=True)
    loop.target = {"load": 60.0 * np.sin(np.arange(1800.0) / 95.0)}
    drive = two_masses.Drive(np.random.default_rng(1), friction=0.02)
    two_masses.ride(loop, drive, 1800)
    said = str(loop.watch)
    found = re.search(
        "or the plant is not linear: torque was of (.*), in the logs of (.*) .rms", said
    )
    assert found is not None
    assert float(found[1]) == pytest.approx(0.11, rel=0.1)
    assert float(found[2]) == pytest.approx(np.sqrt(1.8**2 / 3.0), rel=0.03)
    loop = two_masses.loop(watched=True)  # as fast as the logs
    loop.target = {"load": 60.0 * np.sign(np.sin(np.arange(700.0) / 95.0))}
    drive = two_masses.Drive(np.random.default_rng(1))
    two_masses.ride(loop, drive, 700, lambda drive: setattr(drive, "inertia", 0.06), 300)
    assert "alarm at call" in str(loop.watch)
    assert "not linear" not in str(loop.watch)
