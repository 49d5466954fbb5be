"""K-step moments against the enumeration of every combination of atoms, and growth factors."""

from __future__ import annotations

from itertools import compress

import numpy as np
import pytest

import stochens_rs as se
from atoms import averages, close, matrix_atoms, mean_and_covariance, vector_atoms
from stochens_rs.theory import moments

AXES = ("columns", "rows")
axes = pytest.mark.parametrize("axis", AXES)


def push(p, x, As, Bs, u):
    """One step of the whole distribution, with fresh A and B for every state."""
    pA, A = np.array([q for q, _ in As]), np.array([value for _, value in As])
    pB, b = np.array([q for q, _ in Bs]), np.array([value @ u for _, value in Bs])
    states = np.einsum("aij,sj->sai", A, x)[:, :, None, :] + b
    weights = p[:, None, None] * pA[:, None] * pB
    return weights.ravel(), states.reshape(-1, x.shape[1])


A2, B2 = np.array([[1.0, -2.0], [0.5, 3.0]]), np.array([[1.0], [-0.5]])
A3 = np.array([[1.0, -2.0, 0.5], [0.25, 1.0, 3.0], [-1.0, 0.5, 0.75]])
# (A, B), x0, u: n = 2 with K = 3, n = 3 with K = 2
CASES = {
    "n=2": ((A2, B2), [1.0, -0.5], [[0.5], [-1.0], [2.0]]),
    "n=2, m=2": ((A2, np.array([[1.0, 0.5], [0.0, -2.0]])), [1.0, -0.5], [[0.5, 1.0], [-1.0, 0.0]]),
    "n=3": ((A3, np.array([[1.0], [0.0], [-0.5]])), [1.0, 0.0, -0.5], [[0.5], [-1.0]]),
    "zero column, zero start": ((np.array([[0.0, 2.0], [0.0, -1.0]]), B2), [0.0, 0.0], [[1.0]] * 3),
    "zero B": ((A2, np.zeros((2, 1))), [3.0, 1.0], [[1.0]] * 3),
}
cases = pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())


@axes
@cases
@pytest.mark.parametrize("sampled", [(True, True, True), (True, False, True), (False, True, False)])
def test_one_run(case, axis, sampled):
    system, x0, u = case
    A, B = system
    x0, u = np.asarray(x0), np.asarray(u)
    As, Bs, x0s = (
        atoms if flag else [(1.0, value)]
        for atoms, value, flag in zip(
            (matrix_atoms(A, axis), matrix_atoms(B, axis), vector_atoms(x0)),
            (A, B, x0),
            sampled,
            strict=True,
        )
    )
    flags = {"sampled": list(compress(("A", "B", "x0"), sampled))}
    S = moments.trajectory_covariance(system, x0, u, axis=axis, **flags)
    mu = se.simulate(system, x0, u).states
    rms = moments.trajectory_rms(system, x0, u, 7, axis=axis, **flags)
    p, x = np.array([q for q, _ in x0s]), np.array([value for _, value in x0s])
    for k in range(len(u) + 1):
        mean, covariance = mean_and_covariance(p, x)
        close(mu[k], mean)
        close(S[k], covariance)
        close(rms[k] ** 2, np.trace(covariance) / 7)
        if k < len(u):
            p, x = push(p, x, As, Bs, u[k])
    # Averages of runs: every covariance over N.
    close(moments.trajectory_covariance(system, x0, u, 7, axis=axis, **flags), S / 7)


@axes
def test_mean_field(axis):
    system, x0, u = CASES["n=2"]
    A, B = system
    x0, u = np.asarray(x0), np.asarray(u)
    for sample_B in (True, False):
        As = averages(matrix_atoms(A, axis), 2)
        Bs = averages(matrix_atoms(B, axis), 2) if sample_B else [(1.0, B)]
        start = averages(vector_atoms(x0), 2)
        p, x = np.array([q for q, _ in start]), np.array([value for _, value in start])
        S = moments.trajectory_covariance(
            system,
            x0,
            u[:2],
            2,
            sampled="A B x0" if sample_B else "A x0",
            averaging="mean-field",
            axis=axis,
        )
        for k in range(3):
            mean, covariance = mean_and_covariance(p, x)
            close(mean, se.simulate(system, x0, u).states[k])
            close(S[k], covariance)
            if k < 2:
                p, x = push(p, x, As, Bs, u[k])


@cases
def test_both_averages_agree_where_they_must(case):
    # One run per step is one run; without sampling error nothing is left.
    for size, expected in ((1, moments.trajectory_covariance(*case)), (None, 0.0)):
        for averaging in ("runs", "mean-field"):
            found = moments.trajectory_covariance(*case, size, averaging=averaging)
            close(found, np.zeros_like(found) + expected)


def test_no_steps_at_all():
    u = np.zeros((0, 1))
    S = moments.trajectory_covariance((A2, [[1.0], [0.0]]), [3.0, -1.0], u, 4)
    assert np.array_equal(S, moments.covariance([3.0, -1.0], 4)[None])
