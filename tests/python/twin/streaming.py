"""Algorithm 1 of the paper in its three readings, with dense matrices and v as printed.

Slots are numbered 0 (x0), 1 (xf), 2 (A). Realization k of a slot is realization k of its sample
under the slot's key; the slot that moves in step k is realization k of the vector (1, 1, 1).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stochens_rs.reference.fusing import line_search
from stochens_rs.reference.sampling import atoms, dense, sample_indices

Array = NDArray[np.float64]


class Streamed(NamedTuple):
    """One row or entry per step, the start included."""

    controls: Array  # (steps + 1, m)
    certificates: Array  # (steps + 1,)
    errors: Array  # (steps + 1,), ||B (v - v*)||
    sizes: Array  # (steps + 1,), the step sizes t, 1 at the start
    estimates: list[Array]  # F0, Ff, FA at the end
    counts: list[int]


def realizations(target: Array, size: int, key: bytes) -> Array:
    """The first `size` realizations of a slot."""
    return dense(sample_indices(target, size, key=key), atoms(target))


def gains(F: list[Array], targets: list[Array], A: Array) -> Array:
    """Guaranteed mean decrease of one step: d^4 / (V + d^2), in units of the state."""
    factors = np.array([np.linalg.norm(A, 2), 1.0, np.linalg.norm(F[0])])
    out = np.zeros(3)
    for i, (f, w) in enumerate(zip(F, targets, strict=True)):
        d2 = np.sum((f - w) ** 2)
        V = np.sum(np.sum(np.abs(w), axis=0) ** 2) - np.sum(w * w)  # sum_j g_j^2 - ||a_j||^2
        out[i] = factors[i] ** 2 * d2 * (d2 / (V + d2)) if d2 > 0.0 else 0.0
    return out


def stream(
    B: ArrayLike,
    x0: ArrayLike,
    xf: ArrayLike,
    A: ArrayLike,
    *,
    keys: list[bytes],
    steps: int,
    safeguard: bool = False,
    slots: str = "random",
) -> Streamed:
    """`steps` steps from the first realization of each slot; `keys`: of x0, xf, A, the choice."""
    B_, A_ = np.asarray(B, dtype=np.float64), np.asarray(A, dtype=np.float64)
    targets = [np.asarray(x0, dtype=np.float64), np.asarray(xf, dtype=np.float64), A_]
    pinv = np.linalg.pinv(B_)
    P = B_ @ pinv
    order = sample_indices(np.ones(3), max(steps, 1), key=keys[3])[:, 0]
    samples = [realizations(w, steps + 1, k) for w, k in zip(targets, keys, strict=False)]
    v_star = pinv @ (targets[1] - A_ @ targets[0])

    def control(E0: Array, Ef: Array, EA: Array) -> Array:
        return pinv @ (Ef - EA @ E0)

    F = [E[0] for E in samples]
    total = [E[0] for E in samples]
    counts = [1, 1, 1]
    v = control(*F)
    controls, certificates, errors, sizes = [], [], [], [1.0]
    for k in range(steps + 1):
        controls.append(v)
        apart = P @ ((F[1] - targets[1]) - A_ @ (F[0] - targets[0]))
        certificates.append(
            np.linalg.norm(apart) + np.linalg.norm(F[2] - A_) * np.linalg.norm(F[0])
        )
        errors.append(np.linalg.norm(B_ @ (v - v_star)))
        if k == steps:
            break
        i = int(order[k])
        if slots == "round-robin":
            i = k % 3
        if slots == "gain":
            gain = gains(F, targets, A_)
            i = int(np.argmax(gain)) if gain.max() > 0.0 else k % 3
        E = samples[i][counts[i]]
        counts[i] += 1
        # the new realization in its slot, the estimates in the others
        t = line_search(F[i], E, targets[i])
        v = (1.0 - t) * v + t * control(*[*F[:i], E, *F[i + 1 :]])
        F[i] = (1.0 - t) * F[i] + t * E
        if safeguard:  # the same once more, towards the mean of the slot's realizations
            total[i] = total[i] + E
            U = total[i] / counts[i]
            s = line_search(F[i], U, targets[i])
            v = (1.0 - s) * v + s * control(*[*F[:i], U, *F[i + 1 :]])
            F[i] = (1.0 - s) * F[i] + s * U
        sizes.append(t)
    return Streamed(
        np.array(controls),
        np.array(certificates),
        np.array(errors),
        np.array(sizes),
        F,
        counts,
    )


def mean_radius(
    samples: ArrayLike, diameter: float, delta: float, size: int | None = None
) -> float:
    """Radius of ||mean - mu|| for all N at once with probability 1 - delta.

    Two of the N independent realizations are at most `diameter` =: R apart. The radius is the
    largest x <= R for which some sigma <= R / sqrt(2) satisfies
    x <= R l / (3 N) + w sqrt(2 l / N) sigma with l = log(2 / (0.75 delta)), and
    sigma^2 - 2 b sigma <= D^2 / N + x^2 with b = w R sqrt(log(4 / delta) / (2 N)); both are
    iterated from above. Without `size`: epochs 4^k <= N < 4^(k + 1) with m = 2 4^k and
    delta / (k (k + 1)).
    """
    E = np.asarray(samples, dtype=np.float64).reshape(len(np.asarray(samples)), -1)
    R, N = diameter, len(E)
    if N == 1 or R == 0.0:
        return R
    if size is None:
        k = max(k for k in range(64) if 4**k <= N)
        if k == 0:
            return R
        size, delta = 2 * 4**k, delta / (k * (k + 1))
    w = (np.sqrt(N / size) + np.sqrt(size / N)) / 2
    mean, variance = np.log(2 / (0.75 * delta)), np.log(1 / (0.25 * delta))
    b = w * R * np.sqrt(variance / (2 * N))
    spread = np.mean(np.sum((E - E.mean(axis=0)) ** 2, axis=1))
    x, sigma = R, R / np.sqrt(2.0)  # 2 V = E ||E - E'||^2 <= R^2
    while True:
        before = x, sigma
        x = min(x, R * mean / (3 * N) + w * np.sqrt(2 * mean / N) * sigma)
        sigma = min(sigma, b + np.sqrt(b * b + spread + x * x))
        if (x, sigma) == before:
            return float(x)
