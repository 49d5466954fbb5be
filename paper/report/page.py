"""The report: what was run, the figures, and where the results must differ from the paper.

`write_report` turns finished experiments into ``report.html`` (self-contained: figures and style
are inlined, nothing is loaded from anywhere), ``results.json`` and the figures as PNG and SVG.
The text is in the templates beside this file, one for each section. All its numbers are read from
the experiments; nothing is computed here.
"""

from __future__ import annotations

import inspect
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from stochens_rs.plots import save_figures

from .. import experiments as _experiments
from ..common import versions, write_listed
from ..methods import STYLES
from .drawings import claims_figure, figure
from .formulas import gap, mathml, number, percent, readable, thousands

if TYPE_CHECKING:
    from ..curves import Panel
    from ..experiment import Experiment
    from ..verdicts.records import Claims

SCHEMA = "stochens-report/1"
# Columns of the table of final errors that hold numbers: key in `final_errors`, heading.
COLUMNS = {"median": "median", "q10": "10 %", "q90": "90 %", "rms": "rms"}

# Sections of the page: id and name of the template, heading.
SECTIONS = (
    ("figures", "Figures"),
    ("errors", "Errors after all samples"),
    ("agreements", "What agrees with the paper"),
    ("deviations", "What cannot agree, and why"),
    ("claims", "The paper, statement by statement"),
    ("settings", "What was run"),
    ("repeat", "To repeat it"),
)


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
    >>> from paper import power
    >>> from paper import final_errors
    >>> final_errors([power(rng=1, replicates=2, samples=20)])[0]["method"]
    'uniform'
    """
    return [
        row
        for experiment in experiments
        for panel in experiment.panels
        for row in _rows(experiment, panel)
    ]


def _rows(experiment: Experiment, panel: Panel) -> Iterator[dict[str, Any]]:
    for curve in panel.curves:
        low, high = curve.band
        exact, z, worst = curve.exact_rms, curve.z, curve.errors[:, -1].max()
        yield {
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
        What :func:`paper.power` and ``tracking`` return; any non-empty selection.
    outdir : path
        Directory; made if it does not exist. Files of the same name are replaced.
    claims : Claims, optional
        What :func:`paper.claims` returns: a section with one row per statement.
    options : mapping, optional
        The options of the run: kept in ``results.json``, beside the SHA-256 of every
        file.
    title : str
        Heading of the page.

    Returns
    -------
    list of Path
        ``results.json``, the PNG and SVG of every figure, and last ``report.html``.

    Raises
    ------
    OSError
        The directory cannot be made or written.
    ValueError
        `experiments` is empty.
    """
    if not experiments:
        raise ValueError("`experiments` must contain at least one experiment")
    directory = Path(outdir)
    directory.mkdir(parents=True, exist_ok=True)
    drawn = {name: made for experiment in experiments for name, made in experiment.plot().items()}
    results = {
        "schema": SCHEMA,
        "options": dict(options or {}),
        "versions": versions(),
        "experiments": [experiment.to_dict() for experiment in experiments],
    }
    if claims is not None:
        drawn["claims"] = claims.plot()
        results["claims"] = claims.to_dict()
    with tempfile.TemporaryDirectory(dir=directory) as made:
        page = Path(made, "report.html")
        figures = save_figures(drawn, made)
        text = render("report.html.j2", experiments, title=title, claims=claims)
        page.write_text(text, encoding="utf-8")
        return write_listed(directory, "results.json", results, [*figures, page])


def render(template: str, experiments: Sequence[Experiment], **more: Any) -> str:
    """Fill in one of the templates."""

    def html(written: Callable[[Any], str]) -> Callable[[Any], Markup]:
        return lambda value: Markup(written(value))

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(
        number=html(lambda value: readable(number(value))),
        percent=lambda share: percent(share).replace(" ", "\u00a0"),
        thousands=thousands,
        readable=html(readable),
        mathml=html(mathml),
        breakable=html(_breakable),
    )
    named = {experiment.name: experiment for experiment in experiments}
    return environment.get_template(template).render(
        {
            "experiments": experiments,
            "power": named.get("power"),
            "tracking": named.get("tracking"),
            "claims": None,
            "sections": [one for one in SECTIONS if one[0] != "claims" or more.get("claims")],
            "tables": tables(experiments),
            "columns": COLUMNS,
            "methods": [one for (_, fusion), one in STYLES.items() if fusion == "product"],
            "code": _code(experiments),
            "figure": figure,
            "claims_figure": claims_figure,
            "last": last,
            "error": error,
            "or_zero": or_zero,
            "gap": html(lambda value: readable(gap(value))),
            "has_zeros": has_zeros,
            **more,
        }
    )


Rows = list[tuple[dict[str, Any], str]]


def tables(experiments: Sequence[Experiment]) -> list[tuple[Panel, Rows]]:
    """Each panel with its rows of `final_errors`, and what the figures call their methods."""
    return [
        (
            panel,
            [
                (row, STYLES[curve.look].label)
                for row, curve in zip(_rows(experiment, panel), panel.curves, strict=True)
            ],
        )
        for experiment in experiments
        for panel in experiment.panels
    ]


def last(panel: Panel, method: str) -> float:
    """Median error after all samples."""
    return float(panel.curve(method).median[-1])


def error(panel: Panel, method: str) -> str:
    """Median error after all samples, in per cent."""
    value = last(panel, method)
    return panel.zero_label if value <= panel.zero_level else percent(value).replace(" ", "\u00a0")


def or_zero(value: float, panel: Panel, zero: str | None = None) -> Markup:
    """A number, or the reason why it counts as zero."""
    from markupsafe import Markup

    if value > panel.zero_level:
        return Markup(readable(number(value)))
    return Markup(escape("0" if value == 0 else zero or panel.zero_label))


def _breakable(key: str) -> str:
    """Hexadecimal digits with places where a line may end."""
    return "<wbr>".join(escape(key[k : k + 8]) for k in range(0, len(key), 8))


def has_zeros(experiment: Experiment, figure: str) -> bool:
    """Whether a figure shows errors that cannot be told from zero."""
    curves = [(p, c) for p in experiment.panels if p.figure == figure for c in p.curves]
    return any(bool((curve.errors <= panel.zero_level).any()) for panel, curve in curves)


def _code(experiments: Sequence[Experiment]) -> str:
    """Lines of Python that give the same numbers."""
    calls = []
    for experiment in experiments:
        parameters = inspect.signature(getattr(_experiments, experiment.name)).parameters
        options = {k: v for k, v in experiment.settings.items() if k in parameters}
        lines = [f"rng=se.Key.from_hex({experiment.key!r})"]
        lines[:0] = ["own_system"] if "given" in parameters and "case" not in options else []
        lines += [f"{name}={value!r}" for name, value in options.items()]
        body = "".join(f"    {line},\n" for line in lines)
        calls.append(f"paper.{experiment.name}(\n{body})")
    return "import paper\nimport stochens_rs as se\n\n" + "\n".join(calls)
