"""The constants behind the bounds of a control, against all atoms of small degenerate systems.

Zero columns and rows, zero entries, entries of equal size, inputs of any rank: every realization
is enumerated, so that a diameter or a reach that is too small by anything but rounding is seen.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from stochens_rs.theory import bounds
from stochens_rs.theory.bounds._geometry import Geometry

ENTRIES = np.array([0.0, 0.0, 0.0, 0.0, 1.0, -1.0, 2.0, -0.5, 3.0])
SYSTEMS = 4000


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


def realizations(A, axis):
    """Every matrix that one realization of A can be."""
    lines = A.T if axis == "columns" else A
    for drawn in itertools.product(*(atoms(line)[0].T for line in lines)):
        yield np.array(drawn).T if axis == "columns" else np.array(drawn)


def products(x0, A, axis):
    """The values of A^s x0^s, one per column: what a realization of A makes of an atom of x0."""
    starts = atoms(x0)[0]
    if axis == "columns":
        return np.hstack(
            [s.sum() * atoms(A[:, np.flatnonzero(s)].sum(axis=1))[0] for s in starts.T]
        )
    found = []
    for start in starts.T:  # row i gives one of the values of rho_i sign(a_ij) x_j
        values = [np.unique(start @ atoms(row)[0]) for row in A]
        found += list(itertools.product(*values))
    return np.array(found).T


def diameter(points):
    return np.sqrt(((points[:, :, None] - points[:, None, :]) ** 2).sum(axis=0).max(initial=0.0))


def reach(points, centre):
    return np.sqrt(((points - centre[:, None]) ** 2).sum(axis=0).max(initial=0.0))


def in_units(at, quantity, B):
    """The map M of the error and the factors of D_f, D_z in the units of the data."""
    pinv = np.linalg.pinv(B)
    return (B @ pinv if quantity == "state" else pinv), at.unit


def wrong_ranges(systems, axis, quantity):
    """Number of systems in which a constant is smaller, or (columns) larger, than the atoms say."""
    wrong = dict.fromkeys(("D_f", "D_z", "reach_z"), 0)
    for B, x0, xf, A in systems:
        at = Geometry(B, x0, xf, A, axis, quantity)
        M = B @ np.linalg.pinv(B) if quantity == "state" else np.linalg.pinv(B)
        z = M @ products(x0, A, axis)
        for name, exact in (
            ("D_f", diameter(M @ atoms(xf)[0])),
            ("D_z", diameter(z)),
            ("reach_z", reach(z, M @ (A @ x0))),
        ):
            found = getattr(at, name) * at.unit
            allowed = 1e-7 * (1.0 + exact)
            above = axis == "rows" and name != "D_f"  # a ball around the atoms: from above only
            wrong[name] += not -allowed <= found - exact <= (np.inf if above else allowed)
    return wrong


@pytest.mark.parametrize("quantity", ["state", "control"])
def test_ranges_of_paired_realizations_by_columns(quantity):
    found = wrong_ranges(small_systems(SYSTEMS, 1), "columns", quantity)
    assert found == {"D_f": 0, "D_z": 0, "reach_z": 0}
