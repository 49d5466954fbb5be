"""``stochens study``: errors against the number of samples, on many processors, resumable."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import click
import numpy as np

from .._base.reading import number
from .._base.validation import nearest
from ..cases import CASES
from ..fusion.fusing import Method
from ..rng import as_key
from ..studies import Results, Study, error
from ..studies.results import SUFFIXES
from ._command import INTERRUPTED, TIME_LIMIT, WORKERS_LOST, Command
from ._options import FILE, Place, Words, force_option, json_option, out_option, seed_option
from ._output import Out, finite, grid, note, show_result
from ._problem import problem
from ._workers import executor, workers_option

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 16  # of a logarithmic range
_CODES = {"interrupted": INTERRUPTED, "time_limit": TIME_LIMIT, "workers_lost": WORKERS_LOST}


@click.command(
    "study",
    cls=Command,
    short_help="Errors against the number of samples.",
    examples=[
        "study ieee14 --sizes 10:1e4:log5 --methods uniform,alse",
        "study system.json --checkpoint run.study --out errors.parquet",
        "study run.study --out errors.csv",
    ],
    codes={TIME_LIMIT: "time limit reached", WORKERS_LOST: "workers lost"},
)
@click.argument("source", metavar="PROBLEM", type=Place("file", CASES))
@click.option("--sizes", default="10:1000:log5", metavar="S", help="10,100 or 10:1e5:log[POINTS].")
@click.option(
    "--methods",
    type=Words(get_args(Method)),
    default="uniform,alse",
    metavar="M",
    help=f"Of {', '.join(get_args(Method))}.",
)
@click.option(
    "--replicates", metavar="R", type=click.IntRange(min=1), default=100, help="Repetitions."
)
@workers_option
@click.option("--dask", metavar="ADDRESS", help="Run on this Dask cluster instead.")
@click.option(
    "--checkpoint",
    type=FILE,
    metavar="FILE",
    help="Keep the numbers here; an existing study goes on.",
)
@click.option("--time-limit", type=float, metavar="S", help="Time limit of this run in seconds.")
@seed_option
@out_option("study", f"all numbers to a file, {', '.join(SUFFIXES)}")
@force_option
@json_option
@click.pass_context
def study_command(
    context: click.Context,
    /,
    source: str,
    sizes: str,
    methods: str,
    replicates: int,
    workers: int,
    dask: str | None,
    checkpoint: str | None,
    time_limit: float | None,
    seed: int,
    as_json: bool,
    **_: Any,
) -> None:
    """Compare fusions by the errors of control and state, relative, over repeated samples.

    PROBLEM is the name of an example system, or a file: .npz, .mat or JSON with A, B and
    optionally x0, xf. With --checkpoint, the same command continues after Ctrl-C or a crash; the
    numbers are the same bits as without, with any number of workers. A file that ends in .study, of
    any study, is shown as it is, and written to --out.
    """
    files, key = Out(context, SUFFIXES), as_key(seed)
    if Path(source).suffix == ".study":
        _show(Study.resume(source).results, files, source, as_json)
        return
    known = source in CASES
    if not known and not Path(source).suffix and not Path(source).exists():
        names = f"{' or '.join(CASES)}, or a file"
        raise click.BadParameter(
            f"{source!r} must be {names}{nearest(source, CASES)}", param_hint="PROBLEM"
        )
    function = error(*problem(source if known else None, None if known else source, key))
    axes = {"size": _sizes(sizes), "method": _methods(methods)}
    made = Study(
        function,
        axes,
        replicates=replicates,
        rng=key.child("study"),
        nested="size",
        shared=["method"],
    )
    with executor(workers, dask) as run_by:
        results = made.run(run_by, checkpoint, progress=True, time_limit=time_limit)
    _show(results, files, checkpoint, as_json)
    if results.status in _CODES:
        if checkpoint is not None:
            note("the same command continues")
        context.exit(_CODES[results.status])


def _show(results: Results, files: Out, checkpoint: str | None, as_json: bool) -> None:
    """Print the summary; write the numbers, or the figure where the study is one over sizes."""
    facts = _facts(results, checkpoint)
    if files.file is not None:
        results.save(files.file)
    show_result(facts, _text(results), as_json)
    if results.values and {"size", "method"} <= results.grid.keys():
        number = "state" if "state" in results.values else next(iter(results.values))
        files.write(facts, lambda: _figure(results, number))


def _sizes(text: str) -> list[int]:
    """Read ``10,100``, ``10:1000:log`` or ``10:1000:log5``."""
    try:
        if ":" not in text:
            found = [_count(cell) for cell in text.split(",")]
        else:
            low, high, kind = text.split(":")
            points = int(kind.removeprefix("log") or _POINTS) if kind.startswith("log") else 0
            if not 1 <= points <= 10_000:
                raise ValueError
            steps = np.geomspace(_count(low), _count(high), points)
            found = np.unique(np.rint(steps).astype(np.int64)).tolist()
        if found != sorted(set(found)):
            raise ValueError
    except ValueError:
        raise click.BadParameter(
            f"{text!r} must be increasing numbers such as 10,100 or a range such as 10:1e5:log",
            param_hint="--sizes",
        ) from None
    return found


def _count(text: str) -> int:
    value = number(text)
    if not (1 <= value <= 1e9 and value.is_integer()):
        raise ValueError
    return int(value)


def _methods(text: str) -> list[str]:
    found, known = text.split(","), get_args(Method)
    for one in found:
        if one not in known or found.count(one) > 1:
            raise click.BadParameter(
                f"{one!r}: give some of {', '.join(known)}{nearest(one, set(known) - {one})}",
                param_hint="--methods",
            )
    return found


def _facts(results: Results, checkpoint: str | None) -> dict[str, Any]:
    columns = results.summary().columns
    numbers = ("mean", "standard_error", "q10", "median", "q90")
    return {
        "schema": "stochens-study-summary/1",
        "status": results.status,
        **results.about,
        "digest": results.digest,
        "replicates": len(results.replicates),
        "failed": len(results.failures),
        "seconds": results.seconds,
        "summary": {k: finite(v) if k in numbers else v for k, v in columns.items()},
        "checkpoint": checkpoint,
    }


def _figure(results: Results, number: str) -> Figure:
    ax = results.plot("size", number, "method")
    ax.set_ylabel(f"relative error of the {number}")
    if np.nanmax(results.values[number]) > 0.0:  # errors of ALSE end at rounding
        ax.set_yscale("log")
    figure = ax.get_figure(root=True)
    assert figure is not None  # it was made with the axes
    return figure


def _text(results: Results) -> str:
    ran = int((results.done | results.failed).sum())
    lines = [f"{results.status}: {ran} of {results.done.size} replicates, {results.seconds:.3g} s"]
    rows = results.summary().texts()
    if len(rows) > 1:
        name = rows[0].index("name")
        kept = [row for row in rows if row[name] in ("name", "control", "state")]
        moved = [[row[name], *row[:name], *row[name + 1 :]] for row in kept]
        lines += grid(moved, keys=name + 1)
    if results.failures:
        lines.append(f"{len(results.failures)} failed, the first: {results.failures[0].error}")
    return "\n".join(lines)
