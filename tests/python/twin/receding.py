"""Receding horizon: the best K inputs over the limits at every state, the first one applied."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .limited_control import Solution, solve
from .limited_problems import several_steps

Array = NDArray[np.float64]


class Regulated(NamedTuple):
    """x(0) .. x(T), the inputs that led there, and what was solved at each state."""

    states: Array  # (T + 1, n)
    inputs: Array  # (T, m)
    solutions: list[Solution]


def regulate(
    A: ArrayLike,
    B: ArrayLike,
    x0: ArrayLike,
    reference: ArrayLike,
    K: int,
    T: int,
    *,
    true: tuple[ArrayLike, ArrayLike] | None = None,
    previous: ArrayLike = 0.0,
    **problem: Any,
) -> Regulated:
    """T steps of x(k+1) = A x(k) + B u(k), or of the `true` (A, B), planned by (A, B).

    Each plan starts from the state itself and from the input applied last (rate limits, penalties).
    The other arguments are those of `several_steps`.
    """
    truth = (A, B) if true is None else true
    F, X = (np.asarray(M, dtype=np.float64) for M in truth)
    m = X.shape[1]
    states, inputs, solutions = [np.asarray(x0, dtype=np.float64)], [], []
    last = np.broadcast_to(np.asarray(previous, dtype=np.float64), m)
    for _ in range(T):
        p = several_steps(A, B, states[-1], reference, K, previous=last, **problem)
        solutions.append(solve(p))
        last = solutions[-1].u[:m]
        inputs.append(last)
        states.append(F @ states[-1] + X @ last)
    return Regulated(np.array(states), np.array(inputs), solutions)
