"""Studies that are made from their files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from .._base import files, gate
from .._base.files import PathLike
from ..exceptions import InputError, InputTypeError, StateError
from ..rng import Key, RngLike
from .block import Block, Function
from .grid import checked_grid
from .manifest import Manifest, reached, require_same, required_parts
from .study_file import read_blocks, read_manifest
from .table import Table
from .table_file import enter, write_parts

if TYPE_CHECKING:
    from typing_extensions import Self


class Kept:
    """Base of `Study`: reads and merges files."""

    _function: Function | None
    _table: Table
    _found: Manifest

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
        raise NotImplementedError

    def _described(self) -> Manifest:
        raise NotImplementedError

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
        checked = [files.checked_path("paths", one) for one in gate.items("paths", paths)]
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
            study._found = {**found, "function": gate.text("function", found["function"])}
        except (KeyError, InputError, InputTypeError) as error:
            raise StateError(f"{path} is not the file of a study: {error}") from error
        if function is None:
            study._function = None
        return study


def _unknown(key: Key, **_: Any) -> Mapping[str, Any]:
    raise InputError("`function` must be given")
