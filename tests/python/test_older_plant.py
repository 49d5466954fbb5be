"""`identify(like=, apart=)`: runs of an older plant whose difference is declared."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats

import stochens_rs as se
from coverage_study import most, sets
from pilot_sets import FAMILIES, Plant, covariance, led, measured, rig, steered
from stochens_rs import _core
from stochens_rs.exceptions import InputError, InputTypeError, ShapeError
from test_pilot_twin import H0, SIGMA, THETA, along, integer_runs, near
from twin import older as twin
from twin import pilot
from twin.laws import normal_quantile

Array = np.ndarray
APART = np.array([[0.01, 0.0, 0.0], [0.0, 0.0, -0.02]])


# -- the oracles of the statements -----------------------------------------------------------------


def older_integer_runs() -> tuple[Array, Array]:
    """Pairs and starts of two runs of another plant, by the same integer formulas."""
    rows, starts = [], []
    for r in (3, 4):
        x = np.array([(((3 * r + 2 * i + 1) ** 2 % 7) - 3) / 2 for i in range(2)])
        starts.append(x)
        for k in range(4):
            u = (2 * r + 1) * (k + 2) ** 2 % 5 - 2.0
            w = np.array([(((i + 3) * (4 * r + k + 2) ** 2 % 13) - 6) / 20 for i in range(2)])
            y = (THETA + APART) @ [*x, u] + w
            rows.append([*x, u, *y])
            x = y
    return np.array(rows), np.array(starts)


def integer_problem() -> tuple[twin.Pooled, _core.Pilot]:
    """By the twin and by the core, with weight 1/4."""
    (rows, starts, _), (old, older_starts) = integer_runs(), older_integer_runs()
    sets = [(rows, starts), (old, older_starts)]
    zeta = [pilot.simulated(H0, x0, np.full(len(x0), 4), data[:, 2:3], None) for data, x0 in sets]
    found = twin.pooled(zeta, [rows[:, :3], old[:, :3]], [rows[:, 3:], old[:, 3:]], 0.25)
    model, _ = _core.Pilot.with_older(
        (rows, np.full(3, 4)), (old, np.full(2, 4)), H0, (np.ones(3), 0.02, None),
        SIGMA**2 * np.eye(2), None, 0.25, 1,
    )  # fmt: skip
    return found, model


def test_the_oracles() -> None:
    found, model = integer_problem()
    for H, T in ((found.H, found.T), (model.centre, model.white)):
        near(H[0], 0.904957407813, 0.231118663034, -0.006502237455)
        near((T**2).sum(), 0.147864283619)
    near((found.B**2).sum(), 0.041891723697)
    assert np.abs(model.centre - found.H).max() < 1e-13
    assert np.abs(model.white.T @ model.white - found.T.T @ found.T).max() < 1e-13
    z, _ = along(found.H, np.array([1.0, -1.0]), np.array([0.5, 0.0, -0.5]))
    bias, _ = twin.ball(found.H[:, :2], np.ones(2), z @ found.B.T, 0.02)
    near(bias / np.sqrt(2.0), 0.004881350601)
    # what the split of a level costs at most for one dimension, where nothing is split
    z = stats.norm.isf
    near(z(0.0175) / z(0.025), 1.075712827277)


@pytest.mark.parametrize("declared", ["ball", "directions"])
@pytest.mark.parametrize("seed", range(4))
def test_the_parts_against_the_twin(declared: str, seed: int) -> None:
    gen = np.random.default_rng([7, seed])
    plant = list(FAMILIES.values())[seed]
    (n, m), K, L = plant.B.shape, plant.steps, plant.length
    Theta = np.hstack([plant.A, plant.B])
    d, eta, S = n + m, 0.02, np.exp(gen.standard_normal(n + m))
    E = 0.01 * gen.standard_normal((2 * n, d))
    (rows, _), (old, _) = measured(plant, 12, gen), measured(plant, 30, gen)
    H0 = Theta + 0.01 * gen.standard_normal(Theta.shape)
    lengths = [np.full(len(data) // L, L) for data in (rows, old)]
    apart = (S, eta, None) if declared == "ball" else (S, 0.0, E)
    known = covariance(plant)
    model, weight = _core.Pilot.with_older(
        (rows, lengths[0]), (old, lengths[1]), H0, apart, known[1], None, 0.25, 1
    )
    zeta = [
        pilot.simulated(H0, data[::L, :n], each, data[:, n:d], None)
        for data, each in zip((rows, old), lengths, strict=True)
    ]
    found = twin.pooled(zeta, [rows[:, :d], old[:, :d]], [rows[:, d:], old[:, d:]], weight)
    assert np.abs(model.centre - found.H).max() < 1e-11 * np.abs(found.H).max()
    u0 = steered(H0, plant.x0, plant.xf, K)
    u = steered(model.centre, plant.x0, plant.xf, K)
    predicted = led(model.centre, plant.x0, u)
    reference = model.reference(plant.x0, u0)
    got = model.near(reference, plant.x0, plant.xf, u, predicted, known, 0.05, False)
    _, _, quantile, mismatch, rest, _, _, difference = got
    # quantile and mismatch with the s that the core took
    z, z0 = np.hstack([predicted[:-1], u]), np.hstack([led(H0, plant.x0, u0)[:-1], u0])
    c, g = z @ found.T.T, z0 @ found.white.T
    A, A0 = found.H[:, :n], H0[:, :n]
    C0 = sum(np.kron(x[None, :], P) for x, P in zip(g, pilot.powers(A0, K)[::-1], strict=True))
    q = plant.sigma * normal_quantile(C0 @ C0.T, 0.05 * (0.8 if K > 1 else 0.88))
    s = quantile / q
    assert 0.3 < s < 2.0
    apart_terms = sum(
        np.kron(x[None, :], P) - s * np.kron(y[None, :], P0)
        for x, y, P, P0 in zip(
            c, g, pilot.powers(A, K)[::-1], pilot.powers(A0, K)[::-1], strict=True
        )
    )
    spectral = float(np.linalg.norm(apart_terms, 2))
    frobenius = np.sqrt(stats.chi2.isf(0.05 * 0.06, n * d))
    assert mismatch <= 1.01 * plant.sigma * frobenius * spectral + 1e-9
    # the difference: exact for directions, between the largest one found and two formulas
    seen = z @ found.B.T / S
    if declared == "ball":
        largest, _ = twin.worst(A, S[:n], seen, gen)
        assert eta * largest <= difference <= (1.0 + 1e-5) * min(twin.ball(A, S[:n], seen, eta))
        assert difference <= 1.2 * eta * largest
    else:
        each = [twin.moved(A, [one @ (found.B @ x) for x in z]) for one in (E[:n], E[n:])]
        assert difference == pytest.approx(sum(map(np.linalg.norm, each)), rel=1e-5)
    assert rest >= 0.0
    # the region holds what noise and difference can do together
    whole = model.region(known, 0.05, True)
    rho = np.sqrt(stats.chi2.isf(0.05, n * d)) / 3.0
    for _ in range(50):
        G = gen.standard_normal((n, d))
        D = gen.standard_normal((n, d))
        D *= eta / np.linalg.norm(D, 2)
        moved = S[:n, None] * D / S if declared == "ball" else gen.choice([-1, 1]) * E[:n] + E[n:]
        off = rho / np.linalg.norm(G, 2) * plant.sigma * G @ found.T + moved @ found.B
        assert whole.contains(np.ascontiguousarray(found.H - off))


# -- coverage --------------------------------------------------------------------------------------


def unlike() -> dict[str, Plant]:
    """The rig, families, and systems that look like none of them."""
    rig_ = rig()
    sparse = Plant(
        np.diag([0.9, 0.5, 0.0, 0.7]) + np.diag([0.3, 0.0, 0.4], 1), np.eye(4)[:, 2:3],
        0.05, np.array([1.0, 1.0, 0.5, 0.2]), 10, np.array([1.0, 0.0, -1.0, 0.0]), np.zeros(4), 6,
    )  # fmt: skip
    T = np.diag([1e3, 1.0, 1e-3])
    plain = FAMILIES["n3"]
    units = Plant(
        T @ plain.A @ np.linalg.inv(T), T @ plain.B, 0.1, T.diagonal() * plain.starts, 10,
        T @ plain.x0, plain.xf, 10,
    )  # fmt: skip
    still = Plant(
        np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.0], [0.1]]), 1e-4, np.ones(2), 8,
        np.array([1.0, 0.0]), np.zeros(2), 8,
    )  # fmt: skip
    names = "n2 stable", "n6", "n4 one step", "n2 unstable"
    own = {name: FAMILIES[name] for name in names}
    return {"rig": rig_, **own, "sparse": sparse, "mixed units": units, "unit root": still}


def scale_of(plant: Plant) -> Array:
    """The sizes of states and inputs that are expected."""
    return np.concatenate([plant.starts, np.ones(plant.B.shape[1])])


def outcomes(
    plant: Plant, eta: float, seed: int, levels: tuple[float, ...], *, times: float = 1.0,
    runs: int = 8, noise: bool = False,
) -> list[tuple[float, float, bool, bool]]:  # fmt: skip
    """Weight, miss over certificate, and whether tube or region failed, at each level.

    The difference is `times` what is declared, in the direction that hurts this task most.
    """
    gen = np.random.default_rng([seed, 41])
    (n, m), K, L = plant.B.shape, plant.steps, plant.length
    Theta, S = np.hstack([plant.A, plant.B]), scale_of(plant)
    u = steered(Theta, plant.x0, plant.xf, K)
    z = np.hstack([led(Theta, plant.x0, u)[:-1], u])
    _, D = twin.worst(plant.A, S[:n], z / S, gen)
    shifted = Theta + times * eta * S[:n, None] * D / S
    older = plant._replace(A=shifted[:, :n], B=shifted[:, n:])
    (rows, _), (old, _) = measured(plant, runs, gen), measured(older, 120, gen)
    first, old = old[: 12 * L], np.ascontiguousarray(old[12 * L :])
    H0 = np.linalg.lstsq(first[:, : n + m], first[:, n + m :], rcond=None)[0].T
    H0, known = np.ascontiguousarray(H0), covariance(plant)
    u0 = steered(H0, plant.x0, plant.xf, K)
    model, weight = _core.Pilot.with_older(
        (rows, np.full(runs, L)), (old, np.full(len(old) // L, L)), H0, (S, eta, None), known[1],
        (plant.x0, u0), None, 1,
    )  # fmt: skip
    u = steered(model.centre, plant.x0, plant.xf, K)
    predicted = led(model.centre, plant.x0, u)
    w = plant.sigma * gen.standard_normal((K, n)) if noise else None
    true = led(Theta, plant.x0, u, w)
    found = []
    for delta in levels:
        got = model.near(
            model.reference(plant.x0, u0), plant.x0, plant.xf, u, predicted, known, delta, noise
        )
        off = np.linalg.norm(true - predicted, axis=1) > got[5] + 1e-13 * np.abs(true).max()
        inside = model.region(known, delta, False).contains(Theta)
        miss = float(np.linalg.norm(true[-1] - plant.xf))
        found.append((weight, miss / got[0], bool(off.any()), not inside))
    return found


LEVELS = 0.5, 0.2, 0.05
# relative differences: noise, difference, and neither of both weighs most
ETAS = {"rig": 1e-5, "unit root": 1e-5, "mixed units": 1e-3}


@pytest.mark.slow
@pytest.mark.parametrize("name", unlike())
@pytest.mark.parametrize("noise", [False, True])
def test_coverage(name: str, noise: bool) -> None:
    """150 sets, in `make test` 30; false alarm 1e-4 for each of 3 levels and 3 statements."""
    plant, runs = unlike()[name], sets(150, 30)
    eta = ETAS.get(name, 0.01)
    found = [outcomes(plant, eta, seed, LEVELS, noise=noise) for seed in range(runs)]
    assert np.mean([one[0][0] > 0.0 for one in found]) > 0.5  # older runs did count
    for at, delta in enumerate(LEVELS):
        for failed in (
            sum(one[at][1] > 1.0 for one in found),
            sum(one[at][2] for one in found),
            sum(one[at][3] for one in found),
        ):
            assert failed <= most(runs, delta)


def test_a_larger_difference_than_declared_breaks_it() -> None:
    """Three times what is declared, where the difference is most of the certificate."""
    plant = FAMILIES["n2 stable"]
    found = [outcomes(plant, 0.02, seed, (0.05,), times=3.0)[0] for seed in range(40)]
    assert sum(one[1] > 1.0 for one in found) > 20


@pytest.mark.slow
def test_what_older_runs_are_worth() -> None:
    """Certificate over that of the new runs with the same pilot, medians of 60 sets."""
    plant, L = FAMILIES["n2 stable"], 10
    Theta, known = np.hstack([plant.A, plant.B]), covariance(plant)
    expected = {(0.003, 5): 0.2, (0.003, 20): 0.47, (0.01, 5): 0.36, (0.01, 20): 0.84}
    expected |= {(0.03, 5): 0.86, (0.1, 5): 1.0 + 1e-9}
    for (eta, runs), limit in expected.items():
        ratios = []
        for seed in range(60):
            gen = np.random.default_rng([seed, runs, 977])
            D = gen.standard_normal((2, 3))
            shifted = Theta + eta / np.linalg.norm(D, 2) * D
            older = plant._replace(A=shifted[:, :2], B=shifted[:, 2:])
            (rows, _), (old, _) = measured(plant, runs, gen), measured(older, 200, gen)
            first, old = old[: 20 * L], np.ascontiguousarray(old[20 * L :])
            H0 = np.linalg.lstsq(first[:, :3], first[:, 3:], rcond=None)[0].T
            H0 = np.ascontiguousarray(H0)
            u0 = steered(H0, plant.x0, plant.xf, plant.steps)
            lengths = np.full(runs, L)
            both, _ = _core.Pilot.with_older(
                (rows, lengths), (old, np.full(180, L)), H0, (np.ones(3), eta, None), known[1],
                (plant.x0, u0), None, 1,
            )  # fmt: skip
            sizes = []
            for model in (both, _core.Pilot(rows, lengths, H0, None, 1)):
                u = steered(model.centre, plant.x0, plant.xf, plant.steps)
                task = plant.x0, plant.xf, u, led(model.centre, plant.x0, u)
                reference = model.reference(plant.x0, u0)
                sizes.append(model.near(reference, *task, known, 0.05, False)[0])
            ratios.append(sizes[0] / sizes[1])
        assert np.median(ratios) < limit


# -- the arguments ---------------------------------------------------------------------------------


PLANT = FAMILIES["n2 stable"]
TASK = (PLANT.x0, PLANT.xf, PLANT.steps)


def runs(count: int, seed: int, plant: Plant = PLANT) -> se.Trajectories:
    """Runs of a plant in open loop."""
    rows, _ = measured(plant, count, np.random.default_rng(seed))
    (n, m), L = plant.B.shape, plant.length
    each = rows.reshape(count, L, 2 * n + m)
    states = [np.vstack([run[:, :n], run[-1:, n + m :]]) for run in each]
    return se.Trajectories(states, [run[:, n : n + m] for run in each])


OLD = PLANT._replace(A=PLANT.A + np.array([[0.003, 0.0], [0.0, 0.0]]))
NEW, LIKE = runs(6, 1), runs(60, 2, OLD)


def older(**options: object) -> se.Model:
    """The new runs with those of the older plant."""
    options = {"like": LIKE, "apart": 0.003, "sigma": 0.1, "reference": TASK, **options}
    return se.identify(options.pop("data", NEW), checks=False, **options)


def test_older_runs_count() -> None:
    model = older()
    assert model.pilot is not None
    assert model.pilot.older is not None
    assert model.pilot.older.weight > 0.0
    plan = se.control(model, PLANT.x0, PLANT.xf, steps=PLANT.steps)
    bound = plan.bound(0.05)
    alone = se.identify(NEW, sigma=0.1, pilot=2, reference=TASK, checks=False)
    other = se.control(alone, PLANT.x0, PLANT.xf, steps=PLANT.steps).bound(0.05)
    assert bound.target < other.target / 2
    assert list(bound.parts) == ["reach", "quantile", "mismatch", "rest", "difference"]
    assert bound.target == pytest.approx(sum(bound.parts.values()), rel=1e-12)
    assert "at most 0.003 apart" in bound.assumption
    assert "runs 0 to 5" in bound.assumption
    assert model.region(0.05).contains(PLANT.A, PLANT.B)
    at = [1.0, 1.0], [1.0]
    assert model.region(0.05).bound(*at) < alone.region(0.05).bound(*at)
    assert se.gain(model, 1.0, 1.0).certificate(0.05).status == "certified"
    with pytest.raises(InputError, match="declared, not drawn"):
        plan.typical()
    # two directions promise more than the ball around them, and no difference more than both
    E = [np.array([[0.003, 0.0, 0.0], [0.0, 0.0, 0.0]])]
    along = se.control(older(apart=E), *TASK[:2], steps=5).bound(0.05)
    same = se.control(older(apart=0.0), *TASK[:2], steps=5).bound(0.05)
    assert same.target < along.target < bound.target
    # a difference so large that the new runs alone promise more
    far = older(apart=10.0)
    assert far.pilot is not None
    assert far.pilot.older is not None
    assert far.pilot.older.weight == 0.0
    assert "left out" in far.pilot.said
    # without a task the smallest region
    assert older(reference=None).region(0.05).bound(*at) < alone.region(0.05).bound(*at)
    offset = older(intercept=True, apart=E)
    assert se.control(offset, *TASK[:2], steps=5).bound(0.05).target < 1.0


def test_saved_and_copied(tmp_path: Path) -> None:
    for apart in (0.003, [0.003 * np.eye(2, 3), 0.001 * np.ones((2, 3))]):
        model = older(apart=apart)
        model.save(tmp_path / "model.safetensors")
        loaded = se.Model.load(tmp_path / "model.safetensors")
        for back in (loaded, pickle.loads(pickle.dumps(model))):
            assert back.pilot is not None
            assert model.pilot is not None
            assert back.pilot.said == model.pilot.said
            assert np.array_equal(back.A, model.A)
            bounds = [se.control(one, *TASK[:2], steps=5).bound() for one in (back, model)]
            assert bounds[0].target == bounds[1].target


def test_refusals() -> None:
    def refused(match: str, kind: type = InputError, **options: object) -> None:
        with pytest.raises(kind, match=match):
            older(**options)

    refused("`apart` must be declared; it cannot be estimated from these runs", apart=None)
    own = se.identify(LIKE[:10], sigma=0.1, checks=False)
    refused("`like` runs were also the pilot: split them", pilot=own)
    arrays = [np.zeros((3, 2))]
    refused("Trajectories", InputTypeError, like=arrays)
    refused(
        "old runs without inputs: use them as `pilot` only", InputTypeError, like=np.zeros((3, 2))
    )
    refused("shares runs with the data", like=[LIKE, NEW])
    refused("known covariance", sigma=None)
    refused("open loop", inputs=np.zeros((1, 2)))
    refused("without `like`", like=None, reference=None)
    refused("apart", apart=-1.0)
    refused("at least one direction", apart=[])
    refused("3 columns", ShapeError, apart=[np.eye(2)])
    refused("with the same names", like=runs(5, 3, FAMILIES["n3"]))
    refused("known entries", known_B=PLANT.B)
    uneven = se.Trajectories(
        [np.eye(3, 2), np.arange(10.0).reshape(5, 2)], [np.ones((2, 1)), np.ones((4, 1))]
    )
    refused("lengths_fixed", like=[LIKE, uneven])
    # a pilot of other old runs
    assert older(like=LIKE[10:], pilot=own).pilot is not None


# -- units -----------------------------------------------------------------------------------------


def in_units(plant: Plant, units: Array) -> Plant:
    """The same plant with states multiplied by `units`; `sigma` is then that of each."""
    A, B = units[:, None] * plant.A / units, units[:, None] * plant.B
    sizes = [units * v for v in (plant.starts, plant.x0, plant.xf)]
    return Plant(A, B, units * plant.sigma, sizes[0], plant.length, *sizes[1:], plant.steps)


def spread(n: int, share: float = 1.0) -> Array:
    """Units that differ by 3e5, not in order; with a `share` by that power of it."""
    order = np.random.default_rng(n).permutation(n)
    return 10.0 ** (share * np.linspace(-2.5, 3.0, n)[order])


class Promised(NamedTuple):
    """What a model with older runs promises, and what came of it, in units of the states."""

    weight: float
    components: Array
    off: Array
    missed: bool  # the target
    inside: bool  # the region


def promised(
    plant: Plant, units: Array, kind: str, seed: int, delta: float, *, reference: bool,
    size: float = 0.005, times: float = 1.0, scale: bool = True,
) -> Promised:  # fmt: skip
    """For a difference `times` what is declared, along 2 directions or in norm."""
    gen, (n, m) = np.random.default_rng([seed, 43]), plant.B.shape
    E = size * gen.standard_normal((2, n, n + m)) * (gen.random((2, n, 1)) < 0.5)
    moved = times * (gen.choice([-1.0, 1.0]) * E[0] + E[1])
    old = plant._replace(A=plant.A + moved[:, :n], B=plant.B + moved[:, n:])
    own, sizes = in_units(plant, units), np.concatenate([units, np.ones(m)])
    apart = list(units[:, None] * E / sizes)
    model = se.identify(
        runs(6, 2 * seed + 1, own), covariance=np.diag(own.sigma**2), checks=False,
        like=runs(80, 2 * seed + 2, in_units(old, units)), scale=sizes if scale else None,
        apart=apart if kind == "directions" else np.linalg.norm(moved / times, 2),
        reference=(own.x0, own.xf, own.steps) if reference else None,
    )  # fmt: skip
    plan = se.control(model, own.x0, own.xf, steps=own.steps)
    bound = plan.bound(delta)
    end = led(np.hstack([own.A, own.B]), own.x0, plan.u)[-1] - own.xf
    assert model.pilot is not None
    assert model.pilot.older is not None
    return Promised(
        model.pilot.older.weight, bound.components / units, end / units,
        bool(np.linalg.norm(end) > bound.target), model.region(delta).contains(own.A, own.B),
    )  # fmt: skip


@pytest.mark.parametrize("reference", [True, False])
@pytest.mark.parametrize("kind", ["directions", "norm"])
@pytest.mark.parametrize("name", ["n2 stable", "n6", "n8"])
def test_units_change_nothing(name: str, kind: str, reference: bool) -> None:
    plant = FAMILIES[name]
    n = len(plant.A)
    for seed in range(3):
        one = promised(plant, np.ones(n), kind, seed, 0.05, reference=reference)
        assert name == "n8" or one.weight > 0.0  # there new runs alone promise more
        for units in (spread(n), spread(n, 0.5)[::-1]):
            for scale in {True, kind == "norm"}:  # directions need none
                other = promised(plant, units, kind, seed, 0.05, reference=reference, scale=scale)
                assert other.weight == one.weight
                assert np.abs(other.components / one.components - 1.0).max() < 1e-6
    # a difference that is left out in one system of units is left out in all
    for units in (np.ones(n), spread(n)):
        far = promised(plant, units, kind, 0, 0.05, reference=reference, size=30.0)
        assert far.weight == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["directions", "norm"])
@pytest.mark.parametrize("name", ["n2 stable", "n6"])
def test_coverage_in_raw_units(name: str, kind: str) -> None:
    """100 sets, in `make test` 20; false alarm 1e-4 for each of 2 levels and 3 statements."""
    plant, runs = FAMILIES[name], sets(100, 20)
    units = spread(len(plant.A))
    for reference in (True, False):
        for delta in (0.05, 0.5):
            found = [
                promised(plant, units, kind, seed, delta, reference=reference)
                for seed in range(runs)
            ]
            assert np.mean([one.weight > 0.0 for one in found]) > 0.9
            for failed in (
                sum((np.abs(one.off) > one.components).any() for one in found),
                sum(one.missed for one in found),
                sum(not one.inside for one in found),
            ):
                assert failed <= most(runs, delta)


def test_more_than_declared_breaks_it_in_raw_units() -> None:
    """Twenty times the directions."""
    plant = FAMILIES["n2 stable"]
    units = spread(len(plant.A))
    found = [
        promised(plant, units, "directions", seed, 0.05, reference=True, times=20.0)
        for seed in range(20)
    ]
    assert sum((np.abs(one.off) > one.components).any() for one in found) > 10
