"""`Identified`: what every model from data has, however it was made."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Literal

from .. import _core
from .._base import show
from .._base.names import Labels
from .._base.records import Record, cached_property, trusted
from .._base.tables import columns
from .._base.types import DELTA, Floats
from ..exceptions import StochensError
from ..system.system import System
from .checks import missing_directions
from .region import Region
from .window import Regressors

LISTED = 12  # most rows and columns of a table of coefficients
WIDE = 100  # characters of a line


class Identified(Record, ABC, listed=False):
    """A model ``x(k+1) = A x(k) + B u(k) + c`` from data, with regions that contain the system.

    Base of the models that `identify`, `fuse` and `ModelStream` make; `control` takes any of them.
    """

    @property
    @abstractmethod
    def Theta(self) -> Floats:
        """``[A B c]`` or ``[A B]``, read-only."""

    @property
    @abstractmethod
    def dt(self) -> float | None:
        """The time between two steps [s]."""

    @property
    @abstractmethod
    def state_names(self) -> tuple[str, ...]:
        """The names of the states."""

    @property
    @abstractmethod
    def input_names(self) -> tuple[str, ...]:
        """The names of the inputs."""

    @property
    @abstractmethod
    def warnings(self) -> tuple[str, ...]:
        """What to be careful about, one sentence each."""

    @property
    def window(self) -> Regressors | None:
        """From which readings or past inputs it predicts; None for states that say all."""
        return None

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of what is predicted: the outputs, or the states where all are measured."""
        return self.state_names

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why no certificate of a plan from this model is finite, one sentence each."""
        return ()

    @property
    def A(self) -> Floats:
        """The state matrix, shape (n, n), read-only."""
        return self.Theta[:, : len(self.state_names)]

    @property
    def B(self) -> Floats:
        """The input matrix, shape (n, m), read-only."""
        n = len(self.state_names)
        return self.Theta[:, n : n + len(self.input_names)]

    @property
    def c(self) -> Floats | None:
        """The offset, shape (n,), read-only; None without intercept."""
        d = len(self.state_names) + len(self.input_names)
        return self.Theta[:, d] if self.Theta.shape[1] > d else None

    @property
    def system(self) -> System:
        """The system ``(A, B)``; the offset is not in it."""
        names = self.state_names, self.input_names
        return System(self.A, self.B, dt=self.dt, states=names[0], inputs=names[1])

    @property
    def largest(self) -> Floats | None:
        """The largest absolute value of each state and input in the data, (n + m,), if known."""
        return None

    @property
    def level(self) -> float:
        """The level at which a control keeps hard limits of states."""
        return DELTA

    @property
    def labels(self) -> Labels:
        """The names in one record, as that of a `System`; data have no units."""
        return trusted(Labels, self.state_names, self.input_names)

    @property
    def centre(self) -> Literal["estimate"]:
        """Always "estimate": a model is not the system, and is not taken for it unasked."""
        return "estimate"

    @abstractmethod
    def region(self, delta: float = 0.05, *, future: int = 0, frobenius: bool = False) -> Region:
        """Return a set of models that contains the true one, as `Model.region` does."""

    def regions(self, delta: float = 0.05, **options: Any) -> tuple[Region, ...]:
        """Return regions that hold in one event, the smallest first.

        Parameters
        ----------
        delta : float, default 0.05
            Probability of error, in (0, 1).
        **options
            As of `region`.

        Returns
        -------
        tuple of Region
        """
        found = self._in_one_event(delta, **options)
        return tuple(sorted(found, key=lambda region: region.radius))

    def _in_one_event(self, delta: float, **options: Any) -> tuple[Region, ...]:
        return (self.region(delta, **options),)

    def __str__(self) -> str:
        """The repr, and the coefficients with what all of them are within at once."""
        cells, about = self._cells()
        return "\n".join([repr(self), *(columns(cells, WIDE) if cells else ()), *about])

    def _table(self) -> str:
        """``[A B c]`` as HTML; empty if it is large."""
        cells, about = self._cells()
        return show.grid(cells[0], cells[1:]) + "".join(map(show.note, about)) if cells else ""

    @property
    def _coefficients(self) -> tuple[tuple[str, ...], tuple[str, ...], Floats]:
        """What is predicted, from what, and the coefficients."""
        return self.state_names, (*self.state_names, *self.input_names, "1"), self.Theta

    def _cells(self) -> tuple[list[list[str]], list[str]]:
        """``[A B c]`` with its names, and what is known of its errors; empty if it is large."""
        names, regressors, Theta = self._coefficients
        n, d = Theta.shape
        if max(n, d) > LISTED:
            return [], []
        head = ["", *regressors][: d + 1]
        try:
            region = self.region()
        except StochensError:  # none is known
            rows = [[f"{value:.4g}" for value in row] for row in Theta]
            about = []
        else:
            pairs = zip(region.centre, region.entry_bounds, strict=True)
            rows = [[*map(show.within, centre, bound)] for centre, bound in pairs]
            about = [f"all within ± with {show.percent(region.delta)}, see region()"]
        body = [[f"{name}(k+1)", *row] for name, row in zip(names, rows, strict=True)]
        return [head, *body], about


class Fitted(Identified, listed=False):
    """A model of least squares, from the triangle of its pairs."""

    @property
    @abstractmethod
    def estimate(self) -> _core.Estimate:
        """The estimate of the core."""

    @cached_property
    def blocks(self) -> list[_core.Fitted]:
        """The fits of the rows with the same unknown entries."""
        return self.estimate.blocks

    @property
    def rank(self) -> int:
        """How many directions of z = (x, u, 1) the data determine, the least over the rows."""
        return self.estimate.rank

    @property
    def identifiable(self) -> bool:
        """Whether the data determine the whole model."""
        return not self.missing

    @cached_property
    def missing(self) -> tuple[str, ...]:
        """The directions of z that the data do not determine, in the names of states and inputs.

        ``x[1] - u[0]``: the data are the same for all models that act alike on the z in which this
        combination is 0.
        """
        return self._missing_in(self.estimate)

    def _missing_in(self, estimate: _core.Estimate) -> tuple[str, ...]:
        """The directions that the data of this estimate do not determine."""
        if estimate.rank == estimate.Theta.shape[1]:
            return ()
        return missing_directions(estimate.blocks, self._coefficients[1])

    def _text(self, sizes: str) -> str:
        """The repr of a model of these sizes."""
        rank = "" if self.identifiable else f", rank {self.rank} of {self.estimate.Theta.shape[1]}"
        dt = "" if self.dt is None else f" dt={self.dt:g}"
        own: Any = self
        pairs, design = show.number_of(own.size, "pair"), own.assumptions.design_text
        name, warned = type(self).__name__, show.warned(self.warnings)
        return f"<{name}: {sizes}{dt}, {pairs}{design}{rank}{warned}>"
