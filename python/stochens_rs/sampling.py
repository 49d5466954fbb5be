"""Drawing realizations of vectors and matrices, and counts without realizations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import _core, _gate
from ._lines import Axis, checked_target, from_lines, to_lines
from ._threads import get_num_threads
from .ensembles import Counts, Ensemble, Scheme, checked_scheme
from .rng import RngLike, as_key

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


def sample(
    target: ArrayLike,
    size: int,
    *,
    rng: RngLike = None,
    scheme: Scheme = "iid",
    axis: Axis = "columns",
) -> Ensemble:
    """Draw realizations whose mean is a given vector or matrix.

    Parameters
    ----------
    target : array_like, shape (n,) or (n, m)
        The vector ``w`` or matrix ``A`` the realizations average to.
    size : int
        Number of realizations N, at least 1.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness; it becomes a 256-bit key that is kept as ``.key``. Two calls with
        the same integer share their draws: use a Generator, or ``key.child(name)``, for entities
        that must be independent.
    scheme : {"iid", "systematic"}, default "iid"
        "iid": independent realizations; the first k of N are those of a sample of size k.
        "systematic": one random offset per line, so that entry i is hit ``floor(N p_i)`` or
        ``ceil(N p_i)`` times, in random order. Unbiased, with a mean-square error of at most
        ``g^2 n / (4 N^2)`` per line instead of ``(g^2 - ||w||^2) / N``; but the realizations are
        dependent, so results that assume independence (the mean-square bound of SLSE, tail
        bounds) do not apply.
    axis : {"columns", "rows"}, default "columns"
        Which lines of a matrix are drawn independently. Ignored for a vector.

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
    is ``w``: a factor 1/N is missing). A zero vector or zero line gives zero realizations. Draw i
    of a line depends on (key, i) only, for any number of threads.

    Unbiased up to a known resolution: with n entries in a line, probabilities are integers out
    of ``T = 2^(32 + ceil(log2 n))``, each within ``1 / T`` of ``|w_i| / g`` (and the rounding of
    running sums), so the mean is within ``g / T`` of w in every entry. Zero entries are never
    drawn; those below ``g / T`` may never be either. "systematic" has ``T = 2^53``, and
    `sample_counts` no such limit.

    Examples
    --------
    >>> import stochens_rs as se
    >>> ensemble = se.sample([3.0, -1.0, 0.0, 2.0], 1000, rng=1)
    >>> ensemble.size, ensemble.shape, ensemble.gamma
    (1000, (4,), 6.0)
    >>> int(ensemble.counts()[2])
    0
    """
    values, axis = checked_target(target, axis)
    count = _gate.size("size", size)
    scheme = checked_scheme(scheme)
    lines = to_lines(values, axis)
    width = 1 if lines.shape[1] <= 2**8 else 2 if lines.shape[1] <= 2**16 else 4
    # the indices, the law with its atoms, one table per line and the work of building one
    cells = 8 << (lines.shape[1] - 1).bit_length()
    needed = count * lines.shape[0] * width + 4 * lines.nbytes + (lines.shape[0] + 5) * cells
    _gate.memory(f"a sample of {count} realizations", needed)
    key = as_key(rng)
    draws = _core.Draws.sample(lines, count, scheme, bytes(key), get_num_threads())
    return Ensemble._of_draws(draws, values.shape, axis, scheme, key)


def sample_counts(
    target: ArrayLike,
    size: int,
    *,
    rng: RngLike = None,
    scheme: Scheme = "iid",
    axis: Axis = "columns",
) -> Counts:
    """Draw how often each entry is hit, without drawing the realizations.

    Counts are all a uniform average needs, and they cost O(n m) for any number of realizations.

    Parameters
    ----------
    target : array_like, shape (n,) or (n, m)
        The vector or matrix the realizations average to.
    size : int
        Number of realizations N, from 1 to 2^53.
    rng, scheme, axis
        As in `sample`.

    Returns
    -------
    Counts
        The counts, and the uniform average they give.

    Raises
    ------
    InputError, InputTypeError
        If an argument cannot be used; the message names it.
    ResourceError
        If the counts do not fit into the memory this process may use.

    Notes
    -----
    One multinomial draw per line, by conditional binomials, whose probabilities have the digits
    of doubles however small they are: an entry of 1e-18 is hit as often as it should be. For
    "iid" the counts are *equal in distribution* to ``sample(...).counts()`` (but for the
    resolution of `sample`), not equal draw by draw; for "systematic" they are the same counts.
    So is what they are fused to: the uniform average, and the control with product fusion that
    `control` computes from counts of x0, xf and A.

    Nothing chooses between `sample` and `sample_counts` by itself: counts are cheaper from about
    100 realizations per entry of a line on, and the only way beyond what fits into memory.

    Examples
    --------
    >>> import numpy as np, stochens_rs as se
    >>> w = np.array([3.0, -1.0, 0.0, 2.0])
    >>> counts = se.sample_counts(w, 10**12, rng=1)
    >>> int(counts.counts.sum()) == 10**12, bool(abs(counts.estimate - w).max() < 1e-4)
    (True, True)
    """
    values, axis = checked_target(target, axis)
    count = _gate.size("size", size)
    scheme = checked_scheme(scheme)
    key = as_key(rng)
    lines = to_lines(values, axis)
    hits = _core.sample_counts(lines, count, scheme, bytes(key))
    # cast at once: short of memory, NumPy's buffered loops crash
    shares = hits.astype(float) / count
    atoms = np.sign(lines) * np.abs(lines).sum(axis=1, keepdims=True)
    drawn = Counts(
        counts=from_lines(hits, values.shape, axis),
        estimate=from_lines(atoms * shares, values.shape, axis),
        size=count,
        key=key,
    )
    object.__setattr__(drawn, "_law", (values.copy(), axis, scheme))
    return drawn
