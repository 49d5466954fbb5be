"""Draw realizations of vectors and matrices, or only the counts of realizations."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .. import _core
from .._base import running, validation
from .._base.running import get_num_threads
from .._base.types import AXES, SCHEMES, Axis, Floats, Scheme
from ..rng import RngLike, as_key
from .ensemble import Ensemble
from .law import Counts, Law, from_lines, to_lines


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
