"""``stochens control``, ``certify`` and ``export``: inputs, the proof of a gain, a loop in C."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import numpy as np

from .. import cases
from .._base.files import is_state, write_text
from .._base.reading import titled
from .._base.show import at_most, listed, percent
from .._base.types import ROUNDING, Floats
from ..controls import control
from ..data.gaps import NEAR
from ..data.table import Table
from ..exceptions import DataWarning, InputError, SolverError, StateError
from ..export import check_proof
from ..feedback import Loop
from ..feedback import gain as gain_of
from ..identification import Model
from ..limits import Cost, Limits, Uncertain
from ..limits.problem import sides
from ..loops import ReadingLoop, Regulator
from . import _command as io


@io.command(x0="start", xf="goal", target="goal", radius="x0_error")
def control_command(
    source: io.File,
    *,
    start: io.Numbers = None,
    record: io.File | None = None,
    time: str | None = None,
    skip: int = 0,
    goal: io.Numbers = None,
    steps: io.Count = 1,
    out: tuple[io.File, ...] = (),
    force: bool = False,
    as_json: bool = False,
    delta: io.Share = io.LEVEL,
    x0_error: float | None = None,
    noise: bool = False,
    gain: bool = False,
    limits: tuple[io.Sides, ...] = (),
    rate: io.Entries = None,
    previous: io.Entries = None,
    Q: io.Entries = None,
    Qf: io.Entries = None,
    R: io.Entries = None,
    state_limits: tuple[io.Sides, ...] = (),
    hard: bool = False,
) -> None:
    """Compute a control; certify where it leads.

    MODEL_OR_PROBLEM is a model of `identify --out`, or a known system: .npz, .mat or JSON
    with A, B and optionally x0, xf. For a model, says how far from the target the true system ends.
    With limits or weights, minimizes weighted squares of distances from the target and inputs.

    Options:
      source MODEL_OR_PROBLEM  See above.
      start --from X,Y  Initial state; default: of the problem.
      record CSV  Of outputs: a log that ends now.
      time COLUMN  Its times: rows that were lost are noticed.
      skip K  Lines above its names to skip.
      goal --to X,Y  Target; default: of the problem, or 0.
      steps K  Number of steps.
      out DIR  Write control.json and the figure there.
      force  Replace these files.
      as_json --json  Print JSON instead of text.
    Certificate of a model:
      delta P  Probability that the certificate does not hold.
      x0_error E  The true initial state is within E of --from.
      noise  Include noise to come, with --steps fixed before the data.
      gain  Follow it with a certified feedback of --Q and --R (else 1).
    Limits and weights:
      limits LOW,HIGH  Of all inputs, or INPUT=LOW,HIGH; repeatable.
      rate R  Largest change of an input in a step; one or each.
      previous U  The inputs applied now; required with --rate.
      Q --Q W  Weight of the states, one or each; default: 0.
      Qf --Qf W  Weight of the last state; default: --Q, or 1.
      R --R W  Weight of the inputs; default: almost 0.
      state_limits LOW,HIGH  As --limits, of the states; soft unless --hard.
      hard  The limits of the states must hold.
    For example:
      control model.safetensors --from 1,0 --to 0,0 --steps 20
      control read.safetensors --record now.csv --steps 20 --limits F=-8,8
    """
    files = io.Out(out, "control", force)
    known: Any
    x0: Any
    if source.endswith(".safetensors") or is_state(source):
        known = Model.load(source)
        x0, xf, n = None, None, known.n_outputs
    else:
        if noise or gain or x0_error:
            raise click.UsageError("--x0-error, --noise and --gain are for models of identify")
        problem = cases.from_file(source)
        known, x0, xf = problem.system, problem.x0, problem.xf
        n = known.n
    read = isinstance(known, Model) and known.window is not None
    states, inputs = known.outputs if read else known.state_names, known.input_names
    if hard and not state_limits:
        raise click.UsageError("--hard is for --state-limits")

    u, x = _sides_of(limits, inputs), _sides_of(state_limits, states)
    asked: dict[str, Any] = {
        "limits": Limits(u=u, rate=rate, previous=previous, x=x, soft=False if hard else None),
        "cost": Cost(Q=Q, Qf=Qf, R=R),
    }
    if goal is not None or xf is None:
        xf = np.array(goal or np.zeros(n))
    if read:
        if record is None or start is not None or x0_error:
            raise click.UsageError(
                "give --record, without --from and --x0-error: a model of outputs starts "
                f"from readings of {listed(known.outputs)}, and the inputs between them"
            )
        asked |= {"record": _last_rows(record, known, time, skip), "target": xf}
    else:
        if record is not None or time is not None or skip:
            raise click.UsageError("--record and --time are for models of outputs: give --from")
        x0 = x0 if start is None else start
        if x0 is None:
            raise click.UsageError(f"give --from, {n} numbers with commas")
        asked |= {"x0": Uncertain(x0, x0_error) if x0_error else x0, "xf": xf}
    plan = control(known, steps=steps, **asked)
    found: Any = None
    near = loop = None
    counted = noise or (None if read else False)
    if isinstance(known, Model):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)  # the text has the reasons
            loop = feedback_for(known, Q, R) if gain else None
            found = plan.bound(delta, noise=counted, gain=loop)
        if not gain:
            try:
                near = io.finite(plan.typical(delta, noise=counted).miss)
            except InputError:  # its conditions do not hold
                near = None
    path = plan.predicted_states if plan.predicted_outputs is None else plan.predicted_outputs
    facts = {
        "outputs" if read else "states": list(states),
        "inputs": list(inputs),
        "target": io.finite(xf),
        "u": plan.u.tolist(),
        "predicted_outputs" if read else "predicted_states": path.tolist(),
        "reach": plan.reachability.verdict,
        "limited": None if plan.limited is None else plan.limited.to_dict(),
        "K": None if loop is None else loop.K.tolist(),
        "certificate": None if found is None else found.to_dict(),
        "typical": near,
        "warnings": list(plan.warnings),
    }
    io.show_result(facts, _text(plan, found, near, (*inputs, *states), path, xf), as_json)
    files.write(facts, lambda: plan.plot(found))


def _text(plan: Any, found: Any, near: Any, names: Any, path: Any, xf: Any) -> str:
    """The controls and where they lead, step by step, then the plan and its certificate."""
    tube = [] if found is None else ["tube"]
    rows = [["step", *names, *tube]]
    for k, state in enumerate(_rounded(path)):
        u = [f"{v:.4g}" for v in _rounded(plan.u)[k]] if k < plan.steps else [""] * plan.u.shape[1]
        radius = [] if found is None else [f"{found.tube[k]:.3g}"]
        rows.append([str(k), *u, *(f"{v:.4g}" for v in state), *radius])
    lines = [*io.grid(rows), "", str(plan)]
    if found is None:
        off = float(np.linalg.norm(path[-1] - xf))
        there = off <= ROUNDING * float(np.abs(path).max())
        where = "at the target" if there else f"{off:.4g} from the target"
        lines.append(f"ends       {where}; the system is taken as known")
    else:
        each = found.quantities.get("last", found.quantities.get("components"))
        lines += [str(found), *([] if each is None else [str(each)])]
        if near is not None:
            share = f"{percent(found.delta)} of the models drawn for these data"
            lines.append(f"typical    {share} miss by less than {near:.4g}")
        lines.append(f"for        {found.assumption}")
    return "\n".join([*lines, *(f"warning    {text}" for text in plan.warnings)])


def _rounded(values: Any) -> Any:
    """0 in place of what is rounding beside the largest value."""
    return np.where(np.abs(values) > ROUNDING * np.abs(values).max(), values, 0.0)


@io.command(x0="start")
def certify_command(
    source: io.File,
    *,
    Q: io.Entries = "1",
    R: io.Entries = "1",
    widest: bool = False,
    delta: io.Share = io.LEVEL,
    start: io.Numbers = None,
    steps: io.Count = 60,
    within: float | None = None,
    noise: io.Share = None,
    limits: tuple[io.Sides, ...] = (),
    margins: bool = False,
    as_json: bool = False,
) -> None:
    """Certify a feedback for all systems.

    Computes a feedback u = K x, and certifies it for every system the data allow. With probability
    1 - P the true system is among them. From a state, also bounds where all of them go: for ever
    without noise, over K steps with it.

    Options:
      source MODEL  A model of `identify --out`.
      Q --Q W  Weight of the states or outputs.
      R --R W  Weight of the inputs, one or each.
      widest  The gain of widest margin, in place of the weights.
      delta P  Probability that the true system is not among those of the certificate.
      start --from X,Y  Initial state, for a tube from there.
      steps K  Steps of the tube.
      within R  From which step on states are within R.
      noise P  Include Gaussian noise; it is larger with this.
      limits LOW,HIGH  Of all inputs, or INPUT=LOW,HIGH: how much of --from keeps them for all time.
      margins  Gain, phase, delay, errors, rounding and saturation that all systems stand.
      as_json --json  Print JSON instead of text.
    For example:
      certify model.safetensors --Q 1 --R 0.1 --margins
      certify model.safetensors --from 1,0 --within 0.05 --noise 5%
      certify model.safetensors --widest --from 1,0 --limits -1,1 --json
    """
    if start is None and (within is not None or noise is not None or limits):
        raise click.UsageError("give --from, which --within, --noise and --limits are about")
    model = Model.load(source)
    states, inputs = model.state_names, model.input_names
    loop = feedback_for(model, Q, R, delta if widest else None)
    proof = loop.certificate(delta)
    facts = {
        "K": loop.K.tolist(),
        "margin": io.finite(proof.margin),
        "certificate": proof.to_dict(),
    }
    rows = zip(states, loop.K.T, strict=True)
    lines = io.grid(
        [["K transposed", *inputs], *([k, *(f"{v:.4g}" for v in row)] for k, row in rows)]
    )
    lines += ["", str(proof)]
    if margins:
        sheet = proof.margins()
        facts["margins"] = sheet.to_dict()
        lines += ["", *io.grid([["", "certified", "of the model"], *sheet.rows()]), ""]
    if start is not None:
        tube = proof.tube(start, steps, noise=noise)
        within_limits = Limits(u=_sides_of(limits, inputs)).u
        level = None
        if within_limits is not None:
            low, high = sides("limits", within_limits, 1, model.labels)
            level = proof.holds((low[0], high[0]), start)
        settles = None if within is None else tube.settles(within)
        facts |= {"tube": tube.to_dict(), "settles": settles, "limits_scale": level}
        if proof.status == "certified":
            lines.append(str(tube))
            if within is not None:
                when = "not certified" if settles is None else f"from step {settles} on, for ever"
                lines.append(f"rest       within {within:g} of 0 without noise: {when}")
            if np.isfinite(tube.reach).all():
                pairs = zip((*states, *inputs), tube.reach, strict=True)
                most = ", ".join(f"|{name}| <= {at_most(v)}" for name, v in pairs)
                lines.append(f"for ever   without noise {most}")
            if level is not None:
                lines.append(
                    f"limits     kept for ever without noise from {level:.3g} times --from"
                )
    lines.append(f"for        {proof.assumption}")
    lines += [f"warning    {text}" for text in proof.warnings]
    io.show_result(facts, "\n".join(lines), as_json)


def _sides_of(pairs: Sequence[tuple[str, Any]], names: Sequence[str]) -> Any:
    """Limits by name, those of one behind those of all; None where there are none."""
    found: dict[str, Any] = {}
    for name, pair in sorted(pairs, key=lambda one: one[0] != ""):
        found |= {titled(name, names): pair} if name else dict.fromkeys(names, pair)
    return found or None


def feedback_for(model: Model, Q: Any, R: Any, widest: float | None = None) -> Loop:
    """The gain of least squares with ``--Q`` and ``--R``, 1 where they are left out.

    With `widest` that of the widest margin in the region of this probability.
    """
    try:
        if widest is not None:
            return gain_of(model, guarantee=widest)
        return gain_of(model, 1.0 if Q is None else Q, 1.0 if R is None else R)
    except SolverError as error:
        raise click.UsageError(f"no gain: {error}") from error


def _last_rows(path: str, model: Model, time: str | None, skip: int) -> tuple[Floats, Floats]:
    """The record (outputs, inputs) for a model of outputs, whose columns the file has.

    It begins behind the last row that is not complete, or that `time` says was lost; of the last
    row of all the inputs are not used, as they act after its reading.
    """
    table = Table.of_file(path, skip)

    def columns(argument: str, names: tuple[str, ...]) -> Floats:
        return np.column_stack([table.numbers(argument, table.title(name)) for name in names])

    y, u = columns("outputs", model.outputs), columns("inputs", model.input_names)
    if not np.isfinite(y[-1]).all():
        raise InputError(f"{path} must have all outputs in its last row, where the plan starts")
    # whether a row and the next one are a step of the record
    follows = np.isfinite(np.hstack([y, u])[:-1]).all(axis=1)
    if time is not None:
        if model.dt is None:
            raise InputError("`time` must be left out for a model whose logs had no times")
        follows &= np.abs(np.diff(table.times(table.title(time))) / model.dt - 1.0) <= NEAR
    first = int(np.max(np.flatnonzero(~follows), initial=-1)) + 1
    return y[first:], u[first:-1]


@io.command()
def export_command(
    source: io.File,
    *,
    out: str = "controller.h",
    name: str = "controller",
    Q: io.Entries = "1",
    R: io.Entries = "1",
    proof: str | None = None,
    checker: str | None = None,
    as_json: bool = False,
) -> None:
    """Write a controller in C.

    Writes a loop as one C99 header without malloc; that of a model is the feedback u = K x of
    least cost. A proof can be checked without this package.

    Options:
      source FILE  A loop.save(path), or a model of `identify --out`.
      out --out FILE  The header.
      name NAME  What its names begin with.
      Q --Q W  For a model, the weight of the states or outputs.
      R --R W  For a model, the weight of the inputs, one or each.
      proof FILE.json  Write the proof of a feedback, too.
      checker FILE.py  Write the checker of proofs, one file that needs Python alone.
      as_json --json  Print JSON instead of text.
    For example:
      export model.safetensors --Q 1,10,0.1,1 --R 0.01 --out controller.h
      export loop.safetensors --out loop.h --name cart
      export model.safetensors --proof proof.json --checker check_proof.py
    """
    loop: Any = None
    for kind in (Loop, Regulator, ReadingLoop):
        with suppress(StateError):  # a file of another kind
            loop = loop or kind.load(source)
    loop = loop or feedback_for(Model.load(source), Q, R)
    loop.to_c(out, name=name)
    if proof is not None:
        loop.certificate().save(proof)
    if checker is not None:
        write_text(checker, Path(check_proof.__file__).read_text("utf-8"))
    facts = {"header": out, "proof": proof, "checker": checker, "loop": repr(loop)}
    for path in filter(None, (out, proof, checker)):
        io.note(f"written: {path}")
    io.show_result(facts, repr(loop), as_json)
