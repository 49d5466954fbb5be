"""Parts of measured runs: their pairs, the last ones, the first steps, some of the runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, overload

import numpy as np

from .._base import gate, html, memory
from ..exceptions import InputError
from ..rng import RngLike, as_key
from .runs import Runs

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from typing_extensions import Self

    from .._base.types import Floats


class Selecting(Runs):
    """What `Trajectories` make of their runs."""

    __slots__ = ()

    def pairs(self) -> tuple[Floats, Floats, Floats]:
        """Return all pairs of all runs.

        Returns
        -------
        x, u, x_next : ndarray, shapes (N, n), (N, m), (N, n)
            Read-only. Row t: the state, the input, and the next state.

        Examples
        --------
        >>> import stochens_rs as se
        >>> data = se.Trajectories([[0.0], [1.0], [1.5]], [[1.0], [1.0]])
        >>> data.pairs()[0].ravel()
        array([0., 1.])
        """
        n = self._n
        return self._rows[:, :n], self._rows[:, n:-n], self._rows[:, -n:]

    def last_pairs(self) -> Self:
        """Keep only the last pair of each run.

        Returns
        -------
        Trajectories
            As many pairs as runs. They may be identified with ``design="independent"``, also
            where the runs had feedback, if the runs are independent of each other and their
            lengths were chosen without a look at the last state.

        Examples
        --------
        >>> import stochens_rs as se
        >>> states, inputs = [[[0.0], [1.0], [1.5]], [[1.0], [0.5]]], [[[1.0], [1.0]], [[0.0]]]
        >>> data = se.Trajectories(states, inputs)
        >>> data.last_pairs()
        <Trajectories: 2 pairs, n=1 m=1>
        """
        rows = self._rows[np.cumsum(self._lengths) - 1]
        return self._part(rows, np.ones(len(rows), dtype=np.int64))

    def k_step(self, steps: int, *, open_loop: bool) -> Self:
        """Take the first K steps of each run as one step: ``(x(0), u(0), ..., u(K-1)) -> x(K)``.

        Parameters
        ----------
        steps : int
            The number of steps K. Shorter runs are left out.
        open_loop : bool
            Your declaration that the inputs were independent of the noise of all runs: chosen
            beforehand or drawn apart. With feedback no region holds, so False is refused.

        Returns
        -------
        Trajectories
            Pairs with ``K m`` inputs. `identify` makes of them the matrices ``A^K`` and
            ``[A^{K-1} B, ..., A B, B]``; with ``design="independent"`` if the runs are independent
            of each other.

        Raises
        ------
        InputError, InputTypeError
            If no run has K steps, or the inputs are not declared to be open loop.

        Examples
        --------
        >>> import stochens_rs as se
        >>> states, inputs = [[[0.0], [1.0], [1.5]], [[1.0], [0.5]]], [[[1.0], [1.0]], [[0.0]]]
        >>> data = se.Trajectories(states, inputs)
        >>> data.k_step(2, open_loop=True).pairs()
        (array([[0.]]), array([[1., 1.]]), array([[1.5]]))
        """
        K = gate.size("steps", steps)
        if not gate.flag("open_loop", open_loop):
            raise InputError(
                "`open_loop` must be True: inputs that react to the noise inside a run break "
                "every region over several steps; with feedback use last_pairs()"
            )
        n = self._n
        enough = self._lengths >= K
        if not enough.any():
            raise InputError(
                f"`steps` is {K}, but the longest run has {html.counted(int(self._lengths.max()))}"
            )
        start = (np.cumsum(self._lengths) - self._lengths)[enough]
        acting = [self._rows[start + k, n:-n] for k in range(K)]
        rows = np.hstack([self._rows[start, :n], *acting, self._rows[start + K - 1, -n:]])
        names = [f"{name}({k})" for k in range(K) for name in self._input_names]
        return self._of(
            rows,
            np.ones(len(rows), dtype=np.int64),
            n,
            None if self._dt is None else K * self._dt,
            self._state_names,
            names if K > 1 else self._input_names,
            K * self._steps,
        )

    def split(self, share: float, *, rng: RngLike = None) -> tuple[Self, Self]:
        """Divide the runs at random into two parts; no run is cut.

        Parameters
        ----------
        share : float or int
            The share of the runs in the first part, in (0, 1); or their number, a whole number
            from 1.
        rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
            Source of randomness. For parts that are not random take slices: ``data[:20]``.

        Returns
        -------
        first, second : Trajectories
            Each with at least one run, in their order here.

        Raises
        ------
        InputError, InputTypeError
            If there is one run only, or one part would have none.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> data = se.Trajectories.from_pairs(np.eye(4), np.ones((4, 1)), np.eye(4))
        >>> data.split(0.75, rng=1)
        (<Trajectories: 3 pairs, n=4 m=1>, <Trajectories: 1 pair, n=4 m=1>)
        """
        runs = len(self)
        whole = isinstance(share, (int, np.integer)) and not isinstance(share, bool)
        if whole:
            count = gate.size("share", share, maximum=max(runs - 1, 1))
        else:
            count = round(gate.probability("share", share) * runs)
        if not 0 < count < runs:
            raise InputError(f"`share` must leave a run for each part, got {share} of {runs}")
        first = np.zeros(runs, dtype=bool)
        first[as_key(rng).child("split").generator().permutation(runs)[:count]] = True
        return self._chosen(first), self._chosen(~first)

    def _chosen(self, runs: NDArray[np.bool_]) -> Self:
        return self._part(self._rows[np.repeat(runs, self._lengths)], self._lengths[runs])

    def _thinned(self) -> Self:
        """Every second pair of each run, as pairs."""
        rows = self._rows[self._places() % 2 == 0]
        return self._part(rows, np.ones(len(rows), dtype=np.int64))

    def past_inputs(self, lags: int) -> Floats:
        """Return the present and past inputs of every pair, as instruments for `identify`.

        Parameters
        ----------
        lags : int
            How many steps back, at least 0.

        Returns
        -------
        ndarray, shape (N, (lags + 1) m)
            ``u(k), u(k - 1), ..., u(k - lags)``, 0 before the start of a run. They are instruments
            only if the inputs are independent of the noise of states and readings: open loop.

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.Trajectories([[0.0], [1.0], [1.5]], [[1.0], [2.0]]).past_inputs(1)
        array([[1., 0.],
               [2., 1.]])
        """
        lags = gate.size("lags", lags, minimum=0, maximum=int(self._lengths.max()))
        memory.need("the past inputs", 2 * 8 * (lags + 1) * self.size * self.m)
        u, places = self._rows[:, self._n : -self._n], self._places()
        back = [
            np.where((places >= lag)[:, None], np.roll(u, lag, axis=0), 0.0)
            for lag in range(lags + 1)
        ]
        return np.hstack(back)

    @overload
    def __getitem__(self, runs: int) -> tuple[Floats, Floats]: ...
    @overload
    def __getitem__(self, runs: slice) -> Self: ...
    def __getitem__(self, runs: int | slice) -> Self | tuple[Floats, Floats]:
        """One run as (states, inputs), or the runs of a slice."""
        if not isinstance(runs, slice):
            index = gate.size("run", runs, minimum=-len(self), maximum=len(self) - 1) % len(self)
            return self[index : index + 1].runs[0]
        chosen = np.zeros(len(self), dtype=bool)
        chosen[runs] = True
        if not chosen.any() or (runs.step or 1) < 0:
            raise InputError("the slice must name at least one run, in their order")
        return self._chosen(chosen)
