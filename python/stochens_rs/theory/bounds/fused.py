"""What bounds for a fused control share, and those for diagonal fusion (paired realizations)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ..._base import gate
from ..._base.types import Axis, Fusion
from ...exceptions import InputError
from ..formulas import Sizes, inverse_size, one_each
from ._base import Bound, Rates
from ._geometry import Geometry, largest_norm
from ._inequalities import bousquet, bousquet_level, chebyshev_level, mcdiarmid, mcdiarmid_level

Quantity: TypeAlias = Literal["state", "control"]

_ENTITIES = ("x0", "xf", "A")


class Fused(Bound):
    """Common to the bounds for the control ``u`` of `control` under uniform weights.

    Parameters
    ----------
    B : (n, m) array_like
        Input matrix, known exactly; any rank.
    x0, xf : (n,) array_like
        Initial state and target state.
    A : (n, n) array_like
        State matrix.
    quantity : {"state", "control"}, default "state"
        The error: ``||B (u - v*)||_2`` of the state after one step or ``||u - v*||_2`` of the
        control, ``v* = B+ (xf - A x0)``.
    axis : {"columns", "rows"}, default "columns"
        Which lines of ``A`` are sampled.

    Raises
    ------
    InputError, InputTypeError
        A shape does not fit, an entry is not finite, a choice is unknown, or ``A x0`` overflows.

    Notes
    -----
    Realizations of different entities, and of the same, must be independent. Where the paper's
    lemmas bound with norms, the moments and diameters here are those of the image under ``B B+``
    (state) or ``B+`` (control), and never larger.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> isinstance(bounds.ProductMcDiarmid([[1.0]], [1.0], [0.0], [[2.0]]), bounds.Fused)
    True
    """

    _paired = False

    def __init__(
        self,
        B: ArrayLike,
        x0: ArrayLike,
        xf: ArrayLike,
        A: ArrayLike,
        *,
        quantity: Quantity = "state",
        axis: Axis = "columns",
    ) -> None:
        self._use(Geometry(B, x0, xf, A, axis, quantity))

    @classmethod
    def _sharing(cls, geometry: Geometry) -> Fused:
        """Make a bound from moments that are there already."""
        self = object.__new__(cls)
        self._use(geometry)
        return self

    def _use(self, geometry: Geometry) -> None:
        self._at = geometry
        self.quantity, self.norm, self._unit = geometry.quantity, "2", geometry.unit

    def required_size(self, eps: float, delta: float, *, exact: Sequence[str] = ()) -> int:
        """Smallest number of realizations that gives a radius of at most `eps`.

        Parameters
        ----------
        eps : float
            Error, > 0, in the units of the quantity.
        delta : float
            Probability of failure, in (0, 1).
        exact : sequence of {"x0", "xf", "A"}, default ()
            Entities that are known exactly.

        Returns
        -------
        int
            The same number for all other entities.

        Raises
        ------
        InputError, InputTypeError
            An argument is out of range, or more than 2^53 realizations are needed.
        """
        given = gate.items("exact", exact)
        known = {gate.choice("exact", name, _ENTITIES) for name in given}
        sampled = tuple(float(name not in known) for name in _ENTITIES)
        return self._required(eps, delta, lambda rate: tuple(rate * flag for flag in sampled))

    def _rates(self, size: Sizes) -> Rates:
        sizes = one_each(size)
        rates = tuple(inverse_size(f"size[{k}]", N) for k, N in enumerate(sizes))
        if self._paired:
            _check_equal(rates, "diagonal fusion pairs the realizations")
        return rates

    def _same(self, rate: float) -> Rates:
        return rate, rate, rate

    def _largest_error(self, rates: Rates) -> float:
        """Product fusion, too: convex in every line, so that the worst average is a realization."""
        r0, rf, rA = rates
        if r0 == 0.0 or rA == 0.0:
            return largest_linear(self._at, rates)
        return largest_linear(self._at, (0.0, rf, 0.0)) + self._at.reach_z

    def _linear_range(self, rates: Rates) -> float:
        """Half the summed squared ranges of ``xf_hat`` and ``x0_hat``."""
        r0, rf, rA = rates
        return (self._at.D_f**2 * rf + self._at.D_0(rA) ** 2 * r0) / 2.0


class FusedChebyshev(Fused):
    """Chebyshev's inequality for the fused control: ``sqrt(tr Cov / delta)``.

    Parameters
    ----------
    B, x0, xf, A, quantity, axis
        As in :class:`Fused`.
    fusion : {"product", "diagonal"}, default "product"
        The fusion.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Fused`.

    Notes
    -----
    ``Cov`` is the exact covariance of `moments.control_covariance` or `moments.state_covariance`.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> B, x0, xf, A = [[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> round(bounds.FusedChebyshev(B, x0, xf, A, quantity="control").radius(10, 0.25), 6)
    1.697056
    """

    name = "Chebyshev"
    source = "Markov's inequality for the squared error"

    def __init__(
        self,
        B: ArrayLike,
        x0: ArrayLike,
        xf: ArrayLike,
        A: ArrayLike,
        *,
        quantity: Quantity = "state",
        axis: Axis = "columns",
        fusion: Fusion = "product",
    ) -> None:
        self._paired = gate.choice("fusion", fusion, ("product", "diagonal")) == "diagonal"
        super().__init__(B, x0, xf, A, quantity=quantity, axis=axis)

    def _rms(self, rates: Rates) -> float:
        square = self._at.paired_mean_square if self._paired else self._at.mean_square
        return math.sqrt(square(*rates))

    def _radius(self, rates: Rates, level: float) -> float:
        return self._rms(rates) * math.exp(level / 2.0)

    def _level(self, rates: Rates, eps: float) -> float:
        return chebyshev_level(self._rms(rates), eps)


class DiagonalMcDiarmid(Fused):
    """McDiarmid's inequality for diagonal fusion: ``rms + sqrt((D_f^2 + D_z^2) L / (2 N))``.

    Parameters
    ----------
    B, x0, xf, A, quantity, axis
        As in :class:`Fused`.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Fused`.

    Notes
    -----
    2 N independent coordinates, ``xf^s`` and ``z^s = A^s x0^s``, with the diameters ``D_f`` and
    ``D_z`` of their atoms under ``B B+`` or ``B+``. For the state ``D_f^2 <= 2 gf^2`` and
    ``D_z^2 <= 4 g0^2 gA^2``, which gives the exponent ``N t^2 / (gf^2 + 2 g0^2 gA^2)``; with it
    Lemma 4.2 is true for this fusion, with its constant C = 2 and ``beta`` at least the largest
    norm of a realization of A. With an entity known exactly, its realizations drop out. Rows of
    A: ``D_z`` is twice the radius of a ball that contains all ``z^s``.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> B, x0, xf, A = [[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> round(bounds.DiagonalMcDiarmid(B, x0, xf, A).radius(1000, 0.01), 4)
    0.4409
    """

    name = "McDiarmid"
    source = "bounded differences in N pairs xf^s, A^s x0^s; mean at most the exact rms"
    _paired = True

    def _constants(self, rates: Rates) -> tuple[float, float]:
        r0, rf, rA = rates
        at = self._at
        if r0 > 0.0 and rA > 0.0:
            spread = (at.D_f**2 * rf + at.D_z**2 * r0) / 2.0
        else:  # nothing is paired with A: as product fusion
            spread = self._linear_range(rates) + at.range_A(at.x0) ** 2 * rA / 2.0
        return math.sqrt(at.paired_mean_square(*rates)), spread

    def _radius(self, rates: Rates, level: float) -> float:
        return mcdiarmid(*self._constants(rates), level)

    def _level(self, rates: Rates, eps: float) -> float:
        return mcdiarmid_level(*self._constants(rates), eps)


class DiagonalBousquet(Fused):
    """Bousquet's inequality for diagonal fusion: ``E + sqrt(2 L (lam + 2 U E)) + U L / 3``.

    Parameters
    ----------
    B, x0, xf, A, quantity, axis
        As in :class:`Fused`.

    Raises
    ------
    InputError, InputTypeError
        As :class:`Fused`.

    Notes
    -----
    With ``M = B B+`` (state) or ``B+`` (control) and the covariance ``C_y = Cv(xf) + C_z`` of one
    pair: ``E^2 = tr(M C_y M^T) / N``, ``lam = lambda_max(M C_y M^T) / N``, and ``U`` over N the
    largest ``||M (xf^s - xf)||`` plus the largest ``||M (z^s - A x0)||``.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> B, x0, xf, A = [[1.0], [0.0]], [1.0, 1.0], [2.0, 2.0], [[1.0, 0.0], [2.0, 5.0]]
    >>> round(bounds.DiagonalBousquet(B, x0, xf, A).radius(1000, 0.01), 4)
    0.414
    """

    name = "Bousquet"
    source = "supremum of <v, M (average of pairs - mean)> over unit vectors v"
    _paired = True

    def _constants(self, rates: Rates) -> tuple[float, float, float]:
        rate, at = max(rates), self._at
        largest, variance = self._largest_error(rates), top_eigenvalue(at, rates, both=True)
        return math.sqrt(at.paired_mean_square(*rates)), variance * rate, largest * rate

    def _radius(self, rates: Rates, level: float) -> float:
        return bousquet(*self._constants(rates), level)

    def _level(self, rates: Rates, eps: float) -> float:
        return bousquet_level(*self._constants(rates), eps)


def largest_linear(at: Geometry, rates: Rates) -> float:
    """Largest deviation of ``M (xf^s - A x0^s - A^s x0)`` over the entities with a rate."""
    r0, rf, rA = rates
    M = at.M
    largest = at.reach_A if rA > 0.0 else 0.0
    if rf > 0.0:
        largest += largest_norm(at.atoms_f - (M @ at.xf)[:, None])
    if r0 > 0.0:
        largest += largest_norm(at.atoms_0 - (M @ (at.A @ at.x0))[:, None])
    return largest


def top_eigenvalue(at: Geometry, rates: Rates, *, both: bool) -> float:
    """``lambda_max`` of the covariance of one realization of each entity with a rate."""
    covariance = at.covariance(*rates, both=both)
    return max(0.0, float(np.linalg.eigvalsh(covariance)[-1])) if covariance.size else 0.0


def _check_equal(rates: Rates, why: str) -> None:
    if len({rate for rate in rates if rate > 0.0}) > 1:
        sizes = ", ".join(f"{1.0 / rate:g}" if rate else "None" for rate in rates)
        raise InputError(f"`size` must be one number here ({why}), got N0, Nf, NA = {sizes}")
