"""What the commands print: `commands.txt` has each command line, its whole output and exit code.

``python tests/python/test_cli_snapshots.py`` writes the file anew, to be read before it is taken.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shlex
import tempfile
from pathlib import Path

import numpy as np
import pytest

from stochens_rs import cli

A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.0], [1.0]])
FILE = Path(__file__).with_name("commands.txt")
BLOCKS = [one.partition("\n") for one in re.split(r"(?m)^\$ stochens ", FILE.read_text())[1:]]
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def log(runs, steps, rng, push=0.0):
    """The lines of a table of runs, the last input of each left empty."""
    lines = ["run,t,angle,rate,torque"]
    for r in range(runs):
        x = rng.standard_normal(2)
        for k in range(steps + 1):
            u = rng.standard_normal()
            cells = [f"r{r}", f"{0.1 * k:.1f}", f"{x[0]:.6f}", f"{x[1]:.6f}"]
            lines.append(",".join([*cells, f"{u:.6f}" if k < steps else ""]))
            x = A @ x + B[:, 0] * u + push + 0.01 * rng.standard_normal(2)
    return lines


def write_files():
    """What the commands read, into the current directory."""
    plant = {"A": A.tolist(), "B": B.tolist(), "x0": [1.0, 0.0]}
    for name, content in {
        "system": plant,
        "named": {**plant, "inputs": ["forces"]},
        "bad": {**plant, "x0": [1.0]},
        "key": {"A": [[1]], "B": [[1]], "x_0": [1]},
        "two": {**plant, "B": [[0.0, 0.1], [1.0, 0.0]], "x0": [3.0, 1.0]},
        "integrator": {"A": [[1.0]], "B": [[1.0]], "x0": [0.0]},
    }.items():
        Path(f"{name}.json").write_text(json.dumps(content))
    Path("system.nzp").write_bytes(b"\x93NUMPY")
    rng = np.random.default_rng(1)
    lines = log(30, 20, rng)
    jitter = (line.split(",") for line in log(8, 150, rng)[1:])
    jitter = [[run, str(float(t) + 2e-3 * rng.standard_normal()), *row] for run, t, *row in jitter]
    for name, content in {
        "runs": lines,
        "one": lines[:22],
        "few": lines[:4],
        "ten": lines[:211],
        "now": log(1, 11, rng),
        "pushed": log(30, 20, rng, push=0.05),
        "jitter": [lines[0], *map(",".join, jitter)],
        "skip": ["by hand", *lines[:22]],
    }.items():
        Path(f"{name}.csv").write_text("\n".join(content) + "\n")


def printed(line):
    """Output, messages, and the exit code where it is not 0."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        code = cli.main(shlex.split(line))
    text = "\n".join(row.rstrip() for row in out.getvalue().strip("\n").splitlines())
    return text + f"\n[{code}]" * bool(code)


@pytest.fixture(scope="module")
def outputs():
    """Of all commands, one after the other in one place."""
    with tempfile.TemporaryDirectory() as place, pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        patch.setenv("COLUMNS", "100")
        write_files()
        return {line: printed(line) for line, *_ in BLOCKS}


@pytest.mark.parametrize(("line", "_", "expected"), BLOCKS, ids=[one[0] for one in BLOCKS])
def test_a_command_prints_what_it_did(line, _, expected, outputs):
    """Text to the letter, numbers to a hundredth: the last digit depends on the machine."""
    found = outputs[line]
    assert NUMBER.sub("0", found) == NUMBER.sub("0", expected.strip("\n"))
    numbers = [[float(one) for one in NUMBER.findall(text)] for text in (found, expected)]
    np.testing.assert_allclose(*numbers, rtol=1e-2)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        os.environ["COLUMNS"] = "100"
        write_files()
        blocks = [f"$ stochens {line}\n{printed(line)}\n" for line, *_ in BLOCKS]
        FILE.write_text("\n".join(blocks))
