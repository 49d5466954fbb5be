"""Exact errors of tracking a reference with a new estimate of A in every step.

With ``P = B B^+``, ``e = x - r`` and ``D_k = A_hat_k - A``: with feedback
``e(k+1) = (I - P) A e(k) + d(k) - P D_k x(k)``, without
``e(k+1) = A e(k) + d(k) - P D_k r(k)``; ``d(k) = (I - P)(A r(k) - r(k+1))``.
"""

from __future__ import annotations

import numpy as np


def covariance(w):
    """Cv(w), of one realization."""
    return np.abs(w).sum() * np.diag(np.abs(w)) - np.outer(w, w)


def excess(A, d):
    """T_A(d) = sum_j d_j Cv(a_j)."""
    return sum(x * covariance(a) for x, a in zip(d, A.T, strict=True))


def tracking_moments(system, reference, size, *, feedback=True, sample_states=False, x0=None):
    """E e(k) and E[e(k) e(k)^T]; `size` realizations in every step."""
    A, B = (system.A, system.B) if hasattr(system, "A") else map(np.asarray, system)
    r, n = np.asarray(reference), len(A)
    P = B @ np.linalg.pinv(B)
    F = A - P @ A if feedback else A
    mean = [(r[0] if x0 is None else np.asarray(x0)) - r[0]]
    second = [np.outer(mean[0], mean[0])]
    for k in range(len(r) - 1):
        d = (np.eye(n) - P) @ (A @ r[k] - r[k + 1])
        squares = r[k] ** 2
        if feedback:  # E[x x] entry by entry
            squares = np.diag(second[k]) + 2.0 * mean[k] * r[k] + squares
        C = excess(A, squares) / size
        if sample_states:
            C += (covariance(r[k + 1]) + A @ covariance(r[k]) @ A.T) / size
            C += excess(A, np.diag(covariance(r[k]))) / size**2
        moved = F @ mean[k]
        cross = np.outer(moved, d)
        mean.append(moved + d)
        second.append(F @ second[k] @ F.T + cross + cross.T + np.outer(d, d) + P @ C @ P)
    return np.array(mean), np.array(second)


def tracking_rms(*args, **options):
    """sqrt(E ||e(k)||^2)."""
    return np.sqrt(np.trace(tracking_moments(*args, **options)[1], axis1=1, axis2=2))
