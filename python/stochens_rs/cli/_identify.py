"""``stochens identify``: from a table of measured runs to a model and a region."""

from __future__ import annotations

import warnings
from typing import Annotated, Any

import click
import numpy as np

from .._base.reading import number
from .._base.show import listed
from ..data.table import Table, csv_files, natural
from ..exceptions import DataWarning
from ..identification import Model, Noise, Pilot, Trajectories, Window, identify
from ..identification.region import Region
from . import _command as io


def _pilot(text: str) -> float | Model:
    """A share or a number of runs, or a model from a file."""
    try:
        value = number(text)
    except ValueError:
        return Model.load(text)
    return int(value) if value.is_integer() else value


def _task(text: str) -> tuple[list[float], list[float], int]:
    start, goal, steps = text.split(":")
    return io.numbers(start), io.numbers(goal), int(steps)


def _window(text: str) -> dict[str, Any]:
    pole, comma, count = text.partition(",")
    return {"filters": (float(pole), int(count))} if comma else {"lags": int(pole)}


Past = Annotated[Any, io.Parsed(_window, "as 8 or 0.8,4")]
Task = Annotated[Any, io.Parsed(_task, "a start, a target and steps, like 1,0:0,0:10")]
Runs = Annotated[Any, io.Parsed(_pilot, "a share, a number of runs, or a model")]


@io.command(law="noise")
def identify_command(
    source: tuple[io.File, ...],
    *,
    states: io.Names = None,
    outputs: io.Names = None,
    inputs: io.Names = None,
    by: str | None = None,
    time: str | None = None,
    dt: float | None = None,
    delay: int = 0,
    on_gap: io.Word = "split",
    last_pairs: bool = False,
    skip: int = 0,
    design: io.Word = "adaptive",
    noise: io.Word = "gaussian",
    sigma: float | None = None,
    covariance: io.Word = "full",
    exact: io.Names = None,
    intercept: bool = False,
    window: Past = None,
    pilot: Runs = None,
    reference: Task = None,
    delta: io.Share = io.LEVEL,
    out: tuple[io.File, ...] = (),
    force: bool = False,
    as_json: bool = False,
) -> None:
    """Fit a model to measured runs.

    x(k+1) = A x(k) + B u(k) + c + w(k), with a region. LOGS are CSV files, folders of them, or
    patterns; each a run, unless --by.

    Table:
      source LOGS...  See above.
      states A,B  Columns of the states.
      outputs A,B  In place of --states: readings of a part of the state.
      inputs U,V  Columns of the inputs.
      by COLUMN  The column that tells runs apart; else one run.
      time COLUMN  The column of times (its unit, or s), or of dates.
      dt S  Time of a step; then stamps may jitter by 25 %.
      delay K  Steps until an input acts.
      on_gap WORD  At lost rows: split the run, or raise.
      last_pairs  Use only the last step of each run.
      skip K  Lines above the names to skip.
    Assumptions:
      design D  adaptive, or independent of the noise.
      noise LAW  Or sub-gaussian, bounded.
      sigma S  Known deviation of the noise; bounded: its largest 2-norm.
      covariance C  Of the noise: full, diagonal or scalar.
      exact A,B  States whose noise is 0, or follows from the others.
      intercept  Fit an offset c as well.
      window W  Of outputs: 8 for 8 lags, 0.8,4 for 4 filters of pole 0.8.
      pilot P  Open loop: share or number of first runs, or a model.
      reference T  With --pilot: task of plans, like 1,0:0,0:10.
    Options:
      delta P  Probability that the region misses the system.
      out OUT  Write identify.json and the figure to this directory; or the model to a file
          .safetensors; or both.
      force  Replace these files.
      as_json --json  Print JSON instead of text.
    For example:
      identify runs.csv --states x,v --inputs F --by run --time t
      identify logs/ --outputs x --inputs F --time t --out m.safetensors
    """
    paths = csv_files(sorted(source, key=natural))
    if (states is None) == (outputs is None) or inputs is None:
        known = ", ".join(map(str, Table.of_file(paths[0], skip).names))
        raise click.UsageError(f"give --states or --outputs, and --inputs, of the columns {known}")
    files = io.Out(out, "identify", force, [".safetensors", ".state"])
    read = "states" if outputs is None else "outputs"
    x = states or outputs
    columns: dict[str, Any] = {read: x, "inputs": inputs, "by": by, "time": time, "on_gap": on_gap}
    if outputs is None:
        columns["delay"] = delay
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always", DataWarning)
        data = Trajectories.from_csv(paths, **columns, dt=dt, skip=skip)
    unused: list[str] = []
    if len(paths) == 1 and by is None:
        table = Table.of_file(paths[0], skip)
        used = set(map(table.title, [*x, *inputs, time]))
        unused = [one for one in table.names if one not in used]
    if last_pairs:
        data = data.last_pairs()
    elif design == "independent" and not data.single:
        raise click.UsageError(
            "--design independent is for single steps, since later states of a run contain its "
            "earlier noise: add --last-pairs, or leave --design out"
        )
    if reference is not None and pilot is None:
        raise click.UsageError("--reference goes with --pilot")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataWarning)  # the text lists them
        model = identify(
            data,
            noise=Noise(noise, covariance, sigma, tuple(exact or ()), design),
            window=Window(**(window or {}), delay=0 if outputs is None else delay),
            pilot=None if pilot is None else Pilot(pilot, reference),
            intercept=intercept,
        )
    region = model.region(delta)
    if files.file is not None:
        model.save(files.file)
        io.note(f"written: {files.file}")
    lost = [str(one.message).replace("dt=", "--dt ") for one in seen]
    careful = [*lost, *model.warnings, *_useless(model, data, region)]
    lines = [str(data), str(model), str(region), f"for        {region.assumption}"]
    if model.checks is not None:
        lines.append(str(model.checks))
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
    facts = {
        "runs": len(data),
        "lost_rows": data.lost,
        "pairs": model.size,
        "states": list(model.state_names),
        "outputs": list(model.outputs),
        "inputs": list(model.input_names),
        "dt": model.dt,
        "A": model.A.tolist(),
        "B": model.B.tolist(),
        "c": None if model.c is None else model.c.tolist(),
        "rank": model.rank,
        "missing": list(model.missing),
        "region": {
            **region.to_dict(),
            "radius": io.finite(region.radius),
            "entry_bounds": io.finite(region.entry_bounds),
        },
        "checks": None if model.checks is None else model.checks.p_values,
        "saved": files.file,
        "unused": unused,
        "warnings": careful,
    }
    io.show_result(facts, "\n".join(lines), as_json)
    files.write(facts, model.plot)


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
