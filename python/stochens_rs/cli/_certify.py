"""``stochens certify``: whether a feedback is stable for every system that the data allow."""

from __future__ import annotations

import click
import numpy as np

from .._base.show import at_most
from ..identification import Model
from ._command import LEVEL, Count, File, Share, command
from ._output import finite, grid, show_result
from ._values import feedback_for, sides_of, vector_of


@command(x0="start")
def certify_command(
    source: File,
    *,
    Q: str = "1",
    R: str = "1",
    widest: bool = False,
    delta: Share = LEVEL,
    start: str | None = None,
    steps: Count = 60,
    within: float | None = None,
    noise: Share = None,
    limits: tuple[str, ...] = (),
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
      as_json --json  Print JSON instead of text.
    For example:
      certify model.safetensors --Q 1 --R 0.1
      certify model.safetensors --from 1,0 --within 0.05 --noise 5%
      certify model.safetensors --widest --from 1,0 --limits -1,1 --json
    """
    if start is None and (within is not None or noise is not None or limits):
        raise click.UsageError("give --from, which --within, --noise and --limits are about")
    model = Model.load(source)
    states, inputs = model.state_names, model.input_names
    loop = feedback_for(model, Q, R, delta if widest else None)
    proof = loop.certificate(delta)
    facts = {"K": loop.K.tolist(), "margin": finite(proof.margin), "certificate": proof.to_dict()}
    rows = zip(states, loop.K.T, strict=True)
    lines = grid([["K transposed", *inputs], *([k, *(f"{v:.4g}" for v in row)] for k, row in rows)])
    lines += ["", str(proof)]
    if start is not None:
        x0 = vector_of("--from", start, model.n, None)
        sides = sides_of("--limits", limits, inputs) if limits else None
        tube = proof.tube(x0, steps, noise=noise)
        level = None if sides is None else proof.holds(sides, x0)
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
    lines.append(f"for        {proof.region.assumption}")
    lines += [f"warning    {text}" for text in proof.warnings]
    show_result(facts, "\n".join(lines), as_json)
