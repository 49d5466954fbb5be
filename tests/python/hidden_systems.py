"""Systems that look nothing like those a guarantee was written for, from one shared generator.

A coverage test draws its systems here, over all ``KINDS`` or over those its assumptions allow, so
that a guarantee that holds only for dense, well-scaled systems does not pass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Draw = Callable[[np.random.Generator, int, int], tuple[Array, Array]]

# a pendulum on a cart: A and B
RIG = np.array(
    [
        [1, -0.0099, 0.1, -0.0003, 0.005],
        [0, 1.0594, 0, 0.102, -0.005],
        [0, -0.2001, 1, -0.0099, 0.1003],
        [0, 1.2004, 0, 1.0594, -0.102],
    ]
)


class HiddenSystem(NamedTuple):
    """``x(k+1) = A x(k) + B u(k)``: A of shape (n, n), B of shape (n, m)."""

    kind: str
    A: Array
    B: Array


def drawn(kind: str, gen: np.random.Generator, n: int = 4, m: int = 2) -> HiddenSystem:
    """Draw a system of this kind. "more_inputs" and "scalar" choose their own n and m."""
    return HiddenSystem(kind, *KINDS[kind](gen, n, m))


def of_each_kind(
    gen: np.random.Generator, n: int = 4, m: int = 2, *, without: tuple[str, ...] = ()
) -> Iterator[HiddenSystem]:
    """Draw one system of each kind but those left out."""
    unknown = set(without) - set(KINDS)
    assert not unknown, f"unknown kinds: {unknown}"
    for kind in KINDS:
        if kind not in without:
            yield drawn(kind, gen, n, m)


def covariance(kind: str, gen: np.random.Generator, n: int) -> Array:
    """Draw a covariance (n, n) of noise of one of the kinds in ``NOISES``."""
    factor = NOISES[kind](gen, n)
    return factor @ factor.T


# -- systems -------------------------------------------------------------------------------------


def stable(gen: np.random.Generator, n: int, radius: float = 0.9) -> Array:
    """A dense matrix of this spectral radius."""
    A = gen.standard_normal((n, n))
    return A * (radius / np.abs(np.linalg.eigvals(A)).max())


def with_singular_values(gen: np.random.Generator, n: int, values: Array) -> Array:
    """A matrix of shape (n, len(values)) with these singular values, len(values) <= n."""
    left = np.linalg.qr(gen.standard_normal((n, len(values))))[0]
    right = np.linalg.qr(gen.standard_normal((len(values), len(values))))[0]
    return left * values @ right.T


def _dense(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    return stable(gen, n), gen.standard_normal((n, m))


def _sparse(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    A = np.where(gen.random((n, n)) < 0.3, gen.uniform(-0.8, 0.8, (n, n)), 0.0)
    B = np.zeros((n, m))
    B[gen.integers(n, size=m), np.arange(m)] = gen.uniform(0.5, 2.0, m)
    return A, B


def _zero_column(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    A, B = _dense(gen, n, m)
    B[:, gen.integers(m)] = 0.0
    return A, B


def _zero_row(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    A, B = _dense(gen, n, m)
    row = gen.integers(n)
    A[row], B[row] = 0.0, 0.0
    return A, B


def _graded(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    A, B = _dense(gen, n, m)
    sizes = np.logspace(0, -8, n)[:, None]
    return A * sizes, B * sizes


def _ill_conditioned(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    m = min(m, n)
    return stable(gen, n), with_singular_values(gen, n, np.logspace(0, -gen.uniform(4, 14), m))


def _nearly_equal_inputs(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    A, B = _dense(gen, n, m)
    B[:, -1] = B[:, 0] + 1e-9 * gen.standard_normal(n)
    return A, B


def _equal_inputs(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    A, B = _dense(gen, n, m)
    B[:, -1] = B[:, 0]
    return A, B


def _mixed_state_units(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    A, B = _dense(gen, n, m)
    units = gen.permutation(np.logspace(-8, 8, n))
    return units[:, None] * A / units, units[:, None] * B


def _mixed_input_units(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    A, B = _dense(gen, n, m)
    return A, B * gen.permutation(np.logspace(0, 6, m))


def _more_inputs(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    return _dense(gen, n, 2 * n + 1)


def _one_huge_entry(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    A, B = _dense(gen, n, m)
    B[gen.integers(n), gen.integers(m)] = 1e10
    return A, B


def _defective(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    return 0.9 * np.eye(n) + np.eye(n, k=1), gen.standard_normal((n, m))


def _chain(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    """A chain of delays: A is nilpotent, the inputs enter at its end."""
    return np.eye(n, k=1), np.eye(n, m)[::-1].copy()


def _unstable(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    return stable(gen, n, 1.5), gen.standard_normal((n, m))


def _weakly_coupled(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    """Most states are reached through couplings of .02 only."""
    return np.diag(gen.uniform(0.3, 0.7, n)) + 0.02 * gen.standard_normal((n, n)), np.eye(n, m)


def _orthogonal(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    return np.linalg.qr(gen.standard_normal((n, n)))[0], gen.standard_normal((n, m))


def _integer(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    A = gen.integers(-1, 2, (n, n)).astype(float)
    return A, gen.integers(-2, 3, (n, m)).astype(float)


def _memoryless(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    return np.zeros((n, n)), gen.standard_normal((n, m))


def _scalar(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    return gen.uniform(-1.1, 1.1, (1, 1)), gen.standard_normal((1, 1))


def _tiny(gen: np.random.Generator, n: int, m: int) -> tuple[Array, Array]:
    A, B = _dense(gen, n, m)
    return A, 1e-30 * B


KINDS: dict[str, Draw] = {
    "dense": _dense,
    "sparse": _sparse,
    "zero_column": _zero_column,
    "zero_row": _zero_row,
    "graded": _graded,
    "ill_conditioned": _ill_conditioned,
    "nearly_equal_inputs": _nearly_equal_inputs,
    "equal_inputs": _equal_inputs,
    "mixed_state_units": _mixed_state_units,
    "mixed_input_units": _mixed_input_units,
    "more_inputs": _more_inputs,
    "one_huge_entry": _one_huge_entry,
    "defective": _defective,
    "chain": _chain,
    "unstable": _unstable,
    "weakly_coupled": _weakly_coupled,
    "orthogonal": _orthogonal,
    "integer": _integer,
    "memoryless": _memoryless,
    "scalar": _scalar,
    "tiny": _tiny,
}

NOISES: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "isotropic": lambda gen, n: np.eye(n),
    "correlated": lambda gen, n: gen.standard_normal((n, n)),
    "graded": lambda gen, n: np.diag(np.logspace(0, -6, n)),
    "one_force": lambda gen, n: gen.standard_normal((n, 1)),  # singular: one noise in all states
    "some_states": lambda gen, n: np.diag(np.arange(n) % 2.0),  # singular: every second state
    "units": lambda gen, n: np.diag(gen.permutation(np.logspace(-8, 8, n))),
}
