"""A quantity to be bounded, with its data and choices."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np

from ..._base import validation
from ..._base.types import AXES, FUSIONS, QUANTITIES, Floats, Scheme
from ...exceptions import InputError, InputTypeError
from ...rng import RngLike, as_key
from ...system import System
from ..dynamics import checked_ends
from ..formulas import lines_of
from .base import Bound, Setting
from .drawn_errors import DrawnEntity, PlanErrors
from .settings import Lines, Paired, Product
from .simulated import DrawnErrors, Simulated
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
        self._made: dict[str, Setting] = {}
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
        self._made[setting] = self._made.get(setting) or self._make(setting)
        return Bound(row.name, row.source, self._made[setting], row.formula, row.equal)

    def _make(self, setting: str) -> Setting:
        if self.system is None:
            norm = "Frobenius" if setting == "matrix" else self.norm
            return Lines(self.lines, self.quantity, norm)
        control = Paired if setting == "diagonal" else Product
        return control(self.system, self.x0, self.xf, self.axis, self.quantity)

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
        return Simulated(DrawnErrors(self.quantity, self.norm, scheme, law), key)


def refuse_choices(what: str, **options: tuple[object, object]) -> None:
    """Refuse options, given with their defaults, that have no effect there."""
    for name, (given, default) in options.items():
        if given != default:
            raise InputError(f"`{name}` must be {default!r} {what}, got {validation.show(given)}")
