"""`gain` against Newton in long arithmetic; in any units; and what is said where there is none."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np
import pytest
import scipy.linalg

import stochens_rs as se
from hidden_systems import KINDS, RIG, drawn
from stochens_rs.exceptions import DataWarning, InputError, SolverError

CART = RIG[:, :4], RIG[:, 4:]
MOVES = "the inputs do not move the mode of A with the eigenvalue "
WEIGHS = "Q gives no weight to the mode with the eigenvalue "
INTEGRATORS = np.eye(4) + 0.01 * np.eye(4, k=1), 0.01 * np.eye(4)[:, -1:]


def in_long_arithmetic(A, B, Q, R, K):
    """The least cost and its gain, by the steps of Newton and Kleinman with 50 digits from K."""
    with localcontext() as context:
        context.prec = 50
        context.Emin, context.Emax = -999999, 999999
        A, B, Q, R, K = (np.vectorize(Decimal, otypes=[object])(one) for one in (A, B, Q, R, K))
        for _ in range(12):
            F, P = A + B @ K, Q + K.T @ R @ K
            while max(map(abs, F.flat)) > Decimal("1e-40"):
                assert max(map(abs, F.flat)) < Decimal("1e60"), "no gain that stabilises"
                P, F = P + F.T @ P @ F, F @ F
            left, right = R + B.T @ P @ B, -(B.T @ P @ A)
            for i in range(len(left)):  # elimination; left is positive definite
                for j in range(i + 1, len(left)):
                    by = left[j, i] / left[i, i]
                    left[j], right[j] = left[j] - by * left[i], right[j] - by * right[i]
            K = np.array(right)
            for i in reversed(range(len(left))):
                K[i] = (right[i] - left[i, i + 1 :] @ K[i + 1 :]) / left[i, i]
        return K.astype(float), P.astype(float)


def in_units(A, B, Q, R, x, u):
    """The same problem for states ``x_old = diag(x) x_new`` and inputs in units u."""
    A, B = A / x[:, None] * x, B / x[:, None] * u
    return A, B, Q * x[:, None] * x, R * u[:, None] * u


@pytest.mark.parametrize(
    ("system", "Q", "R"),
    [
        (CART, np.eye(4), 1.0),
        (CART, np.eye(4), 1e-14),  # the doubling alone: 3e-3
        (CART, np.diag([1.0, 0, 0, 0]), 1e-14),  # the doubling alone: refused
        (in_units(*CART, np.eye(4), np.eye(1), 10.0 ** np.array([-7.5, 0, 0, 0]), np.ones(1))[:2],
         np.eye(4), 1.0),
        (INTEGRATORS, np.eye(4), 1.0),
        (([[1, 1e9], [0, 0.9]], [[0], [1e-6]]), np.diag([1e-12, 1.0]), 1e6),
        (([[0.5, 0], [0, 1.0]], [[1.0], [1.0]]), np.diag([1, 1e-16]), 1.0),
        (([[1.5, 0.1], [0, 0.9]], [[1.0], [0]]), np.zeros((2, 2)), 1.0),
    ],
)  # fmt: skip
def test_all_digits_that_long_arithmetic_gives(system, Q, R):
    A, B = (np.asarray(one, dtype=float) for one in system)
    loop = se.gain((A, B), Q, R)
    K, S = in_long_arithmetic(A, B, Q, R * np.eye(B.shape[1]), loop.K)
    np.testing.assert_allclose(loop.K, K, rtol=0, atol=5e-12 * np.abs(K).max())
    np.testing.assert_allclose(loop.S, S, rtol=0, atol=5e-12 * np.abs(S).max())
    assert np.abs(loop.E).max() < 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_the_units_do_not_count(kind):
    """K, S and E of hidden systems in units of 1e-8 to 1e8; the weights are in the same units."""
    gen = np.random.default_rng(list(KINDS).index(kind))
    for _ in range(3):
        _, A, B = drawn(kind, gen)
        n, m = B.shape
        root = gen.standard_normal((n, n))
        task = A, B, root @ root.T, 0.1 * np.eye(m)
        x, u = 10.0 ** gen.uniform(-8, 8, n), 10.0 ** gen.uniform(-8, 8, m)
        other = in_units(*task, x, u)
        try:
            plain = se.gain(task[:2], *task[2:])
        except SolverError as error:
            with pytest.raises(SolverError, match=re_of(error)):
                se.gain(other[:2], *other[2:])
            continue
        loop = se.gain(other[:2], *other[2:])
        K, S = loop.K * u[:, None] / x, loop.S / x[:, None] / x
        np.testing.assert_allclose(K, plain.K, rtol=0, atol=1e-9 * np.abs(plain.K).max())
        np.testing.assert_allclose(S, plain.S, rtol=0, atol=1e-9 * np.abs(plain.S).max())
        assert np.isfinite(S).all()
        assert np.abs(loop.E).max() == pytest.approx(np.abs(plain.E).max(), rel=1e-6, abs=1e-9)


def re_of(error):
    """The cause, without its numbers."""
    return str(error).split(":")[1][:30]


def test_eigenvalues_are_those_of_balanced_matrices():
    """A cart in units of 1e-7 m: .9575 for .8750 without balancing."""
    gen = np.random.default_rng(4)
    for kind in KINDS:
        _, A, B = drawn(kind, gen)
        x = 10.0 ** gen.uniform(-8, 8, len(A))
        A = A / x[:, None] * x
        K = np.zeros(B.T.shape)
        found = se.feedback.Loop(A, B, K, None, "least squares", None, se.System(A, B).labels).E
        own = scipy.linalg.eigvals(scipy.linalg.matrix_balance(A)[0])
        for value in found:  # in any order; defective ones are less accurate
            assert np.abs(own - value).min() <= 1e-6 * np.abs(own).max() + 1e-300, kind


@pytest.mark.parametrize("units", [1.0, 1e7])
@pytest.mark.parametrize(
    ("A", "B", "Q", "cause"),
    [
        ([[0.5, 0], [0, 1.1]], [1, 0], 1.0, MOVES + "1.1, largest in speed"),
        ([[0.5, 1], [0, 1]], [1, 0], 1.0, MOVES + "1, largest in speed"),
        (np.eye(2), [0, 0], 1.0, MOVES + "1,"),
        ([[1, 0], [0, 0.9]], [1, 1], [0, 1], WEIGHS + "1, largest in angle"),
        ([[0.8, 0.6], [-0.6, 0.8]], [1, 1], [0, 0], WEIGHS + r"0.8 \+- 0.600000i"),
    ],
)  # fmt: skip
def test_a_mode_without_a_gain_is_named_with_its_cause(A, B, Q, cause, units):
    x = np.array([1.0, units])
    A, B = np.array(A) / x[:, None] * x, np.array(B)[:, None] / x[:, None]
    system = se.System(A, B, states=["angle", "speed"])
    with pytest.raises(SolverError, match=cause):
        se.gain(system, Q, 1.0)


def test_what_rounding_decides_is_said_to_be_so():
    gen = np.random.default_rng(0)
    A = gen.standard_normal((26, 26))
    A *= 1.05 / np.abs(np.linalg.eigvals(A)).min()
    with pytest.raises(SolverError, match="rounding decides"):
        se.gain((A, gen.standard_normal((26, 1))), 1.0, 1.0)


def test_weights_in_units_far_apart():
    """In its own units the smallest eigenvalue of this one is rounding of the largest entry."""
    x = np.array([1e8, 1e-8])
    good, bad = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([[1.0, 2.0], [2.0, 1.0]])
    A, B = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.0], [0.1]])
    assert np.abs(se.gain(in_units(A, B, good, np.eye(1), x, np.ones(1))[:2], 1.0, 1.0).E).max() < 1
    with pytest.raises(InputError, match="semidefinite"):
        se.gain((A, B), bad * x[:, None] * x, 1.0)


def test_a_guaranteed_gain_in_other_units():
    """It moved by 8 %: the sum of what it minimises was in units of the states."""
    gen = np.random.default_rng(7)
    A, B = np.array([[1.1, 0.3], [0.0, 0.7]]), np.array([[0.5], [1.0]])
    x, u, w = *gen.standard_normal((2, 60, 2)), gen.standard_normal((60, 2))
    u = u[:, :1]
    y = x @ A.T + u @ B.T + w * [0.05, 0.1]
    Q = np.array([[1.0, 0.2], [0.2, 0.5]])

    def of(unit):
        pairs = se.Trajectories.from_pairs(x / unit, u, y / unit)
        model = se.identify(
            pairs, noise=se.Noise(covariance=np.diag([0.05, 0.1]) ** 2 / unit[:, None] / unit)
        )
        weight = Q * unit[:, None] * unit
        return se.gain(model, weight, 1.0, guarantee=0.05), se.gain(model, 0.0, 1.0, guarantee=0.05)

    unit = np.array([1e-7, 3e5])
    for plain, other in zip(of(np.ones(2)), of(unit), strict=True):
        np.testing.assert_allclose(other.K / unit, plain.K, rtol=1e-5)


def test_a_plan_of_one_step_that_weighs_no_state():
    """Q counts from the second step on: u = 0 is best."""
    with pytest.warns(DataWarning, match="grows by 1.2 in each call"):
        loop = se.regulate(([[1.2]], [[1.0]]), 1, cost=se.Cost(Q=1.0, Qf=0.0, R=1.0))
    assert loop([1.0]) == 0.0
    assert loop.log[-1].status == "optimal"
