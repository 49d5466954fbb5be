"""`Identified`: what every model from data has, however it was made."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Literal

from .._base.labels import Labels
from .._base.records import Record

if TYPE_CHECKING:
    from .._base.types import Floats
    from .region import Region


class Identified(Record, ABC, listed=False):
    """A model ``x(k+1) = A x(k) + B u(k) + c`` from data, with regions that contain the system.

    Base of the models that `identify`, `fuse` and `ModelStream` make; `control` takes any of them.
    """

    @property
    @abstractmethod
    def A(self) -> Floats:
        """The state matrix, shape (n, n)."""

    @property
    @abstractmethod
    def B(self) -> Floats:
        """The input matrix, shape (n, m)."""

    @property
    @abstractmethod
    def c(self) -> Floats | None:
        """The offset, shape (n,), or None."""

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
    def labels(self) -> Labels:
        """The names in one record, as that of a `System`; data have no units."""
        return Labels(self.state_names, self.input_names)

    @property
    def centre(self) -> Literal["estimate"]:
        """Always "estimate": a model is not the system, and is not taken for it unasked."""
        return "estimate"

    @abstractmethod
    def region(self, delta: float = 0.05, *, future: int = 0, frobenius: bool = False) -> Region:
        """Return a set of models that contains the true one, as `Model.region` does."""
