"""Print the table of docs/few-bits.md: three ways to spend 8 bits per node."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
N, n, DRAWS = 12_500, 100, 20


def one_index(own: Floats, rng: np.random.Generator) -> Floats:
    """Node k sends an entry, drawn in proportion to its size, and its sign; ||x_k||_1 is known."""
    sums = np.abs(own).cumsum(axis=1)
    at = np.argmax(sums > rng.random((len(own), 1)) * sums[:, -1:], axis=1)
    values = sums[:, -1] * np.sign(own[np.arange(len(own)), at])
    return np.bincount(at, values, n) / len(own)


def rotated_signs(own: Floats, rng: np.random.Generator) -> Floats:
    """Node k sends signs of 8 coordinates after a common rotation, right in the mean."""
    rotation = np.linalg.qr(rng.standard_normal((n, n)))[0]
    turned = own @ rotation.T
    node, at = np.repeat(np.arange(len(own)), 8), np.arange(8 * len(own)) % n
    most = np.abs(turned).max()
    plus = 2.0 * most * rng.random(len(at)) < most + turned[node, at]
    return rotation.T @ (np.bincount(at, np.where(plus, most, -most)) / np.bincount(at))


def by_number(own: Floats, rng: np.random.Generator) -> Floats:
    """Node k sends its entry k mod n, rounded at random to 8 bits of a common scale."""
    k, step = np.arange(len(own)), np.abs(own).max() / 127
    values = step * np.floor(own[k, k % n] / step + rng.random(len(own)))
    return np.bincount(k % n, values) / np.bincount(k % n)


def main() -> None:
    """Print the relative mean square errors."""
    rng = np.random.default_rng(1)
    x = rng.standard_normal(n)
    cases = {
        "all know the same vector, dense": np.tile(x, (N, 1)),
        "all know the same vector, 5 entries not 0": np.tile(
            np.where(np.arange(n) < 5, x, 0), (N, 1)
        ),
        "each has a sparse histogram of its own": rng.dirichlet(np.full(n, 0.03), N),
    }
    for name, own in cases.items():
        mean = own.mean(axis=0)
        for way in (one_index, rotated_signs, by_number):
            squares = [np.sum((way(own, rng) - mean) ** 2) for _ in range(DRAWS)]
            print(f"{name}, {way.__name__}: {np.mean(squares) / np.sum(mean**2):.1e}")


if __name__ == "__main__":
    main()
