"""`Cost`: what a control minimises."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .._base import validation
from .._base.types import Floats
from .entries import Asked, Entries, Named, entries


@dataclass(frozen=True, eq=False, repr=False)
class Cost(Asked):
    """Weights of states and inputs, and the states wanted.

    ``J(u) = sum_k ||x(k) - r(k)||^2_Q + ||u(k-1)||^2_R`` over k = 1, ..., K, with Qf at K.

    Parameters
    ----------
    Q, Qf : float or array_like, shape (n,) or (n, n), optional
        Weights of the states x(1), ..., x(K-1), and of x(K): numbers, diagonals or matrices, >= 0.
        Default: Q is 0, and Qf is Q, or I without Q. Tables with the names of the states, of a
        matrix along both axes, may be in any order; so may R with the names of the inputs.
    R : "auto", float or array_like, shape (m,) or (m, m), optional
        Weight of each input. "auto", the default with limits or other weights:
        ``1e-8 tr(G'QG) / (m K)``, G from inputs to states.
    reference : array_like, shape (K + 1, n), optional
        The states wanted at the times 0, ..., K, instead of a target xf at all of them.

    Raises
    ------
    InputError, InputTypeError
        If an argument is no number and no array; or labels differ.

    Examples
    --------
    >>> import stochens_rs as se
    >>> cost = se.Cost(Q=1.0, R=0.5)
    >>> se.control(([[1.0]], [[1.0]]), [1.0], [0.0], steps=2, cost=cost).u.ravel().round(3)
    array([-0.727, -0.182])
    """

    Q: Entries = None
    Qf: Entries = None
    R: Entries | str = None
    reference: Floats | Named | None = None

    def __post_init__(self) -> None:
        for name in ("Q", "Qf", "R"):
            self._keep(**{name: entries(name, getattr(self, name), square=True)})
        self._keep(reference=entries("reference", self.reference))
        super().__post_init__()


def as_cost(value: Any) -> Cost:
    """`value` itself, or no weights for None."""
    return Cost() if value is None else validation.instance("cost", value, Cost)
