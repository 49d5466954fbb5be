"""Approximate reachability (Definition 2.3) as an experiment: runs, their average, a verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._base import validation
from ..._base.numbers import ROUNDING, norm
from ..._base.types import Floats
from ...rng import Key, RngLike, as_key
from ...simulation.simulating import simulate_ensemble
from ...system import System
from ...theory.bounds.base import unit_of
from ...theory.bounds.inequalities import supremum
from ...theory.dynamics import checked_steps
from ...theory.exact import best_control
from ...theory.moments import trajectory_covariance
from ...theory.records import Reachability

# The verdicts on targets that are not known to be reachable.
_VERDICTS = {"not reachable": "not approximately reachable", "undecided": "undecided"}


@dataclass(frozen=True, eq=False)
class ApproximateReachability:
    """Errors of the average of N runs, and what they are compared with.

    Attributes
    ----------
    sizes : ndarray of int64, shape (k,)
        Numbers of runs.
    errors : ndarray, shape (k,)
        ``||average of the first sizes[i] runs - xf||``.
    rms : ndarray, shape (k,)
        Its exact root mean square, ``sqrt(tr S_K / N + residual^2)``.
    radii : ndarray, shape (k,)
        Bounds on the errors if ``xf`` is reachable. Each fails with probability at most
        ``delta / k``; all of them hold with probability at least ``1 - delta``.
    exact : Reachability
        Reachability under the exact system in K steps, that of its `Plan`.
    controls : ndarray, shape (K, m)
        The controls that were used, u(k) in row k.
    consistent : bool
        Whether no error exceeds its radius, up to rounding.
    verdict : str
        "approximately reachable", "not approximately reachable", or "inconsistent": the target
        is reachable, but a radius was exceeded (probability at most ``delta``). "undecided" where
        doubles do not decide whether the target is reachable, see `Reachability`.
    key : Key
        The key the experiment can be repeated with.
    """

    sizes: NDArray[np.int64]
    errors: Floats
    rms: Floats
    radii: Floats
    exact: Reachability
    controls: Floats
    consistent: bool
    verdict: str
    key: Key


def approximately(
    system: System | Any,
    x0: ArrayLike,
    xf: ArrayLike,
    steps: int,
    *,
    sizes: ArrayLike = (10, 100, 1000),
    delta: float = 0.01,
    rng: RngLike = None,
) -> ApproximateReachability:
    """Steer N runs of the sampled system with one open-loop control, and average them.

    Parameters
    ----------
    system : System
        The system, or anything `System.from_any` takes, such as ``(A, B)``; ``B`` is sampled, too.
    x0, xf : (n,) array_like
        Initial state and target.
    steps : int
        Number of steps K.
    sizes : array_like of int, shape (k,), default (10, 100, 1000)
        Numbers of runs at which the average is compared with ``xf``, strictly increasing.
    delta : float, default 0.01
        Probability, in (0, 1), with which a reachable target may be called inconsistent.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness of `simulate_ensemble`, which draws the runs.

    Returns
    -------
    ApproximateReachability
        Errors, what they are compared with, and the verdict.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    ResourceError
        The moments of the runs do not fit into memory.

    Notes
    -----
    ``xhat(s, k+1) = A^(s,k) xhat(s, k) + B^(s,k) u(k)`` with fresh draws for every run and step, by
    columns, and the smallest u that takes the exact system to (or nearest to) ``xf``. As printed,
    Definition 2.3 requires that controls "drive the realization through the trajectory", which any
    control does; the proof of Lemma 3.1 uses the control chosen here. The runs
    are independent with mean ``A^K x0 + C_K u``, and none is longer than R_K (see
    `paper.bounds.corrected`), so that Bousquet's inequality holds for their average. An experiment
    can contradict a limit but not prove it. Whether a target is out of reach is therefore decided
    by the exact residual, which the errors approach.

    Examples
    --------
    >>> from stochens_rs.paper import reachability
    >>> system = [[0.5, 0.4], [0.1, 0.6]], [[0.0], [1.0]]
    >>> found = reachability.approximately(system, [1.0, 1.0], [0.0, 0.5], 2, rng=1)
    >>> found.verdict, bool(found.errors[-1] < 0.2)
    ('approximately reachable', True)
    """
    delta = validation.probability("delta", delta)
    checked = System.from_any(system)
    A, B = checked.A, checked.B
    start = validation.vector("x0", x0, length=checked.n)
    goal = validation.vector("xf", xf, length=checked.n)
    K = checked_steps(steps, checked.n, checked.m)
    best = best_control(A, B, start, goal, K)
    exact, u = best.reachability(), best.u.reshape(K, -1)
    grid = validation.sizes("sizes", sizes, maximum=2**31)
    key = as_key(rng)
    unit = unit_of(start, u)  # squares of states in this unit do not overflow
    covariance = trajectory_covariance(checked, start / unit, u / unit)[-1]
    one_run = math.sqrt(max(0.0, float(np.trace(covariance))))
    top = max(0.0, float(np.linalg.eigvalsh(covariance)[-1]))
    farthest = _longest_run(A, B, start / unit, u / unit) + norm(best.reached / unit)
    level = math.log(len(grid) / delta)
    radii = np.array(
        [unit * supremum(one_run / math.sqrt(k), top / k, farthest / k, level) for k in grid]
    )
    # run s depends on (key, s) only: k runs are the first of more
    averages = [
        unit * simulate_ensemble((A, B), u=u / unit, x0=start / unit, size=int(k), rng=key).mean
        for k in grid
    ]
    errors = np.array([norm(average[-1] - goal) for average in averages])
    # ||mean - xf|| <= ||mean - nearest reachable|| + residual, and the bounds are on the first
    rounding = ROUNDING * float(np.abs(averages[-1]).max(initial=1.0))
    consistent = bool((errors <= radii + exact.residual + rounding).all())
    verdict = "approximately reachable" if consistent else "inconsistent"
    return ApproximateReachability(
        sizes=grid,
        errors=errors,
        rms=np.hypot(unit * one_run / np.sqrt(grid), exact.residual),
        radii=radii,
        exact=exact,
        controls=u,
        consistent=consistent,
        verdict=_VERDICTS.get(exact.verdict, verdict),
        key=key,
    )


def _longest_run(A: Floats, B: Floats, x0: Floats, u: Floats) -> float:
    """``R_{k+1} = g(A) R_k + sum_j |u_j(k)| ||b_j||_1`` from ``R_0 = g(x0)``: no run is longer."""
    gain, h = float(np.abs(A).sum(axis=0).max()), np.abs(B).sum(axis=0)
    longest = float(np.abs(x0).sum())
    for u_k in u:
        longest = gain * longest + float(h @ np.abs(u_k))
    return longest
