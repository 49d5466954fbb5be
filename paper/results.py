"""The folder of results: what may be replaced in it, and the numbers of an unfinished run."""

from __future__ import annotations

import json
import re
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

from stochens_rs.exceptions import InputError

from .common import write_text

# every name that a report may have, whatever the options
NAMES = re.compile(r"results\.json|report\.html|(claims|(power|tracking)-figure-\d)\.(png|svg)")


class Folder:
    """A folder for a report, checked before anything is computed.

    Files of other origin are never replaced, those of a run with other options with `force` only.
    The numbers of an unfinished run in it are continued with `resume`, removed with `force`.
    """

    def __init__(self, path: Path, options: dict[str, Any], *, resume: bool, force: bool) -> None:
        self.path, self.unfinished = path, path / "unfinished"
        self._earlier = replaceable(path, "results.json", NAMES, options, force=force)
        index = self.unfinished / "options.json"
        if index.exists():
            try:
                before = json.loads(index.read_text(encoding="utf-8"))
            except ValueError:
                before = "unknown, as their list is damaged"
            if force and not resume:
                self.finish()
            elif not resume:
                raise InputError(f"{self.unfinished} has an unfinished run: --resume or --force")
            elif before != options:
                raise InputError(f"the unfinished run in {path} has other options: {before}")
        self.unfinished.mkdir(parents=True, exist_ok=True)
        write_text(index, json.dumps(options) + "\n")

    def clear(self) -> None:
        """Remove the files of the earlier run; its index is replaced at the end."""
        for path in self._earlier:
            path.unlink(missing_ok=True)

    def finish(self) -> None:
        """Remove the numbers, which the results now have, and nothing else."""
        own = [*self.unfinished.rglob("*.study*"), self.unfinished / "options.json"]
        for path in own:
            path.unlink(missing_ok=True)
        for folder in (self.unfinished / "claims", self.unfinished):
            with suppress(OSError):  # something of the user's is there
                folder.rmdir()


def replaceable(
    folder: Path, index: str, names: re.Pattern[str], options: dict[str, Any], *, force: bool
) -> list[Path]:
    """The files of an earlier run, without its index; raise if there are others of their names."""
    there = sorted(path for path in folder.glob("*") if names.fullmatch(path.name))
    if not there:
        return []
    try:
        found = json.loads((folder / index).read_text(encoding="utf-8"))
        listed, before = dict(found["files"]), dict(found["options"])
    except (OSError, ValueError, TypeError, KeyError):  # no index, or of another program
        listed, before = {}, {}
    for path in there:
        if path.name not in listed:
            raise InputError(f"{path} was not written by this program: choose another --out")
        digest = listed[path.name]
        if digest is not None and sha256(path.read_bytes()).hexdigest() != digest:
            raise InputError(f"{path} was changed since it was written: choose another --out")
    if before != options and not force:
        raise InputError(
            f"{folder} has results of other options ({before}): --force, or another --out"
        )
    return [path for path in there if path.name != index]
