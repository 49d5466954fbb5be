"""`Ensemble`: realizations of a vector or matrix, drawn as singletons or passed by the user.

A singleton realization of a vector ``w`` has one nonzero entry: index ``I`` is drawn with
probability ``|w_i| / g``, ``g = ||w||_1``, and the realization is ``g sign(w_I) e_I``, with mean
``w`` (paper, Lemma 4.1). The columns (or rows) of a matrix are drawn independently of each other.
Only the indices are stored.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .._base import running, show, validation
from .._base.records import SavedRecord, trusted
from .._base.types import AXES, CENTRES, SCHEMES, Axis, Centre, Floats, Scheme
from ..exceptions import InputError, InputTypeError, NonFiniteError, ShapeError
from ..rng import Key
from .law import Law, dense, dense_blocks, from_lines, stack_from_lines, to_lines


def _rebuilt(
    indices: NDArray[Any] | None,
    target: Floats | None,
    axis: Axis,
    scheme: Scheme | None,
    key: Key | None,
    samples: Floats | None,
    centre: Centre | None,
) -> Ensemble:
    """Make an ensemble from its fields, which may come from anywhere."""
    if samples is not None:
        return Ensemble.from_samples(samples, centre=centre)
    if indices is None or target is None:
        raise InputTypeError("an Ensemble must have samples, or indices and a target")
    if scheme is not None:
        validation.choice("scheme", scheme, SCHEMES)
    drawn = Ensemble.from_indices(indices, target, axis=axis)
    key = None if key is None else validation.instance("key", key, Key)
    return drawn._like(scheme=scheme, key=key, centre=None if scheme is None else "truth")


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Ensemble(SavedRecord):
    """N realizations of one vector or matrix; immutable.

    Made by `sample`, `Ensemble.from_samples` or `Ensemble.from_indices`.

    Attributes
    ----------
    samples : ndarray, shape (N, ...), or None
        Dense realizations, read-only; None for singletons.
    shape : tuple of int
        Shape of a realization: (n,) or (n, m).
    axis : {"columns", "rows"}
        Which lines of a matrix were drawn independently.
    scheme : {"iid", "systematic"} or None
        How the realizations were drawn; None if they were not drawn here.
    key : Key or None
        The key to repeat the sample (``rng=key``); None if it was not drawn here.
    centre : {"truth", "estimate"} or None
        What the realizations scatter about; None if unknown.
    """

    _draws: _core.Draws | None
    samples: Floats | None
    shape: tuple[int, ...]
    axis: Axis
    scheme: Scheme | None
    key: Key | None
    centre: Centre | None

    _made_by = staticmethod(_rebuilt)

    def __init__(self, *_: object, **__: object) -> None:
        raise InputTypeError(
            "an Ensemble is made by `sample`, `Ensemble.from_samples` or `Ensemble.from_indices`"
        )

    @classmethod
    def from_samples(cls, samples: ArrayLike, *, centre: Centre | None = None) -> Ensemble:
        """Make an ensemble from dense realizations.

        Parameters
        ----------
        samples : array_like, shape (N, n) or (N, n, m)
            ``samples[s]`` is realization s of a vector or a matrix. Copied.
        centre : {"truth", "estimate"}, optional
            What the realizations scatter about, as in `SystemEnsemble`: bounds refuse "estimate".

        Returns
        -------
        Ensemble
            Dense realizations; it has no `indices`, `atoms` and `counts`.

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
        values = validation.array("samples", samples, ndim=(2, 3))
        running.need("a copy of the samples", values.nbytes)
        if centre is not None:
            validation.choice("centre", centre, CENTRES)
        return cls._made(samples=validation.frozen(values), shape=values.shape[1:], centre=centre)

    @classmethod
    def from_indices(
        cls, indices: ArrayLike, target: ArrayLike, *, axis: Axis = "columns"
    ) -> Ensemble:
        """Make an ensemble of singleton realizations from their indices.

        Parameters
        ----------
        indices : array_like of int, shape (N,) or (N, lines)
            ``indices[s, j]`` is the entry that realization s hits in line j.
        target : array_like, shape (n,) or (n, m)
            The vector or matrix that gives the 1-norms and signs.
        axis : {"columns", "rows"}, default "columns"
            Whether the lines of a matrix are its columns or its rows.

        Returns
        -------
        Ensemble
            N singleton realizations, without a key.

        Raises
        ------
        InputError, InputTypeError
            If an index is not one of an entry of the target.

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.Ensemble.from_indices([0, 0, 1], [3.0, -4.0]).dense()
        array([[ 7.,  0.],
               [ 7.,  0.],
               [ 0., -7.]])
        """
        axis = validation.choice("axis", axis, AXES)
        values = validation.array("target", target, ndim=(1, 2))
        lines = to_lines(values, axis)
        draws = _core.Draws.from_indices(lines, _checked_indices(indices, lines.shape))
        return cls._made(_draws=draws, shape=values.shape, axis=axis)

    @property
    def size(self) -> int:
        """Number of realizations N."""
        return self._draws.size if self._draws is not None else len(self._dense())

    @property
    def is_singleton(self) -> bool:
        """Whether the realizations are singletons, with one nonzero entry per line."""
        return self._draws is not None

    @property
    def law(self) -> Law | None:
        """The law of the realizations; None if they were not drawn here."""
        values = self._values()
        if values is None or self.scheme is None:
            return None
        return trusted(Law, values, self.axis, self.scheme)

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
        return from_lines(self._draws.atoms(), self.shape, self.axis)

    @property
    def nbytes(self) -> int:
        """Memory of the realizations [bytes]."""
        return self._draws.nbytes if self._draws is not None else self._dense().nbytes

    def counts(self) -> NDArray[np.int64]:
        """Count how many realizations hit each entry.

        Returns
        -------
        ndarray of int64
            In the shape of a realization. The sum of a line is N, or 0 for a zero line.

        Raises
        ------
        InputTypeError
            If the realizations are not singletons.
        """
        if self._draws is None:
            raise InputTypeError("counts() needs singleton realizations, got dense ones")
        counts = self._draws.counts()
        # not as a product: NumPy's buffered loops, which mix types, crash if memory runs out
        counts[self._draws.gamma() == 0.0] = 0
        return from_lines(counts, self.shape, self.axis)

    def dense(self) -> Floats:
        """Return all realizations as one dense array.

        Returns
        -------
        ndarray, shape (N, n) or (N, n, m)
            ``dense[s]`` is realization s.

        Raises
        ------
        ResourceError
            If the array does not fit into the memory this process may use.
        """
        if self._draws is not None:
            return dense(self._draws, self.shape, self.axis)
        running.need("the dense realizations", self._dense().nbytes)
        return self._dense().copy()

    def prefix(self, size: int) -> Ensemble:
        """Return the first realizations; the memory is shared.

        Parameters
        ----------
        size : int
            Number of realizations, from 1 to N.

        Returns
        -------
        Ensemble
            Of an iid sample: the sample of this size with the same key. A part of a systematic
            sample is not a systematic sample, so it has no key and no scheme.
        """
        count = validation.size("size", size, maximum=self.size)
        if self._draws is None:
            return self._like(samples=self._dense()[:count])
        part = self._like(_draws=self._draws.prefix(count))
        cut = self.scheme == "systematic" and count < self.size
        return part._like(scheme=None, key=None, centre=None) if cut else part

    def combine(self, weights: ArrayLike) -> Floats:
        """Compute ``sum_s weights[s] E_s``.

        Parameters
        ----------
        weights : array_like, shape (N,)
            Finite weights.

        Returns
        -------
        ndarray
            In the shape of a realization.

        Raises
        ------
        ShapeError, NonFiniteError, InputTypeError
            If the weights cannot be used, or the sum overflows.

        Notes
        -----
        The result is an array, and `control` takes an array as exact, so that its bound is, too.
        For an estimate of your own pass a Fit.
        """
        w = validation.vector("weights", weights, length=self.size)
        result: Floats
        if self._draws is not None:
            result = from_lines(self._draws.combine(w), self.shape, self.axis)
        else:
            with np.errstate(over="ignore", invalid="ignore"):
                result = np.tensordot(w, self._dense(), axes=1)
        if not np.isfinite(result).all():
            raise NonFiniteError("the sum with `weights` overflows: scale them down")
        return result

    def mean(self) -> Floats:
        """Compute the uniform average of the realizations.

        Returns
        -------
        ndarray
            In the shape of a realization.
        """
        if self._draws is not None:
            # converted first: NumPy's loops that mix types end the process where memory runs out
            average = self._draws.atoms() * (self._draws.counts().astype(float) / self.size)
            return from_lines(average, self.shape, self.axis)
        samples = self._dense()
        with np.errstate(over="ignore", invalid="ignore"):
            result: Floats = samples.mean(axis=0)
        if not np.isfinite(result).all():  # the sum overflows, the average does not
            result = sum((row / self.size for row in samples), np.zeros(self.shape))
        return result

    def __reduce__(self) -> tuple[Any, ...]:
        drawn = self.indices, self._values(), self.axis, self.scheme, self.key
        return _rebuilt, (*drawn, self.samples, self.centre)

    def _repr_html_(self) -> str:
        nonzero = "any"
        if self.is_singleton:
            nonzero = "one" if len(self.shape) == 1 else f"one in each of the {self.axis}"
        rows = [
            ("realizations N", show.grouped(self.size)),
            ("shape of each", show.shape(self.shape)),
            ("nonzero entries", nonzero),
            ("scheme", self.scheme or "not drawn here"),
        ]
        return show.card(self, rows)

    def __repr__(self) -> str:
        kind = "dense"
        if self.is_singleton:
            lines = "" if len(self.shape) == 1 else f"{self.axis}, "
            kind = f"singleton ({lines}{self.scheme or 'given indices'})"
        return f"<Ensemble: {self.size} {kind} realizations of shape {self.shape}>"

    @classmethod
    def _made(cls, **values: Any) -> Ensemble:
        made = object.__new__(cls)
        made._keep(**{**_UNKNOWN, **values})
        return made

    def _like(self, **changed: Any) -> Ensemble:
        """The same but for these fields."""
        return self._made(**{**vars(self), **changed})

    def __len__(self) -> int:
        return self.size

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Ensemble):
            return NotImplemented
        mine, its = ((one.shape, one.size, one.is_singleton) for one in (self, other))
        if mine != its:
            return False
        if self._draws is None or other._draws is None:
            return np.array_equal(self._dense(), other._dense())
        return (
            (len(self.shape) == 1 or self.axis == other.axis)
            and np.array_equal(self._draws.atoms(), other._draws.atoms())
            and np.array_equal(self._draws.indices(), other._draws.indices())
        )

    __hash__ = None  # as for arrays

    def _dense_blocks(self, rows: int) -> Iterator[Floats]:
        """Return the dense realizations, `rows` at a time."""
        if self._draws is not None:
            return dense_blocks(self._draws, self.shape, self.axis, rows)
        samples = self._dense()
        return (samples[first : first + rows] for first in range(0, self.size, rows))

    def _values(self) -> Floats | None:
        """Return a copy of the vector or matrix that gives the 1-norms and signs of singletons."""
        if self._draws is None:
            return None
        return from_lines(self._draws.values(), self.shape, self.axis)

    def _dense(self) -> Floats:
        assert self.samples is not None
        return self.samples

    def _lines_of(self, values: Floats) -> Floats:
        """Return a target in the layout of the core (for dense realizations: one row)."""
        return to_lines(values, self.axis) if self._draws is not None else values.reshape(1, -1)

    def _from_core(self, values: Floats) -> Floats:
        """Undo `_lines_of`."""
        if self._draws is not None:
            return from_lines(values, self.shape, self.axis)
        return values.reshape(self.shape)

    def _stack_from_core(self, values: Floats) -> Floats:
        """Undo `_lines_of` for every row of (k, entries)."""
        if self._draws is not None:
            return stack_from_lines(values, self.shape, self.axis)
        return values.reshape(-1, *self.shape)

    def _core_realizations(self) -> _core.Draws | Floats:
        """Return the realizations as the core takes them."""
        return self._draws if self._draws is not None else self._dense().reshape(self.size, -1)


_UNKNOWN: dict[str, Any] = {
    **dict.fromkeys(("_draws", "samples", "scheme", "key", "centre")),
    "axis": "columns",
}


def _checked_indices(indices: ArrayLike, lines: tuple[int, ...]) -> NDArray[np.uint32]:
    """Return indices (N, lines) into lines of this shape (lines, length)."""
    number, length = lines
    given = validation.read("indices", indices)
    given = given.reshape(-1, 1) if given.ndim == 1 else given
    if given.size == 0 or given.ndim != 2 or given.shape[1] != number:
        raise ShapeError(f"`indices` must have shape (N, {number}), got {np.shape(indices)}")
    if given.dtype.kind not in "ui":
        raise InputTypeError(f"`indices` must be integers, got dtype {given.dtype}")
    if given.min() < 0 or given.max() >= length:
        raise InputError(f"`indices` must lie in [0, {length})")
    return np.ascontiguousarray(given, dtype=np.uint32)
