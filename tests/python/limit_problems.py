"""Random least-squares problems over limits, of unlike kinds, for the tests of the twin."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from twin.limited_problems import Problem, one_step

KINDS = ("plain", "sparse", "zero columns", "ill-conditioned", "singular weight", "one input")
WAYS = ("loose", "half", "tight", "one-sided", "fixed inputs")


def weight(gen, size, rank=None):
    """A positive semidefinite matrix of full or given rank."""
    X = gen.normal(size=(size, size if rank is None else rank))
    return X @ X.T


def draw_map(gen, kind, n, d):
    G = gen.normal(size=(n, d))
    if kind == "sparse":
        G *= gen.random((n, d)) < 0.4
    if kind == "zero columns":
        G[:, gen.random(d) < 0.5] = 0.0
    if kind == "ill-conditioned":
        G *= 10.0 ** gen.uniform(-4, 2, size=d)
    return G


def draw_box(gen, way, d, size):
    low, high = -size * gen.random(d), size * gen.random(d)
    if way == "loose":
        low, high = 100.0 * low, 100.0 * high
    if way == "tight":
        low, high = 1e-2 * low, 1e-2 * high
    if way == "one-sided":
        low = np.where(gen.random(d) < 0.7, -np.inf, low)
        high = np.where(gen.random(d) < 0.5, np.inf, high)
    if way == "fixed inputs":
        low = np.where(gen.random(d) < 0.5, high, low)
    return low, high


def draw(gen, index) -> Problem:
    """One problem; kind and limits go round with `index`."""
    kind, way = KINDS[index % len(KINDS)], WAYS[index % len(WAYS)]
    n, d = gen.integers(1, 6), 1 if kind == "one input" else gen.integers(1, 5)
    Q = weight(gen, n, max(1, n // 2)) if kind == "singular weight" else weight(gen, n)
    if gen.random() < 0.3:
        Q = np.eye(n)
    G, b = draw_map(gen, kind, n, d), 3.0 * gen.normal(size=n)
    R = 10.0 ** gen.uniform(-6, 1) * np.diag(gen.uniform(0.5, 2.0, size=d))
    if kind == "one input":
        R = G.T @ Q @ G * np.eye(1) * 10.0 ** gen.uniform(-1, 1) + 1e-9
    low, high = draw_box(gen, way, d, 1.0)
    return one_step(G, b, Q=Q, R=R, low=low, high=high)


def draws(gen, count) -> Iterator[Problem]:
    return (draw(gen, i) for i in range(count))


def draw_steps(gen, index):
    """(A, B, x0, K, the other arguments of `several_steps`), with rates every other time."""
    n, m, K = gen.integers(1, 4), gen.integers(1, 3), int(gen.integers(2, 5))
    A = gen.normal(size=(n, n)) / np.sqrt(n) * (gen.random((n, n)) < 0.8)
    B = draw_map(gen, KINDS[index % 4], n, m)
    low, high = draw_box(gen, WAYS[index % 4], m, 1.0)
    more = {
        "Q": weight(gen, n) if index % 3 else None,
        "Qf": weight(gen, n),
        "R": 10.0 ** gen.uniform(-4, 1),
        "low": low,
        "high": high,
    }
    if index % 2:
        more |= {"rate": gen.uniform(0.1, 1.0, size=m), "previous": np.clip(np.zeros(m), low, high)}
    if index % 5 == 0:
        more |= {"S": 0.3}
    return A, B, 3.0 * gen.normal(size=n), K, more
