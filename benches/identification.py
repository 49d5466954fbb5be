"""Identification from measured pairs: the core against LAPACK, the twin and vectorised NumPy.

10 states and 5 inputs unless it says so. The core is called with arrays as `identify` makes them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from stochens_rs import ModelStream
from stochens_rs import _core as core

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "python"))
from twin import certified_control
from twin import triangle as twin

Line = tuple[str, str, Callable[[], object], float, Callable[[], object], float]


def identification() -> Iterator[Line]:
    gen = np.random.default_rng(0)
    rows = gen.standard_normal((1_000_000, 25))
    yield (
        "triangle of 1e6 pairs",
        "NumPy qr(mode='r')",
        lambda: core.triangle(rows, 1),
        1,
        lambda: np.linalg.qr(rows, mode="r"),
        1,
    )
    few = [rows[i : i + 1] for i in range(2000)]
    r = np.zeros((25, 25))

    def update() -> None:
        for row in few:
            core.triangle_update(r, row)

    def update_by_qr() -> None:
        R = np.zeros((25, 25))
        for row in few[:200]:
            R = np.linalg.qr(np.vstack([R, row]), mode="r")

    yield "triangle updated by one pair", "NumPy qr(mode='r')", update, 2000, update_by_qr, 200
    x, u, y = (np.ascontiguousarray(part) for part in np.hsplit(rows[:200_000], [10, 15]))
    stream = ModelStream(10, 5)

    def feed() -> None:
        for k in range(0, len(x), 100):
            stream.update(x[k : k + 100], u[k : k + 100], y[k : k + 100])

    def feed_by_sums() -> None:
        V, M = np.zeros((15, 15)), np.zeros((15, 10))
        for k in range(5000):
            z = np.concatenate([x[k], u[k]])
            V += z[:, None] * z
            M += z[:, None] * y[k]

    what = "a pair into ModelStream, in batches of 100"
    yield what, "NumPy loop over pairs, sums of products", feed, len(x), feed_by_sums, 5000


def fitted_pairs(gen: np.random.Generator, N: int) -> tuple[np.ndarray, np.ndarray, twin.Fitted]:
    n, d = 10, 15
    Z = gen.standard_normal((N, d))
    Y = Z @ gen.standard_normal((d, n)) + gen.standard_normal((N, n))
    return Z, Y, twin.fit(twin.triangle(Z, Y))


def certificates() -> Iterator[Line]:
    gen = np.random.default_rng(0)
    Z, Y, fitted = fitted_pairs(gen, 1000)
    (_, d), n = Z.shape, Y.shape[1]
    H, white = (np.ascontiguousarray(part) for part in (fitted.H, fitted.white))
    x0, u = gen.standard_normal(n), gen.standard_normal((6, d - n))
    wide, missing = np.ascontiguousarray(fitted.root), np.ascontiguousarray(fitted.missing)
    shape = np.ascontiguousarray(fitted.S)
    rows, columns = np.arange(n), np.arange(d)
    part = core.RegionPart(rows, columns, white, wide, missing, fitted.ratio, shape, 1.1**2)
    region = core.Region(H, d - n, (part,), 2.0, False)
    yield (
        "certificate of 6 steps",
        "NumPy twin",
        lambda: region.errors(x0, u, 0.1, None),
        1,
        lambda: certified_control.several_steps(
            fitted, x0, u, spectral=1.1, frobenius=2.0, rho0=0.1
        ),
        1,
    )
