"""One page that says what was run, shows it, and says where the paper cannot be followed.

`write_report` turns finished experiments into ``report.html`` (self-contained: figures and style
are inlined, nothing is loaded from anywhere), ``results.json`` and the figures as PNG and SVG.
All numbers in the text are read from the experiments; nothing is computed anew and no number of
the paper is repeated.
"""

from __future__ import annotations

import base64
import inspect
import os
import tempfile
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import experiments as _experiments
from . import plots
from ._report_claims import CAPTION, claims_table
from ._report_text import agreements, caption, deviations, number
from .experiments._common import versions, write_listed

if TYPE_CHECKING:
    from .experiments import Experiment
    from .verdicts import Claims

__all__ = ["final_errors", "write_report"]

SCHEMA = "stochens-results/1"

_STYLE = """
:root { color-scheme: light; }
body { font: 17px/1.6 "Charter", "Bitstream Charter", "Georgia", serif; color: #222;
  background: #fff; max-width: 62rem; margin: 0 auto; padding: 2.5rem 1.5rem 5rem; }
h1, h2, h3, table, figcaption, .lead {
  font-family: "Inter", "Helvetica Neue", "Arial", sans-serif; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .4rem; }
h2 { font-size: 1.25rem; margin: 2.8rem 0 .8rem; padding-top: .9rem; border-top: 1px solid #ddd; }
h3 { font-size: 1.02rem; margin: 1.7rem 0 .3rem; }
p { max-width: 44rem; }
sub { line-height: 0; }
.lead { color: #555; font-size: .98rem; }
figure { margin: 1.6rem 0 2.2rem; }
figure img { width: 100%; height: auto; display: block; }
figcaption { font-size: .86rem; line-height: 1.5; color: #444; max-width: 52rem;
  margin-top: .5rem; }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums;
  margin: 1rem 0; }
th { text-align: left; font-weight: 600; border-bottom: 1.5px solid #888; }
th, td { padding: .22rem 1.4rem .22rem 0; vertical-align: baseline; }
td.n, th.n { text-align: right; white-space: nowrap; }
tr.panel td { border-top: 1px solid #ddd; padding-top: .6rem; font-weight: 600; }
.settings th { border: 0; color: #555; font-weight: 500; white-space: nowrap; }
.settings td { overflow-wrap: anywhere; }
.wide { overflow-x: auto; }
pre { background: #f4f4f1; padding: .8rem 1rem; overflow-x: auto; font-size: .84rem;
  line-height: 1.45; }
code { font-size: .88em; }
.claims td { padding: .55rem 1.2rem .55rem 0; border-top: 1px solid #ddd; vertical-align: top;
  max-width: 26rem; }
.claims .evidence { color: #555; font-size: .94em; }
.verdict { font-weight: 600; white-space: nowrap; }
.holds { color: #00795a; } .corrected { color: #8a6100; } .false { color: #b03a00; }
"""


_LEAD = """Controls computed from random realizations of a linear system: how wrong they are after
N samples, by the method that averages the samples; measured over independent replicates and, for
uniform weights, beside the exact value."""
_NOTE = """Product fusion unless marked as diagonal. z: distance of the mean square error from its
exact value, in standard errors. A panel without a figure of its own is given here only."""
_SAME = """The same key gives the same samples on any number of threads. Every error of every
replicate is in <code>results.json</code>."""


def final_errors(experiments: Sequence[Experiment]) -> list[dict[str, Any]]:
    """One row per panel and method: the errors after all samples.

    Parameters
    ----------
    experiments : sequence of Experiment

    Returns
    -------
    list of dict
        Keys "experiment", "panel", "quantity", "method", "samples", "replicates"; "median",
        "q10", "q90", "rms" over the replicates; "zero", why all of them count as zero, or None;
        "exact_rms" and "z" (None where no exact value is known).

    Examples
    --------
    >>> from stochens_rs.experiments import power
    >>> from stochens_rs.report import final_errors
    >>> final_errors([power(rng=1, replicates=2, samples=20)])[0]["method"]
    'uniform'
    """
    rows = []
    for experiment in experiments:
        for panel in experiment.panels:
            for curve in panel.curves:
                low, high = curve.band
                exact, z, worst = curve.exact_rms, curve.z, curve.errors[:, -1].max()
                rows.append(
                    {
                        "experiment": experiment.name,
                        "panel": panel.name,
                        "quantity": panel.quantity,
                        "method": curve.name,
                        "samples": int(experiment.sizes[-1]),
                        "replicates": experiment.replicates,
                        "median": float(curve.median[-1]),
                        "q10": float(low[-1]),
                        "q90": float(high[-1]),
                        "rms": float(curve.rms[-1]),
                        "zero": panel.zero_label if worst <= panel.zero_level else None,
                        "exact_rms": None if exact is None else float(exact[-1]),
                        "z": None if z is None else float(z[-1]),
                    }
                )
    return rows


def write_report(
    experiments: Sequence[Experiment],
    outdir: str | os.PathLike[str],
    *,
    claims: Claims | None = None,
    options: Mapping[str, Any] | None = None,
    title: str = "Steering a linear system known only through random realizations",
) -> list[Path]:
    """Write the report, the data and the figures into one directory.

    Parameters
    ----------
    experiments : sequence of Experiment
        What :func:`stochens_rs.experiments.power` and ``tracking`` return; any non-empty selection.
    outdir : path
        Directory; made if it does not exist. Files of the same name are replaced.
    claims : Claims, optional
        What :func:`stochens_rs.claims` returns: a section with one row per statement.
    options : mapping, optional
        What the run was asked for: kept in ``results.json``, beside the SHA-256 of every
        file.
    title : str
        Heading of the page.

    Returns
    -------
    list of Path
        ``results.json``, the PNG and SVG of every figure, and last ``report.html``.

    Raises
    ------
    ImportError
        matplotlib is not installed.
    OSError
        The directory cannot be made or written.
    ValueError
        `experiments` is empty.
    """
    if not experiments:
        raise ValueError("`experiments` must contain at least one experiment")
    plots.require_matplotlib()
    directory = Path(outdir)
    directory.mkdir(parents=True, exist_ok=True)
    drawn = {
        name: made
        for experiment in experiments
        for name, made in plots.figures(experiment, shown=False).items()
    }
    if claims is not None:
        drawn["claims"] = plots.claims(claims, shown=False)
    results = {
        "schema": SCHEMA,
        "options": dict(options or {}),
        "versions": versions(),
        "experiments": [experiment.to_dict() for experiment in experiments],
    }
    if claims is not None:
        results["claims"] = claims.to_dict()
    with tempfile.TemporaryDirectory(dir=directory) as made:
        page = Path(made, "report.html")
        figures = plots.save_figures(drawn, made)
        page.write_text(_page(title, experiments, claims, page.parent), encoding="utf-8")
        return write_listed(directory, "results.json", results, [*figures, page])


def _page(
    title: str, experiments: Sequence[Experiment], claims: Claims | None, directory: Path
) -> str:
    """The whole page; figures are read back from `directory`."""
    by_name = {experiment.name: experiment for experiment in experiments}
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{escape(title)}</h1>",
        f'<p class="lead">{_LEAD}</p>',
        "<h2>What was run</h2>",
        *(_settings(experiment) for experiment in experiments),
        "<h2>Figures</h2>",
        *(
            _figure(experiment, name, directory)
            for experiment in experiments
            for name in _names(experiment)
        ),
        "<h2>Errors after all samples</h2>",
        _table(final_errors(experiments)),
        "<h2>What agrees with the paper</h2>",
        *(f"<p>{text}</p>" for text in agreements(by_name)),
        "<h2>What cannot agree, and why</h2>",
        *(f"<h3>{escape(head)}</h3><p>{text}</p>" for head, text in deviations(by_name)),
        *([] if claims is None else _claims(claims, directory)),
        "<h2>To repeat it</h2>",
        _repeat(experiments),
        "</body></html>",
    ]
    return "\n".join(parts) + "\n"


def _settings(experiment: Experiment) -> str:
    """A table of everything that determines the numbers."""
    s = experiment.settings
    solves = "; ".join(_solves(name, one) for name, one in experiment.facts["alse"].items())
    rows = {
        "system": f"{s['system']}, n = {s['n']}, m = {s['m']}",
        "samples": f"N = {s['samples']} realizations of each entity, errors taken at "
        f"{experiment.sizes.size} sizes",
        "replicates": f"{experiment.replicates}, same system and states, fresh samples",
        "ALSE": f"{solves}; tolerance {number(s['tol'])}",
        "key": experiment.key,
        "versions": ", ".join(f"{k} {v}" for k, v in experiment.versions.items()),
        "time": "< 0.1 s" if experiment.seconds < 0.1 else f"{experiment.seconds:.1f} s",
    }
    if "angle_std" in s:
        rows["initial state"] = (
            f"Gaussian: angles with standard deviation {s['angle_std']:g} rad, "
            f"speeds {s['speed_std']:g} rad/s; target: the origin"
        )
    body = "".join(f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in rows.items())
    return f'<h3>{escape(experiment.title)}</h3><table class="settings">{body}</table>'


def _solves(name: str, one: dict[str, Any]) -> str:
    """How the ALSE solves for one entity ended."""
    ended = ", ".join(f"{count} {status}" for status, count in one["statuses"].items())
    gap = number(one["worst_relative_gap"])
    return f"{name}: {one['solves']} solves ({ended}), worst relative gap {gap}"


def _names(experiment: Experiment) -> list[str]:
    """Numbers of the figures of one experiment, in order."""
    return list(dict.fromkeys(p.figure for p in experiment.panels if p.figure is not None))


def _figure(experiment: Experiment, name: str, directory: Path) -> str:
    """One inlined figure with its caption."""
    path = directory / f"{experiment.name}-figure-{name}.svg"
    return _inlined(path, f"Figure {name}: {experiment.title}", caption(experiment, name))


def _claims(claims: Claims, directory: Path) -> list[str]:
    """The section on the paper's statements."""
    return [
        "<h2>The paper, statement by statement</h2>",
        _inlined(directory / "claims.svg", "Tail bounds, and SLSE against uniform", CAPTION),
        claims_table(claims),
    ]


def _inlined(path: Path, alt: str, text: str) -> str:
    source = "data:image/svg+xml;base64," + base64.b64encode(path.read_bytes()).decode("ascii")
    return (
        f'<figure><img src="{source}" alt="{escape(alt)}"><figcaption>{text}</figcaption></figure>'
    )


def _table(rows: list[dict[str, Any]]) -> str:
    """The final errors; each panel under a heading of its own."""
    columns = ("median", "10 %", "90 %", "rms", "exact rms", "z")
    head = "".join(f'<th class="n">{name}</th>' for name in columns)
    body = [f"<tr><th>relative error</th>{head}</tr>"]
    before = None
    for row in rows:
        if row["panel"] != before:
            before = row["panel"]
            body.append(f'<tr class="panel"><td colspan="7">{escape(_heading(row))}</td></tr>')
        figures = [row[k] for k in ("median", "q10", "q90", "rms", "exact_rms")]
        cells = "" if row["zero"] is None else f'<td class="n" colspan="4">{row["zero"]}</td>'
        cells += "".join(
            f'<td class="n">{"" if value is None else number(value)}</td>'
            for value in (figures if row["zero"] is None else figures[4:])
        )
        z = "" if row["z"] is None else f"{row['z']:+.2f}"
        body.append(f'<tr><td>{escape(row["method"])}</td>{cells}<td class="n">{z}</td></tr>')
    return f'<div class="wide"><table>{"".join(body)}</table></div><p>{_NOTE}</p>'


def _heading(row: dict[str, Any]) -> str:
    """Write "3b" as "3(b)"; a panel without a figure is named by its quantity alone."""
    name = row["panel"]
    return f"{name[0]}({name[1:]}) {row['quantity']}" if len(name) == 2 else row["quantity"]


def _repeat(experiments: Sequence[Experiment]) -> str:
    """Lines of Python that give the same numbers."""
    calls = []
    for experiment in experiments:
        parameters = inspect.signature(getattr(_experiments, experiment.name)).parameters
        options = {k: v for k, v in experiment.settings.items() if k in parameters}
        lines = [f"rng=se.Key.from_hex({experiment.key!r})"]
        lines += [f"{name}={value!r}" for name, value in options.items()]
        body = "".join(f"    {line},\n" for line in lines)
        calls.append(f"se.experiments.{experiment.name}(\n{body})")
    code = escape("import stochens_rs as se\n\n" + "\n".join(calls))
    return f"<pre>{code}</pre><p>{_SAME}</p>"
