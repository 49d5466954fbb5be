"""One bound by its name, all that apply, and the best of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, overload

import numpy as np

from ..._base import gate, html
from ..._base.types import AXES, FUSIONS, QUANTITIES, SCHEMES, Axis, Floats, Fusion, Scheme
from ...exceptions import InputError, InputTypeError
from ...rng import RngLike, as_key
from ...system import System
from ..dynamics import checked_ends
from ..formulas import Sizes, lines_of
from .base import Bound, Setting, differ
from .drawn_errors import Entity, PlanErrors
from .settings import Lines, OneStep, Paired, Product, Runs
from .simulated import Law, Simulated
from .table import DEPENDENT, SETTINGS, TABLE, Row

Of: TypeAlias = Literal["vector", "matrix", "state", "control", "trajectory"]

_DATA = {
    "vector": "w",
    "matrix": "A",
    "state": "system, x0, xf",
    "control": "system, x0, xf",
    "trajectory": "system, x0, u",
}


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


class _Problem:
    """A quantity with its data and choices, checked; every setting is made once."""

    def __init__(
        self,
        quantity: object,
        data: tuple[Any, ...],
        norm: object,
        fusion: object,
        axis: object,
        sample_B: object = True,
    ) -> None:
        self.quantity = gate.choice("quantity", quantity, tuple(_DATA))
        expected = _DATA[self.quantity]
        many = expected.count(",") + 1
        if len(data) != many:
            raise InputTypeError(
                f"`data` must be {many} argument{'s' * (many > 1)} ({expected}) for a "
                f"{self.quantity}, got {len(data)}"
            )
        control, settings = self.quantity in QUANTITIES, SETTINGS[self.quantity]
        norms = ("2",) if control else tuple(settings)
        self.norm = norms[0] if norm is None else gate.choice("norm", norm, norms)
        self.fusion = gate.choice("fusion", fusion, FUSIONS)
        self.axis = gate.choice("axis", axis, AXES)
        self.sample_B = gate.flag("sample_B", sample_B)
        what = f"for a {self.quantity}"
        if not control:
            _default(what, fusion=(self.fusion, "product"))
        if self.quantity == "vector":
            _default(what, axis=(self.axis, "columns"))
        if self.quantity != "trajectory":
            _default(what, sample_B=(self.sample_B, True))
        self.settings = settings[self.fusion if control else self.norm]
        self._made: dict[str, Setting] = {}
        self.system: System | None = None
        if self.quantity == "vector":
            self.lines = gate.vector("w", data[0])[:, None]
        elif self.quantity == "matrix":
            self.lines = lines_of(gate.matrix("A", data[0]), self.axis)
        elif control:
            self.system, self.x0, self.xf = checked_ends(*data)
        else:
            system = self.system = System.from_any(data[0])
            self.x0 = gate.vector("x0", data[1], length=system.n)
            self.u = gate.inputs("u", data[2], cols=system.m, empty=False)

    def rows(self, table: tuple[Row, ...]) -> dict[str, tuple[Row, str]]:
        """The rows of the table that apply, by name, each with its setting."""
        pairs = ((row, setting) for row in table for setting in row.settings)
        return {row.name: (row, setting) for row, setting in pairs if setting in self.settings}

    def bound(self, row: Row, setting: str) -> Bound:
        """Make the bound of a row."""
        setting = setting.removesuffix(", state")  # the setting is the same; the row is for states
        self._made[setting] = self._made.get(setting) or self._make(setting)
        return Bound(row.name, row.source, row.inequality(self._made[setting]))

    def _make(self, setting: str) -> Setting:
        if self.system is None:
            norm = "Frobenius" if setting == "matrix" else self.norm
            return Lines(self.lines, self.quantity, norm)
        if self.quantity == "trajectory":
            runs = OneStep if setting == "one step" else Runs
            return runs(self.system, self.x0, self.u, self.axis, self.sample_B)
        control = Paired if setting == "diagonal" else Product
        return control(self.system, self.x0, self.xf, self.axis, self.quantity)

    def formulas(self) -> list[Bound]:
        """All bounds for independent realizations that are formulas."""
        several = self.quantity == "trajectory" and (self.axis == "rows" or len(self.u) > 1)
        pairs = self.rows(TABLE).values()
        return [self.bound(row, at) for row, at in pairs if not (several and at == "one step")]

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
            entities = (Entity(value, scheme=scheme) for value in (self.x0, self.xf, A))
            law = PlanErrors(B, *entities, steps=steps, paired=paired, rows=rows)
        key = as_key(rng).child("simulated bound")
        return Simulated(Law(self.quantity, self.norm, scheme, law), key)


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
    sample_B: bool = True,
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
    sample_B : bool, default True
        For a trajectory: whether ``B`` is sampled, too; else it is known exactly.
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
    problem = _Problem(quantity, data, norm, fusion, axis, sample_B)
    how = gate.choice("scheme", scheme, SCHEMES)
    K, key = gate.size("steps", steps), as_key(rng)
    found = problem.rows(TABLE + DEPENDENT)
    simulated = () if problem.quantity == "trajectory" else ("simulated",)
    if gate.choice("name", name, (*found, *simulated)) == "simulated":
        if problem.system is None:
            _default(f"for a {problem.quantity}", steps=(K, 1))
        return problem.simulated(how, K, key)
    _default(f"for the bound '{name}'", scheme=(how, "iid"), steps=(K, 1), rng=(rng, 0))
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
    quantity : {"vector", "matrix", "state", "control", "trajectory"}
        The quantity whose error is bounded.
    *data : System or array_like
        ``w``; ``A``; ``system, x0, xf`` for a state or a control; ``system, x0, u`` with u (K, m).
        `system` is a System or what `System.from_any` takes, such as ``(A, B)``.
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
    ['McDiarmid', 'Bousquet', 'Weissman', 'Hoeffding', 'Chebyshev']
    """
    return _Problem(quantity, data, norm, fusion, axis).formulas()


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
    the size of the problem allow it (not for trajectories), as it is within a few percent of the
    quantile; otherwise the smallest of :func:`candidates`.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> chosen = bounds.best("vector", [3.0, -1.0, 0.5, 2.0], eps=0.1, delta=0.01)
    >>> chosen.bound.name, 12_000 < chosen.size < 15_000, chosen.radius <= 0.1
    ('simulated', True, True)
    """
    if (size is None) == (eps is None):
        raise InputError("`size` or `eps` must be given, and not both")
    problem = _Problem(quantity, data, norm, fusion, axis)
    found, delta = problem.formulas(), gate.probability("delta", delta)
    drawn = None if problem.quantity == "trajectory" else problem.simulated()
    if drawn and not drawn.possible(1 if size is None else size, delta):
        drawn = None
    if eps is not None:
        needed, chosen = _smallest_size([drawn] if drawn else found, eps, delta)
        return Best(chosen, chosen.radius(needed, delta), needed, delta)
    if differ(found[0].setting.rates(size)):
        found = [one for one in found if not one.inequality.equal]
    radii = [one.radius(size, delta) for one in found]
    k = radii.index(min(radii))
    if drawn is None or radii[k] == 0.0:
        return Best(found[k], radii[k], size, delta)
    return Best(drawn, drawn.radius(size, delta), size, delta)


def _default(what: str, **options: tuple[object, object]) -> None:
    """Refuse options, given with their defaults, that have no effect there."""
    for name, (given, default) in options.items():
        if given != default:
            raise InputError(f"`{name}` must be {default!r} {what}, got {gate.show(given)}")


def _smallest_size(found: list[Bound], eps: float, delta: float) -> tuple[int, Bound]:
    """Search the bounds in turn; only those that allow a smaller size are bisected."""
    least, smallest = found[0].required_size(eps, delta), found[0]
    for one in found[1:]:
        if least > 1 and one.radius(least - 1, delta) <= eps:
            least, smallest = one.required_size(eps, delta), one
    return least, smallest
