"""`Snapshot`: the model of a `ModelStream` after the pairs so far, with its region."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, isqrt
from typing import TYPE_CHECKING

import numpy as np

from .. import _core
from .._base import show, validation
from .._base.names import checked_names
from .._base.records import SavedRecord, cached_property
from ..exceptions import InputError
from ..identification.assumptions import Assumptions, checked_scale, require_states
from ..identification.checks import (
    cautions,
    exact_relations,
    missing_directions,
    noise_doubts,
    tested_rows,
)
from ..identification.identified import Identified
from ..identification.region import Region, Wish, region_of, withheld

if TYPE_CHECKING:
    from .._base.types import Floats


@dataclass(frozen=True, eq=False, repr=False)
class Snapshot(SavedRecord, Identified):
    """The model of a `ModelStream` at one time. Made by `ModelStream.model`.

    Attributes
    ----------
    triangle : ndarray
        R with ``R' R = W' W`` for the rows ``W = (x, u, 1, x_next)`` of all pairs so far.
    size : int
        The number of pairs N.
    n, m : int
        The numbers of states and inputs.
    assumptions : Assumptions
        Design, noise and covariance, as declared.
    scale : ndarray, shape (n + m,) or (n + m + 1,)
        The sizes of states and inputs that were expected before the data.
    intercept : bool
        Whether there is an offset c.
    delta : float
        The probability of error of all regions of the stream together.
    first : int
        The number of pairs of the first planned look, see `ModelStream`.
    dt : float or None
        The time between two steps [s].
    state_names, input_names : tuple of str
        The names.
    runs : int
        The number of runs that the pairs came in: one begins where x is not the x_next before.
    """

    triangle: Floats
    size: int
    n: int
    m: int
    assumptions: Assumptions
    scale: Floats
    intercept: bool
    delta: float
    first: int
    dt: float | None = None
    state_names: tuple[str, ...] = ()
    input_names: tuple[str, ...] = ()
    runs: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        d = validation.size("n", self.n) + validation.size("m", self.m) + self.intercept
        validation.kept("triangle", self.triangle, shape=(d + self.n,) * 2)
        validation.kept("scale", self.scale, shape=(d,))
        validation.size("size", self.size, minimum=0)
        validation.size("runs", self.runs, minimum=0, maximum=self.size)
        validation.probability("delta", self.delta)
        validation.size("first", self.first)
        if self.dt is not None:
            validation.positive("dt", self.dt)
        checked_names(self.n, self.m, self.state_names, self.input_names)

    def _verify(self) -> None:
        refuse(self.assumptions)
        require_states(self.assumptions, self.n)
        d = self.n + self.m
        if not np.array_equal(checked_scale(self.scale[:d], d, self.intercept), self.scale):
            raise InputError("`scale` must be positive, and 1 for an offset")
        R, size = self.triangle, self.size
        validation.size("runs", self.runs, minimum=min(size, 1), maximum=size)
        if np.tril(R, -1).any() or (np.diag(R) < 0.0).any():
            raise InputError("`triangle` must be upper triangular with a diagonal >= 0")
        ones = float(np.sum(R[:, len(self.scale) - 1] ** 2)) if self.intercept else float(size)
        if (size == 0 and R.any()) or abs(ones - size) > 1e-6 * size:
            raise InputError(f"`triangle` must be that of {size} pairs")

    @property
    def _delta(self) -> float:
        return self.delta

    @property
    def _d(self) -> int:
        return len(self.scale)

    @cached_property
    def _estimate(self) -> _core.Estimate:
        triangle = np.ascontiguousarray(self.triangle)
        return _core.Estimate(triangle, self.size, self.n, self.m, self.intercept)

    @cached_property
    def _block(self) -> _core.Fitted:
        return self._estimate.blocks[0]

    @cached_property
    def _Theta(self) -> Floats:
        """``[A B c]``, read-only."""
        return validation.frozen(self._estimate.Theta)

    @property
    def rank(self) -> int:
        """How many directions of z = (x, u, 1) the data determine."""
        return self._block.rank

    @property
    def identifiable(self) -> bool:
        """Whether the data determine the whole model."""
        return self.rank == self._d

    @cached_property
    def missing(self) -> tuple[str, ...]:
        """The directions of z that the data do not determine, in the names of states and inputs."""
        return missing_directions([self._block], [*self.state_names, *self.input_names, "1"])

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to be careful about, one sentence each."""
        return (*self.doubts, *cautions([self._block], self.missing))

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Why no certificate is finite: exact relations, and noise that is not as declared.

        Of the tests of `Model.doubts` those that need no pairs: a stream keeps their triangle. At
        each look they have a level of 5e-6.
        """
        f = self._block
        tested = tested_rows(self.assumptions, None, self.n)
        return (
            *exact_relations(f, tested, self.state_names),
            *noise_doubts(f, self.assumptions, tested),
        )

    def region(
        self, delta: float | None = None, *, future: int = 0, frobenius: bool = False
    ) -> Region:
        """Return a set of models that contains the true one, in one event with all other looks.

        Parameters
        ----------
        delta : float, optional
            The probability that it does not at any look, at most that of the stream, which is the
            default.
        future : int, default 0
            Must be 0: regions of a stream cover no noise to come.
        frobenius : bool, default False
            Bound the Frobenius norm as well, by ``sqrt(min(n, rank))`` times the spectral one.

        Returns
        -------
        Region
            For any design that of ``Model.region(delta, anytime=True)``, which holds for all N at
            once. For an independent one the exact region, with ``delta / ((j + 1) (j + 2))`` at the
            planned look j = 0, 1, ...: all of them together have delta.

        Raises
        ------
        InputError, InputTypeError
            If `delta` is above that of the stream; or, for an independent design, the number of
            pairs is not a planned one; the message has the next one.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> x, u, w = np.random.default_rng(1).standard_normal((3, 50, 1))
        >>> stream = se.ModelStream(1, 1, noise=0.1)
        >>> stream.update(x, u, 0.5 * x + u + 0.1 * w)
        >>> stream.model.region().contains([[0.5]], [[1.0]])
        True
        """
        level = self.delta if delta is None else validation.probability("delta", delta)
        if level > self.delta:
            raise InputError(
                f"`delta` must be at most {self.delta:g}, which all looks at this stream share, "
                f"got {level:g}"
            )
        if validation.size("future", future, minimum=0):
            raise InputError("`future` must be 0: regions of a stream cover no noise to come")
        if self.next_look != self.size:
            raise InputError(
                f"a region needs a planned number of pairs with design='independent': there are "
                f"{self.size}, and the next look is at {self.next_look}"
            )
        text = f"{self.assumptions.text}, any design, valid for all N at once"
        if self._planned:
            text = f"{self.assumptions.text}, independent of all states and inputs, planned looks"
            j = look_after(self.first, self.size)
            level /= (j + 1.0) * (j + 2.0)
        made = region_of(self._estimate, self.assumptions, Wish(level, anytime=True), self.scale)
        # ||G||_F <= sqrt(min(n, rank)) ||G||: the same event
        factor = made.parts[0].factor
        wider = float(np.sqrt(factor * min(self.n, self.rank)))
        noise = made.noise if self.assumptions.noise == "gaussian" else None
        region = Region(
            centre=self._Theta,
            m=self.m,
            delta=level,
            assumption=text,
            missing=self.missing,
            parts=made.parts,
            frobenius=wider if validation.flag("frobenius", frobenius) else None,
            noise=None if noise is None else validation.frozen(noise),
        )
        return withheld(region, self.doubts)

    @property
    def _planned(self) -> bool:
        """Whether looks are at planned numbers of pairs only."""
        return self.assumptions.design == "independent"

    @property
    def next_look(self) -> int:
        """The number of pairs of the next possible look: `size` if it is possible now."""
        return self._size_after(self.size)

    def _after(self, size: float) -> Snapshot:
        """The model at a possible look at `size` pairs or more, if data go on like those so far."""
        later = self._size_after(size)
        triangle = validation.frozen(self.triangle * np.sqrt(later / self.size))
        made = replace(self, triangle=triangle, size=later)
        made.__dict__["doubts"] = self.doubts  # too few pairs for a residual are no exact relation
        return made

    def _in_runs(self, pairs: float) -> float:
        """So many pairs in runs of the mean length of those so far."""
        return pairs * self.runs / self.size if self.size else pairs

    def _size_after(self, size: float) -> int:
        """The first possible look at `size` pairs or more."""
        N = ceil(size)
        return planned(self.first, look_after(self.first, N)) if self._planned else N

    def __repr__(self) -> str:
        rank = "" if self.identifiable else f", rank {self.rank} of {self._d}"
        dt = "" if self.dt is None else f" dt={self.dt:g}"
        pairs = show.number_of(self.size, "pair")
        design = self.assumptions.design_text
        warned = show.warned(self.warnings)
        return f"<Snapshot: n={self.n} m={self.m}{dt}, {pairs}{design}{rank}{warned}>"

    def _repr_html_(self) -> str:
        rows = [("assumed", self.assumptions.text), *(("warning", text) for text in self.warnings)]
        return show.card(self, rows, self._table())


def refuse(assumed: Assumptions) -> None:
    """Refuse assumptions whose regions do not hold while data arrive."""
    if assumed.design == "independent" and assumed.noise != "gaussian":
        raise InputError(
            f"`design` must be 'adaptive' for noise='{assumed.noise}': the region is the same, "
            "and may be looked at any time"
        )


def planned(first: int, j: int) -> int:
    """The number of pairs of look j = 0, 1, ...: ``ceil(first 2^(j/2))``, exactly."""
    return isqrt((first * first << j) - 1) + 1


def look_after(first: int, size: int) -> int:
    """The planned look j at `size` pairs, or else the next one."""
    j = 0
    while planned(first, j) < size:
        j += 1
    return j
