"""What targets to come add to the inputs of a gain."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import _core

if TYPE_CHECKING:
    from .._base.types import Floats


def preview(
    model: tuple[Floats, Floats, Floats, Floats],
    weights: tuple[Floats, Floats],
    K: Floats,
    path: tuple[Floats, Floats, Floats],
    start: Floats,
) -> tuple[Floats, Floats]:
    """``v_k`` (h, m) and the way ``x*`` of ``x+ = A x + B u + w`` with ``u = K (x - x°) + u° + v``.

    It is the least of ``sum_k |y*_{k+1} - y°_{k+1}|_Q^2 + |u*_k - u°_k|_R^2``, whose next readings
    are ``C x + D u`` and a constant, about points at rest or on a slope; w is what else acts. The
    cost of a gain that weighs ``u - u°`` more leaves the target at each bend: ``u°`` jumps there,
    and the states behind the readings cannot.
    """
    (A, B, C, D), (Q, R), (x0, u0, w) = model, weights, path
    inputs = D.T @ Q @ D + R
    N = np.linalg.solve(inputs, D.T @ Q @ C)  # the cost of u + N x has no cross term
    left = C - D @ N
    parts = (A - B @ N, B, left.T @ Q @ left + N.T @ R @ N, inputs)
    a, b, q, r = map(np.ascontiguousarray, parts)
    found, S, _ = _core.feedback_gain(a, b, q, r)
    assert S is not None
    own, per = found - N, -np.linalg.solve(inputs + B.T @ S @ B, B.T)
    lacks = x0 @ A.T + u0 @ B.T + w - np.vstack([x0[1:], x0[-1:]])
    ahead, after = np.zeros_like(u0), np.zeros(len(A))
    for k in range(len(x0) - 1, -1, -1):
        after = (A + B @ own).T @ after + S @ lacks[k]
        ahead[k] = per @ after
    way, acts = np.zeros_like(x0), np.zeros_like(u0)
    x = start
    for k in range(len(x0)):
        way[k], acts[k] = x, u0[k] + own @ (x - x0[k]) + ahead[k]
        x = A @ x + B @ acts[k] + w[k]
    return acts - u0 - (way - x0) @ K.T, way
