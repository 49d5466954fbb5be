"""Approximate reachability (Definition 2.3) as an experiment: runs, their average, a verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._base import gate, memory
from ..._base.numbers import norm
from ...ensembles.sampling import sample
from ...rng import Key, RngLike, as_key
from ...theory.bounds import candidates
from ...theory.bounds._base import level_of
from ...theory.formulas import Array
from ...theory.reachability.steps import StepsReachability, several_steps


@dataclass(frozen=True, eq=False)
class ApproximateReachability:
    """What the average of N runs did, beside what it has to do.

    Attributes
    ----------
    sizes : ndarray of int64, shape (k,)
        Numbers of runs.
    errors : ndarray, shape (k,)
        ``||average of the first sizes[i] runs - xf||``.
    rms : ndarray, shape (k,)
        Its exact root mean square, ``sqrt(tr S_K / N + residual^2)``.
    radii : ndarray, shape (k,)
        What an error exceeds with probability at most ``delta / k``, if ``xf`` is reachable: all
        of them hold together with probability ``1 - delta``.
    exact : StepsReachability
        Reachability under the exact system, with the controls that were used.
    consistent : bool
        Whether no error exceeds its radius, up to rounding.
    verdict : str
        "approximately reachable", "not approximately reachable", or "inconsistent": the target
        is reachable, but a radius was exceeded (probability at most ``delta``).
    key : Key
        The key the experiment can be repeated with.
    """

    sizes: NDArray[np.int64]
    errors: Array
    rms: Array
    radii: Array
    exact: StepsReachability
    consistent: bool
    verdict: str
    key: Key


def approximately(
    B: ArrayLike,
    x0: ArrayLike,
    xf: ArrayLike,
    A: ArrayLike,
    steps: int,
    *,
    sizes: ArrayLike = (10, 100, 1000),
    delta: float = 0.01,
    rng: RngLike = None,
) -> ApproximateReachability:
    """Steer N runs of the sampled system with one open-loop control, and average them.

    Parameters
    ----------
    B : (n, m) array_like
        Input matrix; it is sampled, too.
    x0, xf : (n,) array_like
        Initial state and target.
    A : (n, n) array_like
        State matrix.
    steps : int
        Number of steps K.
    sizes : array_like of int, shape (k,), default (10, 100, 1000)
        Numbers of runs at which the average is compared with ``xf``, strictly increasing.
    delta : float, default 0.01
        Probability, in (0, 1), with which a reachable target may be called inconsistent.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness; ``x0`` and, for every step, ``A`` and ``B`` draw from its children.

    Returns
    -------
    ApproximateReachability
        Errors, what they are compared with, and the verdict.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    ResourceError
        The runs do not fit into memory.

    Notes
    -----
    ``xhat(s, k+1) = A^(s,k) xhat(s, k) + B^(s,k) u(k)`` with fresh draws for every run and step, by
    columns, and the smallest u that takes the exact system to (or nearest to) ``xf``. Printed,
    Definition 2.3 asks that controls "drive the realization through the trajectory", which any
    control does; what is meant, and what the proof of Lemma 3.1 uses, is this choice. The runs
    are independent with mean ``A^K x0 + C u``: with the smallest radii of
    `bounds.candidates`. An experiment can contradict the notion, but not prove a limit: the
    verdict for a target out of reach is that of the exact residual, at which the errors level.

    Examples
    --------
    >>> from stochens_rs.paper import reachability
    >>> A, B = [[0.5, 0.4], [0.1, 0.6]], [[0.0], [1.0]]
    >>> found = reachability.approximately(B, [1.0, 1.0], [0.0, 0.5], A, 2, rng=1)
    >>> found.verdict, bool(found.errors[-1] < 0.2)
    ('approximately reachable', True)
    """
    level_of(delta)  # refuses what is no probability
    exact = several_steps(B, x0, xf, A, steps)
    grid = gate.sizes("sizes", sizes, maximum=2**31)
    key = as_key(rng)
    u, N = exact.controls, int(grid[-1])
    found = candidates("trajectory", (A, B), x0, u)
    runs = found[0]._setting
    goal = gate.vector("xf", xf)
    radii = np.array([min(b.radius(int(k), delta / len(grid)) for b in found) for k in grid])
    deviations = [runs.unit * math.sqrt(runs.mean_square / int(k)) for k in grid]
    states = _runs(A, B, x0, u, N, key)
    averages = np.cumsum(states, axis=0)[grid - 1] / grid[:, None]
    errors = np.array([norm(average - goal) for average in averages])
    # by Pythagoras the error beyond the residual is at most that of the mean
    rounding = 1e-12 * float(np.abs(states).max(initial=1.0))
    consistent = bool((errors <= radii + exact.residual + rounding).all())
    verdict = "approximately reachable" if consistent else "inconsistent"
    return ApproximateReachability(
        sizes=grid,
        errors=errors,
        rms=np.array([math.hypot(rms, exact.residual) for rms in deviations]),
        radii=radii,
        exact=exact,
        consistent=consistent,
        verdict=verdict if exact.reachable else "not approximately reachable",
        key=key,
    )


def _runs(A: ArrayLike, B: ArrayLike, x0: ArrayLike, u: Array, N: int, key: Key) -> Array:
    """Final states (N, n) of N runs; every step of every run has draws of its own."""
    n = len(np.asarray(x0))
    memory.need("the runs", 8 * N * (6 * n + u.shape[1]))
    states = sample(x0, N, rng=key.child("x0")).dense()
    for k, control in enumerate(u):
        moved = _apply(A, states, N, key.child(f"A {k}"))
        states = moved + _apply(
            B, np.broadcast_to(control, (N, len(control))), N, key.child(f"B {k}")
        )
    return states


def _apply(M: ArrayLike, x: Array, N: int, key: Key) -> Array:
    """``M^s x_s`` for N realizations: every entry of x_s goes where its column points."""
    drawn = sample(M, N, rng=key)
    indices, atoms = drawn.indices, drawn.atoms
    assert indices is not None
    assert atoms is not None  # drawn as singletons
    rows = indices.astype(np.intp)
    values = x * atoms[rows, np.arange(atoms.shape[1])]
    flat = rows + len(atoms) * np.arange(N)[:, None]
    totals = np.bincount(flat.ravel(), weights=values.ravel(), minlength=N * len(atoms))
    return np.asarray(totals.reshape(N, len(atoms)), dtype=np.float64)
