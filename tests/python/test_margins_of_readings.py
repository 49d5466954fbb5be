"""Margins of loops from readings, against plants and controllers with records of their own."""

from __future__ import annotations

import warnings

import control
import numpy as np
import pytest
from scipy import optimize

import stochens_rs as se
from coverage_study import most, sets
from hidden_outputs import Arx, Rig
from stochens_rs import _core
from stochens_rs.exceptions import InputError


def matrices(x, width):
    return x.reshape(*x.shape[:-1], x.shape[-1] // width, width)


def behind(row, rows):
    return np.concatenate([row[..., None, :], rows], axis=-2)


def together(*parts):
    return np.concatenate([one.reshape(*one.shape[:-2], -1) for one in parts], axis=-1)


class Records:
    """A plant and its controller, each with a window of what it gets, from the formulas alone.

    The plant: ``y+ = Theta z`` of true readings and applied inputs; the controller: ``v = K c``, c
    its window of what it reads and asks for, and the bias ``e+ = e + L (y - H z - e)``. With
    `physics` (A, B, C) the plant has states in place of a window.
    """

    def __init__(self, window, K, L=None, H=None, physics=None):
        self.of, self.K, self.L, self.H, self.physics = window, np.asarray(K), L, H, physics
        self.p, self.m = len(window.outputs), len(window.inputs)
        lags = window.pole is None
        self.sizes = [window.count, window.count + window.delay - 1 if lags else window.count]
        self.queue = 0 if lags else window.delay
        self.n = self.p * self.sizes[0] + self.m * (self.sizes[1] + self.queue)
        self.plant = self.n if physics is None else len(physics[0])

    def next(self, x, u, y=None):
        """z with ``u``, and the record behind it with the reading ``y``; more axes may lead."""
        a, D, r = self.of.pole, self.of.delay, self.of.count
        ends = np.cumsum([self.p * self.sizes[0], self.m * self.sizes[1]])
        read = matrices(x[..., : ends[0]], self.p)
        acted = matrices(x[..., ends[0] : ends[1]], self.m)
        queue = behind(u, matrices(x[..., ends[1] :], self.m))
        if a is None:
            acted = behind(u, acted)
            z = together(read, acted[..., D : D + r, :])
            acted, queue = acted[..., : self.sizes[1], :], queue[..., :0, :]
        else:
            acted = a * acted + (1 - a) * behind(queue[..., D, :], acted[..., :-1, :])
            z, queue = together(read, acted), queue[..., : self.queue, :]
        if y is None:
            return z, None
        newer = behind(y, read[..., :-1, :])
        read = newer if a is None else a * read + (1 - a) * newer
        return z, together(read, acted, queue)

    def step(self, Theta, whole, kappa=1.0, delta=0.0, late=0, mix=None, stored=False, add=None):
        """One step of (plant, controller, bias, inputs asked for before), what to add being 0.

        Returns what comes next and ``(z, y+, v)``; `add` is added to the inputs, to the plant's
        next readings, and to what is read of them.
        """
        n, p, m = self.n + self.plant, self.p, self.m
        more = 0 if self.L is None else p
        x, c, e, past = np.split(whole, [self.plant, n, n + more], axis=-1)
        q, w, error = (np.zeros(m), np.zeros(p), np.zeros(p)) if add is None else add
        v = np.concatenate([c, e], axis=-1) @ self.K.T
        asked = np.concatenate([v, past], axis=-1)
        acts = asked[..., m * late : m * (late + 1)]
        if mix is not None:
            acts = (1 - mix) * v + mix * past[..., :m]
        u = kappa * acts + q
        if self.physics is None:
            z, _ = self.next(x, u)
            y = z @ Theta.T + w
            x = self.next(x, u, y)[1]
        else:
            A, B, C = self.physics
            x, z = x @ A.T + u @ B.T, None
            y = x @ C.T
        read = (1 + delta) * y + error
        seen, c = self.next(c, u if stored else v, read)
        if more:
            e = e + (read - seen @ self.H.T - e) @ self.L.T
        return np.concatenate([x, c, e, asked[..., : past.shape[-1]]], axis=-1), (z, y, v)

    def size(self, late=0):
        return self.n + self.plant + (0 if self.L is None else self.p) + self.m * late

    def matrix(self, Theta, longest=0, **fault):
        late = max(fault.get("late", 0), int(fault.get("mix") is not None), longest)
        return self.step(Theta, np.eye(self.size(late)), **fault)[0].T

    def blocks(self, Theta, white, D, what):
        """A, B, C, D of the region and of one fault, of inputs or readings."""
        n, p, m = self.size(), self.p, self.m
        k, place = (m, 0) if what == "inputs" else (p, 2)
        whole = np.eye(n + D.shape[1] + k)
        add = [np.zeros(m), whole[:, n : n + D.shape[1]] @ D.T, np.zeros(p)]
        add[place] = whole[:, n + D.shape[1] :]
        then, (z, y, v) = self.step(Theta, whole[:, :n], add=add)
        whole = np.hstack([then, z @ white.T, v if what == "inputs" else y]).T
        return whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]


def radius(matrix):
    return np.abs(np.linalg.eigvals(matrix)).max()


def proved(data, window, delta=0.05, Q=1.0, R=1.0):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = se.identify(data, window=window, checks=False, accept="memory")
        proof = se.gain(model, Q, R).certificate(delta)
    return model, proof


def hidden(rng):
    """A hidden system, its true coefficients for a window of lags, and the proof of a gain."""
    plant = Arx(rng)
    model, proof = proved(plant.data(4, 250, rng), se.Window(lags=plant.lags))
    past = range(plant.lags)
    true = np.hstack([*(plant.A[i] for i in past), *(plant.B[i] for i in past)])
    return model, proof, true


class Members:
    """Members of the region of a model, on its boundary."""

    def __init__(self, model, delta=0.05):
        region = model.region(delta)
        (part,) = region.parts
        self.centre, self.white = np.asarray(region.centre), part.white
        values, vectors = np.linalg.eigh(part.S)
        self.D = np.sqrt(part.factor) * vectors * np.sqrt(np.maximum(values, 0))
        self.shape = len(part.S), len(part.white)

    def of(self, G):
        return self.centre + self.D @ (G / np.linalg.norm(G, 2)) @ self.white

    def climbed(self, rng, loops, rounds=8):
        """The largest spectral radius of ``loops(Theta)`` that a search found."""
        best, G = 0.0, np.zeros(self.shape)
        for step in np.geomspace(2.0, 0.1, rounds):
            for _ in range(3):
                trial = G + step * rng.standard_normal(self.shape)
                size = max(radius(one) for one in loops(self.of(trial)))
                if size > best:
                    best, G = size, trial
        return best


def faults(rng, certified, m, p):
    """Faults as large as the sheet allows, each with its line."""
    disk, delay, varying, readings, _, share = certified[4 * m :]
    for i in range(m):
        low, high, phase, alpha = certified[4 * i : 4 * i + 4]
        d = 0.5 * min(alpha, 1.9) * np.exp(1j * rng.uniform(0, 2 * np.pi, 4))
        factors = [low, min(high, 50.0), np.exp(1j * np.deg2rad(phase)), *((1 + d) / (1 - d))]
        for name, one in zip(["gain", "gain", "phase", *["disk"] * 4], factors, strict=True):
            yield name, {"kappa": 1 + (one - 1) * np.eye(m)[i]}
    for _ in range(4):
        d = 0.5 * min(disk, 1.9) * np.exp(1j * rng.uniform(0, 2 * np.pi, m))
        yield "disks", {"kappa": (1 + d) / (1 - d)}
        yield "readings", {"delta": min(readings, 10.0) * rng.choice([-1.0, 1.0], p)}
        yield "share", {"kappa": rng.choice([share, 1.0], m), "stored": True}
    yield from (("delay", {"late": d}) for d in range(1, int(delay) + 1))
    yield "varying", {"mix": min(varying, 1.0)}
    if varying > 1:
        yield "varying", {"late": int(varying)}


def test_the_loop_of_records_is_that_of_the_region():
    """Without a fault, and with an input that the window holds, both are the same loop."""
    rng = np.random.default_rng(1)
    for window in (se.Window(lags=5, delay=1), se.Window(filters=(0.7, 5), delay=1)):
        model, proof = proved(Rig().data(20, rng), window)
        own = Records(model.window, proof.K)
        for _ in range(3):
            Theta = model.coefficients * (1 + 0.01 * rng.standard_normal(model.coefficients.shape))
            ABc = model.window.loop(Theta).ABc
            for by in (1.0, 0.7):
                plain = ABc[:, : own.n] + by * ABc[:, own.n :] @ proof.K
                found = radius(own.matrix(Theta, kappa=by, stored=True))
                assert found == pytest.approx(radius(plain), rel=1e-6)


def test_no_member_leaves_at_the_margins_of_its_loop():
    """The true plant, and the worst members a search finds, with faults as large as certified."""
    rng, worst, seen, count, missed = np.random.default_rng(2), {}, 0, sets(60, 2), 0
    while seen < count:
        model, proof, true = hidden(rng)
        if proof.status != "certified" or len(model.region(0.05).parts) > 1:
            continue
        seen += 1
        members, loop = Members(model), Records(model.window, proof.K)
        sheet = proof.margins()
        assert sheet.disk <= sheet.nominal[-6] * 1.001
        out = False
        for name, fault in faults(rng, sheet.certified, loop.m, loop.p):
            found = members.climbed(rng, lambda T, f=fault, own=loop: [own.matrix(T, **f)], 4)
            worst[name] = max(worst.get(name, 0.0), found)
            out = out or radius(loop.matrix(true, **fault)) >= 1.0
        missed += out
    assert max(worst.values()) < 1.0
    assert missed <= most(count, 0.05)


def small_gain(blocks, gamma, own, count):
    """The least scaled norm on the circle of the region and one fault of this size."""
    A, B, C, D = blocks
    r, k = len(C) - count, B.shape[1] - count
    D = D.copy()
    D[r:, k:] += own * np.eye(count)
    circle = np.exp(1j * np.concatenate([np.linspace(0, np.pi, 60), np.geomspace(1e-4, 1, 30)]))
    whole = C @ np.linalg.solve(circle[:, None, None] * np.eye(len(A)) - A, B) + D

    def norm(log):
        rows, cols = np.ones(len(C)), np.ones(B.shape[1])
        rows[r:], cols[k:] = 10.0 ** (-log / 2), gamma * 10.0 ** (log / 2)
        return np.linalg.norm(rows[:, None] * whole * cols, 2, axis=(1, 2)).max()

    grid = np.linspace(-8, 8, 33)
    at = grid[np.argmin([norm(log) for log in grid])]
    return optimize.minimize_scalar(norm, bounds=(at - 0.5, at + 0.5), method="bounded").fun


def simulated(window, seed, noise=0.1, size=(0.9, 1.1)):
    """Readings of a plant of one output and one input that this window predicts exactly."""
    rng, of = np.random.default_rng(seed), se.identification.Regressors
    pole, count = window.filters if window.filters else (None, window.lags)
    own = Records(of(("y",), ("u",), count, pole, window.delay), None)
    while True:
        Theta = rng.standard_normal((1, 2 * count))
        if size[0] < radius(own.of.loop(Theta).ABc[:, :-1]) < size[1]:
            break
    runs = []
    for _ in range(8):
        x, y, u = np.zeros(own.n), [np.zeros(1)], rng.standard_normal((50, 1))
        for v in u:
            y.append(Theta @ own.next(x, v)[0] + noise * rng.standard_normal(1))
            x = own.next(x, v, y[-1])[1]
        runs.append((np.array(y), u))
    y, u = zip(*runs, strict=True)
    return se.Trajectories(list(y), list(u), outputs=True), Theta


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "window", [se.Window(lags=3), se.Window(filters=(0.4, 2), delay=1)], ids=str
)
def test_sizes_are_those_of_the_small_gain_of_both_records(window, seed):
    """The twin has the whole record of plant and controller; the core only what differs."""
    model, proof = proved(simulated(window, seed)[0], window)
    sheet, members, own = proof.margins(), Members(model), Records(model.window, proof.K)
    assert proof.status == "certified"
    for what, place, skew in (("inputs", -6, 0.5), ("readings", -3, 0.0)):
        of = own.blocks(members.centre, members.white, members.D, what)
        gamma, model_alone = sheet.certified[place], sheet.nominal[place]
        assert 0.0 < gamma < model_alone
        assert small_gain(of, gamma, skew, 1) <= 1.0 + 1e-6
        assert small_gain(of, 1.02 * gamma, skew, 1) > 1.0
        # the centre alone, and python-control on the loop that is broken at the input
        A, B, C, D = of
        alone = A, B[:, -1:], C[-1:], D[-1:, -1:]
        assert small_gain(alone, model_alone * (1 - 1e-3), skew, 1) <= 1.0
        if what == "inputs":
            broken = A - B[:, -1:] @ C[-1:]
            L = control.ss(broken, B[:, -1:], -C[-1:], 0, 1.0)
            omega = np.geomspace(1e-4, np.pi, 5000)
            alpha, _, _ = control.disk_margins(L, omega, skew=0.0)
            assert model_alone == pytest.approx(float(np.min(alpha)), rel=2e-3)


def test_one_output_and_a_delay_have_the_margins_of_their_polynomial():
    """``z^2 - (a + k_u) z + a k_u - kappa b k_y``: the limits of kappa by Jury's conditions."""
    a, b, centre = 1.2, 1.0, np.array([[1.2, 1.0, 0.0], [0.0, 0.0, 1.0]])
    (ky, ku) = K = se.gain((centre[:, :2], centre[:, 2:]), np.diag([1.0, 0.0]), 1.0).K.ravel()
    memory = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([[1.0], [0.0]])

    def limits(a, b):
        return (a - 1.0) * (1.0 - ku) / (-b * ky), (1.0 - a * ku) / (-b * ky)

    for rho in (1e-7, 0.05):
        part = _core.RegionPart(
            np.arange(1), np.arange(2), np.eye(2), np.eye(2), np.zeros((2, 0)), 1.0,
            np.ones((1, 1)), rho**2,
        )  # fmt: skip
        core = _core.Feedback(_core.Region(centre, 1, (part,), None, False), K[None])
        (low, high), nominal = core.margins(memory)[:2, 0], core.margins(memory)[:2, 1]
        assert nominal == pytest.approx(limits(a, b), rel=1e-5)
        angles = np.linspace(0.0, 2 * np.pi, 2001)
        least, largest = limits(a + rho * np.cos(angles), b + rho * np.sin(angles))
        assert least.max() <= low <= least.max() + (5e-3 if rho < 0.01 else 0.05)
        assert largest.min() * (0.995 if rho < 0.01 else 0.9) <= high <= largest.min()


@pytest.fixture(scope="module")
def rig():
    model, proof = proved(
        Rig().data(40, np.random.default_rng(1)), se.Window(filters=(0.7, 5)), Q=[1.0, 10.0], R=0.01
    )
    return model, proof, proof.margins(), Records(model.window, proof.K)


def test_what_acts_on_the_input_now_alone_is_no_margin(rig):
    """With a fault of the current input only, unstable loops of the model are certified."""
    model, proof, sheet, own = rig
    wrong = proof._core.margins()[:, 0]
    centre = model.coefficients
    right = [*sheet.gain[0], np.exp(1j * np.deg2rad(sheet.phase[0]))]
    d = 0.5 * sheet.disk * np.exp(1j * np.linspace(0, np.pi, 40))
    assert max(radius(own.matrix(centre, kappa=one)) for one in [*right, *((1 + d) / (1 - d))]) < 1
    for one in [*wrong[:2], np.exp(1j * wrong[2])]:
        assert radius(own.matrix(centre, kappa=one)) > 1.0
    d = 0.5 * wrong[3] * np.exp(1j * np.linspace(0, np.pi, 40))
    assert max(radius(own.matrix(centre, kappa=one)) for one in (1 + d) / (1 - d)) > 1.0
    # a share is that of an input that the window holds
    share = sheet.certified[-1]
    assert radius(own.matrix(centre, kappa=share, stored=True)) < 1.0
    assert radius(own.matrix(centre, kappa=share)) > 1.0
    # the model alone has no larger delay
    steps = int(sheet.nominal[-5])
    assert radius(own.matrix(centre, late=steps)) < 1.0 < radius(own.matrix(centre, late=steps + 1))


def test_faults_that_an_enemy_changes_at_each_step_do_no_harm(rig):
    """Of all faults that are allowed the one that moves the records furthest, for some members."""
    model, _, sheet, own = rig
    rng, members, m = np.random.default_rng(4), Members(model), own.m
    d = 0.5 * sheet.disk * np.array([-1.0, 0.0, 1.0])
    late = int(sheet.certified[-4])
    assert late >= 1
    kinds = (
        [{"kappa": one} for one in (1 + d) / (1 - d)],
        [{"delta": sheet.certified[-3] * rng.choice([-1.0, 1.0], 2)} for _ in range(4)],
        [{"late": one} for one in range(late + 1)],
        [{"kappa": one, "stored": True} for one in (1.0, sheet.certified[-1])],
    )
    for kind in kinds:
        for trial in range(sets(20, 2)):
            Theta = members.of(rng.standard_normal(members.shape))
            loops = np.array([own.matrix(Theta, late, **one) for one in kind])
            whole, sizes = rng.standard_normal(own.size(late)), []
            for _ in range(600):
                steps = loops @ whole
                worst = np.linalg.norm(steps, axis=1).argmax()
                whole = steps[worst if trial % 2 else rng.integers(len(steps))]
                sizes.append(np.linalg.norm(whole))
            assert max(sizes[-100:]) < 0.5 * max(sizes)
            assert sizes[-1] < 0.1 * max(sizes)
    assert m == 1


@pytest.mark.parametrize("window", [se.Window(filters=(0.7, 5)), se.Window(lags=8)], ids=str)
def test_hidden_plants_stand_all_that_is_certified(window):
    """A pendulum of four states, of which two are read with errors, and the control of a model."""
    plant, C, failed, count = Rig(), np.eye(2, 4), 0, sets(20, 1)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        model, proof = proved(plant.data(40, rng), window, Q=[1.0, 10.0], R=0.01)
        assert proof.status == "certified"
        sheet, physics = proof.margins(), (plant.A, plant.B[:, None], C)
        own = Records(model.window, proof.K, physics=physics)
        true = [radius(own.matrix(None, **f)) for _, f in faults(rng, sheet.certified, 1, 2)]
        assert len(true) > 15
        failed += max(true) >= 1.0
        # and twice as much is more than it stands
        assert radius(own.matrix(None, kappa=2 * sheet.gain[0, 1])) > 1.0
    assert failed <= most(count, 0.05)


def test_the_real_loop_with_a_learned_constant_leaves_where_the_sheet_says():
    """`regulate` itself on the plant of the model, with an input that is weaker or stronger."""
    data, _ = simulated(se.Window(lags=2), 5, noise=0.05, size=(1.02, 1.2))
    model, proof = proved(data, se.Window(lags=2))
    loop = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True)
    proof = loop.certificate(0.05)
    sheet, L, H = proof.margins(), loop._learning[0], model.coefficients
    own = Records(model.window, proof.K, L, H)
    assert proof.status == "certified"
    high = sheet.nominal[1]
    assert radius(own.matrix(H, kappa=high)) == pytest.approx(1.0, abs=1e-4)
    assert 1.0 < sheet.gain[0, 1] < high
    members, rng = Members(model), np.random.default_rng(6)
    for fault in (*({"kappa": one} for one in sheet.gain[0]), {"delta": sheet.certified[-3]}):
        assert members.climbed(rng, lambda T, f=fault: [own.matrix(T, **f)]) < 1.0
    for by, grows in ((0.97, False), (1.03, True)):
        loop.reset()
        plant, y, sizes = np.zeros(own.n), np.array([1e-3]), []
        for _ in range(600):
            v = loop(y)
            z, _ = own.next(plant, by * high * v)
            y = H @ z
            plant = own.next(plant, by * high * v, y)[1]
            sizes.append(abs(y[0]))
        assert (max(sizes[-60:]) > 3 * max(sizes[20:80])) == grows
        assert (max(sizes[-60:]) < max(sizes[20:80]) / 3) != grows


def test_saturation_and_float32_of_a_window():
    rng = np.random.default_rng(7)
    data, Theta = simulated(se.Window(lags=2), 3, noise=0.05, size=(1.02, 1.2))
    model, proof = proved(data, se.Window(lags=2))
    own, members = Records(model.window, proof.K), Members(model)
    assert radius(model.A) > 1.0
    x0 = np.array([1.0, 0.8, 0.0])
    inside, scale = proof.holds((-1.0, 1.0), x0), proof.attracts((-1.0, 1.0), x0)
    assert scale > 1.2 * inside > 0.0
    bound = proof.rounding(x0)
    assert 0.0 < bound.states.max() < 1e-3
    most = np.zeros(own.n)

    def followed(T, x, act, steps=300):
        for _ in range(steps):
            u = act(x)
            x = own.next(x, u, T @ own.next(x, u)[0])[1]
            yield x

    for trial in range(20):
        T = members.of(rng.standard_normal(members.shape)) if trial else Theta
        *_, end = followed(T, scale * x0, lambda x: np.clip(proof.K @ x, -1.0, 1.0))
        assert np.linalg.norm(end) < 1e-3
        K = bound.K.astype(np.float32)
        exact = followed(T, x0, lambda x: proof.K @ x, 100)
        single = followed(T, x0, lambda x, K=K: (K @ x.astype(np.float32)).astype(float), 100)
        for one, other in zip(exact, single, strict=True):
            most = np.maximum(most, np.abs(one - other))
    assert (most <= bound.states).all()
    assert most.max() > 1e-4 * bound.states.max()
    *_, end = followed(Theta, 20 * scale * x0, lambda x: np.clip(proof.K @ x, -1.0, 1.0), 100)
    assert np.linalg.norm(end) > 1e3


def test_what_stays_unknown_is_refused_and_files_have_the_same_sheet(rig, tmp_path):
    model, proof, sheet, _ = rig
    learned = se.regulate(se.gain(model, [1.0, 10.0], 0.01), offset_free=True).certificate(0.05)
    for call in (
        lambda: learned.attracts((-1.0, 1.0), np.ones(learned.region.n)),
        lambda: learned.rounding(np.ones(learned.region.n)),
    ):
        with pytest.raises(InputError, match="not known of a loop with a learned constant"):
            call()
    proof.save(tmp_path / "proof.safetensors")
    again = type(proof).load(tmp_path / "proof.safetensors")
    assert (again.margins().certified == sheet.certified).all()
    assert sheet.names[1] == "largest gain of force"
    assert "phase" in repr(sheet)
    assert len(sheet.plot().axes) == 1


def test_states_with_a_dead_time_have_the_margins_of_both_records():
    rng, A, B = np.random.default_rng(1), np.array([[1.0, 0.1], [0.0, 1.05]]), [0.005, 0.1]
    x, u = np.zeros((10, 31, 2)), rng.standard_normal((10, 30, 1))
    x[:, 0] = rng.standard_normal((10, 2))
    for k in range(30):
        acts = u[:, k - 2] if k >= 2 else np.zeros((10, 1))
        x[:, k + 1] = x[:, k] @ A.T + acts * B + 1e-3 * rng.standard_normal((10, 2))
    data = se.Trajectories(list(x), list(u))
    model = se.identify(data, window=se.Window(delay=2), noise=1e-3, scale=[1.0] * 3)
    proof = se.gain(model, 1.0, 1.0).certificate(0.05)
    sheet, own = proof.margins(), Records(model.window, proof.K)
    low, high, phase = sheet.nominal[:3]
    for kappa in (low, high, np.exp(1j * np.deg2rad(phase))):
        assert radius(own.matrix(model.coefficients, kappa=kappa)) == pytest.approx(1.0, abs=1e-5)
    assert 0.9 * high < sheet.gain[0, 1] < high
    assert radius(own.matrix(model.coefficients, late=int(sheet.nominal[-5]) + 1)) > 1.0
    assert 0.0 < proof.rounding([1.0, 1.0, 0.0, 0.0]).states.max() < 1e-3
    assert proof.attracts((-1.0, 1.0), [1.0, 1.0, 0.0, 0.0]) > 0.28


def test_errors_of_readings_of_a_stated_size_stay_in_the_tube():
    """Errors that an enemy chooses at each step, for members of the region."""
    rng, count, most_of = np.random.default_rng(14), sets(120, 3), 0.0
    for seed in range(count):
        window = (se.Window(lags=2), se.Window(filters=(0.4, 2)), se.Window(lags=2))[seed % 3]
        data = simulated(window, seed, noise=0.05, size=(0.9, 1.1))[0]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = se.identify(data, window=window, checks=False, accept="memory")
            gain = se.gain(model, 1.0, 1.0)
            learned = seed % 3 == 2
            loop = se.regulate(gain, offset_free=True) if learned else gain
            proof = loop.certificate(0.05)
        if proof.status != "certified":
            continue
        source, n = proof.source, proof.region.n
        x0, members = np.zeros(n), Members(model)
        tube = proof.tube(x0, 5, readings=0.1)
        assert (tube.start[0, :n] == 0.0).all()
        assert tube.start[0, n] > 0.0
        assert np.isfinite(tube.reach).all()
        assert proof.tube(x0, 5, readings=0.2).reach == pytest.approx(2 * tube.reach, rel=1e-6)
        H = model.coefficients
        own = Records(source.window, proof.K, source.bias, H)
        T = members.of(rng.standard_normal(members.shape)) if seed % 2 else H
        # the largest output and input at one time: the sign of each error by its own response
        whole = np.zeros(own.size())
        one = own.step(T, whole, add=(np.zeros(1), np.zeros(1), np.ones(1)))[0]
        outputs, inputs = [], []
        for _ in range(400):
            one, (_, y, v) = own.step(T, one)
            outputs.append(abs(y[0]))
            inputs.append(abs(v[0]))
        found = 0.1 * np.array([sum(outputs), sum(inputs)])
        assert found[0] <= tube.reach[0] * (1 + 1e-9)
        assert found[1] <= tube.reach[n] * (1 + 1e-9)
        most_of = max(most_of, found[0] / tube.reach[0])
    assert most_of > 0.5


@pytest.mark.parametrize("bits", [None, 14])
def test_filters_in_the_numbers_of_a_computer_stay_within_their_bound(bits):
    """Filters, gain and inputs as a controller has them, beside the same in exact numbers."""
    window, rng = se.Window(filters=(0.4, 2), delay=1), np.random.default_rng(8)
    data, Theta = simulated(window, 1)
    model, proof = proved(data, window)
    assert proof.status == "certified"
    own, members = Records(model.window, proof.K), Members(model)
    x0 = np.r_[1.0, 0.7, 0.2, -0.1, np.zeros(own.n - 4)]
    bound, worst = proof.rounding(x0, bits=bits), np.zeros(own.n)
    assert np.isfinite(bound.states).all()

    def kept(value):
        if bits is None:
            return np.asarray(value, np.float32)
        return np.round(np.asarray(value, float) * 2.0**bits) / 2.0**bits

    a, count = kept(window.filters[0]), model.window.count
    rest = kept(kept(1.0) - a)

    def record(c, u, y):
        """The controller's own: each operation is rounded."""
        read, acted, queue = c[:count], c[count : 2 * count], c[2 * count :]
        sums = [kept(kept(a * one) + kept(rest * before)) for one, before in (
            *zip(read, [kept(y), *read[:-1]], strict=True),
            *zip(acted, [queue[-1], *acted[:-1]], strict=True),
        )]  # fmt: skip
        return kept([*sums, u, *queue[:-1]])

    K = kept(bound.K[0])
    for trial in range(sets(60, 8)):
        T = members.of(rng.standard_normal(members.shape)) if trial else Theta
        exact, plant, c = x0, x0, kept(x0)
        for _ in range(150):
            u, v = proof.K @ exact, kept(sum(kept(k * one) for k, one in zip(K, c, strict=True)))
            exact = own.next(exact, u, T @ own.next(exact, u)[0])[1]
            y = T @ own.next(plant, np.array([float(v)]))[0]
            plant = own.next(plant, np.array([float(v)]), y)[1]
            c = record(c, v, y[0])
            worst = np.maximum(worst, np.abs(plant - exact))
    assert (worst <= bound.states).all()
    assert worst.max() > 1e-3 * bound.states.max()
