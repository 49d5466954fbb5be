"""`regulate` with `keep` for models of readings: limits that noisy runs of hidden plants keep."""

from __future__ import annotations

import copy
import pickle
import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

import stochens_rs as se
from coverage_study import most, sets
from stochens_rs import _core
from stochens_rs.exceptions import InputError, SolverError
from stochens_rs.loops import keep as keeping
from twin.outputs import filter_system, lag_system

pytestmark = pytest.mark.filterwarnings("ignore::stochens_rs.exceptions.DataWarning")
CALLS, AHEAD = 15, 10


class Plant:
    """``y(t+1) = Theta z(t) + L w``, z of lags, or of filters of a pole; 1 to 3 outputs."""

    def __init__(self, gen, pole=None):
        self.p, self.m, self.count = (int(gen.integers(1, 1 + most)) for most in (3, 2, 3))
        self.pole, radius = pole, 2.0
        while radius > 1.05:
            d = (self.p + self.m) * self.count
            self.Theta = gen.standard_normal((self.p, d)) / np.sqrt(self.count)
            self.matrix, self.J, self.G = self.system(self.Theta)
            radius = np.abs(np.linalg.eigvals(self.matrix[:, : -self.m])).max()
        self.L = 0.1 * np.tril(gen.uniform(0.3, 1.0, (self.p, self.p)))

    def system(self, Theta):
        """``[A B]``, J and G in plain NumPy."""
        if self.pole is None:
            return lag_system(Theta, self.count, self.m)
        return filter_system(Theta, self.pole, self.count, self.m)

    def run(self, act, steps, gen, noise=1.0):
        """Readings (steps + 1, p) and inputs (steps, m) from rest."""
        x, y, u = np.zeros(len(self.matrix)), [np.zeros(self.p)], []
        for _ in range(steps):
            u.append(act(y[-1]))
            w, z = noise * self.L @ gen.standard_normal(self.p), np.hstack([x, u[-1]])
            y.append(self.Theta @ self.J @ z + w)
            x = self.matrix @ z + self.G @ w
        return np.array(y), np.array(u)

    def model(self, gen, runs=10, steps=100):
        K = 0.1 * gen.standard_normal((self.m, self.p))

        def act(y):
            return np.clip(K @ y, -1.0, 1.0) + gen.standard_normal(self.m)

        y, u = zip(*(self.run(act, steps, gen) for _ in range(runs)), strict=True)
        if self.pole is None:
            window = se.Window(lags=self.count)
        else:
            window = se.Window(filters=(self.pole, self.count))
        return se.identify(
            se.Trajectories(list(y), list(u), outputs=True), window=window, checks=False
        )


def made(gen, share, *, pole=None, rates=False, size=3.0):
    """A plant and a loop that goes to 9/10 of a limit, `size` of what is kept back for noise."""
    plant = Plant(gen, pole)
    model = plant.model(gen)
    gain = se.gain(model, 1.0, 1.0)
    if gain.certificate((1.0 - share) / 2.0).margin < 2.0:
        return None
    how = {"offset_free": False, "cost": se.Cost(Q=1.0, R=0.1)}
    how["keep"] = se.Keep(gain, CALLS, share)

    def loop(y, u, du, target=None):
        more = {"rate": du, "previous": 0.0} if rates else {}
        limits = se.Limits(u=(-u, u), x=(-y, y), soft=False, **more)
        return se.regulate(model, AHEAD, target, limits=limits, **how)

    far = [np.full(k, 1e6) for k in (plant.p, plant.m, plant.m)]
    try:
        rows = rows_of(loop(*far))
    except SolverError:  # no bound of the noise
        return None
    y, u, du = (size * rows.noise[of] for of in rows.places)
    target = {model.outputs[0]: 0.9 * y[0]}
    u = np.maximum(2.0 * u, 4.0 * np.abs(loop(*far, target).rest.inputs))
    return plant, model, loop(y, u, 2.0 * du, target), (y, u, 2.0 * du)


def rows_of(loop):
    """The margins for noise, and where readings, inputs and changes are among them."""
    kept, model = loop.kept, loop.model
    names, last = list(kept.names), kept.n + model.m
    at = [len(names[: kept.n]) - 1 - names[: kept.n][::-1].index(one) for one in model.outputs]
    return SimpleNamespace(noise=kept.noise, places=(at, slice(kept.n, last), slice(last, None)))


def violated(plant, loop, limits, gen, noise=1.0):
    """Whether a run of the loop breaks a limit in its calls; None without a promise."""
    loop.reset()
    fill = loop.model.window.fill
    y, u = plant.run(loop, fill + CALLS, gen, noise)
    status = [call.status for call in loop.log]
    assert status[:fill] == ["filling"] * fill
    if "infeasible" in status:
        return None
    largest = limits[:2] + ((limits[2],) if loop.kept.below.size else ())
    moved = np.diff(u, axis=0, prepend=np.zeros((1, plant.m)))[fill:]
    rows = y[fill + 1 :], u[fill:], moved
    pairs = zip(rows, largest, strict=False)
    return loop.kept.ended is not None or any((np.abs(v) > most).any() for v, most in pairs)


def study(share, plants, runs, noise=1.0, size=3.0):
    """Violations, runs in the event of the region, and plants that the region misses."""
    bad = all_of = used = missed = number = 0
    while used < plants:
        gen = np.random.default_rng([int(100 * share), number])
        number += 1
        assert number < 4 * plants
        case = made(gen, share, pole=(None, 0.5)[number % 2], rates=number % 3 == 0, size=size)
        if case is None:
            continue
        plant, model, loop, limits = case
        if violated(plant, loop, limits, gen, 0.0) is None:  # its first plan is not accepted
            continue
        found = [violated(plant, loop, limits, gen, noise) for _ in range(runs)]
        used += 1
        n = plant.p
        if not model.region((1 - share) / 2).contains(plant.Theta[:, :n], plant.Theta[:, n:]):
            missed += 1
            continue
        bad, all_of = bad + found.count(True), all_of + runs - found.count(None)
    return bad, all_of, missed


@pytest.mark.parametrize("share", [0.9, 0.7, 0.4])
def test_hidden_plants_keep_their_limits(share):
    """In 6 plants (soak: 40) of lags and of filters, 12 runs each (50).

    Half of what is not promised is for the region, half for the noise of a run in its event: more
    failures than binomial quantiles of 1e-4 are a false alarm of 2e-4 for a share.
    """
    eps, plants = (1.0 - share) / 2.0, sets(40, 6)
    bad, runs, missed = study(share, plants, sets(50, 12))
    assert missed <= most(plants, eps)
    assert bad <= most(runs, eps)


def test_noise_of_twice_the_size_breaks_them():
    """The gate rejects some, which ends the promise in public: the others are counted."""
    bad, runs, _ = study(0.9, sets(12, 6), sets(20, 12), noise=2.0)
    assert bad > most(runs, 0.05)


def test_without_the_part_for_noise_they_break(monkeypatch):
    """As if the covariance were forgotten."""

    def quiet(of, sides, S, *how):
        return _core.Keeper.of(of, sides, 1e-4 * S, *how)

    monkeypatch.setattr(keeping, "_core", SimpleNamespace(Keeper=SimpleNamespace(of=quiet)))
    bad, runs, _ = study(0.9, 4, 12, size=300.0)
    assert bad > most(runs, 0.05)


# a seed of a plant of 2 outputs whose loop accepts its first plan, and how it is made
CASES = {"lags": (6, {}), "filters": (7, {"pole": 0.5}), "rates": (6, {"rates": True})}
CASES["filters and rates"] = (9, CASES["filters"][1] | CASES["rates"][1])


@pytest.fixture(scope="module", params=CASES)
def case(request):
    """A plant of 2 outputs, with a loop."""
    seed, how = CASES[request.param]
    plant, model, loop, limits = made(np.random.default_rng([3, seed]), 0.9, **how)
    assert plant.p == 2
    assert violated(plant, loop, limits, np.random.default_rng(1), 0.0) is not None
    return plant, model, loop, limits


def started(case, seed=4):
    """The loop in the middle of a run, and the last reading."""
    plant, _, loop, _ = case
    loop = copy.deepcopy(loop)
    loop.reset()
    y, _ = plant.run(loop, loop.model.window.fill + 5, np.random.default_rng(seed))
    assert loop.log[-1].status in ("optimal", "kept")
    return loop, y[-1]


def closed(plant, Theta, K, x0, plan, steps, S=None):
    """Readings, inputs and their changes under ``u = v + K (x - xb)``, xb those of the centre.

    With a covariance S of the noise the deviations of each of them.
    """
    (C, J, G), n = plant.system(Theta), len(x0)
    rows = []
    if S is None:
        centre, x, xb = plant.system(plant.found)[0], x0, x0
        last = None
        for k in range(steps):
            v = plan[k] if k < len(plan) else K @ xb
            u = v + K @ (x - xb)
            y = Theta @ J @ np.hstack([x, u])
            rows.append((y, u, u if last is None else u - last))
            x, xb, last = C @ np.hstack([x, u]), centre @ np.hstack([xb, v]), u
        return [np.array(part) for part in zip(*rows, strict=True)]
    A, ahead = C[:, :n] + C[:, n:] @ K, Theta @ J @ np.vstack([np.eye(n), K])
    P = np.zeros((n, n))
    for _ in range(steps):
        P = A @ P @ A.T + G @ S @ G.T
    moved = K @ (A - np.eye(n))
    of = ahead @ P @ ahead.T + S, K @ P @ K.T, moved @ P @ moved.T + K @ G @ S @ G.T @ K.T
    return [np.sqrt(np.diag(one)) for one in of]


def test_noise_is_that_of_the_loop_in_plain_numpy(case):
    """``zeta sqrt(h'Y h)`` is above that of the centre, and twice it at most."""
    plant, model, loop, _ = case
    kept, rows = loop.kept, rows_of(loop)
    S = model.region(0.05).noise
    own = closed(plant, model.coefficients, kept.proof.K, np.zeros(model.n), [], 300, S)
    sides = 2 * (np.isfinite(kept.high).sum())
    zeta = stats.norm.isf(kept.eps / (sides * CALLS * (CALLS + 1) / 2))
    for of, sd in zip(rows.places, own, strict=True):
        found = rows.noise[of] / zeta
        assert (found >= sd[: len(found)] * (1.0 - 1e-9)).all()
        assert (found <= 2.0 * sd[: len(found)]).all()


def test_members_stay_within_the_margin_for_the_model(case):
    """Systems on the boundary of the region, in plain NumPy and without noise."""
    plant, model, loop, _ = case
    proof, gen = loop.kept.proof, np.random.default_rng(5)
    (part,), K = model.region(proof.region.delta).parts, proof.K
    plan, plant.found = gen.standard_normal((6, plant.m)), model.coefficients
    x0 = gen.standard_normal(model.n)
    whole = np.zeros(loop.kept.n)
    whole[: model.n] = x0
    if loop.kept.behind[1]:
        whole[-plant.m :] = gen.standard_normal(plant.m)
    model_part = loop.kept._core.judge(whole, plan, True)[1]
    centre = closed(plant, plant.found, K, x0, plan, 30)
    root, most = np.linalg.cholesky(part.S), 0.0
    for _ in range(200):
        G = gen.standard_normal((plant.p, len(part.white)))
        G /= np.linalg.norm(G, 2)
        member = plant.found + np.sqrt(part.factor) * root @ G @ part.white
        rows = closed(plant, member, K, x0, plan, 30)
        for of, one, own in zip(rows_of(loop).places, rows, centre, strict=True):
            room = model_part[of]
            off = np.abs(one - own).max(axis=0)[: len(room)]
            assert (off <= room).all()
            most = max(most, (off / room).max(initial=0.0))
    assert most > 0.15


def test_what_a_plan_lacks_is_that_of_the_centre_in_plain_numpy(case):
    """``amount = |h'z| + model + noise - limit`` at the step and row that lack most."""
    plant, model, loop, _ = case
    kept, gen, seen = loop.kept, np.random.default_rng(9), set()
    plant.found, n = model.coefficients, model.n
    places = [np.arange(len(kept.names))[of].tolist() for of in rows_of(loop).places]
    for size in 10 * [0.1, 1.0, 10.0]:
        whole, plan = np.zeros(kept.n), size * gen.standard_normal((4, plant.m))
        whole[:n] = x0 = gen.standard_normal(n) * size
        if kept.behind[1]:
            whole[-plant.m :] = size * gen.standard_normal(plant.m)
        short, _ = kept._core.judge(whole, plan, False)
        if short is None or not np.isfinite(short[2]):
            continue
        row, step, amount, off, noise = short
        y, u, du = closed(plant, model.coefficients, kept.proof.K, x0, plan, step + 1)
        kind = next(k for k, rows in enumerate(places) if row in rows)
        if kind == 2 and step == 0:
            continue
        found = (y[step - 1], u[step], du[step])[kind][places[kind].index(row)]
        assert amount == pytest.approx(abs(found) + off + noise - kept.high[row], rel=1e-6)
        seen.add(kind)
    assert 0 in seen or (kept.below.size and 2 in seen)


def test_plans_that_go_on_are_corrected_by_the_gain(case, monkeypatch):
    """``u = v + K (x - xb)``, x the window from all readings."""
    plant, model, loop, _ = case
    loop, y = started(case)
    kept, inputs, read = loop.kept, [call.u for call in loop.log], [call.y for call in loop.log]
    near = 1e-9 if model.window.pole is None else 1e-4  # filters forget their start in `burn` rows
    far = np.full((AHEAD, plant.m), 1e6), "optimal", 0.0
    monkeypatch.setattr(type(loop), "_planned", lambda *given: far)  # is not accepted
    start, plan, xb = kept.since, kept._plan, kept._start[: model.n]
    for k in range(1, AHEAD + 5):
        xb = plant.system(model.coefficients)[0] @ np.hstack([xb, nominal(kept, plan, xb, k - 1)])
        if k <= start:
            continue
        read.append(y)
        inputs.append(loop(y))
        x = model.window.state_of(np.array(read), np.array(inputs[:-1]))
        assert loop.log[-1].status == ("kept" if kept.count <= kept.calls + 1 else "unproved")
        v = nominal(kept, plan, xb, k)
        np.testing.assert_allclose(inputs[-1], v + kept.proof.K @ (x - xb), rtol=0.0, atol=near)
        y = model.coefficients @ model.loop.J @ np.hstack([x, inputs[-1]]) + 0.3 * plant.L[:, 0]
    assert loop.kept.missing > 1.0


def nominal(kept, plan, xb, k):
    return plan[k] if k < len(plan) else kept.proof.K @ xb


ENDS = {
    "missing": ({"y": np.nan}, "not all readings came"),
    "false": ({"y": 1e4}, "not all readings came"),
    "other": ({"applied": 0.1}, "another input acted"),
    "unknown": ({"applied": np.nan}, "another input acted"),
}


@pytest.mark.parametrize("name", ENDS)
def test_the_promise_ends_and_the_loop_goes_on(case, name):
    """It is said once in the log, in the sentence and by the status of each later call."""
    plant, (more, cause) = case[0], ENDS[name]
    loop, y = started(case)
    assert loop.kept.ended is None
    row = y.copy()
    if "y" in more:
        row[0] = more["y"]
        u = loop(row)
    else:
        u = loop(row, applied=loop.log[-1].u + more["applied"])
    text = f"no limit is promised any more: {cause}"
    assert loop.log[-1].reason.endswith(text)
    for _ in range(3 * loop.model.window.fill + 10):  # also behind a whole window
        assert np.isfinite(u).all()
        assert loop.log[-1].status == "unproved"
        assert repr(loop.kept).endswith(f"and Gaussian noise; {text}>")
        u = loop(plant.L @ np.ones(plant.p) * 0.1)
        assert text not in (loop.log[-1].reason or "")
    loop.reset()
    assert loop.kept.ended is None


def test_the_first_window_is_one_of_readings_that_came(case):
    plant, _, loop, _ = case
    loop.reset()
    fill = loop.model.window.fill

    def act(y):
        return loop(np.full(plant.p, np.nan) if loop.calls == fill else y)

    plant.run(act, 3 * fill + 4, np.random.default_rng(7), 0.5)
    filling = [call.status == "filling" for call in loop.log]
    assert filling == [k <= 2 * fill for k in range(len(filling))]
    assert str(loop.kept.ended).endswith(("None", "its calls are over"))


def test_saved_loops_go_on_and_what_cannot_be_is_refused(case, tmp_path):
    plant, model, loop, _ = case
    loop, y = started(case)
    loop.save(tmp_path / "loop")
    others = [
        type(loop).load(tmp_path / "loop"),
        copy.deepcopy(loop),
        pickle.loads(pickle.dumps(loop)),
    ]
    for _ in range(3):
        u = loop(y)
        for other in others:
            np.testing.assert_allclose(other(y), u, atol=1e-9)
            assert repr(other.kept) == repr(loop.kept)
            np.testing.assert_array_equal(other.kept.tightening, loop.kept.tightening)
    if model.window.pole is None:
        gen, runs = np.random.default_rng(6), []
        for _ in range(19):
            loop.reset()
            runs.append(plant.run(loop, model.window.fill + 6, gen)[0])
        assert np.isfinite(loop.validate(np.array(runs)).tube).all()
    with pytest.raises(InputError, match="`to_c` writes no loop with `keep`"):
        loop.to_c(tmp_path / "loop.h")
    with pytest.raises(InputError, match="`plan` needs a loop that plans, without `keep`"):
        _ = loop.plan
    with pytest.raises(InputError, match="`gain` must be of a model, and takes the place"):
        loop.swap(se.gain(model, 1.0, 2.0))


def test_from_too_far_no_plan_is_accepted(case):
    """The input is that of the gain within the limits, without the promise; from nearer it is."""
    plant, model, loop, limits = case
    loop.reset()
    fill, acted = model.window.fill, np.zeros((model.window.fill, plant.m))
    u = loop.start((np.tile(40.0 * limits[0], (fill + 1, 1)), acted))
    call = loop.log[-1]
    assert call.status == "infeasible"
    assert re.search(r"no plan from this state (keeps the limits|comes to rest)", call.reason)
    assert (np.abs(u) <= limits[1]).all()
    assert loop.kept.ended is None
    loop.start((np.zeros((fill + 1, plant.p)), acted))
    assert (loop.log[-1].status, loop.log[-1].reason) == ("optimal", None)


def test_a_target_may_move(case):
    """The limits do not depend on it."""
    plant, model, loop, limits = case
    loop.reset()

    def act(y):
        goal = {model.outputs[0]: (-1.0) ** (loop.calls // 5) * 0.5 * limits[0][0]}
        return loop(y, target=goal)

    y, _ = plant.run(act, model.window.fill + CALLS, np.random.default_rng(8))
    assert {call.status for call in loop.log} <= {"filling", "optimal", "kept"}
    assert (np.abs(y) <= limits[0]).all()


def test_what_is_not_proved_is_refused():
    gen = np.random.default_rng(1)
    y, u = np.zeros((300, 1)), gen.standard_normal((299, 1))
    for t in range(299):
        y[t + 1] = 0.5 * y[t] + u[t] + 0.1 * gen.standard_normal(1)
    data = se.Trajectories([y], [u], outputs=True)

    def model(lags=2, noise=None, intercept=False, **more):
        window = se.Window(lags=lags, **more)
        return se.identify(data, window=window, noise=noise, intercept=intercept, checks=False)

    def refused(match, of=None, error=InputError, gain=None, **other):
        of = of or model()
        keep = other.pop("keep", None) or se.Keep(gain or se.gain(of, 1.0, 1.0), 10)
        how = {"offset_free": False, "limits": (-9.0, 9.0), "keep": keep, **other}
        with pytest.raises(error, match=match):
            se.regulate(*((of,) if isinstance(of, se.feedback.Loop) else (of, 5)), **how)

    refused("`system` must be the model of a Loop", of=se.gain(model(), 1.0, 1.0))
    refused("`offset_free` must be False: .*, with `keep`", offset_free=True)
    refused("`forecast` must be None: plans choose", limits=se.Limits(forecast={"u[0]": 0.0}))
    refused("`system` must be without an intercept", of=model(intercept=True))
    refused("`system` must be without a `tail`", of=model(tail=0.1))
    bounded = se.Noise(sigma=0.1, law="sub-gaussian")
    refused("`system` must have Gaussian noise, got sub-gaussian", of=model(noise=bounded))
    refused("without soft limits of outputs: give soft=False", limits=se.Limits(x=(-9.0, 9.0)))
    refused("`system` must be the model that `gain` was made for", gain=se.gain(model(3), 1.0, 1.0))
    refused("low < 0 < high, with `keep`", limits=(0.0, 9.0))
    refused("with a finite one, with `keep`", limits=None)
    proof = se.gain(model(), 1.0, 1.0).certificate(0.05)
    refused("`probability` must be below", keep=se.Keep(proof, 9, 0.96))
    refused("lacks .* for noise", error=SolverError, limits=(-0.01, 0.01))
    two = se.Trajectories([y], [np.hstack([u, u[::-1]])], outputs=True)
    two = se.identify(two, window=se.Window(lags=2), checks=False)
    given = se.gain(two, 1.0, 1.0, given=["u[1]"])
    refused("`keep` must have a gain of all inputs", of=two, gain=given)
    hard = se.Limits(x=(-9.0, 9.0), soft=False)
    with pytest.raises(InputError, match=r"regulate\(keep=\) keeps hard ones"):
        se.regulate(model(), 5, limits=hard, offset_free=False)
