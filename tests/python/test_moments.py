"""Exact moments against the enumeration of every atom (n <= 3), and against the sampler."""

from __future__ import annotations

import itertools
from fractions import Fraction
from functools import partial

import numpy as np
import pytest

import stochens_rs as se
from atoms import TOLERANCE, averages, close, matrix_atoms, mean_and_covariance, vector_atoms
from stochens_rs.theory import moments
from twin import moments as twin

AXES = ("columns", "rows")

# -- the oracle: a distribution is a list of (probability, value) ------------------------------


def moments_of(atoms):
    values = np.array([np.ravel(value) for _, value in atoms])
    return mean_and_covariance(np.array([p for p, _ in atoms]), values)


def differences(x0s, xfs, As):
    """The distribution of xf - A x0 for independent x0, xf, A."""
    p = np.einsum("a,b,c->abc", *([q for q, _ in d] for d in (x0s, xfs, As)))
    x0, xf, A = (np.array([value for _, value in d]) for d in (x0s, xfs, As))
    y = xf[None, :, None, :] - np.einsum("cij,aj->aci", A, x0)[:, None, :, :]
    return list(zip(p.ravel(), y.reshape(-1, y.shape[-1]), strict=True))


# -- cases: signs, zeros, all shapes of B ------------------------------------------------------

VECTORS = {
    "signs": [3.0, -1.0, 0.5],
    "zero entry": [2.0, 0.0, -1.0],
    "one entry": [0.0, -4.0],
    "zero": [0.0, 0.0, 0.0],
    "length 1": [-2.0],
    "equal": [1.0, 1.0, 1.0],
}
MATRICES = {
    "full": [[1.0, -2.0, 0.5], [0.25, 1.0, 3.0], [-1.0, 0.5, 0.75]],
    "zero column": [[1.0, 0.0, -2.0], [-3.0, 0.0, 0.5], [0.5, 0.0, 1.0]],
    "zero row": [[0.0, 0.0], [2.0, -1.0]],
    "diagonal": [[2.0, 0.0], [0.0, -1.0]],
    "wide": [[1.0, -1.0, 2.0], [0.0, 3.0, -0.5]],
    "tall": [[1.0, -1.0], [2.0, 0.0], [-0.5, 4.0]],
    "zero": [[0.0, 0.0], [0.0, 0.0]],
}
A2 = [[1.0, -2.0], [0.5, 3.0]]
A3 = MATRICES["full"]
# (A, B), x0, xf
CONTROLS = {
    "n=1": (([[0.5]], [[2.0]]), [3.0], [-1.0]),
    "m < n": ((A2, [[1.0], [2.0]]), [1.0, -0.5], [0.5, 2.0]),
    "m = n": ((A2, [[1.0, 0.5], [-1.0, 2.0]]), [1.0, -0.5], [0.5, 2.0]),
    "m > n": ((A2, [[1.0, 0.5, -1.0], [0.0, 2.0, 1.0]]), [1.0, -0.5], [0.5, 2.0]),
    "rank-deficient B": ((A2, [[1.0, 2.0], [2.0, 4.0]]), [1.0, -0.5], [0.5, 2.0]),
    "zero B": ((A2, [[0.0], [0.0]]), [1.0, -0.5], [0.5, 2.0]),
    "zero xf": ((A2, [[1.0], [2.0]]), [1.0, -0.5], [0.0, 0.0]),
    "zero x0": ((A2, [[1.0], [2.0]]), [0.0, 0.0], [0.5, 2.0]),
    "zero column": (([[0.0, -2.0], [0.0, 3.0]], [[1.0], [2.0]]), [1.0, -0.5], [0.5, 2.0]),
    "zero row": (([[0.0, 0.0], [1.0, 3.0]], [[1.0], [2.0]]), [1.0, -0.5], [0.5, 2.0]),
}
CONTROLS_3 = {
    "n=3, m=2": ((A3, [[1.0, 0.0], [0.5, 1.0], [-1.0, 2.0]]), [1.0, -2.0, 0.5], [0.0, 1.0, -1.0]),
    "n=3, rank 1": (
        (A3, np.outer([1.0, -2.0, 0.5], [1.0, 3.0, 0.0])), [1.0, 0.0, 0.5], [2.0, 1.0, -1.0],
    ),
}  # fmt: skip


def cases(table):
    return pytest.mark.parametrize("case", table.values(), ids=table.keys())


axes = pytest.mark.parametrize("axis", AXES)


# -- one entity ----------------------------------------------------------------------------------


def test_covariance_in_rational_numbers():
    w = [Fraction(3), Fraction(-1, 2), Fraction(0), Fraction(7, 4)]
    gamma = sum(abs(x) for x in w)
    atoms = [
        (abs(x) / gamma, [gamma * (1 if x > 0 else -1) * (i == k) for k in range(4)])
        for i, x in enumerate(w)
        if x != 0
    ]
    assert [sum(p * s[i] for p, s in atoms) for i in range(4)] == w
    exact = [
        [sum(p * (s[i] - w[i]) * (s[k] - w[k]) for p, s in atoms) for k in range(4)]
        for i in range(4)
    ]
    found = moments.covariance([float(x) for x in w])
    assert [[Fraction(x) for x in row] for row in found] == exact


@axes
@cases(MATRICES)
def test_mse(case, axis):
    mean, covariance = moments_of(matrix_atoms(case, axis))
    close(mean, np.ravel(case))
    close(moments.mse(case, axis=axis), np.trace(covariance))
    if axis == "rows":
        close(moments.mse(case, axis=axis), moments.mse(np.transpose(case)))
    close(moments.mse(case, 7, axis=axis), np.trace(covariance) / 7)


@axes
@cases(MATRICES)
def test_second_moment(case, axis):
    m = np.shape(case)[1]
    symmetric = np.array([[2.0, -1.0, 0.5], [-1.0, 1.0, 3.0], [0.5, 3.0, -4.0]])[:m, :m]
    general = np.array([[2.0, -1.0, 0.5], [0.0, 1.0, 3.0], [-2.0, 5.0, -4.0]])[:m, :m]
    for M in (symmetric, general, np.eye(m)):
        expected = sum(p * S @ M @ S.T for p, S in matrix_atoms(case, axis))
        close(moments.second_moment(case, M, axis=axis), expected)


@axes
@cases(MATRICES)
def test_product_covariance(case, axis):
    m = np.shape(case)[1]
    for x0 in ([1.0, -2.0, 0.5][:m], [0.0, 3.0, 0.0][:m], [0.0] * m):
        z = [(p * q, S @ s) for p, s in vector_atoms(x0) for q, S in matrix_atoms(case, axis)]
        mean, covariance = moments_of(z)
        close(mean, np.asarray(case) @ x0)
        found = moments.product_covariance(case, x0, axis=axis)
        close(found, covariance)
        if axis == "columns":  # the closed form C_z of the documentation
            Z, g = np.abs(case), np.abs(case).sum(axis=0)
            closed = np.abs(x0).sum() * np.diag(Z @ (g * np.abs(x0))) - np.outer(mean, mean)
            close(found, closed)


def test_an_entity_that_is_known_exactly_has_no_variance():
    w = VECTORS["signs"]
    for exact in (None, np.inf, float("inf"), np.float32("inf")):
        assert moments.mse(w, exact) == 0.0
        assert not moments.covariance(w, exact).any()
        assert moments.mse(A3, exact) == 0.0
        assert moments.mse(w, exact, scheme="systematic") == 0.0


def test_variance_without_cancellation():
    # g^2 - ||w||^2 = 2e-20 is lost when two numbers near 1 are subtracted.
    assert moments.mse([1.0, 1e-20]) == pytest.approx(2e-20, rel=1e-15)
    assert moments.covariance([1.0, 1e-20])[0, 0] == pytest.approx(1e-20, rel=1e-15)
    assert moments.mse([0.1] + [0.0] * 9) == 0.0


# -- systematic sampling -------------------------------------------------------------------------


SYSTEMATIC = [
    [3.0, -1.0, 0.5, 0.0, 2.0],
    [0.0, 0.0],
    [-5.0],
    [0.25, 0.0, -0.25],
    [1.0, 2.0, 4.0, 8.0, -16.0, 32.0],
]


def systematic_atoms(w, size):
    """The distribution of the average of `size` systematic samples, by the offset U."""
    w = [Fraction(x) for x in w]
    gamma = sum(abs(x) for x in w)
    if gamma == 0:
        return [(1.0, np.zeros(len(w)))]
    c = [size * sum(abs(x) for x in w[:i]) / gamma for i in range(len(w) + 1)]
    breaks = sorted({Fraction(0), Fraction(1), *(x - x.__floor__() for x in c)})
    atoms = []
    for left, right in itertools.pairwise(breaks):
        ceilings = [(x - (left + right) / 2).__ceil__() for x in c]
        counts = [b - a for a, b in itertools.pairwise(ceilings)]
        value = [gamma * k * (1 if x > 0 else -1) / size for x, k in zip(w, counts, strict=True)]
        atoms.append((float(right - left), np.array([float(v) for v in value])))
    return atoms


def systematic_matrix_atoms(A, size, axis):
    lines = np.transpose(A) if axis == "columns" else np.asarray(A)
    atoms = []
    for choice in itertools.product(*(systematic_atoms(line, size) for line in lines)):
        value = np.array([atom for _, atom in choice])
        atoms.append((np.prod([p for p, _ in choice]), value.T if axis == "columns" else value))
    return atoms


@pytest.mark.parametrize("w", SYSTEMATIC)
@pytest.mark.parametrize("size", [1, 2, 3, 7, 50, 6500])
def test_systematic_covariance(w, size):
    mean, covariance = moments_of(systematic_atoms(w, size))
    close(mean, np.array(w))
    found = moments.covariance(w, size, scheme="systematic")
    close(found, covariance)
    assert np.trace(found) == pytest.approx(
        moments.mse(w, size, scheme="systematic"), rel=1e-12, abs=0.0
    )
    if size == 1:
        close(found, moments.covariance(w))
    assert not moments.covariance(w, None, scheme="systematic").any()


@axes
@cases(MATRICES)
def test_covariances_of_matrices_are_those_of_their_lines(case, axis):
    lines = np.transpose(case) if axis == "columns" else np.asarray(case)
    for scheme in ("iid", "systematic"):
        found = moments.covariance(case, 5, axis=axis, scheme=scheme)
        of_a_line = partial(moments.covariance, scheme=scheme)
        close(found, np.array([of_a_line(line, 5) for line in lines]))
        total = np.trace(found, axis1=1, axis2=2).sum()
        close(moments.mse(case, 5, axis=axis, scheme=scheme), total)


@axes
@cases(CONTROLS)
@pytest.mark.parametrize("sizes", [(2, 2, 2), (3, 5, 4), (7, None, 3), (None, 3, 7), (5, 4, None)])
def test_controls_from_systematic_samples(case, axis, sizes):
    A, B, x0, xf = (np.asarray(x, dtype=float) for x in (*case[0], *case[1:]))
    N0, Nf, NA = sizes
    y = differences(
        [(1.0, x0)] if N0 is None else systematic_atoms(x0, N0),
        [(1.0, xf)] if Nf is None else systematic_atoms(xf, Nf),
        [(1.0, A)] if NA is None else systematic_matrix_atoms(A, NA, axis),
    )
    pinv = np.linalg.pinv(B)
    options = {"size": sizes, "axis": axis, "scheme": "systematic"}
    for found, F in (
        (moments.control_covariance(*case, **options), pinv),
        (moments.state_covariance(*case, **options), B @ pinv),
    ):
        close(found, moments_of([(p, F @ v) for p, v in y])[1])
    rms = moments.control_rms(*case, **options), moments.state_rms(*case, **options)
    close(rms[0] ** 2, np.trace(moments.control_covariance(*case, **options)))
    close(rms[1] ** 2, np.trace(moments.state_covariance(*case, **options)))


# -- controls ------------------------------------------------------------------------------------


def check_controls(case, axis, sizes, fusion):
    """Compare control and state with the distribution of all averages (or pairs)."""
    A, B, x0, xf = (np.asarray(x, dtype=float) for x in (*case[0], *case[1:]))
    sampled = vector_atoms(x0), vector_atoms(xf), matrix_atoms(A, axis)
    exact = [(1.0, x0)], [(1.0, xf)], [(1.0, A)]
    entities = list(zip(sampled, exact, sizes, strict=True))
    if fusion == "product":
        y = differences(*(e if k is None else averages(s, k) for s, e, k in entities))
    else:
        N = max(k for k in sizes if k is not None)
        y = averages(differences(*(e if k is None else s for s, e, k in entities)), N)
    pinv = np.linalg.pinv(B)
    mean_u, covariance_u = moments_of([(p, pinv @ v) for p, v in y])
    mean_x, covariance_x = moments_of([(p, A @ x0 + B @ (pinv @ v)) for p, v in y])
    options = {"size": sizes, "fusion": fusion, "axis": axis}
    close(mean_u, pinv @ (xf - A @ x0))
    close(moments.control_covariance(*case, **options), covariance_u)
    close(moments.state_covariance(*case, **options), covariance_x)
    close(moments.control_rms(*case, **options) ** 2, np.trace(covariance_u))
    close(moments.state_rms(*case, **options) ** 2, np.trace(covariance_x))
    # E||x(1) - xf||^2 = trace + what cannot be reached
    miss = sum(p * np.sum((A @ x0 + B @ (pinv @ v) - xf) ** 2) for p, v in y)
    unreached = xf - A @ x0 - B @ (pinv @ (xf - A @ x0))
    close(np.trace(covariance_x) + unreached @ unreached, miss)
    assert np.allclose(mean_x, xf - unreached, atol=1e-12)


@axes
@cases(CONTROLS | CONTROLS_3)
def test_realization_control(case, axis):
    check_controls(case, axis, (1, 1, 1), "product")  # one realization: both fusions agree
    check_controls(case, axis, (1, 1, 1), "diagonal")
    close(
        moments.control_covariance(*case, fusion="diagonal", axis=axis),
        moments.control_covariance(*case, 1, axis=axis),
    )


@axes
@cases(CONTROLS)
@pytest.mark.parametrize(
    "sizes",
    [(2, 2, 2), (1, 3, 2), (3, 1, 1), (2, None, 2), (None, 2, 2), (2, 2, None), (None, 2, None)],
)
def test_product_fusion(case, axis, sizes):
    check_controls(case, axis, sizes, "product")


@axes
@cases(CONTROLS)
@pytest.mark.parametrize("sizes", [(2, 2, 2), (2, None, 2), (None, 2, 2), (2, 2, None)])
def test_diagonal_fusion(case, axis, sizes):
    check_controls(case, axis, sizes, "diagonal")


@axes
@cases(CONTROLS | CONTROLS_3)
def test_product_fusion_is_never_worse(case, axis):
    for size in (1, 2, 10, 1000):
        product = moments.control_covariance(*case, size, axis=axis)
        diagonal = moments.control_covariance(*case, size, fusion="diagonal", axis=axis)
        gain = diagonal - product
        scale = max(1.0, float(np.abs(diagonal).max()))
        assert np.linalg.eigvalsh(gain).min() >= -TOLERANCE * scale
        if size == 1:
            close(gain, np.zeros_like(gain))
        if axis == "columns":
            A, B, x0 = (np.asarray(x, dtype=float) for x in (*case[0], case[1]))
            d = np.abs(x0).sum() * np.abs(x0) - x0 * x0
            T = moments.second_moment(A, np.diag(d)) - A @ np.diag(d) @ A.T
            pinv = np.linalg.pinv(B)
            close(gain, (1.0 / size) * (1.0 - 1.0 / size) * pinv @ T @ pinv.T)


def test_everything_exact_gives_no_variance():
    for fusion in ("product", "diagonal"):
        assert moments.control_rms(*CONTROLS["m = n"], None, fusion=fusion) == 0.0
        assert moments.state_rms(*CONTROLS["m = n"], (None, np.inf, None), fusion=fusion) == 0.0


def test_scale_of_B_does_not_change_its_rank():
    (A, B), x0, xf = CONTROLS["rank-deficient B"]
    for scale in (1e-100, 1e-3, 1e100):
        close(
            moments.state_covariance((A, np.array(B) * scale), x0, xf),
            moments.state_covariance((A, B), x0, xf),
        )


# -- the twin ------------------------------------------------------------------------------------


def near(found, expected, floor=1e-13):
    """Relative to the standard deviations, up to the rounding of the largest variance."""
    found, expected = np.asarray(found), np.asarray(expected, dtype=float)
    sd = np.sqrt(np.maximum(np.diagonal(expected, axis1=-2, axis2=-1), 0.0))
    largest = sd.max(axis=-1)[..., None, None] ** 2
    allowed = 1e-12 * sd[..., :, None] * sd[..., None, :] + floor * largest
    assert found.shape == expected.shape
    assert (np.abs(found - expected) <= allowed).all()


KINDS = ("plain", "unstable", "sparse", "graded", "no effect of B", "one state")


@axes
@pytest.mark.parametrize("kind", KINDS)
def test_random_systems_against_the_twin(kind, axis):
    gen = np.random.default_rng(KINDS.index(kind))
    for _ in range(6):
        n = 1 if kind == "one state" else int(gen.integers(2, 20))
        m, steps = int(gen.integers(1, 4)), int(gen.integers(1, 5))
        A, B, u = (gen.standard_normal(shape) for shape in ((n, n), (n, m), (steps, m)))
        A *= {"unstable": 3.0, "sparse": gen.random((n, n)) < 0.3}.get(kind, 0.5)
        A *= 10.0 ** -gen.integers(0, 6, n) if kind == "graded" else 1.0
        B *= kind != "no effect of B"
        x0, xf = gen.standard_normal((2, n))
        sizes = tuple(int(N) for N in gen.choice([0, 1, 7, 1000], 3))
        given = tuple(N or None for N in sizes)
        for scheme, fusion in (("iid", "product"), ("systematic", "product"), ("iid", "diagonal")):
            paired = fusion == "diagonal"
            own = sizes if not paired else tuple(9 * (N > 0) for N in sizes)
            how = {"axis": axis, "scheme": scheme, "fusion": fusion}
            for of, of_control in (
                (moments.control_covariance, True),
                (moments.state_covariance, False),
            ):
                found = of((A, B), x0, xf, tuple(N or None for N in own), **how)
                near(found, twin.fused(A, B, x0, xf, own, of_control, axis, scheme, paired))
            line = moments.covariance(A, given[0], axis=axis, scheme=scheme)
            lines = A.T if axis == "columns" else A
            near(line, [twin.covariance(one, sizes[0], scheme) for one in lines])
        states = se.simulate((A, B), x0, u).states
        S = moments.trajectory_covariance((A, B), x0, u, 5, axis=axis, averaging="mean-field")
        near(S, twin.trajectory(A, B, states, u, (5, 5, 5), axis))
        if kind != "no effect of B":
            square = B if n == 1 else gen.standard_normal((n, n)) + 3.0 * np.eye(n)
            plan = se.control((A, square), x0, xf, steps=steps)
            states = se.simulate((A, square), x0, plan.u).states
            found = moments.final_state_covariance((A, square), x0, xf, steps, given, axis=axis)
            near(found, twin.final(A, states, xf, sizes, axis), floor=1e-11)
