"""``stochens stream``: the sequential algorithm with a live line and checkpoints."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import click
import numpy as np

from .._base import validation
from .._base.progress import watched
from ..exceptions import InputError
from ..rng import as_key
from ..streams.stream import Stream
from ..theory.exact import best_control
from ._command import INTERRUPTED, TERMINATED, TIME_LIMIT, Command
from ._options import FILE, case_option, file_option, json_option, seed_option
from ._output import note, show_result
from ._problem import problem, share


@click.command(
    cls=Command,
    short_help="Refine a control sample by sample.",
    examples=[
        "stream --case ieee14 --tol 10%",
        "stream --file system.json --checkpoint run.state",
        "stream --file system.json --checkpoint run.state --resume",
    ],
    codes={TIME_LIMIT: "time limit reached"},
)
@case_option
@file_option
@click.option(
    "--tol",
    default="5%",
    metavar="E",
    help="Stop when the bound on the state error is this small, relative to the reached state.",
)
@click.option(
    "--max-steps",
    metavar="K",
    type=click.IntRange(min=1),
    help="Largest number of steps in this run.",
)
@click.option("--time-limit", type=float, metavar="S", help="Time limit of this run in seconds.")
@click.option(
    "--safeguard", is_flag=True, help="Keep every estimate at least as good as the plain mean."
)
@seed_option
@click.option(
    "--checkpoint",
    type=FILE,
    metavar="FILE",
    help="Save the state to this file during the run and at its end.",
)
@click.option("--every", metavar="S", type=float, default=60.0, help="Seconds between checkpoints.")
@click.option("--resume", is_flag=True, help="Continue from the checkpoint.")
@json_option
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

    A run that reaches its limit of steps is done as well, with exit code 0.

    Ctrl-C and SIGTERM save the state before the run ends; with --resume it continues with the same
    results as without the interruption. Beside the checkpoint FILE are FILE.prev, the state before
    it, and FILE.lock, which keeps a second run from using FILE; delete it only when no run uses it.
    """
    relative = validation.positive("tol", share(tol, "--tol"))
    key = as_key(seed)
    system, x0, xf = problem(case, path, key)
    made = Stream(system, x0, xf, rng=key.child("stream"), safeguard=safeguard)
    if resume:
        made = _resumed(made, checkpoint)
    elif checkpoint is not None and os.path.lexists(checkpoint):
        raise click.UsageError(f"{checkpoint} exists: give --resume, or another name")
    best = best_control(system.A, system.B, x0, xf)
    scale, reach = float(np.linalg.norm(best.reached)) or 1.0, best.reachability()
    shown = watched()
    with _signals() as received:
        run = made.run(
            tol=relative * scale,
            max_steps=max_steps,
            time_limit=time_limit,
            progress=_Line(made, scale) if shown else False,
            checkpoint=checkpoint,
            every=every,
        )
    if shown:
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
        "reach": reach.verdict,
        "out_of_reach": 0.0 if reach.reachable else reach.residual,
        "out_of_reach_relative": 0.0 if reach.reachable else reach.relative,
        "u": made.u.tolist(),
        "key": made.key.hex,
        "digest": made.digest,
        "checkpoint": checkpoint,
    }
    show_result(facts, _text(facts), as_json)
    if run.status == "interrupted":
        context.exit(TERMINATED if signal.SIGTERM in received else INTERRUPTED)
    if run.status == "time_limit":
        context.exit(TIME_LIMIT)


def _resumed(made: Stream, checkpoint: str | None) -> Stream:
    if checkpoint is None:
        raise click.UsageError("--resume needs --checkpoint, the file to continue from")
    found = Stream.load(checkpoint)
    if found.digest != made.digest:
        raise InputError(
            f"{checkpoint} must be of this problem, seed and options (digest {made.digest[:12]}), "
            f"got another ({found.digest[:12]})"
        )
    return found


@contextmanager
def _signals() -> Iterator[list[int]]:
    """Let SIGTERM end the run as Ctrl-C does; ignore further signals while the state is saved."""
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
    """Progress in one line of a terminal: steps, certificate, rate."""

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


def _text(facts: dict[str, Any]) -> str:
    error, certificate = (
        100 * facts[name] / facts["reached_norm"] for name in ("error", "certificate")
    )
    lines = [
        f"{facts['status']} after {facts['steps']} steps ({facts['steps_of_this_run']} now, "
        f"{facts['seconds']:.3g} s)",
        f"state error {error:.3g} %, certified {certificate:.3g} %",
        f"u = [{', '.join(f'{value:.6g}' for value in facts['u'])}]",
    ]
    if facts["reach"] == "undecided":
        lines.append(f"undecided whether xf is within reach: {facts['out_of_reach']:.3g} away")
    elif facts["out_of_reach"]:
        share = 100 * facts["out_of_reach_relative"]
        lines.append(f"out of reach: {facts['out_of_reach']:.3g} ({share:.3g} % of xf - A x0)")
    if facts["checkpoint"] is not None:
        lines.append(f"saved: {facts['checkpoint']}")
    return "\n".join(lines)
