"""Bounds of controls within limits: the package against its twin, coverage, and what fails.

Coverage: seeds are fixed; a bound fails if it is exceeded in more than ``delta R`` of R replicates
plus 4 standard errors, as in test_bounds_coverage, whose systems and draws these are.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from hidden_systems import of_each_kind
from limit_plans import within
from limit_problems import draws, weight
from stochens_rs.certificates.of_model import ModelBasis, Question
from stochens_rs.controls import bounds as limit_bound
from stochens_rs.controls.bounds import FIRM, limited_bound, limited_certificate
from stochens_rs.limits import problem as limited_errors
from stochens_rs.limits.problem import Horizon, checked_task
from stochens_rs.theory.exact import states
from test_bounds_coverage import matrices, systems, vectors
from twin import limit_bounds as lb
from twin import limited_control as lc
from twin import limited_problems as lp

ONCE = 1.0 + 1e-9


class Planned:
    """A control within limits for the estimates of a plan."""

    def __init__(self, A, B, x0, xf, K=1, *, fusion="product", **limits):
        self.plan = se.control((A, B), x0, xf, steps=K, fusion=fusion)
        basis = self.basis = self.plan.basis
        n, m = basis.B.shape
        goal = basis.xf.estimate
        self.task = checked_task(n, m, K, goal, **within(**limits))
        matrix = basis.A.estimate
        start = self.plan.predicted_states[0]
        self.limited = Horizon(self.task, matrix, basis.B).solve(start)
        self.predicted = states(matrix, basis.B, start, self.limited.u)

    def bound(self, delta=0.1, fusion="product"):
        return limited_bound(self.basis, self.limited, self.predicted, delta, fusion)


def drawn(name, N, K, **limits):
    """A plan from N realizations of each entity of a system, and the system."""
    A, B, x0, xf = systems()[name]
    some = (se.sample(v, N, rng=i) for i, v in enumerate((A, x0, xf)))
    A_hat, start, goal = some
    return Planned(A_hat, B, start, goal, K, **limits), (A, B, x0, xf)


def errors_of(gen, system, task, N, K, count):
    """State, control and excess of the limited controls of new draws, and which of R they used."""
    A, B, x0, xf = system
    found = []
    moved = matrices(gen, A, N, count)
    for A_hat, start, goal in zip(
        moved, vectors(gen, x0, N, count), vectors(gen, xf, N, count), strict=True
    ):
        wanted = replace(task, reference=np.tile(goal, (K, 1)))
        limited = Horizon(wanted, A_hat, B).solve(start)
        exact = Horizon(replace(task, reference=np.tile(xf, (K, 1)), R=limited.R), A, B)
        best = exact.solve(x0)
        M = exact.core.weighted()[0]
        wrong = (limited.u - best.u).ravel()
        at = [exact.objective(x0, u) for u in (limited.u, best.u)]
        found.append(
            (np.linalg.norm(M @ wrong), np.linalg.norm(wrong), at[0] - at[1] - 1e-9 * at[0])
        )
    return np.array(found).T


def onto(M):
    """``U'`` for an orthonormal basis U of the range of M."""
    U, s, _ = np.linalg.svd(M, full_matrices=False)
    return U[:, s > max(M.shape) * np.finfo(float).eps * s.max(initial=0.0)].T


# -- the map is exact ------------------------------------------------------------------------------


def test_for_one_step_and_Q_1_the_simulated_radius_is_that_without_limits():
    for name in ("Gaussian", "sparse", "random walk"):
        planned, _ = drawn(name, 100, 1, limits=(-0.1, 0.1))
        old, new = planned.plan.bound(0.1), planned.bound()
        np.testing.assert_allclose(new.state, old.state, rtol=1e-7)
        assert new["state"].method == FIRM
        assert (new.kind, new["target"].distance_from) == ("guaranteed", "xf")
        assert planned.limited.distance < 1e-6 * new.state
        assert new.excess == pytest.approx(new.state**2, rel=1e-6)
        assert new.target >= new.state


def test_a_small_weight_beside_a_huge_entry_is_not_lost():
    """``||L|| d`` for ``L = (B'B + R)^-1 B'`` in rationals, where no limit comes into play."""
    A, B, R = 0.5 * np.eye(2), np.array([[1e10, 1.0], [0.0, 1.0]]), 0.1
    x0 = se.sample([1.0, -2.0], 10_000, rng=1)
    target = 0.5 * x0.mean() + [1.0, 0.0]  # the second input is not needed
    plan = se.control((A, B), x0, target, limits=(-9, 9), cost=se.Cost(R=R))
    bound, solver = plan.bound(), plan.limited.distance
    exact = [[Fraction(value) for value in row] for row in B.tolist()]
    (a, b), (c, d) = (
        [sum(exact[k][i] * exact[k][j] for k in range(2)) + (i == j) * Fraction(R) for j in (0, 1)]
        for i in (0, 1)
    )
    det = a * d - b * c
    inverse = [[d / det, -b / det], [-c / det, a / det]]
    L = [[sum(inverse[i][k] * exact[j][k] for k in (0, 1)) for j in (0, 1)] for i in (0, 1)]
    gain = np.linalg.norm(np.array(L, dtype=float), 2)
    assert gain > 0.6  # with R lost it is 0
    moved = bound.state - solver
    assert gain * moved <= bound.control <= 1.1 * gain * moved + 2.0 * solver / R


def test_the_projection_is_that_of_the_twin(gen):
    for p in draws(gen, 200):
        db = gen.normal(size=len(p.b))
        half = lp.root(p.Q)
        found = np.linalg.norm(onto(half @ p.G) @ (half @ db))
        np.testing.assert_allclose(found, lb.projected(p, db), rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("K", [1, 2])
def test_a_moved_target_by_draws_of_the_twin(K):
    """MovedTarget: quantiles of 4000 draws against those of the formula for other draws, Q > 0."""
    gen, N, count = np.random.default_rng(1), 20, 4000
    A, B, x0, xf = systems()["Gaussian"]
    n = len(A)
    Q = weight(gen, n)
    soft = {"state_limits": (-1.0, np.inf), "soft": 2.0}
    for more in ({}, soft):
        first = se.sample(A, N, rng=5) if K == 1 else A
        plan = se.control((first, B), se.sample(x0, N, rng=1), se.sample(xf, N, rng=2), steps=K)
        task = checked_task(n, B.shape[1], K, xf, **within(**more, limits=(-1, 1), Q=Q, R=1.0))
        exact = Horizon(task, A, B)
        errors = limited_errors.MovedTarget(
            limit_bound.plan_errors(plan.basis, K, "product"), exact
        )
        found = errors.draw(count, se.rng.as_key(3))[:, 0]
        dx0, dxf = vectors(gen, x0, N, count) - x0, vectors(gen, xf, N, count) - xf
        powers = [np.linalg.matrix_power(A, k) for k in range(1, K + 1)]
        dc = [dx0 @ P.T for P in powers]
        if K == 1:
            moved = np.einsum("rij,rj->ri", matrices(gen, A, N, count), dx0 + x0)
            dc = [moved - A @ x0]
        if more:
            W = Q + 2.0 * np.eye(n)
            wanted = np.sqrt(sum(np.einsum("ri,ij,rj->r", c, W, c) for c in dc))
            wanted = wanted + np.sqrt(K * np.einsum("ri,ij,rj->r", dxf, Q, dxf))
        else:
            p = lp.several_steps(A, B, x0, np.tile(xf, (K, 1)), K, Q=Q, R=1.0)
            wanted = [
                lb.projected(p, np.concatenate([f - c for c in cs]))
                for f, *cs in zip(dxf, *dc, strict=True)
            ]
        for level in (0.5, 0.9, 0.99):
            np.testing.assert_allclose(
                np.quantile(found, level), np.quantile(wanted, level), rtol=0.06
            )


LIMITS = [
    pytest.param({"R": "auto"}, id="R auto"),
    pytest.param({"R": 0.0}, id="R 0"),
    pytest.param({"R": 10.0}, id="R large"),
]


# -- a model from data -----------------------------------------------------------------------------


def measured(gen, A, B, count, noise):
    n, m = B.shape
    x, u = gen.normal(size=(count, n)), gen.normal(size=(count, m))
    later = x @ A.T + u @ B.T + noise * gen.normal(size=(count, n))
    return se.identify(
        se.Trajectories.from_pairs(x, u, later), checks=False, noise=se.Noise(design="independent")
    )


def certified(model, x0, xf, K, delta=0.1, x0_error=0.0, noise=False, **limits):
    n, m = model.B.shape
    task = checked_task(n, m, K, xf, **within(**limits))
    basis = ModelBasis(model, x0, xf, x0_error)
    limited = Horizon(task, model.A, model.B, model.c).solve(x0)
    predicted = states(model.A, model.B, x0, limited.u)
    question = Question(basis, limited.u, predicted, delta, noise)
    return limited, limited_certificate(question, limited), predicted


@pytest.mark.parametrize("K", [1, 3])
def test_alpha_and_gamma_are_those_of_the_twin(K):
    gen = np.random.default_rng(3)
    for _ in range(20):
        n, m = int(gen.integers(1, 4)), int(gen.integers(1, 3))
        A, B, x0, xf = gen.normal(size=(n, n)), gen.normal(size=(n, m)), *gen.normal(size=(2, n))
        model = measured(gen, 0.5 * A, B, 60, 0.1)
        R = 10.0 ** gen.uniform(-1, 1)
        Q = np.eye(n) if K > 1 else weight(gen, n)
        limited, found, predicted = certified(model, x0, xf, K, limits=(-0.5, 0.5), Q=Q, R=R)
        question = Question(ModelBasis(model, x0, xf), limited.u, predicted, 0.1)
        region = limit_bound.step_regions(question)[0][0]
        part = region.parts[0]
        S = part.factor * part.S
        alpha = np.sqrt(np.sum(found.tube[1:] ** 2))
        if K == 1:
            half = lp.root(Q)
            size = part.length(np.concatenate([x0, limited.u[0]]))
            alpha = size * np.sqrt(np.linalg.norm(half @ S @ half, 2))
        p, squares, delta = np.zeros(n), 0.0, 0.0
        a, b = (np.linalg.norm(part.white[:, c], 2) for c in (slice(n), slice(n, n + m)))
        for k in range(K, 0, -1):
            p = model.A.T @ p + Q @ (predicted[k] - xf)
            eta = np.sqrt(p @ S @ p)
            top = np.sqrt(np.linalg.norm(S, 2))
            squares += ((np.linalg.norm(model.B, 2) + top * b) * delta + eta * b) ** 2
            delta = (np.linalg.norm(model.A, 2) + top * a) * delta + eta * a
        gap = max(
            lc.box_gap(
                2 * half_slope(model, limited, predicted, Q, R), limited.u.ravel(), -0.5, 0.5
            ),
            0,
        )
        wanted = lb.uncertain_map(alpha, np.sqrt(squares / R), gap)
        assert found["states"].radius <= wanted.state * ONCE
        assert found.excess <= wanted.value * ONCE
        assert found.control <= wanted.input / np.sqrt(R) * ONCE
        # and it is one of the two
        p_ = lp.several_steps(model.A, model.B, x0, np.tile(xf, (K, 1)), K, Q=Q, R=R)
        radii = region.core.spread(0, n), region.core.spread(n, n + m)
        radius = Horizon(limited.task, model.A, model.B).core.map_radius(radii)
        small = lb.uncertain_map_small_weight(p_, alpha, np.sqrt(squares), radius, gap)
        np.testing.assert_allclose(found["states"].radius, min(wanted.state, small), rtol=1e-6)


def half_slope(model, limited, predicted, Q, R):
    n = len(Q)
    p = lp.several_steps(
        model.A, model.B, predicted[0], limited.task.reference, len(limited.u), Q=Q, R=R
    )
    assert p.Q.shape[0] == n * len(limited.u)
    return p.G.T @ p.Q @ (p.G @ limited.u.ravel() - p.b) + R * limited.u.ravel()


MODELS = {
    "plain": (3, 2, {}),
    "wide": (2, 3, {}),
    "zero column": (3, 2, {}),
    "ill-conditioned": (3, 2, {}),
}


def true_system(gen, name):
    n, m, _ = MODELS[name]
    A, B = gen.normal(size=(n, n)), gen.normal(size=(n, m))
    if name == "zero column":
        B[:, 1] = 0.0
    if name == "ill-conditioned":
        B *= np.array([1.0, 1e-3])
    return 0.8 * A / np.abs(np.linalg.eigvals(A)).max(), B, *gen.normal(size=(2, n))


@pytest.mark.parametrize("more", LIMITS)
@pytest.mark.parametrize("K", [1, 3])
@pytest.mark.parametrize("name", MODELS)
def test_coverage_of_certificates(name, K, more):
    """60 data sets, in `make test` 15, of 4 systems, 2 horizons, 3 weights; delta = 0.3."""
    gen, delta, count = np.random.default_rng(11), 0.3, sets(60, 15)
    A, B, x0, xf = true_system(gen, name)
    wrong = np.zeros(4)
    for i in range(count):
        off = 0.05 * (i % 2)
        e = gen.normal(size=len(x0))
        start = x0 + off * e / np.linalg.norm(e)
        limited, found, _ = certified(
            measured(gen, A, B, 60, 0.1),
            start,
            xf,
            K,
            delta,
            off,
            limits=(-0.3, 0.3),
            Q=1.0,
            **more,
        )
        exact = Horizon(replace(limited.task, R=limited.R), A, B)
        best = exact.solve(x0)
        at = [states(A, B, x0, u) for u in (limited.u, best.u)]
        J = [exact.objective(x0, u) for u in (limited.u, best.u)]
        seen = (
            np.linalg.norm(at[0] - at[1]) > found["states"].radius + best.distance,
            np.linalg.norm(limited.u - best.u) > found.control + 1e-9,
            J[0] - J[1] > found.excess + best.gap + 1e-9 * J[0],
            np.linalg.norm(at[0][-1] - xf) > found.target,
        )
        wrong += seen
        assert np.isfinite(found.excess)
        assert np.isfinite(found.control) == (found["control"].reason is None)
    assert wrong.max() <= delta * count + 4.0 * np.sqrt(delta * (1 - delta) * count), wrong


def test_the_control_is_at_most_what_the_limits_allow():
    """Each hidden kind, 12 steps, few pairs: never above the farthest corner, and it says which."""
    gen, methods = np.random.default_rng(19), []
    for one in of_each_kind(gen, 3, 2, without=("mixed_state_units", "one_huge_entry", "graded")):
        n, m = one.B.shape
        x0, xf = gen.normal(size=(2, n))
        model = measured(gen, one.A, one.B, 25 + 2 * m, 0.3)
        for more in ({"R": 1e-3}, {"R": 1e-3, "state_limits": (-50.0, 50.0), "soft": False}):
            limited, found, _ = certified(model, x0, xf, 12, limits=(-1.0, 0.5), Q=1.0, **more)
            corner = np.where(limited.u > -0.25, -1.0, 0.5)
            farthest = np.linalg.norm(limited.u - corner)
            assert found.control <= farthest * ONCE <= np.sqrt(12 * m) * 1.5 * ONCE**2
            assert found["control"].reason is None
            assert (found["control"].method == limit_bound.ALONE) == (
                found.control == pytest.approx(farthest)
            )
            task = replace(limited.task, R=limited.R, state_low=None, state_high=None)
            best = Horizon(task, one.A, one.B).solve(x0)
            assert np.linalg.norm(limited.u - best.u) <= farthest * ONCE
            methods.append(found["control"].method)
    assert limit_bound.ALONE in methods
    # without limits of the inputs there is no corner
    free = certified(model, x0, xf, 12, limits=(-np.inf, np.inf), Q=1.0, R=1e-3)[1]
    assert free["control"].method != limit_bound.ALONE
