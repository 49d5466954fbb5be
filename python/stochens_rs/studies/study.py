"""`Study`: a function, a grid and replicates, run anywhere, stopped and continued."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from .._base import files, validation
from .._base.files import PathLike
from .._base.running import Progress, progress_bar
from .._base.types import NDArray, Self, Status
from .._base.validation import show
from .._core import version as package_version
from ..exceptions import InputError, InputTypeError, StateError
from ..rng import RngLike, as_key
from . import tasks
from .results import Failure, Results
from .running import Function, Work, checked_executor, interruptions, run_tasks
from .tasks import Block, Layout, Manifest, StudyFile, Table, fingerprint

EVERY = 1.0  # seconds between two writes to a file
_PATIENCE = 10  # first tasks that may fail before the study is given up


class Study:
    """Replicates of a function over a grid of configurations.

    Parameters
    ----------
    function : callable
        ``function(key, **configuration)`` returns a mapping of names to numbers or arrays of
        numbers, with the same names and shapes each time. All that is random in it must come from
        `key` (a `Key`). An attribute ``units`` of it, a mapping of numbers and axes to texts such
        as "m/s", is for data sets and figures.
    grid : mapping
        For each axis its values: numbers, texts or None. Other values get labels: ``{"system":
        {"small": system, "large": other}}``.
    replicates : int or range
        How many, or which: two halves of a study are ``range(0, 500)`` and ``range(500, 1000)``.
    rng : None, int, SeedSequence, Generator, BitGenerator or Key, optional
        Source of randomness.
    nested : str, optional
        An axis whose values the function gets all at once, such as sample sizes which are prefixes
        of each other. Everything it returns then has one entry for each of them.
    shared : sequence of str, default ()
        Axes whose values get the same key, so that they are compared on the same samples.
    version : str, optional
        Names whatever else the numbers depend on: what `function` calls, data, settings. A file is
        continued with the same name, source text and `version` of the function only.

    Attributes
    ----------
    key : Key
        The key of replicate r of a configuration is ``key.child(text).child(f"replicate {r}")``
        with the labels as JSON, sorted by name, without nested and shared axes: ``{"size":10}``.
    replicates : range

    Raises
    ------
    InputError, InputTypeError, SeedError
        If an argument cannot be used.

    Notes
    -----
    The numbers are the same bits in any order, with any executor, number of workers, interruptions
    and continuations, on one platform: with the same versions of this package, Python and NumPy, on
    the same kind of processor. NumPy's own linear algebra may round differently with another number
    of threads (``OPENBLAS_NUM_THREADS``), which some executors set.

    Examples
    --------
    >>> import stochens_rs as se
    >>> def miss(key, size, method):
    ...     ensemble = se.sample([[1.0, 2.0], [3.0, 4.0]], size, rng=key)
    ...     return {"error": se.fuse(ensemble, method, target=[[1.0, 2.0], [3.0, 4.0]]).error}
    >>> grid = {"size": [10, 100], "method": ["uniform", "alse"]}
    >>> study = se.Study(miss, grid, replicates=5, rng=1, shared=["method"])
    >>> study.run()
    <Results: error of 2 size x 2 method x 5 replicates, completed: 20 of 20 ran>
    """

    def __init__(
        self,
        function: Function,
        grid: Mapping[str, Any],
        *,
        replicates: int | range,
        rng: RngLike = None,
        nested: str | None = None,
        shared: Iterable[str] = (),
        version: str | None = None,
    ) -> None:
        if not callable(function):
            raise InputTypeError(f"`function` must be callable, got {show(function)}")
        self._function: Function | None = function
        self._units = _units_of(function)
        self._version = None if version is None else validation.text("version", version)
        self._grid = tasks.checked_grid(grid, nested, shared)
        size = self._grid.size
        self.replicates = _checked_replicates(replicates, size)
        self.key = as_key(rng)
        self._table = Table(self.replicates.start * size, len(self.replicates) * size)
        self._found: Manifest | None = None  # of the file it was read from
        self._status: Status = "interrupted"
        self._seconds = 0.0

    def run(
        self,
        executor: Executor | None = None,
        path: PathLike | None = None,
        *,
        progress: Progress = None,
        time_limit: float | None = None,
        retry: bool = False,
    ) -> Results:
        """Run the replicates that have not run yet.

        Parameters
        ----------
        executor : Executor, optional
            Any ``concurrent.futures.Executor``: threads, processes, loky, ``client.get_executor(
            pure=False)`` of Dask. Workers must be able to import `function`; the core uses one
            thread in each. Default: this process.
        path : path, optional
            The file in which numbers are kept as they are found. If it exists, its study must be
            this one, and is continued. Beside it is ``<path>.lock``, against a second writer.
        progress : bool or callable, optional
            True for a bar on a terminal; or a function of (done, total).
        time_limit : float, optional
            Seconds after which no more replicates are begun.
        retry : bool, default False
            Run those that failed again, with the same keys.

        Returns
        -------
        Results
            Also after Ctrl-C and SIGTERM, with `status` "interrupted"; running it on continues.
            Replicates that raised are in its `failures`.

        Raises
        ------
        InputError, InputTypeError
            If an argument cannot be used; or the first replicates all raise; or the workers of the
            executor die: what was found is kept, running on with a new one continues.
        StateError
            If the file is damaged, or of another study: the message names what differs.
        StateLockedError
            If the file is in use.
        StateIOError
            If the file cannot be written.
        ResourceError
            If the numbers need more memory than there is.

        Examples
        --------
        >>> import concurrent.futures, stochens_rs as se
        >>> study = se.Study(lambda key, a: {"x": 2.0 * a}, {"a": [1, 2]}, replicates=2, rng=1)
        >>> with concurrent.futures.ThreadPoolExecutor(2) as threads:
        ...     study.run(threads)
        <Results: x of 2 a x 2 replicates, completed: 4 of 4 ran>
        """
        if self._function is None:
            raise InputError("`function` must be given: Study.resume(path, function)")
        by = checked_executor(executor)
        limit = math.inf if time_limit is None else validation.positive("time_limit", time_limit)
        again = validation.flag("retry", retry)
        began, table, total = time.monotonic(), self._table, len(self._table.states)
        with ExitStack() as stack:
            save: Callable[[], None] = lambda: None  # noqa: E731
            if path is not None:
                file = stack.enter_context(closing(StudyFile(files.checked_path("path", path))))
                save = partial(self._save, file, self._open(file))
                save()
            if again:
                table.forget_failures()
            if by is None and table.count(tasks.WAITING):
                self._require_platform(fingerprint())
            report = stack.enter_context(progress_bar(progress, total, "study"))
            interruption = stack.enter_context(interruptions())
            saved = time.monotonic()

            def keep(block: Block | None) -> Layout:
                nonlocal saved
                if block is not None:
                    self._require_platform(block.platform)
                    table.add(block)
                    self._give_up()
                if time.monotonic() - saved >= EVERY:
                    save()
                    saved = time.monotonic()
                if block is not None:
                    report(total - table.count(tasks.WAITING))
                return table.layout

            self._status = "interrupted"
            work, end = Work(self._function, self._grid, self.key), began + limit
            waiting = np.flatnonzero(table.states == tasks.WAITING) + table.first
            try:
                self._status = run_tasks(work, waiting, table.layout, keep, by, interruption, end)
            finally:
                save()
        self._seconds = time.monotonic() - began
        return self.results

    @property
    def results(self) -> Results:
        """The results so far; their arrays share the memory of the study."""
        table, grid = self._table, self._grid
        platforms = table.platforms or [fingerprint()]
        where = {k: " or ".join(dict.fromkeys(p[k] for p in platforms)) for k in platforms[0]}
        failures = []
        for task in sorted(table.errors):
            replicate, number = divmod(task, grid.size)
            at = {name: grid.labels[name][k] for name, k in grid.positions(number).items()}
            failures.append(Failure(at, replicate, table.errors[task]))
        return Results(
            status=self._status if table.count(tasks.WAITING) else "completed",
            grid=dict(grid.labels),
            replicates=np.array(self.replicates),
            values={name: self._arranged(rows) for name, rows in table.values.items()},
            done=self._arranged(table.states == tasks.DONE, of_calls=True),
            failed=self._arranged(table.states == tasks.FAILED, of_calls=True),
            failures=tuple(failures),
            about={"key": self.key.hex, "function": self._name, **where},
            seconds=self._seconds,
            units=self._units,
        )

    def _arranged(self, rows: Any, *, of_calls: bool = False) -> Any:
        """Rows of tasks over the axes of the grid and the replicates."""
        grid, count = self._grid, len(self.replicates)
        shaped = rows.reshape(count, *grid.shape, *rows.shape[1:])
        names = ["replicate", *grid.outer]
        if grid.nested is not None:
            names.append(grid.nested)
            if of_calls:  # the same for all values of the nested axis
                length = len(grid.labels[grid.nested])
                shaped = np.broadcast_to(shaped[..., None], (*shaped.shape, length))
        order = [names.index(name) for name in (*grid.labels, "replicate")]
        found = shaped.transpose(*order, *range(len(order), shaped.ndim))
        found.flags.writeable = False
        return found

    @classmethod
    def resume(
        cls, path: PathLike, function: Function | None = None, grid: Mapping[str, Any] | None = None
    ) -> Self:
        """Return the study in a file.

        Parameters
        ----------
        path : path
            What `run` was given.
        function : callable, optional
            That of the study: it is not in the file. Without it the study cannot be run, but its
            `results` can be read.
        grid : mapping, optional
            That of the study; needed to run it on if there are other values than numbers, texts and
            None.

        Returns
        -------
        Study

        Raises
        ------
        StateError
            If the file is damaged or no study's, or of another function or grid.
        StateNotFoundError
            If there is none.
        StateIOError
            If reading fails.

        Examples
        --------
        >>> import tempfile, pathlib, stochens_rs as se
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "noise.study"
        >>> def noise(key):
        ...     return {"x": key.generator().normal()}
        >>> first = se.Study(noise, {}, replicates=5, rng=1).run(path=path)
        >>> se.Study.resume(path).results.digest == first.digest
        True
        """
        checked = files.checked_path("path", path)
        found, blocks, _ = tasks.read(checked)
        study = cls._of(checked, found, function, grid)
        if function is not None:
            _require_same(checked, found, study._described())
        for block in blocks:
            study._table.add(block, checked)
        return study

    @classmethod
    def merge(cls, paths: Iterable[PathLike], path: PathLike | None = None) -> Self:
        """Merge parts of a study that were computed apart.

        For example, other `replicates` on other machines.

        Parameters
        ----------
        paths : sequence of paths
            The files of the parts: equal but for their replicates.
        path : path, optional
            A new file for the whole.

        Returns
        -------
        Study
            Without its function: see `resume`. Its results name all platforms.

        Raises
        ------
        StateError
            If they are parts of different studies, or differ where they overlap; the message names
            what differs.
        InputError
            If `path` exists.

        Examples
        --------
        >>> import tempfile, pathlib, stochens_rs as se
        >>> folder = pathlib.Path(tempfile.mkdtemp())
        >>> def noise(key):
        ...     return {"x": key.generator().normal()}
        >>> for part in (range(0, 3), range(3, 5)):  # on two machines
        ...     study = se.Study(noise, {}, replicates=part, rng=1)
        ...     found = study.run(path=folder / f"{part.start}.study")
        >>> se.Study.merge([folder / "0.study", folder / "3.study"]).results
        <Results: x of 5 replicates, completed: 5 of 5 ran>
        """
        checked = [files.checked_path("paths", one) for one in validation.items("paths", paths)]
        if not checked:
            raise InputError("`paths` must name at least one file, got none")
        parts = [(one, *tasks.read(one)[:2]) for one in checked]
        first, spans = parts[0][1], [found.replicates for _, found, _ in parts]
        whole = replace(first, replicates=(min(a for a, _ in spans), max(b for _, b in spans)))
        study = cls._of(checked[0], whole)
        for one, found, blocks in parts:
            for name, value in vars(first).items():
                if name != "replicates" and getattr(found, name) != value:
                    raise StateError(f"`{name}` of {one} differs from that of {checked[0]}")
            for block in blocks:
                study._table.add(block, one)
        if path is not None:
            with closing(StudyFile(files.checked_path("path", path))) as file:
                if os.path.lexists(file.path):
                    raise InputError(f"`path` must be a new file, got {file.path}")
                file.create(whole)
                for _, _, blocks in parts:
                    for block in blocks:
                        file.append(replace(block, study=None))
        return study

    @classmethod
    def _of(
        cls, path: str, found: Manifest, function: Function | None = None, grid: Any = None
    ) -> Self:
        """A study as a manifest says, with nothing done yet."""
        try:
            axes, span = found.grid if grid is None else grid, range(*found.replicates)
            about: Any = {"rng": found.key, "nested": found.nested, "shared": found.shared}
            about["version"] = found.version
            study = cls(function or dict, axes, replicates=span, **about)
        except (InputError, InputTypeError) as error:
            raise StateError(f"{path} is not the file of this study: {error}") from error
        study._found = found
        if function is None:
            study._function, study._units = None, found.units
        return study

    def _open(self, file: StudyFile) -> NDArray[np.int8]:
        """Take over what a file has, if there is one; return the states that it has."""
        table, manifest = self._table, self._described()
        states, ours = np.zeros_like(table.states), bool(table.platforms)
        if os.path.lexists(file.path):
            found, blocks, end = tasks.read(file.path)
            _require_same(file.path, found, manifest)
            for block in blocks:
                if ours and block.platform:
                    self._require_platform(block.platform)
                table.add(block, file.path)
                states[block.tasks - table.first] = block.states
            file.extend(len(blocks), end)
            if found.replicates != manifest.replicates:
                file.append(Block.of(manifest))
        else:
            file.create(manifest)
        return states

    def _save(self, file: StudyFile, states: NDArray[np.int8]) -> None:
        """Append what a file has not, which has tasks in these states."""
        found = self._table.states
        missing = (found != tasks.WAITING) & (found != states)
        if missing.any():
            file.append(self._table.block(missing))
            states[missing] = found[missing]

    def _require_platform(self, found: dict[str, str]) -> None:
        known = self._table.platforms
        if known and found not in known:
            name = next(k for k in {**known[0], **found} if known[0].get(k) != found.get(k))
            raise StateError(
                f"`{name}` of the numbers so far is {known[0].get(name)}, here it is "
                f"{found.get(name)}: bits may differ; compute parts apart and merge them"
            )

    def _give_up(self) -> None:
        """Raise if the first tasks all fail: then it is the function."""
        table = self._table
        if table.layout:
            return
        failed = table.count(tasks.FAILED)
        if failed >= min(max(_PATIENCE, self._grid.size), len(table.states)):
            text = table.errors[min(table.errors)]
            table.forget_failures()
            raise InputError(f"`function` failed in the first {failed} replicates: {text}")

    @property
    def _name(self) -> str:
        if self._function is None and self._found is not None:
            return self._found.function
        return tasks.full_name(self._function)

    def _described(self) -> Manifest:
        function, span = self._function, (self.replicates.start, self.replicates.stop)
        if function is None:
            assert self._found is not None
            return replace(self._found, replicates=span)
        grid, version = self._grid, self._version
        axes = grid.labels, grid.digests(), grid.nested, grid.shared
        own = self._name, version, tasks.function_digest(function, version), self._units
        return Manifest(package_version(), self.key, *axes, span, *own)

    def __repr__(self) -> str:
        axes = "".join(f"{len(labels)} {name} x " for name, labels in self._grid.labels.items())
        left = self._table.count(tasks.WAITING)
        return f"<Study: {self._name} of {axes}{len(self.replicates)} replicates, {left} to run>"


def _units_of(function: object) -> dict[str, str]:
    """The attribute ``units`` of a function, checked; empty if it has none."""
    while isinstance(function, partial) and not hasattr(function, "units"):
        function = function.func
    name = "function.units"
    given = getattr(function, "units", {})
    if not isinstance(given, Mapping):
        raise InputTypeError(f"`{name}` must be a mapping of names to texts, got {show(given)}")
    return {
        validation.text(name, k): validation.text(f"{name}[{k!r}]", v) for k, v in given.items()
    }


def _checked_replicates(given: object, size: int) -> range:
    """The replicates that a user asked for, of `size` configurations."""
    most = tasks.MOST // size
    if isinstance(given, range):
        if given.step != 1 or given.start < 0 or not given:
            raise InputError(f"`replicates` must be a range(first, stop) from 0 on, got {given}")
        validation.size("replicates", given.stop, maximum=most)
        return given
    return range(validation.size("replicates", given, maximum=most))


def _require_same(path: str, found: Manifest, ours: Manifest) -> None:
    """Raise if a manifest is not that of this study."""
    first, stop = ours.replicates
    within = first <= found.replicates[0] and found.replicates[1] <= stop
    for name, mine in vars(ours).items():
        theirs = getattr(found, name)
        if not (within if name == "replicates" else name == "units" or mine == theirs):
            raise StateError(
                f"`{name}` of {path} is {theirs!s:.60}, of this study {mine!s:.60}: continue it "
                "with the same, or choose another path"
            )
