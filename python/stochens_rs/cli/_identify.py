"""``stochens identify``: from a table of measured runs to a model and a region."""

from __future__ import annotations

import warnings
from typing import Any

import click
import numpy as np

from .._base.csv_file import Text, csv_files, natural
from .._base.html import listed, within
from .._base.reading import number
from ..exceptions import DataWarning
from ..identification import Model, Trajectories, identify
from ..identification.assumptions import COVARIANCES, DESIGNS, NOISES
from ..identification.gaps import ON_GAP
from ..identification.region import Region
from ..identification.tables import Table
from ._command import Command
from ._options import FILE, Choice, delta_option, force_option, json_option, out_option
from ._output import Out, finite, grid, note, show_result


@click.command(
    "identify",
    cls=Command,
    short_help="Fit a model to measured runs.",
    examples=[
        "identify runs.csv --states x,v --inputs F --by run --time t",
        "identify logs/ --outputs x --inputs F --time t --out m.safetensors",
    ],
    sections={
        "Table": [
            *("states", "outputs", "inputs", "by", "time", "dt", "delay", "on_gap", "last_pairs"),
            *("sep", "decimal", "skip"),
        ],
        "Assumptions": [
            *("design", "noise", "sigma", "covariance", "exact", "intercept"),
            *("window", "pilot", "reference"),
        ],
    },
)
@click.argument("source", metavar="LOGS...", type=FILE, nargs=-1, required=True)
@click.option("--states", metavar="A,B", help="Columns of the states.")
@click.option(
    "--outputs",
    metavar="A,B",
    help="In place of --states: readings of a part of the state.",
)
@click.option("--inputs", metavar="U,V", help="Columns of the inputs.")
@click.option("--by", metavar="COLUMN", help="The column that tells runs apart; else one run.")
@click.option("--time", metavar="COLUMN", help="The column of times (its unit, or s), or of dates.")
@click.option(
    "--dt", metavar="S", type=float, help="Time of a step; then stamps may jitter by 25 %."
)
@click.option("--delay", metavar="K", type=int, default=0, help="Steps until an input acts.")
@click.option(
    "--on-gap",
    type=Choice(ON_GAP),
    metavar="WORD",
    default="split",
    help="At lost rows: split the run, or raise.",
)
@click.option("--sep", metavar="C", help="Between cells; default: as the file shows.")
@click.option("--decimal", metavar="C", help="Of numbers: . or ,; default: as the file shows.")
@click.option("--skip", metavar="K", type=int, default=0, help="Lines above the names to skip.")
@click.option(
    "--design",
    type=Choice(DESIGNS),
    metavar="D",
    default="adaptive",
    help="adaptive, or independent of the noise.",
)
@click.option("--last-pairs", is_flag=True, help="Use only the last step of each run.")
@click.option(
    "--noise",
    type=Choice(NOISES),
    metavar="LAW",
    default="gaussian",
    help=f"{', '.join(NOISES)}.",
    show_default=False,
)
@click.option(
    "--sigma",
    metavar="S",
    type=float,
    help="Known deviation of the noise; bounded: its largest 2-norm.",
)
@click.option(
    "--covariance",
    type=Choice([one for one in COVARIANCES if one != "known"]),
    metavar="C",
    default="full",
    help="Of the noise: full, diagonal or scalar.",
)
@click.option(
    "--exact",
    metavar="A,B",
    help="States whose noise is 0, or follows from the others.",
)
@click.option("--intercept", is_flag=True, help="Fit an offset c as well.")
@click.option(
    "--window",
    metavar="W",
    help="Of outputs: 8 for 8 lags, 0.8,4 for 4 filters of pole 0.8.",
)
@click.option(
    "--pilot",
    metavar="P",
    help="Open loop: share or number of first runs, or a model.",
)
@click.option(
    "--reference",
    metavar="T",
    help="With --pilot: task of plans, like 1,0:0,0:10.",
)
@delta_option("Probability that the region misses the system.")
@out_option("identify", "the model to a file .safetensors")
@force_option
@json_option
@click.pass_context
def identify_command(
    context: click.Context,
    /,
    source: tuple[str, ...],
    states: str | None,
    outputs: str | None,
    inputs: str | None,
    by: str | None,
    time: str | None,
    dt: float | None,
    delay: int,
    on_gap: Any,
    design: Any,
    last_pairs: bool,
    sep: str | None,
    decimal: str | None,
    skip: int,
    noise: Any,
    sigma: float | None,
    covariance: Any,
    exact: str | None,
    intercept: bool,
    window: str | None,
    pilot: str | None,
    reference: str | None,
    delta: float,
    as_json: bool,
    **_: Any,
) -> None:
    """Fit x(k+1) = A x(k) + B u(k) + c + w(k) to runs in CSV files, with a region.

    LOGS are files, folders of .csv files, or patterns; each a run, unless --by.
    """
    paths = csv_files(sorted(source, key=natural))
    how = Text.checked(sep, decimal, skip)
    if (states is None) == (outputs is None) or inputs is None:
        known = ", ".join(map(str, Table.of_file(paths[0], how).names))
        raise click.UsageError(f"give --states or --outputs, and --inputs, of the columns {known}")
    files = Out(context, [".safetensors", ".state"])
    read = "states" if outputs is None else "outputs"
    x, u = _names(f"--{read}", states or outputs or ""), _names("--inputs", inputs)
    columns: dict[str, Any] = {read: x, "inputs": u, "by": by, "time": time, "on_gap": on_gap}
    if outputs is None:
        columns["delay"] = delay
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always", DataWarning)
        data = Trajectories.from_csv(paths, **columns, dt=dt, **how._asdict())
    unused: list[str] = []
    if len(paths) == 1 and by is None:
        table = Table.of_file(paths[0], how)
        used = set(map(table.title, [*x, *u, time]))
        unused = [one for one in table.names if one not in used]
    if last_pairs:
        data = data.last_pairs()
    elif design == "independent" and not data.single:
        raise click.UsageError(
            "--design independent is for single steps, since later states of a run contain its "
            "earlier noise: add --last-pairs, or leave --design out"
        )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)  # the table lists them
        model = identify(
            data,
            design=design,
            noise=noise,
            sigma=sigma,
            covariance=covariance,
            exact=() if exact is None else _names("--exact", exact),
            intercept=intercept,
            delay=0 if outputs is None else delay,
            **_window(window),
            pilot=None if pilot is None else _pilot(pilot),
            reference=None if reference is None else _task(reference),
        )
    region = model.region(delta)
    if files.file is not None:
        model.save(files.file)
    lost = [str(one.message).replace("dt=", "--dt ") for one in seen]
    careful = [*lost, *model.warnings, *_useless(model, data, region)]
    facts = {**_facts(model, data, region, files.file), "unused": unused, "warnings": careful}
    lines = [_text(model, data, region)]
    if unused:
        lines.append(
            f"not used   {listed(unused)}: all rows are one run; --by COLUMN tells runs apart"
        )
    lines += [f"warning    {text}" for text in careful]
    if last_pairs and _exact_is_possible(model):
        lines.append(
            "hint       --design independent would use exact laws, with smaller bounds; declare it "
            "if no state or input depends on the noise of a next state"
        )
    show_result(facts, "\n".join(lines), as_json)
    if files.file is not None:
        note(f"written: {files.file}")
    files.write(facts, model.plot)


def _names(option: str, text: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise click.BadParameter(f"{text!r} has an empty name", param_hint=option)
    return names


def _pilot(text: str) -> float | Model:
    """A share or a number of runs, or a model from a file."""
    try:
        value = number(text)
    except ValueError:
        return Model.load(text)
    return int(value) if value.is_integer() else value


def _task(text: str) -> tuple[list[float], list[float], int]:
    """Read ``1,0:0,0:10``."""
    try:
        start, goal, steps = text.split(":")
        return _numbers(start), _numbers(goal), int(steps)
    except ValueError:
        raise click.BadParameter(
            f"{text!r} must be a start, a target and steps, like 1,0:0,0:10",
            param_hint="--reference",
        ) from None


def _numbers(text: str) -> list[float]:
    return [number(cell) for cell in text.split(",")]


def _window(text: str | None) -> dict[str, Any]:
    if text is None:
        return {}
    pole, comma, count = text.partition(",")
    try:
        return {"filters": (float(pole), int(count))} if comma else {"lags": int(pole)}
    except ValueError:
        raise click.BadParameter(f"{text!r} must be as 8 or 0.8,4", param_hint="--window") from None


def _deviations(model: Model) -> list[float] | None:
    covariance = model.covariance
    return None if covariance is None else np.sqrt(np.diag(covariance)).tolist()


def _facts(model: Model, data: Trajectories, region: Region, save: str | None) -> dict[str, Any]:
    checks, deviations = model.checks, _deviations(model)
    return {
        "schema": "stochens-identify/1",
        "runs": len(data),
        "pieces": len(data.pieces),
        "lost_rows": data.lost,
        "pairs": model.size,
        "states": list(model.state_names),
        "outputs": list(model.outputs),
        "window": None if model.window is None else model.window.text,
        "inputs": list(model.input_names),
        "dt": model.dt,
        "A": model.A.tolist(),
        "B": model.B.tolist(),
        "c": None if model.c is None else model.c.tolist(),
        "residual_deviations": deviations,
        "rank": model.rank,
        "unknowns": len(region.centre[0]),
        "missing": list(model.missing),
        "region": {
            "delta": region.delta,
            "radius": finite(region.radius),
            "centre": region.centre.tolist(),
            "entry_bounds": finite(region.entry_bounds),
            "assumption": region.assumption,
        },
        "checks": None if checks is None else {"exact": checks.exact, **checks.p_values},
        "saved": save,
    }


def _text(model: Model, data: Trajectories, region: Region) -> str:
    dt = "" if model.dt is None else f", {model.dt:g} s apart"
    columns = [*model._regressors][: len(region.centre[0])]
    deviations = _deviations(model) or [np.nan] * model.n_outputs
    body = [
        [f"{name}(k+1)", *map(within, centre, bound), f"{deviation:.3g}"]
        for name, centre, bound, deviation in zip(
            model.outputs, region.centre, region.entry_bounds, deviations, strict=True
        )
    ]
    table = [["", *columns, "deviation"], *body]
    if model.window is not None:  # many columns: one row for each
        table = [list(row) for row in zip(*table, strict=True)]
    window = "" if model.window is None else f"{model.window!r}"[1:-1] + "; "
    lines = [
        f"{data._counts}{dt}; {window}rank {model.rank} of {len(columns)}",
        "",
        *grid(table),
        "",
        f"region     holds with {100 * (1 - region.delta):g} %, radius {region.radius:.4g}",
        f"for        {region.assumption}",
    ]
    if model.checks is not None:
        kind = "p" if model.checks.exact else "p, approximate"
        tests = ", ".join(f"{name} {p:.2g}" for name, p in model.checks.p_values.items())
        lines.append(f"residuals  {tests} ({kind})")
    return "\n".join(lines)


def _exact_is_possible(model: Model) -> bool:
    """Whether an independent design would have a region by exact laws."""
    return model.design == "adaptive" and model.noise == "gaussian" and model.window is None


def _useless(model: Model, data: Trajectories, region: Region) -> list[str]:
    """A warning with its cure if a bound is infinite, or no entry of a row differs from 0."""
    bounds, size = region.entry_bounds, np.abs(region.centre)
    rows = [
        name
        for name, bound, value in zip(model.outputs, bounds, size, strict=True)
        if np.isinf(bound).any() or (bound >= value).all()
    ]
    if not rows:
        return []
    cures = ["measure more runs"]
    if _exact_is_possible(model):
        pairs = "" if data.single else "--last-pairs "
        cures.append(f"declare {pairs}--design independent if it is")
    if model.assumptions.known is None:
        cures.append("give --sigma if the noise is known")
    return [
        f"the bounds of {listed([f'{name}(k+1)' for name in rows])} are infinite or larger "
        f"than every coefficient: {', or '.join(cures)}"
    ]
