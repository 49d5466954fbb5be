"""How often a fresh unit misses more than the units a design was made for.

A design over `size` units, drawn independently from one law, has a threshold: here the largest
miss of the units. Its *risk* is the probability that a fresh unit of the same law misses more. All
functions return a bound of the risk that fails with probability at most `beta` over the units. They
say nothing about units of another law. Every one takes a few microseconds, whatever the size.

`hold_out` is the first choice where fresh units are at hand: it needs nothing of the design.
"""

from __future__ import annotations

from .. import _core
from .._base import validation

__all__ = [
    "a_priori",
    "compression",
    "discarding",
    "hold_out",
    "judged",
    "relaxed",
    "required_scenarios",
]


def a_priori(size: int, dimension: int, beta: float) -> float:
    """Bound the risk of a convex design before the units are seen.

    Parameters
    ----------
    size : int
        The number of units N.
    dimension : int
        The number d of variables of the design; the value counts, so m K + 1 for `control_fleet`.
    beta : float
        Probability of failure of the bound, in (0, 1).

    Returns
    -------
    float
        ``e`` with ``sum_{i<d} C(N, i) e^i (1-e)^(N-i) = beta``; 1 if N < d. (Campi and Garatti
        2008; no bound with this ``beta`` is smaller for all convex designs.)

    Raises
    ------
    SizeError, InputError, InputTypeError
        If an argument is out of its range.

    Examples
    --------
    >>> from stochens_rs.theory import scenario
    >>> round(scenario.a_priori(3000, 21, 1e-6), 10)
    0.0166967329
    """
    size, dimension = validation.size("size", size), validation.size("dimension", dimension)
    return _core.scenario_at_most(size, dimension - 1, validation.probability("beta", beta))


def judged(size: int, support: int, beta: float) -> float:
    """Bound the risk of a convex, nondegenerate design by the size of its support.

    Parameters
    ----------
    support : int
        The number k of units without which, one at a time, the design changes; at most N.
    size, beta
        As in `a_priori`.

    Returns
    -------
    float
        ``e`` with ``beta/(N+1) sum_{m=k}^N C(m, k) (1-e)^(m-k) = C(N, k) (1-e)^(N-k)``; 1 for
        k = N. (Campi and Garatti 2018.)

    Raises
    ------
    SizeError, InputError, InputTypeError
        As `a_priori`.

    Notes
    -----
    Nondegenerate: the units of the support alone give the same design, with probability 1. Copies
    of units and units that no input moves break this, and no computation up to a tolerance can
    verify it; `compression` does not need it.

    Examples
    --------
    >>> from stochens_rs.theory import scenario
    >>> round(scenario.judged(60, 3, 0.05), 10)
    0.16651798
    """
    size = validation.size("size", size)
    support = validation.size("support", support, minimum=0, maximum=size)
    return _core.scenario_judged(size, support, validation.probability("beta", beta))


def compression(size: int, support: int, beta: float, *, violations: int = 0) -> float:
    """Bound the risk of a command that a few of the units alone give.

    Parameters
    ----------
    support : int
        The number k of units that the command was computed from, at most N. They may be chosen by
        any rule, after all units were seen.
    violations : int, default 0
        The number r, fixed before the units were seen: at most r of the other N - k units miss more
        than the threshold.
    size, beta
        As in `a_priori`.

    Returns
    -------
    float
        ``e`` with ``C(N, k) sum_{i<=r} C(N-k, i) e^i (1-e)^(N-k-i) = beta/N``; for r = 0
        ``C(N, k) (1-e)^(N-k) = beta/N``. 1 if k + r >= N. (Littlestone and Warmuth 1986; Floyd and
        Warmuth 1995.)

    Raises
    ------
    SizeError, InputError, InputTypeError
        As `a_priori`.

    Notes
    -----
    The command must be a fixed function of the k units in the order of their numbers: bit for bit,
    with all its settings, and not of the other units or of the clock. Neither convexity nor an
    optimum is needed. The threshold may be computed from all units.

    Proof. Fix k numbers. Their command u is independent of the other N - k units, whose misses
    under u are independent draws of one law. Let q be the smallest x with P(miss > x) <= e. A
    threshold with a risk above e is below q, while P(miss >= q) >= e; at most r of the other units
    miss q or more then: with probability at most ``P(Bin(N-k, e) <= r)``. There are C(N, k) choices
    of k numbers, and N values of k below N: in all beta.

    Examples
    --------
    >>> from stochens_rs.theory import scenario
    >>> round(scenario.compression(60, 3, 0.05), 10)
    0.2647576671
    """
    size = validation.size("size", size)
    support = validation.size("support", support, minimum=0, maximum=size)
    violations = validation.size("violations", violations, minimum=0, maximum=size)
    beta = validation.probability("beta", beta)
    return _core.scenario_compression(size, support, violations, beta)


def relaxed(size: int, support: int, beta: float) -> tuple[float, float]:
    """Bound the risk from below and above for a convex design that pays for violations.

    Parameters
    ----------
    support : int
        The number k of units that violate the design or that it rests on.
    beta : float
        Probability that one of the two bounds fails, in (0, 1).
    size
        As in `a_priori`.

    Returns
    -------
    tuple of float
        The two roots ``e`` around k/N of ``C(N, k) t^(N-k) = beta/2N sum_{i=k}^{N-1} C(i, k)
        t^(i-k) + beta/6N sum_{i=N+1}^{4N} C(i, k) t^(i-k)``, ``t = 1 - e``. (Garatti and Campi
        2022.)

    Raises
    ------
    SizeError, InputError, InputTypeError
        As `a_priori`.

    Notes
    -----
    The violations must have a price in the objective of the design. For units that were left out
    by choice this bound fails; for these there is `discarding`.

    Examples
    --------
    >>> from stochens_rs.theory import scenario
    >>> low, high = scenario.relaxed(60, 10, 0.01)
    >>> round(low, 10), round(high, 10)
    (0.0467202575, 0.3779349539)
    """
    size = validation.size("size", size)
    support = validation.size("support", support, minimum=0, maximum=size)
    return _core.scenario_relaxed(size, support, validation.probability("beta", beta))


def discarding(size: int, discarded: int, dimension: int, beta: float) -> float:
    """Bound the risk of a convex design after some units were left out.

    Parameters
    ----------
    discarded : int
        The number r of the N units that were left out, by any rule; fixed before the units were
        seen. Each of them must miss more than the final threshold.
    dimension : int
        The number d of variables, as in `a_priori`.
    size, beta
        As in `a_priori`.

    Returns
    -------
    float
        ``e`` with ``C(r+d-1, r) sum_{i<=r+d-1} C(N, i) e^i (1-e)^(N-i) = beta``; 1 if
        r + d - 1 >= N. (Campi and Garatti 2011.)

    Raises
    ------
    SizeError, InputError, InputTypeError
        As `a_priori`.

    Examples
    --------
    >>> from stochens_rs.theory import scenario
    >>> round(scenario.discarding(3000, 30, 21, 1e-6), 4)
    0.0481
    """
    size, dimension = validation.size("size", size), validation.size("dimension", dimension)
    discarded = validation.size("discarded", discarded, minimum=0, maximum=size)
    beta = validation.probability("beta", beta)
    return _core.scenario_discarding(size, discarded, dimension, beta)


def hold_out(size: int, violations: int, beta: float) -> float:
    """Bound the risk of any command by fresh units that had no part in its design.

    Parameters
    ----------
    size : int
        The number of fresh units.
    violations : int
        How many of them miss more than the threshold.
    beta
        As in `a_priori`.

    Returns
    -------
    float
        ``e`` with ``P(Bin(size, e) <= violations) = beta``; 1 if all violate. (Clopper and Pearson
        1934.)

    Raises
    ------
    SizeError, InputError, InputTypeError
        As `a_priori`.

    Examples
    --------
    >>> from stochens_rs.theory import scenario
    >>> round(scenario.hold_out(3000, 0, 1e-6), 4)
    0.0046
    """
    size = validation.size("size", size)
    violations = validation.size("violations", violations, minimum=0, maximum=size)
    return _core.scenario_at_most(size, violations, validation.probability("beta", beta))


def required_scenarios(epsilon: float, dimension: int, beta: float) -> int:
    """Return the smallest number of units with an `a_priori` risk of at most `epsilon`.

    Parameters
    ----------
    epsilon : float
        The risk allowed, in (0, 1).
    dimension : int
        The number d of variables, as in `a_priori`.
    beta
        As in `a_priori`.

    Returns
    -------
    int
        At least d.

    Raises
    ------
    SizeError, InputError, InputTypeError
        As `a_priori`, or more than 2^53 units are required.

    Examples
    --------
    >>> from stochens_rs.theory import scenario
    >>> scenario.required_scenarios(0.05, 21, 1e-6)
    992
    """
    epsilon, beta = validation.probability("epsilon", epsilon), validation.probability("beta", beta)
    return _core.scenario_required(epsilon, validation.size("dimension", dimension), beta)
