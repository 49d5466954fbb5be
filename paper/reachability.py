"""Lemmas 3.1 and 3.2 and a remark are false as stated: counterexamples in rational numbers.

All three, which connect the paper's notions of reachability, are true for unbiased realizations, as
`sample` draws them.

Definition 2.2 allows biased realizations, and different weights for every entity. Hence a sequence
with one exact ("good") realization and zeros otherwise approximates its limit: all weight goes to
the good one. If the good realizations of x0, A and B have different indices, no run has all three.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from stochens_rs.exceptions import InputError

from . import common as check
from .rationals import ONE, ZERO, Array, array

__all__ = ["Counterexample", "lemma_3_1", "lemma_3_2", "remark_3_2"]

# The index at which each entity has its one good realization.
_GOOD = {"x0": 0, "A": 1, "B": 2, "xf": 0}


@dataclass(frozen=True)
class Counterexample:
    """The numbers of a counterexample, all exact.

    Attributes
    ----------
    lemma : str
        The number of the lemma.
    size : int
        Number of realizations N of every entity.
    approximation_errors : dict of str to Fraction
        For each entity the largest error of an entry, under the weights that show that it is
        approximated: all 0.
    hypothesis : Fraction
        What the lemma assumes to be 0 and is: the residual of the exact target (3.1), the largest
        residual of a realization (3.2 and the remark).
    claim : Fraction
        What the lemma claims to tend to 0: the least distance of a weighted final state from the
        target (3.1), of the weighted control from the exact one (3.2), for the given weights. What
        the remark claims to be 0: the distance of the target from the states in reach.
    """

    lemma: str
    size: int
    approximation_errors: dict[str, Fraction]
    hypothesis: Fraction
    claim: Fraction


def lemma_3_1(
    size: int = 10, *, weights: list[int] | None = None, controls: list[int] | None = None
) -> Counterexample:
    """``xf`` is reachable and everything is approximated, but no average of runs comes near.

    Parameters
    ----------
    size : int, default 10
        Number of runs, at least 3.
    weights : list of int, optional
        Nonnegative weight of every run, divided by their sum; equal if not given.
    controls : list of int, optional
        The control of every run; all -7 if not given.

    Returns
    -------
    Counterexample
        ``claim`` is the distance of the weighted final states from the line that B spans, hence
        at most the distance from ``xf``; it is 1 for all weights, all controls and all sizes.

    Raises
    ------
    InputError, InputTypeError
        `size` is too small, `weights` or `controls` do not fit.

    Notes
    -----
    ``n = 2``, ``m = 1``, ``K = 1``: ``A = [[0, 1], [1, 0]]``, ``B = (1, 0)``, ``x0 = (1, 0)`` and
    ``xf = A x0 = (0, 1)``, reached with ``u = 0``. Run 1 has the good ``x0``, run 2 the good
    ``A``, run 3 the good ``B``; all else is 0. Independent, as constants are, and bounded.

    Examples
    --------
    >>> from paper import reachability
    >>> found = reachability.lemma_3_1(5, weights=[1, 2, 3, 4, 5])
    >>> found.hypothesis, found.claim, set(found.approximation_errors.values())
    (Fraction(0, 1), Fraction(1, 1), {Fraction(0, 1)})
    """
    size = check.size("size", size, minimum=3, maximum=10**6)
    y = _weights(weights, size)
    u = _integers("controls", [-7] * size if controls is None else controls, size)
    A, B, x0 = array([[0, 1], [1, 0]]), array([1, 0]), array([1, 0])
    xf = A @ x0
    matrices, inputs, starts = (
        _one_good(x, name, size) for x, name in ((A, "A"), (B, "B"), (x0, "x0"))
    )
    average = sum(
        w * (M @ x + b * v) for w, M, x, b, v in zip(y, matrices, starts, inputs, u, strict=True)
    )
    errors = _errors(A=(matrices, A), B=(inputs, B), x0=(starts, x0))
    residual = abs(A @ x0 - xf).max()  # of the exact system with u = 0
    # no control moves the second entry
    return Counterexample("3.1", size, errors, residual, abs(xf[1] - average[1]))


def lemma_3_2(size: int = 10, *, weights: list[int] | None = None) -> Counterexample:
    """Every realization is reachable, but the average control is wrong by 1, whatever the weights.

    Parameters
    ----------
    size : int, default 10
        Number of realizations, at least 2.
    weights : list of int, optional
        Nonnegative weight of every realization, divided by their sum; equal if not given.

    Returns
    -------
    Counterexample
        ``claim`` is ``|B (v* - sum_s y_s u^s)|``: 1 for all weights and all sizes.

    Raises
    ------
    InputError, InputTypeError
        `size` is too small, or `weights` do not fit.

    Notes
    -----
    Scalars: ``x0 = A = B = 1``, ``xf = 0``, so that ``v* = -1``. ``x0^1 = 1`` and ``A^2 = 1``, all
    other realizations are 0: then ``A^s x0^s = 0`` for every s, ``u^s = 0`` steers every
    realization, and so does every average of them. What is missing: unbiased realizations, for
    which ``E u^s = v*``.

    Examples
    --------
    >>> from paper import reachability
    >>> found = reachability.lemma_3_2(3, weights=[1, 1, 7])
    >>> found.claim, found.hypothesis, found.approximation_errors["A"]
    (Fraction(1, 1), Fraction(0, 1), Fraction(0, 1))
    """
    size = check.size("size", size, minimum=2, maximum=10**6)
    y = _weights(weights, size)
    x0, A, B, xf = ONE, ONE, ONE, ZERO
    starts, matrices, goals, errors = _scalars(size, x0, A, xf)
    exact = (xf - A * x0) / B
    u = (goals - matrices * starts) / B
    residual = abs(goals - matrices * starts - B * u).max()
    return Counterexample("3.2", size, errors, residual, abs(B * (exact - (y * u).sum())))


def remark_3_2(size: int = 10) -> Counterexample:
    """Every realization is reachable, but the target is not: the remark after Lemma 3.2.

    Parameters
    ----------
    size : int, default 10
        Number of realizations, at least 2.

    Returns
    -------
    Counterexample
        ``claim`` is the distance of ``xf`` from the only state in reach, ``A x0``: 1.

    Raises
    ------
    InputError, InputTypeError
        `size` is too small.

    Notes
    -----
    The scalars of `lemma_3_2` with ``B = 0``: ``A^s x0^s = 0 = xf^s`` for every s, so that every
    control takes every realization to its target, while ``A x0 = 1`` and ``xf = 0``.

    Examples
    --------
    >>> from paper import reachability
    >>> found = reachability.remark_3_2(3)
    >>> found.claim, found.hypothesis
    (Fraction(1, 1), Fraction(0, 1))
    """
    size = check.size("size", size, minimum=2, maximum=10**6)
    x0, A, xf = ONE, ONE, ZERO
    starts, matrices, goals, errors = _scalars(size, x0, A, xf)
    # B = 0: no control moves anything
    residual = abs(goals - matrices * starts).max()
    return Counterexample("remark after 3.2", size, errors, residual, abs(xf - A * x0))


def _scalars(
    size: int, x0: Fraction, A: Fraction, xf: Fraction
) -> tuple[Array, Array, Array, dict[str, Fraction]]:
    """Realizations of the three, one of each good, and their errors."""
    starts, matrices, goals = (
        _one_good(x, name, size) for x, name in ((x0, "x0"), (A, "A"), (xf, "xf"))
    )
    errors = _errors(x0=(starts, x0), A=(matrices, A), xf=(goals, xf))
    return starts, matrices, goals, errors


def _one_good(value: Array, name: str, size: int) -> Array:
    """The value where the entity has its good realization, 0 elsewhere."""
    drawn = array(np.zeros((size, *np.shape(value)), dtype=int))
    drawn[_GOOD[name]] = value
    return drawn


def _errors(**entities: tuple[Array, Array]) -> dict[str, Fraction]:
    """Largest error of an entry of each entity under all weight on its good realization."""
    return {
        name: np.max(abs(drawn[_GOOD[name]] - value)) for name, (drawn, value) in entities.items()
    }


def _weights(weights: list[int] | None, size: int) -> Array:
    """Nonnegative integers of positive sum, as fractions of it."""
    given = _integers("weights", [1] * size if weights is None else weights, size)
    total = sum(given)
    if min(given) < 0 or total == 0:
        raise InputError("`weights` must be nonnegative and not all 0")
    return array(given) / total


def _integers(name: str, values: list[int], size: int) -> list[int]:
    given = list(values)
    if len(given) != size:
        raise InputError(f"`{name}` must have length {size}, got {len(given)}")
    return [check.size(f"{name}[{k}]", v, -(2**53)) for k, v in enumerate(given)]
