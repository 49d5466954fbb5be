"""One-step controls from realizations, and their errors.

x(1) = A x0 + B u. With the pseudoinverse B+ and the projector P = B B+, the control of one
realization is u_s = B+(xf_s - A_s x0_s). `diagonal` fusion averages these; `product` fusion
computes B+(xf_hat - A_hat x0_hat) from the averaged entities.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Reachability(NamedTuple):
    """residual = ||(I - P)(xf - A x0)||, relative to ||xf - A x0|| (0 if that is 0); rank of B."""

    residual: float
    relative: float
    rank: int


class PlanError(NamedTuple):
    """See `plan_error`; a relative error whose reference is 0 is nan."""

    control: float
    control_relative: float
    state: float
    state_relative: float
    residual: float


def _cutoff(B: Array) -> float:
    """Singular values up to eps * max(n, m) times the largest count as 0."""
    return float(np.finfo(float).eps * max(B.shape))


def pinv(B: ArrayLike) -> Array:
    """The Moore-Penrose inverse (m, n), with the cutoff eps * max(n, m) * sigma_max."""
    M = np.asarray(B, dtype=np.float64)
    return np.asarray(np.linalg.pinv(M, rcond=_cutoff(M)), dtype=np.float64)


def realization_controls(A: ArrayLike, B: ArrayLike, x0: ArrayLike, xf: ArrayLike) -> Array:
    """u_s = B+(xf_s - A_s x0_s), (N, m), for samples A (N, n, n), x0 (N, n), xf (N, n)."""
    As, X0, Xf = (np.asarray(v, dtype=np.float64) for v in (A, x0, xf))
    y = Xf - np.einsum("sij,sj->si", As, X0)
    return np.asarray(y @ pinv(B).T)


def control(
    A: ArrayLike, B: ArrayLike, x0: ArrayLike, xf: ArrayLike, *, fusion: str = "product"
) -> Array:
    """The fused control, (m,).

    product: B+(xf - A x0) for estimates A (n, n), x0 (n,), xf (n,); samples, with one more axis
    in front, are averaged first. diagonal: the mean of the controls of the samples.
    """
    if fusion == "diagonal":
        return np.asarray(realization_controls(A, B, x0, xf).mean(axis=0))
    Ah, X0, Xf = (np.asarray(v, dtype=np.float64) for v in (A, x0, xf))
    X0 = X0.mean(axis=0) if X0.ndim == 2 else X0
    Xf = Xf.mean(axis=0) if Xf.ndim == 2 else Xf
    Ah = Ah.mean(axis=0) if Ah.ndim == 3 else Ah
    return np.asarray(pinv(B) @ (Xf - Ah @ X0))


def reachability(A: ArrayLike, B: ArrayLike, x0: ArrayLike, xf: ArrayLike) -> Reachability:
    """Distance of xf from the reachable states: mu = xf - A x0, residual = ||(I - B B+) mu||."""
    Ah, M, X0, Xf = (np.asarray(v, dtype=np.float64) for v in (A, B, x0, xf))
    mu = Xf - Ah @ X0
    residual = float(np.linalg.norm(mu - M @ (pinv(M) @ mu)))
    size = float(np.linalg.norm(mu))
    sigma = np.linalg.svd(M, compute_uv=False)
    rank = int(np.sum(sigma > _cutoff(M) * sigma[0]))
    return Reachability(residual, residual / size if size > 0.0 else 0.0, rank)


def plan_error(A: ArrayLike, B: ArrayLike, x0: ArrayLike, xf: ArrayLike, u: ArrayLike) -> PlanError:
    """Errors of a control u for the true system: v* = B+(xf - A x0), x_actual = A x0 + B v*.

    control = ||u - v*||, relative to ||v*||; state = ||B(u - v*)||, relative to ||x_actual||;
    residual = ||xf - x_actual||, so that ||A x0 + B u - xf||^2 = state^2 + residual^2.
    """
    Ah, M, X0, Xf, v = (np.asarray(x, dtype=np.float64) for x in (A, B, x0, xf, u))
    v_star = pinv(M) @ (Xf - Ah @ X0)
    x_actual = Ah @ X0 + M @ v_star
    e_u = float(np.linalg.norm(v - v_star))
    e_x = float(np.linalg.norm(M @ (v - v_star)))
    size_u, size_x = float(np.linalg.norm(v_star)), float(np.linalg.norm(x_actual))
    return PlanError(
        e_u,
        e_u / size_u if size_u > 0.0 else float("nan"),
        e_x,
        e_x / size_x if size_x > 0.0 else float("nan"),
        float(np.linalg.norm(Xf - x_actual)),
    )
