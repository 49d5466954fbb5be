"""`Plan.typical` from the definition: models of the law of the estimate, and where each ends."""

from __future__ import annotations

from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[np.float64]]


def law_root(S: Array, kind: str, nu: int, gen: np.random.Generator) -> Array:
    """A draw of R: ``Sigma^1/2``, or ``S^1/2 E^-1/2`` with E of Wishart's law, and its families."""
    n = len(S)
    if kind == "known":
        return np.linalg.cholesky(S)
    if kind == "scalar":
        return np.sqrt(np.trace(S) / gen.chisquare(n * nu)) * np.eye(n)
    if kind == "diagonal":
        return np.diag(np.sqrt(np.diag(S) / gen.chisquare(nu, n)))
    G = gen.standard_normal((n, nu))
    values, vectors = np.linalg.eigh(G @ G.T)
    return np.linalg.cholesky(S) @ (vectors / np.sqrt(values)) @ vectors.T


def misses(
    law: tuple[Array, Array, Array, str, int],
    x0: Array,
    u: Array,
    xf: Array,
    noise: bool,
    size: int,
    gen: np.random.Generator,
) -> Array:
    """``||x(K) - xf||`` of `size` draws of ``H + R G white``, with noise ``R g(k)`` if asked."""
    H, white, S, kind, nu = law
    found = np.empty(size)
    for i in range(size):
        R = law_root(S, kind, nu, gen)
        Theta = H + R @ gen.standard_normal((len(H), len(white))) @ white
        x = x0
        for row in u:
            z = np.concatenate([x, row, np.ones(H.shape[1] - len(x) - len(row))])
            x = Theta @ z + noise * (R @ gen.standard_normal(len(H)))
        found[i] = np.linalg.norm(x - xf)
    return found
