"""`Ensemble`: realizations of a vector or matrix, drawn by `sample` or passed by the user.

A singleton realization of a vector ``w`` has one nonzero entry: index ``I`` is drawn with
probability ``|w_i| / g``, ``g = ||w||_1``, and the realization is ``g sign(w_I) e_I``, with mean
``w`` (paper, Lemma 4.1). The columns (or rows) of a matrix are drawn independently of each other.
Only the indices are stored.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from .. import _core
from .._base import running, validation
from .._base.records import Count, Dense, Record, SavedRecord, require_shapes, trusted
from .._base.running import get_num_threads
from .._base.types import AXES, CENTRES, SCHEMES, ArrayLike, Axis, Centre, Floats, NDArray, Scheme
from ..exceptions import InputError, InputTypeError, NonFiniteError, ShapeError
from ..rng import Key, RngLike, as_key


class Law(Record):
    """The distribution of realizations.

    Attributes
    ----------
    values : ndarray, shape (n,) or (n, m)
        The mean of the realizations.
    axis : {"columns", "rows"}
        Which lines of a matrix are drawn independently.
    scheme : {"iid", "systematic"}
        As in `sample`.
    """

    values: Dense
    axis: Axis
    scheme: Scheme


def to_lines(values: Floats, axis: Axis) -> Floats:
    """Return a vector as one row, a matrix with its lines as rows."""
    if values.ndim == 1:
        return values.reshape(1, -1)
    return np.ascontiguousarray(values.T) if axis == "columns" else values


def from_lines(values: NDArray[Any], shape: tuple[int, ...], axis: Axis) -> NDArray[Any]:
    """Undo `to_lines`."""
    found: NDArray[Any] = stack_from_lines(values, shape, axis)[0]
    return found


def stack_from_lines(values: NDArray[Any], shape: tuple[int, ...], axis: Axis) -> NDArray[Any]:
    """Undo `to_lines` for every row of (k, entries)."""
    if len(shape) == 1 or axis == "rows":
        return values.reshape(-1, *shape)
    return np.ascontiguousarray(values.reshape(-1, shape[1], shape[0]).transpose(0, 2, 1))


_BLOCK = 2**20  # entries written at a time, 8 MiB; between two blocks Ctrl-C is handled


def dense_blocks(
    draws: _core.Draws, shape: tuple[int, ...], axis: Axis, rows: int
) -> Iterator[Floats]:
    """Yield `rows` realizations at a time, each block of shape (rows, *shape)."""
    for first in range(0, draws.size, rows):
        index = draws.indices()[first : first + rows].astype(np.intp)
        atoms = draws.atoms()
        out = np.zeros((len(index), *atoms.shape))
        s, j = np.arange(len(index))[:, None], np.arange(len(atoms))[None, :]
        out[s, j, index] = atoms[j, index]
        yield stack_from_lines(out.reshape(len(index), -1), shape, axis)


def dense(draws: _core.Draws, shape: tuple[int, ...], axis: Axis) -> Floats:
    """Return all realizations, shape (N, *shape)."""
    entries = int(np.prod(shape))
    rows = max(1, _BLOCK // entries)
    # the result, and four arrays of the size of a block
    largest = min(rows, draws.size) * entries
    running.need("the dense realizations", (draws.size * entries + 4 * largest) * 8)
    out = np.empty((draws.size, *shape))
    first = 0
    for block in dense_blocks(draws, shape, axis, rows):
        out[first : first + len(block)] = block
        first += len(block)
    return out


class Counts(SavedRecord):
    """How many of N realizations hit each entry.

    Attributes
    ----------
    counts : ndarray of int64, shape (n,) or (n, m)
        ``counts[i, j]``: how many realizations hit entry (i, j); 0 in a zero line.
    estimate : ndarray, same shape
        The uniform average ``g_j sign(A_ij) counts[i, j] / N``.
    size : int
        Number of realizations N.
    key : Key
        The key to repeat the draw.
    law : Law or None
        The law of the realizations; None if unknown.
    """

    counts: NDArray[np.int64]
    estimate: Floats
    size: Count
    key: Key
    law: Law | None = None

    def _check(self) -> None:
        validation.kept("estimate", self.estimate, shape=self.counts.shape)
        if self.counts.min() < 0:
            raise InputError(f"`counts` must be >= 0, got {self.counts.min()}")
        law = self.law
        if law is None:
            return
        require_shapes(law, values=self.shape)
        along = 1 if law.axis == "rows" and law.values.ndim == 2 else 0
        # Sums up to 2^53 are exact. Converted in one step: NumPy's buffered loops, which mix
        # types, crash if memory runs out.
        hits = self.counts.astype(np.float64).sum(axis=along)
        expected = np.where(law.values.any(axis=along), float(self.size), 0.0)
        outside = (law.values == 0.0) & (self.counts != 0)
        if (hits != expected).any() or outside.any():
            raise InputError(f"`counts` must add up to {self.size} in every nonzero line")

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the vector or matrix."""
        return self.counts.shape


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
        raise InputTypeError("an Ensemble is made by `sample`, `from_samples` or `from_indices`")

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

        Examples
        --------
        >>> import stochens_rs as se
        >>> int(se.sample([3.0, 0.0, -1.0], 50, rng=1).counts().sum())
        50
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

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.sample([3.0, 0.0, -1.0], 50, rng=1).dense().shape
        (50, 3)
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

        Raises
        ------
        InputError, InputTypeError
            If `size` is no number from 1 to N.

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.sample([3.0, 1.0], 50, rng=1).prefix(20) == se.sample([3.0, 1.0], 20, rng=1)
        True
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

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.Ensemble.from_samples([[1.0, 2.0], [3.0, 4.0]]).combine([0.25, 0.75])
        array([2.5, 3.5])
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

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.Ensemble.from_samples([[1.0, 2.0], [3.0, 4.0]]).mean()
        array([2., 3.])
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

    def _values(self) -> Floats | None:
        """Return a copy of the vector or matrix that gives the 1-norms and signs of singletons."""
        if self._draws is None:
            return None
        return from_lines(self._draws.values(), self.shape, self.axis)

    def _dense(self) -> Floats:
        assert self.samples is not None
        return self.samples


_UNKNOWN: dict[str, Any] = {
    **dict.fromkeys(("_draws", "samples", "scheme", "key", "centre")),
    "axis": "columns",
}


def core_of(ensemble: Ensemble) -> _core.Draws | Floats:
    """The realizations as the core takes them: draws, or dense ones as rows."""
    if ensemble._draws is not None:
        return ensemble._draws
    return ensemble._dense().reshape(ensemble.size, -1)


def lines_of(ensemble: Ensemble, values: Floats) -> Floats:
    """A vector or matrix of the shape of a realization as the core takes it."""
    return to_lines(values, ensemble.axis) if ensemble.is_singleton else values.reshape(1, -1)


def from_core(ensemble: Ensemble, values: Floats, stack: bool = False) -> Floats:
    """Undo `lines_of`; of a stack, whose first axis counts."""
    axis: Axis = ensemble.axis if ensemble.is_singleton else "rows"
    found = stack_from_lines(values, ensemble.shape, axis)
    return found if stack else found[0]


def blocks_of(ensemble: Ensemble, rows: int) -> Iterator[Floats]:
    """The dense realizations, so many at a time."""
    if ensemble._draws is not None:
        return dense_blocks(ensemble._draws, ensemble.shape, ensemble.axis, rows)
    samples = ensemble._dense()
    return (samples[first : first + rows] for first in range(0, len(samples), rows))


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


def sample(
    target: ArrayLike,
    size: int,
    *,
    rng: RngLike = None,
    scheme: Scheme = "iid",
    axis: Axis = "columns",
) -> Ensemble:
    """Draw singleton realizations with a given mean.

    Parameters
    ----------
    target : array_like, shape (n,) or (n, m)
        The mean of the realizations: a vector ``w`` or a matrix ``A``.
    size : int
        Number of realizations N, at least 1.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness; its key is kept as ``.key``. Two calls with the same integer have
        the same draws: use a Generator, or ``key.child(name)``, for independent ensembles.
    scheme : {"iid", "systematic"}, default "iid"
        "iid": independent realizations; the first k of N are those of a sample of size k.
        "systematic": one random offset per line, so that entry i is hit ``floor(N p_i)`` or
        ``ceil(N p_i)`` times, in random order. The mean-square error of the average is at most
        ``g^2 n / (4 N^2)`` per line instead of ``(g^2 - ||w||^2) / N``. The realizations are
        unbiased but dependent, so the mean-square bound of SLSE and tail bounds do not hold.
    axis : {"columns", "rows"}, default "columns"
        Whether the columns or the rows of a matrix are drawn independently of each other.

    Returns
    -------
    Ensemble
        N realizations, stored as ``N * lines`` indices of 1, 2 or 4 bytes.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    ResourceError
        If the indices do not fit into the memory this process may use.

    Notes
    -----
    ``E[s] = w`` and ``Cov(s) = g diag|w| - w w^T`` (Lemma 4.1, where the printed mean of the *sum*
    is ``w``: a factor 1/N is missing). A zero vector or line has zero realizations. Draw i of line
    j depends on (key, j, i) only, with any number of threads.

    *Resolution.* With n entries in a line, probabilities are integers over
    ``T = 2^(32 + ceil(log2 n))``, within ``1 / T`` of ``|w_i| / g`` (plus the rounding of running
    sums), so the mean is within ``g / T`` of w in every entry. Zero entries are never drawn, and
    entries below ``g / T`` possibly neither. For "systematic", ``T = 2^53``; `sample_counts` has
    no such limit, and above about 100 n realizations counts are faster.

    Examples
    --------
    >>> import stochens_rs as se
    >>> ensemble = se.sample([3.0, -1.0, 0.0, 2.0], 1000, rng=1)
    >>> ensemble.size, ensemble.shape, ensemble.gamma
    (1000, (4,), 6.0)
    >>> int(ensemble.counts()[2])
    0
    """
    values, count = _checked(target, size, scheme, axis)
    lines = to_lines(values, axis)
    number, length = lines.shape
    width = 1 if length <= 2**8 else 2 if length <= 2**16 else 4  # bytes of an index
    table = 8 << (length - 1).bit_length()  # bytes of the table of a line, a power of two of cells
    # the indices, the law with its atoms, one table per line, and five to build one
    needed = count * number * width + 4 * lines.nbytes + (number + 5) * table
    running.need(f"a sample of {count} realizations", needed)
    key = as_key(rng)
    draws = _core.Draws.sample(lines, count, scheme, bytes(key), get_num_threads())
    known = {"shape": values.shape, "axis": axis, "scheme": scheme, "key": key}
    return Ensemble._made(_draws=draws, centre="truth", **known)


def _checked(target: ArrayLike, size: int, scheme: str, axis: str) -> tuple[Floats, int]:
    """The mean of the realizations, and their number."""
    validation.choice("axis", axis, AXES)
    values = validation.array("target", target, ndim=(1, 2))
    count = validation.size("size", size)
    validation.choice("scheme", scheme, SCHEMES)
    return values, count


def sample_counts(
    target: ArrayLike,
    size: int,
    *,
    rng: RngLike = None,
    scheme: Scheme = "iid",
    axis: Axis = "columns",
) -> Counts:
    """Draw how many realizations hit each entry, without drawing the realizations.

    The cost is O(n m) for any number of realizations. Counts are enough for a uniform average.

    Parameters
    ----------
    target : array_like, shape (n,) or (n, m)
        The mean of the realizations.
    size : int
        Number of realizations N, from 1 to 2^53.
    rng, scheme, axis
        As in `sample`.

    Returns
    -------
    Counts
        The counts and the uniform average.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    ResourceError
        If the counts do not fit into the memory this process may use.

    Notes
    -----
    One multinomial draw per line, by conditional binomials; the probabilities have full double
    precision, however small. For "iid" the counts have the *distribution* of
    ``sample(...).counts()`` (up to the resolution of `sample`) but are other draws; for
    "systematic" they are equal. The same holds for their uniform average and for the control with
    product fusion from counts.

    Counts are faster than `sample` from about 100 realizations per entry of a line.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> w = np.array([3.0, -1.0, 0.0, 2.0])
    >>> counts = se.sample_counts(w, 10**12, rng=1)
    >>> int(counts.counts.sum()) == 10**12, bool(abs(counts.estimate - w).max() < 1e-4)
    (True, True)
    """
    values, count = _checked(target, size, scheme, axis)
    key = as_key(rng)
    lines = to_lines(values, axis)
    hits = _core.sample_counts(lines, count, scheme, bytes(key))
    # converted in one step: NumPy's buffered loops, which mix types, crash if memory runs out
    shares = hits.astype(float) / count
    sums = np.repeat(np.abs(lines).sum(axis=1), lines.shape[1]).reshape(lines.shape)
    atoms = np.copysign(sums, lines)
    return Counts(
        counts=from_lines(hits, values.shape, axis),
        estimate=from_lines(atoms * shares, values.shape, axis),
        size=count,
        key=key,
        law=Law(values.copy(), axis, scheme),
    )
