"""The smallest of all bounds that hold for a quantity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from ..._base import gate, html
from ..._base.types import Axis, Fusion
from ...exceptions import InputError, InputTypeError
from ..formulas import Sizes
from ._base import Bound
from ._geometry import Geometry
from .averages import Bousquet, Chebyshev, Hoeffding, McDiarmid
from .fused import DiagonalBousquet, DiagonalMcDiarmid, Fused, FusedChebyshev
from .norms import Bernstein, Weissman
from .one_step import OneStepHoeffding, OneStepMcDiarmid
from .product import ProductBousquet, ProductHoeffding, ProductMcDiarmid, ProductParts
from .simulated import Simulated
from .trajectories import Trajectory, TrajectoryBousquet, TrajectoryChebyshev, TrajectoryMcDiarmid

Of: TypeAlias = Literal["vector", "matrix", "state", "control", "trajectory"]

_DATA = {
    "vector": "w",
    "matrix": "A",
    "state": "B, x0, xf, A",
    "control": "B, x0, xf, A",
    "trajectory": "A, B, x0, u",
}
_NORMS = {"vector": ("2", "1"), "matrix": ("spectral", "Frobenius")}


@dataclass(frozen=True)
class Best:
    """The smallest bound and what it gives.

    Attributes
    ----------
    bound : Bound
        The bound that was chosen.
    radius : float
        Its radius for `size` and `delta`.
    size : int, None or (N0, Nf, NA)
        The size that was given, or the smallest sufficient one.
    delta : float
        The probability of failure that was given.
    """

    bound: Bound
    radius: float
    size: Sizes
    delta: float

    def _repr_html_(self) -> str:
        return html.record(self)


def candidates(
    quantity: Of,
    *data: Any,
    norm: str | None = None,
    fusion: Fusion = "product",
    axis: Axis = "columns",
) -> list[Bound]:
    """All formulas that bound a quantity, for independent realizations.

    Parameters
    ----------
    quantity : {"vector", "matrix", "state", "control", "trajectory"}
        What the error is of.
    *data : array_like
        ``w``; ``A``; ``B, x0, xf, A`` for the state or the control; ``A, B, x0, u``.
    norm : str, optional
        Vector: "2" (default) or "1". Matrix: "spectral" (default) or "Frobenius". The others
        are in the 2-norm.
    fusion : {"product", "diagonal"}, default "product"
        For a state or a control.
    axis : {"columns", "rows"}, default "columns"
        Which lines of the matrices are sampled.

    Returns
    -------
    list of Bound
        The valid ones, with the data checked and the moments computed. :class:`Simulated` is not
        among them: it is no formula, and needs a `delta` that can be simulated.

    Raises
    ------
    InputError, InputTypeError
        A choice is unknown, or the data do not fit it.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> [bound.name for bound in bounds.candidates("vector", [3.0, -1.0, 0.5])]
    ['McDiarmid', 'Bousquet', 'Weissman', 'Hoeffding', 'Chebyshev']
    """
    name = gate.choice("quantity", quantity, tuple(_DATA))
    if len(data) != len(_DATA[name].split(", ")):
        raise InputTypeError(f"`data` must be {_DATA[name]} for a {name}, got {len(data)} arrays")
    allowed = _NORMS.get(name, ("2",))
    chosen = allowed[0] if norm is None else gate.choice("norm", norm, allowed)
    if name == "vector":
        return _for_vector(data[0], chosen)
    if name == "matrix":
        A = gate.matrix("A", data[0])
        found: list[Bound] = [kind(A, axis=axis) for kind in (McDiarmid, Bousquet)]
        found += [kind(A, axis=axis) for kind in (Hoeffding, Chebyshev)]
        return [Bernstein(A, axis=axis), *found] if chosen == "spectral" else found
    if name == "trajectory":
        return _for_trajectory(data, axis)
    B, x0, xf, A = data
    return _for_control(Geometry(B, x0, xf, A, axis, name), fusion)


def best(
    quantity: Of,
    *data: Any,
    delta: float,
    size: Sizes = None,
    eps: float | None = None,
    norm: str | None = None,
    fusion: Fusion = "product",
    axis: Axis = "columns",
) -> Best:
    """The smallest radius for a size, or the smallest size for a radius.

    Parameters
    ----------
    quantity, *data, norm, fusion, axis
        As in :func:`candidates`.
    delta : float
        Probability of failure, in (0, 1).
    size : int or (N0, Nf, NA), optional
        Number of realizations; give either this or `eps`.
    eps : float, optional
        Error that may be exceeded with probability `delta` only.

    Returns
    -------
    Best
        The bound with its radius and size.

    Raises
    ------
    InputError, InputTypeError
        As :func:`candidates`; both or none of `size` and `eps` are given; an argument is out of
        range; more than 2^53 realizations would be needed.

    Notes
    -----
    The choice depends on the arguments only, not on realizations: :class:`Simulated` where `delta`
    and the size of the problem allow it, which no other bound can beat by more than a few percent
    (not for trajectories); otherwise the smallest of :func:`candidates`: Weissman's wins for few
    entries, Bousquet's for many realizations, McDiarmid's for few, Chebyshev's for large delta.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> chosen = bounds.best("vector", [3.0, -1.0, 0.5, 2.0], eps=0.1, delta=0.01)
    >>> chosen.bound.name, 12_000 < chosen.size < 15_000, chosen.radius <= 0.1
    ('simulated', True, True)
    """
    if (size is None) == (eps is None):
        raise InputError("`size` or `eps` must be given, and not both")
    found = candidates(quantity, *data, norm=norm, fusion=fusion, axis=axis)
    if eps is not None:
        drawn = _simulated(quantity, data, 1, delta, norm, fusion, axis)
        needed, bound = _smallest_size([drawn] if drawn else found, eps, delta)
        return Best(bound, bound.radius(needed, delta), needed, delta)
    if len({rate for rate in found[0]._rates(size) if rate > 0.0}) > 1:
        found = [bound for bound in found if not isinstance(bound, ProductBousquet)]
    radii = [bound.radius(size, delta) for bound in found]
    k = radii.index(min(radii))
    drawn = _simulated(quantity, data, size, delta, norm, fusion, axis)
    if drawn is None or radii[k] == 0.0:
        return Best(found[k], radii[k], size, delta)
    return Best(drawn, drawn.radius(size, delta), size, delta)


def _simulated(
    quantity: Of,
    data: tuple[Any, ...],
    size: Sizes,
    delta: float,
    norm: str | None,
    fusion: Fusion,
    axis: Axis,
) -> Simulated | None:
    """The simulated bound, where there is one."""
    if quantity == "trajectory":
        return None
    bound = Simulated(quantity, *data, norm=norm, fusion=fusion, axis=axis)
    return bound if bound._possible(size, gate.probability("delta", delta)) else None


def _smallest_size(found: list[Bound], eps: float, delta: float) -> tuple[int, Bound]:
    """Search each bound in turn; one that fails below the record need not be bisected."""
    best_size, best_bound = found[0].required_size(eps, delta), found[0]
    for bound in found[1:]:
        if best_size > 1 and bound.radius(best_size - 1, delta) <= eps:
            best_size, best_bound = bound.required_size(eps, delta), bound
    return best_size, best_bound


def _for_vector(w: Any, norm: str) -> list[Bound]:
    checked = gate.vector("w", w)
    if norm == "1":
        return [Weissman(checked)]
    return [
        McDiarmid(checked),
        Bousquet(checked),
        Weissman(checked, norm="2"),
        Hoeffding(checked),
        Chebyshev(checked),
    ]


def _for_trajectory(data: tuple[Any, ...], axis: Axis) -> list[Bound]:
    kinds: tuple[type[Trajectory], ...]
    kinds = (TrajectoryMcDiarmid, TrajectoryBousquet, TrajectoryChebyshev)
    found = [kind(*data, axis=axis) for kind in kinds]
    if len(found[0]._u) > 1 or axis == "rows":
        return [*found]
    return [*found, OneStepMcDiarmid(*data), OneStepHoeffding(*data)]


def _for_control(at: Geometry, fusion: str) -> list[Bound]:
    chebyshev = FusedChebyshev._sharing(at)
    kinds: tuple[type[Fused], ...]
    if gate.choice("fusion", fusion, ("product", "diagonal")) == "diagonal":
        chebyshev._paired = True
        kinds = (DiagonalMcDiarmid, DiagonalBousquet)
    else:
        kinds = (ProductMcDiarmid, ProductBousquet, ProductParts)
        if at.quantity == "state":
            kinds = (*kinds, ProductHoeffding)
    return [*(kind._sharing(at) for kind in kinds), chebyshev]
