"""Lemmas 3.1 and 3.2 and a remark are false as stated: counterexamples in rational numbers.

All use that Definition 2.2 allows weights of its own for every entity and realizations that are
biased: a sequence with one good realization and zeros otherwise approximates its limit, with all
weight on the good one. Where the good realizations sit at different indices, no run is good.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

from ..._base import gate
from ...exceptions import InputError

_Row: TypeAlias = "list[Fraction]"

# the index at which each entity has its one good realization
_GOOD = {"x0": 0, "A": 1, "B": 2}


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
    >>> from stochens_rs.paper import reachability
    >>> found = reachability.lemma_3_1(5, weights=[1, 2, 3, 4, 5])
    >>> found.hypothesis, found.claim, set(found.approximation_errors.values())
    (Fraction(0, 1), Fraction(1, 1), {Fraction(0, 1)})
    """
    size = gate.size("size", size, minimum=3, maximum=10**6)
    y = _weights(weights, size)
    u = _integers("controls", [-7] * size if controls is None else controls, size)
    zero, one = Fraction(0), Fraction(1)
    A, B, x0 = [[zero, one], [one, zero]], [one, zero], [one, zero]
    xf = _times(A, x0)
    nothing = [zero, zero]

    def run(s: int) -> tuple[list[_Row], _Row, _Row]:
        return (
            A if s == _GOOD["A"] else [nothing, nothing],
            B if s == _GOOD["B"] else nothing,
            x0 if s == _GOOD["x0"] else nothing,
        )

    average = [zero, zero]
    for s in range(size):
        As, Bs, start = run(s)
        moved = _times(As, start)
        average = [a + y[s] * (z + b * u[s]) for a, z, b in zip(average, moved, Bs, strict=True)]
    good_A, good_B, good_x0 = run(_GOOD["A"])[0], run(_GOOD["B"])[1], run(_GOOD["x0"])[2]
    errors = {
        "A": max(abs(a - b) for p, q in zip(good_A, A, strict=True) for a, b in _pairs(p, q)),
        "B": max(abs(a - b) for a, b in _pairs(good_B, B)),
        "x0": max(abs(a - b) for a, b in _pairs(good_x0, x0)),
    }
    # with u = 0 the exact system is at A x0 = xf
    residual = max(abs(a - b) for a, b in _pairs(_times(A, x0), xf))
    # the second entry is what no control moves
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
    >>> from stochens_rs.paper import reachability
    >>> found = reachability.lemma_3_2(3, weights=[1, 1, 7])
    >>> found.claim, found.hypothesis, found.approximation_errors["A"]
    (Fraction(1, 1), Fraction(0, 1), Fraction(0, 1))
    """
    size = gate.size("size", size, minimum=2, maximum=10**6)
    y = _weights(weights, size)
    zero, A, B, x0, xf = Fraction(0), Fraction(1), Fraction(1), Fraction(1), Fraction(0)
    starts, matrices = _one_good(x0, "x0", size), _one_good(A, "A", size)
    goals = [xf] * size
    u = [(f - a * z) / B for f, a, z in zip(goals, matrices, starts, strict=True)]
    residuals = [
        abs(f - a * z - B * v) for f, a, z, v in zip(goals, matrices, starts, u, strict=True)
    ]
    exact = (xf - A * x0) / B
    average = sum((w * v for w, v in zip(y, u, strict=True)), zero)
    errors = _errors(starts, matrices, goals, x0, A, xf)
    return Counterexample("3.2", size, errors, max(residuals), abs(B * (exact - average)))


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
    >>> from stochens_rs.paper import reachability
    >>> found = reachability.remark_3_2(3)
    >>> found.claim, found.hypothesis
    (Fraction(1, 1), Fraction(0, 1))
    """
    size = gate.size("size", size, minimum=2, maximum=10**6)
    A, x0, xf = Fraction(1), Fraction(1), Fraction(0)
    starts, matrices = _one_good(x0, "x0", size), _one_good(A, "A", size)
    goals = [xf] * size
    # B = 0: no control moves anything
    residuals = [abs(f - a * z) for f, a, z in zip(goals, matrices, starts, strict=True)]
    errors = _errors(starts, matrices, goals, x0, A, xf)
    return Counterexample("remark after 3.2", size, errors, max(residuals), abs(xf - A * x0))


def _one_good(value: Fraction, name: str, size: int) -> _Row:
    """The value where the entity has its good realization, 0 elsewhere."""
    return [value if s == _GOOD[name] else Fraction(0) for s in range(size)]


def _errors(
    starts: _Row, matrices: _Row, goals: _Row, x0: Fraction, A: Fraction, xf: Fraction
) -> dict[str, Fraction]:
    """Errors of the scalars under all weight on the good realization."""
    return {
        "x0": abs(starts[_GOOD["x0"]] - x0),
        "A": abs(matrices[_GOOD["A"]] - A),
        "xf": abs(goals[0] - xf),
    }


def _weights(weights: list[int] | None, size: int) -> list[Fraction]:
    """Nonnegative integers of positive sum, as fractions of it."""
    given = _integers("weights", [1] * size if weights is None else weights, size)
    total = sum(given)
    if min(given) < 0 or total == 0:
        raise InputError("`weights` must be nonnegative and not all 0")
    return [Fraction(w, total) for w in given]


def _integers(name: str, values: list[int], size: int) -> list[int]:
    given = gate.items(name, values)
    if len(given) != size:
        raise InputError(f"`{name}` must have length {size}, got {len(given)}")
    return [gate.size(f"{name}[{k}]", v, minimum=-(2**53)) for k, v in enumerate(given)]


def _times(A: list[_Row], x: _Row) -> _Row:
    return [sum((a * b for a, b in _pairs(row, x)), Fraction(0)) for row in A]


def _pairs(a: _Row, b: _Row) -> list[tuple[Fraction, Fraction]]:
    return list(zip(a, b, strict=True))
