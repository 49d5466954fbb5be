"""Names and units of states and inputs, and weights by them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..exceptions import InputError, InputTypeError, ShapeError
from . import validation
from .reading import aligned, shown_labels, titled
from .records import Record
from .types import Floats

_LISTED = 12  # most names in a cell of a table


class Labels(Record, eq=True):
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
        self._keep(states=names[0], inputs=names[1], units=units)

    def require(self, n: int, m: int) -> None:
        """Refuse to be the names of another number of states or inputs."""
        x, u = len(self.states), len(self.inputs)
        if (x, u) != (n, m):
            raise ShapeError(f"`labels` must name {n} states and {m} inputs, got {x} and {u}")

    def and_units(self, other: Labels) -> Labels:
        """The same names with the units of others where there was none."""
        if other.units in ((), self.units):
            return self
        units, known = {**dict(other.units), **dict(self.units)}, {*self.states, *self.inputs}
        found = tuple(one for one in units.items() if one[0] in known)
        return Labels(self.states, self.inputs, found)

    def _require_units(self, argument: str, wanted: Labels) -> None:
        """Refuse other units of the same name, where both are known."""
        units = dict(wanted.units) if self.units != wanted.units else {}
        for name, unit in self.units:
            if units.get(name, unit) != unit:
                raise InputError(
                    f"`{argument}` must have {name[:40]!r} in {units[name][:40]!r}, got "
                    f"{unit[:40]!r}: bring the numbers to one unit, written in one way"
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

    def entry(self, i: int, *, inputs: bool = False) -> str:
        """What an error says: ``state 'delta_1'``, or ``input 2`` for a default name."""
        what, name = ("input", self.inputs[i]) if inputs else ("state", self.states[i])
        return f"{what} {i if name in (f'x[{i}]', f'u[{i}]') else repr(name[:40])}"

    def place(self, argument: str, one: object, *, inputs: bool = False) -> int:
        """The place of a state or input, which is given by name or number."""
        names = self.inputs if inputs else self.states
        if isinstance(one, str):
            return names.index(validation.choice(argument, titled(one, names), names))
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

    @property
    def leading(self) -> list[int]:
        """The places of the states, of a window those of the outputs or their first filters."""
        older = [re.fullmatch(r"(.+?)(\(-\d+\)|~\d+)", name) for name in self.states]
        first = [k is None or (k[2] == "~1" and k[1] not in self.inputs) for k in older]
        return [i for i, one in enumerate(first) if one] or list(range(len(first)))

    def rows(self) -> Iterator[tuple[str, str]]:
        """Rows of a table: the names with their units, if any was given."""
        if self.given:
            for what, axes in (("states", self.state_axes), ("inputs", self.input_axes)):
                yield what, ", ".join(axes[:_LISTED]) + ", …" * (len(axes) > _LISTED)


class Order(NamedTuple):
    """Where the states and inputs of a system stand in another one; a slice: where they are."""

    states: list[int] | slice = slice(None)
    inputs: list[int] | slice = slice(None)

    def matrices(self, A: Floats, B: Floats) -> tuple[Floats, Floats]:
        """``A``, ``B``, or several of each, in this order."""
        A, B = _taken(A, self.states, -2), _taken(B, self.states, -2)
        return self.of_states(A), self.of_inputs(B)

    def of_states(self, x: Floats) -> Floats:
        """States along the last axis in this order."""
        return _taken(x, self.states)

    def of_inputs(self, u: Floats) -> Floats:
        """Inputs along the last axis in this order."""
        return _taken(u, self.inputs)

    def labels(self, known: Labels) -> Labels:
        """The names in this order."""
        states, inputs = (np.array(names, dtype=object) for names in (known.states, known.inputs))
        return Labels((*states[self.states],), (*inputs[self.inputs],), known.units)

    def back(self) -> Order:
        """The order that undoes this one."""
        return Order(*(o if isinstance(o, slice) else np.argsort(o).tolist() for o in self))


def _taken(values: Floats, order: list[int] | slice, axis: int = -1) -> Floats:
    return values if isinstance(order, slice) else values.take(order, axis=axis)


def order_of(argument: str, found: Labels | None, wanted: Labels | None) -> Order:
    """Where the states and inputs that are `wanted` stand among those of a system that was `found`.

    The same names in another order are brought into order, other names are refused, and other units
    of the same name. Names that were not given fit all others, and so do units.
    """
    if found and wanted:
        found._require_units(argument, wanted)
    order: list[list[int] | slice] = []
    for what, letter in (("states", "x"), ("inputs", "u")) if found and wanted else ():
        has, names = getattr(found, what), getattr(wanted, what)
        if has == names or _numbered(letter, len(names)) in (has, names):
            order.append(slice(None))
        elif sorted(has) == sorted(names):
            order.append([has.index(name) for name in names])
        else:
            along = [getattr(one, f"{what[:-1]}_axes") for one in (found, wanted)]  # with units
            own = [titled(name, along[1]) for name in along[0]]
            other = [titled(name, own) for name in along[1]]
            if sorted(own) != sorted(other):
                raise InputError(
                    f"`{argument}` must have the {what} {shown_labels(along[1])} in any order, or "
                    f"none by name, got {shown_labels(along[0])}"
                )
            order.append([own.index(name) for name in other])
    return Order(*order)


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
        raise InputTypeError(f"`units` must be a mapping by name, got {validation.show(units)}")
    return Labels(*names, () if units is None else tuple(units.items()))


def texts(argument: str, names: object) -> tuple[str, ...] | None:
    """Names as a tuple of text; None for None."""
    if names is None:
        return None
    return tuple(validation.line(argument, name) for name in validation.items(argument, names))


def checked_names(
    n: int,
    m: int,
    states: object,
    inputs: object,
    arguments: tuple[str, str] = ("state_names", "input_names"),
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names of n states and m inputs, all different; None: ``x[0]``, ``u[0]``, ...."""
    found = []
    parts = zip(arguments, (states, inputs), (n, m), "xu", strict=True)
    for argument, names, count, letter in parts:
        given = texts(argument, names)
        found.append(_numbered(letter, count) if given is None else given)
        if len(found[-1]) != count:
            raise ShapeError(f"`{argument}` must have {count} names, got {len(found[-1])}")
        twice = [name for name, times in Counter(found[-1]).items() if times > 1]
        if twice:
            raise InputError(f"`{argument}` must be different names, got {twice[0][:40]!r} twice")
    both = set(found[0]) & set(found[1])
    if both:
        raise InputError(f"`{arguments[1]}` must not be in `{arguments[0]}`: {min(both)[:40]!r}")
    return found[0], found[1]


def checked_units(
    names: Sequence[str], units: Iterable[tuple[str, str]]
) -> tuple[tuple[str, str], ...]:
    """The units, one line each, in the order of the names; those that are empty are left out."""
    found: dict[str, str] = {}
    known = set(names)
    for name, unit in units:
        if name not in known:
            raise InputError(
                "`units` must name states and inputs of the system, got "
                f"{validation.show(name)}{validation.nearest(str(name), names)}"
            )
        argument = f"units[{name[:40]!r}]"
        found[name] = validation.line(argument, " ".join(validation.text(argument, unit).split()))
    return tuple((name, found[name]) for name in names if found.get(name))


def _numbered(letter: str, count: int) -> tuple[str, ...]:
    return tuple(f"{letter}[{k}]" for k in range(count))


def weight(
    name: str,
    value: Any,
    n: int,
    *,
    positive: bool = False,
    matrix: bool = False,
    labels: Sequence[str] | None = None,
) -> Floats:
    """A weight as a matrix: from a number, a diagonal (n,) or a matrix (n, n).

    A table whose labels are `labels`, the names of its entries, is brought into their order;
    `positive` asks for a positive definite one, `matrix` for one that is given as such.
    """
    value = value if labels is None else aligned(name, value, labels, square=True)
    given = validation.read(name, value)
    if given.ndim == 0 and not matrix:
        number = validation.positive if positive else validation.nonnegative
        return number(name, value) * np.eye(n)
    if given.ndim == 1 and not matrix:
        entries = validation.vector(name, value, length=n)
        if not (entries > 0.0 if positive else entries >= 0.0).all():
            rule = "> 0" if positive else ">= 0"
            raise InputError(f"`{name}` must have entries {rule}, got {entries.min():.3g}")
        return np.diag(entries)
    full = validation.matrix(name, value, rows=n, cols=n)
    # in units in which the diagonal is 1: what rounding is does not depend on those of the entries
    diagonal = np.abs(np.diag(full))
    size = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    unit = full / size[:, None] / size
    i, j = np.unravel_index(np.abs(unit - unit.T).argmax(), unit.shape)
    if abs(unit[i, j] - unit[j, i]) > 5e-10:
        found = f"[{i}, {j}] = {full[i, j]:.6g} and [{j}, {i}] = {full[j, i]:.6g}"
        raise InputError(f"`{name}` must be symmetric, got {found}")
    half = full / 2.0 + full.T / 2.0
    least = float(np.linalg.eigvalsh(unit / 2.0 + unit.T / 2.0)[0])
    room = n * float(np.finfo(np.float64).eps) * float(np.abs(unit).max())
    if least <= room if positive else least < -room:
        least = min(least, float(np.linalg.eigvalsh(half)[0]))
        kind = "definite" if positive else "semidefinite"
        raise InputError(f"`{name}` must be positive {kind}, its least eigenvalue is {least:.3g}")
    return half
