"""Realizations of vectors and matrices: drawn as singletons, or brought by the user.

A singleton realization of a vector ``w`` has one nonzero entry: index ``I`` is drawn with
probability ``|w_i| / g``, ``g = ||w||_1``, and the realization is ``g sign(w_I) e_I``, so that its
mean is ``w`` (paper, Lemma 4.1). A matrix is drawn line by line, each column (or each row)
independently of the others. What is stored is the indices, never the dense realizations.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from . import _core, _gate, _html
from ._lines import Axis, checked_target, from_lines, stack_from_lines, to_lines
from .exceptions import InputError, InputTypeError, NonFiniteError, ShapeError
from .rng import Key

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

Scheme: TypeAlias = Literal["iid", "systematic"]
_BLOCK = 2**20  # entries that are written out at a time


@dataclass(frozen=True, eq=False)
class Counts:
    """Hits of every entry in N realizations that were not drawn one by one.

    Attributes
    ----------
    counts : ndarray of int64, shape (n,) or (n, m)
        ``counts[i, j]``: realizations that hit entry (i, j). Zero in a zero line.
    estimate : ndarray, same shape
        The uniform average ``g_j sign(A_ij) counts[i, j] / N``.
    size : int
        Number of realizations N.
    key : Key
        The key the draw can be repeated with.
    """

    counts: NDArray[np.int64]
    estimate: NDArray[np.float64]
    size: int
    key: Key
    # what was drawn from: the values, the axis of their lines, the scheme
    _law: tuple[NDArray[np.float64], Axis, Scheme] | None = field(
        default=None, init=False, repr=False
    )

    def __post_init__(self) -> None:
        if type(self.counts) is not np.ndarray or self.counts.dtype != np.int64:
            raise InputTypeError(
                f"`counts` must be a numpy.ndarray of int64, got {_gate.show(self.counts)}"
            )
        _gate.kept("estimate", self.estimate, shape=self.counts.shape)
        _gate.size("size", self.size)
        _gate.instance("key", self.key, Key)
        if self.counts.min() < 0:
            raise InputError(f"`counts` must be >= 0, got {self.counts.min()}")

    def _drawn_from(self, values: object, axis: Any, scheme: Any) -> Counts:
        """Say what was drawn from, if it can be what these are the counts of."""
        law = _gate.kept("law", values, shape=self.shape)
        lines = to_lines(law, checked_target(law, axis)[1])
        hits = to_lines(self.counts.astype(np.float64), axis)  # exact: at most 2^53
        expected = np.where(lines.any(axis=1), self.size, 0)
        if (hits.sum(axis=1) != expected).any() or hits[lines == 0.0].any():
            raise InputError(f"`counts` must add up to {self.size} in every line that is drawn")
        object.__setattr__(self, "_law", (law, axis, checked_scheme(scheme)))
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return _counted, (self.counts, self.estimate, self.size, self.key, self._law)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the vector or matrix."""
        return self.counts.shape


class Ensemble:
    """Realizations of one vector or matrix; immutable.

    Made by `sample`, `Ensemble.from_samples` or `Ensemble.from_indices`.
    """

    __slots__ = ("_axis", "_draws", "_key", "_samples", "_scheme", "_shape")

    _draws: _core.Draws | None
    _samples: NDArray[np.float64] | None
    _shape: tuple[int, ...]
    _axis: Axis
    _scheme: Scheme | None
    _key: Key | None

    def __init__(self, *_: object, **__: object) -> None:
        raise InputTypeError(
            "an Ensemble is made by `sample`, `Ensemble.from_samples` or `Ensemble.from_indices`"
        )

    @classmethod
    def from_samples(cls, samples: ArrayLike) -> Ensemble:
        """Make an ensemble of any realizations.

        Parameters
        ----------
        samples : array_like, shape (N, n) or (N, n, m)
            ``samples[s]`` is realization s of a vector or a matrix. Copied.

        Returns
        -------
        Ensemble
            With the same methods as a drawn one, except that there are no indices to count.

        Raises
        ------
        InputError, InputTypeError
            If the array cannot be used.

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.Ensemble.from_samples([[1.0, 0.0], [0.0, 3.0]]).combine([0.5, 0.5])
        array([0.5, 1.5])
        """
        values = _gate.array("samples", samples, ndim=(2, 3))
        _gate.memory("a copy of the samples", values.nbytes)
        return cls._of_samples(_gate.frozen(values))

    @classmethod
    def from_indices(
        cls, indices: ArrayLike, target: ArrayLike, *, axis: Axis = "columns"
    ) -> Ensemble:
        """Make an ensemble of singletons with given indices.

        Parameters
        ----------
        indices : array_like of int, shape (N,) or (N, lines)
            ``indices[s, j]`` is the entry that realization s hits in line j.
        target : array_like, shape (n,) or (n, m)
            The vector or matrix whose 1-norms and signs the realizations have.
        axis : {"columns", "rows"}, default "columns"
            Which lines of a matrix the indices belong to.

        Returns
        -------
        Ensemble
            N singleton realizations, without a key.

        Raises
        ------
        InputError, InputTypeError
            If the indices do not belong to the target.

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.Ensemble.from_indices([0, 0, 1], [3.0, -4.0]).dense()
        array([[ 7.,  0.],
               [ 7.,  0.],
               [ 0., -7.]])
        """
        values, axis = checked_target(target, axis)
        lines = to_lines(values, axis)
        given = _gate.read("indices", indices)
        if given.size == 0 or given.ndim not in (1, 2):
            raise ShapeError(f"`indices` must have shape (N, {lines.shape[0]}), got {given.shape}")
        if given.dtype.kind not in "ui":
            raise InputTypeError(f"`indices` must be integers, got dtype {given.dtype}")
        given = given.reshape(-1, 1) if given.ndim == 1 else given
        if given.shape[1] != lines.shape[0]:
            raise ShapeError(f"`indices` must have shape (N, {lines.shape[0]}), got {given.shape}")
        if given.min() < 0 or given.max() >= lines.shape[1]:
            raise InputError(f"`indices` must lie in [0, {lines.shape[1]})")
        draws = _core.Draws.from_indices(lines, np.ascontiguousarray(given, dtype=np.uint32))
        return cls._of_draws(draws, values.shape, axis, None, None)

    @classmethod
    def _of_draws(
        cls,
        draws: _core.Draws,
        shape: tuple[int, ...],
        axis: Axis,
        scheme: Scheme | None,
        key: Key | None,
    ) -> Ensemble:
        self = object.__new__(cls)
        self._set(draws, None, shape, axis, scheme, key)
        return self

    @classmethod
    def _of_samples(cls, samples: NDArray[np.float64]) -> Ensemble:
        self = object.__new__(cls)
        self._set(None, samples, samples.shape[1:], "columns", None, None)
        return self

    def _set(self, *values: Any) -> None:
        names = ("_draws", "_samples", "_shape", "_axis", "_scheme", "_key")
        for name, value in zip(names, values, strict=True):
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
        """Whether the realizations have one nonzero entry per line."""
        return self._draws is not None

    @property
    def axis(self) -> Axis:
        """Which lines of a matrix were drawn independently."""
        return self._axis

    @property
    def scheme(self) -> Scheme | None:
        """How the realizations were drawn; None if the user brought them."""
        return self._scheme

    @property
    def key(self) -> Key | None:
        """The key the sample can be repeated with (``rng=key``); None if it was not drawn."""
        return self._key

    @property
    def gamma(self) -> float:
        """``||w||_1``, for a matrix the largest 1-norm of a line; for samples the largest seen."""
        if self._draws is not None:
            return float(self._draws.gamma().max())
        norms = np.abs(self._dense()).sum(axis=1)
        return float(norms.max())

    @property
    def indices(self) -> NDArray[Any] | None:
        """Indices (N, lines), read-only, without a copy; None for samples brought by the user."""
        return None if self._draws is None else self._draws.indices()

    @property
    def atoms(self) -> NDArray[np.float64] | None:
        """The value ``g_j sign(A_ij)`` of a realization that hits an entry; None for samples."""
        if self._draws is None:
            return None
        return from_lines(self._draws.atoms(), self._shape, self._axis)

    @property
    def samples(self) -> NDArray[np.float64] | None:
        """The realizations (N, ...) the user brought, read-only; None for singletons."""
        return self._samples

    @property
    def nbytes(self) -> int:
        """Bytes that the realizations take."""
        return self._draws.nbytes if self._draws is not None else self._dense().nbytes

    def counts(self) -> NDArray[np.int64]:
        """Count how many realizations hit each entry.

        Returns
        -------
        ndarray of int64
            In the shape of a realization; N in total per line, none in a zero line.

        Raises
        ------
        InputTypeError
            If the realizations are not singletons.
        """
        if self._draws is None:
            raise InputTypeError("counts() needs singleton realizations; these are dense samples")
        counts = self._draws.counts()
        # not a product of two types: short of memory, NumPy's buffered loops crash
        counts[self._draws.gamma() == 0.0] = 0
        return from_lines(counts, self._shape, self._axis)

    def dense(self) -> NDArray[np.float64]:
        """Write the realizations out.

        Returns
        -------
        ndarray, shape (N, n) or (N, n, m)
            ``dense[s]`` is realization s.

        Raises
        ------
        ResourceError
            If the array does not fit into the memory this process may use.
        """
        entries = int(np.prod(self._shape))
        rows = max(1, _BLOCK // entries)
        largest = min(rows, self.size) * entries
        _gate.memory("the dense realizations", (self.size * entries + 4 * largest) * 8)
        out = np.empty((self.size, *self._shape))
        first = 0
        for block in self._dense_blocks(rows):  # between two of them Ctrl-C is heard
            out[first : first + len(block)] = block
            first += len(block)
        return out

    def _dense_blocks(self, rows: int) -> Iterator[NDArray[np.float64]]:
        """The realizations written out, `rows` at a time."""
        for first in range(0, self.size, rows):
            if self._draws is None:
                yield self._dense()[first : first + rows]
                continue
            index = self._draws.indices()[first : first + rows].astype(np.intp)
            atoms = self._draws.atoms()
            out = np.zeros((len(index), *atoms.shape))
            s, j = np.arange(len(index))[:, None], np.arange(len(atoms))[None, :]
            out[s, j, index] = atoms[j, index]
            yield stack_from_lines(out.reshape(len(index), -1), self._shape, self._axis)

    def prefix(self, size: int) -> Ensemble:
        """Return the first realizations, sharing their memory.

        Parameters
        ----------
        size : int
            How many, from 1 to N.

        Returns
        -------
        Ensemble
            For an iid sample the same as a sample of that size with the same key. A part of a
            systematic sample is none: it has no key and no scheme.
        """
        count = _gate.size("size", size, maximum=self.size)
        if self._draws is not None:
            draws = self._draws.prefix(count)
            if self._scheme == "systematic" and count < self.size:
                return Ensemble._of_draws(draws, self._shape, self._axis, None, None)
            return Ensemble._of_draws(draws, self._shape, self._axis, self._scheme, self._key)
        return Ensemble._of_samples(self._dense()[:count])

    def combine(self, weights: ArrayLike) -> NDArray[np.float64]:
        """Compute ``sum_s weights[s] E_s``.

        Parameters
        ----------
        weights : array_like, shape (N,)
            Any finite weights.

        Returns
        -------
        ndarray
            In the shape of a realization.

        Raises
        ------
        ShapeError, NonFiniteError, InputTypeError
            If the weights cannot be used, or the sum overflows.
        """
        w = _gate.vector("weights", weights, length=self.size)
        result: NDArray[np.float64]
        if self._draws is not None:
            result = from_lines(self._draws.combine(w), self._shape, self._axis)
        else:
            with np.errstate(over="ignore", invalid="ignore"):
                result = np.tensordot(w, self._dense(), axes=1)
        if not np.isfinite(result).all():
            raise NonFiniteError("`weights` times the realizations overflows: scale them down")
        return result

    def mean(self) -> NDArray[np.float64]:
        """Compute the uniform average of the realizations.

        Returns
        -------
        ndarray
            In the shape of a realization.
        """
        if self._draws is not None:
            average = self._draws.atoms() * (self._draws.counts() / self.size)
            return from_lines(average, self._shape, self._axis)
        samples = self._dense()
        with np.errstate(over="ignore", invalid="ignore"):
            result: NDArray[np.float64] = samples.mean(axis=0)
        if not np.isfinite(result).all():  # the sum overflows; an average never does
            result = sum((row / self.size for row in samples), np.zeros(self._shape))
        return result

    def _law(self) -> NDArray[np.float64] | None:
        """The vector or matrix that singletons are drawn from; a copy."""
        if self._draws is None:
            return None
        return from_lines(self._draws.values(), self._shape, self._axis)

    def _dense(self) -> NDArray[np.float64]:
        assert self._samples is not None
        return self._samples

    def _lines_of(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lay a target out as the core does: one line per row (dense samples: one row)."""
        return to_lines(values, self._axis) if self._draws is not None else values.reshape(1, -1)

    def _from_core(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Undo `_lines_of`."""
        if self._draws is not None:
            return from_lines(values, self._shape, self._axis)
        return values.reshape(self._shape)

    def _stack_from_core(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Undo `_lines_of` for every row of (k, entries)."""
        if self._draws is not None:
            return stack_from_lines(values, self._shape, self._axis)
        return values.reshape(-1, *self._shape)

    def _core_realizations(self) -> _core.Draws | NDArray[np.float64]:
        """What the core takes as realizations."""
        return self._draws if self._draws is not None else self._dense().reshape(self.size, -1)

    def __len__(self) -> int:
        return self.size

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Ensemble):
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

    __hash__ = None  # type: ignore[assignment]  # as large as an array, and as little a key

    def __reduce__(self) -> tuple[Any, ...]:
        if self._draws is None:
            return (Ensemble.from_samples, (self._dense(),))
        return (_redrawn, (self.indices, self._law(), self._axis, self._scheme, self._key))

    def _repr_html_(self) -> str:
        return _html.ensemble(self)

    def __repr__(self) -> str:
        kind = "dense"
        if self.is_singleton:
            lines = "" if len(self._shape) == 1 else f"{self._axis}, "
            kind = f"singleton ({lines}{self._scheme or 'given indices'})"
        return f"<Ensemble: {self.size} {kind} realizations of shape {self._shape}>"


def checked_scheme(scheme: str) -> Scheme:
    """Return how realizations are drawn."""
    name = _gate.choice("scheme", scheme, ("iid", "systematic"))
    return "iid" if name == "iid" else "systematic"


def _redrawn(
    indices: ArrayLike, target: ArrayLike, axis: Axis, scheme: Scheme | None, key: Key | None
) -> Ensemble:
    """Unpickle."""
    made = Ensemble.from_indices(indices, target, axis=axis)
    if scheme is not None:
        scheme = checked_scheme(scheme)
    if key is not None:
        key = _gate.instance("key", key, Key)
    made._set(made._draws, None, made._shape, axis, scheme, key)
    return made


def _counted(
    counts: NDArray[np.int64],
    estimate: NDArray[np.float64],
    size: int,
    key: Key,
    law: tuple[object, ...] | None,
) -> Counts:
    """Unpickle."""
    made = Counts(counts, estimate, size, key)
    if law is None:
        return made
    values, axis, scheme = _gate.items("law", law) if len(law) == 3 else (None, None, None)
    return made._drawn_from(values, axis, scheme)
