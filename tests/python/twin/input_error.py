"""Control of B u = b when B and b are estimates: what is certain of the state, and of the input.

b = xf - A x0. Fuse first, invert once: means of pseudoinverses are not the pseudoinverse of a mean
(`mean_pseudoinverse`), and for one state and one input they do not even exist.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .regions import Region, _times, radius

Array = NDArray[np.float64]


def input_bound(region: Region, x0: ArrayLike, u: ArrayLike, xf: ArrayLike) -> float:
    """||u - v||, v = pinv(B) (xf - A x0) the exact best input; infinite if B may lose rank.

    v - u = pinv(B) (b - B u), b - B u = r + (db - dB u), r = b-hat - B-hat u, and pinv(B) r =
    (B' B)^-1 (B-hat' r + (B - B-hat)' r). With s = sigma_min(B-hat) and ||B - B-hat|| <= eB < s:
    (||db - dB u|| + (||B-hat' r|| + eB ||r||) / (s - eB)) / (s - eB). For u = pinv(B-hat) b-hat
    the term B-hat' r is 0.
    """
    f = region.fitted
    x0, u, xf = (np.asarray(v, dtype=np.float64) for v in (x0, u, xf))
    n, m = len(f.H), len(u)
    B = f.H[:, n : n + m]
    z = np.concatenate([x0, u, np.ones(f.H.shape[1] - n - m)])
    r = xf - f.H @ z
    unseen = any(np.isinf(_times(1.0, f, e)) for e in np.eye(f.H.shape[1])[n : n + m])
    eB = np.inf if unseen else radius(region) * float(np.linalg.norm(f.white[:, n : n + m], 2))
    s = float(np.linalg.svd(B, compute_uv=False)[-1]) if m <= n else 0.0
    if not eB < s:
        return np.inf
    model = _times(radius(region), f, z)
    across = float(np.linalg.norm(B.T @ r)) + eB * float(np.linalg.norm(r))
    return float((model + across / (s - eB)) / (s - eB))


def mean_pseudoinverse(b: ArrayLike, s: float) -> Array:
    """E pinv(b + s g) for two states, one input and g standard normal: not pinv(b).

    b' / ||b||^2 (1 - exp(-||b||^2 / (2 s^2))), as x / ||x||^2 is harmonic but at 0.
    """
    b = np.asarray(b, dtype=np.float64)
    size = float(b @ b)
    return np.asarray(b / size * -np.expm1(-size / (2.0 * s * s)))
