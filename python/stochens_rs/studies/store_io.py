"""Between the table of a study and its file."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import closing

import numpy as np

from ..exceptions import InputError, StateError
from .manifest import Manifest, reached, require_same
from .store import Table
from .study_file import StudyFile, read_manifest
from .worker import WAITING, Block


def open_table(
    file: StudyFile, manifest: Manifest, table: Table, size: int
) -> list[dict[str, str]]:
    """Take over what a file has, if there is one, and append what it has not; for a study of
    `size` configurations.

    Returns the platforms of its numbers, if they are not those of the table.
    """
    before = Table(table.span)
    if os.path.lexists(file.path):
        found = read_manifest(file.path)
        require_same(file.path, found, manifest)  # before anything is written
        blocks = list(file.extend())
        enter(file.path, before, blocks)
        _reach(file, table, reached(file.path, found, blocks, size), size)
        there = before.platforms
        if table.platforms and any(one not in table.platforms for one in there):
            raise StateError(f"`platform` of {file.path} is not that of the numbers of this study")
        table.add(before.block(before.span, {}))
    else:
        file.create(manifest)
    news = (table.states != WAITING) & (table.states != before.states)
    for span in table.spans(news):
        file.append(table.block(span, table.platforms[0]))
    return [] if table.platforms else before.platforms


def _reach(file: StudyFile, table: Table, there: range, size: int) -> None:
    """Note in a file that the study now has more replicates than it had."""
    ends = {table.span[0]: there.start * size, table.span[1]: there.stop * size}
    for ours, theirs in ends.items():
        if ours != theirs:
            file.append(Block(ours, np.zeros(0, np.uint8)))
    file.flush()


def enter(path: str, table: Table, blocks: Iterable[Block]) -> None:
    """Enter the blocks of a file into a table."""
    first, end = table.span
    for block in blocks:
        if not first <= block.start <= block.stop <= end:
            raise StateError(f"`replicates` of {path} reach beyond those of this study")
        try:
            table.add(block)
        except StateError as error:
            raise StateError(f"{path}: {error}") from error


def write_parts(path: str, manifest: Manifest, parts: Iterable[Iterable[Block]]) -> None:
    """Write the blocks of several files into a new one."""
    with closing(StudyFile(path)) as file:
        if os.path.lexists(path):
            raise InputError(f"`path` must be a new file, got {path}")
        file.create(manifest)
        for part in parts:
            for block in part:
                file.append(block)
            file.flush()
