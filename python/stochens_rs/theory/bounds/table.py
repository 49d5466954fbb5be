"""The table of all bounds: which inequality holds for which quantity, and the best of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias, overload

import numpy as np

from ..._base import gate, html
from ..._base.types import AXES, FUSIONS, QUANTITIES, SCHEMES, Axis, Fusion, Scheme
from ...exceptions import InputError, InputTypeError
from ...rng import RngLike, as_key
from ...system import System
from ..formulas import Array, Sizes, lines_of
from . import _inequalities as of
from ._base import Bound, Inequality, Setting, differ
from ._settings import Lines, OneStep, Paired, Product, Runs
from ._simulation import Entity, PlanErrors
from .simulated import Law, Simulated

Of: TypeAlias = Literal["vector", "matrix", "state", "control", "trajectory"]

_DATA = {
    "vector": "w",
    "matrix": "A",
    "state": "system, x0, xf",
    "control": "system, x0, xf",
    "trajectory": "system, x0, u",
}

# The settings in which an error can be bounded, by quantity and norm or fusion; the first is the
# default. The spectral norm of a matrix is at most its Frobenius norm.
_SETTINGS: dict[str, dict[str, tuple[str, ...]]] = {
    "vector": {"2": ("vector",), "1": ("1-norm",)},
    "matrix": {"spectral": ("spectral norm", "matrix"), "Frobenius": ("matrix",)},
    "state": {"product": ("product", "product, state"), "diagonal": ("diagonal",)},
    "control": {"product": ("product",), "diagonal": ("diagonal",)},
    "trajectory": {"2": ("runs", "one step")},
}


@dataclass(frozen=True)
class Row:
    """A name, the settings it holds in, the inequality, and the source of the bound."""

    name: str
    settings: tuple[str, ...]
    inequality: type[Inequality]
    source: str


# In the order in which `candidates` lists them.
TABLE = (
    Row("Bernstein", ("spectral norm",), of.Bernstein,
        "N m independent matrices of rank one, matrix Bernstein"),
    Row("McDiarmid", ("vector", "matrix"), of.McDiarmid,
        "bounded differences sqrt(2) g_j / N; mean at most sqrt(sum g_j^2 - ||a_j||^2) / N^.5"),
    Row("McDiarmid", ("product",), of.ProductMcDiarmid,
        "bounded martingale differences, xf then x0 then A; mean at most the exact rms"),
    Row("McDiarmid", ("diagonal",), of.McDiarmid,
        "bounded differences in N pairs xf^s, A^s x0^s; mean at most the exact rms"),
    Row("McDiarmid", ("runs",), of.McDiarmid,
        "bounded differences 2 R_K / N in N independent runs; mean at most the exact rms"),
    Row("Bousquet", ("vector", "matrix"), of.Bousquet,
        "supremum of <v, average - mean> over unit vectors v, N independent terms"),
    Row("Bousquet", ("product",), of.ProductBousquet,
        "Bousquet for the linear part, McDiarmid for the product of two errors"),
    Row("Bousquet", ("diagonal",), of.Bousquet,
        "supremum of <v, M (average of pairs - mean)> over unit vectors v"),
    Row("Bousquet", ("runs",), of.Bousquet,
        "supremum of <v, average of the runs - x(K)> over unit vectors v"),
    Row("sum of parts", ("product",), of.SumOfParts,
        "McDiarmid for each of xf_hat, A x0_hat, A_hat x0_hat given x0_hat; union bound"),
    Row("Weissman", ("vector", "1-norm"), of.Weissman,
        "union bound over all sets of atoms, Hoeffding for each"),
    Row("Hoeffding", ("vector", "matrix"), of.Hoeffding,
        "every entry has the range g_j; union bound over the nonzero entries"),
    Row("Hoeffding", ("product, state",), of.ProductHoeffding,
        "Hoeffding for every entry; triangle inequality with eps/3 for each entity"),
    Row("Chebyshev", ("vector", "matrix", "product", "diagonal", "runs"), of.Chebyshev,
        "Markov's inequality for the squared error"),
    Row("McDiarmid, one step", ("one step",), of.McDiarmid,
        "bounded differences in A^s x0^s and in every column of B^s"),
    Row("Hoeffding, one step", ("one step",), of.OneStepHoeffding,
        "implied by the sharp form: its exponent is at most 4/3 above, and e^(4/3) < 4"),
)  # fmt: skip
# For systematic samples, to which no other row applies: their realizations are dependent.
DEPENDENT = (
    Row("systematic", ("vector", "matrix"), of.Systematic, "every count is within 1 of N p_i"),
)


@dataclass(frozen=True)
class Best:
    """The smallest bound and what it gives.

    Attributes
    ----------
    bound : Bound
        The bound that was chosen.
    radius : float
        Its radius for `size` and `delta`.
    size : int, None or (N0, Nf, NA)
        The size that was given, or the smallest sufficient one.
    delta : float
        The probability of failure that was given.
    """

    bound: Bound
    radius: float
    size: Sizes
    delta: float

    def _repr_html_(self) -> str:
        return html.record(self)


class _Problem:
    """A quantity with its data and choices, checked; settings are made once."""

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
        if len(data) != expected.count(",") + 1:
            raise InputTypeError(
                f"`data` must be {expected} for a {self.quantity}, got {len(data)} arguments"
            )
        control, settings = self.quantity in QUANTITIES, _SETTINGS[self.quantity]
        norms = ("2",) if control else tuple(settings)
        self.norm = norms[0] if norm is None else gate.choice("norm", norm, norms)
        self.fusion = gate.choice("fusion", fusion, FUSIONS)
        self.axis: Axis = "rows" if gate.choice("axis", axis, AXES) == "rows" else "columns"
        self.sample_B = gate.flag("sample_B", sample_B)
        self.settings = settings[self.fusion if control else self.norm]
        self._made: dict[str, Setting] = {}
        self.system: System | None = None
        if self.quantity == "vector":
            self.lines = gate.vector("w", data[0])[:, None]
        elif self.quantity == "matrix":
            self.lines = lines_of(gate.matrix("A", data[0]), self.axis)
        else:
            system = self.system = System.from_any(data[0])
            self.x0 = gate.vector("x0", data[1], length=system.n)
            if control:
                self.xf = gate.vector("xf", data[2], length=system.n)
            else:
                self.u = gate.matrix("u", data[2], cols=system.m)

    def rows(self, table: tuple[Row, ...]) -> dict[str, tuple[Row, str]]:
        """The rows that apply, by name, each with its setting."""
        pairs = ((row, setting) for row in table for setting in row.settings)
        return {row.name: (row, setting) for row, setting in pairs if setting in self.settings}

    def bound(self, row: Row, setting: str) -> Bound:
        """Make one."""
        setting = setting.removesuffix(", state")  # the same, but its row is for the state only
        if setting not in self._made:
            self._made[setting] = self._make(setting)
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
        """All that hold for independent realizations."""
        several = self.quantity == "trajectory" and (self.axis == "rows" or len(self.u) > 1)
        pairs = self.rows(TABLE).values()
        return [self.bound(row, at) for row, at in pairs if not (several and at == "one step")]

    def simulated(self, scheme: Scheme = "iid", steps: int = 1, rng: RngLike = 0) -> Simulated:
        """The order statistic of errors drawn from the law."""
        law: Array | PlanErrors
        if self.system is None:
            law = np.ascontiguousarray(self.lines.T)
        else:
            rows, paired = self.axis == "rows", self.fusion == "diagonal"
            if paired and (steps > 1 or (rows and scheme == "systematic")):
                raise InputError(
                    "`fusion` must be 'product' over several steps and for systematic rows, got "
                    "'diagonal'"
                )
            A, B = self.system.A, self.system.B
            x0, xf, of_A = (Entity(value, scheme=scheme) for value in (self.x0, self.xf, A))
            law = PlanErrors(B, x0, xf, of_A, steps=steps, paired=paired, rows=rows)
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
        Simulated: how the realizations are drawn.
    steps : int, default 1
        Simulated, for a state or a control: over so many steps; product fusion beyond 1.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, default 0
        Simulated: source of randomness, in streams of its own; with the default the same errors in
        every call.

    Returns
    -------
    Bound
        The bound; :class:`Simulated` for "simulated".

    Raises
    ------
    InputError, InputTypeError
        There is no such bound for the quantity (the message lists those that exist), a choice is
        unknown, the data do not fit it, or diagonal fusion is asked for where it is not defined:
        over several steps, and for systematic rows.

    Examples
    --------
    >>> from stochens_rs.theory import bounds
    >>> bounds.bound("systematic", "vector", [3.0, -1.0, 0.5, -0.5]).radius(1000, 0.01)
    0.01
    >>> bounds.bound("Weissman", "vector", [3.0, -1.0], norm="1").required_size(0.1, 0.01)
    16955
    """
    problem = _Problem(quantity, data, norm, fusion, axis, sample_B)
    systematic = gate.choice("scheme", scheme, SCHEMES) == "systematic"
    K, key = gate.size("steps", steps), as_key(rng)
    found = problem.rows(TABLE + DEPENDENT)
    drawn = () if problem.quantity == "trajectory" else ("simulated",)
    if gate.choice("name", name, (*found, *drawn)) == "simulated":
        return problem.simulated("systematic" if systematic else "iid", K, key)
    if systematic or K > 1:
        raise InputError("`scheme` and `steps` are for the bound 'simulated' only")
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
        What the error is of.
    *data : System or array_like
        ``w``; ``A``; ``system, x0, xf`` for the state or the control; ``system, x0, u``. `system`
        is a System or what `System.from_any` takes, such as ``(A, B)``; u (K, m).
    norm : str, optional
        Vector: "2" (default) or "1". Matrix: "spectral" (default) or "Frobenius". The others
        are in the 2-norm.
    fusion : {"product", "diagonal"}, default "product"
        For a state or a control.
    axis : {"columns", "rows"}, default "columns"
        Which lines of the matrices are sampled.

    Returns
    -------
    list of Bound
        The valid ones, with the data checked and the moments computed. :class:`Simulated` is not
        among them: it is no formula, and needs a `delta` that can be simulated.

    Raises
    ------
    InputError, InputTypeError
        A choice is unknown, or the data do not fit it.

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
        Error that may be exceeded with probability `delta` only.

    Returns
    -------
    Best
        The bound with its radius and size.

    Raises
    ------
    InputError, InputTypeError
        As :func:`candidates`; both or none of `size` and `eps` are given; an argument is out of
        range; more than 2^53 realizations would be needed.

    Notes
    -----
    The choice depends on the arguments only, not on realizations: :class:`Simulated` where `delta`
    and the size of the problem allow it, which no other bound can beat by more than a few percent
    (not for trajectories); otherwise the smallest of :func:`candidates`.

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
    found = problem.formulas()
    delta = gate.probability("delta", delta)
    drawn = None if problem.quantity == "trajectory" else problem.simulated()
    if drawn is not None and not drawn._possible(1 if size is None else size, delta):
        drawn = None
    if eps is not None:
        needed, chosen = _smallest_size([drawn] if drawn else found, eps, delta)
        return Best(chosen, chosen.radius(needed, delta), needed, delta)
    if differ(found[0]._rates(size)):
        found = [one for one in found if not one._inequality.equal]
    radii = [one.radius(size, delta) for one in found]
    k = radii.index(min(radii))
    if drawn is None or radii[k] == 0.0:
        return Best(found[k], radii[k], size, delta)
    return Best(drawn, drawn.radius(size, delta), size, delta)


def _smallest_size(found: list[Bound], eps: float, delta: float) -> tuple[int, Bound]:
    """Search each bound in turn; one that fails below the record need not be bisected."""
    best_size, best_bound = found[0].required_size(eps, delta), found[0]
    for one in found[1:]:
        if best_size > 1 and one.radius(best_size - 1, delta) <= eps:
            best_size, best_bound = one.required_size(eps, delta), one
    return best_size, best_bound
