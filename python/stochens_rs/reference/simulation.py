"""Trajectories: ``x(k+1) = A x(k) + B u(k)`` exactly, in independent random runs, as a mean field,
and along a reference.

Every run draws fresh A and B at every step, so that all runs are independent and their mean is the
exact trajectory. The columns of a matrix are drawn independently (see `sampling`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .controls import pinv
from .sampling import atoms
from .streams import RUNS as PURPOSE
from .streams import AliasTable, Words64, alias_table, child, draw, iid_words

Array = NDArray[np.float64]
Take = Callable[[int], Words64]
Estimate = Callable[[Array, bytes], Array]

BLOCK = 32  # runs that share one line of words; part of the stream's definition


def simulate(A: ArrayLike, B: ArrayLike, x0: ArrayLike, u: ArrayLike) -> Array:
    """The exact states x(0), ..., x(K), (K + 1, n), for inputs u (K, m)."""
    A, B = np.asarray(A, dtype=np.float64), np.asarray(B, dtype=np.float64)
    states = [np.asarray(x0, dtype=np.float64)]
    for u_k in np.asarray(u, dtype=np.float64):
        states.append(A @ states[-1] + B @ u_k)
    return np.array(states)


def simulate_runs(
    A: ArrayLike,
    B: ArrayLike,
    x0: ArrayLike,
    u: ArrayLike,
    size: int,
    *,
    key: bytes,
    sampled: tuple[str, ...] = ("A", "B", "x0"),
) -> Array:
    """`size` independent runs, (size, K + 1, n); deterministic."""
    A, B = np.asarray(A, dtype=np.float64), np.asarray(B, dtype=np.float64)
    u, x0 = np.asarray(u, dtype=np.float64), np.asarray(x0, dtype=np.float64)
    blocks = [_block(A, B, u, x0, key, block, sampled) for block in range(-(-size // BLOCK))]
    return np.concatenate(blocks)[:size]


def _block(
    A: Array, B: Array, u: Array, x0: Array, key: bytes, block: int, sampled: tuple[str, ...]
) -> Array:
    """The runs 32 b, ..., 32 b + 31; they take the words of line b in the order of the loops."""
    sample_A, sample_B, sample_x0 = (name in sampled for name in ("A", "B", "x0"))
    words = iid_words(key, block, BLOCK * (1 + len(u) * sum(B.shape)), PURPOSE)
    taken = 0

    def take(count: int) -> Words64:
        nonlocal taken
        taken += count
        return words[taken - count : taken]

    tables_A, tables_B = _tables(A), _tables(B)
    x = np.zeros((BLOCK, len(x0)))
    if not sample_x0:
        x += x0
    elif np.any(x0):
        i = draw(alias_table(x0), take(BLOCK))
        x[np.arange(BLOCK), i] = atoms(x0)[i]
    singletons = sample_A and (sample_x0 or int(np.count_nonzero(x0)) <= 1)
    states = [x]
    for u_k in u:
        x = _apply(A, tables_A, x, take, by_runs=singletons) if sample_A else x @ A.T
        v = np.tile(u_k, (BLOCK, 1))  # the same for all runs
        x = _apply(B, tables_B, v, take, onto=x) if sample_B else x + B @ u_k
        singletons = bool(singletons and not np.any(u_k))
        states.append(x)
    return np.stack(states, axis=1)


def _tables(M: Array) -> list[AliasTable | None]:
    return [alias_table(column) if np.any(column) else None for column in M.T]


def _apply(
    M: Array,
    tables: list[AliasTable | None],
    v: Array,
    take: Take,
    *,
    by_runs: bool = False,
    onto: Array | float = 0.0,
) -> Array:
    """`onto` + M^s v[s] for every run s: each v[s, j] != 0 with a nonzero column draws one index i
    and adds ``v_j g_j sign(M_ij)`` to entry i.
    """
    out, value = np.zeros((len(v), len(M))) + onto, atoms(M)
    if by_runs:  # singletons: at most one nonzero in each run
        for s, j in np.argwhere(v):
            table = tables[j]
            if table is not None:
                i = draw(table, take(1))
                out[s, i] += v[s, j] * value[i, j]
        return out
    for j, table in enumerate(tables):
        runs = np.flatnonzero(v[:, j])
        if table is not None and len(runs) > 0:
            i = draw(table, take(len(runs)))
            out[runs, i] += v[runs, j] * value[i, j]
    return out


def simulate_mean_field(
    A: ArrayLike,
    B: ArrayLike,
    x0: ArrayLike,
    u: ArrayLike,
    size: int,
    *,
    generator: np.random.Generator,
) -> Array:
    """F(k+1) = A_hat F(k) + B_hat u(k), (K + 1, n), with averages of `size` fresh realizations.

    Equal in distribution to the core's, which draws its counts from another generator.
    """
    A, B = np.asarray(A, dtype=np.float64), np.asarray(B, dtype=np.float64)
    x = average(np.asarray(x0, dtype=np.float64)[:, None], size, generator)[:, 0]
    states = [x]
    for u_k in np.asarray(u, dtype=np.float64):
        x = average(A, size, generator) @ x + average(B, size, generator) @ u_k
        states.append(x)
    return np.array(states)


def average(M: Array, size: int, generator: np.random.Generator) -> Array:
    """g_j sign(M_ij) counts_ij / size, counts_j multinomial with p_ij = abs(M_ij) / g_j."""
    g = np.abs(M).sum(axis=0)
    columns = [
        generator.multinomial(size, np.abs(column) / g_j) if g_j > 0 else np.zeros(len(column))
        for column, g_j in zip(M.T, g, strict=True)
    ]
    mean: Array = atoms(M) * np.stack(columns, axis=1) / size
    return mean


def track(
    A: ArrayLike,
    B: ArrayLike,
    reference: ArrayLike,
    x0: ArrayLike,
    estimate: Estimate,
    *,
    key: bytes,
    feedback: bool = True,
    sample_states: bool = False,
) -> tuple[Array, Array]:
    """States (K + 1, n) and inputs (K, m) of one run along a reference (K + 1, n).

    `estimate(target, key)` fuses fresh realizations of a vector or matrix.
    """
    A, B = np.asarray(A, dtype=np.float64), np.asarray(B, dtype=np.float64)
    r, B_plus = np.asarray(reference, dtype=np.float64), pinv(B)
    states, inputs = [np.asarray(x0, dtype=np.float64)], []
    for k in range(len(r) - 1):
        step = child(key, f"step-{k}")
        now, goal = states[k] if feedback else r[k], r[k + 1]
        if sample_states:
            now = estimate(now, child(step, "state"))
            goal = estimate(goal, child(step, "target"))
        inputs.append(B_plus @ (goal - estimate(A, child(step, "A")) @ now))
        states.append(A @ states[k] + B @ inputs[k])
    return np.array(states), np.array(inputs)
