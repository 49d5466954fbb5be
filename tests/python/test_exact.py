"""Best controls of ill-conditioned problems, compared with rational arithmetic."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest

import stochens_rs as se
from coverage_study import sets
from stochens_rs.theory.exact import best_control, factors

CONDITIONS = (1e2, 1e6, 1e10, 1e12, 1e14)
SHAPES = {"square": (6, 6), "tall": (8, 5), "wide": (5, 8)}


# -- rational arithmetic --------------------------------------------------------------------------


def rational(values):
    return [[Fraction(float(x)) for x in row] for row in np.atleast_2d(values)]


def times(M, N):
    columns = list(zip(*N, strict=True))
    return [[sum(a * b for a, b in zip(row, c, strict=True)) for c in columns] for row in M]


def minus(M, N):
    return [[a - b for a, b in zip(r, s, strict=True)] for r, s in zip(M, N, strict=True)]


def transposed(M):
    return [list(column) for column in zip(*M, strict=True)]


def column(values):
    return transposed(rational(values))


def solved(M, y):
    """``M^-1 y`` by elimination."""
    n = len(M)
    rows = [[*row, *right] for row, right in zip(M, y, strict=True)]
    for i in range(n):
        pivot = next(k for k in range(i, n) if rows[k][i])
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for k in (k for k in range(n) if k != i and rows[k][i]):
            factor = rows[k][i] / rows[i][i]
            rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    return [[rows[i][n] / rows[i][i]] for i in range(n)]


def best(B, y):
    """``B^+ y`` for full rank."""
    T = transposed(B)
    if len(B) >= len(T):
        return solved(times(T, B), times(T, y))
    return times(T, solved(times(B, T), y))


def length(v):
    return math.sqrt(sum(x * x for (x,) in v))


# -- problems -------------------------------------------------------------------------------------


def with_condition(gen, n, m, condition):
    k = min(n, m)
    U = np.linalg.qr(gen.standard_normal((n, n)))[0][:, :k]
    V = np.linalg.qr(gen.standard_normal((m, m)))[0][:, :k]
    return U @ np.diag(np.logspace(0.0, -math.log10(condition), k)) @ V.T


def reachable_problem(seed, shape, condition, generic):
    """B, x0, xf, A with xf exactly reachable: by a control of size 1, or any target.

    The tall B repeats its rows times powers of 2, and so do its targets, which is exact.
    """
    gen = np.random.default_rng(seed)
    n, m = SHAPES[shape]
    A, x0 = gen.integers(-3, 4, (n, n)).astype(float), gen.integers(-3, 4, n).astype(float)
    B = with_condition(gen, min(n, m), m, condition)
    y = gen.standard_normal(len(B)) if generic else B @ gen.standard_normal(m)
    if n > m:
        again = 2.0 ** gen.integers(-2, 3, n - m)
        B, y = np.vstack([B, B[: n - m] * again[:, None]]), np.append(y, y[: n - m] * again)
        x0[:] = 0.0
    return B, x0, A @ x0 + y, A


def outside(B):
    """A vector orthogonal to the range of the tall B, whose row 5 is a multiple of row 0."""
    d = np.zeros(len(B))
    d[5], d[0] = 1.0, -B[5, 0] / B[0, 0]
    return d


# -- the factors ----------------------------------------------------------------------------------


def test_the_factors_are_as_near_as_the_allowances_assume():
    """Exactly multiplied, 300 matrices, every other one badly scaled."""
    nearness = []
    for seed in range(300):
        gen = np.random.default_rng(seed)
        n, m = gen.integers(1, 7, 2)
        B = gen.standard_normal((n, m)) * 10.0 ** gen.uniform(-8, 8, (n if seed % 2 else 1, m))
        found = factors(B)
        exact = times(times(rational(found.U), rational(np.diag(found.s))), rational(found.V.T))
        E = np.array([[float(x) for x in row] for row in minus(rational(B), exact)])
        nearness.append(np.linalg.norm(E, 2) / found.off)
    assert 0.1 < max(nearness) < 1.0


# -- what is within reach -------------------------------------------------------------------------


@pytest.mark.parametrize("tiny", [1e-3, 1e-8, 1e-11, 1e-13, 1e-16, 1e-20])
def test_a_small_wish_is_not_lost_in_the_free_motion(gen, tiny):
    """The ratio is the true one where ``xf - A x0`` exceeds the rounding of ``A x0``; else said."""
    A, x0 = gen.integers(-9, 9, (6, 6)).astype(float), gen.integers(-9, 9, 6).astype(float)
    B = np.eye(6)[:, :2]
    d = tiny * np.array([3.0, 0.0, 4.0, 0.0, 0.0, 0.0]) * np.linalg.norm(A @ x0)
    for steps in (None, 1):
        if steps is None:
            plan = se.control((A, B), x0, A @ x0 + d)
        else:
            plan = se.control((A, B), x0, A @ x0 + d, steps=steps)
        found = plan.reachability
        if tiny > 1e-14:
            assert found.relative == pytest.approx(0.8, rel=1e-3)
            assert found.verdict == "not reachable"
        else:
            assert found.upper < 1e-12 * np.linalg.norm(A) * np.linalg.norm(x0)
            assert found.verdict == "reachable"
            if found.relative:
                assert "reachable up to rounding" in repr(plan)


# -- what a control is off by ---------------------------------------------------------------------


def check(error, B, wish, u):
    """Compare an error with the exact one for the control u; return the exact one."""
    v = best(B, wish)
    wrong = minus(column(u), v)
    control, state = length(wrong), length(times(B, wrong))
    residual = length(minus(wish, times(B, v)))
    assert abs(error.control - control) <= error.control_rounding
    assert abs(error.state - state) <= error.state_rounding
    assert abs(error.residual - residual) <= error.state_rounding
    return control, length(v), length(wish)


@pytest.mark.parametrize(
    ("shape", "kind"), [*itertools.product(SHAPES, ["within", "any"]), ("tall", "out")]
)
@pytest.mark.parametrize("condition", CONDITIONS)
def test_errors_hold_within_their_rounding(condition, shape, kind):
    """For the control of the plan itself, whose error comes out as 0, and for a wrong one."""
    largest = 0.0
    for seed in range(sets(8, 4)):
        gen = np.random.default_rng(seed)
        B, x0, xf, A = reachable_problem(seed, shape, condition, kind == "any")
        if kind == "out":
            xf = xf + 10.0 * outside(B)
        system, exact = se.System(A, B), rational(B)
        wish = minus(column(xf), times(rational(A), column(x0)))
        plan = se.control((A, B), x0, xf)
        error = plan.error(system, x0, xf)
        assert error.control == 0.0
        v = plan.u[0]
        true, size, wanted = check(error, exact, wish, v)
        largest = max(largest, true / size)
        u = v + 1e-3 * np.linalg.norm(v) * gen.standard_normal(len(v))
        other = best_control(A, B, x0, xf).error(u, x0)
        check(other, exact, wish, u)
        assert wanted > 0.0
    if kind != "out":  # a large residual acts with the square of the condition
        assert largest < np.finfo(float).eps


def test_a_relative_error_names_what_it_is_relative_to():
    """At the origin, and for a zero control, errors are relative to another quantity."""
    gen = np.random.default_rng(5)
    A, B, x0 = gen.standard_normal((4, 4)), gen.standard_normal((4, 4)), gen.standard_normal(4)
    system = se.System(A, B)
    for steps in (1, 3):
        error = se.steer(system, x0, np.zeros(4), 50, steps=steps, rng=1).error(
            system, x0, np.zeros(4)
        )
        assert (error.control_relative_to, error.state_relative_to) == ("v", "x0")
        assert error.state_relative == pytest.approx(error.state / np.linalg.norm(x0), rel=1e-12)
    # nothing to do: v = 0, up to rounding
    stay = A @ x0
    error = se.steer(system, x0, stay, 50, rng=1).error(system, x0, stay)
    assert (error.control_relative_to, error.state_relative_to) == ("B^+ A x0", "x_actual")
    free = np.linalg.norm(np.linalg.solve(B, stay))
    assert error.control_relative == pytest.approx(error.control / free, rel=1e-9)
    # nothing at all
    plan = se.steer(system, np.zeros(4), stay, 50, rng=1)
    error = plan.error(system, np.zeros(4), np.zeros(4))
    assert (error.control_relative_to, error.state_relative_to) == ("nothing", "nothing")
    assert error.control_relative == error.state_relative == math.inf
    plan = se.control((A, B), np.zeros(4), np.zeros(4))
    assert plan.error(system, np.zeros(4), np.zeros(4)).control_relative == 0.0


# -- what a plan says -----------------------------------------------------------------------------


def test_an_error_beside_almost_nothing_is_not_printed_as_a_share():
    system, x0, xf = se.System([[1.0]], [[1.0]]), [1.0], [1e-7]
    far = se.control(([[1.5]], [[1.0]]), x0, xf).error(system, x0, xf)
    assert far.state_relative == pytest.approx(5e6, rel=1e-3)
    near = se.control(([[1.5]], [[1.0]]), x0, [0.5]).error(system, x0, [0.5])
    assert "state_relative" not in repr(far)
    assert "state_relative=1.0, " in repr(near)
    assert "control_relative=" in repr(far)
