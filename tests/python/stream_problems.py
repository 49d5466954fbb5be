"""Shared by the tests of streams: the problem, and every kind of stream."""

from __future__ import annotations

import numpy as np

import stochens_rs as se

SLOTS = ("x0", "xf", "A", "slots")
# safeguard, slots
OPTIONS = [(False, "random"), (True, "random"), (False, "round-robin"), (True, "gain")]


def system(seed, n=10, m=5):
    """A Gaussian system with spectral radius 1: A, B, x0, xf."""
    gen = np.random.default_rng(seed)
    A = gen.standard_normal((n, n))
    A /= np.abs(np.linalg.eigvals(A)).max()
    return A, gen.standard_normal((n, m)), gen.standard_normal(n), gen.standard_normal(n)


A, B, X0, XF = system(3)


def make(seed, **options):
    return se.Stream((A, B), X0, XF, rng=seed, **options)


def same(a, b):
    """Two streams have the same state, bit for bit."""
    one, two = a._to_sections(), b._to_sections()
    return list(one) == list(two) and all(
        (one[k].dtype, one[k].tobytes()) == (two[k].dtype, two[k].tobytes()) for k in one
    )
