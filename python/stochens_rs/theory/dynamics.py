"""``x(k+1) = A x(k) + B u(k)`` over K steps: checked arguments, powers of A, ``C_K``, states."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base import memory, validation
from .._base.types import Floats
from ..exceptions import NonFiniteError
from ..system import System


def checked_ends(system: object, x0: object, xf: object) -> tuple[System, Floats, Floats]:
    """Check a system, its initial state and its target."""
    checked = System.from_any(system)
    how: Any = {"length": checked.n, "labels": checked.state_names}
    return checked, validation.vector("x0", x0, **how), validation.vector("xf", xf, **how)


def checked_motion(system: object, x0: object, u: object) -> tuple[System, Floats, Floats]:
    """Check a system, its initial state and its inputs."""
    checked = System.from_any(system)
    start = validation.vector("x0", x0, length=checked.n, labels=checked.state_names)
    return checked, start, validation.inputs("u", u, cols=checked.m, labels=checked.input_names)


def checked_steps(steps: object, n: int, m: int) -> int:
    """Check the number of steps against the memory that C_K and the powers of A take."""
    K = validation.size("steps", steps)
    # C_K with the work space of its factors, the powers of A with that of their norms, the states
    # and the control
    memory.need(f"a control over {K} steps", (8 * n * m + 3 * n * n + n + m) * K * 8)
    return K


def matrix_powers(A: Floats, K: int, name: str = "A") -> Floats:
    """``[I, A, ..., A^K]``, (K + 1, n, n)."""
    powers = np.empty((K + 1, *A.shape))
    powers[0], powers[1:2] = np.eye(len(A)), A
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(1, K):
            powers[k + 1] = powers[k] @ A
            if not np.isfinite(powers[k + 1]).all():
                raise NonFiniteError(
                    f"`{name}` to the power {k + 1} overflows: take fewer steps, or scale the "
                    "time step down"
                )
    return powers


def controllability(powers: Floats, B: Floats) -> Floats:
    """``C_K = [B, A B, ..., A^{K-1} B]``, (n, m K), from ``[I, A, ..., A^{K-1}]``.

    Its blocks meet u(K-1), ..., u(0).
    """
    n, m = B.shape
    blocks = np.empty((len(powers), n, m))
    blocks[0] = B
    with np.errstate(over="ignore", invalid="ignore"):
        np.matmul(powers[1:], B, out=blocks[1:])
    if not np.isfinite(blocks).all():
        raise NonFiniteError("`A` to a power times `B` overflows: take fewer steps")
    return np.ascontiguousarray(blocks.transpose(1, 0, 2).reshape(n, -1))


def states(A: Floats, B: Floats, x0: Floats, u: Floats) -> Floats:
    """``x(k+1) = A x(k) + B u(k)`` from ``x(0) = x0``, (K + 1, n)."""
    x = np.empty((len(u) + 1, x0.size))
    x[0] = x0
    with np.errstate(over="ignore", invalid="ignore"):
        for k, u_k in enumerate(u):
            x[k + 1] = A @ x[k] + B @ u_k
    if not np.isfinite(x).all():
        k = int(np.argwhere(~np.isfinite(x))[0, 0])
        raise NonFiniteError(
            f"the state overflows at step {k}: scale the problem down, or take fewer steps"
        )
    return x


def spectral_norms(powers: Floats) -> Floats:
    """2-norm of every matrix of a stack."""
    return np.asarray(np.linalg.norm(powers, ord=2, axis=(1, 2)), dtype=np.float64)
