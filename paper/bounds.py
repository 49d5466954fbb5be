"""The bounds as the paper prints them, and what is wrong with each.

`Corrected` is what holds in their place.
"""

from __future__ import annotations

import math
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stochens_rs import System
from stochens_rs.exceptions import NonFiniteError

from . import common as check
from .common import Floats

__all__ = ["Lemma42", "Lemma43", "OneVector", "Printed"]


class Printed:
    """A sum of exponentials ``C sum_i exp(-2 N eps^2 / c_i^2)``, as printed.

    Parameters
    ----------
    constant, *widths : float
        ``C`` and the ``c_i``.

    Attributes
    ----------
    wrong : str
        What is wrong with it, and under which reading it holds.

    Examples
    --------
    >>> from paper import bounds
    >>> isinstance(bounds.OneVector([1.0, 1.0]), bounds.Printed)
    True
    """

    name: ClassVar[str]
    source: ClassVar[str]
    quantity: ClassVar[str]
    wrong: ClassVar[str]

    def __init__(self, constant: float, *widths: float) -> None:
        if not all(math.isfinite(c) for c in widths):
            raise NonFiniteError("a constant of the lemma overflows: scale the problem down")
        self._constant, self._widths = constant, widths

    def probability(self, size: int, eps: float) -> float:
        """The printed bound on the probability that the error exceeds `eps`, at most 1."""
        level = self._level(check.size("size", size), check.positive("eps", eps))
        return 1.0 if level <= 0.0 else math.exp(-level)

    def radius(self, size: int, delta: float) -> float:
        """The least `eps` at which `probability` is at most `delta`."""
        size = check.size("size", size)
        level = -math.log(check.positive("delta", delta, maximum=1.0))
        if self._level(size, math.ulp(0.0)) >= level:
            return 0.0
        outside = 1.0
        while self._level(size, outside) < level:
            outside *= 2.0
        inside = outside / 2.0
        while inside > 0.0 and self._level(size, inside) >= level:
            outside, inside = inside, inside / 2.0
        while inside < (middle := inside + (outside - inside) / 2.0) < outside:
            inside, outside = (
                (middle, outside) if self._level(size, middle) < level else (inside, middle)
            )
        return outside

    def _level(self, size: int, eps: float) -> float:
        """Level of the sum, from the exponents ``2 N eps^2 / c_i^2``."""
        levels = [2.0 * size * (eps / c) ** 2 for c in self._widths if c > 0.0]
        least = min(levels, default=math.inf)
        if least == math.inf:
            return math.inf
        return least - math.log(self._constant * sum(math.exp(least - one) for one in levels))


class OneVector(Printed):
    """Behind Lemma 4.2: ``P(||w_hat - w||_2 > eps) <= 2 C exp(-2 N eps^2 / g^2)``.

    Parameters
    ----------
    w : (n,) array_like
        The vector.
    C : float, optional
        "A constant dependent only on n"; n if not given.

    Raises
    ------
    InputError, InputTypeError
        `w` is not a finite vector, `C` is not a positive number.

    Notes
    -----
    False for every C: see ``wrong``; `Corrected` holds.

    Examples
    --------
    >>> from paper import bounds
    >>> printed = bounds.OneVector([0.5, 0.5], C=4.0)
    >>> f"{printed.probability(200, 0.3):.1e}"  # exactly 1.0e-9
    '1.9e-15'
    """

    name = "one vector, as printed"
    source = "paper, proof of Lemma 4.2 (Hoeffding for each entry)"
    quantity = "vector"
    wrong = (
        "The constant eta(n) with ||w|| <= eta(n) ||w||_inf belongs in the exponent, as "
        "eps / eta(n); as a factor no constant C(n) is large enough. For n = 2 and equal "
        "entries the exact rate is N eps^2 / g^2, half the printed one. With exponent "
        "N eps^2 / g^2 and eps measured from the rms on, the bound holds for all n."
    )

    def __init__(self, w: ArrayLike, *, C: float | None = None) -> None:
        checked = check.vector("w", w)
        constant = float(checked.size) if C is None else check.positive("C", C)
        with np.errstate(over="ignore"):
            super().__init__(2.0 * constant, float(np.abs(checked).sum()))


class Lemma42(Printed):
    """Lemma 4.2: ``2 C sum_i exp(-2 N eps^2 / (9 beta^2 gamma_i^2))`` over ``xf``, ``x0``, ``A``.

    Parameters
    ----------
    system : System or (A, B)
        The system, or what `System.from_any` takes; A is sampled by columns, B plays no part.
    x0, xf : (n,) array_like
        Initial state and target state.
    C : float, optional
        "A constant dependent only on n"; n if not given.
    reading : {"realizations", "matrix"}, default "realizations"
        ``beta = max(B_A, 1, ||x0||)`` with ``B_A`` the largest 2-norm of a realization of A, as
        the proof has it, or with ``||A||_2`` in its place.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, `C` is not positive, `reading` is unknown.

    Notes
    -----
    See ``wrong``. `best` has bounds that hold and are smaller.

    Examples
    --------
    >>> from paper import bounds
    >>> system = [[1.0, 0.0], [2.0, 5.0]], [[1.0], [0.0]]
    >>> lemma = bounds.Lemma42(system, [1.0, 1.0], [2.0, 2.0], C=2.0)
    >>> round(lemma.radius(1000, 0.01), 3)
    4.8
    """

    name = "Lemma 4.2, as printed"
    source = "paper, Lemma 4.2"
    quantity = "state"
    wrong = (
        "The proof is wrong (see OneVector). The statement happens to hold for the average of "
        "paired realizations, in every p-norm with p >= 2, with C = 2 whatever n is, if beta "
        "contains the largest norm B_A of a realization of A, as in the proof of Lemma 3.2; for "
        "product fusion with C = 28. With ||A|| for B_A it is false: A = H/8 with the Hadamard "
        "matrix of order 64, x0 = (1, ..., 1)/8, N = 50 needs C > 10^7."
    )

    def __init__(
        self,
        system: System | tuple[ArrayLike, ArrayLike],
        x0: ArrayLike,
        xf: ArrayLike,
        *,
        C: float | None = None,
        reading: Literal["realizations", "matrix"] = "realizations",
    ) -> None:
        A = System.from_any(system).A
        x0 = check.vector("x0", x0, length=len(A))
        xf = check.vector("xf", xf, length=len(A))
        check.choice("reading", reading, ("realizations", "matrix"))
        constant = float(len(A)) if C is None else check.positive("C", C)
        with np.errstate(over="ignore"):
            drawn = reading == "realizations"
            norm = largest_realization(A) if drawn else float(np.linalg.norm(A, 2))
            self.beta = max(norm, 1.0, float(np.linalg.norm(x0)))
            gammas = [np.abs(x).sum(axis=0).max() for x in (xf, x0, A)]
        super().__init__(2.0 * constant, *(3.0 * self.beta * float(gamma) for gamma in gammas))


class Lemma43(Printed):
    """Lemma 4.3: ``2 C (e^c1 + e^c2 + e^c3)`` for the average of the runs after K steps.

    Parameters
    ----------
    system : System or (A, B)
        The system, or what `System.from_any` takes.
    x0 : (n,) array_like
        Initial state.
    u : (K, m) array_like
        The controls.
    C : float, optional
        "C only depends on n"; n if not given.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, or `C` is not positive.

    Notes
    -----
    ``c_i = -2 N eps^2 / (9 d_i^2)`` with ``d = (||u|| gB, ||A|| g0, ||x0|| gA)``, ``||u||`` the
    2-norm of all controls. See ``wrong``; `Corrected` holds.

    Examples
    --------
    >>> import numpy as np
    >>> from paper import bounds
    >>> A = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2.0)
    >>> x0, B = np.full(2, 0.5**0.5), [[1.0], [0.0]]
    >>> one, ten = (bounds.Lemma43((A, B), x0, np.zeros((K, 1))).radius(100, 0.01) for K in (1, 10))
    >>> one == ten  # while the variance grows 2000-fold
    True
    """

    name = "Lemma 4.3, as printed"
    source = "paper, Lemma 4.3"
    quantity = "trajectory"
    wrong = (
        "False for every C(n). One step: with A = H/sqrt(n), x0 = (1, ..., 1)/sqrt(n) and u = 0 "
        "the error 0.9 rms is likely while the bound falls with n; ||A|| g0 and ||x0|| gA must "
        "be gA g0. K steps: nothing in the bound depends on K, while N times the mean square "
        "error is 2^(K+1) - 1 for n = 2. For K = 1 it holds with gA g0 and the factor 4."
    )

    def __init__(
        self,
        system: System | tuple[ArrayLike, ArrayLike],
        x0: ArrayLike,
        u: ArrayLike,
        *,
        C: float | None = None,
    ) -> None:
        checked = System.from_any(system)
        A, B = checked.A, checked.B
        x0 = check.vector("x0", x0, length=len(A))
        u = np.asarray(u, dtype=np.float64).reshape(-1, B.shape[1])
        constant = float(len(A)) if C is None else check.positive("C", C)
        with np.errstate(over="ignore"):
            gA, gB = (float(np.abs(x).sum(axis=0).max()) for x in (A, B))
            widths = (
                float(np.linalg.norm(u)) * gB,
                float(np.linalg.norm(A, 2)) * float(np.abs(x0).sum()),
                float(np.linalg.norm(x0)) * gA,
            )
        super().__init__(2.0 * constant, *(3.0 * d for d in widths))


class Corrected(NamedTuple):
    """``P(error >= sqrt(V / N) + t) <= exp(-N t^2 / W)`` for the average of N realizations.

    McDiarmid's inequality. V is the mean square error of one realization and W as follows.

    ==========================  ================================================================
    a vector                    ``g^2``
    a state, diagonal fusion    ``g(xf)^2 + 2 g(x0)^2 g(A)^2``
    runs over K steps           ``2 R_K^2``, ``R_0 = g(x0)``, ``R_{k+1} = g(A) R_k +
                                sum_j |u_j(k)| ||b_j||_1``
    ==========================  ================================================================
    """

    mean_square: float
    ranges: float

    def probability(self, size: int, eps: float) -> float:
        """A bound on the probability that the error exceeds `eps`."""
        beyond = math.sqrt(size) * eps - math.sqrt(self.mean_square)
        return 1.0 if beyond <= 0.0 else math.exp(-beyond * beyond / self.ranges)

    def radius(self, size: int, delta: float) -> float:
        """The error that is exceeded with probability at most `delta`."""
        level = -math.log(delta)
        return (math.sqrt(self.mean_square) + math.sqrt(self.ranges * level)) / math.sqrt(size)


def largest_realization(A: Floats) -> float:
    """``B_A = max_i sqrt(sum of g_j^2 over a_ij != 0)``: every column that can hit row i does."""
    squares = np.abs(A).sum(axis=0) ** 2
    return math.sqrt(float(((A != 0.0) @ squares).max()))
