"""One bound by its name, all that apply, and the best of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, overload

from ..._base import html, validation
from ..._base.types import SCHEMES, Axis, Fusion, Scheme
from ...exceptions import InputError
from ...rng import RngLike, as_key
from ..formulas import Sizes
from .base import Bound, differ
from .problem import BoundedQuantity, Of, refuse_choices
from .simulated import Simulated
from .table import DEPENDENT, TABLE


@dataclass(frozen=True)
class Best:
    """The smallest bound, with its radius and size.

    Attributes
    ----------
    bound : Bound
        The bound that was chosen.
    radius : float
        Its radius for `size` and `delta`.
    size : int, None or (N0, Nf, NA)
        The given size, or the smallest sufficient one.
    delta : float
        The given probability of failure.
    """

    bound: Bound
    radius: float
    size: Sizes
    delta: float

    def _repr_html_(self) -> str:
        return html.record(self)


@overload
def bound(name: Literal["simulated"], quantity: Of, *data: Any, **choices: Any) -> Simulated: ...
@overload
def bound(name: str, quantity: Of, *data: Any, **choices: Any) -> Bound: ...
def bound(
    name: str,
    quantity: Of,
    *data: Any,
    norm: str | None = None,
    fusion: Fusion = "product",
    axis: Axis = "columns",
    scheme: Scheme = "iid",
    steps: int = 1,
    rng: RngLike = 0,
) -> Bound:
    """One bound by its name.

    Parameters
    ----------
    name : str
        As in the table of :mod:`stochens_rs.theory.bounds`.
    quantity, *data, norm, fusion, axis
        As in :func:`candidates`.
    scheme : {"iid", "systematic"}, default "iid"
        For "simulated": how the realizations are drawn.
    steps : int, default 1
        For "simulated" and a state or a control: number of steps K; K > 1 with product fusion.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, default 0
        For "simulated": source of randomness; with the default equal errors in every call.

    Returns
    -------
    Bound
        The bound; :class:`Simulated` for "simulated".

    Raises
    ------
    InputError, InputTypeError
        There is no such bound (the message lists those that exist), a choice is unknown or has no
        effect, the data do not fit, or fusion="diagonal" goes with several steps or systematic
        rows.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> bounds.bound("systematic", "vector", [3.0, -1.0, 0.5, -0.5]).radius(1000, 0.01)
    0.01
    >>> bounds.bound("Weissman", "vector", [3.0, -1.0], norm="1").required_size(0.1, 0.01)
    16955
    """
    problem = BoundedQuantity(quantity, data, norm, fusion, axis)
    how = validation.choice("scheme", scheme, SCHEMES)
    K, key = validation.size("steps", steps), as_key(rng)
    found = problem.rows(TABLE + DEPENDENT)
    if validation.choice("name", name, (*found, "simulated")) == "simulated":
        if problem.system is None:
            refuse_choices(f"for a {problem.quantity}", steps=(K, 1))
        return problem.simulated(how, K, key)
    refuse_choices(f"for the bound '{name}'", scheme=(how, "iid"), steps=(K, 1), rng=(rng, 0))
    return problem.bound(*found[name])


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
    quantity : {"vector", "matrix", "state", "control"}
        The quantity whose error is bounded.
    *data : System or array_like
        ``w``; ``A``; ``system, x0, xf`` for a state or a control. `system` is a System
        or what `System.from_any` takes, such as ``(A, B)``.
    norm : str, optional
        Vector: "2" (default) or "1". Matrix: "spectral" (default) or "Frobenius". The others
        are in the 2-norm.
    fusion : {"product", "diagonal"}, default "product"
        For a state or a control.
    axis : {"columns", "rows"}, default "columns"
        Which lines of the matrices are sampled; not for a vector.

    Returns
    -------
    list of Bound
        In the order of the table, without "simulated" (see :func:`bound`), which is no formula.

    Raises
    ------
    InputError, InputTypeError
        A choice is unknown or has no effect, or the data do not fit.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> [bound.name for bound in bounds.candidates("vector", [3.0, -1.0, 0.5])]
    ['Bousquet', 'Weissman']
    """
    return BoundedQuantity(quantity, data, norm, fusion, axis).formulas()


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
        Error that may be exceeded with probability `delta`.

    Returns
    -------
    Best
        The bound with its radius and size.

    Raises
    ------
    InputError, InputTypeError
        As :func:`candidates`; both or none of `size` and `eps` are given; an argument is out of
        range; more than 2^53 realizations are needed.

    Notes
    -----
    The choice depends on the arguments only, not on realizations: :class:`Simulated` if `delta` and
    the size of the problem allow it, as it is within a few percent of the quantile; otherwise the
    smallest of :func:`candidates`.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> chosen = bounds.best("vector", [3.0, -1.0, 0.5, 2.0], eps=0.1, delta=0.01)
    >>> chosen.bound.name, 12_000 < chosen.size < 15_000, chosen.radius <= 0.1
    ('simulated', True, True)
    """
    if (size is None) == (eps is None):
        raise InputError("`size` or `eps` must be given, and not both")
    problem = BoundedQuantity(quantity, data, norm, fusion, axis)
    found, delta = problem.formulas(), validation.probability("delta", delta)
    drawn = problem.simulated()
    simulated = drawn.possible(1 if size is None else size, delta)
    if eps is not None:
        needed, chosen = _smallest_size([drawn] if simulated else found, eps, delta)
        return Best(chosen, chosen.radius(needed, delta), needed, delta)
    if differ(found[0]._rates(size, any_sizes=True)):
        found = [one for one in found if not one.equal]
    radii = [one.radius(size, delta) for one in found]
    k = radii.index(min(radii))
    if radii[k] == 0.0 or not simulated:
        return Best(found[k], radii[k], size, delta)
    return Best(drawn, drawn.radius(size, delta), size, delta)


def _smallest_size(found: list[Bound], eps: float, delta: float) -> tuple[int, Bound]:
    """Search the bounds in turn; only those that allow a smaller size are bisected."""
    least, smallest = found[0].required_size(eps, delta), found[0]
    for one in found[1:]:
        if least > 1 and one.radius(least - 1, delta) <= eps:
            least, smallest = one.required_size(eps, delta), one
    return least, smallest
