"""`Limits`: what a control must keep to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from .entries import Asked, Entries, entries, pair_of

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, eq=False, repr=False)
class Limits(Asked):
    """Limits of inputs, of their changes and of states.

    Parameters
    ----------
    u : tuple (low, high) or mapping, optional
        Limits of the inputs, each a number, (m,) or (K, m), infinite or None where there is none;
        equal ones fix an input. Or ``{"force": (-8, 8)}``, numbers for some of the names: the
        others have none.
    rate, previous : float or array_like, shape (m,), optional
        ``|u(k) - u(k-1)| <= rate`` with ``u(-1) = previous``, the input that is applied now.
    x : tuple (low, high) or mapping, optional
        Limits of the states x(1), ..., x(K), each a number, (n,) or (K, n), or None; or by name.
    soft : float or bool, optional
        The weight of the squares of what is beyond `x`; default: 1000 times the largest entry of
        Q and Qf. False: hard limits, with status "infeasible" if they cannot be kept; with a model
        from data the true system keeps them with probability 95 %, that of its looks for a
        `ModelStream`, without noise to come. For a fleet they are hard, and False must be given.

    Raises
    ------
    InputError, InputTypeError
        If an argument is no number, no array and no pair of such; or labels differ.

    Examples
    --------
    >>> import stochens_rs as se
    >>> limits = se.Limits(u=(-1.0, 1.0), rate=0.2, previous=0.0)
    >>> plan = se.control(([[1.0]], [[1.0]]), [1.0], [0.0], steps=3, limits=limits)
    >>> plan.u.ravel().round(2)
    array([-0.2, -0.4, -0.4])
    """

    u: tuple[Entries, Entries] | None = None
    rate: Entries = None
    previous: Entries = None
    x: tuple[Entries, Entries] | None = None
    soft: float | bool | None = None

    def __post_init__(self) -> None:
        self._keep(
            u=pair_of("limits", self.u),
            rate=entries("rate", self.rate),
            previous=entries("previous", self.previous),
            x=pair_of("limits.x", self.x),
        )
        super().__post_init__()


LimitsLike: TypeAlias = "Limits | tuple[Any, Any] | Mapping[str, tuple[Any, Any]] | None"


def as_limits(value: Any) -> Limits:
    """`value` itself, or the limits of inputs for a pair or pairs by name, or none for None."""
    return value if isinstance(value, Limits) else Limits(u=value)
