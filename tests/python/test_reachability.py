"""Reachability: exact, of every realization, and on average; the two counterexamples."""

from __future__ import annotations

import itertools
import tracemalloc
from fractions import Fraction

import numpy as np
import pytest

import stochens_rs as se
from stochens_rs.exceptions import InputError, NonFiniteError
from stochens_rs.paper import reachability as notions
from stochens_rs.paper.reachability import approximate
from stochens_rs.theory import dynamics, moments, reachability
from stochens_rs.theory.exact import best_control

# -- the exact system ------------------------------------------------------------------------------


def best(system, x0, xf, steps=1):
    A, B, x0, xf = (np.asarray(values, dtype=float) for values in (*system, x0, xf))
    return best_control(A, B, x0, xf, steps)


def reach(system, x0, xf, steps=1):
    return best(system, x0, xf, steps).reachability()


def test_one_step_is_what_a_plan_says(gen):
    for n, m in ((4, 2), (3, 3), (2, 5), (1, 1)):
        A, B = gen.normal(size=(n, n)), gen.normal(size=(n, m))
        x0, xf = gen.normal(size=(2, n))
        found, plan = reach((A, B), x0, xf), se.control((A, B), x0, xf).reachability
        assert (found.rank, found.reachable) == (plan.rank, plan.reachable)
        assert found.residual == pytest.approx(plan.residual, rel=1e-9, abs=1e-12)
        assert found.relative == pytest.approx(plan.relative, rel=1e-9, abs=1e-12)
        assert found.condition == pytest.approx(plan.condition, rel=1e-9)
        reached = reach((A, B), x0, A @ x0 + B @ gen.normal(size=m))
        assert reached.reachable
        assert reached.residual < 1e-12


def test_several_steps(gen):
    n, m, K = 5, 2, 4
    A, B = gen.normal(size=(n, n)), gen.normal(size=(n, m))
    x0, xf = gen.normal(size=(2, n))
    C = reachability.controllability_matrix((A, B), K)
    blocks = [np.linalg.matrix_power(A, k) @ B for k in range(K)]
    np.testing.assert_allclose(C, np.hstack(blocks), rtol=1e-12)
    W = reachability.gramian((A, B), K)
    np.testing.assert_allclose(W, sum(b @ b.T for b in blocks), rtol=1e-10)
    for steps in (1, 2, K):
        control = best((A, B), x0, xf, steps)
        found, controls = control.reachability(), control.u.reshape(steps, m)
        x = x0
        for u in controls:
            x = A @ x + B @ u
        assert np.linalg.norm(x - xf) == pytest.approx(found.residual, abs=1e-10)
        assert found.reachable == (steps > 2)  # 2 m < n <= 3 m
        assert found.rank == min(n, steps * m)
        assert control.factors.B.shape == (n, steps * m)
    moved = xf - np.linalg.matrix_power(A, K) @ x0
    energy = float((controls**2).sum())
    assert energy == pytest.approx(moved @ np.linalg.pinv(W) @ moved, rel=1e-8)
    # what is reachable after three steps stays so: the rank does not fall
    ranks = [reach((A, B), x0, xf, k).rank for k in range(1, 7)]
    assert ranks == sorted(ranks)


def test_uncontrollable_and_empty_problems():
    A, B = np.diag([0.5, 2.0]), [[1.0], [0.0]]
    for steps in (1, 2, 5):
        found = reach((A, B), [0.0, 1.0], [3.0, 0.0], steps)
        assert (found.rank, found.reachable) == (1, False)
        assert found.residual == pytest.approx(2.0**steps)
    unmoved = best((A, [[0.0], [0.0]]), [1.0, 1.0], [0.5, 2.0])
    nothing = unmoved.reachability()
    assert (nothing.rank, nothing.reachable, nothing.condition) == (0, True, np.inf)
    assert not unmoved.u.any()
    tiny = reach((A, np.array(B) * 1e-200), [0.0, 0.0], [1e-170, 0.0])
    assert tiny.reachable
    assert tiny.rank == 1


# -- every realization -----------------------------------------------------------------------------


def atoms(w):
    """Realizations of a vector with their probabilities, as in the definition."""
    g = np.abs(w).sum()
    if g == 0.0:
        return [(1.0, np.zeros(len(w)))]
    unit = np.eye(len(w))
    return [(abs(x) / g, g * np.sign(x) * unit[i]) for i, x in enumerate(w) if x]


def by_enumeration(B, x0, xf, A):
    """Probability of a control, and rms of the residual, over all realizations."""
    Q = np.eye(len(x0)) - B @ np.linalg.pinv(B)
    probability = square = 0.0
    largest = 0.0
    for columns in itertools.product(*(atoms(a) for a in A.T)):
        M = np.array([a for _, a in columns]).T
        pA = np.prod([p for p, _ in columns])
        for (p, z), (q, f) in itertools.product(atoms(x0), atoms(xf)):
            y = f - M @ z
            residual = np.linalg.norm(Q @ y)
            square += pA * p * q * residual**2
            largest = max(largest, residual)
            if residual <= 1e-9 * max(1.0, np.linalg.norm(y)):
                probability += pA * p * q
    return probability, np.sqrt(square), largest


CASES = {
    "m < n": (([[1.0, -2.0], [0.5, 3.0]], [[1.0], [2.0]]), [1.0, -0.5], [0.5, 2.0]),
    "some": (([[1.0, 0.0], [0.5, 1.5]], [[1.0], [0.0]]), [1.0, -0.5], [0.5, 2.0]),
    "all": (([[1.0, -2.0], [0.0, 0.0]], [[1.0], [0.0]]), [1.0, -0.5], [3.0, 0.0]),
    "zero xf": (([[1.0, -2.0], [0.5, 3.0]], [[1.0], [0.0]]), [1.0, -0.5], [0.0, 0.0]),
    "zero x0": (([[1.0, -2.0], [0.5, 3.0]], [[1.0], [0.0]]), [0.0, 0.0], [1.0, 1.0]),
    "zero column": (([[0.0, -2.0], [0.0, 3.0]], [[1.0], [0.0]]), [1.0, -0.5], [1.0, 0.0]),
    "n = 3": (
        ([[1.0, 0.0, 2.0], [0.0, 1.0, -1.0], [3.0, 0.0, 1.0]], [[1.0, 0], [0, 1.0], [1.0, 1.0]]),
        [1.0, 0.0, 2.0], [1.0, 1.0, 0.0],
    ),
    "invertible": (([[1.0, -2.0], [0.5, 3.0]], [[1.0, 0.3], [0.2, 1.0]]), [1.0, -0.5], [0.5, 2.0]),
    "B = 0": (([[1.0, -2.0], [0.5, 3.0]], [[0.0], [0.0]]), [1.0, -0.5], [0.5, 2.0]),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_sample_reachability_by_enumeration(case):
    system, x0, xf = CASES[case]
    A, B, x0, xf = (np.array(x) for x in (*system, x0, xf))
    probability, rms, largest = by_enumeration(B, x0, xf, A)
    found = notions.sample_reachability(system, x0, xf)
    assert found.probability == pytest.approx(probability, abs=1e-12)
    assert found.rms_residual == pytest.approx(rms, rel=1e-12, abs=1e-7)
    assert found.largest_residual == pytest.approx(largest, rel=1e-12, abs=1e-12)
    assert found.sample_reachable == (probability > 1.0 - 1e-12)
    assert found.residual == pytest.approx(reach(system, x0, xf).residual, abs=1e-12)
    hit = np.count_nonzero(A[:, x0 != 0.0], axis=0)
    products = hit.sum() + bool((hit == 0).any() or not hit.size)
    assert found.atoms == max(1, np.count_nonzero(xf)) * products
    expected = {"all": True, "zero x0": False, "invertible": True}.get(case)
    assert expected in (None, found.sample_reachable)
    if found.sample_reachable:  # and then the exact target is reachable
        assert found.residual < 1e-9
        assert found.atoms == found.reachable_atoms


def test_sample_reachability_fails_for_a_reachable_target(gen):
    """n = 10, m = 5: xf is reachable, none of the realizations is."""
    A, B = gen.normal(size=(10, 10)), gen.normal(size=(10, 5))
    x0 = gen.normal(size=10)
    xf = A @ x0 + B @ gen.normal(size=5)
    found = notions.sample_reachability((A, B), x0, xf)
    assert reach((A, B), x0, xf).reachable
    assert (found.atoms, found.reachable_atoms, found.probability) == (1000, 0, 0.0)
    Q = np.eye(10) - B @ np.linalg.pinv(B)
    C = moments.vector_covariance(xf) + moments.product_covariance(A, x0)
    assert found.rms_residual == pytest.approx(np.sqrt(np.trace(Q @ C @ Q)), rel=1e-9)
    assert found.rms_residual > 1.0
    # and through the sampler: 4000 realizations, mean square within 5 standard errors
    x0s, xfs, As = (se.sample(t, 4000, rng=k) for k, t in ((1, x0), (2, xf), (3, A)))
    y = xfs.dense() - np.einsum("sij,sj->si", As.dense(), x0s.dense())
    squares = ((y @ Q) ** 2).sum(axis=1)
    z = (squares.mean() - found.rms_residual**2) / (squares.std() / np.sqrt(4000))
    assert abs(z) < 5.0
    assert squares.min() > 1e-12
    # the same comparison sees the covariance of x0 left out
    without = np.trace(Q @ (C - A @ moments.vector_covariance(x0) @ A.T) @ Q)
    assert abs(squares.mean() - without) / (squares.std() / np.sqrt(4000)) > 5.0


# -- on average ------------------------------------------------------------------------------------

A2, B2 = np.array([[0.5, 0.4], [0.1, 0.6]]), np.array([[0.0], [1.0]])


@pytest.mark.parametrize(("steps", "xf"), [(1, [0.9, 0.3]), (2, [0.0, 0.5]), (4, [0.1, 0.1])])
def test_a_reachable_target_is_approximately_reachable(steps, xf):
    found = notions.approximately(
        (A2, B2), [1.0, 1.0], xf, steps, sizes=[20, 500, 20_000], delta=1e-4, rng=5
    )
    assert found.exact.reachable
    assert found.consistent
    assert found.verdict == "approximately reachable"
    assert (found.errors <= found.radii + 1e-9).all()
    # the error over its rms: between 1e-3 and 5 in all three sizes
    ratio = found.errors / found.rms
    assert ((ratio > 1e-3) & (ratio < 5.0)).all()
    again = notions.approximately(
        (A2, B2), [1.0, 1.0], xf, steps, sizes=[20, 500], delta=1e-4, rng=found.key
    )
    np.testing.assert_allclose(again.errors, found.errors[:2], rtol=1e-12)


def test_the_rms_of_an_experiment_is_that_of_its_errors():
    """200 experiments of 50 runs: mean square of the errors within 30 % (about 3 se)."""
    runs = [
        notions.approximately((A2, B2), [1.0, 1.0], [0.0, 0.5], 2, sizes=[50], rng=seed)
        for seed in range(200)
    ]
    square = np.mean([float(run.errors[0]) ** 2 for run in runs])
    assert square / float(runs[0].rms[0]) ** 2 == pytest.approx(1.0, abs=0.3)
    assert sum(not run.consistent for run in runs) <= 8  # delta = 0.01: 2 plus 4 se


def test_an_unreachable_target_is_not():
    xf = [2.0, 0.0]  # one step moves the second state only: x_1 = 0.9
    found = notions.approximately((A2, B2), [1.0, 1.0], xf, 1, sizes=[10, 50_000], rng=6)
    assert found.verdict == "not approximately reachable"
    assert found.errors[-1] == pytest.approx(1.1, abs=0.02)
    assert found.rms[-1] == pytest.approx(np.hypot(1.1, 0.0), abs=0.01)
    assert found.exact.residual == pytest.approx(1.1)


def test_a_biased_experiment_is_called_inconsistent(monkeypatch):
    """The check sees runs whose mean is wrong, here by one per cent of A."""
    A, x0 = np.array([[0.0, 1.0], [1.0, 1.0]]), [1.0, 1.0]
    data = ((A, np.eye(2)), x0, [2.0, 1.0], 3)
    assert notions.approximately(*data, sizes=[50_000], rng=7).consistent
    honest = approximate.simulate_ensemble
    monkeypatch.setattr(
        approximate,
        "simulate_ensemble",
        lambda system, **kwargs: honest((1.01 * system[0], system[1]), **kwargs),
    )
    assert notions.approximately(*data, sizes=[50_000], rng=7).verdict == "inconsistent"


# -- counterexamples -------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [3, 10, 100])
def test_lemma_3_1_is_refuted(size):
    rng = np.random.default_rng(size)
    for weights, controls in (
        (None, None),
        ([1] + [0] * (size - 1), [5] * size),
        (rng.integers(1, 9, size).tolist(), rng.integers(-50, 50, size).tolist()),
    ):
        found = notions.lemma_3_1(size, weights=weights, controls=controls)
        assert set(found.approximation_errors.values()) == {Fraction(0)}
        assert set(found.approximation_errors) == {"A", "B", "x0"}
        assert found.hypothesis == Fraction(0)
        assert found.claim == Fraction(1)


@pytest.mark.parametrize("size", [2, 10, 100])
def test_lemma_3_2_is_refuted(size):
    rng = np.random.default_rng(size)
    for weights in (None, [0, 1] + [0] * (size - 2), rng.integers(1, 9, size).tolist()):
        found = notions.lemma_3_2(size, weights=weights)
        assert set(found.approximation_errors.values()) == {Fraction(0)}
        assert found.hypothesis == Fraction(0)
        assert found.claim == Fraction(1)


def test_the_counterexamples_in_floating_point():
    """The same through the package: every weighted control is 0, the exact one is -1."""
    N = 6
    x0, A = np.zeros((N, 1)), np.zeros((N, 1, 1))
    x0[0], A[1] = 1.0, 1.0
    u = se.realization_controls(
        (se.Ensemble.from_samples(A), [[1.0]]), se.Ensemble.from_samples(x0), [0.0]
    )
    assert not u.any()
    assert se.control(([[1.0]], [[1.0]]), [1.0], [0.0]).u == [-1.0]


def test_where_the_system_goes_by_itself_is_reachable():
    """xf = A^K x0 in another order of summation: the difference is rounding, in any direction."""
    gen = np.random.default_rng(3)
    A, B, x0 = gen.standard_normal((4, 4)), gen.standard_normal((4, 1)), gen.standard_normal(4)
    xf = np.array([sum(row[::-1] * x0[::-1]) for row in A])
    assert 0.0 < np.linalg.norm(xf - A @ x0) < 1e-14
    assert reach((A, B), x0, xf).reachable
    assert se.control((A, B), x0, xf).reachability.reachable
    later = np.array([sum(row[::-1] * xf[::-1]) for row in A])
    assert reach((A, B), x0, later, 2).reachable
    assert se.control((A, B), x0, later, steps=2).reachability.reachable
    near = xf + 1e-9 * gen.standard_normal(4)
    assert not reach((A, B), x0, near).reachable
    assert not se.control((A, B), x0, near).reachability.reachable


def test_more_steps_need_not_reach_what_fewer_do():
    system = [[0.5]], [[0.0]]
    assert reach(system, [1.0], [0.5], 1).reachable
    assert not reach(system, [1.0], [0.5], 2).reachable


@pytest.mark.filterwarnings("error")
def test_realizations_at_all_scales():
    (A, B), x0, xf = CASES["m < n"]
    A, x0, xf = np.array(A), np.array(x0), np.array(xf)
    found = notions.sample_reachability((A, B), x0, xf)
    assert found.largest_residual > 0.0
    for s in (1e-200, 1e-150, 1e150, 1e200):
        scaled = notions.sample_reachability((A, B), s * x0, s * xf)
        assert scaled.reachable_atoms == found.reachable_atoms
        assert scaled.largest_residual == pytest.approx(s * found.largest_residual, rel=1e-12)
        assert scaled.rms_residual == pytest.approx(s * found.rms_residual, rel=1e-12)
        split = notions.sample_reachability((A / s, B), s * x0, xf)
        assert split.rms_residual == pytest.approx(found.rms_residual, rel=1e-12)
        run = notions.approximately((A, np.eye(len(B))), s * x0, s * xf, 2, rng=1)
        assert run.verdict == "approximately reachable"
        assert (run.rms > 0.0).all()
        assert (run.errors > 0.0).all()


def test_equal_atoms_are_equal_in_spite_of_rounding():
    # xf hits e_2 with 0.3, A x0 with 3 * 0.1 = 0.30000000000000004; B reaches e_1 only
    found = notions.sample_reachability(
        ([[0.0, 0.0], [0.0, 0.1]], [[1.0], [0.0]]), [0.0, 3.0], [0.0, 0.3]
    )
    assert found.sample_reachable


# -- input -----------------------------------------------------------------------------------------


def test_wrong_input_is_refused():
    (A, B), x0, xf = CASES["m < n"]
    with pytest.raises(InputError, match="`A`"):
        reachability.gramian(([[1.0, 2.0]], B), 2)
    with pytest.raises(InputError, match="`B`"):
        reachability.gramian((A, [[1.0]]), 2)
    with pytest.raises(InputError, match="`steps`"):
        reachability.controllability_matrix((A, B), 0)
    with pytest.raises(NonFiniteError, match="overflow"):
        reachability.gramian((np.array(A) * 1e200, B), 3)
    with pytest.raises(NonFiniteError, match="overflow"):
        reachability.gramian((A, np.array(B) * 1e200), 1)
    with pytest.raises(NonFiniteError, match="overflow"):
        best((np.array(A) * 1e200, B), [1e200, 1e200], xf)
    with pytest.raises(NonFiniteError, match="overflow"):
        notions.sample_reachability((np.array(A) * 1e200, B), [1e200, 1e200], xf)
    with pytest.raises(InputError, match="`xf`"):
        notions.sample_reachability((A, B), x0, [1.0])
    with pytest.raises(InputError, match="`x0`"):
        notions.approximately((A, B), [1.0], xf, 1)
    with pytest.raises(InputError, match="`sizes"):
        notions.approximately((A, B), x0, xf, 1, sizes=[3, 2])
    with pytest.raises(InputError, match="`delta`"):
        notions.approximately((A, B), x0, xf, 1, delta=1.0)
    with pytest.raises(InputError, match="`size`"):
        notions.lemma_3_1(2)
    with pytest.raises(InputError, match="`weights` must have length 3"):
        notions.lemma_3_2(3, weights=[1])
    with pytest.raises(InputError, match="`weights` must be nonnegative"):
        notions.lemma_3_2(2, weights=[1, -1])
    with pytest.raises(InputError, match="`controls`"):
        notions.lemma_3_1(3, controls=[1])


def peak(call):
    """The most bytes that NumPy and Python hold at once during a call."""
    tracemalloc.start()
    try:
        call()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_the_controllability_matrix_takes_no_object_per_block():
    A, B = np.diag([0.9, 0.8, 0.7]), np.ones((3, 1))
    powers = dynamics.matrix_powers(A, 19_999)
    C = dynamics.controllability(powers, B)
    blocks = [B, *(powers[1:] @ B)]
    assert C.tobytes() == np.hstack(blocks).tobytes()
    assert C.flags.c_contiguous
    assert peak(lambda: dynamics.controllability(powers, B)) < 3 * C.nbytes


@pytest.mark.parametrize(("n", "m"), [(3, 1), (20, 1), (10, 10)])
def test_the_memory_check_covers_a_control_over_many_steps(n, m, monkeypatch):
    needed = []
    monkeypatch.setattr(dynamics.memory, "need", lambda _, count: needed.append(count))
    K = dynamics.checked_steps(1000, n, m)
    B, x = np.eye(n, m) + 0.1, np.ones(n)
    assert peak(lambda: best_control(0.99 * np.eye(n), B, x, 0.0 * x, K)) < needed[0]
