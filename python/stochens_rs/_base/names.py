"""Names and units of states and inputs, and weights by them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..exceptions import InputError, InputTypeError, ShapeError
from . import validation
from .reading import aligned_weight
from .records import Record
from .types import Floats

_LISTED = 12  # most names in a cell of a table


@dataclass(frozen=True)
class Labels(Record):
    """Names of the states and inputs of a system, and the units of some of them; hashable.

    Attributes
    ----------
    states, inputs : tuple of str
        The names, all different. The default of state i is ``x[i]``, that of input j ``u[j]``.
    units : tuple of (name, unit)
        The units that are known, in the order of the names.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    units: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        n, m = (len(validation.items(name, getattr(self, name))) for name in ("states", "inputs"))
        names = checked_names(n, m, self.states, self.inputs, ("states", "inputs"))
        units = checked_units((*names[0], *names[1]), self.units)
        for name, value in (("states", names[0]), ("inputs", names[1]), ("units", units)):
            object.__setattr__(self, name, value)

    def require(self, n: int, m: int) -> None:
        """Refuse to be the names of another number of states or inputs."""
        if (len(self.states), len(self.inputs)) != (n, m):
            raise ShapeError(
                f"`labels` must name {n} states and {m} inputs, got {len(self.states)} and "
                f"{len(self.inputs)}"
            )

    @property
    def given(self) -> bool:
        """Whether there is a name or a unit that is not the default."""
        return self != default_labels(len(self.states), len(self.inputs))

    def axis(self, name: str) -> str:
        """What an axis says: ``delta_1 [rad]``, or the name alone if no unit is known."""
        unit = dict(self.units).get(name)
        return name if unit is None else f"{name} [{unit}]"

    @property
    def state_axes(self) -> tuple[str, ...]:
        """The names of the states with their units."""
        return tuple(self.axis(name) for name in self.states)

    @property
    def input_axes(self) -> tuple[str, ...]:
        """The names of the inputs with their units."""
        return tuple(self.axis(name) for name in self.inputs)

    def state(self, i: int) -> str:
        """What an error says: ``state 'delta_1'``, or ``state 0`` for a default name."""
        return _said("state", "x", i, self.states[i])

    def input(self, j: int) -> str:
        """What an error says: ``input 'T_m3'``, or ``input 2`` for a default name."""
        return _said("input", "u", j, self.inputs[j])

    def place(self, argument: str, one: object, *, inputs: bool = False) -> int:
        """The place of a state or input, which is given by name or number."""
        names = self.inputs if inputs else self.states
        if isinstance(one, str):
            return names.index(validation.choice(argument, one, names))
        return validation.size(argument, one, minimum=0, maximum=len(names) - 1)

    def places(self, argument: str, chosen: object, *, inputs: bool = False) -> list[int]:
        """The places of one state or several, of all of them for None; of inputs also of none."""
        if chosen is None:
            return list(range(len(self.inputs if inputs else self.states)))
        several = isinstance(chosen, Iterable) and not isinstance(chosen, (str, bytes))
        found = validation.items(argument, chosen) if several else [chosen]
        if not found and not inputs:
            raise InputError(f"`{argument}` must name a state, got none")
        return [self.place(argument, one, inputs=inputs) for one in found]

    def units_of(self, places: Sequence[int]) -> str | None:
        """The unit that these states have in common."""
        known = dict(self.units)
        found = {known.get(self.states[i]) for i in places}
        return found.pop() if len(found) == 1 else None

    def rows(self) -> Iterator[tuple[str, str]]:
        """Rows of a table: the names with their units, if any was given."""
        if self.given:
            for what, axes in (("states", self.state_axes), ("inputs", self.input_axes)):
                yield what, ", ".join(axes[:_LISTED]) + ", …" * (len(axes) > _LISTED)


class Order(NamedTuple):
    """Where the states and inputs of a system stand in another one; None: where they stand here."""

    states: list[int] | None
    inputs: list[int] | None

    def matrices(self, A: Floats, B: Floats) -> tuple[Floats, Floats]:
        """``A``, ``B``, or several of each, in this order."""
        return self._states(self._states(A), -2), self.of_inputs(self._states(B, -2))

    def of_states(self, x: Floats) -> Floats:
        """States along the last axis in this order."""
        return self._states(x)

    def of_inputs(self, u: Floats) -> Floats:
        """Inputs along the last axis in this order."""
        return u if self.inputs is None else u[..., self.inputs]

    def labels(self, known: Labels) -> Labels:
        """The names in this order."""
        states, inputs = (
            names if order is None else tuple(names[i] for i in order)
            for names, order in ((known.states, self.states), (known.inputs, self.inputs))
        )
        return Labels(states, inputs, known.units)

    def back(self) -> Order:
        """The order that undoes this one."""
        return Order(
            *(None if o is None else sorted(range(len(o)), key=o.__getitem__) for o in self)
        )

    def _states(self, x: Floats, axis: int = -1) -> Floats:
        return x if self.states is None else x.take(self.states, axis=axis)


def order_of(argument: str, found: Labels | None, wanted: Labels | None) -> Order:
    """Where the states and inputs that are `wanted` stand among those of a system that was `found`.

    The same names in another order are brought into order, other names are refused. Names that were
    not given fit all others.
    """
    if found is None or wanted is None:
        return Order(None, None)
    return Order(
        _order_along(argument, "states", "x", found.states, wanted.states),
        _order_along(argument, "inputs", "u", found.inputs, wanted.inputs),
    )


def _order_along(
    argument: str, what: str, letter: str, found: tuple[str, ...], wanted: tuple[str, ...]
) -> list[int] | None:
    if found == wanted:
        return None
    if sorted(found) == sorted(wanted):
        return [found.index(name) for name in wanted]
    if _numbered(letter, len(wanted)) in (found, wanted):
        return None
    raise InputError(
        f"`{argument}` must have the {what} {_some(wanted)} in any order, or none by name, got "
        f"{_some(found)}"
    )


def _some(names: Sequence[str]) -> str:
    return ", ".join(repr(name[:40]) for name in names[:_LISTED]) + ", ..." * (len(names) > _LISTED)


def two_states(labels: Labels, across: object, up: object) -> list[int]:
    """The places of two different states, for a phase portrait."""
    pair = [labels.place("across", across), labels.place("up", up)]
    if pair[0] == pair[1]:
        raise InputError(f"`up` must differ from `across`, got {validation.show(up)} twice")
    return pair


@lru_cache(maxsize=64)
def default_labels(n: int, m: int) -> Labels:
    """``x[0], x[1], ...`` and ``u[0], u[1], ...``."""
    return Labels(_numbered("x", n), _numbered("u", m))


def made_labels(
    n: int, m: int, states: object = None, inputs: object = None, units: object = None
) -> Labels:
    """Check the arguments `states`, `inputs` and `units` of a system with n states, m inputs."""
    if states is None and inputs is None and units is None:
        return default_labels(n, m)
    names = checked_names(n, m, states, inputs, ("states", "inputs"))
    if units is not None and not isinstance(units, Mapping):
        raise InputTypeError(
            "`units` must be a mapping from names of states and inputs to units, got "
            f"{validation.show(units)}"
        )
    return Labels(*names, () if units is None else tuple(units.items()))


def texts(argument: str, names: object) -> tuple[str, ...] | None:
    """Names as a tuple of text; None for None."""
    if names is None:
        return None
    return tuple(validation.line(argument, name) for name in validation.items(argument, names))


def fitting(labels: object, n: int, m: int) -> None:
    """Check the field `labels` of a record of n states and m inputs."""
    if labels is not None:
        validation.instance("labels", labels, Labels).require(n, m)


def checked_names(
    n: int,
    m: int,
    states: object,
    inputs: object,
    arguments: tuple[str, str] = ("state_names", "input_names"),
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names of n states and m inputs, all different; None: ``x[0]``, ``u[0]``, ...."""
    of_states = _names(arguments[0], states, n, "x")
    of_inputs = _names(arguments[1], inputs, m, "u")
    known = set(of_states)
    twice = next((name for name in of_inputs if name in known), None)
    if twice is not None:
        raise InputError(
            f"`{arguments[1]}` must differ from `{arguments[0]}`, got {twice[:40]!r} in both"
        )
    return of_states, of_inputs


def checked_units(names: Sequence[str], units: object) -> tuple[tuple[str, str], ...]:
    """The units, one line each, in the order of the names; those that are empty are left out."""
    found: dict[str, str] = {}
    known = set(names)
    for pair in validation.items("units", units):
        if not isinstance(pair, (tuple, list)) or len(pair) != 2:
            raise InputTypeError(f"`units` must be pairs (name, unit), got {validation.show(pair)}")
        name, unit = pair
        if not isinstance(name, str) or name not in known:
            raise InputError(
                "`units` must name states and inputs of the system, got "
                f"{validation.show(name)}{validation.nearest(str(name), names)}"
            )
        if name in found:
            raise InputError(f"`units` must name every state and input once, got {name[:40]!r}")
        said = f"units[{name[:40]!r}]"
        found[name] = validation.line(said, " ".join(validation.text(said, unit).split()))
    return tuple((name, found[name]) for name in names if found.get(name))


def _names(argument: str, names: object, count: int, letter: str) -> tuple[str, ...]:
    found = texts(argument, names)
    if found is None:
        return _numbered(letter, count)
    if len(found) != count:
        raise ShapeError(f"`{argument}` must have {count} names, got {len(found)}")
    if len(set(found)) < count:
        twice = next(name for name, count in Counter(found).items() if count > 1)
        raise InputError(f"`{argument}` must be different names, got {twice[:40]!r} twice")
    return found


def _numbered(letter: str, count: int) -> tuple[str, ...]:
    return tuple(f"{letter}[{k}]" for k in range(count))


def _said(what: str, letter: str, place: int, name: str) -> str:
    return f"{what} {place}" if name == f"{letter}[{place}]" else f"{what} {name[:40]!r}"


def weight(
    name: str,
    value: Any,
    n: int,
    *,
    auto: bool = False,
    positive: bool = False,
    matrix: bool = False,
    labels: Sequence[str] | None = None,
) -> Floats:
    """A weight as a matrix: from a number, a diagonal (n,) or a matrix (n, n).

    A table whose labels are `labels`, the names of its entries, is brought into their order;
    `positive` asks for a positive definite one, `matrix` for one that is given as such.
    """
    if isinstance(value, str):
        other, found = '"auto", ' if auto else "", validation.show(value)
        raise InputTypeError(f"`{name}` must be {other}a number, ({n},) or ({n}, {n}), got {found}")
    value = value if labels is None else aligned_weight(name, value, labels)
    given = validation.read(name, value)
    kind = "definite" if positive else "semidefinite"
    if given.ndim == 0 and not matrix:
        if positive and validation.is_real(value) and value <= 0.0:
            raise InputError(f"`{name}` must be positive definite, got {validation.show(value)}")
        return validation.nonnegative(name, value) * np.eye(n)
    if given.ndim == 1 and not matrix:
        entries = validation.vector(name, value, length=n)
        least = float(entries.min(initial=1.0))
        if least < 0.0 or (positive and least == 0.0):
            rule = "be positive definite" if positive else "have entries >= 0"
            raise InputError(f"`{name}` must {rule}, got the entry {least:.3g}")
        return np.diag(entries)
    full = validation.matrix(name, value, rows=n, cols=n)
    # in units in which the diagonal is 1: what rounding is does not depend on those of the entries
    diagonal = np.abs(np.diag(full))
    size = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    unit = full / size[:, None] / size
    apart = np.abs(unit - unit.T)
    i, j = np.unravel_index(apart.argmax(), apart.shape) if n else (0, 0)
    if n and apart[i, j] > 5e-10:
        found = f"[{i}, {j}] = {full[i, j]:.6g} and [{j}, {i}] = {full[j, i]:.6g}"
        raise InputError(f"`{name}` must be symmetric, got {found}")
    half = full / 2.0 + full.T / 2.0
    least = float(np.linalg.eigvalsh(unit / 2.0 + unit.T / 2.0)[0])
    room = n * float(np.finfo(np.float64).eps) * float(np.abs(unit).max())
    if least <= room if positive else least < -room:
        least = min(least, float(np.linalg.eigvalsh(half)[0]))
        raise InputError(f"`{name}` must be positive {kind}, its least eigenvalue is {least:.3g}")
    return half
