"""`Trajectories`: measured runs of a system, x(0), u(0), x(1), u(1), ..., x(T).

All that identification asks of a run are its pairs ((x(k), u(k)), x(k + 1)). They are kept as the
rows (x, u, x_next) of one array, with the number of pairs of each run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, overload

import numpy as np

from .._base import running, show, validation
from .._base.names import Labels, checked_names, order_of
from .._base.records import SavedRecord
from .._base.types import ArrayLike, Figure, Floats, NDArray, Places, Self, SubFigure, shared
from .._core import Pieces
from ..exceptions import InputError, InputTypeError, NonFiniteError, ShapeError
from ..plots.panels import draw_runs
from ..rng import RngLike, as_key
from .gaps import OnGap, pairs_of, warn_of_ends
from .table import Columns, Table, csv_files, read_runs


def _rebuild(
    rows: Floats,
    lengths: NDArray[np.int64],
    gaps: NDArray[np.int64],
    lost: NDArray[np.int64],
    n: int,
    dt: float | None,
    state_names: tuple[str, ...],
    input_names: tuple[str, ...],
    outputs: bool = False,
    whole: Trajectories | None = None,
) -> Trajectories:
    """Make trajectories from their fields, which may come from anywhere."""
    checked, count = validation.matrix("rows", rows).copy(), validation.size("n", n)
    whole_numbers = [np.asarray(one) for one in (lengths, gaps, lost)]
    if any(one.dtype.kind not in "iu" for one in whole_numbers):
        raise InputTypeError("`lengths`, `gaps` and `lost` must be whole numbers")
    pieces = Pieces(*(one.ravel().astype(np.int64) for one in whole_numbers))
    if checked.shape[1] <= 2 * count or pieces.lengths.sum() != len(checked):
        raise InputTypeError("the fields of these Trajectories do not fit together")
    about = count, dt, state_names, input_names, bool(outputs)
    made = Trajectories._of(checked, pieces, about)
    if whole is None:
        return made
    last = validation.instance("whole", whole, Trajectories).last_pairs()
    if last != made:
        raise InputError("`whole` must be the runs of which these are the last pairs")
    return last


class Trajectories(SavedRecord, init=False):
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
        Names of the n states and m inputs, all different; the default is ``x[0]``, ``u[0]``, ...,
        of outputs ``y[0]``.
    outputs : bool, default False
        Whether `states` are readings that do not say all of the state, as of positions without
        velocities, or that have errors: `identify` then predicts them from past ones.

    Attributes
    ----------
    n : int
        The number of states.
    dt : float or None
        The time between two steps [s]; None if unspecified.
    state_names, input_names : tuple of str
        The names of the states, and of the inputs.
    outputs : tuple of str
        The names of what was read, where that is not all of the state; else empty.

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

    rows: Floats
    layout: Pieces
    whole: Trajectories | None  # the runs of which these are the last pairs
    n: int
    dt: float | None
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    outputs: tuple[str, ...]

    _made_by = staticmethod(_rebuild)

    def __new__(
        cls,
        states: ArrayLike | Sequence[ArrayLike],
        inputs: ArrayLike | Sequence[ArrayLike],
        *,
        dt: float | None = None,
        state_names: Sequence[str] | None = None,
        input_names: Sequence[str] | None = None,
        outputs: bool = False,
    ) -> Self:
        """Check arrays; see the class."""
        x, u = _several("states", states), _several("inputs", inputs)
        if len(x) != len(u):
            raise ShapeError(
                f"`inputs` must have {len(x)} runs as `states`, got {len(u)}, each (T, m)"
            )
        checked: list[tuple[Floats, Floats]] = []
        n = m = None
        for (states_name, one), (inputs_name, acting) in zip(x, u, strict=True):
            try:
                run = validation.matrix(states_name, one, cols=n)
            except NonFiniteError as error:
                if np.isnan(np.asarray(one, dtype=np.float64)).all(axis=0).any():
                    raise NonFiniteError(
                        f"`{states_name}` has a column of nan: a state that was not measured; "
                        "leave it out, and pass outputs=True, for the others are then readings"
                    ) from error
                raise
            if len(run) < 2:
                raise ShapeError(f"`{states_name}` must have at least 2 rows, got {len(run)}")
            control = validation.matrix(inputs_name, acting, rows=len(run) - 1, cols=m)
            n, m = run.shape[1], control.shape[1]
            checked.append((run, control))
        rows = np.vstack([np.hstack([run[:-1], acting, run[1:]]) for run, acting in checked])
        pieces = Pieces(np.array([len(acting) for _, acting in checked], dtype=np.int64))
        read = validation.flag("outputs", outputs)
        made = cls._of(rows, pieces, (n, dt, state_names, input_names, read))
        warn_of_ends(checked, made.state_names)
        return made

    @classmethod
    def from_csv(
        cls,
        source: Any,
        *,
        states: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        inputs: Sequence[str],
        by: str | None = None,
        time: str | None = None,
        dt: float | None = None,
        delay: int = 0,
        on_gap: OnGap = "split",
        skip: int = 0,
    ) -> Self:
        """Read runs from CSV files, with lost rows and jittering stamps as logs have them.

        Parameters
        ----------
        source : path, pattern or list of paths
            A file, a folder of ``.csv`` files, a pattern as ``"logs/run_*.csv"``, or a list. Each
            file is a run, or several with `by`. The files of a folder or pattern are taken in the
            order of their names with numbers compared as numbers (``run_2`` before ``run_10``),
            those of a list in its order.
        states, outputs, inputs : sequence of str
            The columns of the states or the outputs, and of the inputs, as the first row of each
            file names them.
        by, time, dt, delay, on_gap
            As in `from_table`.
        skip : int, default 0
            The number of lines to leave out above the names of the columns.

        Returns
        -------
        Trajectories

        Raises
        ------
        InputError
            As `from_table`, with the file and its row; or if two files say different units.
        FileNotFoundError
            If there is no such file.

        Notes
        -----
        Files are text in UTF-8, UTF-16 or Windows-1252, with tabs, ``;``, ``|``, ``,`` or blanks
        between cells, and a comma in numbers where that is ``;``. Above the names may be empty
        lines, a line ``sep=;`` and comments that begin with # or %, below them a row of units,
        which become part of the names. Numbers of lines in messages count all lines of the file.
        ``from_table(pandas.read_csv(path, ...), ...)`` reads files that are written otherwise.

        Examples
        --------
        >>> import pathlib, tempfile, stochens_rs as se
        >>> folder = pathlib.Path(tempfile.mkdtemp())
        >>> rows = ["t,v [m/s],F", "0.0,0.0,1", "0.1,0.3,-1", "0.2,,0.5", "0.3,0.1,1", "0.4,0.4,"]
        >>> _ = (folder / "1.csv").write_text(chr(10).join(rows))
        >>> data = se.Trajectories.from_csv(folder, states=["v"], inputs=["F"], time="t")
        >>> data
        <Trajectories: 1 run in 2 pieces, 2 pairs, 1 row lost, n=1 m=1 dt=0.1>
        >>> data.state_names
        ('v [m/s]',)
        """
        columns = Columns.checked(states, outputs, inputs, by, time)
        tables = [Table.of_file(path, skip) for path in csv_files(source)]
        return cls._read(tables, columns, dt, delay, on_gap)

    @classmethod
    def from_table(
        cls,
        table: Any,
        *,
        states: Sequence[Any] | None = None,
        outputs: Sequence[Any] | None = None,
        inputs: Sequence[Any],
        by: Any = None,
        time: Any = None,
        dt: float | None = None,
        delay: int = 0,
        on_gap: OnGap = "split",
    ) -> Self:
        """Read runs from a table with one row per run and time.

        Parameters
        ----------
        table : pandas.DataFrame or mapping of columns
            ``table[name]`` is a column of numbers, all of one length; nan where one is missing.
        states, inputs : sequence of column names
            The columns of the states and of the inputs, in the order that the model is to have.
            They become `state_names` and `input_names`. ``angle`` is also found as ``angle [rad]``
            or ``angle (rad)``, and the name then has the unit.
        outputs : sequence of column names, optional
            In place of `states`: columns that do not say all of the state, as positions without
            velocities, or that are read with error; see `identify`. States must all be there,
            without error.
        by : column name, optional
            The column that tells the runs apart; None: the table is one run.
        time : column name, optional
            The column of times, in the unit in its name (``t [ms]``, ``time_us``, ``TimeMS``), else
            in seconds; or of dates and times, with a time zone in all rows or in none. None: the
            rows of a run are equal steps apart.
        dt : float, optional
            The time between two steps [s]: your declaration that the stamps jitter, by up to 0.25
            of a step, and the sampling does not. None: the mean step of `time`, of which a stamp
            may be off by 0.05. Rows that are further off do not follow on each other.
        delay : int, default 0
            By how many rows the inputs stand too early: ``u(k - delay)`` takes the place of
            ``u(k)``. -1: a row holds the states *after* its input. This mends the log; a dead time
            of the plant is `delay` of `identify`, whose plans and gains know of it.
        on_gap : {"split", "raise"}, default "split"
            Where a row is lost, or a state or input missing, the run is divided into pieces, or an
            error names the row. A pair needs both its rows and its input. The pieces are still one
            run for all that counts runs (`last_pairs`, `split`).

        Returns
        -------
        Trajectories
            In the order in which the runs first appear. The rows of different runs may be mixed.

        Raises
        ------
        InputError
            If a column is missing, not usable, constant, or proportional to another one; the times
            of a run do not increase; more than a tenth of the steps are not a whole number of `dt`;
            or a run has no pair.
        InputTypeError
            If `table` is no table.

        Warns
        -----
        DataWarning
            If stamps that jitter cost many rows, or many readings are the largest or least of all.

        Notes
        -----
        Rows must be lost by chance, which is part of every `Region.assumption`: with a logger that
        loses rows for what they would have read, or runs that were cut before a bad reading, no
        region holds. The input in the last row of a run acts after its last state: it is not used.

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
        columns = Columns.checked(states, outputs, inputs, by, time)
        return cls._read([Table(table)], columns, dt, delay, on_gap)

    @classmethod
    def _read(cls, tables: list[Table], columns: Columns, *about: object) -> Self:
        """The runs of tables, and dt, delay and on_gap."""
        titles, runs = read_runs(tables, columns)
        states, inputs = tuple(map(str, titles.read)), tuple(map(str, titles.inputs))
        rows, pieces, dt = pairs_of(runs, [*states, *inputs], *about)
        read = titles.kind == "outputs"
        return cls._of(rows, pieces, (len(states), dt, states, inputs, read))

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
        before = validation.matrix("x", x)
        N, n = before.shape
        acting = validation.matrix("u", u, rows=N)
        after = validation.matrix("x_next", x_next, rows=N, cols=n)
        running.need("the pairs", (2 * before.nbytes) + acting.nbytes)
        pieces = Pieces(np.ones(N, dtype=np.int64))
        rows = np.hstack([before, acting, after])
        return cls._of(rows, pieces, (n, dt, state_names, input_names, False))

    @property
    def m(self) -> int:
        """The number of inputs."""
        return len(self.input_names)

    @property
    def size(self) -> int:
        """The number of pairs N, of all runs together."""
        return len(self.rows)

    @property
    def lengths(self) -> NDArray[np.int64]:
        """The number of pairs of each run, read-only; of all its pieces, if it has gaps."""
        return self.layout.lengths

    @property
    def pieces(self) -> NDArray[np.int64]:
        """The number of pairs of each piece: a run between two gaps, or a whole one."""
        return np.diff(np.append(np.flatnonzero(self.layout.places() == 0), self.size))

    @property
    def lost(self) -> int:
        """The number of rows that the logs of these runs have lost: missing, or not complete."""
        return int(self.layout.lost.sum())

    @property
    def single(self) -> bool:
        """Whether every run is one pair."""
        return len(self) == self.size

    @property
    def runs(self) -> list[tuple[Floats, Floats]]:
        """The states (T + 1, n) and inputs (T, m) of each run; nan for what is lost at a gap."""
        n, found, skipped = self.n, [], self.layout.skipped()
        running.need("the runs", 8 * (self.size + len(self) + int(skipped.sum())) * (n + self.m))
        for T, end in zip(self.lengths, np.cumsum(self.lengths), strict=True):
            part = self.rows[end - T : end]
            at = np.arange(T) + np.cumsum(skipped[end - T : end])  # the step of each pair
            x, u = np.full((at[-1] + 2, n), np.nan), np.full((at[-1] + 1, self.m), np.nan)
            x[at], u[at], x[at + 1] = part[:, :n], part[:, n:-n], part[:, -n:]
            found.append((x, u))
        return found

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
        x, u, x_next = np.split(self.rows, [self.n, self.n + self.m], axis=1)
        return x, u, x_next

    def last_pairs(self) -> Self:
        """Keep only the last pair of each run.

        Returns
        -------
        Trajectories
            As many pairs as runs, however many pieces a run has; `identify` also looks at the rows
            before them, and at where runs end. They may be identified with
            ``design="independent"``, also where the runs had feedback, if the runs are independent
            of each other and their lengths were chosen without a look at the last state.

        Examples
        --------
        >>> import stochens_rs as se
        >>> states, inputs = [[[0.0], [1.0], [1.5]], [[1.0], [0.5]]], [[[1.0], [1.0]], [[0.0]]]
        >>> data = se.Trajectories(states, inputs)
        >>> data.last_pairs()
        <Trajectories: 2 pairs, n=1 m=1>
        """
        last = np.zeros(self.size, dtype=bool)
        last[np.cumsum(self.lengths) - 1] = True
        whole = self if self.whole is None else self.whole
        return self._part(self.rows[last], self.layout.chosen(last), whole)

    def last_record(self, rows: int = 2) -> tuple[Floats, Floats]:
        """Return the readings and inputs of the last piece: where a plan may begin.

        Parameters
        ----------
        rows : int, default 2
            How many readings the piece must have at the least; shorter ones behind it, as between
            rows that are lost, are passed over.

        Returns
        -------
        outputs : ndarray, shape (T + 1, n)
            What was read, the last row after the last input.
        inputs : ndarray, shape (T, m)

        Raises
        ------
        InputError, InputTypeError
            If no piece is so long.

        Examples
        --------
        >>> import stochens_rs as se
        >>> data = se.Trajectories([[[1.0], [1.5], [2.0]]], [[[0.5], [0.5]]], outputs=True)
        >>> data.last_record()[0].ravel()
        array([1. , 1.5, 2. ])
        """
        x, u, after = self.pairs()
        least, ends = validation.size("rows", rows, minimum=2), np.cumsum(self.pieces)
        long = np.flatnonzero(self.pieces + 1 >= least)
        if not len(long):
            raise InputError(
                f"`rows` must be at most {int(self.pieces.max()) + 1}, which the longest piece "
                f"without a gap has, got {least}"
            )
        end = int(ends[long[-1]])
        own = slice(end - int(self.pieces[long[-1]]), end)
        return np.vstack([x[own], after[end - 1 : end]]), u[own].copy()

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
        if isinstance(share, (int, np.integer)) and not isinstance(share, bool):
            count = validation.size("share", share, maximum=max(runs - 1, 1))
        else:
            count = round(validation.probability("share", share) * runs)
        if not 0 < count < runs:
            raise InputError(f"`share` must leave a run for each part, got {share} of {runs}")
        chosen = as_key(rng).child("split").generator().permutation(runs)[:count]
        first = np.isin(self.layout.runs(), chosen)
        return self._with(first), self._with(~first)

    def _with(self, pairs: NDArray[np.bool_]) -> Self:
        """Some of the pairs; their runs stay."""
        if self.whole is not None:  # one pair of each run
            return self.whole._with(pairs[self.whole.layout.runs()]).last_pairs()  # type: ignore[return-value]
        return self._part(self.rows[pairs], self.layout.chosen(pairs))

    @overload
    def __getitem__(self, runs: int) -> tuple[Floats, Floats]: ...
    @overload
    def __getitem__(self, runs: slice) -> Self: ...
    def __getitem__(self, runs: int | slice) -> Self | tuple[Floats, Floats]:
        """One run as (states, inputs), or the runs of a slice."""
        if not isinstance(runs, slice):
            index = validation.size("run", runs, minimum=-len(self), maximum=len(self) - 1)
            first = index % len(self)
            return self[first : first + 1].runs[0]
        chosen = np.zeros(len(self), dtype=bool)
        chosen[runs] = True
        if not chosen.any() or (runs.step or 1) < 0:
            raise InputError("the slice must name at least one run, in their order")
        return self._with(chosen[self.layout.runs()])

    def __iter__(self) -> Iterator[tuple[Floats, Floats]]:
        return iter(self.runs)

    def plot(
        self,
        states: Places = None,
        inputs: Places = None,
        *,
        figure: Figure | SubFigure | None = None,
    ) -> Figure:
        """Draw all runs, one over another: each state and input in its panel.

        Parameters
        ----------
        states, inputs : str, int or list of them, optional
            Which ones, by name or number; the default is all, ``inputs=[]`` draws no input.
        figure : matplotlib Figure or SubFigure, optional
            Where to draw; the default is a new figure.

        Returns
        -------
        matplotlib Figure

        Raises
        ------
        ImportError
            If matplotlib is not installed.
        InputError, InputTypeError
            If there is no such state or input.

        Examples
        --------
        >>> import stochens_rs as se
        >>> len(se.Trajectories([[0.0], [1.0], [1.5]], [[1.0], [1.0]]).plot().axes)
        2
        """
        labels = Labels(self.state_names, self.input_names)
        at, some = labels.places("states", states), labels.places("inputs", inputs, inputs=True)
        names = [self.state_names[i] for i in at], [self.input_names[i] for i in some]
        x, u = zip(*((x[:, at], u[:, some]) for x, u in self.runs), strict=True)
        return draw_runs(x, u, names, self.dt, figure)

    @classmethod
    def _of(cls, rows: Floats, layout: Pieces, about: tuple[Any, ...], whole: Any = None) -> Self:
        """From checked rows; `about` is as `_about` returns, of which names and dt are checked."""
        n, dt, state_names, input_names, outputs = about
        made = object.__new__(cls)
        rows.flags.writeable = False
        if outputs and state_names is None:
            state_names = [f"y[{i}]" for i in range(n)]
        names = checked_names(n, rows.shape[1] - 2 * n, state_names, input_names)
        step = None if dt is None else validation.positive("dt", dt)
        made._keep(rows=rows, layout=layout, whole=whole, n=n, dt=step)
        made._keep(state_names=names[0], input_names=names[1], outputs=names[0] if outputs else ())
        return made

    def _part(self, rows: Floats, pieces: Pieces, whole: Trajectories | None = None) -> Self:
        return self._of(rows, pieces, self._about(), whole)

    def __reduce__(self) -> tuple[Any, ...]:
        own = self.rows, self.lengths, self.layout.gaps, self.layout.lost
        return _rebuild, (*own, *self._about(), self.whole)

    @property
    def assumption(self) -> str:
        """What is assumed of the rows that are lost, behind the assumptions of a region."""
        return "; rows lost by chance, not for what they read" if self.lost else ""

    def __len__(self) -> int:
        return len(self.lengths)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"Trajectories are immutable: `{name}` cannot be set")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Trajectories):
            return NotImplemented
        return (
            self._about() == other._about()
            and self.layout == other.layout
            and np.array_equal(self.rows, other.rows)
        )

    __hash__ = None  # as for arrays

    def _about(self) -> tuple[int, float | None, tuple[str, ...], tuple[str, ...], bool]:
        """What data that are pooled have in common."""
        return self.n, self.dt, self.state_names, self.input_names, bool(self.outputs)

    def __repr__(self) -> str:
        """``<Trajectories: 2 runs in 5 pieces, 40 pairs, 3 rows lost, n=2 m=1>``."""
        words = [show.number_of(len(self), "run"), show.number_of(self.size, "pair")]
        if self.single:
            words = words[1:]
        elif len(self.layout.gaps):
            words[0] += f" in {show.number_of(len(self.pieces), 'piece')}"
        if self.lost:
            words.append(f"{show.number_of(self.lost, 'row')} lost")
        size = f"{'outputs' if self.outputs else 'n'}={self.n} m={self.m}"
        dt = "" if self.dt is None else f" dt={self.dt:g}"
        return f"<Trajectories: {', '.join(words)}, {size}{dt}>"

    def _repr_html_(self) -> str:
        rows = [
            ("outputs" if self.outputs else "states", ", ".join(self.state_names)),
            ("inputs", ", ".join(self.input_names)),
        ]
        first = self.rows[: self.pieces[0], : self.n]
        return show.card(self, rows, show.states(np.arange(len(first)), first, "the first piece"))


def pooled(data: object, name: str = "data") -> Trajectories:
    """Check the data of `identify`: one set, or a list of sets of the same system."""
    if isinstance(data, Trajectories):
        return data
    if hasattr(data, "columns"):
        raise InputTypeError(
            f"`{name}` must be a Trajectories, got {validation.show(data)}: see its from_table"
        )
    sets = [validation.instance(name, one, Trajectories) for one in validation.items(name, data)]
    if not sets:
        raise InputError(f"`{name}` must have at least one set of Trajectories, got an empty list")
    for k, one in enumerate(sets[1:], start=1):
        if one._about() != sets[0]._about():
            raise InputError(
                f"`{name}[{k}]` must have the states, inputs and dt of `{name}[0]`: "
                f"{sets[0]!r} and {one!r}, with the same names"
            )
    if len(sets) == 1:
        return sets[0]
    running.need("the pooled data", sum(one.rows.nbytes for one in sets))
    if all(one.whole is not None for one in sets):
        return pooled([one.whole for one in sets], name).last_pairs()
    rows = np.vstack([one.rows for one in sets])
    return sets[0]._part(rows, Pieces.joined([one.layout for one in sets]))


def moved(data: Trajectories) -> Trajectories:
    """The same where a row held the states after its input: u(k + 1) in place of u(k)."""
    behind = np.flatnonzero(data.layout.places() > 0)
    if not len(behind):
        raise InputError("`delay` of -1 needs runs of two steps or more: the inputs are moved")
    kept = np.zeros(data.size, dtype=bool)
    kept[behind - 1] = True
    rows = data.rows[kept]
    rows[:, data.n : -data.n] = data.rows[behind, data.n : -data.n]
    return data._part(rows, data.layout.chosen(kept))


def require_whole(data: Trajectories, name: str, why: str) -> None:
    """Refuse runs with gaps where an argument needs every row of a run."""
    gaps = len(data.layout.gaps)
    if gaps:
        raise InputError(
            f"`{name}` must have no gaps, got {show.number_of(gaps, 'gap')} in "
            f"{show.number_of(len(data), 'run')}: {why}"
        )


def in_order(name: str, data: Trajectories, labels: Labels) -> tuple[Floats, Floats, Floats]:
    """The pairs, with states and inputs in the order of these names."""
    order = order_of(name, Labels(data.state_names, data.input_names), labels)
    x, u, x_next = data.pairs()
    return order.of_states(x), order.of_inputs(u), order.of_states(x_next)


def shared_rows(a: Trajectories, b: Trajectories) -> int:
    """How many different pairs (x, u, x_next) two data sets share, aligned by name."""
    if a.rows.shape[1] != b.rows.shape[1]:
        return 0
    try:
        mine = in_order("data", b, Labels(a.state_names, a.input_names))
    except InputError:  # of other signals
        return 0
    return shared(a.rows, np.hstack(mine))


def _several(name: str, value: Any) -> list[tuple[str, Any]]:
    """The runs in an argument, with their names in messages."""
    if getattr(value, "ndim", 0) == 3:  # of xarray, too
        return [(f"{name}[{k}]", value[k]) for k in range(len(value))]
    if isinstance(value, (list, tuple)) and value:
        first = value[0]
        inner = first[0] if isinstance(first, (list, tuple)) and first else None
        rows = isinstance(inner, (list, tuple)) or getattr(inner, "ndim", 0) > 0
        if rows or getattr(first, "ndim", 1) == 2:
            return [(f"{name}[{k}]", one) for k, one in enumerate(value)]
    return [(name, value)]
