"""`Regressors`: what a model of readings is made of, and the system that follows from it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _core
from .._base import running, show, validation
from .._base.names import Labels
from .._base.records import Count, Index, Record, cached_property, trusted
from .._base.types import ArrayLike, Floats
from ..data.trajectories import Trajectories, in_order
from ..exceptions import InputError

FASTER = "a smaller pole, or Window(lags='auto')"


class Stretch(NamedTuple):
    """A record that fills a window, the inputs behind it, and the readings from its end on."""

    record: tuple[Floats, Floats]
    inputs: Floats
    readings: Floats


class Loop(NamedTuple):
    """``z = J (x; u; 1)``, ``x+ = [A B c] (x; u; 1) + G w``; c only with an intercept."""

    J: Floats
    ABc: Floats
    G: Floats


class Regressors(Record, eq=True):
    """Past readings and inputs from which a model predicts the next readings.

    Attributes
    ----------
    outputs, inputs : tuple of str
        What is read, or the states, and what is put in.
    count : int
        The number of lags p, or of filters r.
    pole : float or None
        That of the filters; None for lags.
    delay : int
        After how many steps an input acts.
    intercept : bool
        Whether there is a 1 among the regressors.
    burn : int
        How many rows fill the filters at the start of each piece; lags are filled by count - 1.
    found : int or None
        The count that the first part of the data asked for, before it was made longer; None where
        the window was declared.

    Notes
    -----
    The regressors are ``z = (y_t, .., y_{t-p+1}, u_{t-D}, .., u_{t-D-p+1}, [1])``, or the filters
    ``(xi^1, .., xi^r)`` of the outputs and then of the inputs, with ``xi^1_t = a xi^1_{t-1} +
    (1 - a) s_t`` and ``xi^j_t = a xi^j_{t-1} + (1 - a) xi^{j-1}_{t-1}``, all begun at the first
    reading of their piece.

    Examples
    --------
    >>> import stochens_rs as se
    >>> window = se.identification.Regressors(("pos",), ("force",), 3, 0.8)
    >>> window, window.length
    (<Regressors: 3 filters of pole 0.8 of 1 output and 1 input>, 6)
    """

    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    count: Count
    pole: float | None = None
    delay: Index = 0
    intercept: bool = False
    burn: Index = 0
    found: int | None = None

    def _check(self) -> None:
        if self.pole is not None:
            validation.positive("pole", self.pole, maximum=1.0)
        _ = self.core  # refuses sizes and poles

    @cached_property
    def core(self) -> _core.Window:
        """The window of the core."""
        sizes = len(self.outputs), len(self.inputs), self.count
        return _core.Window(*sizes, self.pole, self.delay, self.intercept, self.burn)

    @property
    def length(self) -> int:
        """The number d of regressors z, the unknowns of each output."""
        return self.core.length

    @property
    def fill(self) -> int:
        """How many pairs at the start of each piece only fill the window."""
        return self.core.fill

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """The names of the states x of the model: what the window holds from step to step."""
        lags = self.pole is None
        acting = self._entries(self.inputs, 1, self.count + self.delay - 1 if lags else self.count)
        queue = (
            () if lags else (f"{u}(-{k})" for k in range(1, self.delay + 1) for u in self.inputs)
        )
        return (*self._entries(self.outputs, 0, self.count), *acting, *queue)

    @cached_property
    def regressor_names(self) -> tuple[str, ...]:
        """The names of the entries of z."""
        acting = self._entries(self.inputs, self.delay, self.count)
        one = ("1" for _ in range(self.intercept))
        return (*self._entries(self.outputs, 0, self.count), *acting, *one)

    def _entries(self, names: tuple[str, ...], back: int, count: int) -> tuple[str, ...]:
        """The names of lags from this one on, or of filters."""
        if self.pole is not None:
            return tuple(f"{name}~{j}" for j in range(1, count + 1) for name in names)
        lags = range(back, back + count)
        return tuple(f"{name}(-{k})" if k else name for k in lags for name in names)

    @property
    def text(self) -> str:
        """The window in words, as ``6 filters of pole 0.8``."""
        delay = f", delay {self.delay}" if self.delay else ""
        if self.pole is None:
            return show.number_of(self.count, "lag") + delay
        return f"{show.number_of(self.count, 'filter')} of pole {self.pole:g}{delay}"

    @property
    def words(self) -> dict[str, str]:
        """The words of messages about a window that is too short, or to be declared."""
        what, pole = "lags" if self.pole is None else "filters", self.pole
        return {
            "what": what,
            "next": f"{self.count + 1} {what}",
            "own": str(self.count),
            "take": "take " if self.found is not None else "leave `window` out, take ",
            "faster": f"{FASTER}, " if pole else "",
            "slow": f"; or filters of pole {pole:g} are too slow: take {FASTER}" if pole else "",
        }

    def loop(self, Theta: Floats) -> Loop:
        """Return the linear system of the contents of the window.

        Parameters
        ----------
        Theta : ndarray, shape (n_y, d)
            The coefficients of the regressors.

        Returns
        -------
        J, ABc, G : ndarray, shapes (d, n + m), (n, n + m), (n, n_y)
            ``z = J (x; u)``, ``x+ = [A B] (x; u) + G w``; with intercept one more column each, for
            1 behind u.

        Raises
        ------
        InputError, InputTypeError
            If `Theta` has another shape or is no matrix of finite numbers.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> window = se.identification.Regressors(("y",), ("u",), 1)
        >>> window.loop(np.array([[0.5, 1.0]])).ABc
        array([[0.5, 1. ]])
        """
        rows = len(self.outputs)
        given = validation.matrix("Theta", Theta, rows=rows, cols=self.length)
        return Loop(*self.core.linear(given))

    def stretches(self, data: Trajectories, steps: int) -> list[Stretch]:
        """Cut runs that were kept apart into arguments of `predict` and the readings that followed.

        Parameters
        ----------
        data : Trajectories
            Runs of the same outputs and inputs, in any order of their names.
        steps : int
            How many steps ahead are to be predicted.

        Returns
        -------
        list of (record, inputs, readings)
            In each piece one stretch after another, the first as soon as its record fills the
            window. The record has all rows of the piece up to then, `inputs` (K, m) are those that
            followed, and `readings` (K + 1, n_y) begin with the last row of the record.

        Raises
        ------
        InputError, InputTypeError
            If the names differ, or no piece is long enough.

        Examples
        --------
        >>> import numpy as np, stochens_rs as se
        >>> data = se.Trajectories([np.zeros((9, 1))], [np.ones((8, 1))], outputs=True)
        >>> window = se.identification.Regressors(data.outputs, data.input_names, 2)
        >>> [len(record[0]) for record, inputs, readings in window.stretches(data, 3)]
        [2, 5]
        """
        K, names = validation.size("steps", steps), Labels(self.outputs, self.inputs)
        read = validation.instance("data", data, Trajectories)
        pairs, found, begun = in_order("data", read, names), [], 0
        for length in read.pieces:
            x, u, after = (one[begun : begun + length] for one in pairs)
            begun += length
            y = np.vstack([x, after[-1:]])
            for t in range(self.fill, length - K + 1, K):
                record = y[: t + 1], u[:t]
                found.append(Stretch(record, u[t : t + K], y[t : t + K + 1]))
        if not found:
            raise InputError(
                f"`data` must have a piece of {self.fill + K} pairs, {self.fill} to fill the "
                f"window and {K} to predict, the longest has {int(read.pieces.max())}"
            )
        return found

    @property
    def long(self) -> tuple[str, ...]:
        """The advice where the region of a window that the data chose is too large."""
        if self.found is None:
            return ()
        few = self.found if self.pole is None else (self.pole, self.found)
        return (
            f"the data chose the window of {self.text}: a shorter one, declared beforehand (as "
            f"Window({self.words['what']}={few})), has a smaller region",
        )

    def state_of(self, outputs: ArrayLike, inputs: ArrayLike) -> Floats:
        """Return the state of the model at the last reading of a record that really happened.

        Parameters
        ----------
        outputs : array_like, shape (T, n_y)
            Readings in a row, without a gap.
        inputs : array_like, shape (T - 1, m)
            The inputs between them.

        Returns
        -------
        ndarray, shape (n,)

        Raises
        ------
        InputError, InputTypeError
            If they are too few to fill the window, or do not fit together.

        Examples
        --------
        >>> import stochens_rs as se
        >>> window = se.identification.Regressors(("y",), ("u",), 2)
        >>> window.state_of([[1.0], [2.0]], [[0.5]])
        array([2. , 1. , 0.5])
        """
        y = validation.matrix("outputs", outputs, cols=len(self.outputs))
        given, m = validation.read("inputs", inputs), len(self.inputs)
        u = validation.matrix("inputs", given, cols=m) if given.size else np.zeros((0, m))
        if len(y) <= self.fill or len(u) != len(y) - 1:
            raise InputError(
                f"`record` needs {self.fill + 1} rows of outputs and {self.fill} of inputs that "
                f"were measured, got {len(y)} and {len(u)}; a single reading does not fix the "
                f"velocities; in Python data.last_record({self.fill + 1}) is the last piece of a "
                "log that has them"
            )
        return self.core.state_of(y, np.ascontiguousarray(u))

    def __repr__(self) -> str:
        of = show.number_of(len(self.outputs), "output"), show.number_of(len(self.inputs), "input")
        return f"<Regressors: {self.text} of {of[0]} and {of[1]}>"


def of_names(states: tuple[str, ...], inputs: tuple[str, ...], intercept: bool) -> Regressors:
    """The window of one lag: states say all of the past."""
    return trusted(Regressors, states, inputs, 1, None, 0, intercept)


def assumed(window: Regressors, tail: float) -> str:
    """What the region of a model with this window assumes, behind the law of the noise."""
    chosen = "" if window.found is None else ", chosen by the first part,"
    but = f" but for a tail of {tail:g}" if tail else ""
    return (
        "; white innovations; inputs from logged signals only; "
        f"the window of {window.text}{chosen} taken as exact{but}, which no data prove"
    )


def regressors_of(found: _core.Identified, data: Trajectories, intercept: bool) -> Regressors:
    """The window that the core made, or chose, of these readings."""
    own, names = found.window, (data.state_names, data.input_names)
    burn, count = 0 if own.pole is None else own.fill - own.delay, own.count
    return trusted(Regressors, *names, count, own.pole, own.delay, intercept, burn, found.found)


def rows_of(window: Regressors, data: Trajectories, first: int = 0) -> tuple[Floats, Floats]:
    """The rows (z, y one step later) of complete windows: before pair `first`, and after."""
    if (window.count, window.pole, window.delay, window.intercept) == (1, None, 0, False):
        return data.rows[:first], data.rows[first:]  # as they are
    running.need("the pairs", 8 * data.size * (window.length + data.n))
    return window.core.rows(data.rows, data.layout, first)


def spread(window: Regressors, sizes: Floats | None) -> Floats | None:
    """The sizes of z from those of outputs and inputs, and 1."""
    if sizes is None:
        return None
    y, u, one = np.split(sizes, np.cumsum([len(window.outputs), len(window.inputs)]))
    return np.concatenate([np.tile(y, window.count), np.tile(u, window.count), one])
