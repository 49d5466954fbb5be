"""A discrete-time linear system, checked when it is made::

x(k+1) = A x(k) + B u(k),    x(k) in R^n,  u(k) in R^m
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from .._base import show, validation
from .._base.names import Labels, Order, made_labels, order_of, texts
from .._base.reading import matrices
from .._base.tables import Exported
from .._base.types import ArrayLike, NDArray
from . import conversions


class System(Exported):
    """The system ``x(k+1) = A x(k) + B u(k)``; immutable and hashable.

    Parameters
    ----------
    A : array_like, shape (n, n)
        ``A[i, j]`` is the effect of state j at step k on state i at step k + 1. A and B may be
        tables, see the notes.
    B : array_like, shape (n, m)
        ``B[i, j]`` is the effect of input j at step k on state i at step k + 1.
    dt : float or True, optional
        The time between two steps [s], > 0. True or None (the default): discrete time with an
        unspecified step.
    name : str, optional
        A label that is shown; ``==`` ignores it.
    states, inputs : sequence of str, optional
        Names of the states (n) and of the inputs (m), all different. They are shown in errors,
        tables and figures. Default: ``x[0], x[1], ...`` and ``u[0], u[1], ...``. ``==`` ignores
        them, as it ignores `units`: it compares numbers.
    units : mapping of str to str, optional
        Units by the names of states and inputs, such as ``{"delta_1": "rad"}``. They are text that
        is shown: nothing is converted.

    Raises
    ------
    ShapeError
        If `A` is not square, `B` has another number of rows, or there are more or fewer names than
        states or inputs.
    NonFiniteError
        If an entry, or `dt`, is nan or infinite.
    InputTypeError
        If `A` or `B` does not hold real numbers, or another argument has a wrong type.
    InputError
        If `dt` is 0 (continuous time) or negative, `A` or `B` has labels, two names are equal,
        or a unit belongs to no state or input.

    Notes
    -----
    `A` and `B` are copied; the attributes are read-only. Tables whose labels are names give them to
    the system: A with the names of the states along rows and columns, B with those of the states
    and the inputs (pandas; in xarray with the dimensions of `to_xarray`). Their rows and columns
    may be in any order, which `states` and `inputs` decide if they are given, else the rows of A
    and the columns of B. Wherever x0, xf or inputs over time are asked for, a table with the names
    of the system is brought into its order. All other tables with labels are refused, unless these
    are 0, 1, 2, ... in order: pass plain arrays, ``x0[states].to_numpy()``.

    Examples
    --------
    >>> system = System([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.1]], dt=0.1, name="cart")
    >>> system
    <System cart: n=2 m=1 dt=0.1>
    >>> system.A @ [0.0, 1.0]
    array([0.1, 1. ])
    >>> cart = System(system.A, system.B, states=["p", "v"], inputs=["F"], units={"p": "m"})
    >>> cart.state_names, cart.input_names, cart.units
    (('p', 'v'), ('F',), {'p': 'm'})
    """

    __slots__ = {
        "A": "The state matrix, shape (n, n), read-only.",
        "B": "The input matrix, shape (n, m), read-only.",
        "_mean_of": "The number of models, if it is their mean.",
        "dt": "The time between two steps [s]; True or None if unspecified.",
        "labels": "Names and units in one hashable record, with `states`, `inputs` and `units`.",
        "name": "The label, or None.",
    }

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    dt: float | bool | None
    name: str | None
    labels: Labels
    _mean_of: int | None

    def __init__(
        self,
        A: ArrayLike,
        B: ArrayLike,
        *,
        dt: float | bool | None = None,
        name: str | None = None,
        states: Iterable[str] | None = None,
        inputs: Iterable[str] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> None:
        names = texts("states", states), texts("inputs", inputs)
        A, B, of_states, of_inputs = matrices(A, B, *names)
        checked_A = validation.matrix("A", A, square=True)
        checked_B = validation.matrix("B", B, rows=len(checked_A))
        label = None if name is None else " ".join(validation.text("name", name).split())
        validation.line("name", label or "")
        n, m = checked_B.shape
        labels = made_labels(n, m, of_states, of_inputs, units)
        for slot, value in (
            ("labels", labels),
            ("A", validation.frozen(checked_A)),
            ("B", validation.frozen(checked_B)),
            ("dt", conversions.checked_dt(dt)),
            ("name", label or None),
            ("_mean_of", None),
        ):
            object.__setattr__(self, slot, value)

    @classmethod
    def from_any(cls, system: object, dt: float | None = None) -> System:
        """Convert a pair (A, B), or a system of another package.

        Parameters
        ----------
        system : object
            A `System` (returned as it is), a tuple ``(A, B)`` or ``(A, B, dt)``, a
            ``control.StateSpace`` or ``TransferFunction``, a system of ``scipy.signal``, what
            `to_xarray` returns, or any object with attributes ``A``, ``B`` and optionally ``dt``
            and ``name``. None of these packages is imported. Names of states and inputs are kept.
        dt : float, optional
            The step [s] with which a system in continuous time is discretized, by a zero-order
            hold: exact for inputs that are constant over each step. Without it such a system is
            refused. Systems in discrete time have a step of their own.

        Returns
        -------
        System
            With copies of A and B. Its `name` says so if it was discretized ("zero-order hold"),
            or realized from a transfer function, by the ``to_ss()`` of its package; the states are
            those of that realization. Outputs (C, D) are left out.

        Raises
        ------
        InputTypeError
            If `system` is none of these.
        InputError
            If the system is in continuous time and `dt` is missing, or in discrete time and `dt` is
            another one; it is a model estimated from data; or A or B cannot be used.

        Warns
        -----
        DataWarning
            If the poles of a realization are not those of its transfer function.

        Notes
        -----
        ``[[A_d, B_d], [0, I]] = exp(dt [[A, B], [0, 0]])``, by scaling and squaring (Higham, SIAM
        J. Matrix Anal. Appl. 26(4), 2005), in units of the states in which rows and columns of A
        are alike, so that the units of the states have no part in its accuracy.

        Examples
        --------
        >>> System.from_any(([[0.5]], [[1.0]], 0.01))
        <System: n=1 m=1 dt=0.01>
        >>> System.from_any(([[0.0]], [[2.0]], 0), dt=0.1).B
        array([[0.2]])
        """
        if isinstance(system, cls):
            conversions.same_step(system.dt, dt)
            return system
        return cls(**conversions.arguments(system, dt))

    @property
    def n(self) -> int:
        """The number of states."""
        return int(self.B.shape[0])

    @property
    def m(self) -> int:
        """The number of inputs."""
        return int(self.B.shape[1])

    @property
    def state_names(self) -> tuple[str, ...]:
        """The names of the states; by default ``x[0]``, ``x[1]``, ...."""
        return self.labels.states

    @property
    def input_names(self) -> tuple[str, ...]:
        """The names of the inputs; by default ``u[0]``, ``u[1]``, ...."""
        return self.labels.inputs

    @property
    def units(self) -> dict[str, str]:
        """The units that are known, by the names of states and inputs; a copy."""
        return dict(self.labels.units)

    def _as_mean(self, count: int | None) -> System:
        object.__setattr__(self, "_mean_of", count)
        return self

    def __setattr__(self, attribute: str, value: object) -> None:
        raise AttributeError(f"a System is immutable: `{attribute}` cannot be set")

    def __delattr__(self, attribute: str) -> None:
        raise AttributeError(f"a System is immutable: `{attribute}` cannot be deleted")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, System):
            return NotImplemented
        return (
            self._step() == other._step()
            and np.array_equal(self.A, other.A)
            and np.array_equal(self.B, other.B)
        )

    def __hash__(self) -> int:
        # Adding 0.0 turns -0.0 into 0.0: they are equal, so their hashes must be equal.
        return hash(
            (self.B.shape, (self.A + 0.0).tobytes(), (self.B + 0.0).tobytes(), self._step())
        )

    def _step(self) -> tuple[bool, float | bool | None]:
        return (self.dt is True, self.dt)  # True == 1.0 in Python, but not here

    def __reduce__(self) -> tuple[object, ...]:
        named = self.labels if self.labels.given else None
        return (rebuilt, (self.A, self.B, self.dt, self.name, named, self._mean_of))

    def __copy__(self) -> System:
        return self

    def __deepcopy__(self, memo: dict[int, object]) -> System:
        return self

    def __repr__(self) -> str:
        label = "" if self.name is None else f" {self.name}"
        return f"<System{label}: n={self.n} m={self.m} dt={self.dt}>"

    def _repr_html_(self) -> str:
        dt = f"{self.dt} s" if isinstance(self.dt, float) else str(self.dt)
        return show.card(self, [("states n", self.n), ("inputs m", self.m), ("step dt", dt)])


def rebuilt(
    A: ArrayLike,
    B: ArrayLike,
    dt: float | bool | None,
    name: str | None,
    labels: Labels | None = None,
    count: int | None = None,
) -> System:
    """A system with these labels, the mean of `count` models if that is given."""
    words: Any = {}
    if labels is not None:
        words = {"states": labels.states, "inputs": labels.inputs, "units": dict(labels.units)}
    return System(A, B, dt=dt, name=name, **words)._as_mean(count)


def in_order(argument: str, system: System, labels: Labels | None) -> System:
    """The same system, with states and inputs in the order of these names, see `order_of`."""
    order = order_of(argument, system.labels, labels)
    if order == Order():
        return system
    A, B = order.matrices(system.A, system.B)
    return rebuilt(A, B, system.dt, system.name, order.labels(system.labels), system._mean_of)


def mean_of(system: System) -> int:
    """The number of models that a system is the mean of."""
    return system._mean_of or 1
