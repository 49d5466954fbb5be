"""Weights against independent solutions: exact rationals, enumeration, a QP by all supports.

The reference in NumPy has the same weights (`test_against_reference`). Sections: errors of every
prefix; the closed form of ALSE (Lemma 4.4, corrected) against quadratic programs; the order of the
methods on every path.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

import stochens_rs as se
from stochens_rs import reference as twin
from stochens_rs.fusion import Alse

Array = NDArray[np.float64]
Exact = list[Fraction]


class Result(NamedTuple):
    estimate: Array
    weights: Array
    error: float


def fused(ensemble: Any, method: str, target: Any, weight_set: str) -> Result:
    fit = se.fuse(ensemble, Alse(weight_set) if method == "alse" else method, target=target)
    return Result(fit.estimate, fit.weights, fit.error)


def dense(samples: Any, method: str, target: Any, weight_set: str = "simplex") -> Result:
    samples = np.asarray(samples, dtype=float)
    return fused(se.Ensemble.from_samples(samples), method, target, weight_set)


def singleton(
    indices: Any, w: Any, method: str, target: Any = None, weight_set: str = "simplex"
) -> Result:
    goal = w if target is None else target
    return fused(se.Ensemble.from_indices(np.asarray(indices), w), method, goal, weight_set)


def errors_of(ensemble: se.Ensemble, method: str, target: Any) -> Array:
    """The errors of all prefixes."""
    path = se.fuse_path(ensemble, np.arange(1, ensemble.size + 1), method, target=target)
    return np.asarray(path.errors)


# --- exact arithmetic -----------------------------------------------------------------------------


def dot(a: Exact, b: Exact) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def exact_search(F: Exact, E: Exact, target: Exact) -> Exact:
    """The point of [F, E] nearest to the target, t = clip(<E* - F, E - F> / ||E - F||^2, 0, 1)."""
    d = [e - f for e, f in zip(E, F, strict=True)]
    if not any(d):
        return F
    t = dot([a - f for a, f in zip(target, F, strict=True)], d) / dot(d, d)
    t = min(max(t, Fraction(0)), Fraction(1))
    return [f + t * x for f, x in zip(F, d, strict=True)]


def exact_errors(samples: Sequence[Sequence[Any]], target: Sequence[Any], method: str) -> Exact:
    """The squared errors after 1..N samples, for rational samples, as rationals."""
    E = [[Fraction(x) for x in row] for row in samples]
    goal = [Fraction(x) for x in target]
    F, total, out = E[0], [Fraction(0)] * len(goal), []
    for n, sample in enumerate(E, start=1):
        total = [a + b for a, b in zip(total, sample, strict=True)]
        mean = [a / n for a in total]
        F = mean if method == "uniform" else exact_search(F, sample, goal)
        if method == "slse-safeguarded":
            F = exact_search(F, mean, goal)
        r = [a - f for a, f in zip(goal, F, strict=True)]
        out.append(dot(r, r))
    return out


# --- SLSE: what is true ---------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["uniform", "slse", "slse-safeguarded"])
def test_errors_of_every_prefix_are_exact(method: str) -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        N, n = int(rng.integers(1, 9)), int(rng.integers(1, 5))
        samples, target = rng.integers(-4, 5, (N, n)), rng.integers(-3, 4, n)
        exact = exact_errors(samples.tolist(), target.tolist(), method)
        errors = errors_of(se.Ensemble.from_samples(samples.astype(float)), method, target)
        assert_allclose(errors**2, [float(e) for e in exact], rtol=1e-11, atol=1e-13)
        last = dense(samples, method, target)
        assert_allclose(last.error**2, float(exact[-1]), rtol=1e-11, atol=1e-13)
        assert_allclose(last.weights @ samples, last.estimate, atol=1e-12)
        assert abs(last.weights.sum() - 1) < 1e-12
        assert last.weights.min() >= 0


def test_a_repeated_sample_changes_nothing() -> None:
    """E = F: the step is 0 by convention, so the weight stays with the first occurrence."""
    for result in (
        dense([[1.0, 2.0]] * 3, "slse", [5.0, 0.0]),
        singleton([1, 1, 1], np.array([1.0, 2.0]), "slse"),
    ):
        assert result.weights.tolist() == [1.0, 0.0, 0.0]


def random_cases(count: int, seed: int) -> Iterator[tuple[Array, Array]]:
    """Dense samples and targets, vectors and matrices, with repeated samples among them."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        shape = [(3,), (2, 3), (6,)][k % 3]
        samples = rng.normal(size=(int(rng.integers(1, 25)), *shape))
        repeated = samples[rng.integers(0, len(samples), size=len(samples))]
        target = rng.normal(size=shape) * (0.0 if k % 10 == 9 else 0.3)
        yield (repeated if k % 2 else samples), target


def test_order_of_the_methods_on_every_path() -> None:
    """ALSE <= safeguarded SLSE <= uniform and ALSE <= SLSE; all but uniform non-increasing."""
    for samples, target in random_cases(30, seed=6):
        unit = float(np.sum(target**2)) or max(float(np.sum(E**2)) for E in samples)
        drawn = se.Ensemble.from_samples(samples)
        squares = {
            m: errors_of(drawn, m, target) ** 2
            for m in ("uniform", "alse", "slse", "slse-safeguarded")
        }
        slack, solver = 1e-13 * unit, 2e-9 * unit  # rounding; the tolerance of `fuse`
        assert np.all(squares["slse-safeguarded"] <= squares["uniform"] + slack)
        for method in ("slse", "slse-safeguarded"):
            assert np.all(np.diff(squares[method]) <= slack)
            assert np.all(squares["alse"] <= squares[method] + solver)
        assert np.all(squares["alse"] <= squares["uniform"] + solver)
        assert np.all(np.diff(squares["alse"]) <= solver)


def test_safeguard_holds_where_slse_fails() -> None:
    """Negative control: on the same paths the plain SLSE does exceed the uniform mean."""
    violations, w = 0, np.array([2.0, 1.0, 1.0])
    for idx in itertools.product(range(3), repeat=4):
        drawn = se.Ensemble.from_indices(np.array(idx), w)
        errors = {m: errors_of(drawn, m, w) for m in ("uniform", "slse", "slse-safeguarded")}
        violations += int(np.any(errors["slse"] > errors["uniform"] + 1e-9))
        assert np.all(errors["slse-safeguarded"] <= errors["uniform"] + 1e-13)
    assert violations > 0


# --- ALSE: closed form and certificate against quadratic programs ---------------------------------


def brute_force(points: Array, weight_set: str) -> float:
    """min ||y P||^2 by trying every support: solve the equality-constrained problem on each.

    Exact for a handful of points; the subsimplex is the simplex with the sample 0 added, that is
    with the last row of `points` (the caller passes -target there).
    """
    P = points if weight_set == "subsimplex" else points[:-1]
    best = np.inf
    for size in range(1, min(len(P), P.shape[1] + 1) + 1):
        for support in itertools.combinations(range(len(P)), size):
            S = P[list(support)]
            K = np.zeros((size + 1, size + 1))  # [2 S S^T, 1; 1^T, 0] (y, lambda) = (0, 1)
            K[:size, :size], K[:size, size], K[size, :size] = 2 * S @ S.T, 1.0, 1.0
            y = np.linalg.lstsq(K, np.eye(size + 1)[-1], rcond=None)[0][:size]
            if y.min() >= -1e-12 and abs(y.sum() - 1) < 1e-9:
                best = min(best, float(np.sum((y @ S) ** 2)))
    return best


def singleton_cases(count: int) -> Iterator[tuple[list[int], Array, Array]]:
    """Vectors with zeros and signs, N = 1..8 draws, targets: exact, off by 30%, wrong signs."""
    rng = np.random.default_rng(3)
    for _ in range(count):
        n = int(rng.integers(1, 6))
        w = rng.normal(size=n) * (rng.random(n) < 0.8)
        if not w.any():
            w[0] = -1.0
        N = int(rng.integers(1, 9))
        indices = rng.choice(n, size=N, p=np.abs(w) / np.abs(w).sum()).tolist()
        for target in (w, w + 0.3 * rng.normal(size=n), w * rng.choice([-1.0, 1.0], size=n)):
            yield indices, w, target


@pytest.mark.parametrize("weight_set", ["simplex", "subsimplex"])
def test_closed_form_solves_the_quadratic_program(weight_set: str) -> None:
    for indices, w, target in singleton_cases(200):
        result = singleton(indices, w, "alse", target, weight_set)
        atoms = twin.sampling.atoms(w)
        points = np.vstack([np.diag(atoms)[np.unique(indices)] - target, -target])
        best, unit = brute_force(points, weight_set), float(np.sum(atoms**2) + np.sum(target**2))
        assert abs(result.error**2 - best) <= 1e-9 * max(best, 1e-3 * unit)
        y = result.weights
        assert y.min() >= 0
        assert y.sum() <= 1 + 1e-13
        assert weight_set == "subsimplex" or y.sum() >= 1 - 1e-13
        # equal samples share equally: the solution of least norm
        for k in set(indices):
            assert np.ptp(y[np.array(indices) == k]) <= 1e-15
        combined = np.zeros_like(w)
        np.add.at(combined, indices, y * atoms[indices])
        assert_allclose(result.estimate, combined, atol=1e-13 * np.abs(w).sum())


def test_closed_form_for_the_exact_target() -> None:
    """Y_k = |w_k|/gamma + delta/|D1|, J = sum_{D2} w_k^2 + (gamma delta)^2/|D1| (Lemma 4.4')."""
    for indices, w, target in singleton_cases(60):
        if target is not w:
            continue
        seen = np.zeros(len(w), dtype=bool)
        seen[indices] = True
        lost = np.abs(w)[~seen].sum()  # gamma * delta
        result = singleton(indices, w, "alse")
        expected = np.where(seen, np.sign(w) * (np.abs(w) + lost / seen.sum()), 0.0)
        assert_allclose(result.estimate, expected, atol=1e-14 * np.abs(w).sum())
        J = np.sum(w[~seen] ** 2) + lost**2 / seen.sum()
        assert_allclose(result.error**2, J, rtol=1e-12, atol=1e-28 * np.sum(w**2))
        sub = singleton(indices, w, "alse", weight_set="subsimplex")
        assert_allclose(sub.error**2, np.sum(w[~seen] ** 2), rtol=1e-12, atol=1e-28 * np.sum(w**2))


def test_weights_are_on_the_simplex_whatever_the_sizes() -> None:
    """Targets far beyond or below the realizations: weights, and a status that is their gap's.

    The gap is recomputed in fractions; weights of sum 1 + d move it by d times what it is made of.
    """
    gen = np.random.default_rng(11)
    for k in range(150):
        d, lines, N = (int(i) for i in gen.integers(1, 4, 3) * (1, 1, 3))
        w = gen.standard_normal((d, lines)) * 10.0 ** gen.choice([0, -100, 100])
        w[:, gen.random(lines) < 0.5] = 0.0
        target = -np.sign(w) * gen.random((d, lines)) * np.abs(w).max()
        target = target * 10.0 ** gen.choice([-160, -20, 0, 20, 40])
        drawn = se.sample(w, N, rng=k)
        given = drawn if k % 2 else se.Ensemble.from_samples(drawn.dense())
        fit = se.fuse(given, "alse", target=target)
        assert np.isfinite(fit.weights).all()
        assert fit.weights.min() >= 0.0
        assert abs(fit.weights.sum() - 1.0) <= 1e-13
        E = [[Fraction(float(v)) for v in one.ravel()] for one in drawn.dense()]
        goal = [Fraction(float(v)) for v in target.ravel()]
        weights = [Fraction(float(v)) for v in fit.weights]
        total = sum(weights)
        left = [
            sum(v * one[i] for v, one in zip(weights, E, strict=True)) / total - goal[i]
            for i in range(len(goal))
        ]
        gradient = [sum(r * e for r, e in zip(left, one, strict=True)) for one in E]
        at = sum(v * g for v, g in zip(weights, gradient, strict=True)) / total
        gap = 2 * (at - min(gradient))
        square = sum(v * v for v in goal)
        square = square or max(sum(e * e for e in one) for one in E)
        largest = max(sum(abs(e) for e in one) for one in E)
        rounding = Fraction(1, 2**45) * largest * sum(abs(r) for r in left)
        if fit.status == "optimal":
            assert gap <= square * Fraction(1, 10**9) + rounding


@pytest.mark.parametrize("weight_set", ["simplex", "subsimplex"])
def test_dense_alse_against_clarabel(weight_set: str) -> None:
    clarabel, sparse = pytest.importorskip("clarabel"), pytest.importorskip("scipy.sparse")
    rng = np.random.default_rng(13)
    for N, d in ((5, 3), (40, 6), (120, 20)):
        samples, target = rng.normal(size=(N, d)), 0.5 * rng.normal(size=d)
        cones = [clarabel.ZeroConeT(1) if weight_set == "simplex" else clarabel.NonnegativeConeT(1)]
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
        solver = clarabel.DefaultSolver(
            sparse.csc_matrix(np.triu(2 * samples @ samples.T)),
            -2 * samples @ target,
            sparse.csc_matrix(np.vstack([np.ones((1, N)), -np.eye(N)])),
            np.concatenate([[1.0], np.zeros(N)]),
            [*cones, clarabel.NonnegativeConeT(N)],
            settings,
        )
        y = np.array(solver.solve().x)
        best = float(np.sum((y @ samples - target) ** 2))
        result = dense(samples, "alse", target, weight_set)
        assert abs(result.error**2 - best) <= 1e-8 * np.sum(target**2)


def test_projections_are_projections() -> None:
    """KKT: p - tau is constant on the support of p and not smaller outside of it."""
    rng = np.random.default_rng(16)
    for _ in range(200):
        tau = rng.normal(size=int(rng.integers(1, 8))) * rng.choice([0.1, 1.0, 10.0])
        p = twin.fusing.project_simplex(tau)
        assert p.min() >= 0
        assert abs(p.sum() - 1) < 1e-14
        shift = (p - tau)[p > 0]
        assert np.ptp(shift) < 1e-14
        assert np.all((p - tau)[p == 0] >= shift[0] - 1e-14)
        q = twin.fusing.project_subsimplex(tau)
        clipped = np.maximum(tau, 0)
        assert_allclose(q, clipped if clipped.sum() <= 1 else p, atol=1e-15)


# --- every p-norm at once -------------------------------------------------------------------------


def least_square(E: list[Exact], goal: Exact) -> Fraction:
    """The least ``|sum w_i E_i - goal|^2`` of the simplex, over the faces on which it is inside."""
    found = []
    for size in range(1, len(E) + 1):
        for *others, last in itertools.combinations(E, size):
            D = [[a - b for a, b in zip(e, last, strict=True)] for e in others]
            r = [a - b for a, b in zip(goal, last, strict=True)]
            rows = [[*(dot(a, b) for b in D), dot(a, r)] for a in D]
            for k in range(len(D)):
                pivot = next((i for i in range(k, len(D)) if rows[i][k]), None)
                if pivot is None:
                    break
                rows[k], rows[pivot] = rows[pivot], rows[k]
                rows[k] = [v / rows[k][k] for v in rows[k]]
                for i in set(range(len(D))) - {k}:
                    factor = rows[i][k]
                    rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
            else:
                w = [row[-1] for row in rows]
                if min([*w, 1 - sum(w)]) >= 0:
                    off = [
                        sum(v * d[j] for v, d in zip(w, D, strict=True)) - r[j]
                        for j in range(len(r))
                    ]
                    found.append(dot(off, off))
    return min(found)


def test_gaps_of_alse_hold_for_targets_of_any_size() -> None:
    """Targets down to 1e-50 of the realizations, in rational numbers; some hulls hold 0."""
    optimal = 0
    for seed in range(150):
        gen = np.random.default_rng([88, seed])
        n, d = int(gen.integers(2, 5)), int(gen.integers(1, 3))
        E = gen.standard_normal((n, d, d)) * 10.0 ** gen.uniform(-3.0, 3.0)
        E -= E.mean(axis=0) * (seed % 3 == 0)
        goal = gen.standard_normal((d, d)) * 10.0 ** -gen.uniform(0.0, 50.0 * (seed % 2))
        fused = se.fuse(se.Ensemble.from_samples(E), "alse", target=goal)
        exact = [[Fraction(v) for v in e.ravel().tolist()] for e in E]
        t, w = (
            [Fraction(v) for v in goal.ravel().tolist()],
            [Fraction(v) for v in fused.weights.tolist()],
        )
        off = [sum(a * e[j] for a, e in zip(w, exact, strict=True)) - t[j] for j in range(len(t))]
        excess = dot(off, off) - least_square(exact, t)
        assert excess <= Fraction(fused.gap)
        optimal += fused.status == "optimal"
        assert fused.status != "optimal" or excess <= dot(t, t) / 10**9
    assert 50 < optimal < 140
