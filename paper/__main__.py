"""``python -m paper reproduce`` and ``python -m paper claims``."""

from __future__ import annotations

import json
import re
import signal
import sys
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from functools import partial
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import matplotlib  # noqa: F401 - missing, it shall be so before hours of work

from stochens_rs import cases
from stochens_rs.exceptions import StochensError
from stochens_rs.plots import save_figures
from stochens_rs.rng import as_key

from .common import versions, write_listed
from .experiments import power, tracking
from .report import final_errors, write_report
from .report.page import COLUMNS
from .results import Folder, replaceable
from .verdicts import claims as checked_claims

# Options of --quick.
QUICK: dict[str, dict[str, Any]] = {
    "power": {"replicates": 10, "samples": 100},
    "tracking": {"replicates": 5, "samples": 100, "n": 30, "m": 24},
}
OF_CLAIMS = re.compile(r"claims\.(json|png|svg)")
OK, CONTRADICTED, INTERRUPTED = 0, 3, 130  # exit codes beside those of click


@click.group(context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
def main() -> None:
    """Repeat the experiments of the paper and check its statements.

    Exit codes: 0 done, 1 an error, 2 usage, 3 a verdict is contradicted, 130 Ctrl-C or SIGTERM.
    """


@main.command()
@click.option("--out", default="results", metavar="DIR", help="For the report and the figures.")
@click.option("--seed", default=1, type=click.IntRange(min=0), help="Seed of all random numbers.")
@click.option("--replicates", type=click.IntRange(min=1), help="Repetitions; else 100 and 20.")
@click.option("--samples", type=click.IntRange(min=1), help="Realizations; else 1000.")
@click.option("--quick", is_flag=True, help="A first look in seconds: fewer and smaller runs.")
@click.option("--claims/--no-claims", "with_claims", default=True, help="Check the statements.")
@click.option("--case", default="ieee14", help=f"{', '.join(cases.CASES)}, or a file of a system.")
@click.option("--workers", default=1, type=click.IntRange(1, 1024), help="Processes.")
@click.option("--resume", is_flag=True, help="Continue an unfinished run in DIR.")
@click.option("--force", is_flag=True, help="Replace the results of a run with other options.")
def reproduce(
    out: str,
    seed: int,
    replicates: int | None,
    samples: int | None,
    quick: bool,
    with_claims: bool,
    case: str,
    workers: int,
    resume: bool,
    force: bool,
) -> None:
    """Repeat the two experiments of the paper and write a report with the figures.

    Prints the errors after all samples: quantiles and root mean square over the replicates; for
    uniform weights also the exact root mean square, and z, the difference between the mean square
    and its exact value in standard errors. Until the report is written, the numbers are kept in
    DIR/unfinished, from which --resume continues with the same results.
    """
    options = {
        "seed": seed,
        "replicates": replicates,
        "samples": samples,
        "quick": quick,
        "claims": with_claims,
        "case": case,
    }
    own = None if case in cases.CASES else cases.from_file(case).system
    first = partial(power, **{"case": case} if own is None else {"given": own})
    folder = Folder(Path(out), options, resume=resume, force=force)
    key = as_key(seed)
    given = {k: v for k, v in (("replicates", replicates), ("samples", samples)) if v is not None}
    done, checked = [], None
    with _pool(workers) if workers > 1 else nullcontext() as executor:
        where: dict[str, Any] = {"executor": executor, "progress": True}
        for name, run in (("power", first), ("tracking", tracking)):
            chosen = {**(QUICK[name] if quick else {}), **given}
            path = folder.unfinished / f"{name}.study"
            done.append(run(rng=key.child(name), path=path, **where, **chosen))
        if with_claims:
            path = folder.unfinished / "claims"
            checked = checked_claims(key.child("claims"), quick=quick, path=path, **where)
    folder.clear()
    files = write_report(done, folder.path, claims=checked, options=options)
    folder.finish()
    print(_table(final_errors(done)))
    if checked is not None:
        print(f"\n{checked.summary}")
    click.echo(f"report: {files[-1]}", err=True)


@main.command()
@click.option("--seed", default=1, type=click.IntRange(min=0), help="Seed of all random numbers.")
@click.option("--quick", is_flag=True, help="Fewer runs: a second or two instead of ten.")
@click.option("--out", metavar="DIR", help="For claims.json and the figure; other files stay.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
def claims(seed: int, quick: bool, out: str | None, as_json: bool) -> int:
    """Check every definition, lemma, algorithm and figure of the paper.

    For each: what the paper says, whether it holds, what is true instead, and the evidence, which
    is computed anew.
    """
    options = {"seed": seed, "quick": quick}
    if out is not None:
        replaceable(Path(out), "claims.json", OF_CLAIMS, options, force=True)
    found = checked_claims(seed, quick=quick, progress=True)
    print(json.dumps(found.to_dict(), indent=2) if as_json else f"{found}\n\n{found.summary}")
    if out is not None:
        directory = Path(out)
        directory.mkdir(parents=True, exist_ok=True)
        figures = save_figures({"claims": found.plot()}, directory)
        facts = {**found.to_dict(), "versions": versions(), "options": options}
        write_listed(directory, "claims.json", facts, figures)
    return OK if found.confirmed else CONTRADICTED


def _pool(workers: int) -> ProcessPoolExecutor:
    """Processes that leave Ctrl-C to this one."""
    ignored = (signal.SIGINT, signal.SIG_IGN)
    context = get_context("spawn")
    return ProcessPoolExecutor(workers, context, initializer=signal.signal, initargs=ignored)


def _table(rows: list[dict[str, Any]]) -> str:
    """The final errors as text, one block per panel."""
    lines = []
    for panel, group in groupby(rows, key=lambda row: row["panel"]):
        shown = list(group)
        quantity, samples = shown[0]["quantity"], shown[0]["samples"]
        lines += ["", f"{panel}  relative error of the {quantity}, N = {samples}"]
        cells = [["", *COLUMNS.values(), "exact rms", "z"], *map(_cells, shown)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        for row in cells:
            texts = [row[0].ljust(widths[0])]
            texts += [cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True)]
            lines.append("  ".join(texts).rstrip())
    return "\n".join(lines[1:])


def _cells(row: dict[str, Any]) -> list[str]:
    """The method, its errors or why they are zero, and the exact value with z."""
    errors = [f"{row[k]:.3g}" for k in COLUMNS]
    if row["zero"]:
        errors = [*[""] * (len(COLUMNS) - 1), row["zero"]]
    exact = ["", ""] if row["z"] is None else [f"{row['exact_rms']:.3g}", f"{row['z']:+.2f}"]
    return [row["method"], *errors, *exact]


def run(arguments: list[str] | None = None) -> int:
    """Run a command; what goes wrong is one line on standard error and an exit code."""
    try:
        return main(arguments, prog_name="python -m paper", standalone_mode=False) or 0
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        click.echo("paper: interrupted; what was computed is kept: --resume continues", err=True)
        return INTERRUPTED
    except (StochensError, OSError) as error:
        click.echo(f"paper: {error}", err=True)
        return 1


if __name__ == "__main__":
    sys.exit(run())
