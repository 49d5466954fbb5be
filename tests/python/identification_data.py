"""Data for the tests of identification."""

from __future__ import annotations

import numpy as np

from coverage_study import sets

RUNS = sets(1500, 300)
LAMS = tuple(4.0**j for j in range(6))

# y = Theta z + w by integer formulas, so that every number below can be checked anywhere.
_i, _t = np.arange(3)[:, None], np.arange(12)
Z = ((((2 * _i + 1) * (_t + 1) ** 2) % 11) - 5.0).T
W = (((((np.arange(2)[:, None] + 3) * (_t + 2) ** 2) % 13) - 6) / 20.0).T
THETA = np.array([[0.9, 0.2, 0.0], [-0.1, 0.8, 1.0]])
Y = Z @ THETA.T + W
POINT = np.array([1.0, -1.0, 0.5])

SKEWED = np.array(  # a root of a noise covariance that is far from I
    [[1.0, 0.0, 0.0, 0.0], [0.7, 0.3, 0.0, 0.0], [-0.5, 0.2, 0.1, 0.0], [2.0, -1.0, 0.5, 1.5]]
)


def independent(gen, n=4, d=6, N=40, root=None):
    """Theta, Z, Y of N independent pairs; noise root g, g standard normal."""
    Theta, z = gen.standard_normal((n, d)), gen.standard_normal((N, d))
    root = np.eye(n) if root is None else np.asarray(root)
    return Theta, z, z @ Theta.T + gen.standard_normal((N, n)) @ root.T


def stable(gen, n=4, m=2, size=0.9):
    """A of spectral radius `size`, and B."""
    A = gen.standard_normal((n, n))
    return size * A / np.abs(np.linalg.eigvals(A)).max(), gen.standard_normal((n, m))


def tuned(gen, T, *, explore=1.0):
    """Closed loop, n = 2, m = 1: an unstable plant, feedback that is tuned by the noise so far.

    The gain follows the running error of least squares, which whoever designs the feedback from
    residuals does too: more excitation where the past noise has pushed the estimate.
    """
    A, B = np.array([[1.05, 0.2], [0.0, 0.9]]), np.array([[0.0], [1.0]])
    Theta, x = np.hstack([A, B]), np.zeros(2)
    K = np.array([0.6, 0.9])
    states, inputs, V, M = [x], [], np.eye(3), np.zeros((2, 3))
    for _ in range(T):
        D = np.linalg.solve(V, M.T).T
        size = explore / (1.0 + 4.0 * np.linalg.norm(D[0]))
        u = np.array([-K @ x + size * gen.standard_normal()])
        w = gen.standard_normal(2)
        z = np.concatenate([x, u])
        V, M = V + np.outer(z, z), M + np.outer(w, z)
        x = A @ x + B @ u + w
        states.append(x)
        inputs.append(u)
    return Theta, (np.array(states), np.array(inputs))


def check(actual, expected, rtol=2e-12, atol=6e-13):  # numbers with 12 decimals
    np.testing.assert_allclose(actual, expected, rtol=rtol, atol=atol)


def noisy_states(gen, T, sv, sw=0.1):
    """A stable plant whose states are read with error; inputs, and the pairs as read."""
    A, B = np.array([[0.8, 0.2], [-0.1, 0.7]]), np.array([[0.0], [1.0]])
    x, u = np.zeros((T + 1, 2)), gen.standard_normal((T, 1))
    w = sw * gen.standard_normal((T, 2))
    for t in range(T):
        x[t + 1] = A @ x[t] + B @ u[t] + w[t]
    return np.hstack([A, B]), (x + sv * gen.standard_normal(x.shape), u)


def rolled(Theta, x0, inputs, noise=None):
    x = np.asarray(x0)
    for k, u in enumerate(inputs):
        x = Theta @ np.concatenate([x, u]) + (0.0 if noise is None else noise[k])
    return x


def hull(gen, Theta, spread, off=0.0, M=4):
    """Models around Theta whose hull holds it, or is `off` beside it."""
    models = Theta + spread * gen.standard_normal((M, *Theta.shape))
    return models - models.mean(axis=0) + Theta + off * gen.standard_normal(Theta.shape)
