"""The statements about pilot models against values computed by other codes."""

from __future__ import annotations

import numpy as np
import pytest

from twin import pilot as twin

Array = np.ndarray
H0 = np.array([[0.8, 0.1, 0.1], [0.0, 0.9, 0.9]])
THETA = np.array([[0.9, 0.2, 0.0], [-0.1, 0.8, 1.0]])
SIGMA = 0.2


def integer_runs() -> tuple[Array, Array, Array]:
    """Pairs (x, u, x_next), the starts, and the noise, by integer formulas: 3 runs of 4 steps."""
    rows, starts, noise = [], [], []
    for r in range(3):
        x = np.array([(((3 * r + 2 * i + 1) ** 2 % 7) - 3) / 2 for i in range(2)])
        starts.append(x)
        for k in range(4):
            u = (2 * r + 1) * (k + 2) ** 2 % 5 - 2.0
            w = np.array([(((i + 3) * (4 * r + k + 2) ** 2 % 13) - 6) / 20 for i in range(2)])
            y = THETA @ [*x, u] + w
            rows.append([*x, u, *y])
            noise.append(w)
            x = y
    return np.array(rows), np.array(starts), np.array(noise)


def along(Theta: Array, x0: Array, u: Array) -> tuple[Array, Array]:
    """The z of a plan and its last state."""
    x, z = np.asarray(x0, dtype=float), []
    for one in u:
        z.append([*x, one])
        x = Theta @ z[-1]
    return np.array(z), x


def problem(u: tuple[float, ...] = (0.5, 0.0, -0.5)) -> tuple[twin.Problem, Array]:
    """The plan of the statements' oracles."""
    rows, starts, _ = integer_runs()
    zeta = twin.simulated(H0, starts, np.array([4, 4, 4]), rows[:, 2:3], None)
    found = twin.estimate(zeta, rows[:, :3], rows[:, 3:])
    z, end = along(found.H, np.array([1.0, -1.0]), np.array(u))
    z0, _ = along(H0, np.array([1.0, -1.0]), np.array([0.4, 0.1, -0.4]))
    return twin.Problem(found, H0, SIGMA * np.eye(2), 4.0, 5.0, z, z0), end


def near(found: object, *expected: float, rel: float = 2e-11) -> None:
    """Compare with printed digits."""
    assert np.ravel(found) == pytest.approx(expected, rel=rel, abs=2e-12)


def test_instruments_and_estimate() -> None:
    rows, starts, noise = integer_runs()
    near(rows[0, 3:], -0.7, 1.55)
    near(rows[1, 3:], -0.57, 3.51)
    near(rows[11, 3:], -2.902, -5.604)
    p, _ = problem()
    f = p.found
    near(np.linalg.det(f.R) ** 2, 9818.701109004)
    near(f.H[0], 0.907601101149, 0.231379985186, -0.002744116356)
    near(f.H[1], -0.130716947269, 0.890340889079, 0.978587870153)
    TT = f.T.T @ f.T
    near(
        (TT[0, 0], TT[0, 1], TT[1, 1], TT[2, 2]),
        *(0.119258839051, -0.026098280686, 0.025581679921, 0.036992426144),
    )
    near((f.tau, np.linalg.norm(f.E)), 0.314850170972, 0.842768800195)
    near(twin.scalar_bound(f, 0.5, 0.01), 0.338306122159)
    # the identity of the first theorem, and least squares where the instruments are the data
    zeta = twin.simulated(H0, starts, np.array([4, 4, 4]), rows[:, 2:3], None)
    Q = zeta @ np.linalg.inv(f.R)
    assert np.abs(f.H - THETA - noise.T @ Q @ f.T).max() < 1e-14
    own = twin.estimate(rows[:, :3], rows[:, :3], rows[:, 3:])
    least = np.linalg.lstsq(rows[:, :3], rows[:, 3:], rcond=None)[0].T
    assert np.abs(own.H - least).max() < 1e-13
    assert own.tau < 1e-13
    assert np.abs(own.T - np.linalg.inv(own.R).T).max() < 1e-13


def test_the_parts_of_the_certificate() -> None:
    p, end = problem()
    near(end, 0.315643130031, -1.053347527170)
    C = p.C0(3)
    near((C[0, 0], C[0, 1], C[1, 1]), 0.030777752048, 0.004608741924, 0.038884767035)
    q, mismatch, b = twin.wq(C, 0.04), p.mismatch(3, 1.0), p.plain_rest(3)
    near(q, 0.475814105027, rel=1e-8)
    near(mismatch, 0.229134914640)
    near((*b[1:], p.rest(b)), 0.119780581346, 0.223716829142, 0.271739880027)
    near(np.linalg.norm(end) + q + mismatch + p.rest(b), 2.076312289100, rel=1e-8)
    near(p.near(1, 0.004), 0.116097289243, 0.051766682969, rel=1e-7)
    near(p.near(2, 0.004), 0.172465023534, 0.068770821937, rel=1e-7)
    s, value = p.best(3, 0.04)
    near(s, 0.805084135, rel=1e-6)
    near(value, 0.604897785001, rel=1e-8)
    near(q + mismatch, 0.704949019667, rel=1e-8)
    near(p.mismatch(3, 0.0), 0.905716870633)
    far, _ = problem((-4.0, 3.0, -2.0))
    near(far.best(3, 0.04), 0.924337039, 1.331467509021, rel=1e-6)
    near(far.mismatch(3, 0.0), 1.535827758509)
