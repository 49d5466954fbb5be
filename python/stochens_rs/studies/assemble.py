"""From the table of a study to its results: axes in the order of the grid."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._base.types import Status
from .grid import Grid
from .results import Failure, Results
from .store import Table
from .worker import DONE, FAILED, WAITING, fingerprint


def collected(
    table: Table,
    grid: Grid,
    replicates: range,
    status: Status,
    about: dict[str, str],
    seconds: float,
    units: dict[str, str],
) -> Results:
    """The results; their arrays share the memory of the table."""
    platforms = table.platforms or [fingerprint()]
    where = {k: " or ".join(dict.fromkeys(p[k] for p in platforms)) for k in platforms[0]}
    return Results(
        status=status if table.count(WAITING) else "completed",
        grid=dict(grid.labels),
        replicates=replicates,
        values={k: _arranged(rows, grid, len(replicates)) for k, rows in table.values.items()},
        done=_arranged(table.states == DONE, grid, len(replicates), one=True),
        failed=_arranged(table.states == FAILED, grid, len(replicates), one=True),
        failures=[_failure(grid, task, table.errors[task]) for task in sorted(table.errors)],
        about={**about, **where},
        seconds=seconds,
        units=units,
    )


def _arranged(rows: Any, grid: Grid, replicates: int, *, one: bool = False) -> Any:
    """Rows of tasks over the axes of the grid and the replicates; `one` for each call only."""
    shaped = rows.reshape(replicates, *grid.shape, *rows.shape[1:])
    names = ["replicate", *grid.outer]
    if grid.nested is not None:
        names.append(grid.nested)
        if one:
            shaped = shaped[..., None]
    order = [names.index(name) for name in (*grid.labels, "replicate")]
    found = shaped.transpose(*order, *range(len(order), shaped.ndim))
    if grid.nested is not None and one:
        lengths = (*(len(labels) for labels in grid.labels.values()), replicates)
        found = np.broadcast_to(found, lengths)
    found.flags.writeable = False
    return found


def _failure(grid: Grid, task: int, error: str) -> Failure:
    replicate, number = divmod(task, grid.size)
    at = grid.positions(number)
    return Failure({name: grid.labels[name][k] for name, k in at.items()}, replicate, error)
