"""`Regulator.validate` and the mean of Hotelling: coverage, what is the same, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import stochens_rs as se
from coverage_study import exactly, sets
from hidden_outputs import of_lags, one_log
from stochens_rs.exceptions import InputError

A, B = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.005], [0.1]])
K = 8


def loop(**options) -> se.Regulator:
    options = {"limits": (-2.0, 2.0), "cost": se.Cost(Q=1.0, R=0.01), **options}
    return se.regulate((A, B), 5, **options)


def ridden(controller: se.Regulator, M: int, gen: np.random.Generator):
    """Runs of a plant that is not the model: friction, saturation, noise of heavy tails."""
    x, u = np.empty((M, K + 1, 2)), np.empty((M, K, 1))
    for run, inputs in zip(x, u, strict=True):
        controller.reset()
        run[0] = gen.uniform(-1.0, 1.0, 2)
        for k in range(K):
            inputs[k] = controller(run[k])
            drag = [0.0, 0.02 * np.tanh(5.0 * run[k, 1])]
            w = 0.01 * gen.standard_t(3, 2)
            run[k + 1] = A @ run[k] + B @ np.clip(inputs[k], -1.5, 1.5) - drag + w
    return x, u


def test_the_scores_by_their_definition() -> None:
    x, u = ridden(loop(), 20, np.random.default_rng(1))
    held = loop().validate(x, 0.1, scale=[0.1, 0.2])
    for run, deviation, miss in zip(x, held.deviations, held.misses, strict=True):
        one, p, off = loop(), run[0], []
        for k in range(K):
            p = A @ p + B @ one(p)
            off.append(np.abs(run[k + 1] - p) / [0.1, 0.2])
        assert deviation == pytest.approx(np.max(off), rel=1e-9)
        assert miss == pytest.approx(np.linalg.norm(run[-1]), rel=1e-12)
    assert held.source == "runs of a loop"
    assert held.rank == 19
    assert held.noise_free is None
    assert "same controller" in held.covers
    assert "20 runs of a loop" in repr(held)
    same = loop().validate(se.Trajectories(x, u), 0.1, scale=[0.1, 0.2])
    np.testing.assert_array_equal(same.deviations, held.deviations)
    # a used loop is validated as a fresh one
    used = loop()
    used([1.0, 0.0])
    assert used.validate(x, 0.1, scale=[0.1, 0.2]).factor == held.factor
    assert used.calls == 1


def test_coverage_and_a_mutant() -> None:
    """300 draws, in `make test` 20, of 19 runs and a next one at 5 %; far starts fail more."""
    gen, failed, moved = np.random.default_rng(2), np.zeros(2, dtype=int), 0
    count = sets(300, 20)
    for _ in range(count):
        x, _ = ridden(loop(), 20, gen)
        held = loop().validate(x[:19], scale=[0.1, 0.2])
        last = loop().validate(x[19:], 0.5, scale=[0.1, 0.2])
        failed += [last.deviations[0] > held.factor, last.misses[0] > held.target]
        moved += 3.0 * last.misses[0] > held.target
    exactly(failed, count)
    assert moved > stats.binom.ppf(1 - 1e-5, count, 0.05)


def test_what_is_void_is_refused() -> None:
    gen = np.random.default_rng(3)
    x, u = ridden(loop(), 19, gen)
    tuned = loop(cost=se.Cost(Q=1.0, R=0.1))
    with pytest.raises(InputError, match="`runs` must have the inputs of this loop, run 0"):
        tuned.validate(se.Trajectories(x, u))
    few = loop().validate(x[:8])
    assert np.isinf(few.factor)
    assert "8 runs cannot support 95 %: 19 are needed" in str(few.reason)
    lost = [*x, np.full((3, 2), np.nan), x[0][:4]]
    assert loop().validate(lost).diverged == 2
    z = gen.standard_normal((40, 5))
    after = z[:, :2] @ A.T + z[:, 2:3] @ B.T + z[:, 3:] * [0.01, 0.03]
    pairs = se.Trajectories.from_pairs(z[:, :2], z[:, 2:3], after)
    model = se.identify(pairs, checks=False)
    units = se.regulate(model, 5, limits=(-2.0, 2.0)).validate(x)
    np.testing.assert_allclose(
        units.tube[-1] / units.factor, np.sqrt(np.diag(model.covariance)), rtol=1e-12
    )


def test_the_mean_of_the_last_state() -> None:
    """2000 draws (`make test`: 200), 9 runs of one plan: the mean is further off in 5 % at most."""
    plan = se.control((A, B), [1.0, 0.0], [0.0, 0.0], steps=3)
    gen, failed = np.random.default_rng(4), 0
    off = np.array([0.03, -0.02])
    M, n, count = 9, 2, sets(2000, 200)
    for r in range(count):
        runs = np.repeat(plan.predicted_states[None], M, axis=0)
        ends = off + gen.standard_normal((M, 2)) @ [[0.1, 0.05], [0.0, 0.02]]
        runs[:, -1] += ends
        held = plan.validate(runs, 0.05)
        if r < 3:
            S = np.cov(runs[:, -1].T)
            F = stats.f.isf(0.05, n, M - n)
            size = np.sqrt(np.linalg.eigvalsh(S)[-1] * n * (M - 1) / (M * (M - n)) * F)
            expected = np.linalg.norm(runs[:, -1].mean(axis=0)) + size
            assert held.noise_free == pytest.approx(expected, rel=1e-9)
        failed += np.linalg.norm(off) > held.noise_free
    assert failed <= stats.binom.ppf(1 - 1e-5, count, 0.05)
    assert plan.validate(runs[:2]).noise_free == np.inf
    runs[0, 0] += 0.1
    assert plan.validate(runs).noise_free is None


def of_readings(**options):
    """A loop of two outputs and one input, and runs of a plant that is not its model."""
    gen = np.random.default_rng(5)

    def ahead(y, before, v, w):
        pull = [0.02 * np.tanh(5.0 * (y[0] - before[0])), 0.0]
        now = [1.6 * y[0] - 0.7 * before[0] + v[0], 0.5 * y[1] + 0.3 * y[0]]
        return np.array(now) - pull + 0.05 * w

    y, u = one_log(lambda y, u: ahead(y[-1], y[-2], u[-1], 0.0), gen, 400, (2, 1), lags=2)
    model = of_lags(y, u, 2, checks=False)
    made = se.regulate(se.gain(model, 1.0, 1.0), offset_free=True, limits=(-1.5, 1.5), **options)

    def ride(M, spread=1.0):
        y, u = np.empty((M, K + 1, 2)), np.empty((M, K, 1))
        for run, inputs in zip(y, u, strict=True):
            made.reset()
            run[0] = spread * gen.uniform(-1.0, 1.0, 2)
            for k in range(K):
                inputs[k] = made(run[k])
                w = gen.standard_t(3, 2)
                run[k + 1] = ahead(run[k], run[max(k - 1, 0)], inputs[k], w)
        return y, u

    return made, ride


def test_a_run_in_which_the_loop_never_begins_is_lost() -> None:
    made, ride = of_readings(target=[0.5, np.nan], max_missing=0)
    y, _ = ride(3)
    y[1] = 1e12  # a sensor that is broken from the first call on
    assert np.isinf(made.validate(y, 0.5).deviations).tolist() == [False, True, False]


def test_coverage_of_a_loop_from_readings() -> None:
    """300 draws, in `make test` 10, of 19 runs and a next one at 5 %; a far start fails more."""
    made, ride = of_readings(target={"y[0]": 0.5})
    failed, moved, count = np.zeros(2, dtype=int), 0, sets(300, 10)
    for _ in range(count):
        held = made.validate(ride(19)[0])
        last, far = (made.validate(ride(1, size)[0], 0.5) for size in (1.0, 300.0))
        failed += [last.deviations[0] > held.factor, last.misses[0] > held.target]
        moved += far.misses[0] > held.target
    exactly(failed, count)
    assert moved > stats.binom.ppf(1 - 1e-5, count, 0.05)
