"""``stochens reproduce``: the paper's two experiments, with a report."""

from __future__ import annotations

import re
from contextlib import nullcontext
from functools import partial
from itertools import groupby
from typing import Any

import click

from .. import cases, paper
from .._base.files import versions
from ..paper.report.page import COLUMNS, require_report
from ..rng import as_key
from ._command import Command
from ._options import DIRECTORY, force_option, json_option, seed_option
from ._output import grid, note, prepared, show_result
from ._unfinished import unfinished
from ._workers import pool, workers_option

# Options of --quick.
QUICK: dict[str, dict[str, Any]] = {
    "power": {"replicates": 10, "samples": 100},
    "tracking": {"replicates": 5, "samples": 100, "n": 30, "m": 24},
}

# Every name that a report may have, whatever the options.
_NAMES = re.compile(r"results\.json|report\.html|(claims|(power|tracking)-figure-\d)\.(png|svg)")


@click.command(
    cls=Command,
    short_help="Run the paper's experiments, write a report.",
    examples=[
        "reproduce --quick --out first-look",
        "reproduce --workers 4",
        "reproduce --workers 4 --resume",
    ],
)
@click.option(
    "--out",
    type=DIRECTORY,
    default="stochens-report",
    metavar="DIR",
    help="For report.html, results.json and the figures.",
)
@force_option
@seed_option
@click.option(
    "--replicates",
    metavar="R",
    type=click.IntRange(min=1),
    help="Repetitions of both experiments.  [default: 100 and 20]",
)
@click.option(
    "--samples",
    metavar="N",
    type=click.IntRange(min=1),
    help="Realizations of each entity.  [default: 1000]",
)
@click.option(
    "--quick",
    is_flag=True,
    help="A first look in seconds, with fewer and smaller runs.",
)
@click.option(
    "--claims/--no-claims",
    "with_claims",
    default=True,
    help="Also check the paper's statements.",
)
@click.option(
    "--case",
    default="ieee14",
    metavar="NAME_OR_FILE",
    help=f"System of the first experiment: {', '.join(cases.CASES)}, or a file as for `control`.",
)
@workers_option
@click.option("--resume", is_flag=True, help="Continue an unfinished run in DIR, if there is one.")
@json_option
def reproduce(
    out: str,
    force: bool,
    seed: int,
    replicates: int | None,
    samples: int | None,
    quick: bool,
    with_claims: bool,
    case: str,
    workers: int,
    resume: bool,
    as_json: bool,
) -> None:
    """Repeat the two experiments of the paper and write a report with the figures.

    Prints the errors after all samples: quantiles and root mean square over the replicates; for
    uniform weights also the exact root mean square, and z, the difference between the mean square
    and its exact value in standard errors.

    A report in DIR is replaced if a run with the same options wrote it, or with --force; other
    files never are. Until it is written, the numbers are kept in DIR/unfinished: after Ctrl-C,
    SIGTERM or a crash --resume continues, with the same results and any number of workers, and
    --force removes them.
    """
    require_report()
    options = {
        "seed": seed,
        "replicates": replicates,
        "samples": samples,
        "quick": quick,
        "claims": with_claims,
        "case": case,
    }
    own = None if case in cases.CASES else cases.from_file(case).system
    first = partial(paper.power, **{"case": case} if own is None else {"given": own})
    directory, earlier = prepared(out, "results.json", _NAMES, options, force)
    key = as_key(seed)
    given = {k: v for k, v in (("replicates", replicates), ("samples", samples)) if v is not None}
    done, checked = [], None
    with (
        unfinished(directory, options, resume=resume, force=force) as folder,
        pool(workers) if workers > 1 else nullcontext() as executor,
    ):
        where: dict[str, Any] = {"executor": executor, "progress": True}
        for name, run in (("power", first), ("tracking", paper.tracking)):
            chosen = {**(QUICK[name] if quick else {}), **given}
            path = folder / f"{name}.study"
            done.append(run(rng=key.child(name), path=path, **where, **chosen))
        if with_claims:
            path = folder / "claims"
            checked = paper.claims(key.child("claims"), quick=quick, path=path, **where)
        for path in earlier:
            path.unlink(missing_ok=True)
        files = paper.write_report(done, directory, claims=checked, options=options)
    rows = paper.final_errors(done)
    summary = {
        "schema": "stochens-reproduce/1",
        "seed": seed,
        "out": out,
        "files": [str(path) for path in files],
        "versions": versions(),
        "claims": None if checked is None else checked.to_dict(),
        "experiments": [
            {
                **{k: getattr(one, k) for k in ("name", "key", "settings", "facts", "seconds")},
                "final": [row for row in rows if row["experiment"] == one.name],
            }
            for one in done
        ],
    }
    text = _table(rows) + ("" if checked is None else f"\n\n{checked.summary}")
    show_result(summary, text, as_json)
    note(f"report: {files[-1]}")


def _table(rows: list[dict[str, Any]]) -> str:
    """The final errors as text, one block per panel."""
    lines = []
    for panel, group in groupby(rows, key=lambda row: row["panel"]):
        shown = list(group)
        quantity, samples = shown[0]["quantity"], shown[0]["samples"]
        lines += ["", f"{panel}  relative error of the {quantity}, N = {samples}"]
        lines += grid([["", *COLUMNS.values(), "exact rms", "z"], *map(_cells, shown)])
    return "\n".join(lines[1:])


def _cells(row: dict[str, Any]) -> list[str]:
    """The method, its errors or why they are zero, and the exact value with z."""
    errors = [f"{row[k]:.3g}" for k in COLUMNS]
    if row["zero"]:
        errors = [*[""] * (len(COLUMNS) - 1), row["zero"]]
    exact = ["", ""] if row["z"] is None else [f"{row['exact_rms']:.3g}", f"{row['z']:+.2f}"]
    return [row["method"], *errors, *exact]
