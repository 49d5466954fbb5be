"""A quantity to be bounded, with its data and choices."""

from __future__ import annotations

from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np

from ... import _core
from ..._base import memory, validation
from ..._base.types import AXES, FUSIONS, QUANTITIES, Floats, Scheme
from ...exceptions import InputError, InputTypeError
from ...rng import RngLike, as_key
from ...system import System
from ..dynamics import checked_ends
from ..formulas import lines_of
from .base import ENTITIES, Bound
from .drawn_errors import DrawnEntity, PlanErrors
from .simulated import PAIRED, Simulated
from .table import SETTINGS, TABLE, Row

Of: TypeAlias = Literal["vector", "matrix", "state", "control"]

_DATA = {
    "vector": "w",
    "matrix": "A",
    "state": "system, x0, xf",
    "control": "system, x0, xf",
}


class BoundedQuantity:
    """A quantity with its data and choices, checked; every setting is made once."""

    def __init__(
        self,
        quantity: object,
        data: tuple[Any, ...],
        norm: object,
        fusion: object,
        axis: object,
    ) -> None:
        self.quantity = validation.choice("quantity", quantity, tuple(_DATA))
        expected = _DATA[self.quantity]
        many = expected.count(",") + 1
        if len(data) != many:
            raise InputTypeError(
                f"`data` must be {many} argument{'s' * (many > 1)} ({expected}) for a "
                f"{self.quantity}, got {len(data)}"
            )
        control, settings = self.quantity in QUANTITIES, SETTINGS[self.quantity]
        norms = ("2",) if control else tuple(settings)
        self.norm = norms[0] if norm is None else validation.choice("norm", norm, norms)
        self.fusion = validation.choice("fusion", fusion, FUSIONS)
        self.axis = validation.choice("axis", axis, AXES)
        what = f"for a {self.quantity}"
        if not control:
            refuse_choices(what, fusion=(self.fusion, "product"))
        if self.quantity == "vector":
            refuse_choices(what, axis=(self.axis, "columns"))
        self.settings = settings[self.fusion if control else self.norm]
        self._made: dict[str, _core.TailBounds] = {}
        self.system: System | None = None
        if self.quantity == "vector":
            self.lines = validation.vector("w", data[0])[:, None]
        elif self.quantity == "matrix":
            self.lines = lines_of(validation.matrix("A", data[0]), self.axis)
        else:
            self.system, self.x0, self.xf = checked_ends(*data)

    def rows(self, table: tuple[Row, ...]) -> dict[str, tuple[Row, str]]:
        """The rows of the table that apply, by name, each with its setting."""
        pairs = ((row, setting) for row in table for setting in row.settings)
        return {row.name: (row, setting) for row, setting in pairs if setting in self.settings}

    def bound(self, row: Row, setting: str) -> Bound:
        """Make the bound of a row."""
        norm = "Frobenius" if setting == "matrix" else self.norm
        if norm not in self._made:
            self._made[norm] = self._numbers(norm)
        of, equal = self._made[norm], PAIRED if setting == "diagonal" else row.equal
        formula = partial(of.radius, row.name)
        return Bound(
            row.name,
            row.source,
            self.quantity,
            norm,
            formula,
            equal=equal,
            entities=() if self.system is None else ENTITIES,
            cap=of.cap,
            unit=of.unit,
        )

    def _numbers(self, norm: str) -> _core.TailBounds:
        if self.system is None:
            return _core.TailBounds(np.ascontiguousarray(self.lines.T), norm)
        A, B = self.system.A, self.system.B
        memory.need("the moments of the control", 20 * A.nbytes)  # arrays that live at once
        choices = self.axis == "rows", self.quantity == "control", self.fusion == "diagonal"
        return _core.TailBounds(A, B, self.x0.copy(), self.xf.copy(), *choices)

    def formulas(self) -> list[Bound]:
        """All bounds for independent realizations that are formulas."""
        return [self.bound(*pair) for pair in self.rows(TABLE).values()]

    def simulated(self, scheme: Scheme = "iid", steps: int = 1, rng: RngLike = 0) -> Simulated:
        """The order statistic of errors drawn from the law."""
        law: Floats | PlanErrors
        if self.system is None:
            law = np.ascontiguousarray(self.lines.T)
        else:
            rows, paired = self.axis == "rows", self.fusion == "diagonal"
            if paired and (steps > 1 or (rows and scheme == "systematic")):
                text = "`fusion` must be 'product' over several steps and for systematic rows"
                raise InputError(f"{text}, got 'diagonal'")
            A, B = self.system.A, self.system.B
            entities = (DrawnEntity(value, scheme=scheme) for value in (self.x0, self.xf, A))
            law = PlanErrors(B, *entities, steps=steps, paired=paired, rows=rows)
        key = as_key(rng).child("simulated bound")
        return Simulated(self.quantity, self.norm, scheme, law, key)


def refuse_choices(what: str, **options: tuple[object, object]) -> None:
    """Refuse options, given with their defaults, that have no effect there."""
    for name, (given, default) in options.items():
        if given != default:
            raise InputError(f"`{name}` must be {default!r} {what}, got {validation.show(given)}")
