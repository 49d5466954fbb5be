"""`SystemEnsemble`: several models (A_s, B_s) of one system."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Annotated, Any, overload

import numpy as np

from .._base import show, validation
from .._base.names import Labels, Order, order_of
from .._base.records import Line, Positive, SavedRecord
from .._base.tables import Tabled
from .._base.types import Centre, Floats
from ..exceptions import InputError, ShapeError
from ..system.system import System, in_order, rebuilt


class SystemEnsemble(SavedRecord, Tabled):
    """Models ``x(k+1) = A_s x(k) + B_s u(k) (+ c_s)``, s = 1, ..., N; immutable.

    Attributes
    ----------
    A : array_like, shape (N, n, n)
        ``A[s]`` is the state matrix of model s. Copied, read-only.
    B : array_like, shape (N, n, m)
        The input matrices.
    c : array_like, shape (N, n), optional
        The offsets; None: no model has one.
    centre : {"truth", "estimate"}, optional
        What the models scatter about. "truth": their mean is the true system, as for
        realizations drawn from it. "estimate": the mean is an estimate from data, as for
        drawn models; then no statement about the distance to the truth follows from the
        scatter, and the bounds for realizations refuse them. None, the default: unknown.
    dt : float, optional
        The time between two steps [s].
    about : str, default ""
        Where the models are from, in words.
    labels : Labels, optional
        The names of states and inputs, and units; see `System.labels`.

    Raises
    ------
    InputError, InputTypeError
        If the arrays do not fit together or cannot be used.

    Examples
    --------
    >>> import stochens_rs as se
    >>> models = se.SystemEnsemble([[[0.9]], [[0.8]]], [[[1.0]], [[1.1]]])
    >>> models, models[1]
    (<SystemEnsemble: 2 models, n=1 m=1>, <System: n=1 m=1 dt=None>)
    """

    A: Annotated[Floats, "model state from_state", "own unit"]
    B: Annotated[Floats, "model state input", "own unit"]
    c: Annotated[Floats, "model state"] | None = None
    centre: Centre | None = None
    dt: Positive | None = None
    about: Line = ""
    labels: Labels | None = None

    def __post_init__(self) -> None:
        for name, ndim in (("A", 3), ("B", 3), ("c", 2)):
            given = getattr(self, name)
            if given is not None:
                found = validation.array(name, given, ndim=(ndim,))
                self._keep(**{name: validation.frozen(found)})
        super().__post_init__()

    @classmethod
    def from_systems(
        cls, systems: Sequence[System | Any], *, centre: Centre | None = None
    ) -> SystemEnsemble:
        """Make an ensemble of systems.

        Parameters
        ----------
        systems : sequence of System
            At least one; or anything `System.from_any` takes. All of one size and one `dt`. Those
            with the names of the first in another order are brought into its order.
        centre : {"truth", "estimate"}, optional
            As in `SystemEnsemble`.

        Returns
        -------
        SystemEnsemble
            The systems, in their order, with the names of the first that has some, and all units.

        Raises
        ------
        InputError, InputTypeError
            If the systems differ in size, in `dt`, in their names or in units, or one cannot be
            used.

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.SystemEnsemble.from_systems([([[0.9]], [[1.0]]), ([[0.8]], [[1.1]])])
        <SystemEnsemble: 2 models, n=1 m=1>
        """
        found = [System.from_any(system) for system in validation.items("systems", systems)]
        if not found:
            raise InputError("`systems` must have at least one system, got an empty list")
        first = found[0]
        for k, system in enumerate(found):
            if (system.n, system.m, system.dt) != (first.n, first.m, first.dt):
                raise ShapeError(
                    f"`systems[{k}]` must be like the first, n={first.n} m={first.m} "
                    f"dt={first.dt}, got n={system.n} m={system.m} dt={system.dt}"
                )
        dt = first.dt if isinstance(first.dt, float) else None
        labels = next((one.labels for one in found if one.labels.given), None)
        for k, one in enumerate(found):
            found[k] = in_order(f"systems[{k}]", one, labels)
            labels = labels and labels.and_units(one.labels)
        A, B = np.array([one.A for one in found]), np.array([one.B for one in found])
        return cls(A, B, centre=centre, dt=dt, labels=labels)

    @property
    def size(self) -> int:
        """The number of models N."""
        return len(self.A)

    @property
    def n(self) -> int:
        """The number of states."""
        return int(self.A.shape[1])

    @property
    def m(self) -> int:
        """The number of inputs."""
        return int(self.B.shape[2])

    def mean(self) -> System:
        """Average the models entry by entry.

        Returns
        -------
        System
            The mean of A and B. What it is an estimate of: see `centre`. A plan for it
            warns that its numbers are about the mean.

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.SystemEnsemble([[[1.0]], [[0.5]]], [[[1.0]], [[1.0]]]).mean().A
        array([[0.75]])
        """
        with np.errstate(over="ignore"):  # `System` refuses what is not finite
            mean = self.A.mean(axis=0), self.B.mean(axis=0)
            return rebuilt(*mean, self.dt, None, self.labels, self.size)

    def __len__(self) -> int:
        return self.size

    @overload
    def __getitem__(self, s: int) -> System: ...
    @overload
    def __getitem__(self, s: slice) -> SystemEnsemble: ...
    def __getitem__(self, s: int | slice) -> System | SystemEnsemble:
        """Model s, without its offset; of a slice the models, with all that is known of them."""
        if isinstance(s, slice):
            A, B, c = self.A[s], self.B[s], None if self.c is None else self.c[s]
            if not len(A):
                raise InputError("the slice must name at least one model")
            return replace(self, A=A, B=B, c=c)
        index = validation.size("model", s, minimum=-self.size, maximum=self.size - 1)
        return rebuilt(self.A[index], self.B[index], self.dt, None, self.labels)

    def __iter__(self) -> Iterator[System]:
        return (self[s] for s in range(self.size))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SystemEnsemble):
            return NotImplemented
        arrays: Any = ((self.A, other.A), (self.B, other.B), (self.c, other.c))
        same = (self.centre, self.dt) == (other.centre, other.dt)
        return same and all(np.array_equal(mine, its) for mine, its in arrays)

    __hash__ = None  # type: ignore[assignment]  # as for arrays

    def __repr__(self) -> str:
        about = "" if self.centre is None else f", about the {self.centre}"
        count = show.number_of(self.size, "model")
        dt = "" if self.dt is None else f" dt={self.dt:g}"
        return f"<SystemEnsemble: {count}, n={self.n} m={self.m}{dt}{about}>"


def systems_in_order(
    argument: str, systems: SystemEnsemble, labels: Labels | None
) -> SystemEnsemble:
    """The same models, with states and inputs in the order of these names, see `order_of`."""
    order = order_of(argument, systems.labels, labels)
    if systems.labels is None or order == Order():
        return systems
    A, B = order.matrices(systems.A, systems.B)
    c = None if systems.c is None else order.of_states(systems.c)
    return replace(systems, A=A, B=B, c=c, labels=order.labels(systems.labels))
