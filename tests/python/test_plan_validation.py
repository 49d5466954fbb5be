"""`Plan.validate`: coverage on systems of every kind, and what makes it void.

Scores without ties: the next run fails with probability ``(M + 1 - j) / (M + 1)``, 5 % for 19
runs. Counts of failures are compared with binomial quantiles of a stated false-alarm rate, for all
draws of fixed seeds; each comparison has a mutant that does not pass it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from hidden_systems import KINDS, drawn
from stochens_rs.exceptions import InputError
from stochens_rs.theory import scenario
from stochens_rs.validation import Validation
from stochens_rs.validation import held_out as held_out_runs
from stochens_rs.validation.held_out import needed, rank_of

ALARM = 1e-6
K = 5


def binomial_range(size: int, p: float, alarm: float = ALARM) -> tuple[int, int]:
    """Counts below and above which lies at most half of `alarm` each."""
    k = np.arange(size + 1)
    logs = [math.lgamma(size + 1) - math.lgamma(i + 1) - math.lgamma(size - i + 1) for i in k]
    law = np.exp(np.array(logs) + k * math.log(p) + (size - k) * math.log1p(-p))
    below = np.cumsum(law)
    low = int(np.searchsorted(below, alarm / 2))
    return low, size - int(np.searchsorted(np.cumsum(law[::-1]), alarm / 2))


def planned(kind: str, gen: np.random.Generator) -> se.Plan:
    system = drawn(kind, gen)
    n = len(system.A)
    # the states of "mixed_state_units" have their own sizes
    size = np.abs(np.column_stack([system.A, system.B])).sum(axis=1) + 1e-12
    x0 = size / size.max() * gen.uniform(0.5, 1.0, n)
    return se.control((system.A, system.B), x0, np.zeros(n), steps=K)


def measured(
    plan: se.Plan, gen: np.random.Generator, shape: tuple[int, ...], starts: float = 0.1
) -> np.ndarray:
    """Runs of a plant that is not that of the plan: saturated, with noise of heavy tails."""
    A, B = plan.basis.A.values, plan.basis.B
    size = np.abs(plan.predicted_states).max(axis=0) + 1e-30
    off = size * gen.standard_t(3, (*shape, K, len(A))) * 0.05
    x = plan.predicted_states[0] + starts * size * gen.uniform(-1, 1, (*shape, len(A)))
    states = [x]
    for k in range(K):
        x = x @ (0.97 * A).T + plan.u[k] @ B.T + off[..., k, :]
        x = np.clip(x, -3.0 * size, 3.0 * size)
        states.append(x)
    return np.stack(states, axis=-2)


def twin(plan, states, delta, scale):
    """Deviations, misses and their order statistics, in NumPy, from the definitions."""
    A, path = plan.basis.A.values, plan.predicted_states
    powers = [np.linalg.matrix_power(A, k) for k in range(1, K + 1)]
    deviations, misses = [], []
    for run in states:
        start = run[0] - path[0]
        off = [(run[k + 1] - path[k + 1] - P @ start) / scale[k] for k, P in enumerate(powers)]
        deviations.append(np.abs(off).max())
        misses.append(np.linalg.norm(run[-1] - plan.basis.xf.values))
    M = len(states)
    j = math.ceil((1 - delta) * (M + 1) - 1e-9)
    return deviations, misses, *(sorted([*one, np.inf])[j - 1] for one in (deviations, misses))


@pytest.mark.parametrize("kind", KINDS)
def test_the_numbers_are_those_of_the_definitions(kind: str) -> None:
    gen = np.random.default_rng(list(KINDS).index(kind))
    plan = planned(kind, gen)
    states = measured(plan, gen, (30,))
    scale = gen.uniform(0.5, 2.0, plan.predicted_states.shape)
    found = plan.validate(states, 0.2, scale=scale)
    deviations, misses, factor, target = twin(plan, states, 0.2, scale[1:])
    kind_of_equal = {"rtol": 1e-9, "atol": 1e-9 * np.abs(plan.predicted_states).max()}
    np.testing.assert_allclose(found.deviations, deviations, **kind_of_equal)
    np.testing.assert_allclose(found.misses, misses, rtol=1e-12)
    assert found.target == sorted(found.misses)[found.rank - 1]
    assert found.target == pytest.approx(target, rel=1e-12)
    assert found.factor == pytest.approx(factor, rel=1e-9, abs=1e-6)
    np.testing.assert_allclose(found.tube[1:], found.factor * scale[1:], rtol=1e-14)
    assert not found.tube[0].any()
    assert (found.tube[1:] >= found.factor * scale[1:]).all()
    # systems are run as `states` runs them
    A, B = plan.basis.A.values, plan.basis.B
    systems = [se.System(A * (1 + 0.01 * s), B) for s in range(4)]
    fresh = plan.validate(systems, 0.5)
    runs = [plan.states(one, plan.predicted_states[0]) for one in systems]
    again = plan.validate(runs, 0.5)
    np.testing.assert_allclose(fresh.deviations, again.deviations, **kind_of_equal)
    np.testing.assert_allclose(fresh.misses, again.misses, **kind_of_equal)


def failures(kind: str, repeats: int, fresh: bool, delta: float = 0.05, M: int = 19) -> np.ndarray:
    """How many of `repeats` next runs leave the tube, and miss the target by more.

    In the second row with the tube and the target one rank lower.
    """
    gen = np.random.default_rng(1000 + list(KINDS).index(kind))
    plan = planned(kind, gen)
    A, B = plan.basis.A.values, plan.basis.B
    powers = np.array([np.linalg.matrix_power(A, k) for k in range(1, K + 1)])
    failed = np.zeros((2, 2), dtype=int)
    runs = None if fresh else measured(plan, gen, (repeats, M + 1))
    for r in range(repeats):
        if runs is None:
            As = A * (1.0 + 0.1 * gen.standard_normal((M + 1, *A.shape)))
            Bs = B * (1.0 + 0.1 * gen.standard_normal((M + 1, *B.shape)))
            # where A and B change nothing, the offset does
            c = np.abs(plan.predicted_states).max() * 0.01 * gen.standard_normal((M + 1, len(A)))
            held = plan.validate(se.SystemEnsemble(As[:M], Bs[:M], c[:M]), delta)
            one = se.SystemEnsemble(As[M:], Bs[M:], c[M:])
            last = plan.validate(one, 0.5)
            off, miss = last.deviations[0], last.misses[0]
        else:
            held = plan.validate(runs[r, :M], delta)
            # by the definition: another code than that of the scores
            x, units = runs[r, M], held.tube[1:] / held.factor
            paths = plan.predicted_states[1:] + powers @ (x[0] - plan.predicted_states[0])
            off, miss = (np.abs(x[1:] - paths) / units).max(), np.linalg.norm(x[K])
        lower = [sorted(one)[held.rank - 2] for one in (held.deviations, held.misses)]
        failed += [[off > held.factor, miss > held.target], [off > lower[0], miss > lower[1]]]
    return failed


@pytest.mark.parametrize("fresh", [False, True], ids=["runs", "fresh systems"])
def test_coverage_is_exact_on_every_kind(fresh: bool) -> None:
    """50 draws of 19 runs and a next one for each kind; two-sided, false alarms 1e-6 each."""
    repeats = 50
    total, wrong = np.sum([failures(kind, repeats, fresh) for kind in KINDS], axis=0)
    low, high = binomial_range(repeats * len(KINDS), 0.05)
    assert ((low <= total) & (total <= high)).all(), (total, low, high)
    assert (wrong > high).all(), (wrong, high)  # mutant: one rank lower


def scalar() -> se.Plan:
    """``x(1) = w``: the plan predicts 0."""
    return se.control(([[0.0]], [[1.0]]), [1.0], [0.0], steps=1)


def noise(w: np.ndarray) -> np.ndarray:
    return np.stack([np.ones_like(w), w], axis=-1)[..., None]


def test_the_confidence_is_exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """1000 draws, in `make test` 150, of 59 runs: Beta(59, 1), .0485 below .95."""
    plan, gen, repeats = scalar(), np.random.default_rng(5), sets(1000, 150)
    draws = noise(gen.standard_normal((repeats, 59)))

    def below() -> tuple[int, int]:
        held = [plan.validate(runs, 0.05, beta=0.05) for runs in draws]
        true = [math.erf(one.target / math.sqrt(2.0)) for one in held]
        promised = [one.coverage(0.05) for one in held]
        late = sum(found < bound for found, bound in zip(true, promised, strict=True))
        return sum(found < 0.95 for found in true), late

    missed, late = below()
    low, high = binomial_range(repeats, 0.95**59)
    assert low <= missed <= high, (missed, low, high)
    low, high = binomial_range(repeats, 0.05)
    assert low <= late <= high, (late, low, high)
    # mutant: the rank without the confidence
    monkeypatch.setattr(held_out_runs, "rank_of", lambda size, delta, beta: rank_of(size, delta))
    assert below()[0] > sets(5, 2) * high


def test_weights_are_needed_where_the_starts_differ() -> None:
    """1500 draws (`make test`: 120), 60 runs from N(0, 1), the next from N(1, 1), w by x0."""
    plan, gen, repeats, M = scalar(), np.random.default_rng(6), sets(1500, 120), 60
    starts = gen.standard_normal((repeats, M + 1)) + (np.arange(M + 1) == M)
    runs = np.stack([starts, np.exp(starts) * gen.standard_normal(starts.shape)], axis=-1)[
        ..., None
    ]
    ratio = np.exp(starts - 0.5)
    failed = np.zeros(2, dtype=int)
    for one, weights in zip(runs, ratio, strict=True):
        with_, without = plan.validate(one[:M], 0.1, weights=weights), plan.validate(one[:M], 0.1)
        miss = abs(one[M, 1, 0])
        failed += [miss > with_.target, miss > without.target]
    low, high = binomial_range(repeats, 0.1)
    assert failed[0] <= high < failed[1], (failed, high)
    assert failed[0] > low / 4  # it is no infinite bound


ANTI = {
    "half of the runs left out": lambda plan, runs: plan.validate(
        runs[np.argsort(plan.validate(runs).deviations)[:19]]
    ),
    "scale from these runs": lambda plan, runs: plan.validate(
        runs[:19], scale=np.abs(runs[:19] - plan.predicted_states).max(axis=0) + 1e-12
    ),
}


@pytest.mark.parametrize("which", ANTI)
def test_what_was_chosen_after_a_look_is_void(which: str) -> None:
    """500 draws of 38 runs and a next one, in `make test` 150: fails far more often than 5 %."""
    gen, repeats = np.random.default_rng(7), sets(500, 150)
    plan = planned("dense", gen)
    runs = measured(plan, gen, (repeats, 39), starts=0.0)
    chosen: Callable[..., Validation] = ANTI[which]
    failed = 0
    for one in runs:
        held = chosen(plan, one[:38])
        failed += bool((np.abs(one[38] - plan.predicted_states) > held.tube).any())
    assert failed > binomial_range(repeats, 0.05)[1], failed


def test_how_many_runs_are_needed() -> None:
    for delta, size in ((0.2, 4), (0.1, 9), (0.05, 19), (0.01, 99), (0.3, 3), (0.5, 1), (0.9, 1)):
        assert needed(delta) == size
        assert rank_of(size, delta) <= size
        assert size == 1 or rank_of(size - 1, delta) == size
    # with confidence: of M runs 0, 1 or 2 may be left out
    for share, sure, sizes in (
        (0.9, 0.9, (22, 38, 52)),
        (0.9, 0.95, (29, 46, 61)),
        (0.95, 0.9, (45, 77, 105)),
        (0.95, 0.95, (59, 93, 124)),
        (0.95, 0.99, (90, 130, 165)),
        (0.99, 0.95, (299, 473, 628)),
    ):
        delta, beta = round(1 - share, 9), round(1 - sure, 9)
        assert needed(delta, beta) == sizes[0]
        for left, size in enumerate(sizes):
            assert rank_of(size, delta, beta) == size - left
            assert rank_of(size - 1, delta, beta) == size - left
    assert scenario.hold_out(59, 0, 1 - 0.951505474751) == pytest.approx(0.05, abs=1e-9)
    assert scenario.hold_out(39, 1, 1 - 0.912409582569) == pytest.approx(0.1, abs=1e-9)


def test_too_few_runs_say_what_is_needed() -> None:
    plan, draws = scalar(), noise(np.arange(1.0, 60.0))
    few = plan.validate(draws[:8])
    assert np.isinf(few.factor)
    assert np.isinf(few.target)
    assert np.isinf(few.tube[1:]).all()
    assert few.reason == (
        "8 runs cannot support 95 %: 19 are needed (59 to say it with confidence 95 % for these "
        "very runs); 88.8888 % is possible"
    )
    assert few.coverage() == 1.0
    assert "nothing is validated: 8 runs" in repr(few)
    assert plan.validate(draws[:8], 0.12).target == 8.0
    assert plan.validate(draws[:19]).target == 19.0
    assert plan.validate(draws[:39]).target == 38.0
    sure = plan.validate(draws[:58], beta=0.05)
    assert sure.reason == "58 runs cannot support 95 % with confidence 95 %: 59 are needed"
    assert plan.validate(draws, beta=0.05).reason is None
    assert "with confidence 0.95, if the runs are independent" in sure.covers
    # of the textbook: cumulative .18, .27, .64, .82
    weighted = [plan.validate(draws[:4], d, weights=[1, 0.5, 2, 1, 1]) for d in (0.2, 0.1)]
    assert [one.target for one in weighted] == [4.0, np.inf]
    assert "the weights of 4 runs" in str(weighted[1].reason)
    with pytest.raises(InputError, match="`coverage` is not known"):
        weighted[0].coverage()
    with pytest.raises(InputError, match="`beta` must be left out"):
        plan.validate(draws, beta=0.05, weights=np.ones(60))


def test_runs_that_diverged_stay_in() -> None:
    plan = se.control(([[0.5]], [[1.0]]), [1.0], [0.0], steps=2)
    runs = [[[1.0], [0.1 * r], [0.01 * r]] for r in range(37)]
    for lost in ([[1.0], [np.nan], [np.nan]], [[1.0], [2.0]], [[1.0], [np.inf], [0.0]]):
        held = plan.validate([*runs, lost, [[1.0], [0.0], [0.0]]])
        assert held.diverged == 1
        assert held.rank == 38
        assert held.target == 0.36
        two = plan.validate([*runs, lost, lost])
        assert two.reason == "2 of 39 runs diverged or ended early; 95 % allows for 1"
    inputs = [np.tile(plan.u, (1, 1))] * 38 + [plan.u[:1]]
    aborted = se.Trajectories([*runs, runs[0], [[1.0], [2.0]]], inputs)
    assert plan.validate(aborted).diverged == 1
    # one that overflows has a run that is not finite
    fresh = [se.System([[1e200]], [[1.0]]), *[se.System([[0.4]], [[1.0]])] * 38]
    held = plan.validate(fresh)
    assert held.diverged == 1
    assert np.isfinite(held.target)


def test_equal_runs_are_counted() -> None:
    held = scalar().validate(noise(np.repeat([0.0, 1.0], [30, 9])))
    assert held.target == 1.0
    assert scalar().validate(noise(np.zeros(39))).target == 0.0


def test_what_the_numbers_would_be_void_for_is_refused() -> None:
    names = {"states": ["p", "v"], "inputs": ["F"]}
    A, B = [[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.1]]
    plan = se.control(se.System(A, B, dt=0.1, **names), [1.0, 0.0], [0.0, 0.0], steps=4)
    states = [plan.predicted_states + 0.01 * r for r in range(20)]
    runs = se.Trajectories(states, [plan.u] * 20, dt=0.1, state_names=["p", "v"])
    held = plan.validate(runs)
    assert np.array_equal(held.misses, plan.validate(np.array(states)).misses)
    # names in another order are brought into order; what comes after the plan is not used
    turned = [np.vstack([one, one[-1:]])[:, ::-1] for one in states]
    longer = [np.vstack([plan.u, [[7.0]]])] * 20
    swapped = se.Trajectories(turned, longer, dt=0.1, state_names=["v", "p"])
    assert np.array_equal(plan.validate(swapped).deviations, held.deviations)
    data = se.Trajectories(states, np.random.default_rng(1).standard_normal((20, 4, 1)))
    z = np.random.default_rng(1).standard_normal((30, 5))
    pairs = se.Trajectories.from_pairs(z[:, :2], z[:, 2:3], z[:, 3:])
    model = se.identify(pairs, noise=se.Noise(design="independent", sigma=1.0))
    estimated = se.steer((A, B), [1.0, 0.0], [0.0, 0.0], 100, steps=4, rng=1)
    off = se.control(model, se.Uncertain([1.0, 0.0], 0.1), [0.0, 0.0], steps=4)
    one = se.System(A, B)
    for wrong, text in (
        (lambda: plan.validate(data), "`runs` must have the inputs of this plan, run 0"),
        (lambda: plan.validate([model] * 20), "`runs` must not be models from data"),
        (lambda: plan.validate(model.draw(20, rng=1)), "`runs` scatter about an estimate"),
        (lambda: plan.validate(se.Trajectories(states, [plan.u] * 20, dt=1.0)), "dt=0.1"),
        (lambda: plan.validate(runs, weights=-np.ones(21)), "`weights` must be >= 0"),
        (lambda: estimated.validate([one] * 20), "`x0` must be given"),
        (lambda: off.validate([one] * 20), "`x0` must be given"),
    ):
        with pytest.raises(InputError, match=text):
            wrong()
    # with the start it goes
    assert estimated.validate([one] * 20, x0=[1.0, 0.0]).size == 20


def test_a_prediction_and_the_units_of_its_model() -> None:
    """A model from data: the units of the tube are the deviations that its noise gives."""
    gen = np.random.default_rng(2)
    A, B, sigma = np.array([[0.9, 0.2], [0.0, 0.8]]), np.array([[0.0], [1.0]]), 0.05
    z = gen.standard_normal((200, 3))
    after = z[:, :2] @ A.T + z[:, 2:] @ B.T + sigma * gen.standard_normal((200, 2))
    data = se.Trajectories.from_pairs(z[:, :2], z[:, 2:], after)
    model = se.identify(data, noise=se.Noise(design="independent", sigma=sigma))
    plan = se.predict(model, [1.0, 0.0], np.ones((6, 1)))
    runs = np.tile([1.0, 0.0], (40, 7, 1))
    for k in range(6):
        runs[:, k + 1] = runs[:, k] @ A.T + B.ravel() + sigma * gen.standard_normal((40, 2))
    held = plan.validate(runs)
    assert held.xf.tolist() == plan.predicted_states[-1].tolist()
    units = held.tube[1:] / held.factor
    total = np.zeros((2, 2))
    for k in range(6):
        total = model.A @ total @ model.A.T + sigma**2 * np.eye(2)
        np.testing.assert_allclose(units[k], np.sqrt(np.diag(total)), rtol=1e-12)
    assert 2.0 < held.factor < 6.0
    # a number of runs is no certificate: the record is another one, and none goes into the other
    certificate = plan.bound(noise=True)
    assert not isinstance(held, type(certificate))
    assert certificate.target != held.target
