"""``stochens stream``: the sequential algorithm with a live line and checkpoints."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import click
import numpy as np
from numpy.typing import NDArray

from .._base import gate
from ..exceptions import InputError
from ..rng import as_key
from ..streams.stream import Stream
from ..theory.exact import best_control
from ._options import case_option, file_option, seed_option
from ._output import note, show
from ._problem import problem, share

INTERRUPTED, TERMINATED = 130, 143


@click.command()
@case_option
@file_option
@click.option(
    "--tol",
    default="5%",
    show_default=True,
    metavar="E",
    help="Stop when the certificate is this small, relative to the state that is reached.",
)
@click.option("--max-steps", type=click.IntRange(min=1), help="Most steps of this run.")
@click.option("--time-limit", type=float, metavar="S", help="Most seconds of this run.")
@click.option("--safeguard", is_flag=True, help="Never worse than the plain means.")
@seed_option
@click.option(
    "--checkpoint", metavar="FILE", help="Save the state there on the way and at the end."
)
@click.option(
    "--every", type=float, default=60.0, show_default=True, help="Seconds between checkpoints."
)
@click.option("--resume", is_flag=True, help="Go on from the checkpoint.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
@click.pass_context
def stream(
    context: click.Context,
    case: str | None,
    path: str | None,
    tol: str,
    max_steps: int | None,
    time_limit: float | None,
    safeguard: bool,
    seed: int,
    checkpoint: str | None,
    every: float,
    resume: bool,
    as_json: bool,
) -> None:
    """Refine a control one realization at a time, until it is certified.

    Ctrl-C and SIGTERM save before leaving; with --resume the run goes on as if it had never
    stopped. Beside the checkpoint FILE are FILE.prev, the state before it, and FILE.lock, which
    keeps two runs apart and may be deleted when none is going on.

    Exit codes: 0 done (certified, or as many steps or seconds as allowed), 1 internal error,
    2 usage or input, 5 reading or writing files, 130 interrupted, 143 terminated.
    """
    relative = gate.positive("tol", share(tol, "--tol"))
    key = as_key(seed)
    system, x0, xf = problem(case, path, key)
    made = Stream(system, x0, xf, rng=key.child("stream"), safeguard=safeguard)
    if resume:
        made = _resumed(made, checkpoint)
    elif checkpoint is not None and os.path.lexists(checkpoint):
        raise click.UsageError(f"{checkpoint} exists: give --resume, or another name")
    best = best_control(system.A, system.B, x0, xf)
    scale, reach = float(np.linalg.norm(best.reached)) or 1.0, best.reachability()
    watched = sys.stderr is not None and sys.stderr.isatty()
    with _signals() as received:
        run = made.run(
            tol=relative * scale,
            max_steps=max_steps,
            time_limit=time_limit,
            progress=_Line(made, scale) if watched else False,
            checkpoint=checkpoint,
            every=every,
        )
    if watched:
        note("")
    facts = {
        "schema": "stochens-stream/1",
        "status": run.status,
        "steps": made.steps,
        "steps_of_this_run": run.steps,
        "seconds": run.seconds,
        "certificate": run.certificate,
        "error": run.error,
        "reached_norm": scale,
        "out_of_reach": 0.0 if reach.reachable else reach.residual,
        "out_of_reach_relative": 0.0 if reach.reachable else reach.relative,
        "u": made.u.tolist(),
        "key": made.key.hex,
        "digest": made.digest,
        "checkpoint": checkpoint,
    }
    show(json.dumps(facts, allow_nan=False, indent=2) if as_json else _text(facts, made.u))
    if run.status == "interrupted":
        context.exit(TERMINATED if signal.SIGTERM in received else INTERRUPTED)


def _resumed(made: Stream, checkpoint: str | None) -> Stream:
    if checkpoint is None:
        raise click.UsageError("--resume needs --checkpoint, the file to go on from")
    found = Stream.load(checkpoint)
    if found.digest != made.digest:
        raise InputError(
            f"{checkpoint} must be of this problem, seed and options (digest {made.digest[:12]}), "
            f"got another ({found.digest[:12]})"
        )
    return found


@contextmanager
def _signals() -> Iterator[list[int]]:
    """SIGTERM ends the run as Ctrl-C does; once it is ending, further signals wait for the save."""
    received: list[int] = []

    def end(number: int, _: FrameType | None) -> None:
        received.append(number)
        if len(received) == 1:
            raise KeyboardInterrupt

    before = {s: signal.signal(s, end) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Line:
    """One line on a terminal that is written over: steps, certificate, rate."""

    def __init__(self, stream: Stream, scale: float) -> None:
        self._stream, self._scale = stream, scale
        self._start, self._first = time.monotonic(), stream.steps

    def __call__(self, done: int, _: int | None) -> None:
        certificate = (self._stream.certificate or 0.0) / self._scale
        rate = done / max(time.monotonic() - self._start, 1e-9)
        text = (
            f"step {self._first + done:>14,}   certificate {100 * certificate:>9.3g} %   "
            f"{rate:>10,.0f} steps/s"
        )
        sys.stderr.write("\r" + text.replace(",", " "))
        sys.stderr.flush()


def _text(facts: dict[str, object], control: NDArray[np.float64]) -> str:
    certificate, error = float(str(facts["certificate"])), float(str(facts["error"]))
    scale = float(str(facts["reached_norm"]))
    lines = [
        f"{facts['status']} after {facts['steps']} steps ({facts['steps_of_this_run']} now, "
        f"{float(str(facts['seconds'])):.3g} s)",
        f"state off by {100 * error / scale:.3g} %, certified {100 * certificate / scale:.3g} %",
        f"u = [{', '.join(f'{value:.6g}' for value in control)}]",
    ]
    if facts["out_of_reach"]:
        share = 100 * float(str(facts["out_of_reach_relative"]))
        lines.append(f"out of reach: {facts['out_of_reach']:.3g} ({share:.3g} % of xf - A x0)")
    if facts["checkpoint"] is not None:
        lines.append(f"saved: {facts['checkpoint']}")
    return "\n".join(lines)
