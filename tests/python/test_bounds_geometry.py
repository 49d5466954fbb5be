"""The constants behind the bounds of a control, against all atoms of small degenerate systems.

Zero columns and rows, zero entries, entries of equal size, inputs of any rank: every realization
is enumerated, so that a diameter or a reach that is too small by anything but rounding is seen.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import tail_bounds as bounds
from stochens_rs import _core

QUANTITIES = ("state", "control")
SLIGHTLY = 1.0 - 1e-9
ENTRIES = np.array([0.0, 0.0, 0.0, 0.0, 1.0, -1.0, 2.0, -0.5, 3.0])


def small_systems(count, seed):
    """B, x0, xf, A with n <= 4, about half of all entries 0."""
    gen = np.random.default_rng(seed)
    for _ in range(count):
        n, m = gen.integers(1, 5, size=2)
        if gen.random() < 0.3:
            B = gen.choice(ENTRIES, (n, 1)) @ gen.choice(ENTRIES, (1, m))
        else:
            B = gen.choice(ENTRIES, (n, m))
        x0, xf, A = gen.choice(ENTRIES, n), gen.choice(ENTRIES, n), gen.choice(ENTRIES, (n, n))
        if gen.random() < 0.3:
            A[:, gen.integers(n)] = 0.0
        yield B, x0, xf, A


def atoms(w):
    """The values that one realization of w takes, one per column, and their probabilities."""
    g, hit = np.abs(w).sum(), np.flatnonzero(w)
    if hit.size == 0:
        return np.zeros((len(w), 1)), np.ones(1)
    return (g * np.sign(w) * np.eye(len(w)))[:, hit], np.abs(w)[hit] / g


def products(x0, A, axis):
    """The values of A^s x0^s, one per column, and their probabilities."""
    starts, weights = atoms(x0)
    values, p = [], []
    for start, weight in zip(starts.T, weights, strict=True):
        if axis == "columns":  # the one column that x0^s hits
            column, q = atoms(A[:, start != 0.0].sum(axis=1))
            values.append(start.sum() * column)
            p.append(weight * q)
        else:  # row i gives one of the values of rho_i sign(a_ij) x_j
            rows = [(start @ row, q) for row, q in map(atoms, A)]
            values.append(np.array(list(itertools.product(*(v for v, _ in rows)))).T)
            chances = itertools.product(*(q for _, q in rows))
            p.append(weight * np.array([np.prod(q) for q in chances]))
    return np.hstack(values), np.concatenate(p)


def image(B, quantity):
    """The factor of the error of xf_hat - A_hat x0_hat."""
    pinv = np.linalg.pinv(B)
    return B @ pinv if quantity == "state" else pinv


def core(B, x0, xf, A, axis, quantity):
    """The constants of the core, and what gives its measures."""
    args = axis == "rows", quantity == "control", False
    found = _core.TailBounds(*map(np.ascontiguousarray, (A, B, x0, xf)), *args)
    return found.constants(), found.measures


def diameter(points):
    return np.sqrt(((points[:, :, None] - points[:, None, :]) ** 2).sum(axis=0).max())


def reach(points, centre):
    return np.sqrt(((points - centre[:, None]) ** 2).sum(axis=0).max())


# -- what one realization of xf and of A^s x0^s can be ---------------------------------------------


def largest_of_each_sign(at):
    """A mutant: without the zero atom, and without the smaller atoms of the same row and sign."""
    A, x0, M = at["A"], at["x0"], at["images"].T
    moved = at["g0"] * np.abs(A).sum(axis=0) * np.sign(A) * np.sign(x0)
    up, down = moved.max(axis=1), moved.min(axis=1)
    z = np.hstack([M[:, up > 0.0] * up[up > 0.0], M[:, down < 0.0] * down[down < 0.0]])
    empty = z.shape[1] == 0
    at["reach_z"] = 0.0 if empty else reach(z, M @ (A @ x0))


def wrong_ranges(systems, axis, mutate=None):
    """Number of systems in which a constant differs from that of the atoms; by rows: is smaller."""
    wrong = dict.fromkeys(("D_f", "reach_z"), 0)
    for k, (B, x0, xf, A) in enumerate(systems):
        quantity = QUANTITIES[k % 2]
        M, (at, _) = image(B, quantity), core(B, x0, xf, A, axis, quantity)
        if mutate is not None:
            mutate(at)
        z = M @ products(x0, A, axis)[0]
        exact = diameter(M @ atoms(xf)[0]), reach(z, M @ (A @ x0))
        for name, value in zip(wrong, exact, strict=True):
            found, allowed = at[name] * at["unit"], 1e-7 * (1.0 + value)
            # by rows the atoms of A^s x0^s are in a ball: known from above only
            above = axis == "rows" and name != "D_f"
            wrong[name] += not -allowed <= found - value <= (np.inf if above else allowed)
    return wrong


@pytest.mark.parametrize(("axis", "count"), [("columns", 4000), ("rows", 500)])
def test_ranges_of_paired_realizations(axis, count):
    assert not any(wrong_ranges(small_systems(count, 1), axis).values())


def test_atoms_that_are_left_out_are_seen():
    found = wrong_ranges(small_systems(500, 1), "columns", largest_of_each_sign)
    assert found["D_f"] == 0
    assert found["reach_z"] > 3


# -- what an average over A can be -----------------------------------------------------------------


@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("axis", ["columns", "rows"])
def test_ranges_of_A(axis, quantity):
    """reach_A, range_A and its cap and slope, D_0 and the mean squares: every realization of A."""
    gen = np.random.default_rng(2)
    for B, x0, xf, A in small_systems(150, 3):
        M, (at, measures) = image(B, quantity), core(B, x0, xf, A, axis, quantity)
        unit, unit_x0 = at["unit"], at["unit_x0"]
        unit_A = unit_x0 / unit  # of ||M A|| where x0 has its unit
        lines = A.T if axis == "columns" else A
        drawn = [atoms(line) for line in lines]
        As = np.array([
            np.array(k).T if axis == "columns" else np.array(k)
            for k in itertools.product(*(values.T for values, _ in drawn))
        ])  # fmt: skip
        p = np.array([np.prod(q) for q in itertools.product(*(q for _, q in drawn))])
        off = (As - A) @ x0 @ M.T
        assert at["reach_A"] * unit >= np.linalg.norm(off, axis=1).max() * SLIGHTLY - 1e-9
        exact = p @ (off**2).sum(axis=1)
        mean_square, most, _ = measures((0.0, 0.0, 1.0), at["x0"])
        assert mean_square * unit**2 == pytest.approx(exact, abs=1e-9)

        def ranges(x, M=M, drawn=drawn):
            """Root of the summed squared diameters of the lines of A^s times x."""
            if axis == "columns":
                each = [diameter(M @ v * x[j]) for j, (v, _) in enumerate(drawn)]
            else:
                each = [diameter(np.outer(M[:, i], x @ v)) for i, (v, _) in enumerate(drawn)]
            return np.sqrt(np.square(each).sum())

        starts, weights = atoms(x0)
        mixed = [starts @ gen.dirichlet(np.ones(len(weights))) for _ in range(2)]
        for x in (x0, *starts.T, *mixed):
            found = measures((0.0, 0.0, 1.0), x / unit_x0)[1] * unit
            cap = at["cap_A"] * unit
            assert ranges(x) * SLIGHTLY - 1e-9 <= found <= cap / SLIGHTLY + 1e-9
            grown = most * unit + at["slope_A"] / unit_A * np.linalg.norm(x - x0)
            assert found <= grown / SLIGHTLY + 1e-9
        # D_0^2: ||M A d||^2 + r E||M (A^s - A) d||^2 for the difference d of two atoms of x0
        for rate in (0.0, 0.2, 1.0):
            pairs = [0.0]
            for one, two in itertools.combinations(starts.T, 2):
                d = one - two
                extra = p @ (((As - A) @ d @ M.T) ** 2).sum(axis=1)
                pairs.append(np.sum((M @ A @ d) ** 2) + rate * extra)
            D_0_squared = measures((0.0, 0.0, rate), at["x0"])[2]
            found, exact = np.sqrt(D_0_squared) * unit, np.sqrt(max(pairs))
            assert found >= exact * SLIGHTLY - 1e-9
            if axis == "columns":
                assert found <= exact / SLIGHTLY + 1e-9


# -- coverage --------------------------------------------------------------------------------------

DELTAS = (0.5, 0.1, 0.01, 0.001)
SIZES = (1, 3, 10, 100, 1000)
R = 4000
COUNTEREXAMPLE = np.eye(2), np.ones(2), np.zeros(2), np.array([[1.0, 3.0], [0.0, 0.0]])


def averages(gen, law, N):
    """R averages of N draws, (R, n)."""
    values, p = law
    return gen.multinomial(N, p / p.sum(), size=R) @ values.T / N


def paired_errors(gen, x0, xf, A, N, axis):
    """xf_hat - z_hat - (xf - A x0) for paired realizations."""
    z = averages(gen, products(x0, A, axis), N)
    return averages(gen, atoms(xf), N) - z - (xf - A @ x0)


def fused_errors(gen, x0, xf, A, N, axis):
    """xf_hat - A_hat x0_hat - (xf - A x0) for averages of each entity."""
    lines = A.T if axis == "columns" else A
    drawn = np.stack([averages(gen, atoms(line), N) for line in lines], axis=1)
    order = "rji,rj->ri" if axis == "columns" else "rij,rj->ri"
    z = np.einsum(order, drawn, averages(gen, atoms(x0), N))
    return averages(gen, atoms(xf), N) - z - (xf - A @ x0)


def exceeded_too_often(errors, radius, delta):
    """More than 4 standard errors above delta: false alarms below 3e-5 per comparison.

    For delta = .001 the 4000 replicates may exceed a radius 12 times.
    """
    allowed = delta * len(errors) + 4.0 * np.sqrt(delta * (1.0 - delta) * len(errors))
    return int((errors > radius + 1e-12).sum()) > allowed


@pytest.mark.parametrize("axis", ["columns", "rows"])
@pytest.mark.parametrize("fusion", ["diagonal", "product"])
def test_coverage(fusion, axis):
    gen = np.random.default_rng(4)
    draw = paired_errors if fusion == "diagonal" else fused_errors
    for B, x0, xf, A in (COUNTEREXAMPLE, *small_systems(24, 5)):
        found = {
            quantity: bounds.candidates(quantity, (A, B), x0, xf, fusion=fusion, axis=axis)
            for quantity in QUANTITIES
        }
        for N in SIZES:
            y = draw(gen, x0, xf, A, N, axis)
            for quantity in QUANTITIES:
                errors = np.linalg.norm(y @ image(B, quantity).T, axis=1)
                for bound, delta in itertools.product(found[quantity], DELTAS):
                    radius = bound.radius(N, delta)
                    assert not exceeded_too_often(errors, radius, delta), (B, x0, xf, A, N, bound)


def test_the_zero_atom_and_the_smaller_ones_count():
    """A x0^s is (2, 0) or (6, 0): the mean of 100 is .2 or more away from (4, 0) in 36.8 %."""
    B, x0, xf, A = COUNTEREXAMPLE
    y = paired_errors(np.random.default_rng(6), x0, xf, A, 100, "columns")
    errors = np.linalg.norm(y, axis=1)
    bound = bounds.bound("Bousquet", "state", (A, B), x0, xf, fusion="diagonal")
    assert not exceeded_too_often(errors, bound.radius(100, 1e-3), 1e-3)
    chosen = bounds.best("state", (A, B), x0, xf, size=100, delta=1e-6, fusion="diagonal")
    # |Bin(100, 1/2) - 50| > 24 has probability 7e-7, > 23 has 1.9e-6: the quantile is 24 / 25
    assert 24 / 25 <= chosen < 2.0
