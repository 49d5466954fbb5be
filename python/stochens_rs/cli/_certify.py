"""``stochens certify``: whether a feedback is stable for every system that the data allow."""

from __future__ import annotations

from typing import Any

import click
import numpy as np

from .._base.html import at_most, margin, percent
from ..feedback import LoopCertificate, Tube
from ..identification import Model
from ._command import Command
from ._control import state_of
from ._limits import feedback_for, sides_of
from ._options import FILE, delta_option, json_option
from ._output import finite, grid, show_result
from ._problem import share


@click.command(
    "certify",
    cls=Command,
    short_help="Certify a feedback for all systems.",
    examples=[
        "certify model.safetensors --Q 1 --R 0.1",
        "certify model.safetensors --from 1,0 --within 0.05 --noise 5%",
        "certify model.safetensors --widest --from 1,0 --limits -1,1 --json",
    ],
    arguments={"x0": "start"},
)
@click.argument("source", metavar="MODEL", type=FILE)
@click.option("--Q", "Q", metavar="W", default="1", help="Weight of the states or outputs.")
@click.option("--R", "R", metavar="W", default="1", help="Weight of the inputs, one or each.")
@click.option("--widest", is_flag=True, help="The gain of widest margin, in place of the weights.")
@delta_option("Probability that the true system is not among those of the certificate.")
@click.option("--from", "start", metavar="X,Y", help="Initial state, for a tube from there.")
@click.option(
    "--steps", metavar="K", type=click.IntRange(min=1), default=60, help="Steps of the tube."
)
@click.option("--within", metavar="R", type=float, help="From which step on states are within R.")
@click.option("--noise", metavar="P", help="Include Gaussian noise; it is larger with this.")
@click.option(
    "--limits",
    metavar="LOW,HIGH",
    multiple=True,
    help="Of all inputs, or INPUT=LOW,HIGH: how much of --from keeps them for all time.",
)
@json_option
def certify_command(
    source: str,
    widest: bool,
    delta: float,
    start: str | None,
    steps: int,
    within: float | None,
    noise: str | None,
    limits: tuple[str, ...],
    as_json: bool,
    **weights: Any,
) -> None:
    """Compute a feedback u = K x and certify it for every system the data allow.

    MODEL is a model of `identify --out`. With probability 1 - P the true system is among them. From
    a state, also bounds where all of them go: for ever without noise, over K steps with it.
    """
    if start is None and (within is not None or noise is not None or limits):
        raise click.UsageError("give --from, which --within, --noise and --limits are about")
    model = Model.load(source)
    names = model.state_names, model.input_names
    loop = feedback_for(model, weights, delta if widest else None)
    proof = loop.certificate(delta)
    x0 = None if start is None else state_of("--from", start, model.n, None)
    sides = sides_of("--limits", limits, names[1]) if limits else None
    tube = level = None
    if x0 is not None:
        eps = None if noise is None else share(noise, "--noise")
        tube = proof.tube(x0, steps, noise=eps)
        level = None if sides is None else proof.holds(sides, x0)
    settles = None if tube is None or within is None else tube.settles(within)
    facts = {
        "schema": "stochens-certify/1",
        "states": list(names[0]),
        "inputs": list(names[1]),
        "K": loop.K.tolist(),
        "method": loop.method,
        "status": proof.status,
        "reason": proof.reason,
        "margin": finite(proof.margin),
        "norm": finite(proof.norm),
        "least": finite(proof.least),
        "spectral_radius": proof.spectral_radius,
        "delta": delta,
        "assumption": proof.region.assumption,
        "warnings": list(proof.warnings),
        "member": None if proof.member is None else proof.member.tolist(),
        "tube": None if tube is None else _tube_facts(tube, x0, within, settles, level),
    }
    lines = [
        *grid([["K transposed", *names[1]], *_rows(names[0], loop.K.T)]),
        "",
        _verdict(proof),
    ]
    if tube is not None and proof.status == "certified":
        lines += _tube_lines(tube, within, settles, level, names)
    lines.append(f"for        {proof.region.assumption}")
    lines += [f"warning    {text}" for text in proof.warnings]
    show_result(facts, "\n".join(lines), as_json)


def _rows(names: Any, K: Any) -> list[list[str]]:
    return [[name, *(f"{value:.4g}" for value in row)] for name, row in zip(names, K, strict=True)]


def _verdict(proof: LoopCertificate) -> str:
    share = percent(proof.region.delta)
    if proof.status == "certified":
        return (
            f"certified  for all systems that the data allow ({share}), the loop is stable; the "
            f"margin is at least {margin(proof.margin)}"
        )
    if proof.status == "refuted":
        return f"refuted    a system that the data allow ({share}) is unstable"
    why = proof.reason or f"{proof.least:.3g} of 1 allowed; try --widest, or more data"
    return f"nothing    {proof.status}: {why}"


def _tube_lines(
    tube: Tube, within: float | None, settles: int | None, level: float | None, names: Any
) -> list[str]:
    """Where all systems go, in words."""
    K, most = len(tube.inputs), at_most(float(tube.state_radii.max()))
    lines = [f"from there within {most} of the model without noise, in {K} steps"]
    if within is not None:
        when = "not certified" if settles is None else f"from step {settles} on, for ever"
        lines.append(f"rest       within {within:g} of 0 without noise: {when}")
    pairs = zip((*names[0], *names[1]), tube.reach, strict=True)
    if np.isfinite(tube.reach).all():
        lines.append(
            "for ever   without noise "
            + ", ".join(f"|{name}| <= {at_most(v)}" for name, v in pairs)
        )
    if level is not None:
        lines.append(f"limits     kept for ever without noise from {level:.3g} times --from")
    if tube.eps is not None:
        each = zip((*names[0], *names[1]), tube.noise, strict=True)
        share = percent(tube.delta, tube.eps)
        said = ", ".join(f"{name} {at_most(v)}" for name, v in each)
        lines.append(f"noise      adds in {K} steps at most ({share}): {said}")
    return lines


def _tube_facts(
    tube: Tube, x0: Any, within: float | None, settles: int | None, level: float | None
) -> dict[str, Any]:
    n = tube.states.shape[1]
    return {
        "x0": x0.tolist(),
        "steps": len(tube.inputs),
        "radii": finite(tube.radii),
        "components": finite(tube.components),
        "inputs": finite(tube.input_components),
        "reach": finite(tube.reach),
        "within": within,
        "settles": settles,
        "limits_scale": level,
        "eps": tube.eps,
        "noise": {"states": finite(tube.noise[:n]), "inputs": finite(tube.noise[n:])},
    }
