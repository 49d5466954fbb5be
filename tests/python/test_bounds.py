"""Tail bounds: against exact distributions, against their formulas, and as inverses.

No test here is random: small problems are enumerated, so that a bound is either valid for every
eps or it is not. `test_bounds_coverage.py` has the larger systems.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import tail_bounds as bounds
from paper import bounds as paper
from stochens_rs.theory import drawn_bound

AXES = ("columns", "rows")

# -- exact distributions: (probability, value) -----------------------------------------------------


def counts(p, N):
    """All multinomial counts of N draws with their probabilities."""
    hit = np.flatnonzero(p)
    if hit.size == 0:
        return [(1.0, np.zeros(len(p)))]
    found = []
    for parts in itertools.product(range(N + 1), repeat=len(hit) - 1):
        if sum(parts) > N:
            continue
        full = (*parts, N - sum(parts))
        log = math.lgamma(N + 1) - sum(math.lgamma(k + 1) for k in full)
        log += sum(k * math.log(p[i]) for k, i in zip(full, hit, strict=True))
        c = np.zeros(len(p))
        c[hit] = full
        found.append((math.exp(log), c))
    return found


def vector_law(w, N):
    """The exact distribution of the average of N realizations."""
    w = np.asarray(w, dtype=float)
    g = np.abs(w).sum()
    p = np.abs(w) / g if g else w
    return [(q, g * np.sign(w) * c / N) for q, c in counts(p, N)]


def matrix_law(A, N, axis="columns"):
    A = np.asarray(A, dtype=float)
    lines = A.T if axis == "columns" else A
    laws = itertools.product(*(vector_law(line, N) for line in lines))
    law = [(math.prod(q for q, _ in c), np.array([v for _, v in c])) for c in laws]
    return [(q, v.T if axis == "columns" else v) for q, v in law]


def tail(law, error):
    """The errors and P(error >= error_i), both sorted."""
    p = np.array([q for q, _ in law])
    e = np.array([error(v) for _, v in law])
    order = np.argsort(e)
    return e[order], np.cumsum(p[order][::-1])[::-1]


def assert_valid(bound, size, errors, exceeded):
    """No delta below the chance of an error has a smaller radius: the last errors and others."""
    possible = np.unique(errors.round(12))
    possible = possible[possible > 1e-9]
    spread = np.linspace(0, len(possible) - 1, 10).astype(int) if len(possible) else []
    for eps in {*possible[spread], *possible[-5:]}:
        exact = exceeded[np.searchsorted(errors, eps * (1.0 - 1e-12))]
        radius = bound.radius(size, exact * (1.0 - 1e-6))
        assert radius >= eps * (1.0 - 1e-9), (bound, eps)
    for delta in (0.9, 0.5, 0.1, 1e-2, 1e-4, 1e-8):
        radius = bound.radius(size, delta) * (1.0 + 1e-9) + 1e-12
        where = np.searchsorted(errors, radius, side="right")
        assert where == len(errors) or exceeded[where] <= delta


# -- one vector and one matrix ---------------------------------------------------------------------

VECTORS = (
    [1.0, 1.0],
    [3.0, -1.0],
    [1.0, -0.01],
    [2.0, 0.0, -1.0],
    [1.0, 1.0, 1.0],
    [5.0, 0.2, 0.1],
)


@pytest.mark.parametrize("w", VECTORS)
@pytest.mark.parametrize("N", [1, 2, 5, 30])
def test_vector_bounds_on_exact_distributions(w, N):
    law = vector_law(w, N)
    assert sum(q for q, _ in law) == pytest.approx(1.0)
    errors, exceeded = tail(law, lambda v: np.linalg.norm(v - w))
    for bound in bounds.candidates("vector", w):
        assert_valid(bound, N, errors, exceeded)
    errors, exceeded = tail(law, lambda v: np.abs(v - w).sum())
    for bound in bounds.candidates("vector", w, norm="1"):
        assert bound.norm == "1"
        assert_valid(bound, N, errors, exceeded)


def test_the_exact_distribution_catches_the_printed_exponent():
    """`assert_valid` fails for exponents that are twice too large."""
    w, N = [0.5, 0.5], 200
    errors, exceeded = tail(vector_law(w, N), lambda v: np.linalg.norm(v - w))
    for C in (2.0, 4.0, 100.0):
        with pytest.raises(AssertionError):
            assert_valid(paper.OneVector(w, C=C), N, errors, exceeded)

    bound = bounds.bound("Weissman", "vector", w)
    assert_valid(bound, N, errors, exceeded)
    honest = bound.radius
    bound.radius = lambda size, delta: honest(size, delta) / math.sqrt(2.0)
    with pytest.raises(AssertionError):
        assert_valid(bound, N, errors, exceeded)


MATRICES = ([[1.0, -2.0], [0.5, 3.0]], [[1.0, 0.0], [1.0, 2.0]], [[9.0, 0.1], [-1.0, 0.1]])


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("A", MATRICES)
@pytest.mark.parametrize("N", [1, 3, 12])
def test_matrix_bounds_on_exact_distributions(A, N, axis):
    law = matrix_law(A, N, axis)
    for norm, order in (("Frobenius", None), ("spectral", 2)):
        errors, exceeded = tail(law, lambda v, k=order: np.linalg.norm(v - A, k))
        for bound in bounds.candidates("matrix", A, norm=norm, axis=axis):
            assert_valid(bound, N, errors, exceeded)


@pytest.mark.parametrize("w", [[3.0, -1.0, 0.5, 0.0, 2.0], [1.0, 1e-8], [0.25] * 4])
def test_systematic_samples_are_surely_within_the_bound(w):
    bound = bounds.bound("systematic", "vector", w, scheme="systematic")
    g, p = np.abs(w).sum(), np.abs(w) / np.abs(w).sum()
    for N in (1, 7, 100):
        for U in np.linspace(0.0, 1.0, 50, endpoint=False):
            c = np.ceil(N * np.cumsum(p) - U)
            c[-1] = N
            error = np.linalg.norm(g * np.sign(w) * np.diff(c, prepend=0.0) / N - w)
            assert error <= bound.radius(N, 0.5)
    assert bound.radius(100, 5e-324) == bound.radius(100, 1.0 - 1e-16) > 0.0
    found = drawn_bound("vector", w, size=100, delta=1e-9, scheme="systematic")
    assert found == (bound.radius(100, 0.5), "systematic")


# -- formulas --------------------------------------------------------------------------------------


def test_vector_formulas():
    w = np.array([3.0, -1.0, 0.5, 0.0, 2.0])
    g, e, N, delta = 6.5, np.sqrt(6.5**2 - 14.25), 1000, 0.01
    L = math.log(1.0 / delta)
    Cv = g * np.diag(np.abs(w)) - np.outer(w, w)
    lam = np.linalg.eigvalsh(Cv)[-1] / N
    U = max(np.sqrt(g**2 - 2.0 * g * abs(x) + w @ w) for x in w if x) / N
    E = e / np.sqrt(N)
    expected = {
        "Bousquet": E + np.sqrt(2.0 * L * (lam + 2.0 * U * E)) + U * L / 3.0,
        "Weissman": g * np.sqrt((np.log(2.0**4 - 2.0) + L) / N),
    }
    for bound in bounds.candidates("vector", w):
        assert bound.radius(N, delta) == pytest.approx(expected[bound.name], rel=1e-12)
    one = bounds.bound("Weissman", "vector", w, norm="1").radius(N, delta)
    assert one == pytest.approx(g * np.sqrt(2.0 * (np.log(14.0) + L) / N), rel=1e-12)


@pytest.mark.parametrize("axis", AXES)
def test_matrix_formulas(axis):
    A = np.array([[1.0, -2.0, 0.5], [0.5, 3.0, 0.0], [-1.0, 0.0, 0.0]])
    lines = A if axis == "columns" else A.T
    N, delta = 500, 0.05
    L = math.log(1.0 / delta)
    random = lines[:, np.count_nonzero(lines, axis=0) > 1]  # the others are exact
    g, squares = np.abs(random).sum(axis=0), (random**2).sum(axis=0)
    E = np.sqrt((g**2 - squares).sum() / N)
    top = [
        np.linalg.eigvalsh(h * np.diag(np.abs(a)) - np.outer(a, a))[-1]
        for h, a in zip(g, random.T, strict=True)
    ]
    far = [
        max(h**2 - 2.0 * h * abs(x) + s for x in a if x)
        for h, s, a in zip(g, squares, random.T, strict=True)
    ]
    U = np.sqrt(sum(far)) / N
    found = {b.name: b.radius(N, delta) for b in bounds.candidates("matrix", A, axis=axis)}
    bousquet = E + np.sqrt(2.0 * L * (max(top) / N + 2.0 * U * E)) + U * L / 3.0
    assert found["Bousquet"] == pytest.approx(bousquet, rel=1e-12)
    used = random[random.any(axis=1)]
    ell = math.log(sum(used.shape) / delta)
    total = np.diag(np.abs(used) @ g) - used @ used.T
    v = max(np.linalg.norm(total, 2), (g**2 - squares).max()) / N
    linear = np.sqrt(max(far)) / N * ell / 3.0
    assert found["Bernstein"] == pytest.approx(linear + np.sqrt(linear**2 + 2 * v * ell), rel=1e-12)


def test_required_sizes_are_the_closed_formulas():
    w = np.array([1.0, -0.5, 0.25, 2.0, 0.75, -1.5, 0.1, 0.3, -0.9, 1.2])
    g, eps, delta = np.abs(w).sum(), 0.05 * np.linalg.norm(w), 0.01
    for bound in bounds.candidates("vector", w):
        needed = bound.required_size(eps, delta)
        if bound.name == "Weissman":
            L = math.log(1.0 / delta)
            assert needed == math.ceil(g**2 * (math.log(2.0**10 - 2.0) + L) / eps**2)
        assert bound.radius(needed, delta) <= eps < bound.radius(needed - 1, delta)
        assert bound.required_size(1e-12, delta) is None


# -- controls --------------------------------------------------------------------------------------

# B, x0, xf, A
CONTROLS = {
    "square": ([[1.0, 0.5], [-1.0, 2.0]], [1.0, -0.5], [0.5, 2.0], [[1.0, -2.0], [0.5, 3.0]]),
    "m < n": ([[1.0], [2.0]], [1.0, -0.5], [0.5, 2.0], [[1.0, -2.0], [0.5, 3.0]]),
    "cancelling": ([[1.0], [1.0]], [1.0, 1.0], [1.0, -1.0], [[1.0, 1.0], [1.0, -1.0]]),
    "zero column": ([[1.0], [2.0]], [1.0, -0.5], [0.0, 1.0], [[0.0, -2.0], [0.0, 3.0]]),
    "zero x0": ([[1.0], [2.0]], [0.0, 0.0], [0.5, 2.0], [[1.0, -2.0], [0.5, 3.0]]),
    "rank 1": ([[1.0, 2.0], [2.0, 4.0]], [1.0, -0.5], [0.5, 2.0], [[3.0, 0.0], [1.0, 0.1]]),
}
QUANTITIES = ("state", "control")


def errors_of(quantity, B, y):
    pinv = np.linalg.pinv(B)
    return (
        (lambda v: np.linalg.norm(pinv @ (v - y)))
        if quantity == "control"
        else (lambda v: np.linalg.norm(B @ pinv @ (v - y)))
    )


def product_law(x0, xf, A, sizes, axis):
    x0s, xfs = (
        [(1.0, np.asarray(w))] if N is None else vector_law(w, N)
        for w, N in ((x0, sizes[0]), (xf, sizes[1]))
    )
    As = [(1.0, np.asarray(A))] if sizes[2] is None else matrix_law(A, sizes[2], axis)
    return [(p * q * r, f - a @ z) for (p, z), (q, f), (r, a) in itertools.product(x0s, xfs, As)]


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("case", CONTROLS)
def test_product_fusion_on_exact_distributions(case, axis):
    B, x0, xf, A = (np.array(x) for x in CONTROLS[case])
    y = xf - A @ x0
    for size in (
        1,
        4,
        (5, None, 5),
        (None, None, 20),
        (20, None, None),
        (None, 20, None),
        (2, 5, 3),
    ):
        sizes = size if isinstance(size, tuple) else (size, size, size)
        law = product_law(x0, xf, A, sizes, axis)
        for quantity in QUANTITIES:
            errors, exceeded = tail(law, errors_of(quantity, B, y))
            for bound in bounds.candidates(quantity, (A, B), x0, xf, axis=axis):
                if bound.name == "Bousquet" and size == (2, 5, 3):
                    continue
                assert_valid(bound, sizes, errors, exceeded)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("case", CONTROLS)
def test_diagonal_fusion_on_exact_distributions(case, axis):
    B, x0, xf, A = (np.array(x) for x in CONTROLS[case])
    y = xf - A @ x0
    for sizes in ((1, 1, 1), (1, None, 1), (1, 1, None), (None, 1, 1)):
        one = product_law(x0, xf, A, sizes, axis)
        one = merged(one)
        for N in (1, 3):
            law = [
                (math.prod(p for p, _ in draws), sum(v for _, v in draws) / N)
                for draws in itertools.product(one, repeat=N)
            ]
            size = tuple(None if k is None else N for k in sizes)
            for quantity in QUANTITIES:
                errors, exceeded = tail(law, errors_of(quantity, B, y))
                for bound in bounds.candidates(
                    quantity, (A, B), x0, xf, fusion="diagonal", axis=axis
                ):
                    assert_valid(bound, size, errors, exceeded)


def merged(law):
    """Only one of equal values."""
    found = {}
    for p, v in law:
        key = tuple(np.round(v, 9))
        found[key] = (found.get(key, (0.0, v))[0] + p, v)
    return list(found.values())


def test_the_smallest_formula_is_taken_where_nothing_can_be_simulated():
    B, x0, xf, A = CONTROLS["square"]
    data = (A, B), x0, xf
    for quantity, size, fusion in itertools.product(
        QUANTITIES, (5, 10**4, (10, 20, 30), (None, 7, None)), ("product", "diagonal")
    ):
        if fusion == "diagonal" and size == (10, 20, 30):
            continue
        found = bounds.candidates(quantity, *data, fusion=fusion)
        if size == (10, 20, 30):
            found = [b for b in found if b.name != "Bousquet"]
        for delta in (0.5, 0.01, 1e-9):
            radius, name = drawn_bound(quantity, *data, size=size, delta=delta, fusion=fusion)
            smallest = min(found, key=lambda b, N=size, d=delta: b.radius(N, d))
            if delta > 1e-4:
                assert name == "simulated"
                assert radius < smallest.radius(size, delta)
            else:
                assert (radius, name) == (smallest.radius(size, delta), smallest.name)


# -- the largest error that can happen at all ------------------------------------------------------


def assert_capped(bound, size, largest, at_most=1.0):
    """For a tiny delta the radius is the largest error, or up to `at_most` times that."""
    radius = bound.radius(size, 5e-324)
    assert largest <= radius <= at_most * largest * (1.0 + 1e-9) + 1e-12, bound


@pytest.mark.parametrize("N", [1, 2, 3])
def test_estimates_are_capped_at_their_largest_error(N):
    for w in (*VECTORS, [0.0, -2.0]):
        off = [v - w for _, v in vector_law(w, N)]
        for norm, order in (("2", 2), ("1", 1)):
            largest = max(np.linalg.norm(v, order) for v in off)
            for bound in bounds.candidates("vector", w, norm=norm):
                assert_capped(bound, N, largest)
    for A, axis in itertools.product((*MATRICES, [[2.0, 0.0], [0.0, 1.0]]), AXES):
        off = [v - A for _, v in matrix_law(A, N, axis)]
        for norm, order in (("Frobenius", None), ("spectral", 2)):
            largest = max(np.linalg.norm(v, order) for v in off)
            for bound in bounds.candidates("matrix", A, norm=norm, axis=axis):
                # spectral: capped by the Frobenius norm
                assert_capped(bound, N, largest, 1.0 if order is None else math.sqrt(2.0))


def test_without_randomness_every_radius_is_zero():
    nothing = [0.0, 0.0]
    for w in (nothing, [0.0, -3.0], [2.0]):
        for norm in ("2", "1"):
            for bound in bounds.candidates("vector", w, norm=norm):
                assert bound.radius(1, 1e-12) == 0.0
                assert bound.required_size(1e-300, 1e-12) == 1
        for scheme in ("iid", "systematic"):
            assert drawn_bound("vector", w, size=1, delta=0.1, scheme=scheme) == (0.0, "exact")
    for A in (np.zeros((2, 2)), np.diag([1.0, -2.0])):
        for bound in bounds.candidates("matrix", A):
            assert bound.radius(1, 1e-12) == 0.0
    B, x0, xf, A = CONTROLS["square"]
    for quantity, fusion in itertools.product(QUANTITIES, ("product", "diagonal")):
        for M in (A, np.zeros((2, 2))):
            for bound in bounds.candidates(quantity, (M, B), nothing, nothing, fusion=fusion):
                assert bound.radius(3, 1e-6) == 0.0, bound
        for bound in bounds.candidates(quantity, (A, B), x0, xf, fusion=fusion):
            assert bound.radius(None, 1e-6) == bound.radius((None, math.inf, None), 1e-6) == 0.0
        data = (A, B), x0, xf
        assert drawn_bound(quantity, *data, size=None, delta=0.1, fusion=fusion) == (0.0, "exact")
        for bound in bounds.candidates(quantity, (A, np.zeros((2, 1))), x0, xf, fusion=fusion):
            assert bound.radius(3, 0.1) == 0.0  # no control, no error


@pytest.mark.parametrize("scale", [1e-150, 1e150])
def test_units(scale):
    B, x0, xf, A = (np.array(x) for x in CONTROLS["square"])
    for quantity, fusion in itertools.product(QUANTITIES, ("product", "diagonal")):
        pairs = zip(
            bounds.candidates(quantity, (A, B), x0, xf, fusion=fusion),
            bounds.candidates(quantity, (A, B), scale * x0, scale * xf, fusion=fusion),
            bounds.candidates(quantity, (A * scale, B * scale), x0, xf * scale, fusion=fusion),
            strict=True,
        )
        for plain, states, matrices in pairs:
            radius = plain.radius(50, 0.1)
            assert states.radius(50, 0.1) == pytest.approx(scale * radius, rel=1e-9)
            factor = scale if quantity == "state" else 1.0
            assert matrices.radius(50, 0.1) == pytest.approx(factor * radius, rel=1e-9)
    for quantity, data in (("vector", x0), ("matrix", A)):
        for plain, scaled in zip(
            bounds.candidates(quantity, data),
            bounds.candidates(quantity, scale * data),
            strict=True,
        ):
            assert scaled.radius(7, 0.1) == pytest.approx(scale * plain.radius(7, 0.1), rel=1e-9)


# -- the paper's formulas --------------------------------------------------------------------------
