"""``stochens control``: the control for a model from data, or for a known system."""

from __future__ import annotations

import math
import warnings
from typing import Any

import click
import numpy as np

from .. import cases
from .._base import state_file
from .._base.html import at_most, listed, percent
from .._base.numbers import ROUNDING
from .._base.reading import number
from ..certificates import Certificate
from ..controls import Plan, Uncertain, control
from ..exceptions import DataWarning, InputError
from ..feedback import Loop
from ..identification import Model
from ..identification.last_rows import last_rows
from ._command import Command
from ._limits import (
    LIMIT_NAMES,
    feedback_for,
    limit_facts,
    limit_lines,
    limit_options,
    limits_given,
)
from ._options import FILE, delta_option, force_option, json_option, out_option, steps_option
from ._output import Out, finite, grid, show_result

LISTED = 12  # states whose certificates are printed; JSON has all
# Fields of a certificate in JSON.
_RADII = ("target", "state", "components", "tube", "control")
_WORDS = ("kind", "covers", "assumption")


@click.command(
    "control",
    cls=Command,
    short_help="Compute a control and certify where it leads.",
    examples=[
        "control model.safetensors --from 1,0 --to 0,0 --steps 20",
        "control read.safetensors --record now.csv --steps 20 --limits F=-8,8",
    ],
    sections={
        "Options": [],  # the others, first
        "Certificate of a model": ["delta", "x0_error", "noise", "gain", "open_loop", "robust"],
        "Limits and weights": LIMIT_NAMES,
    },
    arguments={"x0": "start", "xf": "goal", "target": "goal", "radius": "x0_error"},
)
@click.argument("source", metavar="MODEL_OR_PROBLEM", type=FILE)
@click.option("--from", "start", metavar="X,Y", help="Initial state; default: of the problem.")
@click.option("--record", metavar="CSV", type=FILE, help="Of outputs: a log that ends now.")
@click.option("--time", metavar="COLUMN", help="Its times: rows that were lost are noticed.")
@click.option("--to", "goal", metavar="X,Y", help="Target; default: of the problem, or 0.")
@steps_option
@delta_option("Probability that the certificate does not hold.")
@click.option(
    "--x0-error",
    metavar="E",
    type=float,
    default=0.0,
    show_default=False,
    help="The true initial state is within E of --from (2-norm).",
)
@click.option(
    "--noise",
    is_flag=True,
    help="Include noise to come, with --steps fixed before the data.",
)
@click.option("--open-loop", is_flag=True, help="The measured inputs did not react to the states.")
@click.option(
    "--gain",
    is_flag=True,
    help="Follow it with a certified feedback of --Q and --R (else 1).",
)
@click.option("--robust", is_flag=True, help="The control of least certificate; one step.")
@limit_options
@out_option("control")
@force_option
@json_option
@click.pass_context
def control_command(
    context: click.Context,
    /,
    source: str,
    start: str | None,
    record: str | None,
    time: str | None,
    goal: str | None,
    steps: int,
    delta: float,
    noise: bool,
    x0_error: float,
    open_loop: bool,
    gain: bool,
    robust: bool,
    as_json: bool,
    **_: Any,
) -> None:
    """Compute the control to a target, also within limits.

    MODEL_OR_PROBLEM is a model of `identify --out`, or a known system: .npz, .mat or JSON
    with A, B and optionally x0, xf, names and units.

    For a model, prints how far from the target the true system, or its readings, can end with
    probability 1 - P. With limits or weights, minimizes weighted squares of distances from the
    target (--Q, --Qf) and inputs (--R).
    """
    files = Out(context)
    known: Any
    if source.endswith(".safetensors") or state_file.is_state(source):
        known = Model.load(source)
        x0, xf, n = None, None, known.n_outputs
    else:
        if noise or open_loop or gain or robust or x0_error:
            raise click.UsageError(
                "--x0-error, --noise, --gain, --open-loop and --robust are for models of identify, "
                "not for a system that is known"
            )
        problem = cases.from_file(source)
        known, x0, xf = problem.system, problem.x0, problem.xf
        n = known.n
    read = isinstance(known, Model) and known.window is not None
    names = known.outputs if read else known.state_names, known.input_names
    asked = limits_given(context.params, names)
    if robust:
        asked["guarantee"] = delta
    xf = state_of("--to", goal, n, np.zeros(n) if xf is None else xf)
    if read:
        if record is None or start is not None or x0_error or robust:
            raise click.UsageError(
                "give --record, without --from, --x0-error and --robust: a model of outputs starts "
                f"from readings of {listed(known.outputs)}, and the inputs between them"
            )
        asked |= {"record": last_rows(record, known, time), "target": xf}
    else:
        if record is not None or time is not None:
            raise click.UsageError("--record and --time are for models of outputs: give --from")
        x0 = state_of("--from", start, n, x0)
        asked |= {"x0": Uncertain(x0, x0_error) if x0_error else x0, "xf": xf}
    plan = control(known, steps=steps, **asked)
    found: Any = None
    loop: Loop | None = None
    counted = noise or (None if read else False)
    if isinstance(known, Model):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataWarning)  # the text has the reasons
            loop = feedback_for(known, context.params) if gain else None
            found = _certified(plan, delta, counted, open_loop, loop)
    near = None if found is None or gain else _typical(plan, delta, counted)
    facts = {**_facts(plan, found, x0, xf, names, loop), "typical": near}
    show_result(facts, _text(plan, found, near, xf, names), as_json)
    files.write(facts, lambda: plan.plot(found))


def _certified(
    plan: Plan, delta: float, noise: bool | None, open_loop: bool, gain: Loop | None
) -> Any:
    """The certificate; that the noise to come has no bound is said in options."""
    try:
        return plan.bound(delta, noise=noise, open_loop=open_loop, gain=gain)
    except InputError as error:
        if gain is not None or not noise or not str(error).startswith("`noise` must be False"):
            raise
        steps = (
            ""
            if plan.steps == 1 or open_loop
            else "; or give --open-loop, if the measured inputs did not react"
        )
        raise click.UsageError(
            "--noise needs a bound on the noise to come, and this model has none: identify "
            f"with --sigma S, or with --last-pairs --design independent{steps}"
        ) from error


def _typical(plan: Plan, delta: float, noise: bool | None) -> float | None:
    """The typical miss; None where its conditions do not hold."""
    try:
        miss: float | None = finite(plan.typical(delta, noise=noise).miss)
    except InputError:
        return None
    return miss


def state_of(option: str, text: str | None, n: int, default: Any) -> Any:
    """Read ``1,0,-0.5``."""
    if text is None:
        if default is None:
            raise click.UsageError(f"give {option}, {n} numbers with commas")
        return default
    try:
        values = [number(cell) for cell in text.split(",")]
    except ValueError:
        raise click.BadParameter(
            f"{text!r} must be numbers with commas", param_hint=option
        ) from None
    if len(values) != n or not all(map(math.isfinite, values)):
        raise click.BadParameter(f"must be {n} finite numbers, got {text!r}", param_hint=option)
    return np.array(values)


def _facts(
    plan: Plan,
    found: Certificate | None,
    x0: Any,
    xf: Any,
    names: tuple[Any, Any],
    gain: Loop | None,
) -> dict[str, Any]:
    outputs = plan.predicted_outputs
    if outputs is None:
        path = {"states": list(names[0]), "x0": x0.tolist(), "xf": xf.tolist()}
        path["predicted_states"] = plan.predicted_states.tolist()
    else:
        path = {"outputs": list(names[0]), "target": xf.tolist()}
        path["predicted_outputs"] = outputs.tolist()
    return {
        "schema": "stochens-control/1",
        **path,
        "inputs": list(names[1]),
        "steps": plan.steps,
        "u": plan.u.tolist(),
        "reach": plan.reachability.verdict,
        "out_of_reach": 0.0 if plan.reachability.reachable else plan.reachability.residual,
        "warnings": list(plan.warnings),
        "limits": limit_facts(plan),
        "K": None if gain is None else gain.K.tolist(),
        "certificate": None
        if found is None
        else {
            "delta": found.delta,
            **{name: finite(radius) for name, radius in _radii(found).items()},
            **{name: getattr(found, name) for name in _WORDS},
            "parts": {name: finite(part) for name, part in found.parts.items()},
            "methods": {name: one.method for name, one in found.quantities.items()},
            "reasons": {name: one.reason for name, one in found.quantities.items() if one.reason},
        },
    }


def _radii(found: Certificate) -> dict[str, Any]:
    """The radii by name: those of all states, or all of a model of outputs."""
    if "readings" not in found.quantities:
        return {name: getattr(found, name) for name in _RADII}
    return {name: one.radius for name, one in found.quantities.items()}


def _text(
    plan: Plan,
    found: Certificate | None,
    near: float | None,
    xf: Any,
    names: tuple[Any, Any],
) -> str:
    tube = [] if found is None else ["tube"]
    rows = [["step", *names[1], *names[0], *tube]]
    outputs = plan.predicted_outputs
    path = _rounded(plan.predicted_states if outputs is None else outputs)
    inputs = _rounded(plan.u)
    at = None if plan.state_active is None else np.pad(plan.state_active, ((1, 0), (0, 0)))
    for k in range(len(path)):
        u = _inputs(plan, inputs, k) if k < plan.steps else [""] * plan.u.shape[1]
        radius = [] if found is None else [f"{found.tube[k]:.3g}"]
        rows.append([str(k), *u, *_starred(path, k, at), *radius])
    lines = [*grid(rows), ""]
    if found is None:
        off = float(np.linalg.norm(plan.predicted_states[-1] - xf))
        where = f"{off:.4g} from the target" if off > _rounding(plan) else "at the target"
        lines.append(f"ends       {where}; the system is taken as known")
    else:
        first, own = found["target"], ("reach", "start")
        error = sum(part for name, part in found.parts.items() if name not in own)
        ends = "the true system ends"
        if outputs is not None:
            ends = f"{first.distance_from.removeprefix('the target, ')} are"
        where = "out of reach of the model" if plan.limited is None else "where the model ends"
        mostly = "" if plan.limited else f": mostly {found.largest}"
        lines += [
            f"certified  nothing: {first.reason}"
            if first.reason
            else f"certified  {ends} within "
            f"{at_most(found.target, 4)} of the target, with {percent(found.delta)}",
            *_beside(found, near),
            f"of that    {_reach(plan, found)} {where}, {error:.4g} by its error{mostly}",
            f"each       {_components(found, names[0])}",
            f"by         {first.method}",
            f"for        {found.assumption}",
        ]
    lines += limit_lines(plan)
    return "\n".join([*lines, *(f"warning    {text}" for text in plan.warnings)])


def _beside(found: Certificate, near: float | None) -> list[str]:
    if near is None:
        return []
    share = percent(found.delta)
    return [f"typical    {share} of the models drawn for these data miss by less than {near:.4g}"]


def _inputs(plan: Plan, inputs: Any, k: int) -> list[str]:
    """The inputs of a step, with a star at a limit or a rate."""
    limited = plan.limited
    return _starred(inputs, k, None if limited is None else limited.active | limited.rate_active)


def _starred(values: Any, k: int, active: Any) -> list[str]:
    """The values of a time, with a star where one is active, and room for it elsewhere."""
    marked = np.zeros_like(values, dtype=bool) if active is None else active != 0
    stars = np.where(marked[k], "*", " " if marked.any() else "")
    return [f"{value:.4g}{star}" for value, star in zip(values[k], stars, strict=True)]


def _reach(plan: Plan, found: Certificate) -> str:
    """How far the model ends from the target; 0 where that is rounding beside the states."""
    reach = found.parts["reach"]
    return f"{reach if reach > _rounding(plan) else 0.0:.4g}"


def _rounding(plan: Plan) -> float:
    """Distances up to here are rounding beside the states."""
    return ROUNDING * float(np.abs(plan.predicted_states).max())


def _components(found: Certificate, names: Any) -> str:
    """How far each state can end from its target, in the unit of its data."""
    each = found.quantities.get("last", found.quantities.get("components"))
    assert each is not None
    pairs = zip(names[:LISTED], np.asarray(each.radius), strict=False)
    more = ", …" * (len(names) > LISTED)
    return ", ".join(f"{name} within {at_most(value, 4)}" for name, value in pairs) + more


def _rounded(values: Any) -> Any:
    """0 in place of what is rounding beside the largest value."""
    return np.where(np.abs(values) > ROUNDING * np.abs(values).max(), values, 0.0)
