"""The finite distributions of realizations of small problems, as (probability, value) pairs."""

from __future__ import annotations

import itertools

import numpy as np

TOLERANCE = 1e-12


def vector_atoms(w):
    """The realizations of a vector: ||w||_1 sign(w_i) e_i with probability |w_i| / ||w||_1."""
    w = np.asarray(w, dtype=float)
    gamma = np.abs(w).sum()
    if gamma == 0.0:
        return [(1.0, np.zeros_like(w))]
    unit = np.eye(w.size)
    return [(abs(x) / gamma, gamma * np.sign(x) * unit[i]) for i, x in enumerate(w) if x != 0.0]


def matrix_atoms(A, axis="columns"):
    """Every combination of one atom per line."""
    A = np.asarray(A, dtype=float)
    lines = A.T if axis == "columns" else A
    atoms = []
    for choice in itertools.product(*(vector_atoms(line) for line in lines)):
        value = np.array([atom for _, atom in choice])
        atoms.append((np.prod([p for p, _ in choice]), value.T if axis == "columns" else value))
    return atoms


def averages(atoms, size):
    """The averages of `size` independent draws."""
    return [
        (np.prod([p for p, _ in draws]), sum(value for _, value in draws) / size)
        for draws in itertools.product(atoms, repeat=size)
    ]


def mean_and_covariance(p, values):
    """Of rows with these probabilities."""
    assert abs(p.sum() - 1.0) < TOLERANCE
    mean = p @ values
    return mean, ((values - mean).T * p) @ (values - mean)


def close(found, expected):
    scale = max(1.0, float(np.abs(expected).max()))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=TOLERANCE * scale)
