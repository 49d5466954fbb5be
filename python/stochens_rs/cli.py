"""The command ``stochens``: repeat the paper's experiments, or say what is installed.

Exit codes: 0 done, 1 internal error, 2 usage or input, 5 reading or writing files, 130 interrupted.
Results go to stdout, everything else (progress, the files written, errors) to stderr.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import click

from . import experiments, plots, report
from ._threads import get_num_threads
from .exceptions import InputError, InputTypeError, ResourceError
from .experiments._common import versions
from .rng import as_key

__all__ = ["main"]

OK, INTERNAL, USAGE, IO, INTERRUPTED = 0, 1, 2, 5, 130

# Small enough for a first look in seconds; the full run is the default.
QUICK: dict[str, dict[str, Any]] = {
    "power": {"replicates": 10, "samples": 100},
    "tracking": {"replicates": 5, "samples": 100, "n": 30, "m": 24},
}


@click.group(
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(
    versions()["stochens_rs"], prog_name="stochens", message="%(prog)s %(version)s"
)
@click.pass_context
def cli(context: click.Context) -> None:
    """Control of a linear system that is known only through random realizations."""
    if context.invoked_subcommand is None:
        _print(context.get_help())


@cli.command()
@click.option(
    "--out",
    default="stochens-report",
    show_default=True,
    metavar="DIR",
    help="Where report.html, results.json and the figures go; made if missing.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=1,
    show_default=True,
    help="Source of all randomness.",
)
@click.option(
    "--replicates",
    type=click.IntRange(min=1),
    help="Independent repetitions of both experiments.  [default: 100 and 20]",
)
@click.option(
    "--samples",
    type=click.IntRange(min=1),
    help="Realizations of each entity.  [default: 1000]",
)
@click.option(
    "--quick",
    is_flag=True,
    help="A first look in seconds: few replicates and samples, n = 30 in tracking.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of the table.")
def reproduce(
    out: str, seed: int, replicates: int | None, samples: int | None, quick: bool, as_json: bool
) -> None:
    """Repeat the two experiments of the paper and write a report with the figures."""
    plots.require_matplotlib()
    directory = _writable(out)
    key = as_key(seed)
    given = {k: v for k, v in (("replicates", replicates), ("samples", samples)) if v is not None}
    done = []
    for name, run in (("power", experiments.power), ("tracking", experiments.tracking)):
        options = {**(QUICK[name] if quick else {}), **given}
        done.append(run(rng=key.child(name), progress=True, **options))
    files = report.write_report(done, directory)
    rows = report.final_errors(done)
    if as_json:
        summary = {
            "schema": "stochens-reproduce/1",
            "seed": seed,
            "out": out,
            "files": [str(path) for path in files],
            "versions": versions(),
            "experiments": [
                {
                    "name": one.name,
                    "key": one.key,
                    "settings": one.settings,
                    "facts": one.facts,
                    "seconds": one.seconds,
                    "final": [row for row in rows if row["experiment"] == one.name],
                }
                for one in done
            ],
        }
        _print(json.dumps(summary, allow_nan=False, indent=2))
    else:
        _print(_table(rows))
    click.echo(f"report: {files[-1]}", err=True)


@cli.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def info(as_json: bool) -> None:
    """Versions, threads a call may use, and which extras are installed."""
    facts: dict[str, Any] = {**versions(), "threads": get_num_threads()}
    for package in ("click", "tqdm", "matplotlib"):
        try:
            facts[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            facts[package] = None
    if as_json:
        _print(json.dumps(facts, indent=2))
        return
    missing = "not installed (pip install 'stochens_rs[plot]')"
    _print("\n".join(f"{k:<12} {missing if v is None else v}" for k, v in facts.items()))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code; never raises, never prints a traceback.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; default: those of the process.

    Returns
    -------
    int
        0, 1, 2, 5 or 130 (see the top of this file).

    Examples
    --------
    >>> from stochens_rs.cli import main
    >>> main(["reproduce", "--samples", "0"])
    2
    """
    try:
        args = None if argv is None else list(argv)
        code = cli.main(args=args, prog_name="stochens", standalone_mode=False)
        return code if isinstance(code, int) else OK
    except click.ClickException as error:
        return _fail(error.format_message(), USAGE)
    except (click.Abort, KeyboardInterrupt):
        return _fail("interrupted", INTERRUPTED)
    except SystemExit:  # click leaves so when whoever read the output has gone
        return IO
    except OSError as error:
        return _fail(str(error), IO)
    except (InputError, InputTypeError, ResourceError, ImportError) as error:
        return _fail(str(error), USAGE)
    except Exception as error:
        return _fail(f"internal error: {type(error).__name__}: {error}", INTERNAL)


def _fail(message: str, code: int) -> int:
    """One line on stderr."""
    click.echo(f"stochens: {' '.join(message.split())}", err=True)
    return code


def _print(text: str) -> None:
    """To stdout, at once, so that a reader who has gone is noticed here."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _writable(out: str) -> Path:
    """Make the directory and try it before anything is computed."""
    if not out.strip():
        raise click.BadParameter("the directory has no name", param_hint="--out")
    directory = Path(out)
    directory.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=directory):
        return directory


def _table(rows: list[dict[str, Any]]) -> str:
    """The final errors as text, one block per panel."""
    lines = []
    before = None
    head = f"{'':<20}{'median':>11}{'10 %':>11}{'90 %':>11}{'rms':>11}{'exact rms':>11}{'z':>7}"
    for row in rows:
        if row["panel"] != before:
            before = row["panel"]
            lines += [
                "",
                f"{row['panel']}  relative error of the {row['quantity']}, N = {row['samples']}",
                head,
            ]
        cells = "".join(
            f"{'' if row[k] is None else format(row[k], '.3g'):>11}"
            for k in ("median", "q10", "q90", "rms", "exact_rms")
        )
        z = "" if row["z"] is None else f"{row['z']:+.2f}"
        lines.append(f"{row['method']:<20}{cells}{z:>7}")
    return "\n".join(lines[1:])
