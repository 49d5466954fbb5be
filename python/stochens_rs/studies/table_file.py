"""Between the table of a study and its file."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import closing

from ..exceptions import InputError, StateError
from .block import WAITING, Block
from .manifest import Manifest, require_same
from .study_file import StudyFile, read_manifest
from .table import Table


def open_table(file: StudyFile, manifest: Manifest, table: Table) -> list[dict[str, str]]:
    """Take over what a file has, if there is one, and append what it has not.

    Returns the platforms of its numbers, if they are not those of the table.
    """
    before = Table(table.span)
    if os.path.lexists(file.path):
        require_same(file.path, read_manifest(file.path), manifest)
        enter(file.path, before, file.extend())
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
