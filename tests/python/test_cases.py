"""The example systems: reference numbers, defining equations, and the choices they document."""

from __future__ import annotations

import numpy as np
import pytest

from hidden_systems import of_each_kind
from stochens_rs import cases
from stochens_rs.cases import swing_models
from stochens_rs.cases.swing_models import MACHINES, reduced_stiffness, swing_matrices
from stochens_rs.exceptions import InputError
from stochens_rs.rng import as_key
from stochens_rs.system.conversions import discretize

STEP = 0.01  # s


def continuous(buses, rating, H, xd, D):
    """A, B in continuous time and the stiffness between the machines."""
    L = reduced_stiffness(buses, *swing_models.NETWORKS[buses], xd * 100.0 / rating)
    return (*swing_matrices(L, H * rating / 100.0, D * rating / 100.0), L)


def ieee14(data, base):
    rating, *others = MACHINES[data].T
    return continuous(14, rating if base == "system" else np.full(5, 100.0), *others)


def ieee39(damping):
    rating, H, xd, D = MACHINES["pai"].T
    return continuous(39, rating, H, xd, damping * D)


def modes(A):
    """Frequencies (Hz, ascending) and all decay rates (1/s) of a continuous-time matrix."""
    eigenvalues = np.linalg.eigvals(A)
    frequencies = np.sort(eigenvalues.imag[eigenvalues.imag > 0.1]) / (2.0 * np.pi)
    return frequencies, -eigenvalues.real


# -- IEEE 14 -------------------------------------------------------------------------------------

L_SYSTEM = np.array([
    [4.270399, -1.941134, -1.415342, -0.493092, -0.420832],
    [-1.941134, 2.607945, -0.424276, -0.128743, -0.113792],
    [-1.415342, -0.424276, 2.112743, -0.140247, -0.132878],
    [-0.493092, -0.128743, -0.140247, 0.85046, -0.088379],
    [-0.420832, -0.113792, -0.132878, -0.088379, 0.75588],
])  # fmt: skip
L_MACHINE = np.array([
    [2.33902, -1.051597, -0.632139, -0.392104, -0.26318],
    [-1.051597, 3.317891, -1.172076, -0.64603, -0.448189],
    [-0.632139, -1.172076, 2.760077, -0.544645, -0.411218],
    [-0.392104, -0.64603, -0.544645, 2.089888, -0.507109],
    [-0.26318, -0.448189, -0.411218, -0.507109, 1.629697],
])  # fmt: skip
# data, base: frequencies in Hz, range of decays in 1/s, max |A_d|, cond B_d, ||B_d||_2 and the
# condition of the two-step map [A B, B]
REFERENCE_14 = {
    ("classic", "machine"): (
        [1.3428, 1.5487, 1.6166, 1.8168], (0.081, 0.176), 0.99697, 1.2938, 0.37186, 257),
    ("classic", "system"): (
        [1.5689, 1.7301, 1.8505, 1.8897], (0.079, 0.187), 1.26323, 24.9943, 1.48603, 4956),
    ("andes", "system"): (
        [1.0284, 1.1094, 1.1511, 1.3036], (0.0, 0.0), 0.99825, 1.6244, 0.47080, 323),
}  # fmt: skip


@pytest.mark.parametrize(("base", "expected"), [("system", L_SYSTEM), ("machine", L_MACHINE)])
def test_ieee14_stiffness(base, expected):
    _, _, L = ieee14("classic", base)
    np.testing.assert_allclose(L, expected, atol=6e-7)


@pytest.mark.parametrize(("data", "base"), REFERENCE_14)
def test_ieee14_reference_numbers(data, base):
    frequencies, (slowest, fastest), largest, condition, norm, two_steps = REFERENCE_14[data, base]
    A_c, _, _ = ieee14(data, base)
    found, decays = modes(A_c)
    np.testing.assert_allclose(found, frequencies, atol=6e-5)
    moving = np.sort(decays)[1:]  # without the common angle
    np.testing.assert_allclose([moving[0], moving[-1]], [slowest, fastest], atol=6e-4)

    system = cases.ieee14(data=data, base=base)
    assert (system.n, system.m, system.dt) == (10, 5, STEP)
    assert np.abs(system.A).max() == pytest.approx(largest, abs=6e-6)
    assert np.linalg.cond(system.B) == pytest.approx(condition, abs=6e-5)
    assert np.linalg.norm(system.B, 2) == pytest.approx(norm, abs=6e-6)
    reach = np.hstack([system.A @ system.B, system.B])
    assert np.linalg.matrix_rank(reach) == 10
    assert np.linalg.cond(reach) == pytest.approx(two_steps, abs=0.6)
    # The common angle is free: eigenvalue 1, and nothing outside the unit circle.
    assert np.abs(np.linalg.eigvals(system.A)).max() == pytest.approx(1.0, abs=1e-12)
    common = np.concatenate([np.ones(5), np.zeros(5)])
    np.testing.assert_allclose(system.A @ common, common, atol=1e-13)


def test_ieee14_andes_ratings_are_the_system_base():
    assert cases.ieee14(data="andes", base="machine") == cases.ieee14(data="andes", base="system")
    assert cases.ieee14(base="machine") != cases.ieee14(base="system")


def test_euler_keeps_the_zeros_and_zoh_fills_them():
    zoh, euler = cases.ieee14(), cases.ieee14(method="euler")
    assert np.count_nonzero(zoh.A) == 100
    assert np.count_nonzero(euler.A) == 40
    A_c, B_c, _ = ieee14("classic", "system")
    np.testing.assert_allclose(euler.A, np.eye(10) + STEP * A_c, atol=1e-15)
    np.testing.assert_allclose(euler.B, STEP * B_c, atol=1e-15)
    assert np.abs(np.linalg.eigvals(euler.A)).max() == pytest.approx(1.006, abs=5e-4)


# -- IEEE 39 -------------------------------------------------------------------------------------


def test_ieee39_reference_numbers_without_damping():
    A_c, B_c, L = ieee39(0.0)
    frequencies, decays = modes(A_c)
    expected = [0.68136, 0.99444, 1.07659, 1.14558, 1.26410, 1.28365, 1.45393, 1.47117, 1.50523]
    np.testing.assert_allclose(frequencies, expected, atol=6e-6)
    np.testing.assert_allclose(decays, 0.0, atol=1e-6)  # the double eigenvalue 0 moves by sqrt(eps)
    _, B = discretize(A_c, B_c, STEP, "zoh")
    assert np.linalg.cond(B) == pytest.approx(20.55, abs=6e-3)
    expected = [14.76069, 8.67648, 10.28307, 11.32943, 5.36144,
                10.93977, 9.648, 9.91415, 7.5521, 19.11315]  # fmt: skip
    np.testing.assert_allclose(np.diag(L), expected, atol=6e-6)


def test_ieee39():
    system = cases.ieee39()
    assert (system.n, system.m, system.dt) == (20, 10, STEP)
    assert np.abs(np.linalg.eigvals(system.A)).max() == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.matrix_rank(system.B) == 10
    assert np.linalg.matrix_rank(np.hstack([system.A @ system.B, system.B])) == 20
    # D = 50 enters as D / w0: a machine alone decays with D / (4 H), never faster than 0.52 / s.
    _, decays = modes(ieee39(1.0)[0])
    assert np.sort(decays)[1] > 0.2
    assert decays.max() < 50.0 / (4.0 * 24.3)


# -- the model -----------------------------------------------------------------------------------

NETWORKS = {
    "14, system": lambda: ieee14("classic", "system"),
    "14, machine": lambda: ieee14("classic", "machine"),
    "14, andes": lambda: ieee14("andes", "system"),
    "39": lambda: ieee39(1.0),
}


@pytest.mark.parametrize("network", NETWORKS)
def test_stiffness_is_a_laplacian(network):
    A, _, L = NETWORKS[network]()
    np.testing.assert_array_equal(L, L.T)
    np.testing.assert_allclose(L.sum(axis=1), 0.0, atol=1e-12)
    assert (L - np.diag(np.diag(L))).max() <= 0.0
    eigenvalues = np.linalg.eigvalsh(L)
    assert abs(eigenvalues[0]) < 1e-12
    assert eigenvalues[1] > 0.1  # connected: only the common angle is free
    assert modes(A)[0].size == L.shape[0] - 1


def test_kron_reduction_on_springs_in_series():
    # Two machines behind 0.2 and 0.3, one line of 0.5 with a bus in the middle: total x = 1.
    L = reduced_stiffness(3, [(1, 2, 0.1), (2, 3, 0.4)], (1, 3), np.array([0.2, 0.3]))
    np.testing.assert_allclose(L, [[1.0, -1.0], [-1.0, 1.0]], atol=1e-15)


def test_two_machines_on_one_bus_and_parallel_lines():
    L = reduced_stiffness(2, [(1, 2, 1.0), (2, 1, 1.0)], (1, 1, 2), np.array([0.5, 0.5, 0.5]))
    np.testing.assert_allclose(L.sum(axis=1), 0.0, atol=1e-14)
    assert L[0, 0] == pytest.approx(L[1, 1])
    # Bus 1 and bus 2 are joined by 2, every machine by 2. For angles (1, 1, 0) the machines 1 and 2
    # act as one spring 4, in series with 2 and 2: energy 1 / (1/4 + 1/2 + 1/2) = 0.8.
    angles = np.array([1.0, 1.0, 0.0])
    assert angles @ L @ angles == pytest.approx(0.8)


def test_swing_has_the_textbook_frequency_and_damping():
    # One machine on a stiff bus, delta'' + D/(2H) delta' + w0/(2H) K delta = 0.
    K, H, D, w0 = 1.5, 4.0, 2.0, 2.0 * np.pi * 60.0
    A, B = swing_matrices(np.array([[K]]), np.array([H]), np.array([D]))
    eigenvalue = np.linalg.eigvals(A)[0]
    decay = D / (4.0 * H)
    assert -eigenvalue.real == pytest.approx(decay, rel=1e-12)
    assert abs(eigenvalue.imag) == pytest.approx(np.sqrt(w0 * K / (2.0 * H) - decay**2), rel=1e-12)
    np.testing.assert_allclose(B, [[0.0], [w0 / (2.0 * H)]], rtol=1e-15)


# -- the matrix exponential ----------------------------------------------------------------------


# -- discretization ------------------------------------------------------------------------------


def test_zoh_does_not_depend_on_the_units_of_the_inputs():
    gen = np.random.default_rng(4)
    for one in of_each_kind(gen, without=("mixed_state_units",)):  # its A is refused
        m = one.B.shape[1]
        for dt in (1e-3, 0.1, 7.0):
            A_d, B_d = discretize(one.A, one.B, dt, "zoh")
            powers = gen.integers(-300, 300, m)
            again_A, again_B = discretize(one.A, np.ldexp(one.B, powers), dt, "zoh")
            np.testing.assert_array_equal(again_A, A_d)
            np.testing.assert_array_equal(again_B, np.ldexp(B_d, powers))
            for unit in (1e-12, 1e8, 2e10, 1e100):
                again_A, again_B = discretize(one.A, unit * one.B, dt, "zoh")
                np.testing.assert_array_equal(again_A, A_d)
                error = np.abs(again_B / unit - B_d).max(axis=0)
                assert (error <= 1e-13 * np.abs(B_d).max(axis=0)).all()


def test_zoh_of_one_huge_input_names_no_time_scale():
    A, dt = np.array([[-1.0]]), 0.1
    A_d, B_d = discretize(A, np.array([[2e10]]), dt, "zoh")
    assert A_d[0, 0] == pytest.approx(np.exp(-0.1), rel=1e-15)
    assert B_d[0, 0] == pytest.approx(-2e10 * np.expm1(-0.1), rel=1e-15)
    A_d, B_d = discretize(A, np.array([[1.0]]), 2e9, "zoh")  # nothing lasts, nothing is lost
    assert (A_d[0, 0], B_d[0, 0]) == (0.0, pytest.approx(1.0, rel=1e-14))
    with pytest.raises(InputError, match=r"short beside the time scales .* got 2e9 s"):
        discretize(np.array([[-1.0, 1.0], [1.0, -1.0]]), np.ones((2, 1)), 2e9, "zoh")
    with pytest.raises(InputError, match="B of the discretized system overflows"):
        discretize(np.zeros((1, 1)), np.array([[1e308]]), 1e5, "zoh")


# -- random systems ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "m", "radius"), [(1, 1, 1.0), (10, 5, 1.0), (6, 9, 0.3), (4, 2, 7.0)]
)
def test_random_system(n, m, radius):
    system = cases.random_system(n, m, rng=3, spectral_radius=radius)
    assert (system.n, system.m, system.dt) == (n, m, True)
    assert np.abs(np.linalg.eigvals(system.A)).max() == pytest.approx(radius, rel=1e-12)
    assert np.linalg.matrix_rank(system.B) == min(n, m)


def test_random_system_is_the_documented_stream():
    key = bytes(as_key(11).child("random_system"))
    philox = np.random.Philox(key=int.from_bytes(key[:16], "little"))
    normal = np.random.Generator(philox)
    G, B = normal.standard_normal((5, 5)), normal.standard_normal((5, 3))
    system = cases.random_system(5, 3, rng=11, spectral_radius=0.5)
    np.testing.assert_array_equal(system.B, B)
    np.testing.assert_allclose(system.A, G * 0.5 / np.abs(np.linalg.eigvals(G)).max(), rtol=1e-14)
