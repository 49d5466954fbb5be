"""How everything that is repeated here is run: as studies, to their ends."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from stochens_rs import Study
from stochens_rs.exceptions import InputError

if TYPE_CHECKING:
    from .common import Floats, PathLike, Progress


class Where(NamedTuple):
    """Where studies run, and the folder that has a file for each of them."""

    executor: Any = None
    folder: Path | None = None

    def of(self, name: str) -> dict[str, Any]:
        """The options of `complete`, `power` and `tracking`."""
        path = None if self.folder is None else self.folder / f"{name}.study"
        return {"executor": self.executor, "path": path}


HERE = Where()


def complete(
    study: Study,
    executor: Any = None,
    path: PathLike | None = None,
    progress: Progress = None,
) -> dict[str, Floats]:
    """Run a study to its end and return its numbers; raise if it does not get there.

    Ctrl-C and SIGTERM raise KeyboardInterrupt when what is done is in the file.
    """
    # failures in the file may have been of that machine, such as too little memory
    results = study.run(executor, path, progress=progress, retry=True)
    if results.status == "interrupted":
        raise KeyboardInterrupt
    if results.failures:
        first = results.failures[0]
        raise InputError(f"replicate {first.replicate} failed: {first.error}")
    return results.values
