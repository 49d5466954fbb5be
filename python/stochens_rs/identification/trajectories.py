"""`Trajectories`: measured runs of a system, x(0), u(0), x(1), u(1), ..., x(T).

All that identification asks of a run are its pairs ((x(k), u(k)), x(k + 1)). They are kept as the
rows (x, u, x_next) of one array, with the number of pairs of each run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._base import gate, memory
from .._base.durable import Durable, nothing_left
from .._base.records import Record
from ..exceptions import InputError, InputTypeError, ShapeError
from .files import Sections, from_runs, to_runs
from .selecting import Selecting
from .tables import read_table

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from .._base.types import Floats


def _rebuild(
    rows: Floats,
    lengths: NDArray[np.int64],
    n: int,
    dt: float | None,
    state_names: tuple[str, ...],
    input_names: tuple[str, ...],
    steps: int,
) -> Trajectories:
    """Make trajectories from their fields, which may come from anywhere."""
    checked, count = gate.matrix("rows", rows).copy(), gate.size("n", n)
    each = np.array([gate.size("lengths", T) for T in np.asarray(lengths).tolist()], dtype=np.int64)
    if checked.shape[1] <= 2 * count or each.sum() != len(checked):
        raise InputTypeError("the fields of these Trajectories do not fit together")
    size = gate.size("steps", steps)
    return Trajectories._of(checked, each, count, dt, state_names, input_names, size)


class Trajectories(Durable, Selecting, Record):
    """Measured runs: the states and inputs of each, one run after another; immutable.

    Parameters
    ----------
    states : array_like, shape (T + 1, n), or a list of them
        ``states[r][k]`` is the state x(k) of run r. The runs may have unequal lengths, each at
        least one step.
    inputs : array_like, shape (T, m), or a list of them
        ``inputs[r][k]`` is the input u(k) of run r, between ``x(k)`` and ``x(k + 1)``.
    dt : float, optional
        The time between two steps [s], the same in all runs.
    state_names, input_names : sequence of str, optional
        Names of the n states and m inputs, all different; the default is ``x[0]``, ``u[0]``, ....

    Raises
    ------
    ShapeError, NonFiniteError, InputTypeError
        If the arrays do not fit together or cannot be used.
    InputError
        If names are repeated, or an array has labels: see `from_table`.

    Notes
    -----
    Runs that were aborted or diverged belong to the data, up to their last finite state: leaving
    them out makes every certificate wrong.

    Examples
    --------
    >>> import stochens_rs as se
    >>> states, inputs = [[[0.0], [1.0], [1.5]], [[1.0], [0.5]]], [[[1.0], [1.0]], [[0.0]]]
    >>> data = se.Trajectories(states, inputs)
    >>> data
    <Trajectories: 2 runs, 3 pairs, n=1 m=1>
    >>> x, u, x_next = data.pairs()
    >>> x_next.ravel()
    array([1. , 1.5, 0.5])
    """

    __slots__ = ()

    _kind = "trajectories"
    _made_by = staticmethod(_rebuild)

    def __init__(
        self,
        states: ArrayLike | Sequence[ArrayLike],
        inputs: ArrayLike | Sequence[ArrayLike],
        *,
        dt: float | None = None,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
    ) -> None:
        x, u = _several("states", states), _several("inputs", inputs)
        if len(x) != len(u):
            raise ShapeError(
                f"`inputs` must have {len(x)} runs as `states`, got {len(u)}; one run is a pair of "
                "arrays (T + 1, n) and (T, m)"
            )
        rows, n, m = [], None, None
        for (states_name, one), (inputs_name, acting) in zip(x, u, strict=True):
            run = gate.matrix(states_name, one, cols=n)
            if len(run) < 2:
                raise ShapeError(f"`{states_name}` must have at least 2 rows, got {len(run)}")
            control = gate.matrix(inputs_name, acting, rows=len(run) - 1, cols=m)
            n, m = run.shape[1], control.shape[1]
            rows.append(np.hstack([run[:-1], control, run[1:]]))
        lengths = np.array([len(part) for part in rows], dtype=np.int64)
        assert n is not None
        self._set(np.vstack(rows), lengths, n, dt, state_names, input_names, 1)

    @classmethod
    def from_table(
        cls,
        table: Any,
        *,
        states: Sequence[Any],
        inputs: Sequence[Any],
        by: Any = None,
        time: Any = None,
    ) -> Trajectories:
        """Read runs from a table with one row per run and time.

        Parameters
        ----------
        table : pandas.DataFrame or mapping of columns
            ``table[name]`` is a column of numbers, all of one length.
        states, inputs : sequence of column names
            The columns of the states and of the inputs, in the order that the model is to have.
            They become `state_names` and `input_names`.
        by : column name, optional
            The column that tells the runs apart; None: the table is one run.
        time : column name, optional
            The column of times [s], or of dates and times; it gives `dt`. None: the rows of a run
            are equal steps apart.

        Returns
        -------
        Trajectories
            In the order in which the runs first appear. The rows of different runs may be mixed.

        Raises
        ------
        InputError
            If a column is missing or not usable; a state or an input is missing, named by column,
            run and time; the times of a run do not increase or are not equally far apart, with the
            run and the time of the first gap; the steps of two runs differ; or a run has one row.
        InputTypeError
            If `table` is no table.

        Notes
        -----
        The input in the last row of a run acts after its last state: it is not used, and may be
        missing (nan).

        Examples
        --------
        >>> import stochens_rs as se
        >>> table = {
        ...     "rig": [1, 1, 1, 2, 2],
        ...     "t": [0.0, 0.5, 1.0, 0.0, 0.5],
        ...     "angle": [0.0, 1.0, 1.5, 1.0, 0.5],
        ...     "torque": [1.0, 1.0, float("nan"), 0.0, float("nan")],
        ... }
        >>> se.Trajectories.from_table(
        ...     table, states=["angle"], inputs=["torque"], by="rig", time="t"
        ... )
        <Trajectories: 2 runs, 3 pairs, n=1 m=1 dt=0.5>
        """
        rows, lengths, dt = read_table(table, states, inputs, by, time)
        names = [str(name) for name in states], [str(name) for name in inputs]
        return cls._of(rows, lengths, len(names[0]), dt, *names)

    @classmethod
    def from_pairs(
        cls,
        x: ArrayLike,
        u: ArrayLike,
        x_next: ArrayLike,
        *,
        dt: float | None = None,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
    ) -> Trajectories:
        """Take single steps, each a run of its own.

        Parameters
        ----------
        x : array_like, shape (N, n)
            The states before the steps. Where a state was set and not measured: the set points.
        u : array_like, shape (N, m)
            The inputs.
        x_next : array_like, shape (N, n)
            The states after the steps.
        dt, state_names, input_names
            As in `Trajectories`.

        Returns
        -------
        Trajectories
            N runs of one step.

        Raises
        ------
        InputError, InputTypeError
            As `Trajectories`.

        Examples
        --------
        >>> import stochens_rs as se
        >>> se.Trajectories.from_pairs([[0.0], [1.0]], [[1.0], [0.0]], [[1.0], [0.5]])
        <Trajectories: 2 pairs, n=1 m=1>
        """
        before = gate.matrix("x", x)
        N, n = before.shape
        acting = gate.matrix("u", u, rows=N)
        after = gate.matrix("x_next", x_next, rows=N, cols=n)
        memory.need("the pairs", (2 * before.nbytes) + acting.nbytes)
        rows = np.hstack([before, acting, after])
        return cls._of(rows, np.ones(N, dtype=np.int64), n, dt, state_names, input_names)

    def _to_sections(self) -> Sections:
        return from_runs(self)

    @classmethod
    def _from_sections(cls, sections: Sections) -> Trajectories:
        rows, *about = to_runs(sections)
        nothing_left(sections)
        return cls._of(gate.matrix("rows", rows), *about)

    def __reduce__(self) -> tuple[Any, ...]:
        return _rebuild, (self._rows, self._lengths, *self._about())


def pooled(data: object) -> Trajectories:
    """Check the data of `identify`: one set, or a list of sets of the same system."""
    if isinstance(data, Trajectories):
        return data
    if hasattr(data, "columns"):
        raise InputTypeError(
            f"`data` must be a Trajectories, got {gate.show(data)}: see Trajectories.from_table"
        )
    sets = [gate.instance("data", one, Trajectories) for one in gate.items("data", data)]
    if not sets:
        raise InputError("`data` must have at least one set of Trajectories, got an empty list")
    for k, one in enumerate(sets[1:], start=1):
        if one._about() != sets[0]._about():
            raise InputError(
                f"`data[{k}]` must have the states, inputs, steps and dt of `data[0]`: "
                f"{sets[0]!r} and {one!r}, with the same names"
            )
    if len(sets) == 1:
        return sets[0]
    memory.need("the pooled data", sum(one._rows.nbytes for one in sets))
    rows = np.vstack([one._rows for one in sets])
    return sets[0]._part(rows, np.concatenate([one._lengths for one in sets]))


def _several(name: str, value: Any) -> list[tuple[str, Any]]:
    """The runs in an argument, with their names in messages."""
    if isinstance(value, np.ndarray) and value.ndim == 3:
        return [(f"{name}[{k}]", one) for k, one in enumerate(value)]
    if isinstance(value, (list, tuple)) and value:
        first = value[0]
        inner = first[0] if isinstance(first, (list, tuple)) and first else None
        rows = isinstance(inner, (list, tuple)) or getattr(inner, "ndim", 0) > 0
        if rows or getattr(first, "ndim", 1) == 2:
            return [(f"{name}[{k}]", one) for k, one in enumerate(value)]
    return [(name, value)]
