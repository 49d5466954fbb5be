"""Verdicts on reachability, and the rounding in every radius, judged in rational arithmetic."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

import hidden_systems
import stochens_rs as se
from stochens_rs.exceptions import InputError
from stochens_rs.rng import as_key
from stochens_rs.theory.exact import REACHABLE, best_control
from test_exact import (
    best,
    column,
    length,
    minus,
    outside,
    rational,
    reachable_problem,
    times,
    with_condition,
)

EPS = float(np.finfo(float).eps)


def motion(A, B, K):
    """``C_K`` (blocks for u(0), ..., u(K-1)) and ``A^K``, exactly."""
    M, power, blocks = rational(A), rational(np.eye(len(A))), []
    for _ in range(K):
        blocks.insert(0, times(power, rational(B)))
        power = times(power, M)
    return [[x for block in blocks for x in block[i]] for i in range(len(A))], power


def wish(x0, xf, power):
    return minus(column(xf), times(power, column(x0)))


def dot(a, b):
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def least_distance(C, y):
    """``min ||y - C v||`` for any rank, by orthogonalisation of the columns."""
    left, basis = [x for (x,) in y], []
    for one in zip(*C, strict=True):
        new = list(one)
        for q, size in basis:
            share = dot(q, new) / size
            new = [x - share * z for x, z in zip(new, q, strict=True)]
        if size := dot(new, new):
            basis.append((new, size))
            share = dot(new, left) / size
            left = [x - share * z for x, z in zip(left, new, strict=True)]
    return math.sqrt(dot(left, left))


def weakly_coupled(seed, n, m):
    gen = np.random.default_rng(seed)
    A = np.diag(gen.uniform(0.3, 0.7, n)) + 0.02 * gen.standard_normal((n, n))
    return A, np.eye(n)[:, :m], gen.standard_normal(n)


# -- the verdict -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "m", "K", "seeds"), [(10, 1, 8, 5), (20, 1, 15, 30), (30, 2, 12, 30), (300, 15, 10, 1)]
)
def test_no_target_is_called_reachable_that_is_not(n, m, K, seeds):
    """To the origin: .1 to 40 % of the wish are out of reach, and controls are as large as 1e12."""
    for seed in range(seeds):
        A, B, x0 = weakly_coupled(seed, n, m)
        plan = se.control((A, B), x0, np.zeros(n), steps=K)
        found = plan.reachability
        assert found.relative > 1e-3
        assert 0.0 < found.lower <= found.residual * (1.0 + EPS)
        assert found.residual * (1.0 - EPS) <= found.upper < 1.1 * found.residual
        if found.rank == m * K:
            assert (found.verdict, found.size) == ("not reachable", math.inf)
            assert found.upper < (1.0 + 1e-6) * found.lower
            assert "out of reach" in repr(plan)
        else:
            assert found.verdict == "undecided"
            assert found.reachable is None
            assert np.linalg.norm(plan.u) < found.size < math.inf
            assert "undecided whether reachable" in repr(plan)
        if n == 10:
            C, power = motion(A, B, K)
            away = least_distance(C, wish(x0, np.zeros(n), power))
            assert away <= found.upper
            assert found.size < math.inf or found.lower <= away


def test_verdicts_on_hidden_systems_are_true():
    """Every kind, K = 1 to 4, targets at random, within reach, and of a size like rounding."""
    seen = dict.fromkeys(("reachable", "not reachable", "undecided"), 0)
    gen = np.random.default_rng(23)
    for K in (1, 2, 4):
        for system in hidden_systems.of_each_kind(gen, 4, 2):
            A, B = system.A, system.B
            n, m = B.shape
            C, power = motion(A, B, K)
            x0 = gen.standard_normal(n)
            free = np.linalg.matrix_power(A, K) @ x0
            for xf in (
                gen.standard_normal(n),
                se.theory.controllability_matrix((A, B), K) @ gen.standard_normal(m * K) + free,
                free * (1.0 + 1e-15 * gen.standard_normal(n)),
            ):
                made = best_control(A, B, x0, xf, K)
                found = made.reachability()
                y = wish(x0, xf, power)
                away, size = least_distance(C, y), length(y)
                seen[found.verdict] += 1
                assert away <= found.upper, system.kind
                assert found.size < math.inf or found.lower <= away, system.kind
                if found.verdict == "reachable":
                    assert away <= max(REACHABLE * size, made.unsure), system.kind
                elif found.verdict == "not reachable":
                    assert away > 0.9 * REACHABLE * size, system.kind
    assert seen["reachable"] > 60
    assert seen["not reachable"] > 20


def test_the_verdict_is_one_form_everywhere():
    plan = se.control(([[0.5, 0.0], [0.0, 0.5]], [[1.0], [0.0]]), [1.0, 1.0], [0.0, 0.0])
    found = plan.reachability
    assert (found.verdict, found.reachable, found.rank) == ("not reachable", False, 1)
    assert "out of reach 70.7 %" in repr(plan)
    assert "not reachable" in found._repr_html_()
    with pytest.raises(InputError, match="`verdict` must be one of"):
        type(found)(**{**vars(found), "verdict": "perhaps"})


# -- the rounding of controls ----------------------------------------------------------------------


def problems():
    """One step at conditions from 1 to 1e14, and up to 15 steps."""
    for condition in (1.0, 1e3, 1e6, 1e9, 1e12, 1e14):
        for shape in ("square", "tall", "wide"):
            for kind in ("within", "any", "out")[: 3 if shape == "tall" else 2]:
                B, x0, xf, A = reachable_problem(5, shape, condition, kind == "any")
                yield A, B, x0, xf + (10.0 * outside(B) if kind == "out" else 0.0), 1
    for n, m, K in [(4, 1, 4), (4, 2, 3), (3, 1, 8), (5, 1, 3), (3, 1, 15), (2, 1, 15)]:
        gen = np.random.default_rng(n * K)
        A, B = gen.standard_normal((n, n)), gen.standard_normal((n, m))
        yield A / 2.0, B, gen.standard_normal(n), gen.standard_normal(n), K


def test_rounding_is_bounded_sharply():
    """The reported rounding over the true one: never below 1, at most 10 in the median.

    With the a priori bounds of the factors it was 1 290 for the control and 417 for the state.
    """
    control, state, accuracy = [], [], []
    for A, B, x0, xf, K in problems():
        C, power = motion(A, B, K)
        v = best(C, wish(x0, xf, power))
        plan = se.control((A, B), x0, xf, steps=K)
        error = plan.error(se.System(A, B), x0, xf)
        wrong = minus(column(plan.u.ravel()), v)
        control.append(error.control_rounding / length(wrong))
        state.append(error.state_rounding / length(times(C, wrong)))
        accuracy.append(length(wrong) / np.linalg.norm(plan.u))
    assert min(control) >= 1.0
    assert min(state) >= 1.0
    assert np.median(control) <= 2.0
    assert np.median(state) <= 10.0
    # all but the large residuals at the largest conditions, whose effect is squared
    assert np.quantile(accuracy, 0.9) <= EPS


# -- the rounding in every radius ------------------------------------------------------------------


def lone(condition, seed):
    """A problem whose realizations are all equal, as their laws have one entry per line."""
    gen = np.random.default_rng(seed)
    n = 4
    m = (2, 3, 4)[seed % 3]
    B = with_condition(gen, n, m, condition)
    x0, xf = np.zeros(n), np.zeros(n)
    x0[seed % n], xf[(seed + 1) % n] = gen.standard_normal(2)
    return np.diag(gen.uniform(0.5, 1.5, n)), B, x0, xf


def by_ensembles(scheme="iid", axis="columns", fusion="product", steps=1, delta=0.05):
    """A plan of realizations: the simulated bound, or by formulas for a small delta."""

    def made(A, B, x0, xf):
        key, N = as_key(1), 20
        drawn = (
            se.sample(x0, N, rng=key.child("x0"), scheme=scheme),
            se.sample(xf, N, rng=key.child("xf"), scheme=scheme),
        )
        matrix = se.sample(A, N, rng=key.child("A"), scheme=scheme, axis=axis)
        plan = se.control((matrix, B), *drawn, steps=steps, fusion=fusion)
        bound = plan.bound(delta)
        assert (bound["state"].method == "simulated") == (delta > 1e-6)
        return plan.u, bound.state, bound.control, bound.target

    return made


def by_exact(steps=1):
    def made(A, B, x0, xf):
        plan = se.control((A, B), x0, xf, steps=steps)
        bound = plan.bound()
        assert bound["state"].method == "exact error"
        return plan.u, bound.state, bound.control, bound.target

    return made


def by_fits(A, B, x0, xf):
    fits = (se.fuse(se.sample(v, 20, rng=k), "alse", target=v) for k, v in enumerate((x0, xf, A)))
    start, goal, matrix = fits
    plan = se.control((matrix, B), start, goal)
    bound = plan.bound()
    assert "targets of the fits" in bound.assumption
    return plan.u, bound.state, bound.control, bound.target


def within_limits(drawn):
    """Limits that no control meets, and no weight of the inputs."""

    def made(A, B, x0, xf):
        data = (se.sample(v, 20, rng=k) if drawn else v for k, v in enumerate((x0, xf, A)))
        start, goal, matrix = data
        plan = se.control((matrix, B), start, goal, limits=(-1e30, 1e30), cost=se.Cost(R=0.0))
        bound = plan.bound()
        assert bound["state"].method == (
            "limits: firm nonexpansiveness" if drawn else "exact error"
        )
        return plan.u, bound.state, math.inf, bound.target

    return made


def by_means(A, B, x0, xf):
    stream = se.DataStream(B, ranges={"x0": 0.0, "xf": 0.0, "A": 0.0})
    stream.update(x0=x0, xf=xf, A=A)
    found = stream.confidence()
    assert found.kind == "guaranteed"
    return stream.u[None, :], found.state, math.inf, math.inf


def by_targets(A, B, x0, xf):
    stream = se.DataStream(B, x0=x0, xf=xf, A=A)
    stream.update(x0=x0, xf=xf, A=A)
    assert stream.error <= stream.certificate
    return stream.u[None, :], stream.certificate, math.inf, math.inf


def by_stream(A, B, x0, xf):
    stream = se.Stream((A, B), x0, xf, rng=1)
    run = stream.run(max_steps=50, tol=1e-300)
    assert run.error <= run.certificate == stream.certificate
    return stream.u[None, :], run.certificate, math.inf, math.inf


ROUTES = {
    "exact": by_exact(),
    "exact, 3 steps": by_exact(3),
    "simulated": by_ensembles(),
    "simulated, rows": by_ensembles(axis="rows"),
    "simulated, systematic": by_ensembles(scheme="systematic"),
    "simulated, diagonal": by_ensembles(fusion="diagonal"),
    "simulated, 3 steps": by_ensembles(steps=3),
    "formulas": by_ensembles(delta=1e-9),
    "formulas, rows": by_ensembles(axis="rows", delta=1e-9),
    "formulas, systematic": by_ensembles(scheme="systematic", delta=1e-9),
    "formulas, diagonal": by_ensembles(fusion="diagonal", delta=1e-9),
    "formulas, 3 steps": by_ensembles(steps=3, delta=1e-9),
    "fits": by_fits,
    "limits, exact": within_limits(drawn=False),
    "limits, drawn": within_limits(drawn=True),
    "DataStream.confidence": by_means,
    "DataStream.certificate": by_targets,
    "Stream.run": by_stream,
}


@pytest.mark.parametrize("route", ROUTES)
def test_every_radius_has_the_rounding_of_the_control(route):
    """Nothing but rounding is wrong, and every radius covers it, at conditions from 1 to 1e14."""
    covered = 0
    for condition in (1.0, 1e4, 1e8, 1e10, 1e12, 1e14):
        for seed in range(3):
            A, B, x0, xf = lone(condition, seed)
            u, state, control, target = ROUTES[route](A, B, x0, xf)
            C, power = motion(A, B, len(u))
            v = best(C, wish(x0, xf, power))
            wrong = minus(column(u.ravel()), v)
            off = length(times(C, wrong))
            assert off <= state, (condition, seed)
            assert length(wrong) <= control, (condition, seed)
            end = minus(wish(x0, xf, power), times(C, column(u.ravel())))
            assert length(end) <= target, (condition, seed)
            # the mutant: a radius without the rounding of u is 0 here but for rounding of its own
            covered += off > 1e-17
    assert covered > 9
