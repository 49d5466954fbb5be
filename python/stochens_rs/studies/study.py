"""`Study`: a function, a grid and replicates, run anywhere, stopped and continued."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from .._base import files, validation
from .._base.files import PathLike
from .._base.progress import Progress, progress_bar
from .._base.types import Status
from .._base.validation import show
from ..exceptions import InputError, InputTypeError, StateError
from ..rng import Key, RngLike, as_key
from .assemble import collected
from .digest import full_name
from .grid import checked_grid
from .manifest import (
    Manifest,
    checked_replicates,
    described,
    different,
    reached,
    require_same,
    required_parts,
)
from .results import Results
from .scheduling import ExecutorLike, Run, checked_executor, run_all
from .signals import interruptions
from .store import Table
from .store_io import enter, open_table, write_parts
from .study_file import StudyFile, read_blocks, read_manifest
from .units import checked_units, units_of
from .worker import FAILED, WAITING, Block, Function, Layout, Work, fingerprint

if TYPE_CHECKING:
    from typing_extensions import Self

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
    ) -> None:
        if not callable(function):
            raise InputTypeError(f"`function` must be callable, got {show(function)}")
        units_of(function)
        self._function: Function | None = function
        self._grid = checked_grid(grid, nested, shared)
        self.replicates = checked_replicates(replicates, self._grid.size)
        self.key = as_key(rng)
        size = self._grid.size
        self._table = Table((self.replicates.start * size, self.replicates.stop * size))
        self._found: Manifest = {}  # of the file it was read from
        self._status: Status = "interrupted"
        self._seconds = 0.0

    def run(
        self,
        executor: ExecutorLike = None,
        path: PathLike | None = None,
        *,
        progress: Progress = None,
        time_limit: float | None = None,
    ) -> Results:
        """Run the replicates that have not run yet.

        Parameters
        ----------
        executor : Executor or callable, optional
            Any ``concurrent.futures.Executor``: threads, processes, loky, ``client.get_executor(
            pure=False)`` of Dask. Or a function without arguments that makes one, such as
            ``ProcessPoolExecutor``: then workers that died are replaced. Workers must be able to
            import `function`; the core uses one thread in each. Default: this process.
        path : path, optional
            The file in which numbers are kept as they are found. If it exists, its study must be
            this one, and is continued. Beside it is ``<path>.lock``, against a second writer.
        progress : bool or callable, optional
            True for a bar on a terminal; or a function of (done, total).
        time_limit : float, optional
            Seconds after which no more replicates are begun.

        Returns
        -------
        Results
            Also after Ctrl-C and SIGTERM, with `status` "interrupted"; running it on continues.
            Replicates that raised are in its `failures`.

        Raises
        ------
        InputError, InputTypeError
            If an argument cannot be used; or the first replicates all raise.
        StateError
            If the file is damaged, or of another study: the message names what differs.
        StateLockedError
            If the file is in use.
        StateIOError
            If the file cannot be written.
        ResourceError
            If the numbers need more memory than there is.
        """
        return self._run(executor, path, progress, time_limit)

    def retry(
        self,
        executor: ExecutorLike = None,
        path: PathLike | None = None,
        *,
        progress: Progress = None,
        time_limit: float | None = None,
    ) -> Results:
        """Run the replicates that failed again, with the same keys, and those that have not run.

        Parameters
        ----------
        executor, path, progress, time_limit : optional
            As for `run`.

        Returns
        -------
        Results
        """
        return self._run(executor, path, progress, time_limit, again=True)

    @property
    def results(self) -> Results:
        """What has been found so far."""
        about = {"key": self.key.hex, "function": self._named()}
        status, seconds = self._status, self._seconds
        found = (self._table, self._grid, self.replicates, status, about, seconds)
        known = self._function is not None
        units = units_of(self._function) if known else self._found["units"]
        return collected(*found, units)

    @classmethod
    def resume(
        cls,
        path: PathLike,
        function: Function | None = None,
        grid: Mapping[str, Any] | None = None,
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
        found, blocks = read_manifest(checked), list(read_blocks(checked))
        study = cls._of(checked, found, blocks, function, grid)
        if function is not None:
            require_same(checked, found, study._described())
        enter(checked, study._table, blocks)
        return study

    @classmethod
    def merge(cls, paths: Iterable[PathLike], path: PathLike | None = None) -> Self:
        """Return one study made of parts that were computed apart, for example with other
        `replicates` on other machines.

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
        """
        checked = [files.checked_path("paths", one) for one in validation.items("paths", paths)]
        if not checked:
            raise InputError("`paths` must name at least one file, got none")
        manifests = [read_manifest(one) for one in checked]
        parts = [list(read_blocks(one)) for one in checked]
        found = required_parts(checked, manifests)
        study = cls._of(checked[0], found, [block for part in parts for block in part])
        for one, part in zip(checked, parts, strict=True):
            enter(one, study._table, part)
        if path is not None:
            write_parts(files.checked_path("path", path), study._described(), parts)
        return study

    @classmethod
    def _of(
        cls,
        path: str,
        found: Manifest,
        blocks: list[Block],
        function: Function | None = None,
        grid: Mapping[str, Any] | None = None,
    ) -> Self:
        """A study as a manifest says, with the replicates of all blocks, and nothing done yet."""
        try:
            axes = checked_grid(found["grid"], found["nested"], found["shared"])
            study = cls(
                function or _unknown,
                found["grid"] if grid is None else grid,
                replicates=reached(path, found, blocks, axes.size),
                rng=Key.from_hex(found["key"]),
                nested=found["nested"],
                shared=found["shared"],
            )
            name, units = validation.text("function", found["function"]), found.get("units", {})
            study._found = {**found, "function": name, "units": checked_units(units)}
        except (KeyError, InputError, InputTypeError) as error:
            raise StateError(f"{path} is not the file of a study: {error}") from error
        if function is None:
            study._function = None
        return study

    def _run(
        self,
        executor: object,
        path: PathLike | None,
        progress: Progress,
        time_limit: float | None,
        *,
        again: bool = False,
    ) -> Results:
        if self._function is None:
            raise InputError("`function` must be given: Study.resume(path, function)")
        run_by = checked_executor(executor)
        limit = None if time_limit is None else validation.positive("time_limit", time_limit)
        began, table = time.monotonic(), self._table
        total = len(table.states)
        with ExitStack() as stack:
            file: StudyFile | None = None
            if path is not None:
                file = StudyFile(files.checked_path("path", path))
                stack.callback(file.close)
                table.platforms += open_table(file, self._described(), table, self._grid.size)
            if again:
                table.forget_failures()
            if run_by is None and table.count(WAITING):
                self._require_platform(fingerprint())
            tell = stack.enter_context(progress_bar(progress, total, "study"))
            interruption = stack.enter_context(interruptions())

            def keep(block: Block) -> Layout:
                self._require_platform(block.platform)
                table.add(block)
                self._give_up()
                if file is not None:
                    file.append(block)
                tell(total - table.count(WAITING))
                return table.layout

            self._status = "interrupted"
            work = Work(self._function, self._grid, self.key)
            idle = file.flush_if_due if file is not None else lambda: None
            run = Run(work, table.layout, keep, idle, interruption, limit)
            try:
                self._status = run_all(run, run_by, table.waiting)
            finally:
                if file is not None:
                    file.flush()
        self._seconds = time.monotonic() - began
        return self.results

    def _require_platform(self, found: dict[str, str]) -> None:
        known = self._table.platforms
        if known and found not in known:
            name = str(different(known[0], found))
            raise StateError(
                f"`{name}` of the numbers so far is {known[0].get(name)}, here it is "
                f"{found.get(name)}: bits may differ; compute parts apart and merge them"
            )

    def _give_up(self) -> None:
        """Raise if the first tasks all fail: then it is the function."""
        table = self._table
        if table.layout:
            return
        failed = table.count(FAILED)
        if failed >= min(max(_PATIENCE, self._grid.size), len(table.states)):
            text = table.errors[min(table.errors)]
            table.forget_failures()
            raise InputError(f"`function` failed in the first {failed} replicates: {text}")

    def _named(self) -> str:
        return str(self._found["function"]) if self._function is None else full_name(self._function)

    def _described(self) -> Manifest:
        if self._function is None:
            return {**self._found, "replicates": [self.replicates.start, self.replicates.stop]}
        return described(self._function, self._grid, self.key, self.replicates)

    def __repr__(self) -> str:
        axes = " x ".join(f"{len(labels)} {name}" for name, labels in self._grid.labels.items())
        left = self._table.count(WAITING)
        return (
            f"<Study: {self._named()} of {axes + ' x ' if axes else ''}"
            f"{len(self.replicates)} replicates, {left} to run>"
        )


def _unknown(key: Key, **_: Any) -> Mapping[str, Any]:
    raise InputError("`function` must be given")
