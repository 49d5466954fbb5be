"""The stored realizations of an ensemble, and their layout in the core."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import _core
from .._base.types import Axis, Centre, Floats, Scheme
from ..rng import Key
from .dense import dense_blocks
from .law import Law
from .lines import from_lines, stack_from_lines, to_lines

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray
    from typing_extensions import Self


class Realizations:
    """Draws of the core, or dense samples (N, ...); immutable."""

    __slots__ = ("_draws", "_samples", "_shape", "_axis", "_scheme", "_key", "_centre")  # noqa: RUF023

    _draws: _core.Draws | None
    _samples: Floats | None
    _shape: tuple[int, ...]
    _axis: Axis
    _scheme: Scheme | None
    _key: Key | None
    _centre: Centre | None

    @classmethod
    def _of_draws(
        cls,
        draws: _core.Draws,
        shape: tuple[int, ...],
        axis: Axis,
        scheme: Scheme | None,
        key: Key | None,
    ) -> Self:
        self = object.__new__(cls)
        self._set(draws, None, shape, axis, scheme, key, None if scheme is None else "truth")
        return self

    @classmethod
    def _of_samples(cls, samples: Floats, centre: Centre | None = None) -> Self:
        self = object.__new__(cls)
        self._set(None, samples, samples.shape[1:], "columns", None, None, centre)
        return self

    def _set(self, *values: Any) -> None:
        for name, value in zip(Realizations.__slots__, values, strict=True):
            object.__setattr__(self, name, value)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"an Ensemble is immutable: cannot set `{name}`")

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"an Ensemble is immutable: cannot delete `{name}`")

    @property
    def size(self) -> int:
        """Number of realizations N."""
        return self._draws.size if self._draws is not None else len(self._dense())

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of a realization: (n,) or (n, m)."""
        return self._shape

    @property
    def is_singleton(self) -> bool:
        """Whether the realizations are singletons, with one nonzero entry per line."""
        return self._draws is not None

    @property
    def axis(self) -> Axis:
        """Which lines of a matrix were drawn independently: "columns" or "rows"."""
        return self._axis

    @property
    def scheme(self) -> Scheme | None:
        """How the realizations were drawn; None if they were not drawn here."""
        return self._scheme

    @property
    def law(self) -> Law | None:
        """The law of the realizations; None if they were not drawn here."""
        values = self._values()
        if values is None or self._scheme is None:
            return None
        return Law(values, self._axis, self._scheme)

    @property
    def centre(self) -> Centre | None:
        """What the realizations scatter about: "truth" or "estimate"; None if unknown."""
        return self._centre

    @property
    def key(self) -> Key | None:
        """The key to repeat the sample (``rng=key``); None if it was not drawn here."""
        return self._key

    @property
    def gamma(self) -> float:
        """Largest 1-norm of a line of the target; of a realization if they are dense."""
        if self._draws is not None:
            return float(self._draws.gamma().max())
        norms = np.abs(self._dense()).sum(axis=1)
        return float(norms.max())

    @property
    def indices(self) -> NDArray[Any] | None:
        """Indices (N, lines), read-only, not copied; None for dense realizations."""
        return None if self._draws is None else self._draws.indices()

    @property
    def atoms(self) -> Floats | None:
        """``g_j sign(A_ij)``, the value of an entry that is hit; None for dense realizations."""
        if self._draws is None:
            return None
        return from_lines(self._draws.atoms(), self._shape, self._axis)

    @property
    def samples(self) -> Floats | None:
        """Dense realizations (N, ...), read-only; None for singletons."""
        return self._samples

    @property
    def nbytes(self) -> int:
        """Memory of the realizations [bytes]."""
        return self._draws.nbytes if self._draws is not None else self._dense().nbytes

    def __len__(self) -> int:
        return self.size

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Realizations):
            return NotImplemented
        if (self._shape, self.size, self.is_singleton) != (
            other._shape,
            other.size,
            other.is_singleton,
        ):
            return False
        if self._draws is None or other._draws is None:
            return np.array_equal(self._dense(), other._dense())
        return (
            (len(self._shape) == 1 or self._axis == other._axis)
            and np.array_equal(self._draws.atoms(), other._draws.atoms())
            and np.array_equal(self._draws.indices(), other._draws.indices())
        )

    __hash__ = None  # type: ignore[assignment]  # as for arrays

    def _dense_blocks(self, rows: int) -> Iterator[Floats]:
        """Return the dense realizations, `rows` at a time."""
        if self._draws is not None:
            return dense_blocks(self._draws, self._shape, self._axis, rows)
        samples = self._dense()
        return (samples[first : first + rows] for first in range(0, self.size, rows))

    def _values(self) -> Floats | None:
        """Return a copy of the vector or matrix that gives the 1-norms and signs of singletons."""
        if self._draws is None:
            return None
        return from_lines(self._draws.values(), self._shape, self._axis)

    def _dense(self) -> Floats:
        assert self._samples is not None
        return self._samples

    def _lines_of(self, values: Floats) -> Floats:
        """Return a target in the layout of the core (for dense realizations: one row)."""
        return to_lines(values, self._axis) if self._draws is not None else values.reshape(1, -1)

    def _from_core(self, values: Floats) -> Floats:
        """Undo `_lines_of`."""
        if self._draws is not None:
            return from_lines(values, self._shape, self._axis)
        return values.reshape(self._shape)

    def _stack_from_core(self, values: Floats) -> Floats:
        """Undo `_lines_of` for every row of (k, entries)."""
        if self._draws is not None:
            return stack_from_lines(values, self._shape, self._axis)
        return values.reshape(-1, *self._shape)

    def _core_realizations(self) -> _core.Draws | Floats:
        """Return the realizations as the core takes them."""
        return self._draws if self._draws is not None else self._dense().reshape(self.size, -1)
