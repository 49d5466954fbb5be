"""``stochens reproduce``: the paper's two experiments, with a report."""

from __future__ import annotations

import json
import re
from typing import Any

import click

from .. import paper
from .._base.files import versions
from ..paper.report.page import require_report
from ..rng import as_key
from ._options import seed_option
from ._output import note, prepared, show

# Small enough for a first look in seconds; the full run is the default.
QUICK: dict[str, dict[str, Any]] = {
    "power": {"replicates": 10, "samples": 100},
    "tracking": {"replicates": 5, "samples": 100, "n": 30, "m": 24},
}

# Every name that a report may have, whatever the options.
_NAMES = re.compile(r"results\.json|report\.html|(claims|(power|tracking)-figure-\d)\.(png|svg)")


@click.command()
@click.option(
    "--out",
    default="stochens-report",
    show_default=True,
    metavar="DIR",
    help="Where report.html, results.json and the figures go; made if missing.",
)
@click.option("--force", is_flag=True, help="Replace the report of a run with other options.")
@seed_option
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
@click.option(
    "--claims/--no-claims",
    "with_claims",
    default=True,
    show_default=True,
    help="Also check the paper's statements, for a section of the report.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of the table.")
def reproduce(
    out: str,
    force: bool,
    seed: int,
    replicates: int | None,
    samples: int | None,
    quick: bool,
    with_claims: bool,
    as_json: bool,
) -> None:
    """Repeat the two experiments of the paper and write a report with the figures.

    Prints the errors after all samples: quantiles and root mean square over the replicates, for
    uniform weights also the exact root mean square, and z, the distance of the mean square from
    its exact value in standard errors.

    A report in DIR is replaced if the same options made it, or with --force. A file with the name
    of one of the report's that this command did not write, or that was changed since (results.json
    has the SHA-256 of the others), is never replaced: nothing is done then.
    """
    require_report()
    options = {
        "seed": seed,
        "replicates": replicates,
        "samples": samples,
        "quick": quick,
        "claims": with_claims,
    }
    directory, earlier = prepared(out, "results.json", _NAMES, options, force)
    key = as_key(seed)
    given = {k: v for k, v in (("replicates", replicates), ("samples", samples)) if v is not None}
    done = []
    for name, run in (("power", paper.power), ("tracking", paper.tracking)):
        chosen = {**(QUICK[name] if quick else {}), **given}
        done.append(run(rng=key.child(name), progress=True, **chosen))
    checked = None
    if with_claims:
        checked = paper.claims(key.child("claims"), quick=quick, progress=True)
    for path in earlier:
        path.unlink(missing_ok=True)
    files = paper.write_report(done, directory, claims=checked, options=options)
    rows = paper.final_errors(done)
    if as_json:
        summary = {
            "schema": "stochens-reproduce/1",
            "seed": seed,
            "out": out,
            "files": [str(path) for path in files],
            "versions": versions(),
            "claims": None if checked is None else checked.to_dict(),
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
        show(json.dumps(summary, allow_nan=False, indent=2))
    else:
        show(_table(rows))
        if checked is not None:
            show(f"\n{checked.summary}")
    note(f"report: {files[-1]}")


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
        cells = "".join(f"{row[k]:>11.3g}" for k in ("median", "q10", "q90", "rms"))
        exact = "" if row["z"] is None else f"{row['exact_rms']:>11.3g}{row['z']:>+7.2f}"
        lines.append(f"{row['method']:<20}{row['zero'] or cells:>44}{exact}")
    return "\n".join(lines[1:])
